//! Draws a frame: exposure and seam on the coarse samples, then pixels.

use std::ops::Range;

use super::blend::{self, Blender, Ranges};
use super::blend_rows::{blend_zone, extend_row};
use super::drawing::{DrawnMesh, DrawnView, Patch, Runs};
use super::exposure::{RunningGain, fixed_gain};
use super::graph_cut::GridCut;
use super::mesh::{Mapping, Mesh, MeshGrid};
use super::params::*;
use super::pyramid::{LANES, ONE};
use super::seam::Seam;
use super::segments::{BASE_ONLY, BASE_SHOWN, NEW_ONLY, NEW_SHOWN, Segment, Segments};
use super::taps::{Joined, Taps};
use super::warp::{self, BLOCK, Block, Pixels, Span};
use crate::lit::LitPart;
use crate::{Parallel, Rect, SharedMut, View, ViewMut};

/// Canvas rows per chunk.
pub(super) const ROWS: usize = 16;

/// All views on the canvas, and the data that joins them: geometry, seams, gains, work memory.
#[derive(Debug, Default)]
pub(super) struct Layers {
    pub(super) warps: Vec<Warp>,
    /// Meshes that views are drawn by; empty if there is none.
    pub(super) meshes: [Mesh; MAX_VIEWS],
    /// Lit parts of the views; `None` for all.
    pub(super) lit: [Option<LitPart>; MAX_VIEWS],
    /// Whether the second of two views is shown to the left of the first.
    pub(super) is_left: bool,
    /// Columns that a view covers, by view and canvas row.
    pub(super) spans: Vec<Vec<Span>>,
    /// Views in use; the vectors keep the memory of more.
    pub(super) active: usize,
    pub(super) steps: Vec<Step>,
    pub(super) gains: [[f32; 3]; MAX_VIEWS],
    pub(super) running: [RunningGain; MAX_VIEWS],
    pub(super) joined: Joined,
    pub(super) cut: GridCut,
    pub(super) blender: Blender,
    /// What each pixel shows, and the columns around the seam, for a painter.
    pub(super) runs: Runs,
    pub(super) patch: Patch,
}

/// Geometry of one view on the canvas.
#[derive(Debug)]
pub(super) struct Warp {
    pub(super) source_from_canvas: [f64; 9],
    pub(super) source_from_tap: [f64; 9],
    /// Columns and rows to add to a canvas position, when the view is only shifted by whole pixels.
    pub(super) shift: Option<(i64, i64)>,
    /// Canvas rectangle in which the mesh of the reference view moves it.
    pub(super) moved: Option<Rect>,
    /// Columns of each canvas row in which the mesh moves the view; valid if `moved` is set.
    pub(super) moved_spans: Vec<Span>,
    /// Positions of the first canvas pixel and of the first tap on the reference plane, px.
    pub(super) origins: [[f32; 2]; 2],
    /// Distance of neighbouring taps there, px.
    pub(super) tap_step: f32,
    pub(super) taps: Taps,
}

impl Warp {
    /// Mapping from canvas pixels to those of the view: by the mesh if there is one.
    pub(super) fn mapping<'a>(&'a self, mesh: Option<&'a Mesh>) -> Mapping<'a> {
        match mesh {
            Some(mesh) => Mapping::Mesh(MeshGrid { mesh, origin: self.origins[0], step: 1.0 }),
            None => Mapping::Plane(&self.source_from_canvas),
        }
    }

    /// The coarse samples, and the mapping from them to pixels of the view.
    pub(super) fn taps<'a>(&'a mut self, mesh: Option<&'a Mesh>) -> (&'a mut Taps, Mapping<'a>) {
        let mapping = match mesh {
            Some(mesh) => Mapping::Mesh(MeshGrid { mesh, origin: self.origins[1], step: self.tap_step }),
            None => Mapping::Plane(&self.source_from_tap),
        };
        (&mut self.taps, mapping)
    }
}

/// State for joining one view to the previous ones.
#[derive(Debug, Default)]
pub(super) struct Step {
    pub(super) seam: Seam,
    pub(super) segments: Segments,
    pub(super) labels: Vec<u8>,
    /// Canvas rectangle that is blended.
    pub(super) zone: Option<Rect>,
    pub(super) ranges: Ranges,
}

