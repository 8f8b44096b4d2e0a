//! Whether a homography can belong to two views of one scene (thesis, section 2.4.3).

use super::homography::{Homography, Point};

/// Bounds on a warped frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plausibility {
    /// Least area of the warped frame over that of the frame.
    pub min_area_ratio: f64,
    /// Largest area of the warped frame over that of the frame.
    pub max_area_ratio: f64,
    /// Least length of each warped side over that of the frame's side.
    pub min_side_ratio: f64,
    /// Largest length of each warped side over that of the frame's side.
    pub max_side_ratio: f64,
}

impl Default for Plausibility {
    fn default() -> Self {
        Self { min_area_ratio: 0.2, max_area_ratio: 5.0, min_side_ratio: 0.3, max_side_ratio: 3.0 }
    }
}

impl Plausibility {
    /// Whether the warped frame of `size` (width, height) is a convex quadrilateral of plausible size that is not mirrored.
    pub fn accepts(&self, map: &Homography, size: (usize, usize)) -> bool {
        let (width, height) = (size.0 as f64 - 1.0, size.1 as f64 - 1.0);
        let Some(corners) = map.map_corners(size.0, size.1) else {
            return false;
        };
        if width < 1.0 || height < 1.0 || !is_convex(&corners) {
            return false;
        }
        let within = |value: f64, low: f64, high: f64| value >= low && value <= high;
        let area = area(&corners) / (width * height);
        within(area, self.min_area_ratio, self.max_area_ratio)
            && (0..4).all(|i| {
                let (a, b) = (corners[i], corners[(i + 1) % 4]);
                let side = (a[0] - b[0]).hypot(a[1] - b[1]) / if i % 2 == 0 { width } else { height };
                within(side, self.min_side_ratio, self.max_side_ratio)
            })
    }
}

/// Whether the corners turn the same way all round, clockwise as seen with y down.
pub fn is_convex(corners: &[Point; 4]) -> bool {
    (0..4).all(|i| {
        let (a, b, c) = (corners[i], corners[(i + 1) % 4], corners[(i + 2) % 4]);
        (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) > 0.0
    })
}

/// Area of a quadrilateral, positive when its corners run clockwise as seen with y down.
pub fn area(corners: &[Point; 4]) -> f64 {
    (0..4)
        .map(|i| {
            let (a, b) = (corners[i], corners[(i + 1) % 4]);
            a[0] * b[1] - b[0] * a[1]
        })
        .sum::<f64>()
        * 0.5
}
