//! What block matching and semi-global matching share: checked sizes, prefiltered planes, bands of rows, the winners of a row.

use std::ops::Range;

use super::StereoError;
use super::block_matching_finish::{self as finish, Limits, Winners};
use super::block_matching_kernel::{Row, add_row};
use super::error::{check_channels, check_size};
use super::prefilter::PaddedPlane;
use crate::{Parallel, Rect, SharedMut, View, ViewMut};

/// Left columns and geometry shared by all rows of one call.
#[derive(Clone, Debug)]
pub struct Span {
    /// First left column that is matched.
    pub x0: usize,
    /// Left columns that are matched.
    pub count: usize,
    /// Disparities that are searched: whole blocks of 32.
    pub lanes: usize,
    /// Radius of the window, px.
    pub radius: usize,
    /// Smallest disparity, px.
    pub min: i32,
    /// Output pixels whose every lane lies inside the right view.
    pub inside: Range<usize>,
}

impl Span {
    /// The left columns of `roi` whose search overlaps a right view of `width` columns.
    pub fn new(roi: Rect, width: usize, min: i32, search_px: usize, radius: usize) -> Option<Self> {
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

/// The maps that a matcher fills: the left view's disparity, and the right view's if wanted.
pub(super) struct Maps<'a> {
    pub left: ViewMut<'a, f32>,
    pub right: Option<ViewMut<'a, f32>>,
}

impl Maps<'_> {
    /// # Errors
    /// When sizes or channel counts of views and maps do not agree, or the views are wider than 65,000 px.
    pub fn check(&self, left: View<'_, u8>, right: View<'_, u8>) -> Result<(), StereoError> {
        let size = (left.width, left.height);
        check_channels("left view", &[1], "1 (gray)", left.channels)?;
        check_channels("right view", &[1], "1 (gray)", right.channels)?;
        check_channels("disparity", &[1], "1", self.left.channels)?;
        check_size("right view", size, (right.width, right.height))?;
        check_size("disparity", size, (self.left.width, self.left.height))?;
        if let Some(map) = &self.right {
            check_channels("right disparity", &[1], "1", map.channels)?;
            check_size("right disparity", size, (map.width, map.height))?;
        }
        if left.width > 65_000 {
            let (value, accepted) = (left.width.to_string(), "at most 65000 columns");
            return Err(StereoError::Parameter { name: "width", value, accepted });
        }
        Ok(())
    }

    /// Writes NaN into the rows outside `rows`.
    pub fn clear_outside(&mut self, rows: Range<usize>) {
        for map in [Some(&mut self.left), self.right.as_mut()].into_iter().flatten() {
            for y in (0..rows.start).chain(rows.end..map.height) {
                map.row_mut(y).fill(f32::NAN);
            }
        }
    }

    /// Runs bands of at least `band_rows` rows of `roi`, each in one chunk: `prepare(band, y)` before its first row, then
    /// `step(band, y, target)` for each row. Steps begin `warm_up` rows early, with no target.
    ///
    /// There are at most eight bands, so that few rows are read twice.
    pub fn fill_bands<B: Default + Send>(
        self,
        bands: &mut Vec<B>,
        roi: Rect,
        (band_rows, warm_up): (usize, usize),
        pool: &dyn Parallel,
        prepare: impl Fn(&mut B, usize) + Sync,
        step: impl Fn(&mut B, usize, Option<Target<'_>>) + Sync,
    ) {
        let band_rows = roi.height.div_ceil(8).max(band_rows);
        let count = roi.height.div_ceil(band_rows);
        if bands.len() < count {
            bands.resize_with(count, B::default);
        }
        let bands = SharedMut::new(bands);
        let width = self.left.width;
        let (stride, stride_right) = (self.left.stride, self.right.as_ref().map_or(0, |map| map.stride));
        let out = SharedMut::new(self.left.data);
        let out_right = self.right.map(|map| SharedMut::new(map.data));
        pool.run(count, &|index| {
            let first = roi.y + index * band_rows;
            let last = (first + band_rows).min(roi.y + roi.height);
            // SAFETY: `Parallel::run` calls each index once, and the memory of a band belongs to its index.
            let band = unsafe { &mut bands.part(index, 1)[0] };
            let start = first.saturating_sub(warm_up);
            prepare(band, start);
            for y in start..last {
                let target = (y >= first).then(|| Target {
                    // SAFETY: row `y` belongs to this band alone; rows have `width` elements.
                    left: unsafe { out.part(y * stride, width) },
                    // SAFETY: the right map has the same size, and its row `y` belongs to this band alone.
                    right: out_right.as_ref().map(|map| unsafe { map.part(y * stride_right, width) }),
                });
                step(band, y, target);
            }
        });
    }
}

/// One row of the maps.
pub struct Target<'a> {
    pub left: &'a mut [f32],
    pub right: Option<&'a mut [f32]>,
}

/// A pair of views as the kernels read it: prefiltered and padded.
#[derive(Debug, Default)]
pub struct PaddedPair {
    left: PaddedPlane,
    right: PaddedPlane,
    /// 255 at padding, 0 at pixels of the right view.
    outside: Vec<u8>,
}

