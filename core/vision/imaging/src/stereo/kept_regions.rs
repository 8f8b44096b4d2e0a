//! Gives back what a filter has removed or moved although the match has it right in both views.
//!
//! A filter distrusts disparities near steps of depth, where matches reach over the edge, and takes the values of what lies around. Where an object
//! is as narrow as that, such as a wire or the tip of an instrument, nothing of it is left. What both views agree on over an area, with no more of
//! the same surface beside it than its edge would have, is an object and keeps its disparities.

use crate::stereo::confidence::ConfidenceParams;
use crate::stereo::filter_input::FilterInput;
use crate::stereo::shared_field::is_seen_by_both;
use crate::{Parallel, Rect, SharedMut, ViewMut};

/// Smallest area of a region, in squares of the radius of the scatter and [`EDGE_PX`]: wrong matches are about as large as a matcher's window.
const MIN_SQUARES: usize = 9;
/// Matches reach over edges by so much more than the radius of their scatter, px.
pub(crate) const EDGE_PX: usize = 2;
/// Largest step of disparity inside a region, px.
const MAX_STEP_PX: f32 = 1.0;
/// Confidence of a disparity that is given back; what a filter makes of it says nothing.
pub(crate) const KEPT_CONFIDENCE: f32 = 0.5;
/// Rows per chunk.
const ROWS: usize = 16;
/// Pixels of a row that are compared together.
const GRAIN_PX: usize = 32;

/// Neighbouring pixels of one row and one region.
#[derive(Clone, Copy, Debug)]
struct Run {
    row: u32,
    start: u32,
    end: u32,
    /// A run of the same region; its own index at the region's root, where the counts are.
    parent: u32,
    area: u32,
    /// Pixels that are well exposed.
    exposed: u32,
    /// Edges between the region's pixels and pixels of the same surface that the filter has kept.
    contacts: u32,
}

/// Finds and gives back regions; keeps its memory.
#[derive(Debug, Default)]
pub(crate) struct KeptRegions {
    /// What became of each pixel of the ROI.
    fates: Vec<u8>,
    runs: Vec<Run>,
}

/// The filter has kept the disparity, or the pixel had none that both views agree on.
const STAYS: u8 = 0;
/// The filter has moved or removed a disparity that both views agree on, of a pixel that is black or saturated.
const MOVED: u8 = 1;
/// The same of a well exposed pixel.
const MOVED_EXPOSED: u8 = 2;

impl KeptRegions {
    /// Writes the disparities of `input` over those of `filtered` in regions that the filter has lost, and their confidence. `edge_px` is how far from
    /// steps of depth the filter changes disparities by right. Returns the number of pixels given back; 0 where neither the right view nor a given confidence
    /// speaks for the match.
    pub fn restore(
        &mut self,
        input: &FilterInput<'_>,
        params: &ConfidenceParams,
        edge_px: usize,
        pool: &dyn Parallel,
        filtered: &mut ViewMut<'_, f32>,
        confidence: Option<&mut ViewMut<'_, f32>>,
    ) -> usize {
        let roi = input.roi.clamped(filtered.width, filtered.height);
        if roi.is_empty() || (input.disparity_right.is_none() && input.confidence.is_none()) {
            return 0;
        }
        if !self.find_moved(input, params, roi, pool, filtered) {
            return 0;
        }
        self.find_runs(input, roi, filtered, params.left_right_px);
        let min_area = (MIN_SQUARES * (params.scatter_radius_px + EDGE_PX).pow(2)) as u32;
        let mut confidence = confidence;
        let mut restored = 0;
        for index in 0..self.runs.len() {
            let Run { row, start, end, .. } = self.runs[index];
            let root = self.root(index);
            let root = self.runs[root];
            let is_object = root.area >= min_area
                && u64::from(root.area) > u64::from(root.contacts) * edge_px as u64
                && 2 * root.exposed > root.area;
            if is_object {
                let (y, columns) = (row as usize, start as usize..end as usize);
                filtered.row_mut(y)[columns.clone()].copy_from_slice(&input.disparity.row(y)[columns.clone()]);
                if let Some(map) = &mut confidence {
                    map.row_mut(y)[columns].iter_mut().for_each(|value| *value = value.max(KEPT_CONFIDENCE));
                }
                restored += (end - start) as usize;
            }
        }
        restored
    }

    /// Finds the pixels that the filter has moved though both views agree on them. Whether there are any.
    fn find_moved(
        &mut self,
        input: &FilterInput<'_>,
        params: &ConfidenceParams,
        roi: Rect,
        pool: &dyn Parallel,
        filtered: &ViewMut<'_, f32>,
    ) -> bool {
        self.fates.resize(roi.width * roi.height, STAYS);
        let any = std::sync::atomic::AtomicBool::new(false);
        let fates = SharedMut::new(&mut self.fates);
        let out = filtered.as_view();
        pool.run(roi.height.div_ceil(ROWS), &|chunk| {
            for row in chunk * ROWS..((chunk + 1) * ROWS).min(roi.height) {
                // SAFETY: one row, one chunk.
                let fates = unsafe { fates.part(row * roi.width, roi.width) };
                fates.fill(STAYS);
                let y = roi.y + row;
                let columns = roi.x..roi.x + roi.width;
                let (here, smooth) = (&input.disparity.row(y)[columns.clone()], &out.row(y)[columns]);
                for (grain, (d, smooth)) in here.chunks(GRAIN_PX).zip(smooth.chunks(GRAIN_PX)).enumerate() {
                    // NaN is not near.
                    let is_moved = |d: f32, smooth: f32| {
                        let is_near = (d - smooth).abs() <= params.left_right_px;
                        d.is_finite() & !is_near
                    };
                    // All of them, so that the compiler can vectorise the loop.
                    if !d.iter().zip(smooth).fold(false, |any, (d, smooth)| any | is_moved(*d, *smooth)) {
                        continue;
                    }
                    for (i, (d, smooth)) in d.iter().zip(smooth).enumerate() {
                        let at = grain * GRAIN_PX + i;
                        if is_moved(*d, *smooth) && is_agreed(input, params, (roi.x + at, y), *d) {
                            fates[at] = if is_exposed(input, params, (roi.x + at, y)) { MOVED_EXPOSED } else { MOVED };
                            any.store(true, std::sync::atomic::Ordering::Relaxed);
                        }
                    }
                }
            }
        });
        any.into_inner()
    }

