//! Registration of two views by SURF, on whole frames or on the overlap seen last (thesis, chapter 2, Alg. 2.2).

use super::matching::{Gate, Match, MatchParams, Matcher};
use super::surf::{Features, Surf, SurfParams};
use crate::geometry::ransac::{Ransac, RansacParams};
use crate::geometry::{
    Homography, Plausibility, Point, Rect, RegistrationState, Stability, StabilityParams, overlap_rois, rms_of,
};
use crate::{Parallel, Serial, SharedMut, View};

/// Overlaps narrower than this cannot hold the larger filters; the next search covers whole frames.
const LEAST_ROI_PX: usize = 48;
/// The homography before also stays while it explains the matches worse by no more than this share.
const STILL_TOLERANCE: f64 = 0.1;

/// How to register.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegisterParams {
    /// Features of both views.
    pub surf: SurfParams,
    /// Searches the overlap of the frame before, shrunk; otherwise whole frames at full size.
    pub roi: bool,
    /// Shrink factor k of the search regions when `roi` is on (2 at 640x480).
    pub shrink: usize,
    /// Matching.
    pub matching: MatchParams,
    /// Radius in which matches are sought around the place that the frame before predicts, in pixels; 0: everywhere.
    pub gate_px: f32,
    /// Robust estimation; the threshold is in full-frame pixels.
    pub ransac: RansacParams,
    /// Inliers below which a homography is not believed; at least 4 (thesis 2.4.3).
    pub min_inliers: usize,
    /// What a warped frame may look like.
    pub plausibility: Plausibility,
    /// The homography stays while its median error on the new inliers is below this (chapter 4, Algorithm 2),
    /// in pixels; 0: refit every frame.
    pub stability_px: f64,
    /// Weight of the frame before (of a plain shift in the first frame) beside that of all inliers, 0..=4: what the overlap leaves open, the far corners
    /// above all, then moves slowly instead of jumping with every change of inliers. 0: the inliers alone.
    pub calm: f64,
    /// A homography whose inliers are further off than this (rms, px) is not believed; 0 believes all.
    pub max_rms_px: f64,
    /// Failed frames in a row for which the homography before still counts as held rather than lost.
    pub hold_frames: usize,
    /// Widens both search regions, in pixels.
    pub roi_margin_px: usize,
}

impl Default for RegisterParams {
    fn default() -> Self {
        Self {
            surf: SurfParams { max_points: 600, hessian_threshold: 50.0, ..SurfParams::default() },
            roi: true,
            shrink: 2,
            matching: MatchParams::default(),
            gate_px: 0.0,
            ransac: RansacParams::default(),
            min_inliers: 8,
            plausibility: Plausibility::default(),
            stability_px: 0.0,
            calm: 0.0,
            max_rms_px: 0.0,
            hold_frames: 0,
            roi_margin_px: 8,
        }
    }
}

/// Result for one frame pair.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Registration {
    /// Maps right-frame pixels to left-frame pixels; the last good one when held or lost, the identity before any.
    pub left_from_right: Homography,
    /// Fresh, held or lost.
    pub state: RegistrationState,
    /// Keypoints of the left and right view.
    pub points: (usize, usize),
    /// Matches given to RANSAC.
    pub matches: usize,
    /// Matches that agree with the homography; 0 unless fresh.
    pub inliers: usize,
    /// Root mean square reprojection error of the inliers in the left frame, in pixels; 0 unless fresh.
    pub rms_px: f64,
    /// The error for which this frame's homography was not believed, px.
    pub refused_rms_px: Option<f64>,
    /// Overlap in the left frame (the next search region); the whole frame unless fresh.
    pub roi_left: Rect,
    /// Overlap in the right frame.
    pub roi_right: Rect,
    /// Whether the homography is the previous frame's, kept by the stability test.
    pub kept: bool,
}

