//! `panoscope calibrate`: both cameras from views of a printed board.

use std::path::PathBuf;

use anyhow::Result;
use panoscope_data::calibration::{Board, packet};
use panoscope_eval::calibration::{self, Options, Source};
use panoscope_eval::chain;

use crate::session::Terminal;
use panoscope_cli::End;
use panoscope_cli::terminal::{log, out, raw};

/// Arguments of `calibrate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Left views: images (a folder, dir/*.png, img_%04d.png, in quotes), a video, a camera or a GStreamer pipeline;
    /// with
    /// --graph a port such as scope.left.
    #[arg(long, value_name = "FILES|PORT")]
    left: String,
    /// Right views, in the same forms.
    #[arg(long, value_name = "FILES|PORT")]
    right: String,
    /// Takes the views from the ports of this graph.
    #[arg(long, value_name = "GRAPH")]
    graph: Option<PathBuf>,
    /// The printed board: chessboard:9x6:25mm (inner corners), circles:4x11:20mm (asymmetric), circle_grid:7x6:10mm or
    /// charuco:19x26:5mm:4mm:4x4_250 (squares, square, marker, dictionary).
    #[arg(long)]
    board: Board,
    /// The result, as OpenCV's FileStorage YAML.
    #[arg(long, short, value_name = "FILE.yml", default_value = "calibration.yml")]
    out: PathBuf,
    /// Folder for images: coverage, rows after rectification, corners of the last view.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Distortion that is solved for: radial (k1 k2), standard (k1 k2 p1 p2), full (and k3), rational (k1 to k6),
    /// equidistant (k1 to k4 of a fisheye); auto is standard, or full or rational if these explain left-out views better.
    #[arg(long, default_value = "auto", value_parser = ["auto", "radial", "standard", "full", "rational", "equidistant"])]
    model: String,
    /// Maximum number of pairs; default for a video, a camera or a live graph: 300.
    #[arg(long, value_parser = clap::value_parser!(u64).range(5..))]
    frames: Option<u64>,
    /// Keeps views with outlying errors.
    #[arg(long)]
    keep_all: bool,
    /// Method: own, or sample for the steps of OpenCV's sample stereo_calib with all views and its model.
    #[arg(long, default_value = "own", value_parser = ["own", "sample"])]
    method: String,
}

impl Arguments {
    fn options(&self) -> Options {
        Options {
            left: self.left.clone(),
            right: self.right.clone(),
            graph: self.graph.clone(),
            board: self.board,
            model: self.model.clone(),
            frames: self.frames,
            keep_all: self.keep_all,
            method: self.method.clone(),
        }
    }
}

/// Calibrates, and shows and writes the result.
pub fn run(arguments: &Arguments) -> Result<End> {
    panoscope_cli::interrupt::listen();
    let options = arguments.options();
    let source = match Source::of(&Terminal, &options) {
        Ok(source) => source,
        Err(error) => {
            log!("error: {}", chain(&error));
            return Ok(End::Wrong);
        }
    };
    let calibrated = calibration::calibrate(&Terminal, &options, &source)?;
    let views = &calibrated.views;
    views.skipped().iter().for_each(|line| log!("{line}"));
    let calibration = match &calibrated.calibration {
        Ok(calibration) => calibration,
        Err(reason) => {
            log!("error: {reason}");
            return Ok(End::Failed);
        }
    };
    if let Some(folder) = &arguments.pictures {
        calibrated.write_pictures(folder)?;
    }
    panoscope_data::calibration::write(&arguments.out, calibration)?;
    raw(&views.table());
    out!("");
    raw(&calibration::summary(calibration, views));
    let rectified = packet::rectification(calibration)?;
    out!("rectified  {:.2} px focal length, baseline {:.3} mm", rectified.left.focal_px, rectified.baseline_mm);
    out!("written    {}", arguments.out.display());
    Ok(End::Done)
}
