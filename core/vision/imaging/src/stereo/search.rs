//! The disparity range that a matcher searches, and its warnings: one mechanism for all engines.

use super::StereoError;
use super::offset::Offset;
use super::pair::{MapSamples, PairViews};
use super::range_plan::RangePlan;
use super::survey::{COARSE_WIDTH, FINE_WIDTH, MatchCount, Survey};
use super::tile::Tile;
use super::watch::{Searched, Watch};
use crate::{Parallel, Rect, Report};

/// Calls between two surveys.
const SURVEY_CALLS: u64 = 4;
/// Share of the surveyed matches, in percent, that the search must cover for the offset to stay.
const ENOUGH_PERCENT: usize = 98;
/// Share of the coarse pixels, in 1/1000, matched outside one search from which on that search does not hold the scene, and
/// below which it does again. Small: near surfaces are mostly instruments, and a survey matches only their flat parts.
const OUTSIDE_PERMILLE: (usize, usize) = (5, 3);
/// Share of matched coarse pixels, in percent, from which on their disparities can be divided into tiles.
const PLAN_PERCENT: usize = 10;
/// Calls between two measurements of the vertical error.
const ROWS_CALLS: u64 = 8;

/// The searched range of disparities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchParams {
    /// Whether the offset is estimated from the pictures.
    pub auto_offset: bool,
    /// Whether tiles are searched over ranges of their own when one search does not hold what the views show. Needs `auto_offset`.
    pub auto_range: bool,
    /// The offset when it is not estimated, and until the first estimate, px.
    pub min_disparity_px: i32,
    /// Whether that offset is used while the search from there covers nearly all matches. For engines that lose a column for
    /// each pixel of offset.
    pub keeps_asked: bool,
    /// Width of the search, px.
    pub search_px: usize,
    /// Vertical error of matched points above which a warning is reported, px; 0 disables it.
    pub drift_px: f32,
}

/// Estimates the range of the search and warns when matching fails. Reuses its memory.
#[derive(Debug)]
pub struct Search {
    survey: Survey,
    offset: Offset,
    plan: RangePlan,
    watch: Watch,
    calls: u64,
    found_nothing: bool,
    asked_is_enough: bool,
    /// One search does not hold the scene.
    is_tiled: bool,
    /// Of the views of the last call: tiles belong to it.
    size: (usize, usize),
}

impl Search {
    /// A search without history.
    ///
    /// # Errors
    /// None with its constants, which the kernel checks.
    pub fn new() -> Result<Self, StereoError> {
        Ok(Self {
            survey: Survey::new()?,
            offset: Offset::default(),
            plan: RangePlan::default(),
            watch: Watch::default(),
            calls: 0,
            found_nothing: false,
            asked_is_enough: false,
            is_tiled: false,
            size: (0, 0),
        })
    }

    /// Call before matching. Returns the smallest disparity to search for this pair, in px, where [`Search::tiles`] has none. Both views
    /// have the same size.
    ///
    /// # Errors
    /// The same as those of the survey's kernel, and of the views.
    pub fn begin(
        &mut self,
        report: &dyn Report,
        views: &mut dyn PairViews,
        params: &SearchParams,
        pool: &dyn Parallel,
    ) -> Result<i32, StereoError> {
        let size = views.size();
        let is_survey = self.calls.is_multiple_of(SURVEY_CALLS) || size != self.size;
        let mut found = None;
        if is_survey {
            let mut coarse = self.survey.look(views, [0, 1], COARSE_WIDTH, pool)?;
            if self.offset.says_nothing(coarse.matched, coarse.pixels) {
                coarse = self.survey.look(views, [0, 1], FINE_WIDTH, pool)?;
            }
            self.found_nothing = self.offset.says_nothing(coarse.matched, coarse.pixels);
            self.offset.update(self.survey.counts(), self.survey.bin_px(), coarse.pixels, params.search_px);
            if !self.found_nothing {
                let within = self.survey.within(params.min_disparity_px, params.search_px);
                self.asked_is_enough = within * 100 >= coarse.matched * ENOUGH_PERCENT;
            }
            found = Some(coarse);
        }
        let stays = params.keeps_asked && self.asked_is_enough;
        let known = if params.auto_offset && !stays { self.offset.current_px() } else { None };
        let offset_px = known.unwrap_or(params.min_disparity_px);
        if let Some(found) = found {
            self.divide(report, size, found, offset_px, params);
            self.report_survey(report, views, found, offset_px, params, pool)?;
        }
        if !params.auto_offset {
            self.watch.blind(report, offset_px, params.search_px, size.0);
        }
        report.metric("offset_px", f64::from(offset_px));
        // A call that has failed does not count: the next one surveys in its place.
        (self.size, self.calls) = (size, self.calls + 1);
        Ok(offset_px)
    }

