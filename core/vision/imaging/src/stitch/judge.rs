//! Compares a panorama with the image of a wide camera, and a registration with correspondences, for evaluations of
//! composites.

use super::correspond::{CorrespondParams, correspondences};
use super::evaluate::{Gray, RegionSimilarity, likeness, overlap, seam_band};
use super::placement::{Placement, ghost_pct};
use crate::geometry::{Homography, Point, Ransac, RansacParams};
use crate::{Parallel, View};

/// Maximum distance of a correct correspondence from every plane, px.
const CORRELATED_REACH_PX: f64 = 12.0;
/// Radius in which the ground truth may contain the content shown along the seam, pixels.
const GHOST_REACH_PX: usize = 2;
/// Differences below this count as noise and shading, levels.
const GHOST_LEVELS: f32 = 16.0;

/// Comparison of a placement with correspondences found by correlation; NaN if there are too few.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrelatedMarks {
    /// Root mean square distance of the placement from them, px of the left view.
    pub align_px: f64,
    /// Root mean square distance of the best-fitting plane, because tissue is not planar.
    pub floor_px: f64,
    /// Number of correspondences.
    pub points: usize,
}

/// Compares a placement with correspondences found by correlation in the views (BGR).
pub fn correlated(placed: &Placement, left: View<'_, u8>, right: View<'_, u8>, pool: &dyn Parallel) -> CorrelatedMarks {
    let (left, right) = (Gray::of_bgr(left), Gray::of_bgr(right));
    let found = correspondences(&left, &right, &CorrespondParams::default(), pool);
    let (from, to): (Vec<Point>, Vec<Point>) = found.iter().map(|pair| (pair.right, pair.left)).unzip();
    let mut inliers = Vec::new();
    // Wide: parallax is no mistake of the correlation, but the far end of the picture is.
    let loose = RansacParams { threshold_px: CORRELATED_REACH_PX, ..RansacParams::default() };
    let Ok(fit) = Ransac::new().estimate(&from, &to, &loose, &mut inliers) else {
        return CorrelatedMarks { align_px: f64::NAN, floor_px: f64::NAN, points: 0 };
    };
    let best = fit.homography.refine(&from, &to, |index| inliers[index], 20);
    let kept = || (0..from.len()).filter(|index| inliers[*index]);
    let floor = kept().map(|index| best.squared_error(from[index], to[index])).sum::<f64>();
    let errors = kept().filter_map(|index| placed.error_px(from[index], to[index]));
    let (squares, count) = errors.fold((0.0, 0usize), |(sum, count), error| (sum + error * error, count + 1));
    CorrelatedMarks {
        align_px: (squares / count.max(1) as f64).sqrt(),
        floor_px: (floor / fit.inliers.max(1) as f64).sqrt(),
        points: fit.inliers,
    }
}

/// A panorama drawn by a composite.
#[derive(Clone, Copy, Debug)]
pub struct DrawnPanorama<'a> {
    /// The image, BGR.
    pub picture: View<'a, u8>,
    /// Column and row at which the left view begins in it.
    pub left_at: (i32, i32),
    /// View that each pixel shows: 0 none, 1 the left one. Compared only if it has the image's size.
    pub shown: Option<View<'a, u8>>,
}

/// Image of one wide camera at the left camera's position.
#[derive(Clone, Copy, Debug)]
pub struct WideTruth<'a> {
    /// The image, BGR.
    pub picture: View<'a, u8>,
    /// Column and row at which the left view begins in it.
    pub left_at: (i32, i32),
}

/// Comparison of a panorama with the wide ground truth; `None` if there is nothing to compare.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PictureMarks {
    /// In the overlap of both views.
    pub whole: Option<RegionSimilarity>,
    /// Along the seam.
    pub seam: Option<RegionSimilarity>,
    /// Share of the band along the seam whose content is not nearby in the ground truth, percent.
    pub ghost_pct: Option<f64>,
}

