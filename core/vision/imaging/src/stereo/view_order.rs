//! Which of two views is the left one, by features that both show.
//!
//! A calibration says where a point of one camera appears in the other: on one row of the rectified views, and nearer than infinity. Features are
//! matched without it, so that they obey it for the views as they are given, or for the views exchanged. Unlike the sign of disparities, this also
//! holds for cameras that are turned towards each other: their exchanged views keep positive disparities in part.

use super::camera::CameraModel;
use super::rectify::{Rectification, turn};
use super::view_delay::RowSample;
use crate::features::{Features, GrayBuffer, Match, MatchParams, Matcher, Surf, SurfParams, shrink_gray};
use crate::geometry::median;
use crate::{Parallel, View};

/// Approximate number of columns of the views in which features are looked for.
const COLUMNS: usize = 400;
/// Keypoints of each view.
const KEYPOINTS: usize = 400;
/// Smallest number of pairs that obey a calibration by other means than chance.
const MIN_PAIRS: usize = 12;
/// Smallest share of all pairs that obey the calibration, in percent: views of different scenes match by chance in places.
const MIN_PERCENT: usize = 40;
/// The other order explains at most this share of these pairs, in percent.
const OTHER_PERCENT: usize = 50;
/// Largest vertical distance of a pair that obeys the calibration: this many times the median, and this part of the width; and at least this many of
/// the pixels in which features are found.
const TOLERANCE: (f64, f64, f64) = (3.0, 0.01, 0.5);

/// Which view is which.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// As the calibration has them.
    AsCalibrated,
    /// The first view is that of the right camera.
    Exchanged,
    /// Too few features, or both orders explain them.
    Unknown,
}

/// How features agree with a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderEvidence {
    /// What follows.
    pub order: Order,
    /// Pairs of features.
    pub pairs: usize,
    /// How many of them obey the calibration as the views are given, and exchanged.
    pub fitting: [usize; 2],
}

/// Compares the features of two views with a calibration. Reuses its memory.
#[derive(Debug)]
pub struct ViewOrder {
    surf: Surf,
    matcher: Matcher,
    small: [GrayBuffer; 2],
    factor: usize,
    features: [Features; 2],
    matches: Vec<Match>,
    /// The left view of the next instant.
    next: (GrayBuffer, Features, Vec<Match>),
}

impl Default for ViewOrder {
    fn default() -> Self {
        let surf = SurfParams {
            hessian_threshold: 20.0,
            octaves: 3,
            upright: true,
            max_points: KEYPOINTS,
            spread: (8, 6),
            ..SurfParams::default()
        };
        Self {
            surf: Surf::new(surf),
            matcher: Matcher::new(),
            small: Default::default(),
            factor: 1,
            features: Default::default(),
            matches: Vec::new(),
            next: Default::default(),
        }
    }
}