impl Layers {
    /// Forgets exposures and seams; memory and geometry stay.
    pub(super) fn forget(&mut self) {
        self.forget_gains();
        for step in &mut self.steps {
            step.seam.forget();
        }
    }

    /// Resets all gains to 1 until they are measured again.
    pub(super) fn forget_gains(&mut self) {
        self.gains = [[1.0; 3]; MAX_VIEWS];
        self.running = [RunningGain::default(); MAX_VIEWS];
    }

    /// Samples the views for [`Layers::plan`].
    pub(super) fn sample(&mut self, views: &[View<u8>], pool: &dyn Parallel, avx2: bool) {
        for ((warp, mesh), view) in self.warps.iter_mut().zip(&self.meshes).zip(views) {
            let (taps, source_from_tap) = warp.taps(mesh.given());
            taps.fill(view, source_from_tap, pool, avx2);
        }
    }

    /// Updates gains and seams by the samples; cells of the seams have sides of `scale` px. Returns whether a seam was
    /// recomputed, and the cost along it.
    pub(super) fn plan(
        &mut self,
        params: &CompositeParams,
        scale: usize,
        may_learn: bool,
        moved: bool,
        canvas: Canvas,
        pool: &dyn Parallel,
    ) -> (bool, f32) {
        let (mut found_any, mut worst_cost) = (false, 0.0f32);
        let first = fixed_gain(&self.gains[0]);
        self.joined.start(&self.warps[0].taps, &first);
        for k in 1..self.active {
            let taps = &self.warps[k].taps;
            if params.exposure != ExposureMethod::None
                && may_learn
                && let Some(measured) = self.joined.light(taps).gain(params.exposure)
            {
                self.running[k].update(&mut self.gains[k], measured, params);
            }
            let gain = fixed_gain(&self.gains[k]);
            let step = &mut self.steps[k];
            step.seam.resize(canvas.width.div_ceil(scale), canvas.height.div_ceil(scale));
            self.joined.measure(taps, &gain, &mut step.seam, pool);
            step.seam.keep(self.meshes[k].given(), canvas, scale);
            if step.seam.is_due(params, may_learn) {
                step.seam.doubt(self.meshes[k].given(), self.meshes[0].given(), canvas, scale);
            }
            let found = step.seam.update(params, scale, k == 1, may_learn, &mut self.cut);
            found_any |= found;
            worst_cost = worst_cost.max(step.seam.cost_along());
            if moved || step.labels != step.seam.take {
                step.labels.clone_from(&step.seam.take);
                let (base, new) = self.spans.split_at(k);
                step.segments.build((canvas.width, canvas.height), base, &new[0], &step.seam, scale);
                step.zone = zone(step, params, canvas, scale);
                let Step { ranges, seam, zone, .. } = step;
                if let Some(z) = zone {
                    set_ranges(ranges, seam, *z, levels_of(params), scale);
                }
            }
            if k + 1 < self.active {
                self.joined.add(taps, &gain, &step.seam);
            }
        }
        (found_any, worst_cost)
    }

