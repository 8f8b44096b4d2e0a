//! Block matching: sums of absolute differences over a square window, winner takes all, for the
//! left and the right view in one pass.
//!
//! The costs are computed once per (left pixel, disparity); the right view's winners are the minima
//! along the diagonals of the same cost table, so the second map costs a few instructions per vector.
//! Sub-pixel positions come from an equiangular fit (two lines of equal slope), the shape a sum of
//! absolute differences has around its minimum.

use crate::stereo::StereoError;
use crate::stereo::block_matching_finish::Limits;
use crate::stereo::block_matching_kernel::{MAX_LANES, Row, match_row};
use crate::stereo::matcher::{Job, Matcher, Method, Window};
use crate::stereo::matching::{Span, Target, WinnerRow, left_right_limit, window_above};
use crate::stereo::prefilter::MAX_VALUE;

/// Columns beyond each side of a tile that are matched with it.
pub const TILE_MARGIN_PX: usize = 8;

/// What block matching searches and what it rejects.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockMatchingParams {
    /// Smallest disparity searched, in px; may be negative.
    pub min_disparity_px: i32,
    /// Disparities searched from there on, 1 to 512, rounded up to a multiple of 32.
    pub search_px: usize,
    /// Side of the square window, in px, odd, 3 to 31.
    pub block_px: usize,
    /// Clip of the horizontal Sobel response that is compared, 1 to 31; 0 compares gray values
    /// (sensitive to exposure differences between the views).
    pub prefilter_cap: u8,
    /// Windows whose summed absolute response is smaller are not matched; 0 keeps all.
    pub texture_threshold: u32,
    /// A pixel is rejected when a disparity not next to the best costs at most this much more, in per cent; 0 keeps all.
    pub uniqueness_percent: u32,
    /// Largest difference between the left pixel's disparity and that of the right pixel it points to; `None` keeps all.
    pub left_right_px: Option<u32>,
}

impl Default for BlockMatchingParams {
    fn default() -> Self {
        Self {
            min_disparity_px: 0,
            search_px: 64,
            block_px: 15,
            prefilter_cap: 31,
            texture_threshold: 10,
            uniqueness_percent: 15,
            left_right_px: Some(1),
        }
    }
}

impl BlockMatchingParams {
    /// Names the first parameter that is out of range.
    ///
    /// # Errors
    /// [`StereoError::Parameter`].
    pub fn validate(&self) -> Result<(), StereoError> {
        let refuse = |name, value: String, accepted| Err(StereoError::Parameter { name, value, accepted });
        if self.search_px == 0 || self.search_px > MAX_LANES {
            return refuse("search_px", self.search_px.to_string(), "1 to 512");
        }
        if self.block_px.is_multiple_of(2) || !(3..=31).contains(&self.block_px) {
            return refuse("block_px", self.block_px.to_string(), "an odd number from 3 to 31");
        }
        if self.prefilter_cap > MAX_VALUE / 2 {
            return refuse("prefilter_cap", self.prefilter_cap.to_string(), "0 to 31");
        }
        if self.min_disparity_px.unsigned_abs() > 1 << 20 {
            return refuse("min_disparity_px", self.min_disparity_px.to_string(), "-1048576 to 1048576");
        }
        Ok(())
    }
}

/// Work memory of one band of rows.
#[derive(Debug, Default)]
pub struct Band {
    columns: Vec<u16>,
    cost: Vec<u16>,
    winners: WinnerRow,
    texture_columns: Vec<u16>,
}

/// Block matcher.
pub type BlockMatcher = Matcher<BlockMatchingParams>;

impl Method for BlockMatchingParams {
    type Band = Band;

    const BAND_ROWS: usize = 32;
    const WARM_UP_ROWS: usize = 0;
    const TILE_MARGIN_PX: usize = TILE_MARGIN_PX;

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

    /// Sums of the window above the first row, so that every row is one step down.
    fn prepare(job: &Job<'_, Self>, band: &mut Band, first: usize) {
        let Span { count, lanes, radius, .. } = job.span;
        let steps = count + 2 * radius;
        band.columns.clear();
        band.columns.resize((steps + 1) * lanes, 0);
        band.cost.resize(count * lanes, 0);
        band.winners.resize(&job.span);
        job.pair.add_window_above(&job.span, first, job.avx2, &mut band.columns);
        band.texture_columns.clear();
        band.texture_columns.resize(steps, 0);
        for y in window_above(&job.span, first) {
            for (sum, value) in band.texture_columns.iter_mut().zip(job.pair.rows(&job.span, y).0) {
                *sum += u16::from(value.abs_diff(job.params.prefilter_cap));
            }
        }
    }

    fn step(job: &Job<'_, Self>, band: &mut Band, y: usize, target: Option<Target<'_>>) {
        let radius = job.span.radius;
        let (new_left, new_right) = job.pair.rows(&job.span, y as isize + radius as isize);
        let (old_left, old_right) = job.pair.rows(&job.span, y as isize - radius as isize - 1);
        let outside = job.pair.outside(&job.span);
        let row = band.winners.row(&job.span, outside, &mut band.cost, job.params.uniqueness_percent);
        let columns = &mut band.columns;
        match_row(Row { radius, new_left, new_right, old_left, old_right, columns, ..row }, job.avx2);
        job.texture(band, new_left, old_left);
        let limits = Limits {
            texture_at_least: job.params.texture_threshold.min(u32::from(u16::MAX)) as u16,
            left_right_at_most: left_right_limit(job.params.left_right_px),
        };
        let Some(target) = target else { return };
        band.winners.write(&job.span, outside, &band.cost, &limits, job.avx2, target);
    }
}

impl Job<'_, BlockMatchingParams> {
    /// Moves the texture sums down one row and along it.
    fn texture(&self, band: &mut Band, new_left: &[u8], old_left: &[u8]) {
        let cap = self.params.prefilter_cap;
        if self.params.texture_threshold == 0 {
            return;
        }
        for ((sum, entering), leaving) in band.texture_columns.iter_mut().zip(new_left).zip(old_left) {
            *sum = *sum + u16::from(entering.abs_diff(cap)) - u16::from(leaving.abs_diff(cap));
        }
        let window = 2 * self.span.radius + 1;
        let mut total: u16 = band.texture_columns[..window - 1].iter().sum();
        for (i, out) in band.winners.texture.iter_mut().enumerate() {
            total += band.texture_columns[i + window - 1];
            *out = total;
            total -= band.texture_columns[i];
        }
    }
}
