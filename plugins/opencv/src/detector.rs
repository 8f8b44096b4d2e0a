//! OpenCV's detectors with a limit on the number of points, and its brute-force matcher.

use opencv::core::{DMatch, KeyPoint, Mat, NORM_HAMMING, NORM_L2, ToInputArray, Vector, no_array};
use opencv::features2d::{AKAZE, AKAZE_DescriptorType, BFMatcher, KAZE_DiffusivityType, ORB, ORB_ScoreType, SIFT};
use opencv::prelude::*;
use panoscope_node::Choice;

/// Kind of features that OpenCV detects.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detector {
    /// SIFT: differences of Gaussians, 128 floats.
    Sift,
    /// AKAZE: nonlinear scale space, binary descriptor.
    Akaze,
    /// ORB: corners, binary descriptor.
    Orb,
}

/// Keypoints of a view and their descriptors, strongest first, one descriptor per row.
pub struct FoundFeatures {
    /// Position and size of each point, px.
    pub points: Vec<KeyPoint>,
    /// One row per point.
    pub descriptors: Mat,
}

/// A match of two keypoints.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    /// Index in the left features.
    pub left: usize,
    /// Index in the right features.
    pub right: usize,
    /// Distance of the descriptors, in OpenCV's measure.
    pub distance: f32,
    /// Ratio of that distance to the second-best one; 0 when there is no second.
    pub ratio: f32,
}

/// The rows of a matrix with the indices `order`, in that order.
fn rows_of(all: &Mat, order: &[usize]) -> opencv::Result<Mat> {
    if order.is_empty() {
        return Ok(Mat::default());
    }
    let mut out = Mat::new_rows_cols_with_default(order.len() as i32, all.cols(), all.typ(), 0.0.into())?;
    let width = all.cols() as usize * all.elem_size()?;
    let bytes = all.data_bytes()?;
    for (row, &index) in out.data_bytes_mut()?.chunks_exact_mut(width.max(1)).zip(order) {
        row.copy_from_slice(&bytes[index * width..][..width]);
    }
    Ok(out)
}

impl Detector {
    /// Detects and describes at most `max_points` (0: OpenCV's default). `threshold` 0 is OpenCV's default.
    ///
    /// # Errors
    /// OpenCV's.
    pub fn find(self, image: &impl ToInputArray, max_points: usize, threshold: f64) -> opencv::Result<FoundFeatures> {
        let (mut points, mut descriptors) = (Vector::<KeyPoint>::new(), Mat::default());
        let count = i32::try_from(max_points).unwrap_or(i32::MAX);
        let or = |default: f64| if threshold > 0.0 { threshold } else { default };
        match self {
            // SIFT counts before it knows the orientations, of which a place may have several.
            Self::Sift => SIFT::create(count, 3, or(0.04), 10.0, 1.6)?.detect_and_compute(
                image,
                &no_array(),
                &mut points,
                &mut descriptors,
                false,
            )?,
            Self::Akaze => AKAZE::create(
                AKAZE_DescriptorType::DESCRIPTOR_MLDB,
                0,
                3,
                or(0.001) as f32,
                4,
                4,
                KAZE_DiffusivityType::DIFF_PM_G2,
            )?
            .detect_and_compute(image, &no_array(), &mut points, &mut descriptors, false)?,
            Self::Orb => {
                let count = if count == 0 { 500 } else { count };
                ORB::create(count, 1.2, 8, 31, 0, 2, ORB_ScoreType::HARRIS_SCORE, 31, or(20.0) as i32)?
                    .detect_and_compute(image, &no_array(), &mut points, &mut descriptors, false)?;
            }
        }
        let points = points.to_vec();
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by(|&a, &b| points[b].response().total_cmp(&points[a].response()).then(a.cmp(&b)));
        if max_points > 0 {
            order.truncate(max_points);
        }
        let strongest = order.iter().map(|&index| points[index].clone()).collect();
        Ok(FoundFeatures { points: strongest, descriptors: rows_of(&descriptors, &order)? })
    }

    /// Matches descriptors with the ratio test, and requires each point to be the other's best when `mutual`.
    ///
    /// # Errors
    /// OpenCV's.
    pub fn pairs(
        self,
        left: &FoundFeatures,
        right: &FoundFeatures,
        ratio: f32,
        mutual: bool,
    ) -> opencv::Result<Vec<Pair>> {
        if left.points.is_empty() || right.points.is_empty() {
            return Ok(Vec::new());
        }
        let matcher = BFMatcher::new(if self == Self::Sift { NORM_L2 } else { NORM_HAMMING }, false)?;
        let mut forward = Vector::<Vector<DMatch>>::new();
        matcher.knn_train_match_def(&left.descriptors, &right.descriptors, &mut forward, 2)?;
        let mut best_left = Vec::new();
        if mutual {
            let mut backward = Vector::<DMatch>::new();
            matcher.train_match_def(&right.descriptors, &left.descriptors, &mut backward)?;
            best_left = vec![usize::MAX; right.points.len()];
            for back in &backward {
                best_left[back.query_idx as usize] = back.train_idx as usize;
            }
        }
        let mut pairs = Vec::new();
        for candidates in &forward {
            let Ok(best) = candidates.get(0) else { continue };
            let second = candidates.get(1).map_or(f32::INFINITY, |second| second.distance);
            let (a, b) = (best.query_idx as usize, best.train_idx as usize);
            let share = if second > 0.0 { best.distance / second } else { 1.0 };
            if share < ratio && (!mutual || best_left[b] == a) {
                pairs.push(Pair { left: a, right: b, distance: best.distance, ratio: share });
            }
        }
        Ok(pairs)
    }
}
