//! The closed loop as a graph: phantom, tip, tracker, controller, arm, and back.

use std::path::Path;

use anyhow::{Context, Result};
use panoscope_arm_core::rehearsal::Row;

use crate::commands::eval::look::{self, Plan, Table};

/// Movements of the phantom's leading tool.
pub const SCENARIOS: [&str; 8] = ["still", "step", "ramp", "circle", "strokes", "leave", "cross", "masks"];

/// A run.
pub struct Run {
    /// One per tick.
    pub rows: Vec<Row>,
    /// Of the pictures, px.
    pub size: (u32, u32),
}

/// The graph of a scenario. In `masks` (strokes) and `cross` the tip is found by `tool_tip` in true masks and true depth instead of told.
fn text(name: &str, seed: u64, size: (u32, u32)) -> String {
    let motion = if name == "masks" { "strokes" } else { name };
    let finder = |id: &str, class: &str| {
        format!(
            "[nodes.{id}]\ntype = \"tool_tip\"\ninputs = {{ instances = \"scope.instances\", depth = \"scope.depth\", calibration = \"scope.calibration\" }}\nparams = {{ class = \"{class}\" }}\n"
        )
    };
    let (tools, tip, from) = match name {
        "masks" => (1, finder("found", ""), "\"found.tip\""),
        "cross" => (2, finder("one", "hook") + &finder("two", "grasper"), "\"one.tip\", \"two.tip\""),
        _ => (1, String::new(), "\"scope.tip\""),
    };
    let (width, height) = size;
    format!(
        r#"# The closed loop that `panoscope eval arm` judges.
mode = "batch"
plugins = ["phantom", "tools", "arm"]

[nodes.scope]
type = "phantom"
inputs = {{ camera_pose = {{ from = "arm.camera_pose", delay = 1 }} }}
params = {{ seed = {seed}, distance_mm = 85.0, width = {width}, height = {height}, tools = {tools}, tool_kinds = "hook, grasper", tool_motion = "{motion}" }}

{tip}
[nodes.track]
type = "tip_track"
inputs = {{ tip = [{from}], camera_pose = {{ from = "arm.camera_pose", delay = 1 }}, calibration = "scope.calibration" }}

[nodes.control]
type = "arm_pid"
inputs = {{ tip = "track.tip", joints = {{ from = "arm.joints", delay = 1 }}, setpoint = {{ from = "arm.setpoint", delay = 1 }}, calibration = "scope.calibration" }}

[nodes.arm]
type = "arm_sim"
inputs = {{ joints = "control.joints", tip = "track.tip" }}

[nodes.judge]
type = "evaluate_arm"
inputs = {{ tip = "scope.tip", arm = "arm.table", calibration = "scope.calibration" }}
params = {{ track_id = 1 }}
"#
    )
}

/// Runs a scenario and reads what the judge saw.
pub fn run(name: &str, seed: u64, seconds: u32, width: u32) -> Result<Run> {
    let size = (width, width * 3 / 4);
    let text = text(name, seed, size);
    let path = format!("eval_arm_{name}.toml");
    let plan = Plan {
        text: &text,
        path: Path::new(&path),
        frames: Some(u64::from(seconds) * 30),
        threads: 0,
        ports: &[("judge", "table")],
        paced: false,
    };
    let seen = look::run(&plan)?;
    let packet = seen.packets[0].as_ref().context("the judge saw nothing")?;
    let table = Table::read(packet.bytes()).context("the judge's table could not be read")?;
    let column = |name: &str| table.column(name).with_context(|| format!("the judge's table has no column {name}"));
    let [time, error, u, v, distance] =
        ["time_s", "error_mm", "error_u_px", "error_v_px", "error_distance_mm"].map(column);
    let [view, pivot, following, speed, change] =
        ["in_view", "pivot_mm", "following", "camera_mm_s", "camera_mm_s2"].map(column);
    let (time, error, u, v, distance) = (time?, error?, u?, v?, distance?);
    let (view, pivot, following, speed, change) = (view?, pivot?, following?, speed?, change?);
    // Pictures of all sizes are judged as if they had 640 columns.
    let scale = 640.0 / f64::from(width);
    let rows = (0..time.len())
        .map(|k| Row {
            at_s: time[k],
            error_mm: error[k],
            error_px: [u[k] * scale, v[k] * scale],
            distance_error_mm: distance[k],
            in_view: view[k] > 0.5,
            is_away: name == "leave" && (0.5..11.9).contains(&((time[k] - 2.0).max(0.0) % 12.0))
                || name == "cross" && view[k] < 0.5,
            pivot_mm: pivot[k],
            following: following[k] > 0.5,
            camera_mm_s: speed[k],
            camera_mm_s2: change[k],
        })
        .collect();
    Ok(Run { rows, size })
}