impl PaddedPair {
    /// Prefilters `rows` of both views, clipped at `cap`.
    pub fn fill(
        &mut self,
        [left, right]: [View<'_, u8>; 2],
        span: &Span,
        rows: Range<usize>,
        cap: u8,
        avx2: bool,
        pool: &dyn Parallel,
    ) {
        self.fill_padded([left, right], (span.lanes, span.radius), rows, cap, avx2, pool);
    }

    /// Prefilters all rows, for windows of up to this radius and searches of up to `lanes` disparities.
    pub fn fill_all(
        &mut self,
        views: [View<'_, u8>; 2],
        lanes: usize,
        radius: usize,
        cap: u8,
        avx2: bool,
        pool: &dyn Parallel,
    ) {
        self.fill_padded(views, (lanes, radius), 0..views[0].height, cap, avx2, pool);
    }

    fn fill_padded(
        &mut self,
        [left, right]: [View<'_, u8>; 2],
        (lanes, radius): (usize, usize),
        rows: Range<usize>,
        cap: u8,
        avx2: bool,
        pool: &dyn Parallel,
    ) {
        let pad = lanes + radius + 32;
        self.left.fill(left, rows.clone(), cap, pad, avx2, pool);
        self.right.fill(right, rows, cap, pad, avx2, pool);
        self.outside.resize(left.width + 2 * pad, 0);
        self.outside.fill(255);
        self.outside[pad..pad + left.width].fill(0);
    }

    /// Start of column 0 in a padded left row, and of lane 0 of column 0 in a padded right row.
    fn starts(&self, span: &Span) -> (usize, usize) {
        let left = self.left.pad + span.x0 - span.radius;
        (left, (left as i64 - i64::from(span.min) - span.lanes as i64 + 1) as usize)
    }

    /// The left and the right row `y`, from the first column of the window of `span` on. Rows outside the view repeat its border.
    pub fn rows(&self, span: &Span, y: isize) -> (&[u8], &[u8]) {
        let (left, right) = self.starts(span);
        (&self.left.row(y)[left..], &self.right.row(y)[right..])
    }

    /// 255 where a lane of a column of `span` lies outside the right view.
    pub fn outside(&self, span: &Span) -> &[u8] {
        &self.outside[self.starts(span).1 + span.radius..]
    }

    /// Adds the window above row `first` to the column sums, so that each row is one step down.
    pub fn add_window_above(&self, span: &Span, first: usize, avx2: bool, columns: &mut [u16]) {
        for y in window_above(span, first) {
            let (left, right) = self.rows(span, y);
            add_row(left, right, span.lanes, avx2, columns);
        }
    }
}

/// Rows of the window around the row above `first`.
pub(super) fn window_above(span: &Span, first: usize) -> Range<isize> {
    let start = first as isize - span.radius as isize - 1;
    start..start + 2 * span.radius as isize + 1
}

/// The best disparity of each pixel of a row, and what it is judged by.
#[derive(Debug, Default)]
pub(super) struct WinnerRow {
    best_lane: Vec<u16>,
    best_cost: Vec<u16>,
    ambiguous: Vec<u16>,
    pub texture: Vec<u16>,
    right_best: Vec<u16>,
    right_cost: Vec<u16>,
    less: Vec<u16>,
    more: Vec<u16>,
    back: Vec<u16>,
}

impl WinnerRow {
    /// Makes room for the columns and lanes of `span`.
    pub fn resize(&mut self, span: &Span) {
        for row in [&mut self.best_lane, &mut self.best_cost, &mut self.ambiguous, &mut self.texture] {
            row.resize(span.count, 0);
        }
        for row in [&mut self.right_best, &mut self.right_cost, &mut self.less, &mut self.more, &mut self.back] {
            row.resize(span.count + span.lanes, 0);
        }
    }

    /// The row as the kernels fill it from `cost`; window and column sums are left empty.
    pub fn row<'a>(
        &'a mut self,
        span: &Span,
        outside: &'a [u8],
        cost: &'a mut [u16],
        uniqueness_percent: u32,
    ) -> Row<'a> {
        Row {
            lanes: span.lanes,
            count: span.count,
            radius: 0,
            new_left: &[],
            new_right: &[],
            old_left: &[],
            old_right: &[],
            outside,
            inside: span.inside.clone(),
            columns: &mut [],
            cost,
            best_lane: &mut self.best_lane,
            best_cost: &mut self.best_cost,
            less: &mut self.less,
            more: &mut self.more,
            ambiguous: &mut self.ambiguous,
            right_best: &mut self.right_best,
            right_cost: &mut self.right_cost,
            uniqueness_percent,
        }
    }

    /// Writes the winners that pass `limits` as disparities, NaN elsewhere.
    pub fn write(
        &mut self,
        span: &Span,
        outside: &[u8],
        cost: &[u16],
        limits: &Limits,
        avx2: bool,
        Target { left, right }: Target<'_>,
    ) {
        let Span { x0, count, lanes, min, .. } = *span;
        let mut winners = Winners {
            lanes,
            count,
            interleaved: avx2,
            cost,
            best_lane: &self.best_lane,
            best_cost: &self.best_cost,
            ambiguous: &self.ambiguous,
            texture: &self.texture,
            right_best: &self.right_best,
            right_cost: &self.right_cost,
            less: &mut self.less,
            more: &mut self.more,
            back: &mut self.back,
            inside: span.inside.clone(),
            outside,
        };
        left[..x0].fill(f32::NAN);
        left[x0 + count..].fill(f32::NAN);
        finish::left(&mut winners, limits, min, avx2, &mut left[x0..x0 + count]);
        let Some(right) = right else { return };
        right.fill(f32::NAN);
        let width = right.len();
        finish::right_within(&mut winners, x0, width, min, avx2, right);
    }
}

/// Largest difference of left and right disparity as the kernels take it; `None` allows any.
pub(super) fn left_right_limit(limit_px: Option<u32>) -> u16 {
    limit_px.map_or(u16::MAX, |px| px.min(u32::from(u16::MAX)) as u16)
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

/// The same view, for one call.
pub(crate) fn again<'a>(view: &'a mut ViewMut<'_, f32>) -> ViewMut<'a, f32> {
    ViewMut {
        data: &mut *view.data,
        width: view.width,
        height: view.height,
        stride: view.stride,
        channels: view.channels,
    }
}
