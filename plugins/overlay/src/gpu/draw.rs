//! Shapes drawn on images that are on the GPU: only the parts that they touch come to the processor, and go back.

use panoscope_imaging::Rect;
use panoscope_node::device::{DeviceImage, Gpu, MARGIN_BYTES, Steps, Store};
use panoscope_node::pick::{Grid, Parts};
use panoscope_node::{Bgr8, Image, Result};

use super::fit::FitJob;
use crate::shapes::Shapes;

/// Draws on copies of images. The bytes are those of the processor, which draws.
#[derive(Debug)]
pub struct DeviceDrawing {
    gpu: Gpu,
    parts: Parts<u8>,
    /// The parts after drawing, one after the other, here and on the GPU.
    drawn: Vec<u8>,
    store: Store,
}

impl DeviceDrawing {
    /// Draws on a GPU.
    pub fn new(gpu: Gpu) -> Self {
        let (parts, drawn, store) = Default::default();
        Self { gpu, parts, drawn, store }
    }

    /// Draws on the upper left part of `out`, which is to be a copy of `image`: adds the writing of the parts to `steps`, and the jobs that bring image
    /// and parts to `out` to `jobs`.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn draw<'a>(
        &'a mut self,
        image: &Image<'_, Bgr8>,
        shapes: &Shapes,
        out: DeviceImage,
        (steps, jobs): (&mut Steps<'a>, &mut Vec<FitJob>),
    ) -> Result<()> {
        let from = image.on_device()?;
        let to = DeviceImage { width: from.width, height: from.height, ..out };
        jobs.push(FitJob { from, to, start: 0, from_start: 0 });
        let areas = shapes.areas((from.width, from.height));
        if areas.is_empty() {
            return Ok(());
        }
        let grids: Vec<Grid> = areas.iter().map(|area| Grid::of_area(*area)).collect();
        let mut picture = self.parts.canvas(*image, &grids)?;
        shapes.draw(&mut picture);
        let row_bytes = |area: &Rect| DeviceImage::stride_bytes(area.width, 3);
        let total = areas.iter().map(|area| row_bytes(area) * area.height).sum::<usize>();
        let buffer = self.store.reserve(self.gpu, total + MARGIN_BYTES)?;
        self.drawn.clear();
        for area in &areas {
            let (width, height, stride_bytes) = (area.width, area.height, row_bytes(area));
            let from = DeviceImage { buffer, width, height, stride_bytes };
            let start = area.y * out.stride_bytes + 3 * area.x;
            jobs.push(FitJob { from, to: DeviceImage { width, height, ..out }, start, from_start: self.drawn.len() });
            for y in area.y..area.y + area.height {
                self.drawn.extend_from_slice(&picture.row_mut(y)[3 * area.x..][..3 * area.width]);
                self.drawn.resize(self.drawn.len() + stride_bytes - 3 * area.width, 0);
            }
        }
        steps.write(buffer, 0, &self.drawn);
        Ok(())
    }
}
