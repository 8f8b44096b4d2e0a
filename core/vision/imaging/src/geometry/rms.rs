//! Reprojection error of a homography on its inliers, and the warning when it is too large.

use super::{Homography, Point};
use crate::Report;

/// Root mean square distance of the selected pairs under `map`, in pixels of the target frame; 0 when none is selected.
pub fn rms_of(map: &Homography, from: &[Point], to: &[Point], selected: &[bool]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for ((from, to), _) in from.iter().zip(to).zip(selected).filter(|(_, selected)| **selected) {
        sum += map.squared_error(*from, *to);
        count += 1.0;
    }
    if count == 0.0 { 0.0 } else { f64::sqrt(sum / count) }
}

/// Good frames in a row that end the warning, so that an error near the limit is not reported again and again.
const GOOD_FRAMES: u32 = 30;

/// Warns once when registrations are refused because of their error, and reports once when they are accepted again.
#[derive(Clone, Copy, Debug, Default)]
pub struct RmsWatch {
    is_told: bool,
    good_frames: u32,
    refused: u64,
}

impl RmsWatch {
    /// Takes the outcome of one frame: its error, or that for which it was refused, in pixels.
    pub fn look(&mut self, report: &dyn Report, rms_px: f64, refused_px: Option<f64>, limit_px: f64) {
        report.metric("rms_px", refused_px.unwrap_or(rms_px));
        if let Some(refused_px) = refused_px {
            self.refused += 1;
            self.good_frames = 0;
            if !self.is_told {
                self.is_told = true;
                report.warn(&format!(
                    "the homography is off by {refused_px:.1} px (rms of its inliers, `max_rms_px` allows {limit_px}): it is not used, the one before is held. \
                     The views may not be of one instant, the calibration may not fit, or the tissue is too curved for one plane: look at the sources' skew, \
                     or try `register_grid`, a smaller `ransac_px` or `stability_px = 0`"
                ));
            }
        } else {
            self.good_frames = self.good_frames.saturating_add(1);
            if self.is_told && self.good_frames >= GOOD_FRAMES {
                self.is_told = false;
                report.info(&format!("the homography fits again ({rms_px:.1} px)"));
            }
        }
        report.metric("refused", self.refused as f64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_is_that_of_the_selected_pairs() {
        let map = Homography([1.0, 0.0, 3.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let (from, to) = ([[0.0, 0.0], [1.0, 0.0], [2.0, 2.0]], [[3.0, 4.0], [4.0, 0.0], [90.0, 0.0]]);
        assert_eq!(rms_of(&map, &from, &to, &[true, true, false]), 8.0_f64.sqrt());
        assert_eq!(rms_of(&map, &from, &to, &[false; 3]), 0.0);
    }
}
