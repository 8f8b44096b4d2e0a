//! Semi-global matching at video rate.
//!
//! Matching costs are small windows of absolute differences of the clipped horizontal Sobel response;
//! they are summed along five paths (left, right, down, and the two downward diagonals) that charge
//! a small penalty for a step of one disparity and a large one for a jump (Hirschmueller, "Stereo
//! processing by semiglobal matching and mutual information", 2008). Everything happens row by row: no
//! cost volume is ever stored. Bands of rows run in parallel; each starts a few rows early so that the
//! downward paths have converged where its output starts. Edges are sharper than block matching's: a filter
//! that follows should judge scatter over 3 px, not 5.

use crate::stereo::StereoError;
use crate::stereo::block_matching_finish::Limits;
use crate::stereo::block_matching_kernel::pick_row;
use crate::stereo::matcher::{Job, Matcher, Method, Window};
use crate::stereo::matching::{Span, Target, WinnerRow, left_right_limit};
use crate::stereo::semi_global_kernel::{CostRow, MAX_LANES, Paths, Penalties, RIM, aggregate, cost_row, slot_bytes};

/// What semi-global matching searches, what it charges, and what it rejects.
#[derive(Clone, Debug, PartialEq)]
pub struct SemiGlobalParams {
    /// Smallest disparity searched, in px; may be negative.
    pub min_disparity_px: i32,
    /// Disparities searched from there on, 1 to 512, rounded up to a multiple of 32.
    pub search_px: usize,
    /// Side of the cost window in px: 3, 5 or 7.
    pub block_px: usize,
    /// Clip of the horizontal Sobel response that is compared, 1 to 31; 0 compares gray values.
    pub prefilter_cap: u8,
    /// Charge for a change of one disparity, 1 to 100, in units of a window's mean difference times four.
    pub small_penalty: u8,
    /// Charge for a larger change, above `small_penalty`, at most 120.
    pub large_penalty: u8,
    /// Whether diagonal paths are followed; without them it is faster and rougher.
    pub diagonals: bool,
    /// A pixel is rejected when a disparity not next to the best costs at most this much more, in per cent; 0 keeps all.
    pub uniqueness_percent: u32,
    /// Largest difference between the left pixel's disparity and that of the right pixel it points to; `None` keeps all.
    pub left_right_px: Option<u32>,
}

impl Default for SemiGlobalParams {
    fn default() -> Self {
        Self {
            min_disparity_px: 0,
            search_px: 64,
            block_px: 5,
            prefilter_cap: 31,
            small_penalty: 10,
            large_penalty: 100,
            diagonals: true,
            uniqueness_percent: 5,
            left_right_px: Some(1),
        }
    }
}

impl SemiGlobalParams {
    /// Names the first parameter that is out of range.
    ///
    /// # Errors
    /// [`StereoError::Parameter`].
    pub fn validate(&self) -> Result<(), StereoError> {
        let refuse = |name, value: String, accepted| Err(StereoError::Parameter { name, value, accepted });
        if self.search_px == 0 || self.search_px > MAX_LANES {
            return refuse("search_px", self.search_px.to_string(), "1 to 512");
        }
        if ![3, 5, 7].contains(&self.block_px) {
            return refuse("block_px", self.block_px.to_string(), "3, 5 or 7");
        }
        if self.prefilter_cap > 31 {
            return refuse("prefilter_cap", self.prefilter_cap.to_string(), "0 to 31");
        }
        if !(1..=100).contains(&self.small_penalty) {
            return refuse("small_penalty", self.small_penalty.to_string(), "1 to 100");
        }
        if self.large_penalty <= self.small_penalty || self.large_penalty > 120 {
            return refuse("large_penalty", self.large_penalty.to_string(), "above small_penalty, at most 120");
        }
        if self.min_disparity_px.unsigned_abs() > 1 << 20 {
            return refuse("min_disparity_px", self.min_disparity_px.to_string(), "-1048576 to 1048576");
        }
        Ok(())
    }

    /// Brings a window's sum (at most 62 per pixel) to about seven bits.
    fn shift(&self) -> i32 {
        match self.block_px {
            3 => 2,
            5 => 3,
            _ => 4,
        }
    }
}

