//! Images that evaluations draw and write.

use std::path::Path;

use panoscope_imaging::ViewMut;
use panoscope_imaging::draw::{self, Color};

use crate::error::{Context, FileAction, OnFile, Result};

/// A BGR image to draw on, row by row without padding.
pub(crate) struct Canvas {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Blue, green, red bytes.
    pub bgr: Vec<u8>,
}

impl Canvas {
    /// An image of one colour.
    pub fn new(width: usize, height: usize, color: Color) -> Self {
        Self { width, height, bgr: color.repeat(width * height) }
    }

    /// The pixels, for the functions of [`draw`].
    pub fn view(&mut self) -> ViewMut<'_, u8> {
        ViewMut::new(&mut self.bgr, self.width, self.height, 3)
    }

    /// Writes text with its top left corner at `(x, y)`.
    pub fn text(&mut self, x: f32, y: f32, text: &str, color: Color) {
        draw::text(&mut self.view(), x, y, text, 1.6, color);
    }

    /// Copies another image into this one, with its top left corner at `(x, y)`; all of it must fit.
    pub fn paste(&mut self, (x, y): (usize, usize), other: &Self) {
        for (row, line) in other.bgr.chunks_exact(3 * other.width.max(1)).enumerate() {
            self.bgr[3 * ((y + row) * self.width + x)..][..line.len()].copy_from_slice(line);
        }
    }

    /// Writes the image to a file.
    pub fn save(mut self, path: &Path) -> Result<()> {
        self.bgr.chunks_exact_mut(3).for_each(|p| p.swap(0, 2));
        let image = image::RgbImage::from_raw(self.width as u32, self.height as u32, self.bgr);
        image.context("an image of another size")?.save(path).on_file(FileAction::Write, path)
    }
}
