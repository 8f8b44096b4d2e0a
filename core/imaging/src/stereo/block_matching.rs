//! Block matching: sums of absolute differences over a square window, winner takes all, for the
//! left and the right view in one pass.
//!
//! The costs are computed once per (left pixel, disparity); the right view's winners are the minima
//! along the diagonals of the same cost table, so the second map costs a few instructions per vector.
//! Sub-pixel positions come from an equiangular fit (two lines of equal slope), the shape a sum of
//! absolute differences has around its minimum.

use crate::stereo::StereoError;
use crate::stereo::block_matching_finish::{self as finish, Limits, Winners};
use crate::stereo::block_matching_kernel::{MAX_LANES, Row, add_row, match_row};
use crate::stereo::error::{check_channels, check_size};
use crate::stereo::prefilter::{MAX_VALUE, PaddedPlane};
use crate::{Parallel, Rect, SharedMut, Simd, View, ViewMut};

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
struct Band {
    columns: Vec<u16>,
    cost: Vec<u16>,
    best_lane: Vec<u16>,
    best_cost: Vec<u16>,
    ambiguous: Vec<u16>,
    right_best: Vec<u16>,
    right_cost: Vec<u16>,
    texture_columns: Vec<u16>,
    texture: Vec<u16>,
    less: Vec<u16>,
    more: Vec<u16>,
    back: Vec<u16>,
}

/// Left columns and geometry shared by all rows of one call.
pub(crate) struct Span {
    pub x0: usize,
    pub count: usize,
    pub lanes: usize,
    pub radius: usize,
    pub min: i32,
    /// Output pixels whose every lane lies inside the right view.
    pub inside: std::ops::Range<usize>,
}

impl Span {
    /// The left columns of `roi` that can see a right view of `width` columns at all.
    pub(crate) fn new(roi: Rect, width: usize, min: i32, search_px: usize, radius: usize) -> Option<Self> {
        if roi.is_empty() {
            return None;
        }
        let lanes = search_px.next_multiple_of(32);
        let x0 = roi.x.max(min.max(0) as usize);
        // The right pixel of the largest disparity must not lie past the right edge.
        let end = (width as i64 + i64::from(min) + lanes as i64 - 1).clamp(0, (roi.x + roi.width) as i64) as usize;
        if x0 >= end {
            return None;
        }
        // From `first` on the largest disparity is inside; up to `last` the smallest is.
        let first = (i64::from(min) + lanes as i64 - 1 - x0 as i64).max(0) as usize;
        let last = (width as i64 + i64::from(min) - x0 as i64).max(0) as usize;
        Some(Self { x0, count: end - x0, lanes, radius, min, inside: first..last })
    }
}

/// Block matcher with its work memory; nothing is allocated once the sizes have been seen.
#[derive(Debug)]
pub struct BlockMatcher {
    params: BlockMatchingParams,
    left: PaddedPlane,
    right: PaddedPlane,
    outside: Vec<u8>,
    bands: Vec<Band>,
    avx2: bool,
}

impl BlockMatcher {
    /// A matcher with the given parameters.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range.
    pub fn new(params: BlockMatchingParams) -> Result<Self, StereoError> {
        params.validate()?;
        let (left, right) = (PaddedPlane::default(), PaddedPlane::default());
        Ok(Self { params, left, right, outside: Vec::new(), bands: Vec::new(), avx2: Simd::detect().avx2() })
    }

    /// Takes the portable path even where AVX2 exists (tests compare the two).
    pub fn force_portable(&mut self) {
        self.avx2 = false;
    }

    /// The parameters in use.
    pub fn params(&self) -> &BlockMatchingParams {
        &self.params
    }

    /// Changes the parameters; memory is kept.
    ///
    /// # Errors
    /// [`StereoError::Parameter`] when one is out of range; the old ones stay.
    pub fn set_params(&mut self, params: BlockMatchingParams) -> Result<(), StereoError> {
        params.validate()?;
        self.params = params;
        Ok(())
    }

    /// Matches the pixels of `roi` of a rectified gray pair.
    ///
    /// `disparity` receives px of the left view, NaN where unmatched or outside `roi`.
    /// `disparity_right`, when asked for, receives each right pixel's best match among the left pixels
    /// of `roi`, unchecked, as positive px (`x_left = x_right + disparity`), NaN where there was none.
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
        let roi = roi.clamped(left.width, left.height);
        let Some(span) =
            Span::new(roi, left.width, self.params.min_disparity_px, self.params.search_px, self.params.block_px / 2)
        else {
            fill_nan(&mut disparity, pool);
            if let Some(map) = &mut disparity_right {
                fill_nan(map, pool);
            }
            return Ok(());
        };
        // Rows of the region are written whole as they are matched.
        let others = || (0..roi.y).chain(roi.y + roi.height..left.height);
        others().for_each(|y| disparity.row_mut(y).fill(f32::NAN));
        if let Some(map) = &mut disparity_right {
            others().for_each(|y| map.row_mut(y).fill(f32::NAN));
        }

        let radius = span.radius;
        let pad = span.lanes + radius + 32;
        let rows = roi.y.saturating_sub(radius)..(roi.y + roi.height + radius).min(left.height);
        self.left.fill(left, rows.clone(), self.params.prefilter_cap, pad, self.avx2, pool);
        self.right.fill(right, rows, self.params.prefilter_cap, pad, self.avx2, pool);
        self.outside.resize(left.width + 2 * pad, 0);
        self.outside.fill(255);
        self.outside[pad..pad + left.width].fill(0);

