//! Semi-global matching at video rate.
//!
//! Matching costs are small windows of absolute differences of the clipped horizontal Sobel response;
//! they are summed along five paths (left, right, down, and the two downward diagonals) that charge
//! a small penalty for a step of one disparity and a large one for a jump (Hirschmueller, "Stereo
//! processing by semiglobal matching and mutual information", 2008). Everything happens row by row: no
//! cost volume is ever stored. Bands of rows run in parallel; each begins a few rows early so that the
//! downward paths have settled where its output begins. Edges are sharper than block matching's: a filter
//! that follows should judge scatter over 3 px, not 5.

use crate::stereo::StereoError;
use crate::stereo::block_matching::{Span, fill_nan};
use crate::stereo::block_matching_finish::{self as finish, Limits, Winners};
use crate::stereo::block_matching_kernel::{Row, add_row, pick_row};
use crate::stereo::error::{check_channels, check_size};
use crate::stereo::prefilter::PaddedPlane;
use crate::stereo::semi_global_kernel::{CostRow, MAX_LANES, Paths, Penalties, RIM, aggregate, cost_row, slot_bytes};
use crate::{Parallel, Rect, SharedMut, Simd, View, ViewMut};

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

/// Rows that a band runs before its output begins.
const WARM_UP_ROWS: usize = 24;
/// Least rows of a band: bands repeat their warm-up, so they must not be short.
const BAND_ROWS: usize = 96;

#[derive(Debug, Default)]
struct Band {
    columns: Vec<u16>,
    cost: Vec<u8>,
    /// Path costs of the row above and of this row.
    before: Vec<u8>,
    after: Vec<u8>,
    least_before: Vec<u8>,
    least_after: Vec<u8>,
    sums: Vec<u16>,
    best_lane: Vec<u16>,
    best_cost: Vec<u16>,
    ambiguous: Vec<u16>,
    texture: Vec<u16>,
    right_best: Vec<u16>,
    right_cost: Vec<u16>,
    less: Vec<u16>,
    more: Vec<u16>,
    back: Vec<u16>,
}

/// Semi-global matcher with its work memory; nothing is allocated once the sizes have been seen.
#[derive(Debug)]
pub struct SemiGlobalMatcher {
    params: SemiGlobalParams,
    left: PaddedPlane,
    right: PaddedPlane,
    outside: Vec<u8>,
    bands: Vec<Band>,
    avx2: bool,
}

impl SemiGlobalMatcher {
    /// A matcher with the given parameters.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range.
    pub fn new(params: SemiGlobalParams) -> Result<Self, StereoError> {
        params.validate()?;
        let (left, right) = (PaddedPlane::default(), PaddedPlane::default());
        Ok(Self { params, left, right, outside: Vec::new(), bands: Vec::new(), avx2: Simd::detect().avx2() })
    }

    /// Takes the portable path even where AVX2 exists (tests compare the two).
    pub fn force_portable(&mut self) {
        self.avx2 = false;
    }

    /// The parameters in use.
    pub fn params(&self) -> &SemiGlobalParams {
        &self.params
    }

    /// Changes the parameters; memory is kept.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range; the old ones stay.
    pub fn set_params(&mut self, params: SemiGlobalParams) -> Result<(), StereoError> {
        params.validate()?;
        self.params = params;
        Ok(())
    }

