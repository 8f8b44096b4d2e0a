//! Calibration of both cameras from views of a printed board.
//!
//! A small graph around the node `calibrate_stereo` does the work: the framework is its own user.

mod options;
mod report;
mod source;

use std::path::Path;

use panoscope_abi::Calibration;

use crate::error::{Context, FileAction, OnFile, Result};
use crate::packets::{self, Table};
use crate::run::{self, Pace, Plan, RunOutput};
use crate::session::Session;

pub use options::Options;
pub use report::{Views, summary};
pub use source::Source;

/// What a warning of the node contains that says why it has not solved.
const UNSOLVED: &str = "no calibration";

/// A calibration and the views that it was made from.
pub struct Calibrated {
    /// Both cameras, or why there are none.
    pub calibration: std::result::Result<Calibration, String>,
    /// All views that were looked at.
    pub views: Views,
    output: RunOutput,
}

/// Looks at all views and calibrates.
///
/// # Errors
/// The graph does not run, or its source gave no pair of views.
pub fn calibrate(session: &dyn Session, options: &Options, source: &Source) -> Result<Calibrated> {
    let text = source.text(options)?;
    let node = source::NODE;
    let ports = [(node, "calibration"), (node, "table"), (node, "coverage"), (node, "epipolar"), (node, "image")];
    let plan = Plan {
        text: &text,
        path: source.path(),
        frames: source.frames(options),
        threads: 0,
        ports: &ports,
        pace: Pace::Free,
    };
    let output = run::run(session, &plan)?;
    let packet = output.packets[1].as_ref().context("no pair of views came: is the source empty?")?;
    let table = Table::read(packet.bytes()).context("the table of views is cut off")?;
    let views = Views::of(&table, source);
    let calibration = match &output.packets[0] {
        Some(packet) => Ok(packets::calibration(packet.bytes()).context("the calibration is cut off")?),
        None => Err(output.log.iter().rev().find(|(id, text)| id == node && text.contains(UNSOLVED)).map_or_else(
            || format!("{} of {} views could be used: that gives no calibration", views.used(), views.len()),
            |(_, text)| text.clone(),
        )),
    };
    Ok(Calibrated { calibration, views, output })
}

impl Calibrated {
    /// Writes pictures into a folder: coverage, rows after rectification, corners of the last view.
    ///
    /// # Errors
    /// The folder or a file cannot be written.
    pub fn write_pictures(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder).on_file(FileAction::Create, folder)?;
        for (index, name) in [(2, "coverage.png"), (3, "epipolar.png"), (4, "corners.png")] {
            if let Some(frame) = &self.output.packets[index] {
                report::save(frame, &folder.join(name))?;
            }
        }
        Ok(())
    }
}
