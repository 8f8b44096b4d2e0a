//! The closed loop as a graph: phantom, tip, tracker, controller, arm, and back.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use panoscope_arm_core::rehearsal::Row;
use panoscope_engine::Listener;
use panoscope_engine::memory::FrameRef;
use panoscope_engine::sync::lock;
use panoscope_graph::GraphOptions;

use super::preset;
use crate::error::{Context, Result};
use crate::inputs::Folder;
use crate::packets::Table;
use crate::run::{self, Pace, Plan, Watchers};
use crate::session::Session;

/// Movements of the phantom's leading tool, and sources of its tip.
///
/// Scenarios up to `leave` use the exact tip while it is in view. `cross` and `occlusion` find it in true masks and
/// depth, among other tools that pass in front of it; `masks` so too, alone; `smoke` in true masks and the depth that
/// stereo finds in smoke; `detector` in boxes of the shipped detector and the depth that stereo finds.
pub const SCENARIOS: [&str; 11] =
    ["still", "step", "ramp", "circle", "strokes", "leave", "cross", "occlusion", "masks", "smoke", DETECTOR];
/// The scenario that needs a model.
pub const DETECTOR: &str = "detector";

/// A run.
pub struct Run {
    /// Rows of the table, one per tick.
    pub rows: Vec<Row>,
    /// Size of the images, px.
    pub size: (u32, u32),
}

/// Parts of the graph for a scenario.
struct Scene {
    /// Parameters of the phantom.
    phantom: &'static str,
    /// Nodes between phantom and tracker, as TOML.
    nodes: String,
    /// Outputs with tips, and with tips that another tool hides.
    tips: &'static str,
    hidden: &'static str,
}

const STEREO: &str = r#"
[nodes.match]
type = "stereo_bm"
inputs = { left = "scope.left", right = "scope.right" }
"#;

fn finder(id: &str, from: &str, depth: &str, class: &str) -> String {
    format!(
        "[nodes.{id}]\ntype = \"tool_tip\"\ninputs = {{ {from}, {depth}, calibration = \"scope.calibration\" }}\nparams = {{ class = \"{class}\" }}\n"
    )
}

fn scene(name: &str) -> Scene {
    let model = crate::inputs::shipped_model("instruments.onnx").unwrap_or_default();
    let (masks, true_depth) = ("instances = \"scope.instances\"", "depth = \"scope.depth\"");
    let stereo_depth = "disparity = \"match.disparity\"";
    let exact = |phantom| Scene { phantom, nodes: String::new(), tips: "\"scope.tip\"", hidden: "" };
    let found = |phantom, nodes| Scene { phantom, nodes, tips: "\"found.tip\"", hidden: "\"found.hidden\"" };
    let alone = "tools = 1, tool_kinds = \"grasper\"";
    match name {
        "cross" => Scene {
            phantom: "tools = 2, tool_kinds = \"grasper, clipper\"",
            nodes: finder("one", masks, true_depth, "grasper") + &finder("two", masks, true_depth, "clipper"),
            tips: "\"one.tip\", \"two.tip\"",
            hidden: "\"one.hidden\", \"two.hidden\"",
        },
        "occlusion" => {
            found("tools = 3, tool_kinds = \"grasper, hook, bipolar\"", finder("found", masks, true_depth, "grasper"))
        }
        "masks" => found(alone, finder("found", masks, true_depth, "")),
        "smoke" => found(
            "tools = 1, tool_kinds = \"grasper\", smoke = 0.5, noise = 2.0",
            STEREO.to_owned() + &finder("found", masks, stereo_depth, ""),
        ),
        DETECTOR => found(
            "tools = 1, tool_kinds = \"grasper\"",
            STEREO.to_owned()
                + &format!(
                    "[nodes.find]\ntype = \"yolo\"\ninputs = {{ image = \"scope.left\" }}\nparams = {{ model = {model:?}, min_score = 0.1 }}\n"
                )
                + &finder("found", "detections = \"find.detections\", image = \"scope.left\"", stereo_depth, ""),
        ),
        _ => exact(alone),
    }
}

/// The graph of a scenario, with its end.
fn text(name: &str, seed: u64, size: (u32, u32), mode: &str, end: &str) -> String {
    let motion = match name {
        "masks" | "occlusion" | "smoke" | DETECTOR => "strokes",
        name => name,
    };
    let Scene { phantom, nodes, tips, hidden } = scene(name);
    let hidden = if hidden.is_empty() { String::new() } else { format!("hidden = [{hidden}], ") };
    let (width, height) = size;
    format!(
        r#"# The closed loop that `panoscope eval arm` judges.
mode = "{mode}"
plugins = ["phantom", "stereo", "tools", "arm", "sinks"]

[nodes.scope]
type = "phantom"
inputs = {{ camera_pose = {{ from = "arm.camera_pose", delay = 1 }} }}
params = {{ seed = {seed}, distance_mm = 85.0, width = {width}, height = {height}, {phantom}, tool_motion = "{motion}" }}

{nodes}
[nodes.track]
type = "tip_track"
inputs = {{ tip = [{tips}], {hidden}camera_pose = {{ from = "arm.camera_pose", delay = 1 }}, calibration = "scope.calibration" }}

[nodes.control]
type = "arm_pid"
inputs = {{ tip = "track.tip", joints = {{ from = "arm.joints", delay = 1 }}, setpoint = {{ from = "arm.setpoint", delay = 1 }}, calibration = "scope.calibration" }}

[nodes.arm]
type = "arm_sim"
inputs = {{ joints = "control.joints", tip = "track.tip" }}

{end}
"#
    )
}

