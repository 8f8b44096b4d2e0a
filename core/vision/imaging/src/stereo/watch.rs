//! Warnings of a matcher: swapped views, a drifted calibration, a search range without matches. Each is reported once when it begins
//! and once when it ends.

use super::StereoError;
use super::epipolar::Epipolar;
use super::pair::{MapSamples, PairViews};
use super::survey::{COARSE_WIDTH, MatchCount, Survey};
use crate::{Parallel, Report};

/// A drift warning ends when the error falls below this part of the limit.
const RECOVERED: f32 = 0.7;
/// Smoothing: share of the difference to a new measurement that the reported error moves.
const DRIFT_STEP: f32 = 0.25;
/// Share of the surveyed matches, in percent, below which the search range misses the scene.
const BESIDE_PERCENT: usize = 25;
/// Share of the surveyed matches, in percent, below which the search leaves out a part of the scene.
const NARROW_PERCENT: usize = 90;
/// Such surveys in a row before the warning.
const NARROW_SURVEYS: u32 = 3;
/// Share of matched coarse pixels, in percent, above which their disparities locate the scene.
const USABLE_PERCENT: usize = 2;
/// Known share of a disparity map, in percent, below which the match counts as poor. The scope's geometry leaves a shared region of
/// 12 % of the picture or more.
const POOR_PERCENT: f64 = 0.5;
/// Poor surveys in a row before the warning: a short blur or a covered lens needs none.
const POOR_SURVEYS: u32 = 3;

/// What is searched.
#[derive(Clone, Copy, Debug)]
pub enum Searched {
    /// One range everywhere.
    Range {
        /// Smallest disparity, px.
        first_px: i32,
        /// Disparities from there on.
        search_px: usize,
    },
    /// Tiles over ranges of their own: all that the survey has found.
    Tiles,
}

/// The state of the warnings of one matcher.
#[derive(Debug, Default)]
pub struct Watch {
    epipolar: Epipolar,
    error_px: Option<f32>,
    drifted: bool,
    swapped: bool,
    blind: bool,
    /// The search range misses the scene.
    beside: bool,
    /// Surveys in a row of which the search leaves out a part.
    narrow_surveys: u32,
    narrow: bool,
    /// A tile has more range than its search.
    cut: bool,
    /// Poor surveys in a row.
    poor_surveys: u32,
    poor: bool,
}

impl Watch {
    /// Whether the views are swapped.
    pub fn is_swapped(&self) -> bool {
        self.swapped
    }

    /// Whether matched points are too far off their rows: the calibration does not fit the views.
    pub fn is_drifted(&self) -> bool {
        self.drifted
    }

    /// Checks after a survey with few matches whether the swapped views match. Views that match in neither order, such as dark ones, decide nothing.
    ///
    /// # Errors
    /// The same as those of the kernel, and of the views.
    pub fn swapped(
        &mut self,
        cx: &dyn Report,
        survey: &mut Survey,
        found: MatchCount,
        views: &mut dyn PairViews,
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        // A pair in the right order matches most of its shared region.
        let few = found.matched * 4 < found.pixels;
        let swapped = few.then(|| survey.look(views, [1, 0], COARSE_WIDTH, pool)).transpose()?;
        let is_clear =
            |of: MatchCount, other: MatchCount| of.matched > 3 * other.matched && of.matched * 10 > of.pixels;
        let swapped = match swapped {
            Some(swapped) if is_clear(swapped, found) => true,
            Some(swapped) if !is_clear(found, swapped) => return Ok(()),
            _ => false,
        };
        if swapped && !self.swapped {
            cx.warn("left and right are swapped: the disparities are negative, nothing is matched until the inputs change places");
        } else if self.swapped && !swapped {
            cx.info("left and right are in order again");
        }
        self.swapped = swapped;
        cx.metric("views_swapped", f64::from(u8::from(swapped)));
        Ok(())
    }

    /// Warns when the search from `offset_px` on is outside views of `width` columns.
    pub fn blind(&mut self, cx: &dyn Report, offset_px: i32, search_px: usize, width: usize) {
        let (first, last) = (i64::from(offset_px), i64::from(offset_px) + search_px as i64);
        let blind = first >= width as i64 || last <= -(width as i64);
        if blind && !self.blind {
            cx.warn(&format!(
                "the search for disparities begins at {first} px, the views are {width} px wide: nothing can be matched"
            ));
        }
        self.blind = blind;
    }

