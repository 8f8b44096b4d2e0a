//! OpenCV's engines as nodes, so that they can be compared with Panoscope's inside one graph.
//!
//! The steps are those of OpenCV's `stitching_detailed` sample; like our nodes, these keep the canvas constant over time.

mod calibrate;
mod composite;
mod detector;
mod features;
mod find_board;
mod mats;
mod register;
mod stereo;

pub use calibrate::CalibrateStereo;
pub use composite::CompositeOpencv;
pub use features::FeaturesOpencv;
pub use find_board::FindBoard;
pub use register::RegisterOpencv;
pub use stereo::{DisparityFbsOpencv, DisparityWlsOpencv, StereoOpencv};

panoscope_node::export_plugin![
    FeaturesOpencv,
    RegisterOpencv,
    CompositeOpencv,
    StereoOpencv,
    DisparityWlsOpencv,
    DisparityFbsOpencv,
    CalibrateStereo,
    FindBoard
];