impl ViewOrder {
    /// Takes shrunk copies of both views, gray or BGR, of one instant and one size.
    pub fn take(&mut self, views: [View<'_, u8>; 2], pool: &dyn Parallel) {
        self.factor = ((views[0].width + COLUMNS / 2) / COLUMNS).max(1);
        for (view, small) in views.into_iter().zip(&mut self.small) {
            shrink_gray(view, self.factor, small, pool);
        }
    }

    /// Finds the features of one of the views that were taken, 0 or 1.
    pub fn find(&mut self, view: usize, pool: &dyn Parallel) {
        self.surf.detect_and_describe(self.small[view].view(), None, 1, pool, &mut self.features[view]);
    }

    /// Compares the features that were found. `cameras` are those of the views as they are given, left and right.
    pub fn compare(
        &mut self,
        cameras: [&CameraModel; 2],
        rectification: &Rectification,
        pool: &dyn Parallel,
    ) -> OrderEvidence {
        let [left, right] = &self.features;
        let unit = self.factor as f64;
        self.matcher.match_features(left, right, &MatchParams::default(), None, pool, &mut self.matches);
        let position = |features: &Features, index: u32| position(features, index, unit);
        let direction = |camera: usize, px: [f64; 2]| direction(cameras, rectification, camera, px);
        let focal_px = rectification.left.focal_px;
        // Rows apart and disparity from infinity on, px, for both orders.
        let mut apart: [Vec<[f64; 2]>; 2] = Default::default();
        for found in &self.matches {
            let (first, second) = (position(left, found.left), position(right, found.right));
            for (apart, [left, right]) in apart.iter_mut().zip([[first, second], [second, first]]) {
                let (left, right) = (direction(0, left), direction(1, right));
                apart.push([(left.1 - right.1) * focal_px, (left.0 - right.0) * focal_px]);
            }
        }
        evaluate(&apart, unit, rectification.width as f64)
    }

    /// Size of the pixels in which features are found, px of the views: about as exact are their positions.
    pub fn unit_px(&self) -> f64 {
        self.factor as f64
    }

    /// Takes a shrunk copy of the left view of the instant after the one that [`Self::take`] was given.
    pub fn take_next(&mut self, left: View<'_, u8>, pool: &dyn Parallel) {
        shrink_gray(left, self.factor, &mut self.next.0, pool);
    }

    /// Follows the pairs of the last comparison into the next left view, which was taken `step_s` later.
    pub fn row_samples(
        &mut self,
        cameras: [&CameraModel; 2],
        rectification: &Rectification,
        step_s: f64,
        pool: &dyn Parallel,
    ) -> Vec<RowSample> {
        let (small, next, followed) = &mut self.next;
        self.surf.detect_and_describe(small.view(), None, 1, pool, next);
        let [left, right] = &self.features;
        self.matcher.match_features(left, next, &MatchParams::default(), None, pool, followed);
        let unit = self.factor as f64;
        let direction = |camera: usize, px: [f64; 2]| direction(cameras, rectification, camera, px);
        let focal_px = rectification.left.focal_px;
        let half = [0.5 * cameras[0].width as f64, 0.5 * cameras[0].height as f64];
        let sample = |found: &Match| {
            let at = followed.binary_search_by_key(&found.left, |followed| followed.left).ok()?;
            let px = position(left, found.left, unit);
            let row = direction(0, px).1;
            Some(RowSample {
                at: [px[0] / half[0] - 1.0, px[1] / half[1] - 1.0],
                rows_px: (row - direction(1, position(right, found.right, unit)).1) * focal_px,
                velocity_px_s: (direction(0, position(next, followed[at].right, unit)).1 - row) * focal_px / step_s,
            })
        };
        self.matches.iter().filter_map(sample).collect()
    }
}

/// Position of a feature in the views, px.
fn position(features: &Features, index: u32, unit: f64) -> [f64; 2] {
    features.keypoints.position(index as usize).map(|px| (px + 0.5) * unit - 0.5)
}

/// Direction of a pixel of one camera in the rectified axes, at depth 1.
fn direction(cameras: [&CameraModel; 2], rectification: &Rectification, camera: usize, [u, v]: [f64; 2]) -> (f64, f64) {
    let rotations = [&rectification.rotation_left, &rectification.rotation_right];
    turn(cameras[camera], rotations[camera], u, v)
}

/// `apart` are rows apart and disparities of the pairs for both orders, px, of views of `width` px, whose features are exact to about `unit` px.
fn evaluate(apart: &[Vec<[f64; 2]>; 2], unit: f64, width: f64) -> OrderEvidence {
    let pairs = apart[0].len();
    let rows = |apart: &Vec<[f64; 2]>| median(&mut apart.iter().map(|[rows, _]| rows.abs()).collect::<Vec<_>>());
    let smaller = apart.iter().map(rows).fold(f64::INFINITY, f64::min);
    let rows_px = (TOLERANCE.0 * smaller).min(TOLERANCE.1 * width).max(TOLERANCE.2 * unit);
    // Points at infinity have none.
    let fits = |[rows, disparity]: &&[f64; 2]| rows.abs() <= rows_px && *disparity >= -unit;
    let fitting = apart.each_ref().map(|apart| apart.iter().filter(fits).count());
    let explains = |order: usize| {
        let (own, other) = (fitting[order], fitting[1 - order]);
        own >= MIN_PAIRS && own * 100 >= pairs * MIN_PERCENT && other * 100 <= own * OTHER_PERCENT
    };
    let order = match (explains(0), explains(1)) {
        (true, _) => Order::AsCalibrated,
        (_, true) => Order::Exchanged,
        _ => Order::Unknown,
    };
    OrderEvidence { order, pairs, fitting }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evidence of pairs with these rows apart and disparities, as given and exchanged.
    fn order(given: [f64; 2], exchanged: [f64; 2], count: usize) -> Order {
        evaluate(&[vec![given; count], vec![exchanged; count]], 1.0, 640.0).order
    }

    #[test]
    fn rows_and_the_sign_of_disparities_decide() {
        assert_eq!(order([0.3, 40.0], [-0.3, -40.0], 30), Order::AsCalibrated);
        assert_eq!(order([0.3, -40.0], [-0.3, 40.0], 30), Order::Exchanged);
        // Turned towards each other: exchanged views keep positive disparities, but not their rows.
        assert_eq!(order([0.5, 40.0], [-17.0, 15.0], 30), Order::AsCalibrated);
        assert_eq!(order([-17.0, 15.0], [0.5, 40.0], 30), Order::Exchanged);
        // A calibration that has drifted by a few rows.
        assert_eq!(order([4.0, 40.0], [-4.0, -40.0], 30), Order::AsCalibrated);
    }

    #[test]
    fn little_or_equal_evidence_decides_nothing() {
        assert_eq!(order([0.3, -40.0], [-0.3, 40.0], 8), Order::Unknown);
        assert_eq!(order([30.0, -40.0], [-30.0, 40.0], 30), Order::Unknown, "no order has its points on rows");
        assert_eq!(order([0.3, 0.0], [-0.3, 0.0], 30), Order::Unknown, "twice the same view");
        assert_eq!(evaluate(&[Vec::new(), Vec::new()], 1.0, 640.0).order, Order::Unknown);
    }
}
