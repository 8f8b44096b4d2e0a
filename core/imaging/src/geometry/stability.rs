//! A homography that does not jitter (thesis, chapter 4, Algorithm 2).

use super::homography::{Homography, Point};

/// The homography to use for this frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stabilized {
    /// The previous or the refitted map.
    pub homography: Homography,
    /// Whether the previous one stayed.
    pub kept: bool,
}

/// Median reprojection error of `map` on the selected pairs, in pixels; `None` when none is selected.
///
/// For an even number the lower of the two middle ones is taken. `work` is overwritten and keeps its memory.
pub fn median_error(
    map: &Homography,
    from: &[Point],
    to: &[Point],
    select: impl Fn(usize) -> bool,
    work: &mut Vec<f64>,
) -> Option<f64> {
    work.clear();
    let pairs = from.iter().zip(to).enumerate().filter(|(index, _)| select(*index));
    work.extend(pairs.map(|(_, (&from, &to))| map.squared_error(from, to)));
    if work.is_empty() {
        return None;
    }
    let middle = (work.len() - 1) / 2;
    let (_, median, _) = work.select_nth_unstable_by(middle, f64::total_cmp);
    Some(median.sqrt())
}

/// Whether `previous` explains the pairs about as well as `fresh` does.
///
/// On curved tissue many planes fit equally well, and noise alone makes RANSAC choose another one in every frame. Both maps are
/// charged the squared error of each pair, at most that of an outlier (MSAC; Torr and Zisserman 2000); `previous` may cost
/// more by the share `tolerance`.
pub fn explains_as_well(
    previous: &Homography,
    fresh: &Homography,
    from: &[Point],
    to: &[Point],
    threshold_px: f64,
    tolerance: f64,
) -> bool {
    let most = threshold_px * threshold_px;
    // `min` also turns the NaN of a point on the horizon into the cost of an outlier.
    let cost =
        |map: &Homography| from.iter().zip(to).map(|(&from, &to)| map.squared_error(from, to).min(most)).sum::<f64>();
    cost(previous) <= cost(fresh) * (1.0 + tolerance)
}

/// Keeps `previous` while its median error on the new inliers is below `threshold_px`; otherwise refits on them.
///
/// `fresh` is the map RANSAC found; it is used when the refit fails. `inlier` picks the pairs.
pub fn stabilize(
    previous: Option<&Homography>,
    fresh: &Homography,
    from: &[Point],
    to: &[Point],
    inlier: impl Fn(usize) -> bool,
    threshold_px: f64,
    work: &mut Vec<f64>,
) -> Stabilized {
    if let Some(previous) = previous {
        let median = median_error(previous, from, to, &inlier, work);
        if median.is_some_and(|median| median < threshold_px) {
            return Stabilized { homography: *previous, kept: true };
        }
    }
    let refit = Homography::fit(from, to, &inlier).map(|map| map.refine(from, to, &inlier, 5));
    Stabilized { homography: refit.unwrap_or(*fresh), kept: false }
}