        // At most eight bands, so that the rows read twice (the first window of a band) stay few.
        let band_rows = roi.height.div_ceil(8).max(32);
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
            avx2: self.avx2,
            width: left.width,
            span,
        };
        pool.run(band_count, &|index| {
            let first = roi.y + index * band_rows;
            let last = (first + band_rows).min(roi.y + roi.height);
            // SAFETY: each band's memory and rows are used by one chunk only.
            let band = unsafe { &mut bands.part(index, 1)[0] };
            job.prepare(band, first);
            for y in first..last {
                // SAFETY: as above; the image checks cover `width` elements of each row.
                let row = unsafe { out.part(y * stride, job.width) };
                let row_right = out_right.as_ref().map(|map| {
                    // SAFETY: as above.
                    unsafe { map.part(y * stride_right, job.width) }
                });
                job.row(band, y, row, row_right);
            }
        });
        Ok(())
    }
}

/// What every row of one call shares.
struct Job<'a> {
    params: &'a BlockMatchingParams,
    left: &'a PaddedPlane,
    right: &'a PaddedPlane,
    outside: &'a [u8],
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

    /// Sums of the window above the first row, so that every row is one step down.
    fn prepare(&self, band: &mut Band, first: usize) {
        let Span { count, lanes, radius, .. } = self.span;
        let steps = count + 2 * radius;
        band.columns.clear();
        band.columns.resize((steps + 1) * lanes, 0);
        band.cost.resize(count * lanes, 0);
        band.best_lane.resize(count, 0);
        for row in [&mut band.best_cost, &mut band.ambiguous, &mut band.texture] {
            row.resize(count, 0);
        }
        for row in [&mut band.less, &mut band.more, &mut band.back] {
            row.resize(count + lanes, 0);
        }
        band.right_best.resize(count + lanes, 0);
        band.right_cost.resize(count + lanes, 0);
        band.texture_columns.clear();
        band.texture_columns.resize(steps, 0);
        let (start_left, start_right) = self.starts();
        for step in 0..2 * radius + 1 {
            let y = first as isize - radius as isize - 1 + step as isize;
            let left = &self.left.row(y)[start_left..];
            add_row(left, &self.right.row(y)[start_right..], lanes, self.avx2, &mut band.columns);
            for (sum, value) in band.texture_columns.iter_mut().zip(left) {
                *sum += u16::from(value.abs_diff(self.params.prefilter_cap));
            }
        }
    }

    fn row(&self, band: &mut Band, y: usize, out: &mut [f32], out_right: Option<&mut [f32]>) {
        let Span { x0, count, lanes, radius, min, ref inside } = self.span;
        let (start_left, start_right) = self.starts();
        let new = y as isize + radius as isize;
        let old = y as isize - radius as isize - 1;
        let new_left = &self.left.row(new)[start_left..];
        let old_left = &self.left.row(old)[start_left..];
        let start_outside = start_right + radius;
        match_row(
            Row {
                lanes,
                count,
                radius,
                new_left,
                new_right: &self.right.row(new)[start_right..],
                old_left,
                old_right: &self.right.row(old)[start_right..],
                outside: &self.outside[start_outside..],
                inside: inside.clone(),
                columns: &mut band.columns,
                cost: &mut band.cost,
                best_lane: &mut band.best_lane,
                best_cost: &mut band.best_cost,
                less: &mut band.less,
                more: &mut band.more,
                ambiguous: &mut band.ambiguous,
                right_best: &mut band.right_best,
                right_cost: &mut band.right_cost,
                uniqueness_percent: self.params.uniqueness_percent,
            },
            self.avx2,
        );

        self.texture(band, new_left, old_left);
        let mut winners = Winners {
            lanes,
            count,
            interleaved: self.avx2,
            cost: &band.cost,
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
        let limits = Limits {
            texture_at_least: self.params.texture_threshold.min(u32::from(u16::MAX)) as u16,
            left_right_at_most: self.params.left_right_px.map_or(u16::MAX, |px| px.min(u32::from(u16::MAX)) as u16),
        };
        out[..x0].fill(f32::NAN);
        out[x0 + count..].fill(f32::NAN);
        finish::left(&mut winners, &limits, min, self.avx2, &mut out[x0..x0 + count]);
        let Some(out_right) = out_right else { return };
        out_right.fill(f32::NAN);
        finish::right_within(&mut winners, x0, self.width, min, self.avx2, out_right);
    }

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
        for (i, out) in band.texture.iter_mut().enumerate() {
            total += band.texture_columns[i + window - 1];
            *out = total;
            total -= band.texture_columns[i];
        }
    }
}

/// Writes NaN everywhere, in parallel.
pub(crate) fn fill_nan(map: &mut ViewMut<'_, f32>, pool: &dyn Parallel) {
    let (stride, width, height) = (map.stride, map.width, map.height);
    if width == 0 || height == 0 {
        return;
    }
    let data = SharedMut::new(map.data);
    pool.run(height.div_ceil(64), &|chunk| {
        for y in chunk * 64..(chunk * 64 + 64).min(height) {
            // SAFETY: each row belongs to one chunk.
            unsafe { data.part(y * stride, width) }.fill(f32::NAN);
        }
    });
}
