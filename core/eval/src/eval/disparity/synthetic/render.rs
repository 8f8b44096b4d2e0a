//! Casts the rays of both views.

use panoscope_base::Parallel;

use super::camera::{BASELINE_MM, Point, centre};
use super::relief::Level;
use super::rows::fill_rows;
use super::scenes::{Layer, Scene};
use super::texture::colour;

/// Rays per pixel are the square of this.
const RAYS_ALONG: usize = 2;
/// A surface that is nearer by less than this hides nothing, px of disparity.
const SAME_SURFACE_PX: f64 = 0.25;

/// One view as rendered: light, not yet bytes.
#[derive(Clone)]
pub struct Rendered {
    /// Columns and rows.
    pub size: (usize, usize),
    /// Blue, green, red levels, not clipped.
    pub bgr: Vec<f32>,
    /// See [`super::SyntheticView`].
    pub disparity: Vec<f32>,
    /// See [`super::SyntheticView`].
    pub visible: Vec<u8>,
}

/// The nearest surface of a ray: column in the left view, disparity, layer.
struct Hit<'a> {
    x: f64,
    level: Level,
    layer: &'a Layer,
}

/// The nearest layer at a place of the left view.
fn left_hit(layers: &[Layer], (x, y): (f64, f64)) -> Option<Hit<'_>> {
    let mut best: Option<Hit<'_>> = None;
    for layer in layers.iter().filter(|layer| layer.cover.contains((x, y))) {
        let level = layer.relief.at((x, y));
        if best.as_ref().is_none_or(|hit| level.d > hit.level.d) {
            best = Some(Hit { x, level, layer });
        }
    }
    best
}

/// The nearest layer at a place of the right view. `columns` holds each layer's column of the ray before.
fn right_hit<'a>(layers: &'a [Layer], (x_right, y): (f64, f64), columns: &mut [f64]) -> Option<Hit<'a>> {
    let mut best: Option<Hit<'_>> = None;
    for (layer, column) in layers.iter().zip(columns) {
        let (x, level) = layer.relief.column_of_right(x_right, y, *column);
        *column = x;
        if layer.cover.contains((x, y)) && best.as_ref().is_none_or(|hit| level.d > hit.level.d) {
            best = Some(Hit { x, level, layer });
        }
    }
    best
}

/// Both views of a scene.
pub fn render(scene: &Scene, pool: &dyn Parallel) -> [Rendered; 2] {
    [false, true].map(|right| view(scene, right, pool))
}

fn view(scene: &Scene, is_right: bool, pool: &dyn Parallel) -> Rendered {
    let size @ (width, height) = scene.size;
    let mut bgr = vec![0.0; 3 * width * height];
    fill_rows(&mut bgr, 3 * width, pool, |row, pixels| {
        light_row(scene, is_right, row, pixels.as_chunks_mut::<3>().0);
    });
    let (disparity, visible) = truth(scene, is_right, pool);
    Rendered { size, bgr, disparity, visible }
}

/// Disparity and visibility of a view; see [`super::SyntheticView`].
pub fn truth(scene: &Scene, is_right: bool, pool: &dyn Parallel) -> (Vec<f32>, Vec<u8>) {
    let (width, height) = scene.size;
    let mut pixels = vec![(0.0, 0); width * height];
    fill_rows(&mut pixels, width, pool, |row, pixels| truth_row(scene, is_right, row, pixels));
    pixels.into_iter().unzip()
}

/// Mean light of the rays of each pixel.
fn light_row(scene: &Scene, is_right: bool, row: usize, pixels: &mut [[f32; 3]]) {
    let eye_x_mm = if is_right { BASELINE_MM } else { 0.0 };
    // A right camera whose calibration is wrong looks past its rows.
    let below_px = if is_right { scene.right_rows_px } else { 0.0 };
    let middle = centre(scene.size);
    let mut columns = vec![0.0; scene.layers.len()];
    for step in 0..RAYS_ALONG {
        let offset = |step: usize| (step as f64 + 0.5) / RAYS_ALONG as f64 - 0.5;
        let y = row as f64 + offset(step) + below_px;
        columns.fill(0.0);
        for (column, pixel) in pixels.iter_mut().enumerate() {
            for along in 0..RAYS_ALONG {
                let x = column as f64 + offset(along);
                let hit = if is_right {
                    right_hit(&scene.layers, (x, y), &mut columns)
                } else {
                    left_hit(&scene.layers, (x, y))
                };
                let Some(Hit { x, level, layer }) = hit else { continue };
                let point = Point::new((x - middle.0, y - middle.1), level.d, (level.dx, level.dy));
                for (sum, value) in pixel.iter_mut().zip(colour(&layer.material, &point, eye_x_mm)) {
                    *sum += (value / (RAYS_ALONG * RAYS_ALONG) as f64) as f32;
                }
            }
        }
    }
}

/// Disparity of each pixel's centre, and whether the other camera sees that point.
fn truth_row(scene: &Scene, is_right: bool, row: usize, pixels: &mut [(f32, u8)]) {
    let y = row as f64;
    let (layers, last) = (&scene.layers, scene.size.0 as f64 - 1.0);
    let mut columns = vec![0.0; layers.len()];
    let mut others = vec![0.0; layers.len()];
    for (column, (disparity, visible)) in pixels.iter_mut().enumerate() {
        let x = column as f64;
        let hit = if is_right { right_hit(layers, (x, y), &mut columns) } else { left_hit(layers, (x, y)) };
        let Some(hit) = hit else { continue };
        *disparity = hit.level.d as f32;
        let (to, nearest) = if is_right {
            (hit.x, left_hit(layers, (hit.x, y)))
        } else {
            let to = x - hit.level.d;
            (to, right_hit(layers, (to, y), &mut others))
        };
        let is_nearest = nearest.is_some_and(|other| other.level.d <= hit.level.d + SAME_SURFACE_PX);
        *visible = if is_nearest && (0.0..=last).contains(&to) { 255 } else { 0 };
    }
}
