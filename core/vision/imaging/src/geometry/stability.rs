//! A homography that does not jitter (thesis, chapter 4, Algorithm 2).

use super::anchor_fit::{AnchorFit, shift_of};
use super::homography::{Homography, Point};
use super::ransac::RansacFit;
use super::rms::rms_of;

/// How far a frame's homography can be relied on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RegistrationState {
    /// Measured in this frame (or confirmed by it).
    Fresh,
    /// This frame failed; the one before is recent enough to be used.
    Held,
    /// This frame failed and nothing recent is known.
    #[default]
    Lost,
}

/// The homography that a frame uses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stabilized {
    /// Maps the source frame to the target frame.
    pub homography: Homography,
    /// Whether it is the previous frame's.
    pub kept: bool,
}

/// Median reprojection error of `map` on the selected pairs, in pixels; `None` when none is selected.
///
/// For an even number the lower of the two middle ones is taken. `work` is overwritten and keeps its memory.
pub fn median_error(
    map: &Homography,
    from: &[Point],
    to: &[Point],
    select: impl Fn(usize) -> bool,
    work: &mut Vec<f64>,
) -> Option<f64> {
    work.clear();
    let pairs = from.iter().zip(to).enumerate().filter(|(index, _)| select(*index));
    work.extend(pairs.map(|(_, (&from, &to))| map.squared_error(from, to)));
    if work.is_empty() {
        return None;
    }
    let middle = (work.len() - 1) / 2;
    let (_, median, _) = work.select_nth_unstable_by(middle, f64::total_cmp);
    Some(median.sqrt())
}

/// Whether `previous` explains the pairs about as well as `fresh` does.
///
/// On curved tissue many planes fit equally well, and noise alone makes RANSAC choose another one in every frame. Both maps are
/// charged the squared error of each pair, at most that of an outlier (MSAC; Torr and Zisserman 2000); `previous` may cost
/// more by the share `tolerance`.
pub fn explains_as_well(
    previous: &Homography,
    fresh: &Homography,
    from: &[Point],
    to: &[Point],
    threshold_px: f64,
    tolerance: f64,
) -> bool {
    let most = threshold_px * threshold_px;
    // `min` also turns the NaN of a point on the horizon into the cost of an outlier.
    let cost =
        |map: &Homography| from.iter().zip(to).map(|(&from, &to)| map.squared_error(from, to).min(most)).sum::<f64>();
    cost(previous) <= cost(fresh) * (1.0 + tolerance)
}

/// A previous map that fails the test is reused for one more frame while it costs no more than this share above the fresh one.
const DOUBTED_TOLERANCE: f64 = 1.0;

/// When the previous homography is reused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StabilityParams {
    /// It is reused while its median error on the new inliers is below this, in pixels; 0 refits every frame.
    pub stability_px: f64,
    /// It is also reused while its cost on the pairs (see [`explains_as_well`]) is higher by no more than this share.
    pub still_tolerance: f64,
    /// Error of an outlier, in pixels: RANSAC's threshold.
    pub outlier_px: f64,
    /// Weight of the previous map (of a translation in the first frame) relative to all inliers, see [`AnchorFit`]; 0 fits the inliers alone.
    pub anchor_fit: f64,
    /// Largest rms error on the new inliers at which the previous or the anchored map is accepted, in pixels; 0 accepts any.
    pub max_rms_px: f64,
}

/// Chooses the homography of each frame. Keeps work memory between frames, and whether the last test was failed.
#[derive(Clone, Debug, Default)]
pub struct Stability {
    anchor_fit: AnchorFit,
    errors: Vec<f64>,
    doubted: bool,
}

/// A previous map whose median error on the new inliers is this many times the outlier threshold belongs to another scene.
const JUMP: f64 = 2.0;

impl Stability {
    /// Reserves memory for up to `count` inliers and an anchor weight of up to `weight`.
    pub fn reserve(&mut self, count: usize, weight: f64) {
        self.anchor_fit.reserve(count, weight);
        self.errors.reserve(count.saturating_sub(self.errors.len()));
    }

    /// Returns `previous` where it still fits, else the new map, anchored at `previous` (see [`AnchorFit`]).
    ///
    /// `pairs` are source and target points and which of them are the inliers of `fit`; `size` is that of the source frame, in
    /// pixels. A previous map that fails narrowly is dropped only in the second such frame: noise fails one frame, motion all.
    pub fn choose(
        &mut self,
        fit: &RansacFit,
        previous: Option<Homography>,
        size: (usize, usize),
        pairs: (&[Point], &[Point], &[bool]),
        params: &StabilityParams,
    ) -> Stabilized {
        let (from, to, mask) = pairs;
        // After a jump the previous map is no anchor: the far corners would stay wrong for many frames. A map of another plane of the
        // same scene has errors as large, but still explains many pairs.
        let held = previous.filter(|before| {
            let median = median_error(before, from, to, |index| mask[index], &mut self.errors);
            let near = median.is_none_or(|median| median < JUMP * params.outlier_px);
            let bound = params.outlier_px * params.outlier_px;
            let explained = from.iter().zip(to).filter(|(from, to)| before.squared_error(**from, **to) < bound).count();
            near || 2 * explained >= fit.inliers
        });
        let fits = |map: &Homography| params.max_rms_px <= 0.0 || rms_of(map, from, to, mask) <= params.max_rms_px;
        let mut fresh = if params.anchor_fit > 0.0 {
            // The translation is a guess, so it weighs less than a previous map.
            let guess = || (shift_of(&fit.homography, from, mask), 0.1 * params.anchor_fit);
            let (anchor, weight) = held.map_or_else(guess, |before| (before, params.anchor_fit));
            self.anchor_fit.fit(fit, &anchor, weight, size, pairs)
        } else {
            fit.homography
        };
        if !fits(&fresh) {
            fresh = fit.homography;
        }
        let doubted = std::mem::take(&mut self.doubted);
        if let Some(previous) = held.filter(|before| params.stability_px > 0.0 && fits(before)) {
            let median = median_error(&previous, from, to, |index| mask[index], &mut self.errors);
            let near = median.is_some_and(|median| median < params.stability_px);
            let explains = |share| explains_as_well(&previous, &fresh, from, to, params.outlier_px, share);
            let holds = near || explains(params.still_tolerance);
            if holds || (!doubted && explains(DOUBTED_TOLERANCE)) {
                self.doubted = !holds;
                return Stabilized { homography: previous, kept: true };
            }
        }
        Stabilized { homography: fresh, kept: false }
    }
}