/// Registers frame pairs one after the other and remembers overlap and homography.
#[derive(Clone, Debug)]
pub struct RegisterSurf {
    params: RegisterParams,
    sides: [Side; 2],
    matcher: Matcher,
    ransac: Ransac,
    matches: Vec<Match>,
    from: Vec<Point>,
    to: Vec<Point>,
    mask: Vec<bool>,
    stability: Stability,
    memory: Option<Memory>,
    failures: usize,
    refused_rms_px: Option<f64>,
}

/// Detector and features of one view.
#[derive(Clone, Debug)]
struct Side {
    surf: Surf,
    features: Features,
}

/// What a good frame leaves behind.
#[derive(Clone, Copy, Debug)]
struct Memory {
    left_from_right: Homography,
    sizes: [(usize, usize); 2],
}

impl RegisterSurf {
    /// A registration without a past.
    pub fn new(params: RegisterParams) -> Self {
        let side = || Side { surf: Surf::new(params.surf), features: Features::default() };
        Self {
            params,
            sides: [side(), side()],
            matcher: Matcher::new(),
            ransac: Ransac::new(),
            matches: Vec::new(),
            from: Vec::new(),
            to: Vec::new(),
            mask: Vec::new(),
            stability: Stability::default(),
            memory: None,
            failures: 0,
            refused_rms_px: None,
        }
    }

    /// The parameters.
    pub fn params(&self) -> &RegisterParams {
        &self.params
    }

    /// Changes the parameters and keeps what is known of the frame before.
    pub fn set_params(&mut self, params: RegisterParams) {
        self.params = params;
        for side in &mut self.sides {
            side.surf.set_params(params.surf);
        }
    }

    /// Forgets the frame before.
    pub fn reset(&mut self) {
        self.memory = None;
        self.failures = 0;
    }

    /// Keypoints and descriptors of the last frame pair, left and right.
    pub fn features(&self) -> (&Features, &Features) {
        (&self.sides[0].features, &self.sides[1].features)
    }

    /// Matches of the last frame pair, and which of them agree with the homography (all false when it failed).
    pub fn matches(&self) -> (&[Match], &[bool]) {
        (&self.matches, &self.mask)
    }

    /// Registers one pair of views (gray or BGR). Nothing is allocated once the largest frames have been seen.
    ///
    /// A failure is a state, not an error: the next frame searches whole frames and so resumes.
    pub fn register(&mut self, left: View<'_, u8>, right: View<'_, u8>, pool: &dyn Parallel) -> Registration {
        let sizes = [(left.width, left.height), (right.width, right.height)];
        let whole = [Rect::new(0, 0, left.width, left.height), Rect::new(0, 0, right.width, right.height)];
        let memory = self.memory.filter(|memory| memory.sizes == sizes);
        let trusted = memory.filter(|_| self.failures == 0).map(|memory| memory.left_from_right);
        let search = match trusted {
            Some(map) if self.params.roi => self.search_regions(&map, sizes).unwrap_or(whole),
            _ => whole,
        };
        let shrink = if self.params.roi { self.params.shrink.max(1) } else { 1 };
        detect(&mut self.sides, [left, right], search, shrink, pool);
        let [left, right] = &self.sides;
        let (left, right) = (&left.features, &right.features);
        let gate = trusted
            .filter(|_| self.params.gate_px > 0.0)
            .map(|left_from_right| Gate { left_from_right, radius_px: self.params.gate_px });
        self.matcher.match_features(left, right, &self.params.matching, gate.as_ref(), pool, &mut self.matches);
        let mut result = Registration {
            points: (left.len(), right.len()),
            matches: self.matches.len(),
            roi_left: whole[0],
            roi_right: whole[1],
            ..Registration::default()
        };
        match self.estimate(trusted, sizes) {
            Some(found) => {
                self.failures = 0;
                self.memory = Some(Memory { left_from_right: found.left_from_right, sizes });
                let (roi_left, roi_right) = overlap_rois(&found.left_from_right, sizes[0], sizes[1]);
                result = Registration {
                    left_from_right: found.left_from_right,
                    state: RegistrationState::Fresh,
                    inliers: found.inliers,
                    rms_px: found.rms_px,
                    kept: found.kept,
                    roi_left,
                    roi_right,
                    ..result
                };
            }
            None => {
                self.failures += 1;
                self.mask.clear();
                self.mask.resize(self.matches.len(), false);
                result.refused_rms_px = self.refused_rms_px;
                if let Some(memory) = memory {
                    result.left_from_right = memory.left_from_right;
                    if self.failures <= self.params.hold_frames {
                        result.state = RegistrationState::Held;
                    }
                }
            }
        }
        result
    }

