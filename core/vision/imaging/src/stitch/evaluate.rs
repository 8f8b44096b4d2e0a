//! Quality of a panorama by comparison with ground truth.
//!
//! Structural similarity after Z. Wang, A. Bovik, H. Sheikh, E. Simoncelli, "Image quality assessment", IEEE TIP 13
//! (2004), with square windows. Panorama and ground truth may differ by one gain, which is removed first, because a
//! composite may use the exposure of either view.

use crate::View;
use crate::geometry::{Homography, Point};

/// Side of a window of the structural similarity, px.
const WINDOW: usize = 8;
/// Distance between windows, px.
const STRIDE: usize = 4;

/// A gray image of floats, row after row.
#[derive(Clone, Debug, Default)]
pub struct Gray {
    /// Levels 0..=255.
    pub data: Vec<f32>,
    /// Columns, in pixels.
    pub width: usize,
    /// Rows, in pixels.
    pub height: usize,
}

impl Gray {
    /// Luma of a BGR image.
    pub fn of_bgr(view: View<'_, u8>) -> Self {
        let mut data = Vec::with_capacity(view.width * view.height);
        for y in 0..view.height {
            let luma = |p: &[u8]| 0.114 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.299 * f32::from(p[2]);
            data.extend(view.row(y).chunks_exact(3).map(luma));
        }
        Self { data, width: view.width, height: view.height }
    }
}

/// Similarity of two images inside a region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionSimilarity {
    /// Peak signal-to-noise ratio, dB.
    pub psnr_db: f64,
    /// Mean structural similarity, 1 at most; NaN when no window lies in the region.
    pub ssim: f64,
    /// Pixels compared.
    pub pixels: usize,
}

/// Compares `picture` with `truth` where `region` is true; both have its size. `None` when it is empty.
pub fn likeness(picture: &Gray, truth: &Gray, region: &[bool]) -> Option<RegionSimilarity> {
    let inside = || region.iter().zip(picture.data.iter().zip(&truth.data)).filter(|(r, _)| **r).map(|(_, pair)| pair);
    let (mut pixels, mut cross, mut square) = (0usize, 0.0f64, 0.0f64);
    for (&p, &t) in inside() {
        pixels += 1;
        cross += f64::from(p) * f64::from(t);
        square += f64::from(p) * f64::from(p);
    }
    if pixels == 0 {
        return None;
    }
    let gain = if square > 0.0 { (cross / square) as f32 } else { 1.0 };
    let error: f64 = inside().map(|(&p, &t)| f64::from(p * gain - t).powi(2)).sum::<f64>() / pixels as f64;
    let psnr_db = 10.0 * (255.0f64.powi(2) / error.max(1e-9)).log10();
    Some(RegionSimilarity { psnr_db, ssim: ssim(picture, truth, region, gain), pixels })
}

