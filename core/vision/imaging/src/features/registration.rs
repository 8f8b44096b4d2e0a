//! Registration of two views by SURF, on whole frames or on the last known overlap (thesis, chapter 2, Alg. 2.2).

use super::matching::{Gate, Match, MatchParams, Matcher};
use super::strips::{Search, Sizes, Strips, narrow, narrow_surf};
use super::surf::{Features, Surf, SurfParams};
use crate::Rect;
use crate::geometry::narrow::{ALONG, NarrowParams, fit_narrow};
use crate::geometry::ransac::{Ransac, RansacFit, RansacParams};
use crate::geometry::{
    Homography, Plausibility, Point, RegistrationState, Stability, StabilityParams, Stabilized, overlap_rois, rms_of,
};
use crate::{Parallel, Serial, SharedMut, View};

/// Minimum width of an overlap for the larger filters; below it the next search covers whole frames.
const MIN_ROI_PX: usize = 48;
/// Minimum number of inliers in a narrow overlap; fewer agree on a shift by chance.
const MIN_NARROW_INLIERS: usize = 8;
/// The previous homography is also kept while its error on the matches is larger by at most this share.
const STILL_TOLERANCE: f64 = 0.1;

/// Parameters of the registration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegisterParams {
    /// Features of both views.
    pub surf: SurfParams,
    /// Whether the overlap of the previous frame is searched, shrunk; otherwise whole frames at full size.
    pub roi: bool,
    /// Shrink factor k of the search regions when `roi` is on (2 at 640x480).
    pub shrink: usize,
    /// Matching.
    pub matching: MatchParams,
    /// Radius in which matches are searched around the position predicted from the previous frame, in pixels; 0:
    /// everywhere.
    pub gate_px: f32,
    /// Robust estimation; the threshold is in full-frame pixels.
    pub ransac: RansacParams,
    /// Inliers below which a homography is rejected; at least 4 (thesis 2.4.3).
    pub min_inliers: usize,
    /// Plausibility limits of a warped frame.
    pub plausibility: Plausibility,
    /// The homography is kept while its median error on the new inliers is below this (chapter 4, Algorithm 2), in
    /// pixels; 0: refit every frame.
    pub stability_px: f64,
    /// Weight of the previous frame (of a plain shift in the first frame) relative to all inliers, 0..=4: parameters
    /// that the overlap does not determine, above all the far corners, then move slowly instead of jumping with every
    /// change of inliers. 0 uses the inliers alone.
    pub anchor_fit: f64,
    /// Maximum rms error of the inliers, px, above which a homography is rejected; 0 accepts all.
    pub max_rms_px: f64,
    /// Failed frames in a row for which the previous homography counts as held rather than lost.
    pub hold_frames: usize,
    /// Widens both search regions, in pixels.
    pub roi_margin_px: usize,
    /// Whether overlaps narrower than a quarter of a view are searched too: when whole views fail, a pair of facing
    /// sides is searched in the same frame, at full size; after that only the overlap, and an affine map near a shift
    /// replaces the homography. Only with `roi`.
    pub strips: bool,
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
            anchor_fit: 0.0,
            max_rms_px: 0.0,
            hold_frames: 0,
            roi_margin_px: 8,
            strips: false,
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
    /// The error for which this frame's homography was rejected, px.
    pub refused_rms_px: Option<f64>,
    /// Overlap in the left frame (the next search region); the whole frame unless fresh.
    pub roi_left: Rect,
    /// Overlap in the right frame.
    pub roi_right: Rect,
    /// Whether the homography is the previous frame's, kept by the stability test.
    pub kept: bool,
    /// Whether it was estimated on a narrow overlap.
    pub is_narrow: bool,
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
    strips: Strips,
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

/// State kept from a good frame.
#[derive(Clone, Copy, Debug)]
struct Memory {
    left_from_right: Homography,
    sizes: [(usize, usize); 2],
}

