//! Quality of registrations: a graph is run with evaluating nodes after its composites.

use std::path::Path;

use panoscope_engine::memory::FrameRef;
use panoscope_graph::{Catalog, GraphText};

use crate::error::{Context, Result};
use crate::inputs::wiring::{JudgeInputs, Wiring};
use crate::packets::Table;
use crate::run::{self, Plan, RunOutput};
use crate::session::Session;
use crate::statistics::{finite, mean, rms};

/// Code of a fresh registration in the evaluating node's table.
pub const FRESH: f64 = 0.0;

/// Whether a registration is right: its alignment error is at most twice that of the best plane, plus 6 px. NaN is not
/// right.
pub fn is_right(align_px: f64, floor_px: f64) -> bool {
    align_px <= WRONG.0 * floor_px + WRONG.1
}

/// Multiple of the best plane's error, and px added to it, beyond which a registration is wrong.
pub const WRONG: (f64, f64) = (2.0, 6.0);

/// Measures of one pair of views; NaN without ground truth.
#[derive(Clone, Debug)]
pub struct Registration {
    /// Share of frames with a fresh registration.
    pub stitched_pct: f64,
    /// Root mean square distance between mapped and true positions in the overlap.
    pub align_px: f64,
    /// As `align_px` for the best plane: the error that parallax causes.
    pub floor_px: f64,
    /// Peak signal-to-noise ratio of both views in the overlap.
    pub psnr_overlap_db: f64,
    /// Structural similarity of both views in the overlap, 0 to 1.
    pub ssim_overlap: f64,
    /// Peak signal-to-noise ratio along the seam.
    pub psnr_seam_db: f64,
    /// Structural similarity along the seam, 0 to 1.
    pub ssim_seam: f64,
    /// Offset of lines across the seam: means over the frames of the median and of the 95th percentile.
    pub seam_break_px: (f64, f64),
    /// Share of the band along the seam with content that the ground truth does not have nearby, percent.
    pub ghost_pct: f64,
    /// Change of lengths against the homography in areas that only the right view shows, percent, in the worst frame.
    pub stretch_pct: f64,
    /// Area that the panorama shows, in percent of one view.
    pub fov_pct: f64,
    /// Maximum cropped share of the views.
    pub cropped_pct: f64,
}

/// Reads the table of an evaluating node.
///
/// # Errors
/// A column is missing.
pub fn registration(rows: &Table) -> Result<Registration> {
    let column = |name: &str| rows.required("the table", name);
    let state = column("state")?;
    let fresh = state.iter().filter(|s| **s == FRESH).count();
    Ok(Registration {
        stitched_pct: 100.0 * fresh as f64 / state.len().max(1) as f64,
        align_px: rms(&column("align_px")?),
        floor_px: rms(&column("floor_px")?),
        psnr_overlap_db: mean(&column("psnr_overlap_db")?),
        ssim_overlap: mean(&column("ssim_overlap")?),
        psnr_seam_db: mean(&column("psnr_seam_db")?),
        ssim_seam: mean(&column("ssim_seam")?),
        seam_break_px: (mean(&column("seam_break_px")?), mean(&column("seam_break_p95_px")?)),
        ghost_pct: mean(&column("ghost_pct")?),
        stretch_pct: finite(&column("stretch_pct")?).fold(f64::NAN, f64::max),
        fov_pct: mean(&column("fov_pct")?),
        cropped_pct: finite(&column("cropped_pct")?).fold(f64::NAN, f64::max),
    })
}

/// Result of a graph run with its evaluating nodes.
pub struct JudgedRun {
    /// One table per evaluating node, in the order of [`judges`].
    pub tables: Vec<Table>,
    /// The last panorama of each composite; `None` if only the registration is evaluated.
    pub panoramas: Vec<Option<FrameRef>>,
    /// Packets and counters of the run.
    pub output: RunOutput,
}

/// Names of the evaluating nodes, in the graph and in figures.
pub fn judges(wiring: &Wiring) -> Vec<(String, String)> {
    let mut all = Vec::new();
    for composite in &wiring.composites {
        for pair in 0..composite.pairs() {
            let view = if composite.pairs() > 1 { format!("view{}", pair + 1) } else { String::new() };
            let id = if wiring.composites.len() > 1 { composite.name().to_owned() } else { String::new() };
            all.push((
                composite.judge(pair),
                [id, view].into_iter().filter(|p| !p.is_empty()).collect::<Vec<_>>().join("_"),
            ));
        }
    }
    all
}

/// Runs a graph with its evaluating nodes for `frames` ticks; `path` names it in messages.
///
/// # Errors
/// The graph does not run, or an evaluating node returned no table.
pub fn run_judged(
    session: &dyn Session,
    wiring: &Wiring,
    judged: JudgeInputs,
    path: &Path,
    frames: u64,
) -> Result<JudgedRun> {
    let text = wiring.judged(judged).text();
    let names = judges(wiring);
    let mut ports: Vec<(&str, &str)> = names.iter().map(|(name, _)| (name.as_str(), "table")).collect();
    if judged == JudgeInputs::Pictures {
        ports.extend(wiring.composites.iter().map(|composite| (composite.id.as_str(), "panorama")));
    }
    let plan = Plan { text: &text, path, frames: Some(frames), ports: &ports, ..Plan::default() };
    let mut output = run::run(session, &plan)?;
    let panoramas = output.packets.split_off(names.len());
    let tables = output.packets.iter().map(|packet| Table::of_judge(packet.as_ref())).collect::<Result<_>>()?;
    Ok(JudgedRun { tables, panoramas, output })
}

/// Measures the registration of the first composite of a graph (TOML text) over `frames` ticks.
///
/// # Errors
/// The graph has no composite, or does not run.
pub fn registration_of(session: &dyn Session, text: &str, frames: u64) -> Result<Registration> {
    let path = Path::new("bench.toml");
    let wiring = Wiring::of(&GraphText::parse(path, text), &Catalog::default())?;
    let run = run_judged(session, &wiring, JudgeInputs::Registration, path, frames)?;
    registration(run.tables.first().context("the graph has no evaluating node")?)
}