    /// Joins moved pixels into regions.
    fn find_runs(&mut self, input: &FilterInput<'_>, roi: Rect, filtered: &ViewMut<'_, f32>, limit_px: f32) {
        self.runs.clear();
        let out = filtered.as_view();
        let mut above = 0..0;
        for row in 0..roi.height {
            let (first, y) = (self.runs.len(), roi.y + row);
            let fates = &self.fates[row * roi.width..(row + 1) * roi.width];
            let here = &input.disparity.row(y)[roi.x..roi.x + roi.width];
            let mut x = 0;
            while let Some(skip) = fates[x..].iter().position(|fate| *fate != STAYS) {
                let start = x + skip;
                x = start + 1;
                while x < roi.width && fates[x] != STAYS && (here[x] - here[x - 1]).abs() <= MAX_STEP_PX {
                    x += 1;
                }
                let count = |all: &dyn Fn(usize) -> bool| (start..x).filter(|x| all(*x)).count() as u32;
                // Of the same surface, and where it was.
                let is_kept = |d: f32, column: usize, row: usize| {
                    let (other, smooth) =
                        (input.disparity.row(roi.y + row)[roi.x + column], out.row(roi.y + row)[roi.x + column]);
                    self.fates[row * roi.width + column] == STAYS
                        && (d - other).abs() <= MAX_STEP_PX
                        && (other - smooth).abs() <= limit_px
                };
                let mut contacts = u32::from(start > 0 && is_kept(here[start], start - 1, row))
                    + u32::from(x < roi.width && is_kept(here[x - 1], x, row));
                if row > 0 {
                    contacts += count(&|x| is_kept(here[x], x, row - 1));
                }
                if row + 1 < roi.height {
                    contacts += count(&|x| is_kept(here[x], x, row + 1));
                }
                self.runs.push(Run {
                    row: y as u32,
                    start: (roi.x + start) as u32,
                    end: (roi.x + x) as u32,
                    parent: self.runs.len() as u32,
                    area: (x - start) as u32,
                    exposed: count(&|x| fates[x] == MOVED_EXPOSED),
                    contacts,
                });
            }
            if row > 0 {
                self.join(above, input.disparity.row(y - 1), input.disparity.row(y));
            }
            above = first..self.runs.len();
        }
    }

    /// Joins the runs of two rows that touch: those `above`, and those behind them.
    fn join(&mut self, above: std::ops::Range<usize>, upper: &[f32], lower: &[f32]) {
        let (mut a, mut b) = (above.start, above.end);
        while a < above.end && b < self.runs.len() {
            let (over, under) = (self.runs[a], self.runs[b]);
            let shared = over.start.max(under.start) as usize..over.end.min(under.end) as usize;
            let touches = !shared.is_empty()
                && upper[shared.clone()].iter().zip(&lower[shared]).any(|(a, b)| (a - b).abs() <= MAX_STEP_PX);
            if touches {
                let (a, b) = (self.root(a), self.root(b));
                if a != b {
                    let Run { area, exposed, contacts, .. } = self.runs[b];
                    self.runs[b].parent = a as u32;
                    let run = &mut self.runs[a];
                    (run.area, run.exposed, run.contacts) =
                        (run.area + area, run.exposed + exposed, run.contacts + contacts);
                }
            }
            if over.end <= under.end {
                a += 1;
            } else {
                b += 1;
            }
        }
    }

    /// The root of a run's region. Shortens the way there.
    fn root(&mut self, mut index: usize) -> usize {
        while self.runs[index].parent as usize != index {
            let next = self.runs[self.runs[index].parent as usize].parent;
            self.runs[index].parent = next;
            index = next as usize;
        }
        index
    }
}

/// Whether the right view has the same disparity, or, without it, whether the given confidence trusts it.
fn is_agreed(input: &FilterInput<'_>, params: &ConfidenceParams, (x, y): (usize, usize), d: f32) -> bool {
    if !is_seen_by_both(x, d, input.disparity.width) {
        return false;
    }
    let Some(right) = input.disparity_right else {
        return input.confidence.is_some_and(|map| map.row(y)[x] >= KEPT_CONFIDENCE);
    };
    let other = ((x as f32 - d).round().max(0.0) as usize).min(right.width - 1);
    (right.row(y)[other] - d).abs() <= params.left_right_px
}

/// Whether a pixel is neither black nor a highlight.
fn is_exposed(input: &FilterInput<'_>, params: &ConfidenceParams, (x, y): (usize, usize)) -> bool {
    let pixel = &input.guide.row(y)[x * input.guide.channels..(x + 1) * input.guide.channels];
    let is_dark = params.dark_level.is_some_and(|dark| pixel.iter().all(|value| *value <= dark));
    let is_bright = params.highlight_level.is_some_and(|bright| pixel.iter().all(|value| *value >= bright));
    !is_dark && !is_bright
}
