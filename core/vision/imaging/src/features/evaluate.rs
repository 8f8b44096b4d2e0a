//! Quality of keypoints and matches under a known homography, for any detector.
//!
//! Repeatability after K. Mikolajczyk, C. Schmid, "Scale and affine invariant interest point detectors",
//! IJCV 60 (2004), with distances of centres instead of region overlaps.

use crate::geometry::{Homography, Point};

/// Number of keypoints of one image that are found again in the other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Repeatability {
    /// One-to-one pairs closer than the tolerance.
    pub repeated: usize,
    /// The smaller of the numbers of keypoints visible in both images.
    pub possible: usize,
    /// `repeated / possible`, 0 when none are possible.
    pub share: f64,
}

/// Share of correct matches.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Precision {
    /// Matches within the tolerance of the ground truth.
    pub correct: usize,
    /// Number of evaluated matches.
    pub total: usize,
    /// `correct / total`, 0 when there are none.
    pub share: f64,
}

fn share(part: usize, whole: usize) -> f64 {
    if whole == 0 { 0.0 } else { part as f64 / whole as f64 }
}

fn inside(point: Point, size: (usize, usize)) -> bool {
    point[0] >= 0.0 && point[1] >= 0.0 && point[0] <= size.0 as f64 - 1.0 && point[1] <= size.1 as f64 - 1.0
}

/// Share of keypoints seen by both images that have a partner within `tolerance_px` of the second image.
///
/// `second_from_first` is the ground truth; sizes are (width, height). Only keypoints whose counterpart is in the other
/// image are counted. Pairs are one to one, nearest first.
pub fn repeatability(
    first: &[Point],
    second: &[Point],
    second_from_first: &Homography,
    first_size: (usize, usize),
    second_size: (usize, usize),
    tolerance_px: f64,
) -> Repeatability {
    let Some(first_from_second) = second_from_first.inverse() else {
        return Repeatability::default();
    };
    let projected: Vec<Point> =
        first.iter().map(|&point| second_from_first.map(point)).filter(|&point| inside(point, second_size)).collect();
    let mut visible: Vec<Point> =
        second.iter().copied().filter(|&point| inside(first_from_second.map(point), first_size)).collect();
    visible.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut pairs = Vec::new();
    for (i, point) in projected.iter().enumerate() {
        let start = visible.partition_point(|other| other[0] < point[0] - tolerance_px);
        for (j, other) in visible.iter().enumerate().skip(start) {
            if other[0] > point[0] + tolerance_px {
                break;
            }
            let squared = (other[0] - point[0]).powi(2) + (other[1] - point[1]).powi(2);
            if squared <= tolerance_px * tolerance_px {
                pairs.push((squared, i, j));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let (mut first_used, mut second_used) = (vec![false; projected.len()], vec![false; visible.len()]);
    let mut repeated = 0;
    for (_, i, j) in pairs {
        if !first_used[i] && !second_used[j] {
            (first_used[i], second_used[j]) = (true, true);
            repeated += 1;
        }
    }
    let possible = projected.len().min(visible.len());
    Repeatability { repeated, possible, share: share(repeated, possible) }
}

/// Share of matches (index in `first`, index in `second`) within `tolerance_px` of the ground truth.
///
/// Distances are measured in the second image. Indices out of range count as wrong.
pub fn precision(
    first: &[Point],
    second: &[Point],
    matches: &[(usize, usize)],
    second_from_first: &Homography,
    tolerance_px: f64,
) -> Precision {
    let right = |&&(i, j): &&(usize, usize)| match (first.get(i), second.get(j)) {
        (Some(&from), Some(&to)) => second_from_first.squared_error(from, to) <= tolerance_px * tolerance_px,
        _ => false,
    };
    let correct = matches.iter().filter(right).count();
    Precision { correct, total: matches.len(), share: share(correct, matches.len()) }
}
