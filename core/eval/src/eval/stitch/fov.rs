//! Measures how much more than one view a panorama shows, by scene and distance, compared with the phantom's ground
//! truth.
//!
//! `fov_total_pct` is the area of tissue that the panorama shows over the area of one view, in pixels of the reference
//! view; `fov_gain_pct` is the part above 100. A wrong homography can stretch a view over a large canvas, so a pixel
//! counts only when the phantom's footprint of all cameras has it, and a frame counts as one view (100 %) if a
//! registration is lost or not [right](is_right).

use std::path::PathBuf;

use panoscope_engine::text_table::table;
use panoscope_graph::GraphOptions;

use super::graphs;
use crate::error::{EvalError, Result};
use crate::figures::Figure;
use crate::inputs::wiring::{Composite, JudgeInputs, Wiring};
use crate::packets::Table;
use crate::registration::{FRESH, is_right, run_judged};
use crate::session::Session;
use crate::statistics::{mean, rms};

/// Scenes of the phantom to evaluate.
const SCENES: [&str; 2] = ["bowel", "liver"];
/// Width of the image in which the true footprint is drawn, in views: the second view may lie next to the first one.
const WIDE_FACTOR: f64 = 3.0;
/// Code of a held registration in the evaluating node's table.
const HELD: f64 = 1.0;
/// Area of one view, percent.
const ONE_VIEW_PCT: f64 = 100.0;

/// Options of [`judge`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Graph files whose views come from a phantom.
    pub graphs: Vec<PathBuf>,
    /// `NODE.PARAM=VALUE`, applied to every graph.
    pub settings: Vec<String>,
    /// Overlays of the graphs, and values of their arguments.
    pub given: GraphOptions,
    /// Ticks of each run.
    pub frames: u64,
    /// Distances from the scope to the tissue, mm.
    pub distances_mm: Vec<f64>,
}

/// Default distances of the command, mm.
pub const DISTANCES_MM: [f64; 4] = [20.0, 30.0, 50.0, 70.0];

/// Field of view of one composite in one run.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reach {
    /// Area shown, true area of the union of all views, in percent of one view; means over all frames.
    total_pct: f64,
    truth_pct: f64,
    /// Area that the panorama covers, whether correct or not.
    covered_pct: f64,
    /// Share of frames whose registrations are all fresh and correct.
    stitched_pct: f64,
    frames: usize,
    /// Number of frames with a registration reported as lost.
    lost: usize,
    wrong: usize,
    /// Root mean square alignment error of correct frames, and that of the best planes, px.
    align_px: f64,
    floor_px: f64,
}

/// Quality of the registration of one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Fresh,
    Held,
    Lost,
    Wrong,
}

/// Verdict on one pair of views in a frame.
fn verdict(state: f64, align_px: f64, floor_px: f64) -> Verdict {
    if state != FRESH && state != HELD {
        return Verdict::Lost;
    }
    match is_right(align_px, floor_px) {
        true if state == FRESH => Verdict::Fresh,
        true => Verdict::Held,
        false => Verdict::Wrong,
    }
}

