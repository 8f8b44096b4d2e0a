//! Chapter 4 compared with chapter 2 on images that are hard to stitch: the thesis's Tables 4.1 (share of stitchable
//! frames), 4.2 (alignment error) and 4.3 (time), and the jitter of the result.
//!
//! All methods get the same frames. The phantom's cases have exact ground truth; real pairs are evaluated with
//! correspondences from correlation.

use std::path::{Path, PathBuf};

use panoscope_engine::text_table::{number, table};
use panoscope_graph::GraphOptions;
use toml::Value;

use super::beside::{self, Method, Times};
use super::sources::{self, Source};
use super::tally::{self, StitchScore};
use crate::error::{FileAction, OnFile, Result};
use crate::figures::Figure;
use crate::inputs::{Folder, find, wants};
use crate::packets::Table;
use crate::plot::{self, Chart, Series, Style};
use crate::session::{Session, note};
use crate::statistics::rms;

/// Methods evaluated by default: the thesis's two, then ours.
const METHODS: [&str; 4] = ["chapter 2", "chapter 4", "ROI", "grid"];
/// Ticks for the registration to settle before its jitter is measured.
const SETTLE: usize = 5;
/// Timed ticks, one at a time.
const TIMED: u64 = 16;
/// Minimum number of ticks of a run with still views.
const STILL: u64 = 16;

/// One kind of images.
struct Case {
    name: &'static str,
    /// Title in tables.
    title: &'static str,
    /// Parameters of the phantom.
    params: &'static [(&'static str, f64)],
    /// Whether its fault also occurs with still cameras.
    can_rest: bool,
}

/// Strengths at which the methods differ: each weaker fault leaves all of them at 100 %.
const CASES: [Case; 7] = [
    Case { name: "plain", title: "as it is", params: &[], can_rest: true },
    Case { name: "smooth", title: "smooth, few features", params: &[("texture", 0.15)], can_rest: true },
    Case { name: "bare", title: "hardly any features", params: &[("texture", 0.05)], can_rest: true },
    Case { name: "smoke", title: "smoke", params: &[("smoke", 1.0)], can_rest: true },
    Case {
        name: "blur",
        title: "motion blur, 25 px",
        params: &[("speed_mm_s", 100.0), ("motion_blur", 10.0)],
        can_rest: false,
    },
    Case { name: "dark", title: "low light, noise", params: &[("light", 0.05), ("noise", 3.0)], can_rest: true },
    Case {
        name: "worst",
        title: "smooth, smoke, low light",
        params: &[("texture", 0.3), ("smoke", 0.5), ("light", 0.2), ("noise", 2.0)],
        can_rest: true,
    },
];

/// Scenes of the phantom in each case.
const SCENES: [&str; 2] = ["liver", "bowel"];

/// Result of one method in one case.
#[derive(Clone, Debug, Default)]
struct Outcome {
    tally: StitchScore,
    /// Motion of the mapped image grid from frame to frame while nothing moves, RMS px; NaN if the case has no still
    /// run.
    jitter_px: f64,
    times: Option<Times>,
}

/// Results of one case.
struct CaseResult {
    name: String,
    title: String,
    input: String,
    /// One outcome per method.
    outcomes: Vec<Outcome>,
    /// Alignment error of the best plane, px.
    floor_px: f64,
}

fn integer(name: &str) -> bool {
    matches!(name, "motion_blur" | "seed")
}

fn phantom(case: &Case, scene: &str, rests: bool, settings: &[String]) -> Source {
    let value = |name: &str, number: f64| if integer(name) { Value::from(number as i64) } else { Value::from(number) };
    let own = case.params.iter().map(|(name, number)| (*name, value(name, *number)));
    let motion = (case.name == "blur").then(|| ("camera_path", Value::from("glide")));
    let rest = rests.then_some([("speed_mm_s", Value::from(0.0)), ("breathing_mm", Value::from(0.0))]);
    let all = [("scene", Value::from(scene))].into_iter().chain(own).chain(motion);
    Source::phantom(all.chain(beside::source_params(settings)).chain(rest.into_iter().flatten()))
}