    /// Matches the pixels of `roi` of a rectified gray pair; outputs as in
    /// [`crate::stereo::BlockMatcher::compute`].
    ///
    /// # Errors
    /// When sizes or channel counts do not agree, or the view is wider than 65,000 px.
    pub fn compute(
        &mut self,
        left: View<'_, u8>,
        right: View<'_, u8>,
        roi: Rect,
        pool: &dyn Parallel,
        mut disparity: ViewMut<'_, f32>,
        mut disparity_right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        let size = (left.width, left.height);
        check_channels("left view", &[1], "1 (gray)", left.channels)?;
        check_channels("right view", &[1], "1 (gray)", right.channels)?;
        check_channels("disparity", &[1], "1", disparity.channels)?;
        check_size("right view", size, (right.width, right.height))?;
        check_size("disparity", size, (disparity.width, disparity.height))?;
        if let Some(map) = &disparity_right {
            check_channels("right disparity", &[1], "1", map.channels)?;
            check_size("right disparity", size, (map.width, map.height))?;
        }
        if left.width > 65_000 {
            let (value, accepted) = (left.width.to_string(), "at most 65000 columns");
            return Err(StereoError::Parameter { name: "width", value, accepted });
        }
        fill_nan(&mut disparity, pool);
        if let Some(map) = &mut disparity_right {
            fill_nan(map, pool);
        }
        let roi = roi.clamped(left.width, left.height);
        let params = &self.params;
        let Some(span) = Span::new(roi, left.width, params.min_disparity_px, params.search_px, params.block_px / 2)
        else {
            return Ok(());
        };
        let pad = span.lanes + span.radius + 32;
        let above = span.radius + WARM_UP_ROWS;
        let rows = roi.y.saturating_sub(above)..(roi.y + roi.height + span.radius).min(left.height);
        self.left.fill(left, rows.clone(), params.prefilter_cap, pad, self.avx2, pool);
        self.right.fill(right, rows, params.prefilter_cap, pad, self.avx2, pool);
        self.outside.resize(left.width + 2 * pad, 0);
        self.outside.fill(255);
        self.outside[pad..pad + left.width].fill(0);

        let band_rows = roi.height.div_ceil(8).max(BAND_ROWS);
        let band_count = roi.height.div_ceil(band_rows);
        if self.bands.len() < band_count {
            self.bands.resize_with(band_count, Band::default);
        }
        let bands = SharedMut::new(&mut self.bands);
        let (stride, stride_right) = (disparity.stride, disparity_right.as_ref().map_or(0, |map| map.stride));
        let out = SharedMut::new(disparity.data);
        let out_right = disparity_right.map(|map| SharedMut::new(map.data));
        let job = Job {
            params: &self.params,
            left: &self.left,
            right: &self.right,
            outside: &self.outside,
            offsets: if self.params.diagonals { &[0, -1, 1] } else { &[0] },
            avx2: self.avx2,
            width: left.width,
            span,
        };
        pool.run(band_count, &|index| {
            let first = roi.y + index * band_rows;
            let last = (first + band_rows).min(roi.y + roi.height);
            // SAFETY: each band's memory and rows are used by one chunk only.
            let band = unsafe { &mut bands.part(index, 1)[0] };
            let start = first.saturating_sub(WARM_UP_ROWS);
            job.prepare(band, start);
            for y in start..last {
                job.aggregate(band, y);
                if y >= first {
                    // SAFETY: as above; the image checks cover `width` elements of each row.
                    let row = unsafe { out.part(y * stride, job.width) };
                    let row_right = out_right.as_ref().map(|map| {
                        // SAFETY: as above.
                        unsafe { map.part(y * stride_right, job.width) }
                    });
                    job.finish(band, row, row_right);
                }
            }
        });
        Ok(())
    }
}

/// What every row of one call shares.
struct Job<'a> {
    params: &'a SemiGlobalParams,
    left: &'a PaddedPlane,
    right: &'a PaddedPlane,
    outside: &'a [u8],
    offsets: &'a [isize],
    avx2: bool,
    width: usize,
    span: Span,
}

