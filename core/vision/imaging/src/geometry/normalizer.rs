//! Similarity transforms that bring points to unit scale, which conditions the equations built from them.

use super::homography::{Homography, Point};

/// Moves the centroid of points to the origin and scales their mean distance from it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Normalizer {
    x: f64,
    y: f64,
    /// Factor from pixels to normalised units.
    pub scale: f64,
}

impl Normalizer {
    /// The transform after which the selected points have the mean distance `mean_distance` from the origin.
    ///
    /// `None` for fewer than four points, and for points that coincide or are not finite.
    pub fn of(points: &[Point], select: impl Fn(usize) -> bool, mean_distance: f64) -> Option<Self> {
        let chosen = || points.iter().enumerate().filter(|(index, _)| select(*index)).map(|(_, point)| point);
        let (mut count, mut x, mut y) = (0usize, 0.0, 0.0);
        for point in chosen() {
            (count, x, y) = (count + 1, x + point[0], y + point[1]);
        }
        if count < 4 {
            return None;
        }
        (x, y) = (x / count as f64, y / count as f64);
        let mean: f64 = chosen().map(|point| (point[0] - x).hypot(point[1] - y)).sum::<f64>() / count as f64;
        (mean.is_finite() && mean > 1e-9).then(|| Self { x, y, scale: mean_distance / mean })
    }

    /// A point in normalised units.
    pub fn apply(&self, point: Point) -> Point {
        [(point[0] - self.x) * self.scale, (point[1] - self.y) * self.scale]
    }

    /// [`Self::apply`] as a matrix.
    pub fn matrix(&self) -> Homography {
        let s = self.scale;
        Homography([s, 0.0, -s * self.x, 0.0, s, -s * self.y, 0.0, 0.0, 1.0])
    }

    /// The way back to pixels.
    pub fn inverse(&self) -> Homography {
        let s = 1.0 / self.scale;
        Homography([s, 0.0, self.x, 0.0, s, self.y, 0.0, 0.0, 1.0])
    }
}