    /// Tiles to match one by one, each over its own range; `None` where one search from the offset holds the scene.
    pub fn tiles(&self) -> Option<&[Tile]> {
        (self.is_tiled && !self.plan.tiles().is_empty()).then(|| self.plan.tiles())
    }

    /// Decides after a survey whether one search holds the scene, and divides the view into tiles where it does not.
    fn divide(
        &mut self,
        report: &dyn Report,
        (width, height): (usize, usize),
        found: MatchCount,
        offset_px: i32,
        params: &SearchParams,
    ) {
        if !params.auto_range || !params.auto_offset {
            self.is_tiled = false;
        } else if found.matched * 100 >= found.pixels * PLAN_PERCENT {
            let within = self.survey.within(offset_px, params.search_px);
            let limit = if self.is_tiled { OUTSIDE_PERMILLE.1 } else { OUTSIDE_PERMILLE.0 };
            let is_outside = (found.matched - within) * 1000 >= found.pixels * limit;
            let was_tiled = std::mem::replace(&mut self.is_tiled, is_outside);
            if self.is_tiled {
                self.plan.update(&self.survey, Rect::whole(width, height));
                self.watch.cut(report, self.plan.is_cut());
            }
            if self.is_tiled && !was_tiled {
                let (low, high) = self.plan.range_px();
                report.info(&format!(
                    "the views hold disparities from {low} to {high} px, one search has {} px: each part of the picture is searched over its own range",
                    params.search_px
                ));
            }
        }
        report.metric("tiles", self.tiles().map_or(0.0, |tiles| tiles.len() as f64));
    }

    fn report_survey(
        &mut self,
        report: &dyn Report,
        views: &mut dyn PairViews,
        found: MatchCount,
        offset_px: i32,
        params: &SearchParams,
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        // First, because matching the swapped views overwrites the survey's counts.
        let searched = match self.tiles().is_some() {
            true => Searched::Tiles,
            false => Searched::Range { first_px: offset_px, search_px: params.search_px },
        };
        self.watch.beside(report, &self.survey, found, searched);
        self.watch.swapped(report, &mut self.survey, found, views, pool)
    }

    /// Whether the views are swapped: what a kernel matches of them is chance.
    pub fn is_swapped(&self) -> bool {
        self.watch.is_swapped()
    }

    /// Whether the calibration does not fit the views, as the last measurement of rows found.
    pub fn is_drifted(&self) -> bool {
        self.watch.is_drifted()
    }

    /// Call after matching, with the left map. `is_whole`: the whole left view was matched, not only a region.
    ///
    /// # Errors
    /// Those of the views and of the map.
    pub fn end(
        &mut self,
        report: &dyn Report,
        views: &mut dyn PairViews,
        disparity: &mut dyn MapSamples,
        is_whole: bool,
        params: &SearchParams,
    ) -> Result<(), StereoError> {
        let call = self.calls.saturating_sub(1);
        if call.is_multiple_of(SURVEY_CALLS) {
            let known = if is_whole { Some(disparity.known_share()?) } else { None };
            self.watch.poor(report, self.found_nothing, known.map(|share| 100.0 * share));
        }
        if call.is_multiple_of(ROWS_CALLS) {
            self.watch.rows(report, views, disparity, params.drift_px)?;
        }
        Ok(())
    }
}
