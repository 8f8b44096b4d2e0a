//! Held-out scenes of the phantom: their images with exact outlines, and the distance of found tips from the true
//! ones.

use std::path::Path;

use serde_json::Value;

use super::find::Node;
use super::truth::{self, Truth};
use crate::error::{Context, FileAction, OnFile, Result};
use crate::inputs::Folder;
use crate::run::{self, Plan};
use crate::session::{Session, check_cancelled};

/// First seed beyond those of the training.
const FIRST_SEED: u64 = 2_000_001;
const SCENES: [&str; 3] = ["liver", "bowel", "cavity"];
/// Instruments of the scenes for tips, one each.
const KINDS: [&str; 7] = ["grasper", "bipolar", "hook", "scissors", "clipper", "irrigator", "specimen_bag"];
/// Number of images of each scene, a second apart.
const FRAMES: u64 = 12;

/// Renders frames with one to four instruments into `scratch`.
pub fn frames(session: &dyn Session, scratch: &Folder) -> Result<Truth> {
    let mut all = Truth::default();
    for index in 0..9u64 {
        let folder = scratch.path().join(format!("scene{index}"));
        std::fs::create_dir_all(&folder).on_file(FileAction::Create, &folder)?;
        let text = format!(
            "mode = \"batch\"\nplugins = [\"phantom\", \"sinks\"]\n\
             [nodes.scope]\ntype = \"phantom\"\n\
             params = {{ scene = \"{}\", seed = {}, tools = {}, rate_hz = 1.0, width = 640, height = 360, distance_mm = {:?} }}\n\
             [nodes.pictures]\ntype = \"write_images\"\ninputs = {{ image = \"scope.left\" }}\nparams = {{ path = \"{{seq}}.png\" }}\n\
             [nodes.truth]\ntype = \"write_table\"\ninputs = {{ instances = \"scope.instances\" }}\nparams = {{ path = \"truth.json\" }}\n",
            SCENES[index as usize % 3],
            FIRST_SEED + index,
            1 + index % 4,
            40.0 + 5.0 * index as f64,
        );
        let path = folder.join("eval.toml");
        let plan = Plan { text: &text, path: &path, frames: Some(FRAMES), ..Plan::default() };
        run::run(session, &plan)?;
        let scene = truth::read(session, &folder.join("truth.json"), None, None)?;
        all.classes = scene.classes;
        all.pictures.extend(scene.pictures);
        check_cancelled(session)?;
    }
    Ok(all)
}

/// Found tips compared with true ones.
#[derive(Default)]
pub struct Tips {
    /// Ticks in which a tip is visible.
    pub seen: usize,
    /// Image distances of found tips, px.
    pub errors_px: Vec<f64>,
    /// Distances in space of those with a valid position, mm.
    pub errors_mm: Vec<f64>,
    /// Per kind of instrument: tips seen, found, and their median distance in px.
    pub kinds: Vec<(String, usize, usize, f64)>,
}

impl Tips {
    /// Median of distances; NaN if there are none.
    pub fn median(values: &[f64]) -> f64 {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
    }

    /// Numbers of visible and found tips.
    pub fn count(&self) -> [usize; 2] {
        [self.seen, self.errors_px.len()]
    }

    /// Ends a kind of instrument, with the counts `before` it began.
    pub fn end_kind(&mut self, name: &str, before: [usize; 2]) {
        let own = &self.errors_px[before[1]..];
        self.kinds.push((name.to_owned(), self.seen - before[0], own.len(), Self::median(own)));
    }
}

/// Input for finding the tip.
#[derive(Clone, Copy)]
pub enum From<'a> {
    /// True outlines, for the error of `tool_tip` alone.
    TrueMasks,
    /// A model's boxes or outlines.
    Model(Node, &'a Path),
}

/// Lines of a JSONL table.
pub fn read_lines(path: &Path) -> Result<Vec<Value>> {
    let text = std::fs::read_to_string(path).on_file(FileAction::Read, path)?;
    text.lines().map(|l| serde_json::from_str(l).with_context(|| format!("{} is damaged", path.display()))).collect()
}

/// Number of a line's tick.
pub fn seq(line: &Value) -> Option<u64> {
    line.get("seq").and_then(Value::as_u64)
}

/// Position of a line's tip in the image, px, and in space, mm.
pub fn place(line: &Value) -> Option<([f64; 2], Option<Vec<f64>>)> {
    let tip = line.get("tip")?;
    let xyz = tip.get("xyz_mm").and_then(Value::as_array);
    let xyz = xyz.and_then(|v| v.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>());
    Some(([tip.get("u_px")?.as_f64()?, tip.get("v_px")?.as_f64()?], xyz))
}

/// Runs scenes with one instrument each through `tool_tip` with the true depth.
pub fn tips(session: &dyn Session, from: From<'_>) -> Result<Tips> {
    let scratch = Folder::new("panoscope-tips")?;
    let (finder, inputs) = match from {
        From::TrueMasks => (String::new(), "instances = \"scope.instances\"".to_owned()),
        From::Model(node, model) => (node.text("scope.left", model), node.tip_inputs("scope.left")),
    };
    let mut out = Tips::default();
    for (index, kind) in KINDS.iter().enumerate() {
        let text = format!(
            "mode = \"batch\"\nplugins = [\"phantom\", \"tools\", \"sinks\"]\n\
             [nodes.scope]\ntype = \"phantom\"\n\
             params = {{ scene = \"{}\", seed = {}, tools = 1, tool_kinds = \"{kind}\", \
             rate_hz = 1.0, width = 640, height = 360, distance_mm = 80.0, speed_mm_s = 4.0 }}\n{finder}\
             [nodes.tip]\ntype = \"tool_tip\"\ninputs = {{ {inputs}, depth = \"scope.depth\", calibration = \"scope.calibration\" }}\n\
             [nodes.found]\ntype = \"write_table\"\ninputs = {{ tip = \"tip.tip\" }}\nparams = {{ path = \"found.jsonl\" }}\n\
             [nodes.truth]\ntype = \"write_table\"\ninputs = {{ tip = \"scope.tip\" }}\nparams = {{ path = \"truth.jsonl\" }}\n",
            SCENES[index % 3],
            FIRST_SEED + 100 + index as u64,
        );
        let path = scratch.path().join("eval.toml");
        let plan = Plan { text: &text, path: &path, frames: Some(FRAMES), ..Plan::default() };
        run::run(session, &plan)?;
        let read = |name: &str| read_lines(&scratch.path().join(name));
        let (found, real) = (read("found.jsonl")?, read("truth.jsonl")?);
        let before = out.count();
        for line in &real {
            let Some((uv, xyz)) = place(line) else { continue };
            out.seen += 1;
            let Some((own, own_xyz)) = found.iter().find(|f| seq(f) == seq(line)).and_then(place) else { continue };
            out.errors_px.push((own[0] - uv[0]).hypot(own[1] - uv[1]));
            if let (Some(a), Some(b)) = (own_xyz, xyz) {
                out.errors_mm.push(a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt());
            }
        }
        out.end_kind(kind, before);
    }
    Ok(out)
}
