//! What a person sees in a screenshot: images with their marks, and texts.

use eframe::egui::epaint::ClippedShape;
use eframe::egui::{Color32, Context, FullOutput, Pos2, Rect, Shape, TextureId};
use panoscope_editor_widgets::golden::{Textures, colors_at};

use super::marks::Mark;
use crate::arrange::TITLE;

/// An image on the screen.
#[derive(Debug)]
pub struct Shown {
    /// What it shows, and whether it is undimmed; of each eye where rows alternate.
    pub marks: [Option<(Mark, bool)>; 2],
    /// The texture that it is drawn with.
    pub texture: TextureId,
    /// Its title.
    pub title: String,
    /// The age above it, ms.
    pub age_ms: Option<f64>,
}

/// The images and texts on a screen.
pub struct Screen {
    pub images: Vec<Shown>,
    pub texts: Vec<(Rect, String)>,
}

impl Screen {
    /// Reads a frame.
    pub fn read(ctx: &Context, output: &FullOutput, textures: &Textures) -> Self {
        let mut screen = Self { images: Vec::new(), texts: Vec::new() };
        let mut rects = Vec::new();
        output.shapes.iter().for_each(|ClippedShape { shape, .. }| screen.collect(shape, &mut rects));
        // The left eye before the right one.
        rects.sort_by(|(a, _), (b, _)| (a.left() + a.top()).total_cmp(&(b.left() + b.top())));
        let points = output.pixels_per_point;
        // As they are, and of even and of odd rows alone.
        let pixels = rects.iter().flat_map(|(rect, _)| {
            [(1, 0), (2, 0), (2, 1)].into_iter().flat_map(move |(rows, row)| {
                Mark::blocks().map(move |(x, y)| {
                    let at = Pos2::new(rect.left() + x * rect.width(), rect.top() + y * rect.height()) * points;
                    [at.x as u32, at.y as u32 / rows * rows + row]
                })
            })
        });
        let colors = colors_at(ctx, output, textures, Color32::BLACK, &pixels.collect::<Vec<_>>());
        let brightness: Vec<f32> = colors.iter().map(|color| f32::from(color[1])).collect();
        let blocks = Mark::blocks().count();
        for ((rect, texture), brightness) in rects.into_iter().zip(brightness.chunks_exact(3 * blocks)) {
            let above = Rect::from_min_max(Pos2::new(rect.left(), rect.top() - TITLE), rect.right_top());
            let above = screen.texts.iter().filter(|(text, _)| above.contains(text.center()));
            let (ages, titles): (Vec<_>, Vec<_>) = above
                .map(|(_, text)| text)
                .filter(|text| *text != "no new image")
                .partition(|text| age_ms(text).is_some());
            let (title, age_ms) = (
                titles.first().map_or_else(String::new, |title| (*title).clone()),
                ages.first().and_then(|age| age_ms(age)),
            );
            let [both, even, odd] = [0, 1, 2].map(|k| Mark::read(&brightness[k * blocks..][..blocks]));
            let marks = if both.is_some() { [both; 2] } else { [even, odd] };
            screen.images.push(Shown { marks, texture, title, age_ms });
        }
        screen
    }

    fn collect(&mut self, shape: &Shape, rects: &mut Vec<(Rect, TextureId)>) {
        match shape {
            Shape::Mesh(mesh) if mesh.texture_id != TextureId::default() => {
                rects.push((mesh.calc_bounds(), mesh.texture_id));
            }
            Shape::Text(text) if !text.galley.text().trim().is_empty() => {
                self.texts.push((text.visual_bounding_rect(), text.galley.text().to_owned()));
            }
            Shape::Vec(all) => all.iter().for_each(|one| self.collect(one, rects)),
            _ => {}
        }
    }

    /// Whether a text is on the screen.
    pub fn has(&self, wanted: &str) -> bool {
        self.texts.iter().any(|(_, text)| text.contains(wanted))
    }
}

/// The age that a text such as `120 ms` or `1.3 s old` states, ms.
pub fn age_ms(text: &str) -> Option<f64> {
    let (number, factor) = match (text.strip_suffix(" s old"), text.strip_suffix(" ms")) {
        (Some(seconds), _) => (seconds, 1e3),
        (None, Some(ms)) => (ms, 1.0),
        (None, None) => return None,
    };
    number.parse::<f64>().ok().map(|number| number * factor)
}