/// Reads the tables of a composite's evaluating nodes, one per pair of views.
fn reach(tables: &[Table]) -> Option<Reach> {
    let columns = |name: &str| tables.iter().map(|table| table.column(name)).collect::<Option<Vec<_>>>();
    let (states, aligns, floors) = (columns("state")?, columns("align_px")?, columns("floor_px")?);
    // All judges of a composite see the same panorama.
    let first = tables.first()?;
    let (covered, truth, right) =
        (first.column("fov_pct")?, first.column("fov_truth_pct")?, first.column("fov_right_pct")?);
    let frames = states.iter().map(Vec::len).min().filter(|frames| *frames > 0)?;
    let (mut total, mut fresh, mut lost, mut wrong) = (0.0, 0, 0, 0);
    let (mut good_aligns, mut good_floors) = (Vec::new(), Vec::new());
    for tick in 0..frames {
        let pairs =
            || (0..tables.len()).map(|pair| verdict(states[pair][tick], aligns[pair][tick], floors[pair][tick]));
        let is_any = |wanted| pairs().any(|verdict| verdict == wanted);
        if is_any(Verdict::Lost) || is_any(Verdict::Wrong) || !right[tick].is_finite() {
            total += ONE_VIEW_PCT;
            let is_wrong = is_any(Verdict::Wrong);
            wrong += usize::from(is_wrong);
            lost += usize::from(!is_wrong);
            continue;
        }
        total += right[tick];
        fresh += usize::from(!is_any(Verdict::Held));
        good_aligns.extend(aligns.iter().map(|pair| pair[tick]));
        good_floors.extend(floors.iter().map(|pair| pair[tick]));
    }
    Some(Reach {
        total_pct: total / frames as f64,
        truth_pct: mean(&truth),
        covered_pct: mean(&covered),
        stitched_pct: 100.0 * fresh as f64 / frames as f64,
        frames,
        lost,
        wrong,
        align_px: rms(&good_aligns),
        floor_px: rms(&good_floors),
    })
}

/// Figures of one case.
fn figures(case: &str, reach: &Reach, input: &str) -> Vec<Figure> {
    let figure = |name: &str, value: f64, unit, truth: Option<f64>, peer: &str| {
        let mut figure = Figure::new(&format!("{name}/{case}"), value, unit, input);
        if let Some(truth) = truth.filter(|truth| truth.is_finite()) {
            figure.peer = Some(peer.to_owned());
            figure.peer_value = Some(truth);
            figure.ratio = (truth > 0.0).then(|| value / truth);
        }
        figure
    };
    const TRUTH: &str = "union of the true views";
    let (total, truth) = (reach.total_pct, reach.truth_pct);
    let mut all = vec![
        figure("fov_total_pct", total, "%", Some(truth), TRUTH),
        figure("fov_gain_pct", total - ONE_VIEW_PCT, "%", Some(truth - ONE_VIEW_PCT), TRUTH),
        figure("fov_stitched_share", reach.stitched_pct, "%", None, ""),
        figure("fov_lost_frames", reach.lost as f64, "frames", None, ""),
        figure("fov_wrong_frames", reach.wrong as f64, "frames", None, ""),
    ];
    if reach.align_px.is_finite() {
        all.push(figure("fov_align_px", reach.align_px, "px", None, ""));
    }
    all
}

fn row(name: &str, composite: &Composite, scene: &str, distance_mm: f64, reach: &Reach) -> Vec<String> {
    let pct = |value: f64| format!("{value:.1}");
    let px = |value: f64| if value.is_finite() { format!("{value:.2}") } else { "-".to_owned() };
    vec![
        name.to_owned(),
        composite.views.len().to_string(),
        scene.to_owned(),
        format!("{distance_mm}"),
        pct(reach.total_pct),
        pct(reach.total_pct - ONE_VIEW_PCT),
        pct(reach.truth_pct),
        pct(reach.covered_pct),
        pct(reach.stitched_pct),
        reach.lost.to_string(),
        reach.wrong.to_string(),
        px(reach.align_px),
        px(reach.floor_px),
    ]
}

const HEAD: [&str; 13] = [
    "graph",
    "cameras",
    "scene",
    "mm",
    "total %",
    "gain %",
    "truth %",
    "covered %",
    "stitched %",
    "lost",
    "wrong",
    "align px",
    "best plane px",
];

