//! The kernel of a matcher: what finds the disparities of a pair.

use super::StereoError;
use super::tile::Tile;
use crate::{Parallel, Rect, View, ViewMut};

/// A kernel that matches a rectified gray pair over ranges that it is given.
pub trait StereoKernel {
    /// Matches `roi` over `search_px` disparities from `first_px` on. Maps as in [`Matcher::compute`].
    ///
    /// [`Matcher::compute`]: super::Matcher::compute
    ///
    /// # Errors
    /// Sizes do not agree, or the range is out of bounds.
    fn match_roi(
        &mut self,
        range: (i32, usize),
        views: [View<'_, u8>; 2],
        roi: Rect,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        disparity_right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError>;

    /// Matches each tile over its own range. The left map as in [`Matcher::compute_tiles`], the right one by [`project_right`], which drops left
    /// pixels that differ from it by more than `left_right_px`.
    ///
    /// [`Matcher::compute_tiles`]: super::Matcher::compute_tiles
    /// [`project_right`]: super::project_right
    ///
    /// # Errors
    /// Sizes do not agree.
    fn match_tiles(
        &mut self,
        tiles: &[Tile],
        views: [View<'_, u8>; 2],
        left_right_px: Option<f32>,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        disparity_right: ViewMut<'_, f32>,
    ) -> Result<(), StereoError>;
}
