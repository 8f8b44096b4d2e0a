//! False and missed warnings near tissue and other tips, compared with the phantom's exact distances.

use std::path::Path;

use crate::error::{Context, Result};
use crate::figures::Figure;
use crate::inputs::wants;
use crate::packets::Table;
use crate::run::{self, Plan};
use crate::session::{Session, check_cancelled};

/// Sources of the positions of tips, tissue and instruments.
///
/// `exact`: exact tips, depth and masks, so that only tissue hidden by instruments is estimated. `matched`: depth from
/// block matching instead. `found`: tips found in masks too. `boxes`: the same with boxes instead of masks, as from a
/// detector.
pub const CHAINS: [&str; 4] = ["exact", "matched", "found", "boxes"];

/// Options of [`judge`].
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Sources of depth and instruments; repeatable. Default: all.
    #[arg(long = "chain", value_name = "CHAIN", value_parser = CHAINS)]
    pub chains: Vec<String>,
    /// Scenes to run; repeatable. Default: both.
    #[arg(long = "scene", value_name = "SCENE", value_parser = SCENES)]
    pub scenes: Vec<String>,
    /// Length of each run, s of media time.
    #[arg(long, default_value_t = Self::default().seconds, value_parser = clap::value_parser!(u32).range(1..=3600))]
    pub seconds: u32,
    /// Width of the phantom's images, px.
    #[arg(long, default_value_t = Self::default().width, value_parser = clap::value_parser!(u32).range(160..=1920))]
    pub width: u32,
    /// Mean distance of the tissue, mm: the nearer, the closer to it the instruments work.
    #[arg(long, default_value_t = Self::default().distance_mm)]
    pub distance_mm: f64,
    /// Seed of scenes and movements.
    #[arg(long, default_value_t = Self::default().seed)]
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { chains: Vec::new(), scenes: Vec::new(), seconds: 20, width: 640, distance_mm: 60.0, seed: 7 }
    }
}

/// Names of the scenes.
pub const SCENES: [&str; 2] = ["bowel", "liver"];

fn text(chain: &str, scene: &str, options: &Options) -> String {
    let Options { width, seed, distance_mm, .. } = options;
    let height = width * 3 / 4;
    let (found, masked) = match chain {
        "boxes" => ("detections", "detections = \"scope.detections\", image = \"scope.left\""),
        _ => ("instances", "instances = \"scope.instances\""),
    };
    let image = if found == "detections" { ", image = \"scope.left\"" } else { "" };
    let (nodes, tip_depth, depth) = match chain {
        "exact" => ("", "depth = \"scope.depth\"", "scope.depth"),
        _ => (
            r#"[nodes.match]
type = "stereo_bm"
inputs = { left = "scope.left", right = "scope.right" }

[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "match.disparity", calibration = "scope.calibration" }
"#,
            "disparity = \"match.disparity\"",
            "points.depth",
        ),
    };
    let tip = |class: &str| {
        format!(
            "[nodes.{class}]\ntype = \"tool_tip\"\ninputs = {{ {found} = \"scope.{found}\"{image}, {tip_depth}, calibration = \"scope.calibration\" }}\nparams = {{ class = \"{class}\" }}\n"
        )
    };
    let is_exact = matches!(chain, "exact" | "matched");
    let finders = if is_exact { String::new() } else { tip("grasper") + &tip("hook") };
    let tips = if is_exact { "\"scope.lead\", \"scope.second\"" } else { "\"grasper.tip\", \"hook.tip\"" };
    format!(
        r#"# Warnings that `panoscope eval proximity` judges.
mode = "batch"
plugins = ["phantom", "stereo", "tools"]

[nodes.scope]
type = "phantom"
params = {{ scene = "{scene}", seed = {seed}, distance_mm = {distance_mm:?}, width = {width}, height = {height}, tools = 2, tool_kinds = "grasper, hook", tool_motion = "strokes", speed_mm_s = 2.0 }}

{nodes}
{finders}
[nodes.near]
type = "proximity"
inputs = {{ tip = [{tips}], depth = "{depth}", {masked}, calibration = "scope.calibration" }}

[nodes.judge]
type = "evaluate_proximity"
inputs = {{ table = "near.table", truth = "scope.clearance" }}
"#
    )
}

/// Approaches, false and missed warnings of each chain on each scene.
///
/// # Errors
/// A run fails, or the session is cancelled.
pub fn judge(session: &dyn Session, options: &Options) -> Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for scene in SCENES.into_iter().filter(|scene| wants(&options.scenes, scene)) {
        for chain in CHAINS.into_iter().filter(|chain| wants(&options.chains, chain)) {
            check_cancelled(session)?;
            let text = text(chain, scene, options);
            let path = format!("eval_proximity_{chain}.toml");
            let plan = Plan {
                text: &text,
                path: Path::new(&path),
                frames: Some(u64::from(options.seconds) * 30),
                ports: &[("judge", "table")],
                ..Plan::default()
            };
            let seen = run::run(session, &plan)?;
            let table = Table::of_judge(seen.packets[0].as_ref())?;
            listed(&table, &format!("{chain}/{scene}"), options, &mut figures)?;
        }
    }
    Ok(figures)
}

/// Figures of one run.
fn listed(table: &Table, case: &str, options: &Options, figures: &mut Vec<Figure>) -> Result<()> {
    let value = |row: usize, name: &str| -> Result<f64> {
        let column = table.required("the judge's table", name)?;
        column.get(row).copied().context("the judge's table has too few rows")
    };
    let margin = value(1, "margin_mm")?;
    let (width, height) = (options.width, options.width * 3 / 4);
    let input = format!("two instruments on the phantom, {width}x{height}, {} s at 30 Hz", options.seconds);
    let mut add = |name: &str, of: f64, unit| figures.push(Figure::new(&format!("{name}/{case}"), of, unit, &input));
    for kind in ["tissue", "tips"] {
        let of = |row: usize, what: &str| value(row, &format!("{kind}_{what}"));
        add(&format!("{kind}_approaches"), of(1, "approaches")?, "");
        add(&format!("{kind}_missed"), of(1, "missed")?, "");
        add(&format!("{kind}_false"), of(1, "false")?, "");
        add(&format!("{kind}_warnings"), of(1, "warnings")?, "");
        add(&format!("{kind}_delay_ms"), of(1, "delay_ms")?, "ms");
        add(&format!("{kind}_rms_mm"), of(0, "rms_mm")?, "mm");
        add(&format!("{kind}_known_pct"), 100.0 * of(0, "known")? / of(0, "ticks")?.max(1.0), "%");
        add(&format!("{kind}_strict_approaches"), of(0, "approaches")?, "");
        add(&format!("{kind}_strict_missed"), of(0, "missed")?, "");
        add(&format!("{kind}_strict_false"), of(0, "false")?, "");
    }
    add("margin_mm", margin, "mm");
    Ok(())
}
