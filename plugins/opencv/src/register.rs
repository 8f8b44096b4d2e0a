//! `register_opencv`: the conventional registration with OpenCV's classes (thesis, section 2.2).

use opencv::calib3d::{RANSAC, find_homography_ext};
use opencv::core::{Mat, Point2d, Size, Vector};
use opencv::imgproc::{self, INTER_LINEAR_EXACT};
use opencv::prelude::*;
use panoscope_imaging::geometry::{Homography as Map, Plausibility, RmsWatch};
use panoscope_node::abi::{self, Homography};
use panoscope_node::{Context, Gray8, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, View};

use crate::detector::{Detector, FoundFeatures};
use crate::mats::{Threads, borrowed, failed};

/// Parameters of the registration.
#[derive(Params, Clone, PartialEq)]
pub struct RegisterParams {
    /// Kind of features.
    #[param(default = "sift")]
    detector: Detector,
    /// Maximum number of keypoints per view, strongest first; 0 uses OpenCV's default.
    #[param(default = 0, range = 0..=100_000, unit = "points")]
    max_points: u32,
    /// Threshold of the detector; 0 uses OpenCV's default (0.04, 0.001, 20).
    #[param(default = 0.0, range = 0.0..=1000.0)]
    threshold: f64,
    /// Size to which larger views are reduced for the search, in megapixels; 0 searches at full resolution. OpenCV's stitcher uses 0.6.
    #[param(default = 0.0, range = 0.0..=10.0, step = 0.05)]
    work_megapixels: f64,
    /// Maximum ratio of the best to the second-best distance of a match.
    #[param(default = 0.75, range = 0.3..=1.0, step = 0.01, unit = "ratio")]
    ratio: f32,
    /// Keeps a match only when each point is the other's best. Matches in both directions, which takes twice as long.
    #[param(default = true)]
    mutual: bool,
    /// Maximum reprojection error of an inlier.
    #[param(default = 3.0, range = 0.2..=20.0, step = 0.1, unit = "px")]
    ransac_px: f64,
    /// Minimum number of inliers of a registration.
    #[param(default = 8, range = 4..=1000, unit = "points")]
    min_inliers: u32,
    /// Maximum root mean square error of the inliers. A worse homography is not used: the state is lost. 0 uses all.
    #[param(default = 18.0, range = 0.0..=100.0, step = 0.5, unit = "px")]
    max_rms_px: f64,
    /// Number of OpenCV's threads. Applies to the whole process while this node is open.
    #[param(default = 1, range = 1..=64)]
    threads: u32,
}

/// Inputs of the registration.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view; the homography maps to its pixels.
    left: Image<'f, Gray8>,
    /// Right view of the same instant.
    right: Image<'f, Gray8>,
}

/// Outputs of the registration.
#[derive(Ports)]
pub struct Out<'f> {
    /// Maps right-view pixels to left-view pixels; fresh or lost.
    homography: Slot<'f, Homography>,
}

/// The `register_opencv` node.
pub struct RegisterOpencv {
    last: [f64; 9],
    watch: RmsWatch,
    threads: Threads,
}

/// Factor, at most 1, that reduces `pixels` to this many megapixels; 0 megapixels means no reduction.
pub fn shrink(megapixels: f64, pixels: usize) -> f64 {
    if megapixels > 0.0 { (megapixels * 1e6 / pixels.max(1) as f64).sqrt().min(1.0) } else { 1.0 }
}

/// Finds features of a view reduced to `work_megapixels`. Returns positions in pixels of the full view.
fn find(view: View<'_, u8>, params: &RegisterParams) -> opencv::Result<(FoundFeatures, Vec<[f64; 2]>)> {
    let whole = borrowed(view)?;
    let scale = shrink(params.work_megapixels, view.width * view.height);
    let (count, threshold) = (params.max_points as usize, params.threshold);
    let found = if scale < 1.0 {
        let mut small = Mat::default();
        imgproc::resize(&whole, &mut small, Size::default(), scale, scale, INTER_LINEAR_EXACT)?;
        params.detector.find(&small, count, threshold)?
    } else {
        params.detector.find(&whole, count, threshold)?
    };
    // Pixel centres: the middle of the first small pixel is the middle of the patch that it stands for.
    let up = |v: f32| (f64::from(v) + 0.5) / scale - 0.5;
    let places = found.points.iter().map(|p| [up(p.pt().x), up(p.pt().y)]).collect();
    Ok((found, places))
}

