//! Inputs of a tracker: rules, and tips as detectors report them.

use nalgebra::Vector3;

use crate::tracking::kalman::Model;

/// Parameters of the tracking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Parameters of the motion and of the gate.
    pub model: Model,
    /// Standard deviation of a tip's position in the image, px.
    pub lateral_px: f64,
    /// Standard deviation of its disparity, px.
    pub disparity_px: f64,
    /// Focal length, px.
    pub focal_px: f64,
    /// Distance of the cameras, mm.
    pub baseline_mm: f64,
    /// Lowest score of a report that is used.
    pub min_score: f64,
    /// Longest prediction of an unseen tip, s.
    pub max_gap_s: f64,
    /// Time without the leading tip, while others are seen, before one of them leads, s.
    pub switch_s: f64,
}

/// Class of a tool whose kind a detector does not know. It is ignored when reports are compared with tracks.
pub const UNKNOWN_CLASS: u32 = u32::MAX;

/// A tip as a detector reports it, in the left camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Position, mm.
    pub xyz_mm: Vector3<f64>,
    /// Confidence of the detector, 0 to 1.
    pub score: f64,
    /// Number of the tool if the detector gives one, else below 0.
    pub track_id: i64,
    /// Class of the tool, by the detector's labels, or [`UNKNOWN_CLASS`].
    pub class_index: u32,
    /// Age of the image in which it was seen, s. `xyz_mm` is relative to the current camera pose, for a tip that has
    /// not moved since.
    pub age_s: f64,
}

/// Seconds from one time to another.
pub fn passed_s(since_ns: i64, now_ns: i64) -> f64 {
    now_ns.saturating_sub(since_ns) as f64 * 1e-9
}
