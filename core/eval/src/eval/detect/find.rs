//! Runs a model in its real node on real images.

use std::collections::BTreeMap;
use std::path::Path;

use super::truth::{Truth, normal_name, read_found};
use crate::error::{Context, Result, bail};
use crate::inputs::{Folder, quoted};
use crate::run::{self, Plan};
use crate::session::{Session, note};
use panoscope_imaging::detect::Find;

/// Node that runs a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Node {
    /// `yolo`.
    Yolo,
    /// `mask_rcnn`.
    MaskRcnn,
}

impl Node {
    /// Its type.
    pub fn name(self) -> &'static str {
        match self {
            Self::Yolo => "yolo",
            Self::MaskRcnn => "mask_rcnn",
        }
    }

    /// The node `find` in a graph's text, with a model and its own parameters, on the output `image`.
    pub fn text(self, image: &str, model: &Path) -> String {
        self.text_with(image, model, &[])
    }

    /// As [`Self::text`], with further parameters (`param = value`).
    pub fn text_with(self, image: &str, model: &Path, settings: &[String]) -> String {
        let params: String = settings.iter().map(|setting| format!(", {setting}")).collect();
        format!(
            "[nodes.find]\ntype = \"{}\"\nbudget_ms = 60000\ninputs = {{ image = \"{image}\" }}\nparams = {{ model = {}{params} }}\n",
            self.name(),
            quoted(model)
        )
    }

    /// Inputs of a `tool_tip` after the node `find`.
    pub fn tip_inputs(self, image: &str) -> String {
        match self {
            Self::Yolo => {
                format!("detections = \"find.detections\", keypoints = \"find.keypoints\", image = \"{image}\"")
            }
            Self::MaskRcnn => format!("instances = \"find.instances\", image = \"{image}\""),
        }
    }

    /// Its output.
    pub fn port(self) -> &'static str {
        match self {
            Self::Yolo => "detections",
            Self::MaskRcnn => "instances",
        }
    }
}

/// Detections of all images and the time that they took.
pub struct Detections {
    /// Per image; class numbers are those of the ground truth.
    pub finds: Vec<Vec<Find>>,
    /// Median time of the node, ms.
    pub ms: f64,
}

/// Parameters for measuring AP: all but the weakest detections, per class, with loose suppression. `settings` override
/// them.
fn node_params(node: Node, model: &Path, settings: &[String]) -> String {
    // AP ranks every name that is thought possible: `unknown` would take the unsure ones away.
    let own: &[&str] = match node {
        Node::Yolo => &["max_boxes = 100", "unknown_below = 0.0"],
        Node::MaskRcnn => &["max_instances = 100"],
    };
    let mut params = vec![format!("model = {}", quoted(model))];
    params
        .extend(["min_score = 0.01", "max_overlap = 0.65", "track = false"].iter().chain(own).map(|p| (*p).to_owned()));
    let name = |setting: &str| setting.split('=').next().unwrap_or("").trim().to_owned();
    params.retain(|p| !settings.iter().any(|s| name(s) == name(p)));
    params.extend(settings.iter().cloned());
    params.join(", ")
}

/// Runs `model` in `node` over the images of `truth`. With `settings` (`param = value`) the node's parameters change.
pub fn run(session: &dyn Session, node: Node, model: &Path, truth: &Truth, settings: &[String]) -> Result<Detections> {
    let scratch = Folder::new("panoscope-eval")?;
    let out = scratch.path().join("found.json");
    let params = node_params(node, model, settings);
    let text = format!(
        "mode = \"batch\"\nplugins = [\"capture\", \"tools\", \"sinks\"]\n\
         [nodes.files]\ntype = \"capture\"\nparams = {{ left = {} , pace = \"off\" }}\n\
         [nodes.find]\ntype = \"{}\"\nbudget_ms = 60000\ninputs = {{ image = \"files.left\" }}\nparams = {{ {params} }}\n\
         [nodes.out]\ntype = \"write_table\"\ninputs = {{ {} = \"find.{}\" }}\nparams = {{ path = {} }}\n",
        toml::Value::String(truth.file_list()),
        node.name(),
        node.port(),
        node.port(),
        quoted(&out),
    );
    let count = truth.pictures.len() as u64;
    let path = scratch.path().join("eval.toml");
    let plan = Plan { text: &text, path: &path, frames: Some(count), ..Plan::default() };
    let seen = run::run(session, &plan)?;
    let report = seen.report.nodes.get("find").context("the node did not run")?;
    if report.faults > 0 {
        bail!("`{}` failed on {} of {count} images", node.name(), report.faults);
    }
    let found = read_found(&out)?;
    let mut strangers: BTreeMap<&str, usize> = BTreeMap::new();
    let mut finds = Vec::new();
    if found.by_image.len() != truth.pictures.len() {
        bail!("`{}` returned results for {} of {count} images", node.name(), found.by_image.len());
    }
    for (picture, annotations) in truth.pictures.iter().zip(found.by_image.values()) {
        let mut list = Vec::new();
        for a in annotations {
            let name = found.names.get(&a.category_id).map_or("", String::as_str);
            let Some(class) = truth.classes.iter().position(|c| *c == normal_name(name)) else {
                *strangers.entry(name).or_default() += 1;
                continue;
            };
            let mask = a.segmentation.as_ref().map(|s| s.mask(picture.width, picture.height)).transpose();
            let mask = mask.with_context(|| picture.path.display().to_string())?;
            list.push(Find { class, bbox: a.bbox, mask, score: a.score });
        }
        finds.push(list);
    }
    if !strangers.is_empty() {
        let names: Vec<String> = strangers.iter().map(|(n, c)| format!("{c} of `{n}`")).collect();
        note!(session, "left out, since the truth knows no such class: {}", names.join(", "));
    }
    Ok(Detections { finds, ms: report.p50_ms })
}
