//! `panoscope eval`: how good the results are, beside truth and peers.

mod arm;
mod calibrate;
mod detect;
pub mod disparity;
pub mod look;
mod mosaic;
pub mod plot;
mod proximity;
mod rewire;
mod skill;
pub mod stitch;
mod surf;

use std::path::PathBuf;

use anyhow::Result;

pub use self::detect::{Scratch, quoted, shipped};
use super::bench::record;
use crate::End;

/// What is judged.
#[derive(clap::Subcommand)]
pub enum Eval {
    /// SURF beside OpenCV's SIFT and AKAZE on two photographs of a wall under a known homography.
    Surf(surf::Arguments),
    /// The panorama of a graph beside the truth.
    Stitch(stitch::Arguments),
    /// A mosaic from one moving camera beside the truth, with loop closure and without.
    Mosaic(mosaic::Arguments),
    /// Disparity beside true disparities and surfaces, and left beside right.
    Disparity(disparity::Arguments),
    /// Calibration beside OpenCV's sample and beside the phantom's truth.
    Calibrate(calibrate::Arguments),
    /// Detectors and segmenters beside true boxes, outlines and tips.
    Detect(detect::Arguments),
    /// The arm: closed loop on moving tips, limits against hostile inputs, time of the control.
    Arm(arm::Arguments),
    /// Surgical skill: a report of tracks of tips, or the measures beside motions that are known in closed form.
    Skill(skill::Arguments),
    /// False and missed warnings near tissue and other tips, beside the phantom's exact distances.
    Proximity(proximity::Arguments),
}

/// Judges.
pub fn run(eval: &Eval) -> Result<End> {
    crate::interrupt::listen();
    let (figures, json): (_, &Option<PathBuf>) = match eval {
        Eval::Surf(arguments) => (surf::judge(arguments)?, &arguments.json),
        Eval::Stitch(arguments) => (stitch::judge(arguments)?, &arguments.json),
        Eval::Mosaic(arguments) => (mosaic::judge(arguments)?, &arguments.json),
        Eval::Disparity(arguments) => (disparity::judge(arguments)?, &arguments.json),
        Eval::Calibrate(arguments) => (calibrate::judge(arguments)?, &arguments.json),
        Eval::Detect(arguments) => (detect::judge(arguments)?, &arguments.json),
        Eval::Arm(arguments) => (arm::judge(arguments)?, &arguments.json),
        Eval::Skill(arguments) if !arguments.files.is_empty() => return skill::report(arguments),
        Eval::Skill(arguments) => (skill::judge(arguments)?, &arguments.json),
        Eval::Proximity(arguments) => (proximity::judge(arguments)?, &arguments.json),
    };
    let Some(figures) = figures else { return Ok(End::Wrong) };
    record::show(&figures);
    if let Some(path) = json {
        record::write(path, &figures)?;
    }
    Ok(End::Done)
}
