//! Positions of frames in a mosaic compared with ground truth, with and without loop closure.
//!
//! One camera of the phantom moves on a ring over a plane and over curved tissue. `end_drift`: when it is back at the
//! start; `lap_drift`: root mean square over the last lap; `floor`: error of the best homography of each frame, 0 for a
//! plane.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use crate::error::{Context, EvalError, Result};
use crate::figures::Figure;
use crate::inputs::{create, quoted, wants};
use crate::packets::Table;
use crate::plot::{self, Chart, Series, Style};
use crate::run::{self, Pace, Plan};
use crate::session::{Session, check_cancelled};
use crate::statistics::percentile;

/// Scenes: bowel without relief, and unchanged tissue.
pub const SCENES: [&str; 3] = ["plane", "bowel", "liver"];
/// Peer of closed loops.
const PEER: &str = "the same without loop closure";
/// Frames per second.
const RATE_HZ: f64 = 30.0;
/// Frames at the end of the path over which the closing error is taken.
const END_FRAMES: usize = 10;
/// Maximum number of keyframes, enough for every path here, so that nothing is dropped while drift is measured.
const KEYFRAMES: u32 = 200;
/// Height of the phantom's ring, for its length.
const RISE_MM: f64 = 1.5;

/// Options of [`judge`].
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Scenes to run; repeatable. Default: all.
    #[arg(long = "scene", value_name = "SCENE", value_parser = SCENES)]
    pub scenes: Vec<String>,
    /// Model of the maps between keyframes.
    #[arg(long, default_value_t = Self::default().model, value_parser = ["homography", "affine", "similarity"])]
    pub model: String,
    /// Laps of the path; drift is measured over the last one.
    #[arg(long, default_value_t = Self::default().laps, value_parser = clap::value_parser!(u32).range(1..=20))]
    pub laps: u32,
    /// Diameter of the path, mm.
    #[arg(long, default_value_t = Self::default().path_mm)]
    pub path_mm: f64,
    /// Speed of the camera, mm/s.
    #[arg(long, default_value_t = Self::default().speed_mm_s)]
    pub speed_mm_s: f64,
    /// Mean distance of the tissue, mm.
    #[arg(long, default_value_t = Self::default().distance_mm)]
    pub distance_mm: f64,
    /// Width of the camera's images, px.
    #[arg(long, default_value_t = Self::default().width, value_parser = clap::value_parser!(u32).range(160..=1920))]
    pub width: u32,
    /// Seed of the scenes.
    #[arg(long, default_value_t = Self::default().seed)]
    pub seed: u64,
    /// Folder for the mosaics.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Draws drift over time, a chart per scene.
    #[arg(long, value_name = "FILE.png")]
    pub plot: Option<PathBuf>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            scenes: Vec::new(),
            model: "homography".to_owned(),
            laps: 2,
            path_mm: 40.0,
            speed_mm_s: 20.0,
            distance_mm: 50.0,
            width: 640,
            seed: 7,
            pictures: None,
            plot: None,
        }
    }
}

impl Options {
    /// Frames of all laps and a few more, so that the camera has come back.
    fn frames(&self) -> u64 {
        let rise = RISE_MM * (self.distance_mm / 50.0).min(1.0);
        let path_mm = TAU * (self.path_mm / 2.0).hypot(2.0 * rise);
        (f64::from(self.laps) * path_mm / self.speed_mm_s * RATE_HZ).ceil() as u64 + 1
    }
}

fn text(scene: &str, is_closed: bool, options: &Options) -> String {
    let Options { width, seed, distance_mm, path_mm, speed_mm_s, model, .. } = options;
    let height = width * 3 / 4;
    let (tissue, relief) = if scene == "plane" { ("bowel", 0.0) } else { (scene, 1.0) };
    let still = options.pictures.as_ref().map_or_else(String::new, |folder| {
        let name = format!("{scene}_{}.png", if is_closed { "closed" } else { "open" });
        format!(
            "[nodes.still]\ntype = \"write_images\"\ninputs = {{ image = \"mosaic.mosaic\" }}\nparams = {{ path = {}, at_end = true }}\n",
            quoted(&folder.join(name))
        )
    });
    format!(
        r#"# The mosaic that `panoscope eval mosaic` judges.
mode = "batch"
plugins = ["phantom", "stitch", "sinks"]

[nodes.scope]
type = "phantom"
params = {{ scene = "{tissue}", relief = {relief:?}, seed = {seed}, distance_mm = {distance_mm:?}, width = {width}, height = {height}, rate_hz = {RATE_HZ:?}, camera_path = "ring", path_mm = {path_mm:?}, speed_mm_s = {speed_mm_s:?}, breathing_mm = 0.0 }}

[nodes.mosaic]
type = "mosaic"
inputs = {{ image = "scope.left" }}
params = {{ loop_closure = {is_closed}, model = "{model}", max_keyframes = {KEYFRAMES} }}

[nodes.judge]
type = "evaluate_mosaic"
inputs = {{ homography = "mosaic.homography", pose = "scope.pose", depth = "scope.depth", calibration = "scope.calibration" }}

{still}"#
    )
}

/// Result of one run.
struct JudgeInputs {
    /// Rows, one per tick.
    rows: Table,
    /// The mosaic's own last row.
    own: Table,
    p50_ms: f64,
    p99_ms: f64,
    max_ms: f64,
}

impl JudgeInputs {
    fn column(&self, name: &str) -> Result<Vec<f64>> {
        self.rows.required("the judge's table", name)
    }

    fn own(&self, name: &str) -> Result<f64> {
        let column = self.own.required("the mosaic's table", name)?;
        column.first().copied().context("the mosaic's table is empty")
    }