    /// Draws all views.
    pub(super) fn paint(
        &mut self,
        params: &CompositeParams,
        views: &[View<u8>],
        canvas: Canvas,
        pool: &dyn Parallel,
        out: &mut ViewMut<u8>,
        avx2: bool,
    ) {
        let stride = out.stride;
        let first = Source::new(&views[0], &self.warps[0], self.meshes[0].given(), &self.gains[0], avx2);
        if views.len() == 1 {
            return paint_only(&first, &self.spans[0], canvas, pool, out);
        }
        let levels = levels_of(params);
        for k in 1..views.len() {
            let step = &self.steps[k];
            let source = Source::new(&views[k], &self.warps[k], self.meshes[k].given(), &self.gains[k], avx2);
            let zone = step.zone;
            if let Some(z) = zone {
                self.blender.reset(z.width, z.height, levels);
            }
            {
                let target = SharedMut::new(&mut *out.data);
                let differences = SharedMut::new(zone.map_or(&mut [], |_| self.blender.differences()));
                pool.run(canvas.height.div_ceil(ROWS), &|chunk| {
                    let mut work = Work::default();
                    for y in rows_of(chunk, canvas) {
                        // SAFETY: rows are split between chunks.
                        let row = unsafe { target.part(y * stride, canvas.width * 3) };
                        let inside = zone.filter(|z| y >= z.y && y < z.y + z.height);
                        if k == 1 {
                            let needed = inside.map_or((0, 0), |z| {
                                let (a, b) = step.ranges.needed(y - z.y);
                                (z.x + a, z.x + b)
                            });
                            paint_base(&first, step.segments.row(y), needed, y, row, &mut work);
                        }
                        let blended = inside.map(|z| {
                            // SAFETY: rows are split between chunks.
                            let d = unsafe { differences.part((y - z.y) * z.width * LANES, z.width * LANES) };
                            Blended {
                                zone: z,
                                active: step.ranges.active(y - z.y),
                                needed: step.ranges.needed(y - z.y),
                                out: d,
                            }
                        });
                        paint_new(&source, step.segments.row(y), y, row, blended, &mut work);
                    }
                });
            }
            if let Some(z) = zone {
                let bands = params.blend == BlendMethod::MultiBand;
                let Step { segments, ranges, .. } = &self.steps[k];
                let at = |x: usize, y: usize| y * stride + x * 3;
                blend_zone(&mut self.blender, segments, ranges, z, bands, pool, (&mut *out.data, &at), avx2);
            }
        }
    }

    /// Draws 255 inside views.
    pub(super) fn paint_mask(&self, mask: &mut ViewMut<u8>, pool: &dyn Parallel) {
        let (width, height, stride) = (mask.width, mask.height, mask.stride);
        let target = SharedMut::new(&mut *mask.data);
        let spans = &self.spans[..self.active];
        pool.run(height.div_ceil(64), &|chunk| {
            for y in chunk * 64..(chunk * 64 + 64).min(height) {
                // SAFETY: rows are split between chunks.
                let row = unsafe { target.part(y * stride, width) };
                row.fill(0);
                for span in spans.iter().map(|s| s[y]).filter(|s| !s.is_empty()) {
                    row[span.start as usize..span.end as usize].fill(255);
                }
            }
        });
    }
}

/// Halvings of the blend pyramid: the transition is about twice the coarsest level's pixel wide.
pub(super) fn levels_of(params: &CompositeParams) -> usize {
    if params.blend == BlendMethod::None || params.blend_px < 2 {
        return 0;
    }
    (params.blend_px.min(256) as f32 / 2.0).log2().round().max(1.0) as usize
}

/// Distance from the seam, canvas pixels, beyond which weights are zero or one: a weight of the coarsest level gathers
/// `2 (2^n - 1)` pixels and is spread over `1.5 * 2^n` more.
fn reach_of(levels: usize) -> usize {
    2 * ((1 << levels) - 1) + (3 << levels) / 2
}

/// Narrows the zone row by row to the vicinity of the seam.
fn set_ranges(ranges: &mut Ranges, seam: &Seam, z: Rect, levels: usize, scale: usize) {
    let reach = reach_of(levels);
    ranges.set(z.width, z.height, |first, end| {
        let cells = (z.y + first).saturating_sub(reach) / scale..(z.y + end + reach).div_ceil(scale);
        // Changes that start one row of cells above end here.
        let (x0, _, x1, _) = seam.bounds_of(cells.start.saturating_sub(1), cells.end)?;
        Some(((x0 * scale).saturating_sub(reach + z.x), (x1 * scale + reach).saturating_sub(z.x)))
    });
}

/// The rectangle around the seam within which weights can differ from zero and one.
fn zone(step: &Step, params: &CompositeParams, canvas: Canvas, scale: usize) -> Option<Rect> {
    let levels = levels_of(params);
    if levels == 0 {
        return None;
    }
    let (x0, y0, x1, y1) = step.seam.bounds()?;
    let reach = reach_of(levels);
    let x = (x0 * scale).saturating_sub(reach);
    let y = (y0 * scale).saturating_sub(reach);
    let (right, bottom) = ((x1 * scale + reach).min(canvas.width), (y1 * scale + reach).min(canvas.height));
    (x < right && y < bottom).then_some(Rect { x, y, width: right - x, height: bottom - y })
}