impl RegisterSurf {
    /// A registration without history.
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
            strips: Strips::default(),
            memory: None,
            failures: 0,
            refused_rms_px: None,
        }
    }

    /// The parameters that were last set.
    pub fn params(&self) -> &RegisterParams {
        &self.params
    }

    /// Changes the parameters and keeps the state of the previous frame.
    pub fn set_params(&mut self, params: RegisterParams) {
        self.params = params;
        for side in &mut self.sides {
            side.surf.set_params(params.surf);
        }
    }

    /// Clears the state of the previous frame.
    pub fn reset(&mut self) {
        self.memory = None;
        self.failures = 0;
        self.strips.reset();
    }

    /// Keypoints and descriptors of the last frame pair, left and right.
    pub fn features(&self) -> (&Features, &Features) {
        (&self.sides[0].features, &self.sides[1].features)
    }

    /// Matches of the last frame pair, and which of them agree with the homography (all false when it failed).
    pub fn matches(&self) -> (&[Match], &[bool]) {
        (&self.matches, &self.mask)
    }

    /// Registers one pair of views (gray or BGR). Allocates only for larger frames than before.
    ///
    /// A failure is a state, not an error: the next frame searches whole frames and so resumes.
    pub fn register(&mut self, left: View<'_, u8>, right: View<'_, u8>, pool: &dyn Parallel) -> Registration {
        let sizes = [(left.width, left.height), (right.width, right.height)];
        let whole = [Rect::new(0, 0, left.width, left.height), Rect::new(0, 0, right.width, right.height)];
        let memory = self.memory.filter(|memory| memory.sizes == sizes);
        let trusted = memory.filter(|_| self.failures == 0).map(|memory| memory.left_from_right);
        let gate = trusted
            .filter(|_| self.params.gate_px > 0.0)
            .map(|left_from_right| Gate::circle(left_from_right, self.params.gate_px));
        let shrink = if self.params.roi { self.params.shrink.max(1) } else { 1 };
        let overlap = trusted.filter(|_| self.params.roi).and_then(|map| self.overlap_search(&map, gate, sizes));
        let first = overlap.unwrap_or(Search { regions: whole, shrink, gate, is_narrow: false });
        let mut found = self.search(&first, [left, right], trusted, sizes, pool);
        if overlap.is_none() && self.params.roi && self.params.strips {
            let last = memory.map(|memory| memory.left_from_right);
            found = self.search_narrow(found, last.as_ref(), [left, right], sizes, pool);
        }
        let [left, right] = &self.sides;
        let mut result = Registration {
            points: (left.features.len(), right.features.len()),
            matches: self.matches.len(),
            roi_left: whole[0],
            roi_right: whole[1],
            ..Registration::default()
        };
        match found {
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
                    is_narrow: found.is_narrow,
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

    /// The search of the overlap under `map`; `None` if it is too small.
    fn overlap_search(&self, map: &Homography, gate: Option<Gate>, sizes: Sizes) -> Option<Search> {
        if let Some(search) = narrow(map, sizes).filter(|_| self.params.strips) {
            return Some(search);
        }
        let (left, right) = overlap_rois(map, sizes[0], sizes[1]);
        let shrink = self.params.shrink.max(1);
        let least = MIN_ROI_PX * shrink;
        let fits = |roi: &Rect| roi.width >= least && roi.height >= least;
        let margin = self.params.roi_margin_px;
        let regions = (fits(&left) && fits(&right))
            .then(|| [left.grown(margin, sizes[0].0, sizes[0].1), right.grown(margin, sizes[1].0, sizes[1].1)])?;
        Some(Search { regions, shrink, gate, is_narrow: false })
    }

    /// Returns the result of a search of whole views, unless it failed or found a narrow overlap, for which it is
    /// unreliable: then searches that overlap, or a pair of strips, at full size.
    fn search_narrow(
        &mut self,
        whole: Option<Estimate>,
        last: Option<&Homography>,
        views: [View<'_, u8>; 2],
        sizes: Sizes,
        pool: &dyn Parallel,
    ) -> Option<Estimate> {
        let mut found = whole;
        if let Some(estimate) = &found {
            let Some(overlap) = narrow(&estimate.left_from_right, sizes) else { return found };
            found = self.search(&overlap, views, None, sizes, pool);
        }
        if found.is_some() {
            return found;
        }
        let strips = self.strips.choose(last, sizes)?;
        let first = self.search(&strips, views, None, sizes, pool)?;
        // What was found among all keypoints of the strips must be found again in the overlap alone.
        let overlap = narrow(&first.left_from_right, sizes)?;
        self.search(&overlap, views, None, sizes, pool)
    }

    /// Finds, matches and fits within the regions of one search.
    fn search(
        &mut self,
        search: &Search,
        views: [View<'_, u8>; 2],
        trusted: Option<Homography>,
        sizes: Sizes,
        pool: &dyn Parallel,
    ) -> Option<Estimate> {
        let surf = if search.is_narrow { narrow_surf(self.params.surf) } else { self.params.surf };
        self.sides.iter_mut().for_each(|side| side.surf.set_params(surf));
        detect(&mut self.sides, views, search.regions, search.shrink, pool);
        let [left, right] = &self.sides;
        let (left, right) = (&left.features, &right.features);
        let matching = &self.params.matching;
        self.matcher.match_features(left, right, matching, search.gate.as_ref(), pool, &mut self.matches);
        self.estimate(trusted, sizes, search.is_narrow)
    }

    fn estimate(&mut self, trusted: Option<Homography>, sizes: Sizes, is_narrow: bool) -> Option<Estimate> {
        self.refused_rms_px = None;
        self.from.clear();
        self.to.clear();
        // No frame has more matches than keypoints: the lists grow once.
        let points =
            if self.params.strips { narrow_surf(self.params.surf).max_points } else { self.params.surf.max_points };
        let most = points.max(self.matches.len());
        self.from.reserve(most);
        self.to.reserve(most);
        self.mask.reserve(most.saturating_sub(self.mask.len()));
        self.matches.reserve(most - self.matches.len());
        self.ransac.reserve(most);
        self.stability.reserve(most, self.params.anchor_fit);
        let [left, right] = &self.sides;
        for found in &self.matches {
            self.to.push(left.features.keypoints.position(found.left as usize));
            self.from.push(right.features.keypoints.position(found.right as usize));
        }
        let fit = self.fit(is_narrow)?;
        let params = &self.params;
        if fit.inliers < params.min_inliers.max(4) || !params.plausibility.accepts(&fit.homography, sizes[1]) {
            return None;
        }
        let stable = StabilityParams {
            stability_px: params.stability_px,
            still_tolerance: STILL_TOLERANCE,
            outlier_px: params.ransac.threshold_px * if is_narrow { ALONG } else { 1.0 },
            // A narrow overlap leaves the far corners to the model alone, which holds them.
            anchor_fit: if is_narrow { 0.0 } else { params.anchor_fit },
            max_rms_px: params.max_rms_px,
        };
        let chosen = self.stability.choose(&fit, trusted, sizes[1], (&self.from, &self.to, &self.mask), &stable);
        // Error of the returned map, not of the fit: the returned one may be the previous map or anchored at it.
        let rms_px = rms_of(&chosen.homography, &self.from, &self.to, &self.mask);
        if params.max_rms_px > 0.0 && rms_px > params.max_rms_px {
            self.refused_rms_px = Some(rms_px);
            return None;
        }
        let Stabilized { homography: left_from_right, kept } = chosen;
        Some(Estimate { left_from_right, inliers: fit.inliers, rms_px, kept, is_narrow })
    }

    /// The map that most matches agree on; `mask` becomes its inliers.
    fn fit(&mut self, is_narrow: bool) -> Option<RansacFit> {
        let RegisterParams { ransac, min_inliers, .. } = self.params;
        if !is_narrow {
            return self.ransac.estimate(&self.from, &self.to, &ransac, &mut self.mask).ok();
        }
        let narrow = NarrowParams {
            threshold_px: ransac.threshold_px,
            min_inliers: min_inliers.max(MIN_NARROW_INLIERS),
            seed: ransac.seed,
        };
        fit_narrow(&self.from, &self.to, &narrow, &mut self.mask)
    }
}

/// Finds the features of both views, one view per thread: two long chunks synchronise once, many short ones at the end
/// of every loop.
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
    is_narrow: bool,
}