struct Fit {
    map: [f64; 9],
    inliers: u32,
    rms_px: f64,
}

fn fit(from: &[[f64; 2]], to: &[[f64; 2]], threshold_px: f64) -> opencv::Result<Option<Fit>> {
    if from.len() < 4 {
        return Ok(None);
    }
    let list = |points: &[[f64; 2]]| points.iter().map(|p| Point2d::new(p[0], p[1])).collect::<Vector<Point2d>>();
    let mut mask = Mat::default();
    let found = find_homography_ext(&list(from), &list(to), RANSAC, threshold_px, &mut mask, 2000, 0.995)?;
    if found.rows() != 3 || found.cols() != 3 {
        return Ok(None);
    }
    let mut map = [0.0; 9];
    for (index, value) in map.iter_mut().enumerate() {
        *value = *found.at_2d::<f64>(index as i32 / 3, index as i32 % 3)?;
    }
    let (mut inliers, mut squares) = (0, 0.0);
    for (index, flag) in mask.data_bytes()?.iter().enumerate() {
        if *flag != 0 {
            inliers += 1;
            squares += Map(map).squared_error(from[index], to[index]);
        }
    }
    Ok(Some(Fit { map, inliers, rms_px: (squares / f64::from(inliers.max(1))).sqrt() }))
}

impl Node for RegisterOpencv {
    const INFO: NodeInfo = NodeInfo::compute(
        "register_opencv",
        "stitch",
        "Finds the homography between two overlapping views with OpenCV: whole frames, brute-force matches, RANSAC.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = RegisterParams;

    fn open(_: &Open<'_>, _: &RegisterParams) -> Result<Self> {
        Ok(Self { last: Map::identity().0, watch: RmsWatch::default(), threads: Threads::hold()? })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &RegisterParams,
    ) -> Result<()> {
        self.threads.set(params.threads)?;
        let (left, places_left) = find(input.left.view(), params).map_err(failed)?;
        let (right, places_right) = find(input.right.view(), params).map_err(failed)?;
        let pairs = params.detector.pairs(&left, &right, params.ratio, params.mutual).map_err(failed)?;
        let from: Vec<_> = pairs.iter().map(|p| places_right[p.right]).collect();
        let to: Vec<_> = pairs.iter().map(|p| places_left[p.left]).collect();
        let size = (input.right.width(), input.right.height());
        let good = fit(&from, &to, params.ransac_px).map_err(failed)?.filter(|found| {
            found.inliers >= params.min_inliers && Plausibility::default().accepts(&Map(found.map), size)
        });
        cx.metric("matches", pairs.len() as f64);
        let limit_px = params.max_rms_px;
        let is_refused = |found: &Fit| limit_px > 0.0 && found.rms_px > limit_px;
        let (rms_px, refused_px) = match &good {
            Some(found) if is_refused(found) => (0.0, Some(found.rms_px)),
            found => (found.as_ref().map_or(0.0, |found| found.rms_px), None),
        };
        self.watch.look(cx, rms_px, refused_px, limit_px);
        let good = good.filter(|found| !is_refused(found));
        out.homography.set(match good {
            Some(found) => {
                self.last = found.map;
                Homography {
                    left_from_right: found.map,
                    rms_px: found.rms_px,
                    inliers: found.inliers,
                    state: abi::STATE_FRESH,
                }
            }
            None => Homography { left_from_right: self.last, rms_px: 0.0, inliers: 0, state: abi::STATE_LOST },
        })
    }
}
