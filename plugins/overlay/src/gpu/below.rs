//! Images with a bar of text below them, joined on the GPU.

use std::ops::Range;

use panoscope_imaging::ViewMut;
use panoscope_node::device::{DeviceImage, Gpu, MARGIN_BYTES, Steps, Store};
use panoscope_node::{Bgr8, Image, Result};

use super::draw::DeviceDrawing;
use super::fit::{DeviceFit, FitJob};
use crate::bar::Bar;
use crate::shapes::Shapes;

/// A bar of text: its plates, number of lines, and scale of the text.
pub type BarText<'a> = (&'a Bar, usize, f32);

/// Joins images and bars. Keeps the bar on the GPU and writes only those of its rows that have changed.
#[derive(Debug)]
pub struct Below {
    gpu: Gpu,
    fit: DeviceFit,
    drawing: DeviceDrawing,
    /// Plates, width, lines and scale of the bar as it is in `store`.
    bar: Bar,
    size: (usize, usize, f32),
    /// Its pixels.
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
        let (bar, size, drawn, next, store) = Default::default();
        Ok(Self { gpu, fit, drawing: DeviceDrawing::new(gpu), bar, size, drawn, next, store })
    }

    /// Copies `image` with shapes drawn on it to the upper rows of `out`, and a bar to those below. Waits for the GPU only where something is drawn. A
    /// bar like the last one is not drawn again.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn join(
        &mut self,
        image: &Image<'_, Bgr8>,
        shapes: &Shapes,
        (bar, lines, scale): BarText<'_>,
        out: DeviceImage,
    ) -> Result<()> {
        let (stride, height) = (out.stride_bytes, out.height - image.height());
        let (mut rows, size) = (0..0, (out.width, lines, scale));
        if self.bar != *bar || self.size != size || self.drawn.len() != stride * height {
            self.next.resize(stride * height, 0);
            bar.draw(&mut ViewMut::with_stride(&mut self.next, out.width, height, 3, stride), lines, scale);
            rows = changed_rows(&self.drawn, &self.next, stride);
            std::mem::swap(&mut self.drawn, &mut self.next);
            self.bar.clone_from(bar);
            self.size = size;
        }
        let from = DeviceImage { buffer: self.store.reserve(self.gpu, stride * height + MARGIN_BYTES)?, height, ..out };
        let (mut steps, mut jobs) = (Steps::default(), Vec::new());
        steps.write(from.buffer, rows.start * stride, &self.drawn[rows.start * stride..rows.end * stride]);
        self.drawing.draw(image, shapes, out, (&mut steps, &mut jobs))?;
        let start = image.height() * stride;
        jobs.push(FitJob { from, to: DeviceImage { height, ..out }, start, from_start: 0 });
        self.fit.run(steps, &jobs)
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