/// One view, ready to be sampled on the canvas.
pub(super) struct Source<'a> {
    view: View<'a, u8>,
    source_from_canvas: Mapping<'a>,
    shift: Option<(i64, i64)>,
    /// Region in which a view that is otherwise only shifted is sampled: bounds, and columns of each canvas row.
    moved: Option<(Rect, &'a [Span])>,
    gain: [i16; 4],
    avx2: bool,
}

/// Work memory of a thread.
#[derive(Default)]
pub(super) struct Work {
    block: Block,
    pub(super) pixels: Pixels,
}

impl<'a> Source<'a> {
    pub(super) fn new(
        view: &View<'a, u8>,
        warp: &'a Warp,
        mesh: Option<&'a Mesh>,
        gain: &[f32; 3],
        avx2: bool,
    ) -> Self {
        let is_plain = mesh.is_none() || warp.moved.is_some();
        let shift = warp.shift.filter(|_| is_plain && gain.iter().all(|g| *g == 1.0));
        let moved = warp.moved.filter(|_| mesh.is_some()).map(|bounds| (bounds, &warp.moved_spans[..]));
        let source_from_canvas = warp.mapping(mesh);
        Self { view: *view, source_from_canvas, shift, moved, gain: fixed_gain(gain), avx2 }
    }

    /// The view for a painter.
    pub(super) fn drawn(&self, source_from_canvas: &[f64; 9]) -> DrawnView<'a> {
        let mesh = match &self.source_from_canvas {
            Mapping::Mesh(grid) => Some(DrawnMesh::of(grid)),
            Mapping::Plane(_) => None,
        };
        let (source_from_canvas, gain) = (*source_from_canvas, self.gain);
        let moved = self.moved.map(|(bounds, _)| bounds);
        let size = (self.view.width, self.view.height);
        DrawnView { size, source_from_canvas, mesh, shift: self.shift, moved, gain }
    }

    /// Samples up to a block of canvas pixels from `(x, y)` on into `work.pixels`.
    fn sample(&self, x: usize, y: usize, count: usize, work: &mut Work) {
        let v = &self.view;
        self.source_from_canvas.locate((x, y), (v.width, v.height, v.stride), count, &mut work.block, self.avx2);
        warp::sample(v, &work.block, count, &self.gain, &mut work.pixels, self.avx2);
    }

    /// Writes the canvas columns `start..end` of row `y` into `row`.
    fn draw(&self, start: usize, end: usize, y: usize, row: &mut [u8], work: &mut Work) {
        let Some(shift) = self.shift else { return self.draw_sampled(start, end, y, row, work) };
        let moved = self.moved.and_then(|(_, spans)| spans.get(y)).filter(|span| !span.is_empty());
        let Some(moved) = moved else { return self.copy(shift, start, end, y, row) };
        let (from, to) = ((moved.start as usize).clamp(start, end), (moved.end as usize).clamp(start, end));
        self.copy(shift, start, from, y, row);
        self.draw_sampled(from, to, y, row, work);
        self.copy(shift, to, end, y, row);
    }

    fn copy(&self, (dx, dy): (i64, i64), start: usize, end: usize, y: usize, row: &mut [u8]) {
        let end = end.min((self.view.width as i64 - dx).max(0) as usize);
        if start < end {
            let (sx, sy) = (start as i64 + dx, y as i64 + dy);
            let at = sy as usize * self.view.stride + sx as usize * 3;
            row[start * 3..end * 3].copy_from_slice(&self.view.data[at..at + (end - start) * 3]);
        }
    }

    fn draw_sampled(&self, start: usize, end: usize, y: usize, row: &mut [u8], work: &mut Work) {
        let mut x = start;
        while x < end {
            let n = (end - x).min(BLOCK);
            self.sample(x, y, n, work);
            warp::pack_bgr(&work.pixels, &mut row[x * 3..(x + n) * 3], self.avx2);
            x += n;
        }
    }
}

/// The rows of the canvas that a chunk draws.
fn rows_of(chunk: usize, canvas: Canvas) -> Range<usize> {
    chunk * ROWS..(chunk * ROWS + ROWS).min(canvas.height)
}

