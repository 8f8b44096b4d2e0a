//! `panoscope eval disparity`.

use std::path::PathBuf;

use panoscope_eval::eval::disparity::{self, GraphRequest, Options, Pair};

use panoscope_cli::given::Given;

/// Arguments of `eval disparity`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph that is judged beside our chains, as chain `graph`: the pair of each case takes the place of its source.
    graph: Option<PathBuf>,
    /// The graph's disparity, where it has several.
    #[arg(long, value_name = "NODE.PORT", default_value = "", hide_default_value = true, requires = "graph")]
    disparity: String,
    /// Sets a parameter of the graph. May be given again.
    #[arg(long, value_name = "NODE.PARAM=VALUE", requires = "graph")]
    set: Vec<String>,
    #[command(flatten)]
    given: Given,
    /// Only these cases; may be given again. Without it all.
    #[arg(long, value_parser = disparity::CASES)]
    case: Vec<String>,
    /// Folder of data sets, searched before the usual ones. May be given again.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    #[command(flatten)]
    pair: OwnPair,
    /// Folder for pictures of disparities and errors.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
}

/// The user's own pair.
#[derive(clap::Args)]
struct OwnPair {
    /// Left view of a pair of your own, rectified unless --rectify is given.
    #[arg(long, value_name = "FILE", requires = "right")]
    left: Option<PathBuf>,
    /// Right view of the same instant.
    #[arg(long, value_name = "FILE", requires = "left")]
    right: Option<PathBuf>,
    /// Truth for the left view: disparity or depth as PFM, NPY, f32 TIFF or PNG, points as XYZ or PLY (left rectified camera,
    /// mm). Without it only the consistency of left and right is judged.
    #[arg(long, value_name = "FILE", requires = "left")]
    truth: Option<PathBuf>,
    /// The truth is depth in mm, not disparity in px.
    #[arg(long, requires = "truth")]
    depth: bool,
    /// What a PNG's values are divided by: 1 for whole px, 256 as KITTI has it. 0 is unknown.
    #[arg(long, default_value_t = 1.0)]
    truth_scale: f32,
    /// Calibration of the pair, for depth, points and --rectify. May be given twice: two halves.
    #[arg(long, value_name = "FILE")]
    calibration: Vec<PathBuf>,
    /// Rectifies the pair first.
    #[arg(long, requires = "calibration")]
    rectify: bool,
    /// Smallest disparity searched, px.
    #[arg(long, default_value_t = 0, allow_hyphen_values = true)]
    first_px: i32,
    /// Width of the disparity search, px: a multiple of 16.
    #[arg(long, default_value_t = 128)]
    search_px: usize,
}

impl Arguments {
    /// What the library judges.
    pub fn options(&self) -> Options {
        let pair = |given: &OwnPair| {
            Some(Pair {
                left: given.left.clone()?,
                right: given.right.clone()?,
                truth: given.truth.clone(),
                truth_is_depth: given.depth,
                truth_scale: given.truth_scale,
                calibration: given.calibration.clone(),
                rectify: given.rectify,
                first_px: given.first_px,
                search_px: given.search_px,
            })
        };
        Options {
            graph: self.graph.clone().map(|path| GraphRequest {
                path,
                given: self.given.options(&self.set),
                disparity: self.disparity.clone(),
            }),
            cases: self.case.clone(),
            data: self.data.clone(),
            pair: pair(&self.pair),
            pictures: self.pictures.clone(),
        }
    }
}
