//! Images with a bar of text below them, joined on the GPU.

use std::ops::Range;

use panoscope_imaging::ViewMut;
use panoscope_node::Result;
use panoscope_node::device::{DeviceImage, Gpu, MARGIN_BYTES, Steps, Store};

use super::fit::{DeviceFit, FitJob};

/// What the pixels of a bar without boxes depend on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BarText {
    /// Its title.
    pub title: String,
    /// The text of its plates.
    pub words: String,
    /// Width, px.
    pub width: usize,
    /// Number of lines.
    pub lines: usize,
    /// Scale of its text.
    pub scale: f32,
}

/// Joins images and bars. Keeps the bar on the GPU and writes only those of its rows that have changed.
#[derive(Debug)]
pub struct Below {
    gpu: Gpu,
    fit: DeviceFit,
    text: BarText,
    /// The bar as it is in `store`.
    drawn: Vec<u8>,
    /// Memory for the next one.
    next: Vec<u8>,
    store: Store,
}

/// The first to the last row of `next` that differs from `drawn`; all if their sizes differ.
fn changed_rows(drawn: &[u8], next: &[u8], stride: usize) -> Range<usize> {
    let rows = next.len() / stride;
    if drawn.len() != next.len() {
        return 0..rows;
    }
    let differs = |y: &usize| drawn[y * stride..][..stride] != next[y * stride..][..stride];
    let first = (0..rows).find(differs).unwrap_or(rows);
    first..(first..rows).rev().find(differs).map_or(first, |last| last + 1)
}

impl Below {
    /// Prepares the GPU.
    ///
    /// # Errors
    /// It rejects the kernel.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let fit = DeviceFit::new(gpu)?;
        let (text, drawn, next, store) = Default::default();
        Ok(Self { gpu, fit, text, drawn, next, store })
    }

    /// Copies `image` to the upper rows of `out`, and the bar that `draw` draws to those below. Does not wait for the
    /// GPU. A bar with the text of the last one is not drawn again.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn join(
        &mut self,
        image: DeviceImage,
        out: DeviceImage,
        text: &BarText,
        draw: impl FnOnce(&mut ViewMut<'_, u8>),
    ) -> Result<()> {
        let (stride, height) = (out.stride_bytes, out.height - image.height);
        let mut rows = 0..0;
        if self.text != *text || self.drawn.len() != stride * height {
            self.next.resize(stride * height, 0);
            draw(&mut ViewMut::with_stride(&mut self.next, out.width, height, 3, stride));
            rows = changed_rows(&self.drawn, &self.next, stride);
            std::mem::swap(&mut self.drawn, &mut self.next);
            self.text.clone_from(text);
        }
        let bar = DeviceImage { buffer: self.store.reserve(self.gpu, stride * height + MARGIN_BYTES)?, height, ..out };
        let mut steps = Steps::default();
        steps.write(bar.buffer, rows.start * stride, &self.drawn[rows.start * stride..rows.end * stride]);
        let upper = FitJob { from: image, to: DeviceImage { height: image.height, ..out }, start: 0 };
        let lower = FitJob { from: bar, to: DeviceImage { height, ..out }, start: image.height * stride };
        self.fit.run(steps, &[upper, lower])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_between_changed_ones_count_as_changed() {
        let drawn = [0, 0, 1, 1, 2, 2, 3, 3];
        assert_eq!(changed_rows(&drawn, &drawn, 2), 4..4);
        assert_eq!(changed_rows(&drawn, &[0, 0, 9, 1, 2, 2, 3, 9], 2), 1..4);
        assert_eq!(changed_rows(&drawn, &[0, 9, 1, 1, 2, 2, 3, 3], 2), 0..1);
        assert_eq!(changed_rows(&drawn, &[0, 0, 1, 1], 2), 0..2);
    }
}