/// Motion of the map from frame to frame, RMS px.
fn jitter_px(rows: &Table) -> f64 {
    rms(rows.column("move_px").unwrap_or_default().get(SETTLE..).unwrap_or_default())
}

fn on_the_phantom(
    session: &dyn Session,
    case: &Case,
    methods: &[Method],
    frames: u64,
    settings: &[String],
) -> Result<CaseResult> {
    let mut outcomes = vec![Outcome { jitter_px: f64::NAN, ..Outcome::default() }; methods.len()];
    let (mut all_floors, mut jitters) = (Vec::new(), vec![Vec::new(); methods.len()]);
    for scene in SCENES {
        let source = phantom(case, scene, false, settings);
        let tables = beside::judged(session, methods, &source, frames.div_ceil(2))?;
        let floors = tally::floors(&tables.iter().collect::<Vec<_>>());
        for (outcome, rows) in outcomes.iter_mut().zip(&tables) {
            outcome.tally = outcome.tally.and(&StitchScore::of(rows, &floors, 0)?);
        }
        all_floors.extend(floors);
        if case.can_rest {
            let still =
                beside::judged(session, methods, &phantom(case, scene, true, settings), frames.div_ceil(2).max(STILL))?;
            for (jitters, rows) in jitters.iter_mut().zip(&still) {
                jitters.push(jitter_px(rows));
            }
        }
    }
    for ((outcome, method), jitters) in outcomes.iter_mut().zip(methods).zip(&jitters) {
        outcome.jitter_px = rms(jitters);
        outcome.times =
            Some(beside::timed(session, method, &phantom(case, SCENES[0], false, settings), TIMED.min(frames))?);
    }
    let input = format!("phantom liver and bowel 640x480, {}, {} frames", case.title, 2 * frames.div_ceil(2));
    let (name, title) = (case.name.to_owned(), case.title.to_owned());
    Ok(CaseResult { name, title, input, outcomes, floor_px: rms(&all_floors) })
}

/// Evaluates on real stereo pairs, if available; they have no ground truth and no still run.
fn on_real_pairs(
    session: &dyn Session,
    methods: &[Method],
    folders: &[PathBuf],
    work: &Path,
) -> Result<Option<CaseResult>> {
    let Some(folder) = find(folders, "hamlyn_640x480") else { return Ok(None) };
    let source = sources::hamlyn(&folder, work)?;
    let pairs = std::fs::read_dir(folder.join("left")).on_file(FileAction::Read, &folder)?.count() as u64;
    let tables = beside::judged(session, methods, &source, pairs)?;
    let floors = tally::floors(&tables.iter().collect::<Vec<_>>());
    let mut outcomes = Vec::new();
    for (method, rows) in methods.iter().zip(&tables) {
        outcomes.push(Outcome {
            tally: StitchScore::of(rows, &floors, 0)?,
            jitter_px: f64::NAN,
            times: Some(beside::timed(session, method, &source, TIMED.min(pairs))?),
        });
    }
    let judged = outcomes.first().map_or(0, |outcome| outcome.tally.frames);
    let input =
        format!("Hamlyn pairs 640x480, {judged} of {pairs} frames, judged by correspondences found by correlation");
    let (name, title) = ("hamlyn".to_owned(), "real pairs (Hamlyn)".to_owned());
    Ok(Some(CaseResult { name, title, input, outcomes, floor_px: rms(&floors) }))
}

/// A measure: title of its table, name and unit of its figures, decimals, and its value in an outcome.
struct Measure {
    title: &'static str,
    name: &'static str,
    unit: &'static str,
    places: usize,
    value: fn(&Outcome) -> f64,
}

const MEASURES: [Measure; 5] = [
    Measure {
        title: "Table 4.1: stitchable frames, %",
        name: "stitched_share",
        unit: "%",
        places: 1,
        value: |o| o.tally.stitched_pct(),
    },
    Measure {
        title: "believed and wrong, %",
        name: "wrong_share",
        unit: "%",
        places: 1,
        value: |o| o.tally.wrong_pct(),
    },
    Measure {
        title: "Table 4.2: alignment of stitched frames, px",
        name: "align_px",
        unit: "px",
        places: 2,
        value: |o| o.tally.align_px(),
    },
    Measure {
        title: "Table 4.3: time of a frame, ms",
        name: "stitch_ms",
        unit: "ms",
        places: 2,
        value: |o| o.times.map_or(f64::NAN, |times| times.whole_ms()),
    },
    Measure { title: "jitter at rest, px", name: "jitter_px", unit: "px", places: 2, value: |o| o.jitter_px },
];

