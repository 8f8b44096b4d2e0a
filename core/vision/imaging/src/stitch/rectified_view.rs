//! A camera and its rectification.

use crate::geometry::Point;
use crate::shrink::shrunk_px;
use crate::stereo::Lens;

/// One camera and its rectification, with the parameters that map a pixel of the rectified view back to the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RectifiedView {
    /// Columns and rows of the image.
    pub size: (usize, usize),
    /// Focal lengths of the camera, px.
    pub focal_px: [f64; 2],
    /// Principal point of the camera, px.
    pub centre_px: [f64; 2],
    /// Lens of the camera.
    pub lens: Lens,
    /// Rotation from the camera's axes to the rectified ones, row by row.
    pub rectified_from_camera: [f64; 9],
    /// Focal lengths of the rectified view, px.
    pub rectified_focal_px: [f64; 2],
    /// Principal point of the rectified view, px.
    pub rectified_centre_px: [f64; 2],
}

impl RectifiedView {
    /// Whether the camera's image is the rectified view.
    pub fn is_straight(&self) -> bool {
        let same = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        self.lens == Lens::NONE
            && self.rectified_from_camera == same
            && self.focal_px == self.rectified_focal_px
            && self.centre_px == self.rectified_centre_px
    }

    /// Position in the camera's image of a pixel of the rectified view; not finite if the camera cannot see it.
    pub fn unrectify(&self, [u, v]: Point) -> Point {
        let (x, y) = (
            (u - self.rectified_centre_px[0]) / self.rectified_focal_px[0],
            (v - self.rectified_centre_px[1]) / self.rectified_focal_px[1],
        );
        let r = &self.rectified_from_camera;
        // The inverse of a rotation is its transpose.
        let (a, b, c) = (r[0] * x + r[3] * y + r[6], r[1] * x + r[4] * y + r[7], r[2] * x + r[5] * y + r[8]);
        if c <= 0.0 {
            return [f64::NAN; 2];
        }
        let (dx, dy) = self.lens.distort(a / c, b / c);
        [self.focal_px[0] * dx + self.centre_px[0], self.focal_px[1] * dy + self.centre_px[1]]
    }

    /// The same camera with an image that is smaller by a whole factor, each pixel the mean of a block.
    pub fn shrunk(&self, factor: usize) -> Self {
        let px = |length: f64| length / factor as f64;
        let at = |centre: Point| centre.map(|at| shrunk_px(at, factor));
        Self {
            size: (self.size.0 / factor, self.size.1 / factor),
            focal_px: self.focal_px.map(px),
            centre_px: at(self.centre_px),
            rectified_focal_px: self.rectified_focal_px.map(px),
            rectified_centre_px: at(self.rectified_centre_px),
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shrink::enlarged_px;

    #[test]
    fn a_small_camera_sees_the_same_points() {
        let (sin, cos) = 0.03f64.sin_cos();
        let large = RectifiedView {
            size: (1920, 1080),
            focal_px: [2200.0, 2210.0],
            centre_px: [950.0, 548.0],
            lens: Lens::of_coefficients(&[-0.2, 0.05, 0.001, -0.002]).unwrap(),
            rectified_from_camera: [cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos],
            rectified_focal_px: [2150.0; 2],
            rectified_centre_px: [900.0, 540.0],
        };
        let small = large.shrunk(3);
        for at in [[0.0, 0.0], [700.0, 300.0], [1900.0, 1000.0]] {
            let [expected, found] = [large.unrectify(at), small.unrectify(at.map(|px| shrunk_px(px, 3)))];
            assert!((0..2).all(|k| (enlarged_px(found[k], 3) - expected[k]).abs() < 1e-6));
        }
    }
}