/// The part of the wide ground truth under the panorama; false in the mask outside it.
fn truth_on_canvas(wide: &WideTruth<'_>, left_at: (i32, i32), size: (usize, usize)) -> (Gray, Vec<bool>) {
    let all = Gray::of_bgr(wide.picture);
    let mut out = Gray { data: vec![0.0; size.0 * size.1], width: size.0, height: size.1 };
    let mut known = vec![false; size.0 * size.1];
    let shift = [wide.left_at.0 - left_at.0, wide.left_at.1 - left_at.1].map(i64::from);
    for y in 0..size.1 {
        let v = y as i64 + shift[1];
        if v < 0 || v >= all.height as i64 {
            continue;
        }
        for x in 0..size.0 {
            let u = x as i64 + shift[0];
            if u >= 0 && u < all.width as i64 {
                out.data[y * size.0 + x] = all.data[v as usize * all.width + u as usize];
                known[y * size.0 + x] = true;
            }
        }
    }
    (out, known)
}

/// Compares a panorama with the wide ground truth in the overlap of two views of these sizes, and within `band_px` of
/// the seam there.
pub fn compare_pictures(
    panorama: &DrawnPanorama<'_>,
    wide: &WideTruth<'_>,
    [left, right]: [(usize, usize); 2],
    left_from_right: &Homography,
    band_px: usize,
) -> PictureMarks {
    let size = (panorama.picture.width, panorama.picture.height);
    let (truth, known) = truth_on_canvas(wide, panorama.left_at, size);
    let mut region = overlap(size, panorama.left_at, left, right, left_from_right);
    region.iter_mut().zip(&known).for_each(|(r, known)| *r &= known);
    let picture = Gray::of_bgr(panorama.picture);
    let whole = likeness(&picture, &truth, &region);
    let seam = panorama.shown.filter(|s| (s.width, s.height) == size).and_then(|shown| {
        let mut band = seam_band(shown, band_px);
        band.iter_mut().zip(&region).for_each(|(b, r)| *b &= r);
        let ghosts = ghost_pct(&picture, &truth, &band, GHOST_REACH_PX, GHOST_LEVELS);
        Some((likeness(&picture, &truth, &band)?, ghosts?))
    });
    PictureMarks { whole, seam: seam.map(|(likeness, _)| likeness), ghost_pct: seam.map(|(_, ghosts)| ghosts) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panorama_of_the_truth_is_the_truth_and_one_that_is_off_is_not() {
        let (width, height) = (120, 60);
        let wave = |x: f64, y: f64| (120.0 + 60.0 * (0.5 * x).sin() + 30.0 * (0.3 * y).sin()) as u8;
        let drawn = |shift: f64, size: (usize, usize), at: (i32, i32)| -> Vec<u8> {
            let place = |i: usize| ((i % size.0) as f64 - f64::from(at.0), (i / size.0) as f64 - f64::from(at.1));
            (0..size.0 * size.1).flat_map(|i| [wave(place(i).0 + shift, place(i).1); 3]).collect()
        };
        let (canvas, wide) = ((width + 40, height + 4), (width + 80, height + 20));
        let truth = drawn(0.0, wide, (10, 10));
        let wide = WideTruth { picture: View::new(&truth, wide.0, wide.1, 3), left_at: (10, 10) };
        let shown: Vec<u8> = (0..canvas.0 * canvas.1).map(|i| if i % canvas.0 < 80 { 1 } else { 2 }).collect();
        let marks = |shift: f64| {
            let picture = drawn(shift, canvas, (2, 2));
            let panorama = DrawnPanorama {
                picture: View::new(&picture, canvas.0, canvas.1, 3),
                left_at: (2, 2),
                shown: Some(View::new(&shown, canvas.0, canvas.1, 1)),
            };
            let map = Homography::translation(40.0, 0.0);
            compare_pictures(&panorama, &wide, [(width, height); 2], &map, 8)
        };
        let (same, off) = (marks(0.0), marks(5.0));
        assert!(same.whole.unwrap().ssim > 0.999 && same.seam.unwrap().ssim > 0.999, "{same:?}");
        assert_eq!(same.ghost_pct, Some(0.0));
        assert!(off.seam.unwrap().ssim < 0.8 && off.whole.unwrap().ssim < 0.8, "{off:?}");
    }
}