impl Job<'_> {
    /// Start of column 0 in a padded left row, and of lane 0 of column 0 in a padded right row.
    fn starts(&self) -> (usize, usize) {
        let Span { x0, radius, lanes, min, .. } = self.span;
        let left = self.left.pad + x0 - radius;
        (left, (left as i64 - i64::from(min) - lanes as i64 + 1) as usize)
    }

    fn prepare(&self, band: &mut Band, first: usize) {
        let Span { count, lanes, radius, .. } = self.span;
        band.columns.clear();
        band.columns.resize((count + 2 * radius + 1) * lanes, 0);
        band.cost.resize(count * lanes, 0);
        band.sums.resize(count * lanes, 0);
        let slots = self.offsets.len() * (count + 2);
        let slot = slot_bytes(lanes);
        for plane in [&mut band.before, &mut band.after] {
            plane.clear();
            plane.resize(slots * slot, 0);
            for slot in plane.chunks_exact_mut(slot) {
                slot[..RIM].fill(255);
                slot[RIM + lanes..].fill(255);
            }
        }
        for plane in [&mut band.least_before, &mut band.least_after] {
            plane.clear();
            plane.resize(slots, 0);
        }
        for row in [&mut band.best_lane, &mut band.best_cost, &mut band.ambiguous, &mut band.texture] {
            row.resize(count, 0);
        }
        for row in [&mut band.right_best, &mut band.right_cost, &mut band.less, &mut band.more, &mut band.back] {
            row.resize(count + lanes, 0);
        }
        let (start_left, start_right) = self.starts();
        for step in 0..2 * radius + 1 {
            let y = first as isize - radius as isize - 1 + step as isize;
            let (left, right) = (&self.left.row(y)[start_left..], &self.right.row(y)[start_right..]);
            add_row(left, right, lanes, self.avx2, &mut band.columns);
        }
    }

    /// Costs of row `y` and their sums over paths.
    fn aggregate(&self, band: &mut Band, y: usize) {
        let Span { count, lanes, radius, .. } = self.span;
        let (start_left, start_right) = self.starts();
        let new = y as isize + radius as isize;
        let old = y as isize - radius as isize - 1;
        let row = CostRow {
            lanes,
            count,
            radius,
            shift: self.params.shift(),
            new_left: &self.left.row(new)[start_left..],
            new_right: &self.right.row(new)[start_right..],
            old_left: &self.left.row(old)[start_left..],
            old_right: &self.right.row(old)[start_right..],
            outside: &self.outside[start_right + radius..],
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
            offsets: self.offsets,
            before: &band.before,
            after: &mut band.after,
            least_before: &band.least_before,
            least_after: &mut band.least_after,
            sums: &mut band.sums,
        };
        aggregate(paths, self.avx2);
        std::mem::swap(&mut band.before, &mut band.after);
        std::mem::swap(&mut band.least_before, &mut band.least_after);
    }

    /// Winners of the row aggregated last.
    fn finish(&self, band: &mut Band, out: &mut [f32], out_right: Option<&mut [f32]>) {
        let Span { x0, count, lanes, radius, min, ref inside } = self.span;
        let start_outside = self.starts().1 + radius;
        let row = Row {
            lanes,
            count,
            radius: 0,
            new_left: &[],
            new_right: &[],
            old_left: &[],
            old_right: &[],
            outside: &self.outside[start_outside..],
            inside: inside.clone(),
            columns: &mut [],
            cost: &mut band.sums,
            best_lane: &mut band.best_lane,
            best_cost: &mut band.best_cost,
            less: &mut band.less,
            more: &mut band.more,
            ambiguous: &mut band.ambiguous,
            right_best: &mut band.right_best,
            right_cost: &mut band.right_cost,
            uniqueness_percent: self.params.uniqueness_percent,
        };
        pick_row(row, self.avx2);
        let mut winners = Winners {
            lanes,
            count,
            interleaved: self.avx2,
            cost: &band.sums,
            best_lane: &band.best_lane,
            best_cost: &band.best_cost,
            ambiguous: &band.ambiguous,
            texture: &band.texture,
            right_best: &band.right_best,
            right_cost: &band.right_cost,
            less: &mut band.less,
            more: &mut band.more,
            back: &mut band.back,
            inside: inside.clone(),
            outside: &self.outside[start_outside..],
        };
        let left_right_at_most = self.params.left_right_px.map_or(u16::MAX, |px| px.min(u32::from(u16::MAX)) as u16);
        let limits = Limits { texture_at_least: 0, left_right_at_most };
        finish::left(&mut winners, &limits, min, self.avx2, &mut out[x0..x0 + count]);
        if let Some(out_right) = out_right {
            finish::right_within(&mut winners, x0, self.width, min, self.avx2, out_right);
        }
    }
}
