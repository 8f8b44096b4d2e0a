//! A homography fit that is anchored where correspondences are missing.
//!
//! The overlap of two views hardly constrains the far edge of the second view. On curved tissue each choice of inliers fits another
//! plane, and the far corners jump by tens of pixels from frame to frame. This fit adds a few border points to the least-squares problem,
//! which an anchor (the previous frame's map) positions. Inside the overlap the inliers outweigh them.

use super::ransac::RansacFit;
use super::{Homography, Point};

/// Number of anchored border points.
const ANCHORS: usize = 8;

/// Refits homographies; reuses its memory from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct AnchorFit {
    from: Vec<Point>,
    to: Vec<Point>,
}

impl AnchorFit {
    /// Reserves memory for up to `count` inliers and an anchor weight of up to `weight`.
    pub fn reserve(&mut self, count: usize, weight: f64) {
        let most = count + ((weight.max(0.0) * count as f64) as usize).next_multiple_of(ANCHORS) + ANCHORS;
        for list in [&mut self.from, &mut self.to] {
            list.reserve(most.saturating_sub(list.len()));
        }
    }

    /// Refits `found` on its inliers and on border points of a source frame of `size` (width, height in px), whose targets `anchor`
    /// gives. `weight` is the weight of all border points together, relative to that of all inliers together.
    pub fn fit(
        &mut self,
        found: &RansacFit,
        anchor: &Homography,
        weight: f64,
        size: (usize, usize),
        pairs: (&[Point], &[Point], &[bool]),
    ) -> Homography {
        let (from, to, inliers) = pairs;
        self.from.clear();
        self.to.clear();
        for index in (0..from.len()).filter(|&index| inliers[index]) {
            self.from.push(from[index]);
            self.to.push(to[index]);
        }
        let copies = ((weight * found.inliers as f64 / ANCHORS as f64).round() as usize).max(1);
        let (right, bottom) = (size.0.saturating_sub(1) as f64, size.1.saturating_sub(1) as f64);
        let (middle, centre) = (right / 2.0, bottom / 2.0);
        let border: [Point; ANCHORS] = [
            [0.0, 0.0],
            [middle, 0.0],
            [right, 0.0],
            [right, centre],
            [right, bottom],
            [middle, bottom],
            [0.0, bottom],
            [0.0, centre],
        ];
        for point in border {
            for _ in 0..copies {
                self.from.push(point);
                self.to.push(anchor.map(point));
            }
        }
        found.homography.refine(&self.from, &self.to, |_| true, 6)
    }
}

/// The translation that moves the inliers of `map` as `map` does on average: the map of two parallel cameras and a flat scene.
pub fn shift_of(map: &Homography, from: &[Point], inliers: &[bool]) -> Homography {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for (point, _) in from.iter().zip(inliers).filter(|(_, inlier)| **inlier) {
        let [x, y] = map.map(*point);
        sum[0] += x - point[0];
        sum[1] += y - point[1];
        count += 1.0;
    }
    let count = f64::max(count, 1.0);
    Homography([1.0, 0.0, sum[0] / count, 0.0, 1.0, sum[1] / count, 0.0, 0.0, 1.0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_overlap_decides_and_the_far_edge_stays() {
        let truth = Homography([1.0, 0.0, 300.0, 0.0, 1.0, 2.0, 0.0, 0.0, 1.0]);
        // Inliers in the left third of the right view, and a found map that fits them but tilts the far side.
        let from: Vec<Point> = (0..100).map(|i| [f64::from(i % 10) * 20.0, f64::from(i / 10) * 48.0]).collect();
        let to: Vec<Point> = from
            .iter()
            .enumerate()
            .map(|(i, p)| {
                let [x, y] = truth.map(*p);
                [x + if i % 2 == 0 { 0.8 } else { -0.8 }, y + if i % 3 == 0 { 0.9 } else { -0.45 }]
            })
            .collect();
        let mask = vec![true; from.len()];
        let found = Homography::fit(&from, &to, |_| true).expect("a map");
        let fit = RansacFit { homography: found, inliers: from.len(), rms_px: 1.0, iterations: 1 };
        let anchored = AnchorFit::default().fit(&fit, &truth, 0.1, (640, 480), (&from, &to, &mask));
        let distance = |map: &Homography, p: Point| map.squared_error(p, truth.map(p)).sqrt();
        assert!(distance(&anchored, [639.0, 0.0]) < distance(&found, [639.0, 0.0]));
        let error = |map: &Homography| from.iter().zip(&to).map(|(a, b)| map.squared_error(*a, *b)).sum::<f64>();
        assert!(error(&anchored) < error(&found) * 1.1, "the overlap stays aligned");
    }
}
