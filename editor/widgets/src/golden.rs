//! Renders screenshots of a window without a graphics card and compares them with golden images. `PANOSCOPE_BLESS=1` writes the images.
//!
//! Here and not in the tests, because it is the only part of them whose speed matters: the windows are built without optimization.

use std::cell::RefCell;
use std::collections::HashMap;
use std::path::Path;
use std::rc::Rc;

use eframe::egui::epaint::{Primitive, Vertex};
use eframe::egui::{Color32, ColorImage, Context, FullOutput, ImageData, Rect, TextureId, TexturesDelta};
use egui_kittest::TestRenderer;
use image::RgbImage;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

/// With this variable set, tests write the golden images instead of comparing.
const BLESS: &str = "PANOSCOPE_BLESS";
/// Largest difference of a channel that counts as the same colour.
const MIN_DIFFERENCE: u8 = 24;
/// Share of the pixels that may have another colour, because rounding differs between processors.
const MAX_DIFFERENT: f64 = 0.0005;

/// The textures that egui has uploaded.
#[derive(Clone, Default)]
pub struct Textures(Rc<RefCell<HashMap<TextureId, ColorImage>>>);

impl TestRenderer for Textures {
    fn handle_delta(&mut self, delta: &mut TexturesDelta) {
        let mut kept = self.0.borrow_mut();
        let set = std::mem::take(&mut delta.set);
        for (id, change) in set.into_iter().flat_map(|(id, changes)| changes.into_iter().map(move |c| (id, c))) {
            let ImageData::Color(image) = &change.image;
            match (change.pos, kept.get_mut(&id)) {
                (Some([x, y]), Some(old)) => {
                    let [width, height] = image.size;
                    for row in 0..height {
                        let to = (y + row) * old.size[0] + x;
                        old.pixels[to..to + width].copy_from_slice(&image.pixels[row * width..(row + 1) * width]);
                    }
                }
                _ => {
                    kept.insert(id, (**image).clone());
                }
            }
        }
        for id in std::mem::take(&mut delta.free) {
            kept.remove(&id);
        }
    }
}

/// A colour with its opacity multiplied in, 0..=255.
type Premultiplied = [f32; 4];

fn color(c: Color32) -> Premultiplied {
    c.to_array().map(f32::from)
}

fn texel(image: &ColorImage, u: f32, v: f32) -> Premultiplied {
    let [width, height] = image.size;
    let (x, y) = (u * width as f32 - 0.5, v * height as f32 - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let at = |dx: f32, dy: f32| {
        let column = (x0 + dx).clamp(0.0, width as f32 - 1.0) as usize;
        let row = (y0 + dy).clamp(0.0, height as f32 - 1.0) as usize;
        color(image.pixels[row * width + column])
    };
    let (a, b, c, d) = (at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), at(1.0, 1.0));
    std::array::from_fn(|k| {
        let (upper, lower) = (a[k] + (b[k] - a[k]) * fx, c[k] + (d[k] - c[k]) * fx);
        upper + (lower - upper) * fy
    })
}

/// A triangle of a mesh, in px.
struct Triangle<'a> {
    corners: [&'a Vertex; 3],
    at: [[f64; 2]; 3],
    area: f64,
    clip: Rect,
    texture: &'a ColorImage,
}

fn edge(a: [f64; 2], b: [f64; 2], p: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
}

