//! `features_opencv`: keypoints of two views and their matches, as tables.

use opencv::prelude::*;
use panoscope_node::{Context, Gray8, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot, TableData};

use crate::detector::{Detector, FoundFeatures};
use crate::mats::{Threads, borrowed, failed};

/// Parameters of the features.
#[derive(Params, Clone, PartialEq)]
pub struct FeaturesParams {
    /// Kind of features.
    #[param(default = "sift")]
    detector: Detector,
    /// Maximum number of keypoints per view, strongest first; 0 uses OpenCV's default.
    #[param(default = 0, range = 0..=100_000, unit = "points")]
    max_points: u32,
    /// Threshold of the detector; 0 uses OpenCV's default (0.04, 0.001, 20).
    #[param(default = 0.0, range = 0.0..=1000.0)]
    threshold: f64,
    /// Maximum ratio of the best to the second-best distance of a match.
    #[param(default = 0.8, range = 0.3..=1.0, step = 0.01, unit = "ratio")]
    ratio: f32,
    /// Keeps a match only when each point is the other's best.
    #[param(default = true)]
    mutual: bool,
    /// Number of OpenCV's threads. Applies to the whole process while this node is open.
    #[param(default = 1, range = 1..=64)]
    threads: u32,
}

/// Inputs of the features.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view, or the only one.
    left: Image<'f, Gray8>,
    /// Right view, of any size. Without it no matches are made.
    right: Option<Image<'f, Gray8>>,
}

/// Outputs of the features.
#[derive(Ports)]
pub struct Out<'f> {
    /// Keypoints of the left view, strongest first.
    left_points: Slot<'f, TableData>,
    /// Keypoints of the right view.
    right_points: Slot<'f, TableData>,
    /// Matches: row numbers in both tables.
    matches: Slot<'f, TableData>,
}

/// The `features_opencv` node.
pub struct FeaturesOpencv {
    threads: Threads,
}

fn rows(found: &FoundFeatures) -> Vec<f64> {
    let row = |p: &opencv::core::KeyPoint| [p.pt().x, p.pt().y, p.size(), p.angle(), p.response()].map(f64::from);
    found.points.iter().flat_map(row).collect()
}

impl Node for FeaturesOpencv {
    const INFO: NodeInfo = NodeInfo::compute(
        "features_opencv",
        "stitch",
        "Finds and matches SIFT, AKAZE or ORB features of two views with OpenCV.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = FeaturesParams;

    fn open(_: &Open<'_>, _: &FeaturesParams) -> Result<Self> {
        Ok(Self { threads: Threads::hold()? })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &FeaturesParams,
    ) -> Result<()> {
        const POINTS: [&str; 5] = ["x_px", "y_px", "size_px", "angle_deg", "response"];
        self.threads.set(params.threads)?;
        let find = |view: &Image<'_, Gray8>| {
            let image = borrowed(view.view()).map_err(failed)?;
            params.detector.find(&image, params.max_points as usize, params.threshold).map_err(failed)
        };
        let left = find(&input.left)?;
        out.left_points.set_table(&POINTS, &rows(&left))?;
        let Some(right) = &input.right else { return Ok(()) };
        let right = find(right)?;
        let pairs = params.detector.pairs(&left, &right, params.ratio, params.mutual).map_err(failed)?;
        cx.metric("matches", pairs.len() as f64);
        out.right_points.set_table(&POINTS, &rows(&right))?;
        let values: Vec<f64> = pairs
            .iter()
            .flat_map(|p| [p.left as f64, p.right as f64, f64::from(p.distance), f64::from(p.ratio)])
            .collect();
        out.matches.set_table(&["left_index", "right_index", "distance", "ratio"], &values)
    }
}