fn ssim(picture: &Gray, truth: &Gray, region: &[bool], gain: f32) -> f64 {
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    let (width, height) = (picture.width, picture.height);
    let (mut sum, mut windows) = (0.0, 0usize);
    for y in (0..(height + 1).saturating_sub(WINDOW)).step_by(STRIDE) {
        for x in (0..(width + 1).saturating_sub(WINDOW)).step_by(STRIDE) {
            let (mut a, mut b, mut aa, mut bb, mut ab, mut whole) = (0.0f64, 0.0f64, 0.0f64, 0.0f64, 0.0f64, true);
            for row in y..y + WINDOW {
                let at = row * width + x;
                if !region[at..at + WINDOW].iter().all(|r| *r) {
                    whole = false;
                    break;
                }
                for (p, t) in picture.data[at..at + WINDOW].iter().zip(&truth.data[at..at + WINDOW]) {
                    let (p, t) = (f64::from(p * gain), f64::from(*t));
                    (a, b, aa, bb, ab) = (a + p, b + t, aa + p * p, bb + t * t, ab + p * t);
                }
            }
            if !whole {
                continue;
            }
            let n = (WINDOW * WINDOW) as f64;
            let (ma, mb) = (a / n, b / n);
            let (va, vb, cab) = (aa / n - ma * ma, bb / n - mb * mb, ab / n - ma * mb);
            sum += (2.0 * ma * mb + c1) * (2.0 * cab + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
            windows += 1;
        }
    }
    if windows == 0 { f64::NAN } else { sum / windows as f64 }
}

/// Marks the pixels within `reach` px (in rows and columns) of a change between two views in `shown` (0: none).
pub fn seam_band(shown: View<'_, u8>, reach: usize) -> Vec<bool> {
    let (width, height) = (shown.width, shown.height);
    let mut seam = vec![false; width * height];
    for y in 0..height {
        for x in 0..width {
            let here = shown.row(y)[x];
            let differs = |other: u8| here != 0 && other != 0 && here != other;
            if (x + 1 < width && differs(shown.row(y)[x + 1])) || (y + 1 < height && differs(shown.row(y + 1)[x])) {
                seam[y * width + x] = true;
            }
        }
    }
    let mut wide = vec![false; width * height];
    for y in 0..height {
        for x in 0..width {
            if seam[y * width + x] {
                wide[y * width + x.saturating_sub(reach)..y * width + (x + reach + 1).min(width)].fill(true);
            }
        }
    }
    let mut band = vec![false; width * height];
    for y in 0..height {
        for near in y.saturating_sub(reach)..(y + reach + 1).min(height) {
            let (from, to) = (&wide[near * width..(near + 1) * width], &mut band[y * width..(y + 1) * width]);
            from.iter().zip(to).for_each(|(from, to)| *to |= from);
        }
    }
    band
}

/// Marks the canvas pixels that both views reach; `left_at` is where the left view lies on the canvas.
pub fn overlap(
    canvas: (usize, usize),
    left_at: (i32, i32),
    left: (usize, usize),
    right: (usize, usize),
    left_from_right: &Homography,
) -> Vec<bool> {
    let mut region = vec![false; canvas.0 * canvas.1];
    let Some(back) = left_from_right.inverse() else { return region };
    for (y, row) in region.chunks_exact_mut(canvas.0.max(1)).enumerate() {
        for (x, flag) in row.iter_mut().enumerate() {
            let (u, v) = (x as f64 - f64::from(left_at.0), y as f64 - f64::from(left_at.1));
            if u < 0.0 || v < 0.0 || u >= left.0 as f64 || v >= left.1 as f64 {
                continue;
            }
            let [a, b] = back.map([u, v]);
            *flag = a >= 0.0 && b >= 0.0 && a <= right.0 as f64 - 1.0 && b <= right.1 as f64 - 1.0;
        }
    }
    region
}

/// True correspondences of a view next to the left one with a parallel axis.
#[derive(Clone, Copy, Debug)]
pub struct TruePairs<'a> {
    /// Disparity of the left view, px; NaN where it is unknown.
    pub disparity: View<'a, f32>,
    /// 255 where the other view sees the same point; without it all points inside its frame count.
    pub visible: Option<View<'a, u8>>,
    /// Position of the other camera, in units of the baseline: the point at `(u, v)` is at `(u, v) - disparity * along`
    /// in its view.
    pub along: [f64; 2],
    /// Spacing of the compared pixels.
    pub step: usize,
}

