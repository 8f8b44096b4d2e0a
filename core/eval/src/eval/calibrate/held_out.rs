//! Lengths on boards that a calibration was not made from, with the errors stated for them.
//!
//! The pairs of a set are divided several times. Each part is measured with the calibration of the others: the board is found in the rectified left view,
//! the depth preset maps the pair, and the distances of some of the board's points are compared with the print.

use std::path::{Path, PathBuf};

use panoscope_abi::Calibration;
use panoscope_base::random::SplitMix64;
use panoscope_data::calibration::Board;

use crate::calibration::{self, Source};
use crate::error::{Context, Result};
use crate::figures::Figure;
use crate::inputs::Folder;
use crate::inputs::scene;
use crate::packets::Table;
use crate::run::{self, Pace, Plan};
use crate::session::{Session, note};
use crate::statistics::percentile;

/// Parts of a division.
const PARTS: usize = 4;
/// Lengths measured on each pair.
const LENGTHS: usize = 24;
const SEED: u64 = 5;
const PEER: &str = "without what the calibration states of its error";

/// The pairs of a board.
pub struct BoardSet<'a> {
    /// In the figures' names.
    pub name: &'a str,
    /// Left and right files, pair by pair.
    pub files: [Vec<PathBuf>; 2],
    pub board: Board,
}

/// A length on a held-out board, mm.
#[derive(Clone, Copy, Debug)]
struct Length {
    error_mm: f64,
    bound_mm: f64,
    /// The bound without what the calibration states.
    plain_mm: f64,
}

/// Which part a view belongs to: every fourth one, then each quarter of the sequence.
const DIVISIONS: [fn(usize, usize) -> usize; 2] = [|view, _| view % PARTS, |view, count| view * PARTS / count];

/// Figures of all lengths; none where no calibration comes of the parts.
pub fn figures(session: &dyn Session, set: &BoardSet<'_>) -> Result<Vec<Figure>> {
    let folder = Folder::new("panoscope-held-out")?;
    let (mut lengths, mut errors) = (Vec::new(), Vec::new());
    let count = set.files[0].len();
    for division in DIVISIONS {
        for part in 0..PARTS {
            let (out, rest): (Vec<usize>, Vec<usize>) = (0..count).partition(|view| division(*view, count) == part);
            let pick = |side: usize| rest.iter().map(|view| set.files[side][*view].clone()).collect::<Vec<_>>();
            let options = calibration::Options::new("", "", set.board);
            let made = match calibration::calibrate(session, &options, &Source::Images([pick(0), pick(1)]))?.calibration
            {
                Ok(made) => made,
                Err(why) => {
                    note!(session, "{}: {} pairs give no calibration: {why}", set.name, rest.len());
                    continue;
                }
            };
            let files = ["stated.yml", "plain.yml"].map(|name| folder.path().join(name));
            panoscope_data::calibration::write(&files[0], &made)?;
            panoscope_data::calibration::write(&files[1], &Calibration { stated_error: 0, ..made })?;
            for view in out {
                let pair = [&set.files[0][view], &set.files[1][view]].map(PathBuf::as_path);
                lengths.extend(measure(session, set, &files, pair)?);
            }
            errors.push(made.rms_px);
        }
    }
    let input = format!(
        "{} lengths on held-out pairs, {count} pairs of {}, {} calibrations",
        lengths.len(),
        set.board,
        errors.len()
    );
    Ok(if lengths.is_empty() { Vec::new() } else { summary(&lengths, set.name, &input) })
}

fn summary(lengths: &[Length], name: &str, input: &str) -> Vec<Figure> {
    let quantile = |share: f64, of: fn(&Length) -> f64| percentile(&lengths.iter().map(of).collect::<Vec<_>>(), share);
    let held = |bound: fn(&Length) -> f64| {
        100.0 * lengths.iter().filter(|l| l.error_mm <= bound(l)).count() as f64 / lengths.len() as f64
    };
    let by_error = |bound: fn(&Length) -> f64| quantile(0.5, bound) / quantile(0.5, |l| l.error_mm);
    let plain = |figure: Figure, value: f64| {
        let mut figure = figure.beside(PEER, Some(value));
        // Neither more nor less is better.
        figure.ratio = None;
        figure
    };
    let figure = |measure: &str, value: f64, unit| Figure::new(&format!("{measure}/{name}"), value, unit, input);
    vec![
        figure("held_out_length_mm", quantile(0.5, |l| l.error_mm), "mm"),
        figure("held_out_length_p95_mm", quantile(0.95, |l| l.error_mm), "mm"),
        plain(figure("held_out_length_within_stated", held(|l| l.bound_mm), "%"), held(|l| l.plain_mm)),
        plain(figure("held_out_bound_mm", quantile(0.5, |l| l.bound_mm), "mm"), quantile(0.5, |l| l.plain_mm)),
        plain(figure("held_out_bound_by_error", by_error(|l| l.bound_mm), "1"), by_error(|l| l.plain_mm)),
    ]
}