fn tables(names: &[&str], all: &[CaseResult]) -> String {
    let mut text = String::new();
    for measure in &MEASURES {
        let is_alignment = measure.name == "align_px";
        let mut head = vec![measure.title.to_owned()];
        head.extend(names.iter().map(|name| (*name).to_owned()));
        head.extend(is_alignment.then(|| "best plane".to_owned()));
        let mut rows = vec![head];
        for judged in all {
            let mut row = vec![judged.title.clone()];
            row.extend(judged.outcomes.iter().map(|outcome| number((measure.value)(outcome), measure.places)));
            row.extend(is_alignment.then(|| number(judged.floor_px, measure.places)));
            rows.push(row);
        }
        text += &table(&rows);
        text += "\n";
    }
    text
}

fn charts(names: &[&str], all: &[CaseResult]) -> Vec<Chart> {
    let words: Vec<(f64, String)> =
        all.iter().enumerate().map(|(at, judged)| (at as f64, judged.name.clone())).collect();
    let wanted = MEASURES.iter().filter(|measure| measure.name != "wrong_share");
    let of = |measure: &Measure| {
        let line = |(index, name): (usize, &&str)| {
            // Side by side, so that equal values stay apart.
            let shift = (index as f64 - (names.len() as f64 - 1.0) / 2.0) * 0.12;
            let value =
                |(at, judged): (usize, &CaseResult)| (at as f64 + shift, (measure.value)(&judged.outcomes[index]));
            Series::new(*name, Style::Dots, index, all.iter().enumerate().map(value).collect())
        };
        let (table, label) = measure.title.split_once(": ").unwrap_or(("Stability", measure.title));
        Chart {
            title: format!("{table}: {}", label.split(',').next().unwrap_or_default()),
            x_label: "case".to_owned(),
            y_label: label.to_owned(),
            series: names.iter().enumerate().map(line).collect(),
            from_zero: true,
            words: words.clone(),
            ..Chart::default()
        }
    };
    wanted.map(of).collect()
}

fn figures(names: &[&str], all: &[CaseResult]) -> Vec<Figure> {
    let mut out = Vec::new();
    for judged in all {
        for (name, outcome) in names.iter().zip(&judged.outcomes) {
            for measure in &MEASURES {
                let value = (measure.value)(outcome);
                if value.is_finite() {
                    let case = format!("{}/{}_{}", measure.name, judged.name, name.replace(' ', "_"));
                    out.push(Figure::new(&case, value, measure.unit, &judged.input));
                }
            }
        }
        if judged.floor_px.is_finite() {
            out.push(Figure::new(&format!("align_floor_px/{}", judged.name), judged.floor_px, "px", &judged.input));
        }
    }
    out
}

/// Names of all cases.
pub fn known() -> Vec<&'static str> {
    CASES.iter().map(|case| case.name).chain(["hamlyn"]).collect()
}

/// Options of [`judge`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Graph files; default: the thesis's two and our two.
    pub graphs: Vec<PathBuf>,
    /// Names of [`known`] cases; default: all.
    pub only: Vec<String>,
    /// Ticks of each run.
    pub frames: u64,
    /// `NODE.PARAM=VALUE`; node `scope` is the source that all graphs share.
    pub settings: Vec<String>,
    /// Overlays of the graphs, and values of their arguments.
    pub given: GraphOptions,
    /// Folders of data sets, searched before the default ones.
    pub data: Vec<PathBuf>,
    /// Image file (PNG) for a plot of all measures by case.
    pub plot: Option<PathBuf>,
}

