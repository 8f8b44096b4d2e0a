//! Disparity maps smaller than the images that they belong to: the depth of large images is computed on small ones.
//!
//! Pixel `i` of a map that is smaller by a factor `n` covers the pixels `n i` to `n i + n - 1` of the image, and
//! counts disparity in its own pixels.

use crate::geometry::Homography;

/// Factor by which a disparity map is smaller than an image; `None` if the sizes are not related by a whole factor.
pub fn map_factor(map: (usize, usize), picture: (usize, usize)) -> Option<usize> {
    let factor = picture.0.checked_div(map.0)?;
    (factor > 0 && (picture.0 / factor, picture.1 / factor) == map).then_some(factor)
}

/// Converts a map between small images to one between large images.
pub(super) fn enlarged(small: &Homography, factor: usize) -> Homography {
    within(small, factor as f64)
}

/// Converts a map between large images to one between small images.
pub(super) fn shrunk(large: &Homography, factor: usize) -> Homography {
    within(large, 1.0 / factor as f64)
}

/// The same map between images whose pixels are smaller by a factor.
fn within(map: &Homography, factor: f64) -> Homography {
    let shift = |px: f64| Homography::translation(px, px);
    let there = shift(0.5).product(map).product(&shift(-0.5));
    let [to, from] = [factor, 1.0 / factor].map(Homography::scaling);
    shift(-0.5).product(&to).product(&there).product(&from).product(&shift(0.5))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shrink::{enlarged_px, shrunk_px};

    #[test]
    fn a_map_belongs_to_pictures_that_are_larger_by_a_whole_factor() {
        assert_eq!(map_factor((640, 480), (640, 480)), Some(1));
        assert_eq!(map_factor((640, 360), (1920, 1080)), Some(3));
        assert_eq!(map_factor((640, 360), (1921, 1082)), Some(3), "what no block covers is left out");
        assert_eq!(map_factor((640, 480), (1920, 1080)), None);
        assert_eq!(map_factor((1280, 720), (1920, 1080)), None);
        assert_eq!(map_factor((1920, 1080), (640, 360)), None);
        assert_eq!(map_factor((0, 0), (640, 360)), None);
    }

    #[test]
    fn a_small_map_says_the_same_as_the_large_one() {
        let large = Homography([1.02, 0.01, 310.0, -0.02, 0.98, 7.0, 1e-5, -2e-5, 1.0]);
        let small = shrunk(&large, 3);
        for at in [[0.0, 0.0], [500.0, 300.0], [1500.0, 1000.0]] {
            let there = small.map(at.map(|px| shrunk_px(px, 3))).map(|px| enlarged_px(px, 3));
            let [expected, back] = [large.map(at), enlarged(&small, 3).map(at)];
            assert!((0..2).all(|k| (there[k] - expected[k]).abs() < 1e-6 && (back[k] - expected[k]).abs() < 1e-6));
        }
    }
}
