//! Draws a frame with a painter: the processor finds and blends the seam from samples and columns of the views.

use super::blend::Blender;
use super::blend_rows::blend_zone;
use super::drawing::{Drawing, PaintError, Painter, Patch};
use super::paint::{Layers, ROWS, Source, Step, Work, levels_of, write_differences};
use super::params::*;
use super::pyramid::LANES;
use super::segments::NEW_ONLY;
use crate::{Parallel, Rect, SharedMut, View, ViewMut};

impl Layers {
    /// As [`Layers::sample`], of two views; only the layout of `views` is read.
    ///
    /// # Errors
    /// Errors of the painter.
    pub(super) fn sample_by(
        &mut self,
        painter: &mut dyn Painter,
        views: &[View<u8>],
        pool: &dyn Parallel,
        avx2: bool,
    ) -> Result<(), PaintError> {
        let mut samples = self.warps.iter_mut().zip(&self.meshes).zip(views).map(|((warp, mesh), view)| {
            let (taps, source_from_tap) = warp.taps(mesh.given());
            taps.locate(view, source_from_tap, pool, avx2)
        });
        let (Some(first), Some(second)) = (samples.next(), samples.next()) else { return Ok(()) };
        painter.sample(&mut [first, second])
    }

    /// Lets `painter` draw one or two views into `out`, or on its device; only the layout of `views` is read.
    ///
    /// # Errors
    /// Errors of the painter.
    pub(super) fn paint_by(
        &mut self,
        painter: &mut dyn Painter,
        params: &CompositeParams,
        views: &[View<u8>],
        canvas: Canvas,
        pool: &dyn Parallel,
        out: Option<&mut ViewMut<u8>>,
        avx2: bool,
    ) -> Result<(), PaintError> {
        let drawn = |view: usize| {
            let (warp, mesh) = (&self.warps[view], self.meshes[view].given());
            Source::new(&views[view], warp, mesh, &self.gains[view], avx2).drawn(&warp.source_from_canvas)
        };
        let count = views.len();
        let drawn = [drawn(0), drawn(count - 1)];
        let step = self.steps.get(1).filter(|_| count > 1);
        let zone = step.and_then(|step| step.zone.map(|zone| (step, zone)));
        if let Some((step, zone)) = zone {
            self.patch.shape(zone, &step.ranges);
            painter.draw_columns(&drawn, &mut self.patch)?;
            blend_patch(&mut self.blender, step, zone, params, &mut self.patch, pool, avx2);
        }
        let size = (canvas.width, canvas.height);
        let second = step.map(|step| (&step.segments, step.zone, &step.ranges));
        self.runs.build(size, &self.spans[0], second);
        let patch = zone.map(|_| &self.patch);
        painter.paint(&Drawing { size, views: &drawn[..count], runs: &self.runs, patch }, out, pool)
    }
}

/// Blends both images of a patch into its first one.
fn blend_patch(
    blender: &mut Blender,
    Step { segments, ranges, .. }: &Step,
    zone: Rect,
    params: &CompositeParams,
    patch: &mut Patch,
    pool: &dyn Parallel,
    avx2: bool,
) {
    blender.reset(zone.width, zone.height, levels_of(params));
    let stride = patch.stride();
    let (base, new) = patch.pixels.split_at_mut(stride * zone.height);
    let (rows, differences) = (SharedMut::new(base), SharedMut::new(blender.differences()));
    pool.run(zone.height.div_ceil(ROWS), &|chunk| {
        let mut work = Work::default();
        for r in chunk * ROWS..(chunk * ROWS + ROWS).min(zone.height) {
            let (from, to) = ranges.needed(r);
            let (start, end) = (zone.x + from, zone.x + to);
            let bytes = |a: usize, b: usize| (a - start) * 3..(b - start) * 3;
            let new = &new[r * stride..(r + 1) * stride];
            // SAFETY: rows are split between chunks.
            let (row, out) = unsafe {
                let out = differences.part((r * zone.width + from) * LANES, (to - from) * LANES);
                (rows.part(r * stride, stride), out)
            };
            let segments = segments.row(zone.y + r);
            for (a, b) in segments.iter().filter(|s| s.kind == NEW_ONLY).filter_map(|s| s.clip(start, end)) {
                row[bytes(a, b)].copy_from_slice(&new[bytes(a, b)]);
            }
            write_differences(segments, (start, end), row, out, &mut work, avx2, |x, n, work| {
                let pixels = work.pixels.0.as_chunks_mut::<4>().0.iter_mut();
                for (pixel, [b, g, r]) in pixels.zip(new[bytes(x, x + n)].as_chunks::<3>().0) {
                    *pixel = [*b, *g, *r, 0];
                }
            });
        }
    });
    let at = |x: usize, y: usize| {
        let row = y - zone.y;
        row * stride + (x - patch.starts[row] as usize) * 3
    };
    let bands = params.blend == BlendMethod::MultiBand;
    blend_zone(blender, segments, ranges, zone, bands, pool, (base, &at), avx2);
}
