//! `panoscope eval`: quality of results, compared with ground truth and peers.

mod calibrate;
mod detect;
mod disparity;
mod screen;
mod skill;
mod stitch;

use std::path::PathBuf;

use anyhow::Result;
use panoscope_eval::{EvalError, eval, figures};

use crate::session::Terminal;
use panoscope_cli::End;
use panoscope_cli::terminal::{log, raw};

/// Evaluations.
#[derive(clap::Subcommand)]
pub enum Eval {
    /// SURF compared with OpenCV's SIFT and AKAZE on two photographs of a wall under a known homography.
    Surf(Surf),
    /// The panorama of a graph compared with ground truth.
    Stitch(stitch::Arguments),
    /// A mosaic from one moving camera compared with ground truth, with and without loop closure.
    Mosaic(Evaluation<eval::mosaic::Options>),
    /// Disparity compared with true disparities and surfaces, and left with right.
    Disparity(disparity::Arguments),
    /// Calibration compared with OpenCV's sample and with the phantom's ground truth.
    Calibrate(calibrate::Arguments),
    /// Detectors and segmenters compared with true boxes, outlines and tips.
    Detect(detect::Arguments),
    /// The arm: closed loop on moving tips, limits against hostile inputs, time of the control.
    Arm(Evaluation<eval::arm::Options>),
    /// Surgical skill: a report of tracks of tips, or the measures compared with motions known in closed form.
    Skill(skill::Arguments),
    /// False and missed warnings near tissue and other tips, compared with the phantom's exact distances.
    Proximity(Evaluation<eval::proximity::Options>),
    /// A graph's screen: share of the main image, dead area, cut surface, depths beyond the colours.
    Screen(screen::Arguments),
}

/// Arguments of an evaluation whose options need no more than the library's.
#[derive(clap::Args)]
#[group(skip)]
pub struct Evaluation<T: clap::Args> {
    #[command(flatten)]
    options: T,
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
}

/// Arguments of `eval surf`.
#[derive(clap::Args)]
#[group(skip)]
pub struct Surf {
    /// Writes the figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
    #[command(flatten)]
    options: eval::surf::Options,
}

/// Evaluates, and shows and writes the figures.
pub fn run(eval: &Eval) -> Result<End> {
    panoscope_cli::interrupt::listen();
    if let Eval::Skill(arguments) = eval
        && !arguments.options.files.is_empty()
    {
        return skill::report(&Terminal, arguments);
    }
    let (found, json) = match judge(eval) {
        Ok((Some(found), json)) => (found, json),
        Ok((None, _)) => return Ok(End::Wrong),
        Err(error) => return refused(error),
    };
    raw(&figures::table(&found));
    if let Some(path) = json {
        figures::write(path, &found)?;
    }
    Ok(End::Done)
}

/// The figures, if there are any, and their file.
fn judge(eval: &Eval) -> Result<(Option<Vec<figures::Figure>>, &Option<PathBuf>)> {
    let session = &Terminal;
    Ok(match eval {
        Eval::Surf(arguments) => (Some(eval::surf::judge(session, &arguments.options)?), &arguments.json),
        Eval::Stitch(arguments) => {
            let found = stitch::judge(session, arguments)?;
            // Why each case was skipped has been shown.
            ((!found.is_empty()).then_some(found), &arguments.json)
        }
        Eval::Mosaic(arguments) => (Some(eval::mosaic::judge(session, &arguments.options)?), &arguments.json),
        Eval::Disparity(arguments) => (Some(eval::disparity::judge(session, &arguments.options())?), &arguments.json),
        Eval::Calibrate(arguments) => (Some(eval::calibrate::judge(session, &arguments.options())?), &arguments.json),
        Eval::Detect(arguments) => (Some(detect::judge(session, arguments)?), &arguments.json),
        Eval::Arm(arguments) => (Some(eval::arm::judge(session, &arguments.options)?), &arguments.json),
        Eval::Skill(arguments) => (skill::judge(arguments)?, &arguments.json),
        Eval::Proximity(arguments) => (Some(eval::proximity::judge(session, &arguments.options)?), &arguments.json),
        Eval::Screen(arguments) => (Some(eval::screen::judge(session, &arguments.options())?), &arguments.json),
    })
}

/// Shows an error of the arguments or the graph; returns every other error.
fn refused(error: anyhow::Error) -> Result<End> {
    match error.downcast_ref::<EvalError>() {
        Some(EvalError::Check { diagnostics }) => raw(&diagnostics.render(false)),
        Some(EvalError::Options { reason }) => log!("error: {reason}"),
        _ => return Err(error),
    }
    Ok(End::Wrong)
}
