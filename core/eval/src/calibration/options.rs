//! What is calibrated, and how.

use std::path::PathBuf;

use panoscope_data::calibration::Board;

/// Options of [`calibrate`](super::calibrate).
#[derive(Clone, Debug)]
pub struct Options {
    /// Left views: images (a folder, dir/*.png, img_%04d.png, in quotes), a video, a camera or a GStreamer pipeline; with
    /// --graph a port such as scope.left.
    pub left: String,
    /// The same for the right views.
    pub right: String,
    /// Takes the views from the ports of this graph.
    pub graph: Option<PathBuf>,
    /// The printed board: chessboard:9x6:25mm (inner corners), circles:4x11:20mm (asymmetric), circle_grid:7x6:10mm or
    /// charuco:19x26:5mm:4mm:4x4_250 (squares, square, marker, dictionary).
    pub board: Board,
    /// Distortion that is solved for: radial (k1 k2), standard (k1 k2 p1 p2), full (and k3), rational (k1 to k6), equidistant (k1 to k4
    /// of a fisheye); auto is standard, or full or rational where these explain views left out better.
    pub model: String,
    /// Pairs that are looked at; of a video, a camera or a live graph 300 unless given.
    pub frames: Option<u64>,
    /// Keeps views whose error stands out.
    pub keep_all: bool,
    /// Whose steps are taken: own, or sample, those of OpenCV's sample stereo_calib with all views and its model.
    pub method: String,
}

impl Options {
    /// Arguments for views of `board`, with the defaults.
    pub fn new(left: &str, right: &str, board: Board) -> Self {
        Self {
            left: left.to_owned(),
            right: right.to_owned(),
            graph: None,
            board,
            model: "auto".into(),
            frames: None,
            keep_all: false,
            method: "own".into(),
        }
    }
}