/// Draws the only view.
fn paint_only(source: &Source, spans: &[Span], canvas: Canvas, pool: &dyn Parallel, out: &mut ViewMut<u8>) {
    let stride = out.stride;
    let target = SharedMut::new(&mut *out.data);
    pool.run(canvas.height.div_ceil(ROWS), &|chunk| {
        let mut work = Work::default();
        for y in rows_of(chunk, canvas) {
            // SAFETY: rows are split between chunks.
            let row = unsafe { target.part(y * stride, canvas.width * 3) };
            paint_first(source, spans[y], y, row, &mut work);
        }
    });
}

fn paint_first(source: &Source, span: Span, y: usize, row: &mut [u8], work: &mut Work) {
    let (start, end) = if span.is_empty() { (0, 0) } else { (span.start as usize, span.end as usize) };
    row[..start * 3].fill(0);
    row[end * 3..].fill(0);
    if start < end {
        source.draw(start, end, y, row, work);
    }
}

/// As [`paint_first`] for a first view that a second one partly covers: skips hidden columns, except for `needed`,
/// whose differences are blended.
fn paint_base(
    source: &Source,
    segments: &[Segment],
    needed: (usize, usize),
    y: usize,
    row: &mut [u8],
    work: &mut Work,
) {
    for segment in segments {
        let (start, end) = (segment.start as usize, segment.end as usize);
        match segment.kind {
            BASE_ONLY | BASE_SHOWN => source.draw(start, end, y, row, work),
            NEW_SHOWN => {
                if let Some((a, b)) = segment.clip(needed.0, needed.1) {
                    source.draw(a, b, y, row, work);
                }
            }
            NEW_ONLY => {}
            _ => row[start * 3..end * 3].fill(0),
        }
    }
}

/// One row of the blend zone. Columns of `active` and `needed` count from the zone's left.
struct Blended<'a> {
    zone: Rect,
    active: (usize, usize),
    needed: (usize, usize),
    out: &'a mut [i16],
}

/// Writes the differences and weights of a row of the blend zone into `out`: columns `start..end` of the canvas, whose
/// pixels without the new view are `base`, BGR. `sample` puts as many pixels of the new view as asked for into the work
/// memory, from a column on.
pub(super) fn write_differences(
    segments: &[Segment],
    (start, end): (usize, usize),
    base: &[u8],
    out: &mut [i16],
    work: &mut Work,
    avx2: bool,
    sample: impl Fn(usize, usize, &mut Work),
) {
    for segment in segments.iter().filter(|s| s.both()) {
        let Some((a, b)) = segment.clip(start, end) else { continue };
        let mut x = a;
        while x < b {
            let n = (b - x).min(BLOCK);
            sample(x, n, work);
            let part = &mut out[(x - start) * LANES..(x - start + n) * LANES];
            let weight = if segment.kind == BASE_SHOWN { ONE } else { 0 };
            blend::difference(&base[(x - start) * 3..(x - start + n) * 3], &work.pixels, weight, part, avx2);
            x += n;
        }
    }
    extend_row(segments, (start, end), out);
}

/// Draws the new view where it alone is shown; in the blend zone writes differences and weights.
fn paint_new(
    source: &Source,
    segments: &[Segment],
    y: usize,
    row: &mut [u8],
    blended: Option<Blended>,
    work: &mut Work,
) {
    let width = row.len() / 3;
    let (mut hidden, mut shown) = (width, width);
    if let Some(Blended { zone, active, needed, out }) = blended {
        let (n0, n1) = (zone.x + needed.0, zone.x + needed.1);
        let out = &mut out[needed.0 * LANES..needed.1 * LANES];
        let sample = |x: usize, n: usize, work: &mut Work| source.sample(x, y, n, work);
        write_differences(segments, (n0, n1), &row[n0 * 3..n1 * 3], out, work, source.avx2, sample);
        (hidden, shown) = (zone.x + active.0, zone.x + active.1);
    }
    // Inside the active columns the picture so far stays: the blend adds to it.
    for segment in segments {
        match segment.kind {
            NEW_ONLY => source.draw(segment.start as usize, segment.end as usize, y, row, work),
            NEW_SHOWN => {
                for (from, to) in [(0, hidden), (shown, width)] {
                    if let Some((a, b)) = segment.clip(from, to) {
                        source.draw(a, b, y, row, work);
                    }
                }
            }
            _ => {}
        }
    }
}
