//! Rectification, disparity, depth and measurement (thesis, chapter 3); maps and clouds beside the truth.

mod coarse;
mod colours;
mod evaluate;
mod filter;
pub mod gpu;
mod matcher;
mod measure;
mod order;
mod rectify;
mod reproject;
mod shrinking;
mod shrunk;
mod stereo_bm;
mod stereo_sgbm;

pub use evaluate::{EvaluateCloud, EvaluateDepth, EvaluateDisparity};
pub use filter::{DisparityFbs, DisparityWls};
pub use measure::Measure;
pub use rectify::Rectify;
pub use reproject::Reproject;
pub use stereo_bm::StereoBm;
pub use stereo_sgbm::StereoSgbm;

panoscope_node::export_plugin![
    Rectify,
    StereoBm,
    StereoSgbm,
    DisparityWls,
    DisparityFbs,
    Reproject,
    Measure,
    EvaluateDisparity,
    EvaluateDepth,
    EvaluateCloud,
];
