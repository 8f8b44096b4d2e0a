//! A coarse match over the whole range of disparities. It shows which disparities occur and whether the views are swapped.
//!
//! The views are shrunk to about 160 columns and matched from 0 px to their full width, so that
//! the shared region is found wherever it is. The cost is a small part of one full-size search.

use super::{BlockMatcher, BlockMatchingParams, PairViews, StereoError};
use crate::{Parallel, Rect, View, ViewMut};

/// Approximate number of columns of a shrunk view.
pub const COARSE_WIDTH: usize = 160;
/// Columns for a second, slower survey after one with hardly any match: it resolves a narrow shared region.
pub const FINE_WIDTH: usize = 320;
/// Side of the matching window, in coarse px.
const WINDOW: usize = 9;

/// How many pixels a survey matched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchCount {
    /// Coarse pixels whose disparity agrees with that of their neighbours.
    pub matched: usize,
    /// All coarse pixels.
    pub pixels: usize,
}

/// Surveys pairs of views. Reuses its memory.
#[derive(Debug)]
pub struct Survey {
    matcher: BlockMatcher,
    planes: [Vec<u8>; 2],
    disparity: Vec<f32>,
    /// The part of `disparity` that neighbours support, NaN elsewhere.
    supported: Vec<f32>,
    size: (usize, usize),
    counts: Vec<u32>,
    factor: usize,
}

impl Survey {
    /// A survey without data.
    ///
    /// # Errors
    /// None with these constants, which the kernel checks.
    pub fn new() -> Result<Self, StereoError> {
        let matcher = BlockMatcher::new(params(COARSE_WIDTH))?;
        Ok(Self {
            matcher,
            planes: [Vec::new(), Vec::new()],
            disparity: Vec::new(),
            supported: Vec::new(),
            size: (0, 0),
            counts: Vec::new(),
            factor: 1,
        })
    }

    /// Pixels of a full-size view per bin of [`Survey::counts`].
    pub fn bin_px(&self) -> usize {
        self.factor
    }

    /// Matched coarse pixels per disparity, in bins of [`Survey::bin_px`] from 0 px on.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Disparities of the coarse pixels, in coarse px, NaN where neighbours do not support them; columns and rows.
    pub fn map(&self) -> (&[f32], (usize, usize)) {
        (&self.supported, self.size)
    }

    /// Matched coarse pixels whose disparity is in `offset_px..offset_px + search_px`.
    pub fn within(&self, offset_px: i32, search_px: usize) -> usize {
        let (first, end) = (i64::from(offset_px), i64::from(offset_px) + search_px as i64);
        let lies_within = |bin: usize| (first..end).contains(&((bin * self.factor) as i64));
        self.counts.iter().enumerate().filter(|(bin, _)| lies_within(*bin)).map(|(_, count)| *count as usize).sum()
    }

    /// Range of the middle 80 % of the matched disparities, px; `None` when nothing matched.
    pub fn range_px(&self) -> Option<(usize, usize)> {
        let all: u64 = self.counts.iter().map(|count| u64::from(*count)).sum();
        let below = |share: u64| {
            let mut sum = 0;
            self.counts.iter().position(|count| {
                sum += u64::from(*count);
                sum * 10 > all * share
            })
        };
        Some((below(1)? * self.factor, below(9)? * self.factor))
    }

    /// Matches the views shrunk to about `columns` columns: view `sides[0]` as the left one, `sides[1]` as the right one.
    ///
    /// # Errors
    /// The same as those of the kernel, and of the views.
    pub fn look(
        &mut self,
        views: &mut dyn PairViews,
        sides: [usize; 2],
        columns: usize,
        pool: &dyn Parallel,
    ) -> Result<MatchCount, StereoError> {
        let (width, height) = views.size();
        self.factor = (width + columns / 2).div_euclid(columns).max(1);
        let (width, height) = (width / self.factor, height / self.factor);
        self.counts.clear();
        self.counts.resize(width, 0);
        self.size = (width, height);
        self.supported.clear();
        self.supported.resize(width * height, f32::NAN);
        if width < 16 || height < 16 {
            return Ok(MatchCount { matched: 0, pixels: width * height });
        }
        for (side, plane) in sides.into_iter().zip(&mut self.planes) {
            views.shrink(side, self.factor, plane)?;
        }
        self.disparity.resize(width * height, f32::NAN);
        let wanted = params(width);
        if *self.matcher.params() != wanted {
            self.matcher.set_params(wanted)?;
        }
        let plane = |index: usize| View::new(&self.planes[index][..], width, height, 1);
        let out = ViewMut::new(&mut self.disparity, width, height, 1);
        self.matcher.compute(plane(0), plane(1), Rect::whole(width, height), pool, out, None)?;
        let mut matched = 0;
        for y in 0..height {
            for x in 0..width {
                let Some(disparity) = supported(&self.disparity, width, height, x, y) else { continue };
                matched += 1;
                self.supported[y * width + x] = disparity;
                self.counts[((disparity + 0.5).max(0.0) as usize).min(width - 1)] += 1;
            }
        }
        Ok(MatchCount { matched, pixels: width * height })
    }
}

/// A pixel's disparity if two of the four pixels one window away have nearly the same one. Views of different scenes match by
/// chance in places, but not with equal disparities.
fn supported(map: &[f32], width: usize, height: usize, x: usize, y: usize) -> Option<f32> {
    const NEAR_PX: f32 = 2.0;
    let own = map[y * width + x];
    if own.is_nan() {
        return None;
    }
    let at = |x: usize, y: usize| if x < width && y < height { map[y * width + x] } else { f32::NAN };
    let around = [at(x.wrapping_sub(WINDOW), y), at(x + WINDOW, y), at(x, y.wrapping_sub(WINDOW)), at(x, y + WINDOW)];
    // NaN fails.
    (around.into_iter().filter(|other| (other - own).abs() <= NEAR_PX).count() >= 2).then_some(own)
}

fn params(width: usize) -> BlockMatchingParams {
    BlockMatchingParams {
        min_disparity_px: 0,
        search_px: width.clamp(32, 512),
        block_px: WINDOW,
        uniqueness_percent: 10,
        left_right_px: Some(1),
        ..BlockMatchingParams::default()
    }
}