    /// Warns when the search covers hardly any of the surveyed disparities, or leaves out a part of them for some surveys.
    pub fn beside(&mut self, cx: &dyn Report, survey: &Survey, found: MatchCount, searched: Searched) {
        cx.metric("found_pct", 100.0 * found.matched as f64 / found.pixels.max(1) as f64);
        if found.matched * 100 < found.pixels * USABLE_PERCENT || self.swapped {
            return;
        }
        let (within, from, to) = match searched {
            Searched::Tiles => (found.matched, 0, 0),
            Searched::Range { first_px, search_px } => {
                (survey.within(first_px, search_px), i64::from(first_px), i64::from(first_px) + search_px as i64)
            }
        };
        cx.metric("in_search_pct", 100.0 * within as f64 / found.matched.max(1) as f64);
        let beside = within * 100 < found.matched * BESIDE_PERCENT;
        let range = survey.range_px().unwrap_or((0, 0));
        if beside && !self.beside {
            cx.warn(&format!(
                "disparities are searched from {from} to {to} px, the views hold them from about {} to {} px: nearly all of the map is wrong. Switch `auto_offset` on, or set `min_disparity_px` and `search_px` to that range",
                range.0,
                range.1
            ));
        } else if self.beside && !beside {
            cx.info("the search for disparities holds what the views show again");
        }
        self.beside = beside;
        self.narrow(cx, !beside && within * 100 < found.matched * NARROW_PERCENT, (from, to), range);
    }

    /// Warns when the search has left out a part of what the views show for some surveys.
    fn narrow(&mut self, cx: &dyn Report, is_narrow: bool, (from, to): (i64, i64), range: (usize, usize)) {
        self.narrow_surveys = if is_narrow { self.narrow_surveys.saturating_add(1) } else { 0 };
        if self.narrow_surveys >= NARROW_SURVEYS && !self.narrow {
            self.narrow = true;
            cx.warn(&format!(
                "disparities are searched from {from} to {to} px, most of what the views show lies from about {} to {} px: a part of the map is missing or wrong. Switch `auto_range` on, or raise `search_px`",
                range.0, range.1
            ));
        } else if self.narrow && !is_narrow {
            self.narrow = false;
            cx.info("the search for disparities holds all that the views show again");
        }
    }

    /// Warns when one part of the picture shows more disparities than a search can hold.
    pub fn cut(&mut self, cx: &dyn Report, is_cut: bool) {
        if is_cut && !self.cut {
            cx.warn("a part of the picture shows more than 512 px of disparities: the farthest surfaces there are not searched. Shrink the views");
        }
        self.cut = is_cut;
    }

    /// Warns when hardly anything has been matched for some surveys. `known_percent` is the share of the map that is known.
    pub fn poor(&mut self, cx: &dyn Report, found_nothing: bool, known_percent: Option<f64>) {
        if let Some(percent) = known_percent {
            cx.metric("matched_pct", percent);
        }
        let is_poor = found_nothing || known_percent.is_some_and(|percent| percent < POOR_PERCENT);
        self.poor_surveys = if is_poor { self.poor_surveys.saturating_add(1) } else { 0 };
        if self.poor_surveys >= POOR_SURVEYS && !self.poor && !self.swapped && !self.blind {
            self.poor = true;
            cx.warn(
                "hardly anything in the two views matches: they are dark, blurred or covered, not rectified, not of one instant, or show different things",
            );
        } else if self.poor && self.poor_surveys == 0 {
            self.poor = false;
            cx.info("the two views match again");
        }
        cx.metric("poor_match", f64::from(u8::from(self.poor)));
    }

    /// Measures the vertical error of matched points and warns when it exceeds `limit_px`; 0 disables the warning.
    ///
    /// # Errors
    /// Those of the views and of the map.
    pub fn rows(
        &mut self,
        cx: &dyn Report,
        views: &mut dyn PairViews,
        disparity: &mut dyn MapSamples,
        limit_px: f32,
    ) -> Result<(), StereoError> {
        let Some(measured) = self.epipolar.measure(views, disparity)? else { return Ok(()) };
        let error = self.error_px.map_or(measured, |error| error + (measured - error) * DRIFT_STEP);
        self.error_px = Some(error);
        cx.metric("epipolar_px", f64::from(error));
        if limit_px > 0.0 && error > limit_px && !self.drifted {
            self.drifted = true;
            cx.warn(&format!(
                "matched points lie {error:.1} px off their rows, {limit_px:.1} px are allowed: the calibration does not fit these views (drifted, or not rectified)"
            ));
        } else if self.drifted && (error < RECOVERED * limit_px || limit_px <= 0.0) {
            self.drifted = false;
            cx.info(&format!("matched points lie on their rows again ({error:.1} px)"));
        }
        cx.metric("drifted", f64::from(u8::from(self.drifted)));
        Ok(())
    }
}