impl<'a> Triangle<'a> {
    /// `None` for a triangle without area.
    fn new(corners: [&'a Vertex; 3], points: f32, clip: Rect, texture: &'a ColorImage) -> Option<Self> {
        let at = corners.map(|v| [f64::from(v.pos.x * points), f64::from(v.pos.y * points)]);
        let area = edge(at[0], at[1], at[2]);
        if area == 0.0 || !area.is_finite() {
            return None;
        }
        // Gives all triangles the same orientation.
        let order = if area > 0.0 { [0, 1, 2] } else { [0, 2, 1] };
        let (corners, at, area) = (order.map(|k| corners[k]), order.map(|k| at[k]), area.abs());
        Some(Self { corners, at, area, clip, texture })
    }

    /// The first and the last coordinate that it may cover.
    fn bounds(&self, axis: usize) -> (f64, f64) {
        let (clip_low, clip_high) = match axis {
            0 => (self.clip.left(), self.clip.right()),
            _ => (self.clip.top(), self.clip.bottom()),
        };
        let along = || self.at.iter().map(|p| p[axis]);
        (
            along().fold(f64::MAX, f64::min).max(f64::from(clip_low)),
            along().fold(f64::MIN, f64::max).min(f64::from(clip_high)),
        )
    }

    /// Its colour at the middle of a pixel; `None` outside.
    #[inline]
    fn color_at(&self, p: [f64; 2]) -> Option<Premultiplied> {
        let (at, clip) = (&self.at, self.clip);
        // A pixel on a shared edge belongs to only one of the two triangles.
        let owns = |a: [f64; 2], b: [f64; 2]| (a[1] == b[1] && b[0] > a[0]) || b[1] < a[1];
        let inside_clip = p[0] >= f64::from(clip.left())
            && p[0] < f64::from(clip.right())
            && p[1] >= f64::from(clip.top())
            && p[1] < f64::from(clip.bottom());
        if !inside_clip {
            return None;
        }
        let mut weights = [0.0; 3];
        for (weight, (a, b)) in weights.iter_mut().zip([(at[1], at[2]), (at[2], at[0]), (at[0], at[1])]) {
            *weight = edge(a, b, p);
            let is_inside = *weight > 0.0 || (*weight == 0.0 && owns(a, b));
            if !is_inside {
                return None;
            }
        }
        let share = weights.map(|w| (w / self.area) as f32);
        let mix = |[a, b, c]: [f32; 3]| a * share[0] + b * share[1] + c * share[2];
        let corners = self.corners;
        let sampled = texel(self.texture, mix(corners.map(|v| v.uv.x)), mix(corners.map(|v| v.uv.y)));
        let tints = corners.map(|v| v.color.to_array());
        let tint: Premultiplied = std::array::from_fn(|k| mix(tints.map(|tint| f32::from(tint[k]))));
        Some(std::array::from_fn(|k| sampled[k] * tint[k] / 255.0))
    }
}

/// A colour over another one.
fn over(source: Premultiplied, below: [f32; 3]) -> [f32; 3] {
    let rest = 1.0 - source[3] / 255.0;
    std::array::from_fn(|k| source[k] + below[k] * rest)
}

/// Calls `draw` with all triangles of a frame, in order.
fn each_triangle(ctx: &Context, output: &FullOutput, textures: &Textures, mut draw: impl FnMut(&Triangle<'_>)) {
    let points = output.pixels_per_point;
    let textures = textures.0.borrow();
    for part in ctx.tessellate(output.shapes.clone(), points) {
        let clip = Rect::from_min_max(
            (part.clip_rect.min.to_vec2() * points).to_pos2(),
            (part.clip_rect.max.to_vec2() * points).to_pos2(),
        );
        let Primitive::Mesh(mesh) = &part.primitive else { continue };
        let Some(texture) = textures.get(&mesh.texture_id) else { continue };
        for corners in mesh.indices.as_chunks::<3>().0 {
            let corners = corners.map(|i| &mesh.vertices[i as usize]);
            if let Some(triangle) = Triangle::new(corners, points, clip, texture) {
                draw(&triangle);
            }
        }
    }
}

/// The colours of single pixels of a frame on the background `ground`, each at a column and a row: as [`paint`] has them, in less time.
pub fn colors_at(
    ctx: &Context,
    output: &FullOutput,
    textures: &Textures,
    ground: Color32,
    pixels: &[[u32; 2]],
) -> Vec<[u8; 3]> {
    let mut colors = vec![[ground.r(), ground.g(), ground.b()].map(f32::from); pixels.len()];
    each_triangle(ctx, output, textures, |triangle| {
        let [(left, right), (top, bottom)] = [triangle.bounds(0), triangle.bounds(1)];
        for (pixel, color) in pixels.iter().zip(&mut colors) {
            let p = pixel.map(|at| f64::from(at) + 0.5);
            if p[0] >= left
                && p[0] <= right
                && p[1] >= top
                && p[1] <= bottom
                && let Some(source) = triangle.color_at(p)
            {
                *color = over(source, *color);
            }
        }
    });
    colors.into_iter().map(|color| color.map(|v| v.round().clamp(0.0, 255.0) as u8)).collect()
}

/// Renders a frame on the background `ground`.
///
/// # Panics
/// Never: the picture has three bytes per pixel.
pub fn paint(ctx: &Context, output: &FullOutput, textures: &Textures, ground: Color32) -> RgbImage {
    let size = ctx.viewport_rect().size() * output.pixels_per_point;
    let (width, height) = (size.x.round() as usize, size.y.round() as usize);
    let mut pixels = vec![[ground.r(), ground.g(), ground.b()].map(f32::from); width * height];
    each_triangle(ctx, output, textures, |triangle| {
        let within = |(low, high): (f64, f64), end: usize| {
            (low.floor().max(0.0) as usize)..(high.ceil().max(0.0) as usize).min(end)
        };
        let columns = within(triangle.bounds(0), width);
        for y in within(triangle.bounds(1), height) {
            for x in columns.clone() {
                if let Some(source) = triangle.color_at([x as f64 + 0.5, y as f64 + 0.5]) {
                    let to = &mut pixels[y * width + x];
                    *to = over(source, *to);
                }
            }
        }
    });
    let bytes = pixels.iter().flat_map(|p| p.map(|v| v.round().clamp(0.0, 255.0) as u8)).collect();
    RgbImage::from_raw(width as u32, height as u32, bytes).expect("three bytes per pixel")
}

/// Compares a screenshot with the golden image `tests/snapshots/NAME.png` of the package whose test runs; `masked` rectangles, such as those with times,
/// are not compared.
///
/// # Panics
/// The pictures differ, or there is no golden image.
pub fn compare(name: &str, mut picture: RgbImage, masked: &[Rect]) {
    for rect in masked {
        let within = |v: f32, most: u32| (v.round().max(0.0) as u32).min(most);
        for y in within(rect.top(), picture.height())..within(rect.bottom(), picture.height()) {
            for x in within(rect.left(), picture.width())..within(rect.right(), picture.width()) {
                picture.put_pixel(x, y, image::Rgb([24, 28, 34]));
            }
        }
    }
    // Set by cargo for each test; that of the compiler would be this package.
    let package = std::env::var_os("CARGO_MANIFEST_DIR").expect("tests run under cargo");
    let folder = Path::new(&package).join("tests/snapshots");
    let kept = folder.join(format!("{name}.png"));
    if std::env::var_os(BLESS).is_some() {
        std::fs::create_dir_all(&folder).expect("the folder can be made");
        let file = std::fs::File::create(&kept).expect("the picture can be written");
        let small = PngEncoder::new_with_quality(file, CompressionType::Best, FilterType::Adaptive);
        picture.write_with_encoder(small).expect("the picture can be written");
        return;
    }
    let now = std::env::temp_dir().join(format!("panoscope_{name}_now.png"));
    let look = || {
        picture.save(&now).expect("temporary files can be written");
        format!("the current screenshot is {}; {BLESS}=1 makes it the golden image", now.display())
    };
    let Ok(old) = image::open(&kept) else { panic!("there is no {}: {}", kept.display(), look()) };
    let old = old.to_rgb8();
    assert!(old.dimensions() == picture.dimensions(), "{name} is {:?} now: {}", picture.dimensions(), look());
    let differs =
        |(a, b): &(&image::Rgb<u8>, &image::Rgb<u8>)| a.0.iter().zip(b.0).any(|(a, b)| a.abs_diff(b) > MIN_DIFFERENCE);
    let count = old.pixels().zip(picture.pixels()).filter(differs).count();
    let share = count as f64 / f64::from(old.width() * old.height());
    assert!(share <= MAX_DIFFERENT, "{count} pixels of {name} differ: {}", look());
}
