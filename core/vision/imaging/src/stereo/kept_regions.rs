//! Gives back what a filter has removed or moved although the match has it right in both views.
//!
//! A filter distrusts disparities near steps of depth, where matches reach over the edge, and takes the values of what lies around. Where an object
//! is as narrow as that, such as a wire or the tip of an instrument, nothing of it is left. What both views agree on over an area, with no more of
//! the same surface beside it than its edge would have, is an object and keeps its disparities.

use crate::simd::dispatch;
use crate::stereo::confidence::ConfidenceParams;
use crate::stereo::filter_input::FilterInput;
use crate::stereo::runs::{Runs, Tally};
use crate::stereo::shared_field::is_seen_by_both;
use crate::{Parallel, Rect, SharedMut, Simd, ViewMut};

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

/// Counts of a region.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    /// Pixels that are well exposed.
    exposed: u32,
    /// Edges between the region's pixels and pixels of the same surface that the filter has kept.
    contacts: u32,
}

impl Tally for Counts {
    fn add(&mut self, other: Self) {
        self.exposed += other.exposed;
        self.contacts += other.contacts;
    }
}

/// Finds and gives back regions; keeps its memory.
#[derive(Debug, Default)]
pub(crate) struct KeptRegions {
    /// What became of each pixel of the ROI.
    fates: Vec<u8>,
    /// Whether any of [`GRAIN_PX`] pixels of a row has moved.
    moved_grains: Vec<bool>,
    runs: Runs<Counts>,
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
        let min_area = MIN_SQUARES * (params.scatter_radius_px + EDGE_PX).pow(2);
        let mut confidence = confidence;
        let mut restored = 0;
        for index in 0..self.runs.len() {
            let root = self.runs.root(index);
            let region = self.runs.get(root);
            let Counts { exposed, contacts } = region.tally;
            let is_object = region.area() >= min_area
                && region.area() > contacts as usize * edge_px
                && 2 * exposed as usize > region.area();
            if is_object {
                let run = self.runs.get(index);
                let (y, columns) = (run.row(), run.columns());
                filtered.row_mut(y)[columns.clone()].copy_from_slice(&input.disparity.row(y)[columns.clone()]);
                if let Some(map) = &mut confidence {
                    map.row_mut(y)[columns.clone()].iter_mut().for_each(|value| *value = value.max(KEPT_CONFIDENCE));
                }
                restored += columns.len();
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
        let per_row = roi.width.div_ceil(GRAIN_PX);
        self.moved_grains.resize(roi.height * per_row, false);
        let (fates, grains) = (SharedMut::new(&mut self.fates), SharedMut::new(&mut self.moved_grains));
        let (out, simd) = (filtered.as_view(), Simd::detect());
        pool.run(roi.height.div_ceil(ROWS), &|chunk| {
            for row in chunk * ROWS..((chunk + 1) * ROWS).min(roi.height) {
                // SAFETY: one row, one chunk.
                let fates = unsafe { fates.part(row * roi.width, roi.width) };
                fates.fill(STAYS);
                let y = roi.y + row;
                let columns = roi.x..roi.x + roi.width;
                let (here, smooth) = (&input.disparity.row(y)[columns.clone()], &out.row(y)[columns]);
                // SAFETY: one row, one chunk.
                let grains = unsafe { grains.part(row * per_row, per_row) };
                let limit_px = params.left_right_px;
                dispatch!(simd, find_moved_grains(here: &[f32], smooth: &[f32], limit_px: f32, grains: &mut [bool]));
                for grain in (0..per_row).filter(|grain| grains[*grain]) {
                    let start = grain * GRAIN_PX;
                    for at in start..(start + GRAIN_PX).min(roi.width) {
                        let d = here[at];
                        if is_moved(d, smooth[at], limit_px) && is_agreed(input, params, (roi.x + at, y), d) {
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
        let per_row = roi.width.div_ceil(GRAIN_PX);
        for row in 0..roi.height {
            let y = roi.y + row;
            let fates = &self.fates[row * roi.width..(row + 1) * roi.width];
            let here = &input.disparity.row(y)[roi.x..roi.x + roi.width];
            let grains = &self.moved_grains[row * per_row..(row + 1) * per_row];
            // Most rows have none.
            let mut x = grains.iter().position(|is_moved| *is_moved).map_or(roi.width, |grain| grain * GRAIN_PX);
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
                let exposed = count(&|x| fates[x] == MOVED_EXPOSED);
                self.runs.push(y, roi.x + start..roi.x + x, Counts { exposed, contacts });
            }
            // The first row of the ROI has no runs above.
            let (upper, lower) = (input.disparity.row(y.saturating_sub(1)), input.disparity.row(y));
            self.runs.end_row(|shared| {
                upper[shared.clone()].iter().zip(&lower[shared]).any(|(a, b)| (a - b).abs() <= MAX_STEP_PX)
            });
        }
    }
}

/// Whether a filter has moved or removed a known disparity; NaN is not near.
#[inline(always)]
fn is_moved(d: f32, smooth: f32, limit_px: f32) -> bool {
    let is_near = (d - smooth).abs() <= limit_px;
    d.is_finite() & !is_near
}

/// Marks the grains of a row in which a disparity has moved.
#[inline(always)]
fn find_moved_grains(here: &[f32], smooth: &[f32], limit_px: f32, grains: &mut [bool]) {
    for ((d, smooth), grain) in here.chunks(GRAIN_PX).zip(smooth.chunks(GRAIN_PX)).zip(grains) {
        // All of them, so that the compiler can vectorise the loop.
        *grain = d.iter().zip(smooth).fold(false, |any, (d, smooth)| any | is_moved(*d, *smooth, limit_px));
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
