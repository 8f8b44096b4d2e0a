//! A screenshot of a part of the window, for export.

use std::sync::Arc;

use eframe::egui::{Context, Event, Rect, UserData, ViewportCommand};

/// A requested screenshot of a part of the window.
#[derive(Default)]
pub struct Cutout {
    rect: Option<Rect>,
}

impl Cutout {
    /// Requests a screenshot of `rect`.
    pub fn request(&mut self, ctx: &Context, rect: Rect) {
        self.rect = Some(rect);
        ctx.send_viewport_cmd(ViewportCommand::Screenshot(UserData::default()));
    }

    /// The screenshot, once it is taken.
    pub fn taken(&mut self, ctx: &Context) -> Option<image::RgbImage> {
        let rect = self.rect?;
        let image = ctx.input(|i| {
            i.events.iter().find_map(|e| match e {
                Event::Screenshot { image, .. } => Some(Arc::clone(image)),
                _ => None,
            })
        })?;
        self.rect = None;
        let [width, height] = image.size;
        let points = ctx.pixels_per_point();
        let at = |v: f32, most: usize| ((v * points).round().max(0.0) as usize).min(most);
        let (x0, x1) = (at(rect.left(), width), at(rect.right(), width));
        let (y0, y1) = (at(rect.top(), height), at(rect.bottom(), height));
        let rows = (y0..y1).flat_map(|y| image.pixels[y * width + x0..y * width + x1].iter());
        let rgb: Vec<u8> = rows.flat_map(|p| [p.r(), p.g(), p.b()]).collect();
        image::RgbImage::from_raw((x1 - x0) as u32, (y1 - y0) as u32, rgb)
    }
}