/// Measures the area of the panorama over that of one view, for each graph, tissue and distance, compared with the true
/// union of the views.
///
/// # Errors
/// A graph has mistakes, nothing to evaluate or no phantom, or a run fails.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let mut wirings = Vec::new();
    for path in &options.graphs {
        let wiring = graphs::wiring(path, &GraphOptions { set: options.settings.clone(), ..options.given.clone() })?;
        let Some(phantom) = wiring.phantom() else {
            let reason = format!(
                "{}: its views do not come from a `phantom`, so the true field of view is not known",
                path.display()
            );
            return Err(EvalError::Options { reason });
        };
        wirings.push((path, wiring, phantom));
    }
    let (mut rows, mut out) = (vec![HEAD.map(str::to_owned).to_vec()], Vec::new());
    for (path, wiring, phantom) in &wirings {
        for scene in SCENES {
            for distance_mm in &options.distances_mm {
                let mut wiring = wiring.clone();
                wiring.set(phantom, "scene", scene);
                wiring.set(phantom, "distance_mm", *distance_mm);
                wiring.set(phantom, "wide_factor", WIDE_FACTOR);
                let run = run_judged(session, &wiring, JudgeInputs::Area, path, options.frames)?;
                let mut tables = run.tables.as_slice();
                for composite in &wiring.composites {
                    let (own, rest) = tables.split_at(composite.pairs().min(tables.len()));
                    tables = rest;
                    let Some(reach) = reach(own) else { continue };
                    let name = name_of(&wiring, composite);
                    rows.push(row(&name, composite, scene, *distance_mm, &reach));
                    let case = format!("{name}_{scene}_{distance_mm}mm");
                    out.extend(figures(
                        &case,
                        &reach,
                        &format!("phantom, {} frames, {} views", reach.frames, composite.views.len()),
                    ));
                }
            }
        }
    }
    session.table(&table(&rows));
    Ok(out)
}

/// Name of a composite in tables: that of its graph, followed by its own if the graph has several.
fn name_of(wiring: &Wiring, composite: &Composite) -> String {
    if wiring.composites.len() > 1 { format!("{}_{}", wiring.name, composite.name()) } else { wiring.name.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(rows: &[[f64; 6]]) -> Table {
        let names = ["state", "align_px", "floor_px", "fov_pct", "fov_truth_pct", "fov_right_pct"];
        Table { names: names.map(str::to_owned).to_vec(), rows: rows.iter().map(|row| row.to_vec()).collect() }
    }

    #[test]
    fn lost_and_stretched_frames_count_as_one_view() {
        let good = [0.0, 2.0, 1.0, 185.0, 188.0, 184.0];
        let stretched = [0.0, 60.0, 1.0, 400.0, 188.0, 188.0];
        let lost = [2.0, f64::NAN, f64::NAN, 185.0, 188.0, 184.0];
        let held = [1.0, 2.0, 1.0, 185.0, 188.0, 180.0];
        let found = reach(&[judged(&[good, stretched, lost, held])]).unwrap();
        assert_eq!((found.frames, found.lost, found.wrong, found.stitched_pct), (4, 1, 1, 25.0));
        assert!((found.total_pct - (184.0 + 100.0 + 100.0 + 180.0) / 4.0).abs() < 1e-9, "{found:?}");
        assert!((found.align_px - 2.0).abs() < 1e-9 && found.truth_pct == 188.0, "{found:?}");
    }

    #[test]
    fn one_bad_pair_of_four_cameras_spoils_the_frame() {
        let good = [0.0, 1.0, 0.5, 280.0, 290.0, 279.0];
        let lost = [2.0, f64::NAN, f64::NAN, 280.0, 290.0, 279.0];
        let found = reach(&[judged(&[good, good]), judged(&[good, lost]), judged(&[good, good])]).unwrap();
        assert_eq!((found.lost, found.stitched_pct, found.total_pct), (1, 50.0, (279.0 + 100.0) / 2.0));
        assert!(reach(&[]).is_none() && reach(&[judged(&[])]).is_none());
    }

    #[test]
    fn figures_stand_beside_the_truth() {
        let reach = reach(&[judged(&[[0.0, 1.0, 0.5, 190.0, 188.0, 180.0]])]).unwrap();
        let all = figures("x_bowel_20mm", &reach, "phantom");
        let gain = all.iter().find(|f| f.name == "fov_gain_pct/x_bowel_20mm").unwrap();
        assert_eq!((gain.value, gain.peer_value), (80.0, Some(88.0)));
    }
}
