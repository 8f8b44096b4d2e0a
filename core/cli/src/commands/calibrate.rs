//! `panoscope calibrate`: both cameras from views of a printed board.
//!
//! The command writes a small graph around the node `calibrate_stereo` and runs it: the framework is its own user.

pub mod plan;
pub mod report;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use panoscope_calibration::{Board, packet};

use crate::End;
use crate::commands::eval::look::{self, Seen};
use crate::terminal::{say, tell};
use plan::{NODE, Source};

/// Arguments of `calibrate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Left views: images (a folder, dir/*.png, img_%04d.png, in quotes), a video, a camera or a GStreamer pipeline; with
    /// --graph a port such as scope.left.
    #[arg(long, value_name = "FILES|PORT")]
    pub left: String,
    /// The same for the right views.
    #[arg(long, value_name = "FILES|PORT")]
    pub right: String,
    /// Takes the views from the ports of this graph.
    #[arg(long, value_name = "GRAPH")]
    pub graph: Option<PathBuf>,
    /// The printed board: chessboard:9x6:25mm (inner corners), circles:4x11:20mm (asymmetric), circle_grid:7x6:10mm or
    /// charuco:19x26:5mm:4mm:4x4_250 (squares, square, marker, dictionary).
    #[arg(long)]
    board: Board,
    /// The result, as OpenCV's FileStorage YAML.
    #[arg(long, short, value_name = "FILE.yml", default_value = "calibration.yml")]
    out: PathBuf,
    /// Folder for pictures: coverage, rows after rectification, corners of the last view.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Distortion that is solved for: radial (k1 k2), standard (k1 k2 p1 p2), full (and k3), rational (k1 to k6).
    #[arg(long, default_value = "standard", value_parser = ["radial", "standard", "full", "rational"])]
    pub model: String,
    /// Pairs that are looked at; of a video, a camera or a live graph 300 unless given.
    #[arg(long, value_parser = clap::value_parser!(u64).range(3..))]
    pub frames: Option<u64>,
    /// Keeps views whose error stands out.
    #[arg(long)]
    pub keep_all: bool,
    /// Whose steps are taken: own, or sample, those of OpenCV's sample stereo_calib with all views and its model.
    #[arg(long, default_value = "own", value_parser = ["own", "sample"])]
    pub method: String,
}

impl Arguments {
    /// Arguments for views of `board`, as the command line gives them by default.
    pub fn new(left: &str, right: &str, board: Board) -> Self {
        Self {
            left: left.to_owned(),
            right: right.to_owned(),
            graph: None,
            board,
            out: PathBuf::new(),
            pictures: None,
            model: "standard".into(),
            frames: None,
            keep_all: false,
            method: "own".into(),
        }
    }
}

/// Calibrates.
pub fn run(arguments: &Arguments) -> Result<End> {
    crate::interrupt::listen();
    let source = match Source::of(arguments) {
        Ok(source) => source,
        Err(error) => {
            tell!("error: {error:#}");
            return Ok(End::Wrong);
        }
    };
    let seen = look_at(arguments, &source)?;
    let table = table_of(&seen)?;
    let views = report::Views::of(&table, &source);
    views.tell_left_out();
    let Some(bytes) = seen.packets[0].as_ref().map(|packet| packet.bytes()) else {
        tell!("error: {} of {} views could be used: that gives no calibration", views.used(), views.len());
        return Ok(End::Failed);
    };
    let calibration = report::calibration(bytes).context("the calibration is cut off")?;
    if let Some(folder) = &arguments.pictures {
        pictures(&seen, folder)?;
    }
    panoscope_calibration::write(&arguments.out, &calibration)?;
    views.show();
    report::show(&calibration, &views);
    let rectified = packet::rectification(&calibration)?;
    say!("rectified  {:.2} px focal length, baseline {:.3} mm", rectified.left.focal_px, rectified.baseline_mm);
    say!("written    {}", arguments.out.display());
    Ok(End::Done)
}

/// Runs the graph; its packets are calibration, table, coverage, epipolar and corners.
pub fn look_at(arguments: &Arguments, source: &Source) -> Result<Seen> {
    let text = source.text(arguments)?;
    let ports = [(NODE, "calibration"), (NODE, "table"), (NODE, "coverage"), (NODE, "epipolar"), (NODE, "image")];
    look::run(&look::Plan {
        text: &text,
        path: source.path(),
        frames: source.frames(arguments),
        threads: 0,
        ports: &ports,
        pace: look::Pace::Free,
    })
}

/// Writes the pictures into a folder: coverage, rows after rectification, corners of the last view.
pub fn pictures(seen: &Seen, folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    for (index, name) in [(2, "coverage.png"), (3, "epipolar.png"), (4, "corners.png")] {
        if let Some(frame) = &seen.packets[index] {
            report::save(frame, &folder.join(name))?;
        }
    }
    Ok(())
}

/// The node's table of views.
pub fn table_of(seen: &Seen) -> Result<look::Table> {
    let packet = seen.packets[1].as_ref().context("no pair of views came: is the source empty?")?;
    look::Table::read(packet.bytes()).context("the table of views is cut off")
}

/// On the command line paths start from here.
fn from_here(path: &Path) -> Result<String> {
    Ok(std::path::absolute(path).with_context(|| path.display().to_string())?.display().to_string())
}