/// Work memory of one band of rows.
#[derive(Debug, Default)]
pub struct Band {
    columns: Vec<u16>,
    cost: Vec<u8>,
    /// Path costs of the row above and of this row.
    before: Vec<u8>,
    after: Vec<u8>,
    min_before: Vec<u8>,
    min_after: Vec<u8>,
    sums: Vec<u16>,
    winners: WinnerRow,
}

/// Semi-global matcher.
pub type SemiGlobalMatcher = Matcher<SemiGlobalParams>;

impl Method for SemiGlobalParams {
    type Band = Band;

    /// Bands repeat their warm-up, so they must not be short.
    const BAND_ROWS: usize = 96;
    /// Paths that come down have converged after these rows.
    const WARM_UP_ROWS: usize = 24;
    const TILE_MARGIN_PX: usize = 24;

    fn check(&self) -> Result<(), StereoError> {
        self.validate()
    }

    fn window(&self) -> Window {
        let &Self { min_disparity_px, search_px, block_px, prefilter_cap, .. } = self;
        Window { min_disparity_px, search_px, block_px, prefilter_cap }
    }

    fn over(&self, first_px: i32, search_px: usize) -> Self {
        Self { min_disparity_px: first_px, search_px, ..self.clone() }
    }

    fn prepare(job: &Job<'_, Self>, band: &mut Band, first: usize) {
        let Span { count, lanes, radius, .. } = job.span;
        band.columns.clear();
        band.columns.resize((count + 2 * radius + 1) * lanes, 0);
        band.cost.resize(count * lanes, 0);
        band.sums.resize(count * lanes, 0);
        let slots = job.offsets().len() * (count + 2);
        let slot = slot_bytes(lanes);
        for plane in [&mut band.before, &mut band.after] {
            plane.clear();
            plane.resize(slots * slot, 0);
            for slot in plane.chunks_exact_mut(slot) {
                slot[..RIM].fill(255);
                slot[RIM + lanes..].fill(255);
            }
        }
        for plane in [&mut band.min_before, &mut band.min_after] {
            plane.clear();
            plane.resize(slots, 0);
        }
        band.winners.resize(&job.span);
        job.pair.add_window_above(&job.span, first, job.avx2, &mut band.columns);
    }

    fn step(job: &Job<'_, Self>, band: &mut Band, y: usize, target: Option<Target<'_>>) {
        job.aggregate(band, y);
        if let Some(target) = target {
            job.finish(band, target);
        }
    }
}

impl Job<'_, SemiGlobalParams> {
    /// Columns by which the paths that come down move in each row.
    fn offsets(&self) -> &'static [isize] {
        if self.params.diagonals { &[0, -1, 1] } else { &[0] }
    }

    /// Costs of row `y` and their sums over paths.
    fn aggregate(&self, band: &mut Band, y: usize) {
        let Span { count, lanes, radius, .. } = self.span;
        let (new_left, new_right) = self.pair.rows(&self.span, y as isize + radius as isize);
        let (old_left, old_right) = self.pair.rows(&self.span, y as isize - radius as isize - 1);
        let row = CostRow {
            lanes,
            count,
            radius,
            shift: self.params.shift(),
            new_left,
            new_right,
            old_left,
            old_right,
            outside: self.pair.outside(&self.span),
            columns: &mut band.columns,
            out: &mut band.cost,
        };
        cost_row(row, self.avx2);
        let penalties = Penalties { small: self.params.small_penalty, large: self.params.large_penalty };
        let paths = Paths {
            lanes,
            count,
            penalties,
            cost: &band.cost,
            offsets: self.offsets(),
            before: &band.before,
            after: &mut band.after,
            min_before: &band.min_before,
            min_after: &mut band.min_after,
            sums: &mut band.sums,
        };
        aggregate(paths, self.avx2);
        std::mem::swap(&mut band.before, &mut band.after);
        std::mem::swap(&mut band.min_before, &mut band.min_after);
    }

    /// Winners of the row aggregated last.
    fn finish(&self, band: &mut Band, target: Target<'_>) {
        let outside = self.pair.outside(&self.span);
        pick_row(band.winners.row(&self.span, outside, &mut band.sums, self.params.uniqueness_percent), self.avx2);
        let limits = Limits { texture_at_least: 0, left_right_at_most: left_right_limit(self.params.left_right_px) };
        band.winners.write(&self.span, outside, &band.sums, &limits, self.avx2, target);
    }
}
