//! Finds surgical instruments: boxes, masks, tips.
//!
//! `yolo` runs a detector, `mask_rcnn` a segmenting model; both read common exports through ONNX Runtime. `onnx` runs any other network according to
//! a table, `stereo_net` the stereo network that ships. `tool_tip` finds the tip of the instrument in their results, `tip_track` follows it over
//! time. `skill` measures how skilfully tips are moved, `proximity` their distance to tissue and to each other; `evaluate_proximity` evaluates its
//! warnings, `evaluate_detections` boxes.

pub mod calibration;
pub mod candidates;
pub mod evaluate_detections;
pub mod evaluate_proximity;
pub mod export_kind;
pub mod finite;
pub mod hidden_jaw;
pub mod image_input;
pub mod keypoints;
pub mod labels;
pub mod letterbox;
pub mod mask_rcnn;
pub mod model;
pub mod onnx;
pub mod onnx_file;
pub mod pictures;
pub mod provider;
pub mod proximity;
pub mod runtime_library;
pub mod second_view;
pub mod session;
pub mod shaft;
pub mod silhouette;
pub mod skill;
pub mod stereo_net;
pub mod tip_map;
pub mod tip_position;
pub mod tip_track;
pub mod tool_tip;
pub mod track;
pub mod views;
pub mod yolo;

use panoscope_node::export_plugin;

export_plugin![
    yolo::Yolo,
    mask_rcnn::MaskRcnn,
    onnx::Onnx,
    stereo_net::StereoNet,
    tool_tip::ToolTip,
    tip_track::TipTrack,
    skill::Skill,
    proximity::Proximity,
    evaluate_proximity::EvaluateProximity,
    evaluate_detections::EvaluateDetections,
];
