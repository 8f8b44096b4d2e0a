//! Disparity maps beside true disparities and surfaces, and left beside right.

mod chains;
mod data;
mod edges;
mod given;
mod judge;
mod liver;
mod outside;
mod own_graph;
mod phantom;
mod picture;
mod rectified;
mod sets;
mod stated;
mod synthetic;
mod synthetic_case;
#[doc(hidden)]
pub mod truth_files;

use std::path::PathBuf;

use crate::error::Result;
use crate::figures::Figure;
use crate::inputs::{create, wants};
use crate::session::{Session, check_cancelled};
use judge::Judge;
use own_graph::OwnGraph;

pub use given::Pair;
pub use own_graph::GraphRequest;

/// Options of [`judge`].
#[derive(Clone, Debug)]
pub struct Options {
    /// The cases that are judged; if empty, all.
    pub cases: Vec<String>,
    /// Folders of data sets, searched before the usual ones.
    pub data: Vec<PathBuf>,
    /// A pair of the user's instead of the cases.
    pub pair: Option<Pair>,
    /// A graph of the user's that is judged beside the chains.
    pub graph: Option<GraphRequest>,
    /// Folder for pictures of disparities and errors.
    pub pictures: Option<PathBuf>,
}

/// Names of the cases.
pub const CASES: [&str; 10] = [
    "truth",
    "range",
    "phantom",
    "synthetic",
    "synthetic_tuning",
    "aloe",
    "motorcycle",
    "synthetic_liver",
    "silicone_heart",
    "hamlyn",
];

/// Judges disparities on the given pair, or on each wanted case whose data is there.
///
/// # Errors
/// A file has the wrong content, a run fails, or the session is cancelled.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let usual = ["target/data", "../shared/data/stereo", "/usr/share/doc/opencv-doc/examples/data"];
    let folders = options.data.iter().cloned().chain(usual.map(PathBuf::from)).collect();
    create(options.pictures.as_deref())?;
    let own = options.graph.as_ref().map(OwnGraph::open).transpose()?;
    let mut judge = Judge { session, folders, own, pictures: options.pictures.as_deref(), figures: Vec::new() };
    if let Some(pair) = &options.pair {
        judge.given(pair)?;
        return Ok(judge.figures);
    }
    for case in CASES.iter().filter(|case| wants(&options.cases, case)) {
        check_cancelled(session)?;
        match *case {
            "truth" => judge.outside()?,
            "range" => judge.range()?,
            "phantom" => judge.phantom()?,
            "synthetic" => judge.synthetic(case, &synthetic::HELD_OUT_SEEDS)?,
            "synthetic_tuning" => judge.synthetic(case, &synthetic::TUNING_SEEDS)?,
            "aloe" => judge.aloe()?,
            "motorcycle" => judge.motorcycle()?,
            "synthetic_liver" => judge.liver()?,
            "silicone_heart" => judge.heart()?,
            _ => judge.hamlyn()?,
        }
    }
    Ok(judge.figures)
}