    fn search_regions(&self, map: &Homography, sizes: [(usize, usize); 2]) -> Option<[Rect; 2]> {
        let (left, right) = overlap_rois(map, sizes[0], sizes[1]);
        let least = LEAST_ROI_PX * self.params.shrink.max(1);
        let fits = |roi: &Rect| roi.width >= least && roi.height >= least;
        let margin = self.params.roi_margin_px;
        (fits(&left) && fits(&right))
            .then(|| [left.grown(margin, sizes[0].0, sizes[0].1), right.grown(margin, sizes[1].0, sizes[1].1)])
    }

    fn estimate(&mut self, trusted: Option<Homography>, sizes: [(usize, usize); 2]) -> Option<Estimate> {
        self.refused_rms_px = None;
        self.from.clear();
        self.to.clear();
        // No frame has more matches than keypoints: the lists grow once.
        let most = self.params.surf.max_points.max(self.matches.len());
        self.from.reserve(most);
        self.to.reserve(most);
        self.mask.reserve(most.saturating_sub(self.mask.len()));
        self.matches.reserve(most - self.matches.len());
        self.ransac.reserve(most);
        self.stability.reserve(most, self.params.calm);
        let [left, right] = &self.sides;
        for found in &self.matches {
            self.to.push(left.features.keypoints.position(found.left as usize));
            self.from.push(right.features.keypoints.position(found.right as usize));
        }
        let params = &self.params;
        let fit = self.ransac.estimate(&self.from, &self.to, &params.ransac, &mut self.mask).ok()?;
        if fit.inliers < params.min_inliers.max(4) || !params.plausibility.accepts(&fit.homography, sizes[1]) {
            return None;
        }
        let stable = StabilityParams {
            stability_px: params.stability_px,
            still_tolerance: STILL_TOLERANCE,
            outlier_px: params.ransac.threshold_px,
            calm: params.calm,
            max_rms_px: params.max_rms_px,
        };
        let chosen = self.stability.choose(&fit, trusted, sizes[1], (&self.from, &self.to, &self.mask), &stable);
        // That of the map which goes out, not of the fit: the map before may have been kept, and calming moves it.
        let rms_px = rms_of(&chosen.homography, &self.from, &self.to, &self.mask);
        if params.max_rms_px > 0.0 && rms_px > params.max_rms_px {
            self.refused_rms_px = Some(rms_px);
            return None;
        }
        Some(Estimate { left_from_right: chosen.homography, inliers: fit.inliers, rms_px, kept: chosen.kept })
    }
}

/// Finds the features of both views, one view per thread: two long chunks meet once, many short ones at the end of every loop.
fn detect(sides: &mut [Side; 2], views: [View<'_, u8>; 2], search: [Rect; 2], shrink: usize, pool: &dyn Parallel) {
    // More threads than views help inside the loops; results do not depend on who runs them.
    let inner: &dyn Parallel = if pool.threads() > sides.len() { pool } else { &Serial };
    let shared = SharedMut::new(&mut sides[..]);
    pool.run(views.len(), &|index| {
        // SAFETY: every chunk has its own side.
        let side = unsafe { &mut shared.part(index, 1)[0] };
        side.surf.detect_and_describe(views[index], Some(search[index]), shrink, inner, &mut side.features);
    });
}

struct Estimate {
    left_from_right: Homography,
    inliers: usize,
    rms_px: f64,
    kept: bool,
}
