//! Evaluates a shipped graph with its own phantom, size, rates and tip; its sinks are replaced by an evaluation.

use std::path::{Path, PathBuf};

use crate::error::{Context, Result, bail};
use crate::inputs::references::{for_evaluation, kind_of, references, remove_sinks};
use crate::inputs::shipped_file;
use toml::{Table, Value};

/// Scenarios that are graphs, and their files.
const PRESETS: [(&str, &str); 4] = [
    ("chapter6", "graphs/thesis_chapter6.toml"),
    ("chapter6_sway", "graphs/thesis_chapter6.toml"),
    ("surgeon", "graphs/surgeon.toml"),
    ("surgeon_sway", "graphs/surgeon.toml"),
];
/// Suffix of the scenarios in which the instrument swings slowly and turns about its shaft: sometimes one of its jaws
/// hides the other.
const SWAY: &str = "_sway";

/// A preset prepared for evaluation.
pub struct Preset {
    /// Text of the graph with a `judge` node.
    pub text: String,
    /// Its file.
    pub path: PathBuf,
    /// Size of the phantom's images, px.
    pub size: (u32, u32),
}

/// Names of the scenarios.
pub fn names() -> impl Iterator<Item = &'static str> {
    PRESETS.iter().map(|(name, _)| *name)
}

/// The file of a preset: next to the program when installed, else in the repository.
pub fn file(name: &str) -> Option<PathBuf> {
    let (_, file) = PRESETS.iter().find(|(preset, _)| *preset == name)?;
    shipped_file(Path::new(file))
}

/// Makes a preset of the text of its file.
///
/// # Errors
/// The text is not a graph, or does not have exactly one each of `phantom`, `arm_sim`, `tip_track` and a tip that
/// follows the phantom's ground truth.
pub fn of(name: &str, seed: u64, text: &str, path: PathBuf) -> Result<Preset> {
    let mut graph: Table = text.parse().with_context(|| format!("{} is not TOML", path.display()))?;
    let Some(nodes) = for_evaluation(&mut graph) else { bail!("{} has no nodes", path.display()) };
    remove_sinks(nodes);
    let one = |kind: &str| -> Result<String> {
        let mut all = nodes.iter().filter(|(_, node)| kind_of(node) == kind).map(|(id, _)| id.clone());
        match (all.next(), all.next()) {
            (Some(id), None) => Ok(id),
            _ => bail!("{}: the graph must have exactly one node of type `{kind}`", path.display()),
        }
    };
    let (phantom, arm, track) = (one("phantom")?, one("arm_sim")?, one("tip_track")?);
    for truth in ["tip", "lead", "second", "detections", "instances", "depth", "disparity", "clearance"] {
        let truth = format!("{phantom}.{truth}");
        if nodes.values().any(|node| references(node).contains(&truth)) {
            bail!(
                "{}: a node reads `{truth}`, the phantom's ground truth; connect it to an estimate instead",
                path.display()
            );
        }
    }
    let params = nodes[&phantom].get("params");
    let side = |name: &str, default: i64| {
        let value = params.and_then(|params| params.get(name)?.as_integer()).unwrap_or(default);
        u32::try_from(value).with_context(|| format!("{}: `{name}` of `{phantom}` is {value}", path.display()))
    };
    let size = (side("width", 640)?, side("height", 480)?);
    let sways = name.ends_with(SWAY);
    let set = |node: &mut Value| {
        let params = node.as_table_mut()?.entry("params").or_insert_with(|| Value::Table(Table::new()));
        let params = params.as_table_mut()?;
        params.insert("seed".to_owned(), Value::Integer(i64::try_from(seed).ok()?));
        if sways {
            params.insert("tool_motion".to_owned(), "sway".into());
        }
        Some(())
    };
    nodes.get_mut(&phantom).and_then(set).with_context(|| format!("{}: `{phantom}` is not a node", path.display()))?;
    let inputs = [
        ("tip", format!("{phantom}.lead")),
        ("arm", format!("{arm}.table")),
        ("track", format!("{track}.table")),
        ("calibration", format!("{phantom}.calibration")),
    ];
    let mut judge = Table::new();
    judge.insert("type".to_owned(), "evaluate_arm".into());
    let inputs: Table = inputs.into_iter().map(|(port, from)| (port.to_owned(), from.into())).collect();
    judge.insert("inputs".to_owned(), inputs.into());
    nodes.insert("judge".to_owned(), judge.into());
    Ok(Preset { text: graph.to_string(), path, size })
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRAPH: &str = r#"
mode = "live"
plugins = ["phantom", "tools", "arm", "sinks"]
[nodes.scope]
type = "phantom"
params = { width = 320, height = 240 }
[nodes.follow]
type = "tip_track"
inputs = { tip = [{ from = "tip.tip", align = "latest" }] }
[nodes.arm]
type = "arm_sim"
inputs = { tip = "follow.tip" }
[nodes.file]
type = "write_table"
inputs = { table = "follow.table" }
"#;

    #[test]
    fn a_preset_keeps_all_but_its_files_and_gets_a_judge() {
        let preset = of("chapter6_sway", 9, GRAPH, PathBuf::from("graph.toml")).unwrap();
        assert_eq!(preset.size, (320, 240));
        let graph: Table = preset.text.parse().unwrap();
        assert_eq!(graph["mode"].as_str(), Some("batch"));
        assert!(graph["nodes"].get("file").is_none() && graph["nodes"].get("follow").is_some());
        assert_eq!(graph["nodes"]["judge"]["inputs"]["tip"].as_str(), Some("scope.lead"));
        assert_eq!(graph["nodes"]["judge"]["inputs"]["track"].as_str(), Some("follow.table"));
        let scope = &graph["nodes"]["scope"]["params"];
        assert_eq!((scope["seed"].as_integer(), scope["tool_motion"].as_str()), (Some(9), Some("sway")));
        let own = of("chapter6", 7, GRAPH, PathBuf::from("graph.toml")).unwrap().text;
        assert!(!own.contains("tool_motion"), "{own}");
    }

    #[test]
    fn a_graph_that_reads_the_truth_is_not_judged() {
        let peeks = GRAPH.replace("[{ from = \"tip.tip\"", "[\"scope.tip\", { from = \"tip.tip\"");
        let error = of("chapter6", 7, &peeks, PathBuf::from("graph.toml")).err().unwrap().to_string();
        assert!(error.contains("graph.toml") && error.contains("`scope.tip`"), "{error}");
        let error = of("surgeon", 7, "[nodes.a]\ntype = \"phantom\"\n", PathBuf::from("x.toml")).err().unwrap();
        assert!(error.to_string().contains("`arm_sim`"), "{error}");
    }
}
