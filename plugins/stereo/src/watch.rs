//! What a matcher tells its user: swapped views, a drifted calibration, a search that can see nothing. Each is said
//! once when it begins, and once when it is over.

use panoscope_imaging::stereo::StereoError;
use panoscope_node::{Context, Parallel, View};

use crate::epipolar::Epipolar;
use crate::survey::{COARSE_WIDTH, Found, Survey};

/// Part of the limit below which a drifted calibration counts as mended.
const MENDED: f32 = 0.7;
/// Part of the way to a new measurement that the error shown moves.
const DRIFT_STEP: f32 = 0.25;

/// State of the warnings.
#[derive(Debug, Default)]
pub struct Watch {
    epipolar: Epipolar,
    error_px: Option<f32>,
    drifted: bool,
    swapped: bool,
    blind: bool,
}

impl Watch {
    /// After a survey with few matches: looks whether the views match the other way round.
    ///
    /// # Errors
    /// As the kernel.
    pub fn swapped(
        &mut self,
        cx: &Context<'_>,
        survey: &mut Survey,
        found: Found,
        views: [View<'_, u8>; 2],
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        // A pair in order matches a good part of what its views share.
        let few = found.matched * 4 < found.pixels;
        let swapped = few && {
            let other = survey.look([views[1], views[0]], COARSE_WIDTH, pool)?;
            other.matched > 3 * found.matched && other.matched * 10 > other.pixels
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

    /// Says so when a search that begins at `offset_px` can see nothing in views of `width` columns.
    pub fn blind(&mut self, cx: &Context<'_>, offset_px: i32, search_px: usize, width: usize) {
        let (first, last) = (i64::from(offset_px), i64::from(offset_px) + search_px as i64);
        let blind = first >= width as i64 || last <= -(width as i64);
        if blind && !self.blind {
            cx.warn(&format!(
                "the search for disparities begins at {first} px, the views are {width} px wide: nothing can be matched"
            ));
        }
        self.blind = blind;
    }

    /// Measures how far matched points lie off their rows, and warns when that grows beyond `limit_px`; 0 never warns.
    pub fn rows(&mut self, cx: &Context<'_>, views: [View<'_, u8>; 2], disparity: View<'_, f32>, limit_px: f32) {
        let Some(measured) = self.epipolar.measure(views[0], views[1], disparity) else { return };
        let error = self.error_px.map_or(measured, |error| error + (measured - error) * DRIFT_STEP);
        self.error_px = Some(error);
        cx.metric("epipolar_px", f64::from(error));
        if limit_px > 0.0 && error > limit_px && !self.drifted {
            self.drifted = true;
            cx.warn(&format!(
                "matched points lie {error:.1} px off their rows, {limit_px:.1} px are allowed: the calibration does not fit these views (drifted, or not rectified)"
            ));
        } else if self.drifted && (error < MENDED * limit_px || limit_px <= 0.0) {
            self.drifted = false;
            cx.info(&format!("matched points lie on their rows again ({error:.1} px)"));
        }
        cx.metric("drifted", f64::from(u8::from(self.drifted)));
    }
}
