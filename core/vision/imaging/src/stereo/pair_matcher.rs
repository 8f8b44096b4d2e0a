//! A matcher as nodes use it: range of the search, kernel, shared field, speckles.

use super::border_strip::BorderStrip;
use super::error::check_size;
use super::lit_pair::LitPair;
use super::pair::{HostMaps, PairMaps, PairViews, RowEdit};
use super::search::{Search, SearchParams};
use super::stereo_kernel::StereoKernel;
use super::tile::Tile;
use super::{SharedField, SpeckleFilter, StereoError};
use crate::lit::LitPart;
use crate::{Parallel, Rect, Report, View, ViewMut};

/// What a [`PairMatcher`] searches and drops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairParams {
    /// The searched range.
    pub search: SearchParams,
    /// Largest difference between the disparities of both views where tiles are matched, px; `None` keeps all. Kernels have their own.
    pub left_right_px: Option<u32>,
    /// Removes patches of the left map with at most this many pixels; 0 keeps all.
    pub speckle_area_px: usize,
}

/// Largest step of disparity within a speckle.
const SPECKLE_STEP_PX: f32 = 1.0;

/// The part of a matcher that is not its kernel. Reuses its memory.
#[derive(Debug)]
pub struct PairMatcher {
    search: Search,
    speckles: SpeckleFilter,
    field: SharedField,
    lit: LitPair,
    strip: BorderStrip,
    /// The right view's map when nobody reads it: the shared field is found by it.
    spare: Vec<f32>,
    /// Tiles inside the region.
    tiles: Vec<Tile>,
}

impl PairMatcher {
    /// A matcher without history.
    ///
    /// # Errors
    /// As [`Search::new`].
    pub fn new() -> Result<Self, StereoError> {
        Ok(Self {
            search: Search::new()?,
            speckles: SpeckleFilter::default(),
            field: SharedField::default(),
            lit: LitPair::default(),
            strip: BorderStrip::default(),
            spare: Vec::new(),
            tiles: Vec::new(),
        })
    }

    /// Sets the lit parts of the left and right view; a view without one is lit as a whole. From now on pixels stay unknown that
    /// lie within `rim_px` of a rim in either view.
    pub fn set_lit(&mut self, parts: [Option<&LitPart>; 2], rim_px: usize) {
        self.lit.set(parts, rim_px);
    }

    /// Whether the calibration does not fit the views, as the last measurement of rows found.
    pub fn is_drifted(&self) -> bool {
        self.search.is_drifted()
    }

    /// Matches `roi` of a rectified gray pair. Writes px of the left view into `disparity` and, where asked for, px of the right view into
    /// `disparity_right`; NaN where unmatched, outside `roi`, and where only one camera sees. A strip at the
    /// right border that is narrower than a block is filled in in `disparity` alone.
    ///
    /// # Errors
    /// When sizes or channel counts do not agree.
    pub fn compute<K: StereoKernel>(
        &mut self,
        report: &dyn Report,
        kernel: &mut K,
        mut views: [View<'_, u8>; 2],
        roi: Rect,
        params: &PairParams,
        pool: &dyn Parallel,
        left: ViewMut<'_, f32>,
        right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        check_size("disparity", (views[0].width, views[0].height), (left.width, left.height))?;
        check_size("right view", (views[0].width, views[0].height), (views[1].width, views[1].height))?;
        let mut spare = std::mem::take(&mut self.spare);
        let mut maps = HostMaps { kernel, views, left, right, spare: &mut spare };
        let computed = self.compute_in(report, &mut views, &mut maps, roi, params, pool);
        self.spare = spare;
        computed
    }

    /// As [`PairMatcher::compute`], for views and maps wherever they are.
    ///
    /// # Errors
    /// Those of the views and of the maps.
    pub fn compute_in(
        &mut self,
        report: &dyn Report,
        views: &mut dyn PairViews,
        maps: &mut dyn PairMaps,
        roi: Rect,
        params: &PairParams,
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        let size = views.size();
        let roi = roi.clamped(size.0, size.1);
        let first_px = self.search.begin(report, views, &params.search, pool)?;
        // A region was chosen by who knows what the views share; the whole frame is cut down to that by the maps of both views.
        let is_whole = roi == Rect::whole(size.0, size.1);
        let right_is_read = maps.right_is_read();
        if self.search.is_swapped() {
            // Matches of swapped views are chance, their depths would be believed.
            for side in 0..=usize::from(right_is_read) {
                maps.edit(side, &[RowEdit::CLEAR], pool)?;
            }
            return self.search.end(report, views, maps, is_whole, &params.search);
        }
        if let Some(tiles) = self.search.tiles() {
            self.tiles.clear();
            self.tiles.extend(tiles.iter().filter_map(|tile| {
                let area = tile.area.intersect(&roi);
                (!area.is_empty()).then_some(Tile { area, ..*tile })
            }));
            maps.match_tiles(&self.tiles, params.left_right_px.map(|px| px as f32), pool)?;
        } else {
            maps.match_roi((first_px, params.search.search_px), roi, is_whole, pool)?;
        }
        self.lit.clear_map(maps, 0, size, pool)?;
        if is_whole || right_is_read {
            self.lit.clear_map(maps, 1, size, pool)?;
            self.field.clear_outside(maps, size, roi, self.lit.clear_parts(size), pool)?;
        }
        if params.speckle_area_px > 0 {
            let speckles = &mut self.speckles;
            maps.change_left(&mut |mut map| {
                speckles.remove(&mut map, roi, params.speckle_area_px, SPECKLE_STEP_PX);
            })?;
        }
        self.strip.fill(views, maps, roi, pool)?;
        self.lit.clear_rim(maps, size, pool)?;
        self.search.end(report, views, maps, is_whole, &params.search)
    }
}
