//! Gives back what a filter has removed or moved although the match has it right in both views.
//!
//! A filter distrusts disparities near steps of depth, where matches reach over the edge, and takes the values of what lies around. Where an object
//! is as narrow as that, such as a wire or the tip of an instrument, nothing of it is left. What both views agree on over an area, with no more of
//! the same surface beside it than its edge would have, is an object and keeps its disparities.

use std::ops::Range;

use crate::simd::dispatch;
use crate::stereo::confidence::ConfidenceParams;
use crate::stereo::filter_input::FilterInput;
use crate::stereo::runs::{Runs, Tally};
use crate::stereo::shared_field::is_seen_by_both;
use crate::{Parallel, Rect, SharedMut, Simd, ViewMut};

/// Smallest area of a region, in squares of the radius of the scatter and [`EDGE_PX`]: wrong matches are about as large as a matcher's window.
const MIN_SQUARES: usize = 9;
/// Matches reach over edges by so much more than the radius of their scatter, px.
pub const EDGE_PX: usize = 2;
/// Largest step of disparity inside a region, px.
pub const MAX_STEP_PX: f32 = 1.0;
/// Confidence of a disparity that is given back; what a filter makes of it says nothing.
pub const KEPT_CONFIDENCE: f32 = 0.5;
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

/// A pixel that a filter has moved or removed although the match has it right in both views.
#[derive(Clone, Copy, Debug)]
pub struct MovedPixel {
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// Whether it is neither black nor saturated.
    pub is_exposed: bool,
    /// How many of its four neighbours are of the same surface and were kept by the filter.
    pub contacts: u32,
    /// Whether its disparity continues that of the left neighbour.
    pub joins_left: bool,
    /// Whether its disparity continues that of the upper neighbour.
    pub joins_above: bool,
}

/// Joins moved pixels into regions and tells objects from edges. Reuses its memory.
#[derive(Debug, Default)]
pub struct MovedRegions {
    runs: Runs<Counts>,
    /// Columns of the present row that continue the row above.
    joined: Vec<usize>,
}

impl MovedRegions {
    /// Takes the pixels of a map: row after row, from left to right.
    pub fn join(&mut self, moved: impl Iterator<Item = MovedPixel>) {
        self.runs.clear();
        self.joined.clear();
        let mut open: Option<(usize, Range<usize>, Counts)> = None;
        for pixel in moved {
            let counts = Counts { exposed: pixel.is_exposed.into(), contacts: pixel.contacts };
            match &mut open {
                Some((row, columns, all)) if pixel.joins_left && (*row, columns.end) == (pixel.y, pixel.x) => {
                    columns.end += 1;
                    all.add(counts);
                }
                _ => {
                    if let Some((row, columns, all)) = open.replace((pixel.y, pixel.x..pixel.x + 1, counts)) {
                        self.runs.push(row, columns, all);
                        if row < pixel.y {
                            self.end_row();
                        }
                        if row + 1 < pixel.y {
                            self.end_row();
                        }
                    }
                }
            }
            if pixel.joins_above {
                self.joined.push(pixel.x);
            }
        }
        if let Some((row, columns, all)) = open {
            self.runs.push(row, columns, all);
            self.end_row();
        }
    }

    fn end_row(&mut self) {
        let joined = &self.joined;
        self.runs.end_row(|shared| {
            let first = joined.partition_point(|x| *x < shared.start);
            joined.get(first).is_some_and(|x| *x < shared.end)
        });
        self.joined.clear();
    }

    /// Calls `keep` with row and columns of each run of pixels of an object. `edge_px` is how far from steps of depth the filter changes disparities by right.
    pub fn objects(&mut self, params: &ConfidenceParams, edge_px: usize, mut keep: impl FnMut(usize, Range<usize>)) {
        let min_area = MIN_SQUARES * (params.scatter_radius_px + EDGE_PX).pow(2);
        for index in 0..self.runs.len() {
            let root = self.runs.root(index);
            let region = self.runs.get(root);
            let Counts { exposed, contacts } = region.tally;
            let is_object = region.area() >= min_area
                && region.area() > contacts as usize * edge_px
                && 2 * exposed as usize > region.area();
            if is_object {
                let run = self.runs.get(index);
                keep(run.row(), run.columns());
            }
        }
    }
}

/// Finds and gives back regions; keeps its memory.
#[derive(Debug, Default)]
pub(crate) struct KeptRegions {
    /// What became of each pixel of the ROI.
    fates: Vec<u8>,
    /// Whether any of [`GRAIN_PX`] pixels of a row has moved.
    moved_grains: Vec<bool>,
    regions: MovedRegions,
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
        self.find_regions(input, roi, filtered, params.left_right_px);
        let mut confidence = confidence;
        let mut restored = 0;
        self.regions.objects(params, edge_px, |y, columns| {
            filtered.row_mut(y)[columns.clone()].copy_from_slice(&input.disparity.row(y)[columns.clone()]);
            if let Some(map) = &mut confidence {
                map.row_mut(y)[columns.clone()].iter_mut().for_each(|value| *value = value.max(KEPT_CONFIDENCE));
            }
            restored += columns.len();
        });
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
    fn find_regions(&mut self, input: &FilterInput<'_>, roi: Rect, filtered: &ViewMut<'_, f32>, limit_px: f32) {
        let (Self { fates, moved_grains, regions }, out) = (self, filtered.as_view());
        let per_row = roi.width.div_ceil(GRAIN_PX);
        let at = |x: usize, row: usize| (input.disparity.row(roi.y + row)[roi.x + x], out.row(roi.y + row)[roi.x + x]);
        let moved = (0..roi.height).flat_map(|row| {
            let grains = &moved_grains[row * per_row..(row + 1) * per_row];
            // Most rows have none.
            let columns = grains.iter().enumerate().filter(|(_, is_moved)| **is_moved);
            let columns = columns.flat_map(|(grain, _)| grain * GRAIN_PX..((grain + 1) * GRAIN_PX).min(roi.width));
            columns.map(move |x| (x, row))
        });
        let moved = moved.filter(|(x, row)| fates[row * roi.width + x] != STAYS).map(|(x, row)| {
            let (d, _) = at(x, row);
            // Of the same surface, and where it was.
            let is_kept = |x: usize, row: usize| {
                let (other, smooth) = at(x, row);
                fates[row * roi.width + x] == STAYS
                    && (d - other).abs() <= MAX_STEP_PX
                    && (other - smooth).abs() <= limit_px
            };
            let contacts = [
                x > 0 && is_kept(x - 1, row),
                x + 1 < roi.width && is_kept(x + 1, row),
                row > 0 && is_kept(x, row - 1),
                row + 1 < roi.height && is_kept(x, row + 1),
            ];
            MovedPixel {
                x: roi.x + x,
                y: roi.y + row,
                is_exposed: fates[row * roi.width + x] == MOVED_EXPOSED,
                contacts: contacts.map(u32::from).iter().sum(),
                joins_left: x > 0 && (d - at(x - 1, row).0).abs() <= MAX_STEP_PX,
                joins_above: row > 0 && (d - at(x, row - 1).0).abs() <= MAX_STEP_PX,
            }
        });
        regions.join(moved);
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