    /// Median over the path's end, where the camera is back where it began.
    fn end(&self, name: &str) -> Result<f64> {
        let column = self.column(name)?;
        Ok(percentile(&column[column.len().saturating_sub(END_FRAMES)..], 0.5))
    }

    /// Root mean square over the last of `laps` laps.
    fn last_lap(&self, name: &str, laps: u32) -> Result<f64> {
        let column = self.column(name)?;
        let from = column.len() - column.len() / laps.max(1) as usize;
        let known = || column[from..].iter().filter(|v| v.is_finite());
        Ok((known().map(|v| v * v).sum::<f64>() / known().count() as f64).sqrt())
    }
}

fn run(session: &dyn Session, scene: &str, is_closed: bool, options: &Options) -> Result<JudgeInputs> {
    let text = text(scene, is_closed, options);
    let plan = Plan {
        text: &text,
        path: Path::new("eval_mosaic.toml"),
        frames: Some(options.frames()),
        ports: &[("judge", "table"), ("mosaic", "table")],
        pace: Pace::Alone,
        ..Plan::default()
    };
    let seen = run::run(session, &plan)?;
    let table = |index: usize| -> Result<Table> {
        let packet = seen.packets[index].as_ref().context("a table is empty")?;
        Table::read(packet.bytes()).context("a table is malformed")
    };
    let node = seen.report.nodes.get("mosaic").context("the report has no entry of the mosaic")?;
    Ok(JudgeInputs { rows: table(0)?, own: table(1)?, p50_ms: node.p50_ms, p99_ms: node.p99_ms, max_ms: node.max_ms })
}

/// Drift of the mosaic on each scene, with and without loop closure.
///
/// # Errors
/// An option is out of range, a run fails, a file cannot be written, or the session is cancelled.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    for (name, value, low, high) in [
        ("--speed-mm-s", options.speed_mm_s, 1.0, 25.0),
        ("--path-mm", options.path_mm, 1.0, 100.0),
        ("--distance-mm", options.distance_mm, 15.0, 150.0),
    ] {
        if !(low..=high).contains(&value) {
            return Err(EvalError::Options { reason: format!("{name} is {value}; it must be {low} to {high}") });
        }
    }
    create(options.pictures.as_deref())?;
    let mut figures = Vec::new();
    let mut charts = Vec::new();
    for scene in SCENES.into_iter().filter(|scene| wants(&options.scenes, scene)) {
        check_cancelled(session)?;
        let closed = run(session, scene, true, options)?;
        let open = run(session, scene, false, options)?;
        listed(scene, &closed, &open, options, &mut figures)?;
        charts.push(chart(scene, &closed, &open)?);
    }
    if let Some(path) = &options.plot {
        plot::save(path, &charts)?;
    }
    Ok(figures)
}

/// Figures of one scene.
fn listed(
    scene: &str,
    closed: &JudgeInputs,
    open: &JudgeInputs,
    options: &Options,
    figures: &mut Vec<Figure>,
) -> Result<()> {
    let (width, height, laps) = (options.width, options.width * 3 / 4, options.laps);
    let input = format!(
        "ring of {} mm at {} mm/s, {} mm over the tissue, {laps} laps, {width}x{height}, {}",
        options.path_mm, options.speed_mm_s, options.distance_mm, options.model
    );
    let figure = |name: &str, value: f64, unit| Figure::new(&format!("{name}/{scene}"), value, unit, &input);
    let mut pair = |name: &str, unit, of: &dyn Fn(&JudgeInputs) -> Result<f64>| -> Result<()> {
        figures.push(figure(name, of(closed)?, unit).beside(PEER, Some(of(open)?)));
        Ok(())
    };
    pair("end_drift_px", "px", &|j| j.end("drift_px"))?;
    pair("end_drift_mm", "mm", &|j| j.end("drift_mm"))?;
    pair("end_drift_pct", "% of the path", &|j| j.end("drift_pct"))?;
    pair("lap_drift_px", "px", &|j| j.last_lap("drift_px", laps))?;
    pair("lap_drift_mm", "mm", &|j| j.last_lap("drift_mm", laps))?;
    figures.push(figure("floor_px", closed.last_lap("floor_px", laps)?, "px"));
    let states = closed.column("state")?;
    let fresh = states.iter().filter(|state| **state == 0.0).count() as f64;
    figures.push(figure("registered_pct", 100.0 * fresh / states.len().max(1) as f64, "%"));
    for (name, unit) in [("coverage_pct", "% of a view"), ("keyframes", ""), ("closures", ""), ("relocalised", "")] {
        figures.push(figure(name, closed.own(name)?, unit));
    }
    figures.push(figure("own_drift_px", closed.own("drift_px")?, "px"));
    figures.push(figure("frame_ms", closed.p50_ms, "ms"));
    figures.push(figure("frame_ms_p99", closed.p99_ms, "ms"));
    figures.push(figure("frame_ms_max", closed.max_ms, "ms"));
    Ok(())
}

/// Drift over time.
fn chart(scene: &str, closed: &JudgeInputs, open: &JudgeInputs) -> Result<Chart> {
    let at = |(tick, value): (usize, f64)| (tick as f64 / RATE_HZ, value);
    let series = |name: &str, color: usize, values: Vec<f64>| {
        Series::new(name, Style::Line, color, values.into_iter().enumerate().map(at).collect())
    };
    Ok(Chart {
        title: format!("Mosaic on {scene}: where frames are put, beside the truth"),
        x_label: "time, s".to_owned(),
        y_label: "drift, px".to_owned(),
        series: vec![
            series("open chain", 1, open.column("drift_px")?),
            series("closed loops", 0, closed.column("drift_px")?),
            series("best homography", 2, closed.column("floor_px")?),
        ],
        from_zero: true,
        ..Chart::default()
    })
}