/// Evaluates each graph on hard images: share of stitched frames, alignment, time, jitter.
///
/// Returns no figures if every case was skipped; the session receives the reasons.
///
/// # Errors
/// A graph or a setting cannot be used, a run fails, or the plot cannot be written.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let work = Folder::new("panoscope-eval")?;
    let methods = beside::methods(&options.graphs, &METHODS, &options.given, &options.settings)?;
    let names: Vec<&str> = methods.iter().map(|method| method.name.as_str()).collect();
    let wanted = |name: &str| wants(&options.only, name);
    let mut all = Vec::new();
    for case in CASES.iter().filter(|case| wanted(case.name)) {
        note!(session, "{}: {}", case.name, case.title);
        all.push(on_the_phantom(session, case, &methods, options.frames, &options.settings)?);
    }
    if wanted("hamlyn") {
        match on_real_pairs(session, &methods, &sources::data_folders(&options.data), work.path())? {
            Some(judged) => all.push(judged),
            None => note!(session, "skipped: hamlyn: there is no hamlyn_640x480 in the data folders (give --data)"),
        }
    }
    session.table(&format!("{}\n\n{}", tally::rule(), tables(&names, &all)));
    if let Some(path) = options.plot.as_ref().filter(|_| !all.is_empty()) {
        plot::save(path, &charts(&names, &all))?;
    }
    Ok(figures(&names, &all))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(title: &str, stitched: [usize; 2]) -> CaseResult {
        let outcome = |stitched| Outcome {
            tally: StitchScore { frames: 50, stitched, wrong: 5, ..StitchScore::default() },
            jitter_px: f64::NAN,
            times: Some(Times { registration_ms: 2.0, composite_ms: 0.5 }),
        };
        let outcomes = stitched.map(outcome).into();
        CaseResult { name: title.to_owned(), title: title.to_owned(), input: String::new(), outcomes, floor_px: 1.25 }
    }

    #[test]
    fn the_tables_of_the_thesis_stand_side_by_side() {
        let text = tables(&["chapter 2", "chapter 4"], &[judged("smoke", [10, 50]), judged("dark", [0, 45])]);
        let lines: Vec<&str> = text.lines().collect();
        let after = |what: &str, rows: usize| {
            let at = lines.iter().position(|line| line.contains(what)).unwrap_or_else(|| panic!("{text}"));
            lines[at + rows].split_whitespace().collect::<Vec<_>>()
        };
        assert_eq!(after("Table 4.1", 1), ["smoke", "20.0", "100.0"]);
        assert_eq!(after("believed and wrong", 2), ["dark", "10.0", "10.0"]);
        assert_eq!(after("Table 4.2", 1), ["smoke", "-", "-", "1.25"]);
        assert_eq!(after("Table 4.3", 1), ["smoke", "2.50", "2.50"]);
        assert_eq!(after("jitter", 2), ["dark", "-", "-"]);
    }

    #[test]
    fn figures_leave_out_what_was_not_measured() {
        let figures = figures(&["chapter 2", "grid"], &[judged("smoke", [10, 50])]);
        let value = |name: &str| figures.iter().find(|f| f.name == name).map(|f| f.value);
        assert_eq!(value("stitched_share/smoke_chapter_2"), Some(20.0));
        assert_eq!(value("stitched_share/smoke_grid"), Some(100.0));
        assert_eq!(value("align_floor_px/smoke"), Some(1.25));
        assert_eq!((value("align_px/smoke_grid"), value("jitter_px/smoke_grid")), (None, None));
    }

    #[test]
    fn a_case_at_rest_keeps_its_fault() {
        let dark = CASES.iter().find(|case| case.name == "dark").unwrap();
        let params = phantom(dark, "liver", true, &["scope.seed=9".to_owned()]).node["params"].clone();
        assert_eq!((params["speed_mm_s"].as_float(), params["light"].as_float()), (Some(0.0), Some(0.05)));
        assert_eq!((params["seed"].as_integer(), params["scene"].as_str()), (Some(9), Some("liver")));
        let blur = CASES.iter().find(|case| case.name == "blur").unwrap();
        let params = phantom(blur, "bowel", false, &[]).node["params"].clone();
        assert_eq!((params["camera_path"].as_str(), params["motion_blur"].as_integer()), (Some("glide"), Some(10)));
    }
}
