//! What is solved, and what comes of it.

use panoscope_node::abi::{Calibration, Camera};

/// Points of one board seen by both cameras.
#[derive(Clone, Debug)]
pub struct Pair {
    /// Positions on the board, mm.
    pub board_mm: Vec<[f64; 2]>,
    /// Positions in the left and right view, px.
    pub px: [Vec<[f32; 2]>; 2],
}

/// What a procedure finds.
pub struct Found {
    /// Left and right.
    pub cameras: [Camera; 2],
    /// Right camera's axes from the left one's, by rows.
    pub rotation: [f64; 9],
    /// Origin of the left camera in the right one, mm.
    pub translation_mm: [f64; 3],
    /// Reprojection error of all points, px.
    pub rms_px: f64,
    /// That of each view, left and right, px.
    pub errors_px: Vec<[f64; 2]>,
}

/// Both cameras, with the errors of each view.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The calibration with its rectification.
    pub calibration: Calibration,
    /// Root mean square reprojection error of each view, left and right, px.
    pub errors_px: Vec<[f64; 2]>,
    /// Mean distance of matching points from one row after rectification, px.
    pub epipolar_px: Vec<f64>,
}

/// Why there is no solution.
#[derive(Debug)]
pub enum Unsolved {
    /// OpenCV's message.
    OpenCv(opencv::Error),
    /// The camera of the left views stands to the right of the other one.
    Exchanged,
    /// Cameras that no rectification exists for, such as one above the other.
    Impossible(String),
}

impl From<opencv::Error> for Unsolved {
    fn from(error: opencv::Error) -> Self {
        Self::OpenCv(error)
    }
}

impl std::fmt::Display for Unsolved {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::OpenCv(error) => write!(f, "OpenCV: {}", error.message),
            Self::Exchanged => f.write_str(
                "left and right look exchanged, because the camera of the left views stands to the right of the other one. Give the views of the left camera as `left` and those of the right one as `right`",
            ),
            Self::Impossible(why) => f.write_str(why),
        }
    }
}