const JUDGE: &str = r#"[nodes.judge]
type = "evaluate_arm"
inputs = { tip = "scope.lead", arm = "arm.table", track = "track.table", calibration = "scope.calibration" }
"#;

/// Runs a scenario and reads the evaluation's rows.
pub fn run(session: &dyn Session, name: &str, seed: u64, seconds: u32, width: u32) -> Result<Run> {
    let size = (width, width * 3 / 4);
    let text = text(name, seed, size, "batch", JUDGE);
    judged(session, &text, Path::new(&format!("eval_arm_{name}.toml")), name, seconds, size)
}

/// Runs a scenario of a shipped graph.
pub fn run_preset(session: &dyn Session, name: &str, seed: u64, seconds: u32, file: PathBuf) -> Result<Run> {
    let text = run::flattened(&file, &GraphOptions::default())?;
    let preset = preset::of(name, seed, &text, file)?;
    judged(session, &preset.text, &preset.path, name, seconds, preset.size)
}

fn judged(session: &dyn Session, text: &str, path: &Path, name: &str, seconds: u32, size: (u32, u32)) -> Result<Run> {
    let plan = Plan { text, path, frames: Some(u64::from(seconds) * 30), ..Plan::default() };
    let rows: Arc<Mutex<BTreeMap<u64, Option<Table>>>> = Arc::default();
    let heard = Arc::clone(&rows);
    let hear = move |frame: &FrameRef| _ = lock(&heard).insert(frame.tick().seq, Table::read(frame.bytes()));
    let listener = Listener { node: "judge".to_owned(), output: "table".to_owned(), hear: Arc::new(hear) };
    run::run_watched(session, &plan, Watchers { listen: vec![listener], ..Watchers::default() })?;
    let mut table = Table::default();
    for ticks in std::mem::take(&mut *lock(&rows)).into_values() {
        let ticks = ticks.context("the table of the evaluating node is malformed")?;
        table.rows.extend(ticks.rows);
        table.names = ticks.names;
    }
    (!table.rows.is_empty()).then_some(()).context("the evaluating node received no packets")?;
    let column = |name: &str| table.required("the judge's table", name);
    let [time, error, u, v, distance] =
        ["time_s", "error_mm", "error_u_px", "error_v_px", "error_distance_mm"].map(column);
    let [view, is_seen, pivot, following, speed, change] =
        ["in_view", "seen", "pivot_mm", "following", "camera_mm_s", "camera_mm_s2"].map(column);
    let (time, error, u, v, distance) = (time?, error?, u?, v?, distance?);
    let (view, is_seen, pivot, following, speed, change) = (view?, is_seen?, pivot?, following?, speed?, change?);
    let (gap, off) = (column("gap_ms")?, column("track_off_mm")?);
    // Pictures of all sizes are judged as if they had 640 columns.
    let scale = 640.0 / f64::from(size.0);
    let rows = (0..time.len())
        .map(|k| Row {
            at_s: time[k],
            error_mm: error[k],
            error_px: [u[k] * scale, v[k] * scale],
            distance_error_mm: distance[k],
            in_view: view[k] > 0.5,
            is_hidden: view[k] > 0.5 && is_seen[k] < 0.5,
            is_away: name == "leave" && (0.0..11.5).contains(&((time[k] - 2.0).max(0.0) % 12.0)),
            pivot_mm: pivot[k],
            following: following[k] > 0.5,
            camera_mm_s: speed[k],
            camera_mm_s2: change[k],
            gap_s: gap[k] * 1e-3,
            track_off_mm: off[k],
        })
        .collect();
    Ok(Run { rows, size })
}

/// Age of the arm's set-points from the cameras' shutter on, in ms, median and 99 %: the loop runs live at 30 frames
/// per second, rendering included.
pub fn set_point_age(session: &dyn Session, seed: u64, seconds: u32, width: u32) -> Result<(f64, f64)> {
    let folder = Folder::new("panoscope-eval-arm")?;
    let sink = format!(
        "[nodes.sent]\ntype = \"write_table\"\ninputs = {{ joints = \"arm.setpoint\" }}\nparams = {{ path = {:?} }}\n",
        folder.path().join("setpoints.csv")
    );
    let text = text("strokes", seed, (width, width * 3 / 4), "live", &sink);
    let plan = Plan {
        text: &text,
        path: Path::new("eval_arm_age.toml"),
        frames: Some(u64::from(seconds) * 30),
        pace: Pace::Camera,
        ..Plan::default()
    };
    let report = run::run(session, &plan)?.report;
    let ages = report.paths.get("sent").context("the controller sent no set-point")?;
    Ok((ages.age_p50_ms, ages.age_p99_ms))
}