/// Node `scope` of one pair.
fn source(pair: [&Path; 2], calibration: &Path) -> String {
    let [left, right] = pair.map(|path| toml::Value::from(path.display().to_string()));
    let calibration = toml::Value::from(calibration.display().to_string());
    format!("type = \"capture\"\nparams = {{ left = {left}, right = {right}, calibration = {calibration} }}\n")
}

fn run_once(session: &dyn Session, text: &str, ports: &[(&str, &str)]) -> Result<Vec<Option<Table>>> {
    let plan = Plan { text, path: Path::new("eval.toml"), frames: Some(1), threads: 0, ports, pace: Pace::Free };
    let output = run::run(session, &plan)?;
    Ok(output.packets.iter().map(|packet| packet.as_ref().and_then(|packet| Table::read(packet.bytes()))).collect())
}

/// Lengths between random points of the board of one pair, by the files of a calibration with and without what it states of its error.
fn measure(
    session: &dyn Session,
    set: &BoardSet<'_>,
    calibrations: &[PathBuf; 2],
    pair: [&Path; 2],
) -> Result<Vec<Length>> {
    let board = toml::Value::from(set.board.to_string());
    let find = scene::rectified("batch", &["opencv"], &source(pair, &calibrations[0]))
        + &format!(
            "[nodes.board]\ntype = \"find_board\"\ninputs = {{ image = \"rectify.left\" }}\nparams = {{ board = {board} }}\n"
        );
    let found = run_once(session, &find, &[("board", "table")])?.remove(0).context("the board's table is cut off")?;
    let (ends, true_mm) = chosen(&found);
    if true_mm.is_empty() {
        return Ok(Vec::new());
    }
    let mut out = Vec::new();
    for calibration in calibrations {
        let text = scene::depth("batch", &source(pair, calibration)) + &lengths(&ends);
        let table = run_once(session, &text, &[("lengths", "table")])?.remove(0).context("the lengths are cut off")?;
        out.push((
            table.column("distance_mm").context("no distance_mm")?,
            table.column("error_mm").context("no error_mm")?,
        ));
    }
    let rows = (0..true_mm.len()).filter(|row| out[0].0[*row].is_finite());
    Ok(rows
        .map(|row| Length {
            error_mm: (out[0].0[row] - true_mm[row]).abs(),
            bound_mm: out[0].1[row],
            plain_mm: out[1].1[row],
        })
        .collect())
}

/// Ends of the measured lengths (u, v of both, one after the other), and the true lengths, mm.
fn chosen(found: &Table) -> (Vec<f64>, Vec<f64>) {
    let (mut ends, mut true_mm) = (Vec::new(), Vec::new());
    let mut random = SplitMix64(SEED);
    if found.rows.len() >= 2 {
        for _ in 0..LENGTHS {
            let mut pick = || &found.rows[random.below(found.rows.len())];
            if let ([_, x0, y0, u0, v0], [_, x1, y1, u1, v1]) = (&pick()[..], &pick()[..])
                && (x0, y0) != (x1, y1)
            {
                ends.extend([u0, v0, u1, v1].map(|v| (v * 100.0).round() / 100.0));
                true_mm.push((x1 - x0).hypot(y1 - y0));
            }
        }
    }
    (ends, true_mm)
}

/// Node `lengths`: between these points, by the depth preset.
fn lengths(ends: &[f64]) -> String {
    format!(
        r#"
[nodes.lengths]
type = "measure"
inputs = {{ cloud = "depth.cloud", calibration = "depth.calibration", confidence = "depth.confidence" }}
params = {{ points = {ends:?} }}
"#
    )
}