impl TruePairs<'_> {
    /// Position in the other view and in the left one of the point at a pixel of the left view, if both see it.
    pub(super) fn at(&self, x: usize, y: usize) -> Option<(Point, Point)> {
        let (width, height) = (self.disparity.width, self.disparity.height);
        if x >= width || y >= height {
            return None;
        }
        let d = f64::from(self.disparity.row(y)[x]);
        let left = [x as f64, y as f64];
        let other = [left[0] - d * self.along[0], left[1] - d * self.along[1]];
        let inside =
            other[0] >= 0.0 && other[1] >= 0.0 && other[0] <= width as f64 - 1.0 && other[1] <= height as f64 - 1.0;
        // NaN is not inside.
        let seen = self.visible.is_none_or(|v| v.row(y)[x] != 0) && inside;
        seen.then_some((other, left))
    }

    /// Position in the other view and in the left one of each point that both see.
    pub(super) fn iter(&self) -> impl Iterator<Item = (Point, Point)> + '_ {
        let step = self.step.max(1);
        let (width, height) = (self.disparity.width, self.disparity.height);
        let rows = (step / 2..height).step_by(step);
        rows.flat_map(move |y| (step / 2..width).step_by(step).map(move |x| (x, y))).filter_map(|(x, y)| self.at(x, y))
    }

    /// Root mean square distance between mapped and true positions of the points that both views see, px of the left
    /// view, and how many there are; `None` when there are none.
    pub fn alignment(&self, left_from_other: &Homography) -> Option<(f64, usize)> {
        let (mut squares, mut count) = (0.0, 0usize);
        for (other, left) in self.iter() {
            squares += left_from_other.squared_error(other, left);
            count += 1;
        }
        (count > 0).then(|| ((squares / count as f64).sqrt(), count))
    }

    /// Lower bound of the alignment of any homography under parallax: that of the best fit to the true pairs. `None`
    /// for fewer than four pairs in general position.
    pub fn floor_px(&self) -> Option<f64> {
        let (from, to): (Vec<Point>, Vec<Point>) = self.iter().unzip();
        let best = Homography::fit(&from, &to, |_| true)?.refine(&from, &to, |_| true, 20);
        self.alignment(&best).map(|(rms, _)| rms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(width: usize, height: usize) -> Gray {
        let data = (0..width * height).map(|i| ((i * 7919 + i / width * 104_729) % 200) as f32).collect();
        Gray { data, width, height }
    }

    #[test]
    fn a_gain_does_not_count_but_noise_does() {
        let truth = texture(64, 48);
        let all = vec![true; 64 * 48];
        let darker = Gray { data: truth.data.iter().map(|v| v * 0.8).collect(), ..truth.clone() };
        let same = likeness(&darker, &truth, &all).unwrap();
        assert!(same.psnr_db > 60.0 && same.ssim > 0.999, "{same:?}");
        let noisy = Gray {
            data: truth.data.iter().enumerate().map(|(i, v)| v + (i % 3) as f32 * 20.0).collect(),
            ..truth.clone()
        };
        let worse = likeness(&noisy, &truth, &all).unwrap();
        assert!(worse.psnr_db < 35.0 && worse.ssim < same.ssim, "{worse:?}");
        assert_eq!(likeness(&noisy, &truth, &vec![false; 64 * 48]), None);
    }

    #[test]
    fn the_seam_band_follows_the_change_of_views() {
        let shown: Vec<u8> = (0..20 * 10)
            .map(|i| {
                if i % 20 < 2 {
                    0
                } else if i % 20 < 12 {
                    1
                } else {
                    2
                }
            })
            .collect();
        let band = seam_band(View::new(&shown, 20, 10, 1), 2);
        let row: Vec<usize> = (0..20).filter(|&x| band[3 * 20 + x]).collect();
        assert_eq!(row, [9, 10, 11, 12, 13], "not at the border of the picture");
    }

    #[test]
    fn alignment_is_zero_for_the_truth_of_a_plane() {
        let disparity = vec![40.0f32; 100 * 50];
        let pairs =
            TruePairs { disparity: View::new(&disparity, 100, 50, 1), visible: None, along: [1.0, 0.0], step: 5 };
        let (rms, count) = pairs.alignment(&Homography::translation(40.0, 0.0)).unwrap();
        assert!(rms < 1e-9 && count == 120, "{rms} {count}");
        let (rms, _) = pairs.alignment(&Homography::translation(43.0, 4.0)).unwrap();
        assert!((rms - 5.0).abs() < 1e-9);
        assert!(pairs.floor_px().unwrap() < 1e-6);
    }

    #[test]
    fn a_view_below_is_judged_along_its_own_direction() {
        // Two planes: no homography fits both.
        let disparity: Vec<f32> = (0..100 * 80).map(|i| if i % 100 < 50 { 40.0 } else { 44.0 }).collect();
        let pairs =
            TruePairs { disparity: View::new(&disparity, 100, 80, 1), visible: None, along: [0.5, 1.0], step: 4 };
        let (rms, _) = pairs.alignment(&Homography::translation(21.0, 42.0)).unwrap();
        assert!((rms - 5f64.sqrt()).abs() < 0.05, "{rms}");
        let floor = pairs.floor_px().unwrap();
        assert!(floor > 0.1 && floor < rms, "{floor}");
        let nowhere = TruePairs { along: [0.0, 3.0], ..pairs };
        assert_eq!((nowhere.alignment(&Homography::identity()), nowhere.floor_px()), (None, None));
    }

    #[test]
    fn the_overlap_is_where_both_views_lie() {
        let region = overlap((60, 20), (5, 3), (40, 10), (40, 10), &Homography::translation(15.0, 0.0));
        let row: Vec<usize> = (0..60).filter(|&x| region[5 * 60 + x]).collect();
        assert_eq!((row[0], row[row.len() - 1]), (20, 44));
        assert!(!region[2 * 60 + 30] && !region[13 * 60 + 30]);
    }
}
