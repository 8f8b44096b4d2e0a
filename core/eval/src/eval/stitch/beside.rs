//! Runs the registrations of several graphs on the same images.

use std::path::{Path, PathBuf};

use panoscope_graph::{Catalog, GraphOptions};
use toml::{Table, Value};

use super::graphs::{self, setting};
use super::sources::Source;
use crate::embedded;
use crate::error::{Context, Result, bail};
use crate::inputs::wiring::Wiring;
use crate::packets;
use crate::run::{self, Pace, Plan};
use crate::session::Session;

/// Without ground truth, one of this many ticks is evaluated.
const CORRELATED_EVERY: u32 = 3;

/// Name of the shared source in the graph that is run, and in `--set`.
pub const SOURCE: &str = "scope";

/// Our conventional, ROI and grid pipelines and the two of the thesis: names of their graph files.
const BUILT_IN: [(&str, &str); 5] = [
    ("conventional", "stitch_conventional.toml"),
    ("ROI", "stitch_roi.toml"),
    ("grid", "stitch_grid.toml"),
    ("chapter 2", "thesis_chapter2.toml"),
    ("chapter 4", "thesis_chapter4.toml"),
];

/// A graph and its name in tables.
#[derive(Clone, Debug)]
pub struct Method {
    /// Name in tables and plots.
    pub name: String,
    /// The checked graph.
    pub wiring: Wiring,
}

/// Loads shipped graphs, in this order.
pub fn built_in(names: &[&str]) -> Result<Vec<Method>> {
    let find = |name: &&str| BUILT_IN.iter().find(|(known, _)| known == name);
    let known = names.iter().filter_map(find);
    let wiring = |file: &str| Wiring::of(&embedded::graph(file).context(file)?, &Catalog::default());
    known.map(|(name, file)| Ok(Method { name: (*name).to_owned(), wiring: wiring(file)? })).collect()
}

/// Applies `--set` to every graph that has the node.
///
/// # Errors
/// No graph has the node, or the text is not a setting.
pub fn set_all(methods: &mut [Method], settings: &[String]) -> Result<()> {
    for text in settings {
        let (node, ..) = setting(text).with_context(|| format!("`{text}` is not NODE.PARAM=VALUE"))?;
        let mut known = node == SOURCE;
        for method in methods.iter_mut() {
            known |= method.wiring.apply(text);
        }
        if !known {
            bail!("`{text}`: none of the graphs has a node `{node}`");
        }
    }
    Ok(())
}

/// Parameters of the shared source among the settings.
pub fn source_params(settings: &[String]) -> impl Iterator<Item = (&str, Value)> {
    settings
        .iter()
        .filter_map(|text| setting(text))
        .filter(|(node, ..)| *node == SOURCE)
        .map(|(_, param, value)| (param, value))
}

/// The reference with the names of the joined graph.
fn renamed(reference: &str, source: &str, index: usize) -> String {
    match reference.split_once('.') {
        Some((node, port)) if node == source => format!("{SOURCE}.{port}"),
        _ => format!("m{index}_{reference}"),
    }
}

fn rename(value: &mut Value, source: &str, index: usize) {
    match value {
        Value::String(text) => *text = renamed(text, source, index),
        Value::Array(list) => list.iter_mut().for_each(|item| rename(item, source, index)),
        Value::Table(table) => {
            if let Some(from) = table.get_mut("from") {
                rename(from, source, index);
            }
        }
        _ => {}
    }
}

/// One source, the registration of each graph, and an evaluating node after each.
fn joined(methods: &[Method], source: &Source) -> Result<String> {
    let mut nodes = Table::new();
    nodes.insert(SOURCE.to_owned(), source.node.clone().into());
    for (index, method) in methods.iter().enumerate() {
        let wiring = &method.wiring;
        for (id, mut node) in wiring.registration() {
            for input in node.get_mut("inputs").and_then(Value::as_table_mut).into_iter().flat_map(|t| t.iter_mut()) {
                rename(input.1, &wiring.source(), index);
            }
            nodes.insert(format!("m{index}_{id}"), node.into());
        }
        let composite = &wiring.composites[0];
        let own = |reference: &str| renamed(reference, &wiring.source(), index);
        let homography = own(&composite.homographies[0]);
        let (left, right) = (own(&composite.views[0]), own(&composite.views[1]));
        let mut judge: Table = format!(
            "type = \"evaluate_stitch\"\nbudget_ms = 60000\n[inputs]\nleft = {left:?}\nright = {right:?}\nhomography = {homography:?}\n"
        )
        .parse()?;
        let truth = if source.has_truth {
            format!(
                "[inputs]\ndisparity = \"{SOURCE}.disparity\"\nvisible = \"{SOURCE}.visible\"\ntruth = \"{SOURCE}.homography\"\n"
            )
        } else {
            // Finding correspondences by correlation takes seconds.
            format!("[params]\ncorrelate = true\nevery = {CORRELATED_EVERY}\n")
        };
        for (key, value) in truth.parse::<Table>()? {
            match (judge.get_mut(&key).and_then(Value::as_table_mut), value) {
                (Some(table), Value::Table(more)) => table.extend(more),
                (_, value) => _ = judge.insert(key, value),
            }
        }
        nodes.insert(format!("judge_{index}"), judge.into());
    }
    let mut graph: Table = "mode = \"batch\"\nplugins = [\"stereo\", \"stitch\", \"flow\"]".parse()?;
    if let Some(list) = graph.get_mut("plugins").and_then(Value::as_array_mut) {
        list.push(source.plugin.into());
    }
    graph.insert("nodes".to_owned(), nodes.into());
    Ok(graph.to_string())
}

/// Runs all registrations on the same frames; returns the table of each evaluating node.
pub fn judged(session: &dyn Session, methods: &[Method], source: &Source, frames: u64) -> Result<Vec<packets::Table>> {
    let text = joined(methods, source)?;
    let names: Vec<String> = (0..methods.len()).map(|index| format!("judge_{index}")).collect();
    let ports: Vec<(&str, &str)> = names.iter().map(|name| (name.as_str(), "table")).collect();
    let path = Path::new("eval.toml");
    let plan = Plan { text: &text, path, frames: Some(frames), ports: &ports, ..Plan::default() };
    let seen = run::run(session, &plan)?;
    seen.packets.iter().map(|packet| packets::Table::of_judge(packet.as_ref())).collect()
}

/// Median times of one graph on a source, one frame at a time, ms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Times {
    /// All nodes that find the homography, ms.
    pub registration_ms: f64,
    /// The node that draws the panorama, ms.
    pub composite_ms: f64,
}

impl Times {
    /// Registration and composite, ms.
    pub fn whole_ms(&self) -> f64 {
        self.registration_ms + self.composite_ms
    }
}

/// Times a graph alone on a source.
pub fn timed(session: &dyn Session, method: &Method, source: &Source, frames: u64) -> Result<Times> {
    let ports = ["left", "right", "calibration"];
    let all: &[&str] = if source.has_truth {
        &["left", "right", "calibration", "disparity", "depth", "visible", "wide"]
    } else {
        &ports
    };
    let mut wiring = method.wiring.with_source(source.node.clone(), all, &[], &[source.plugin, "flow"])?;
    let wide = wiring.composites[0].id.clone();
    wiring.add("timed_sink", "drain", &[("image", format!("{wide}.panorama"))], Table::new());
    let text = wiring.text();
    let plan = Plan { text: &text, frames: Some(frames), pace: Pace::Alone, ..Plan::default() };
    let report = run::run(session, &plan)?.report;
    let p50 = |id: &str| report.nodes.get(id).map_or(f64::NAN, |node| node.p50_ms);
    let registration_ms = method.wiring.registration().iter().map(|(id, _)| p50(id)).sum();
    Ok(Times { registration_ms, composite_ms: p50(&wide) })
}

/// The given graph files, or the built-in graphs `names` if there are none, with the settings applied.
///
/// # Errors
/// A graph has mistakes or no composite, or no graph has the node of a setting.
pub fn methods(paths: &[PathBuf], names: &[&str], given: &GraphOptions, settings: &[String]) -> Result<Vec<Method>> {
    let mut all = if paths.is_empty() { built_in(names)? } else { Vec::new() };
    for path in paths {
        let wiring = graphs::wiring(path, given)?;
        all.push(Method { name: wiring.name.clone(), wiring });
    }
    set_all(&mut all, settings)?;
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registrations_are_put_behind_one_source_with_names_of_their_own() {
        let methods = built_in(&["chapter 2", "grid"]).unwrap();
        let text = joined(&methods, &Source::phantom([("seed", Value::from(3))])).unwrap();
        let graph: Table = text.parse().unwrap();
        let nodes = graph["nodes"].as_table().unwrap();
        let mut names: Vec<&str> = nodes.keys().map(String::as_str).collect();
        names.sort_unstable();
        let grid = ["m1_wide/join/register", "m1_wide/match", "m1_wide/rectify"];
        assert_eq!(names, [&["judge_0", "judge_1", "m0_wide/register"], &grid[..], &["scope"]].concat());
        assert_eq!(
            nodes["m0_wide/register"]["params"]["min_inliers"].as_integer(),
            Some(4),
            "the graph's own parameters stay"
        );
        assert_eq!(nodes["m1_wide/rectify"]["inputs"]["left"].as_str(), Some("scope.left"));
        assert_eq!(nodes["m1_wide/match"]["inputs"]["left"].as_str(), Some("m1_wide/rectify.left"));
        let judged = ["judge_0", "judge_1"].map(|judge| nodes[judge]["inputs"]["left"].as_str());
        assert_eq!(judged, [Some("scope.left"), Some("m1_wide/rectify.left")]);
        let roi = &nodes["m1_wide/match"]["inputs"]["roi"];
        assert_eq!(
            (roi["from"].as_str(), roi["delay"].as_integer()),
            (Some("m1_wide/join/register.roi_left"), Some(1))
        );
        assert_eq!(nodes["judge_1"]["inputs"]["homography"].as_str(), Some("m1_wide/join/register.homography"));
        assert_eq!(nodes["judge_1"]["inputs"]["truth"].as_str(), Some("scope.homography"));
        let real = Source { has_truth: false, ..Source::phantom([]) };
        let graph: Table = joined(&methods, &real).unwrap().parse().unwrap();
        let judge = &graph["nodes"]["judge_0"];
        assert_eq!((judge["params"]["correlate"].as_bool(), judge["inputs"].get("truth")), (Some(true), None));
    }

    #[test]
    fn settings_reach_the_source_and_each_graph_that_has_the_node() {
        let mut methods = built_in(&["ROI", "grid"]).unwrap();
        let settings = ["wide.match_scale=4", "scope.smoke=0.5", "wide.anchor_fit = 0.25"].map(str::to_owned);
        set_all(&mut methods, &settings).unwrap();
        let texts: Vec<String> = methods.iter().map(|m| m.wiring.text()).collect();
        assert!(texts[1].contains("scale = 4") && !texts[0].contains("scale = 4"));
        assert!(texts.iter().all(|text| text.contains("anchor_fit = 0.25")));
        assert_eq!(source_params(&settings).collect::<Vec<_>>(), [("smoke", Value::from(0.5))]);
        for (text, words) in [("nobody.x=1", "no"), ("wide.nothing=1", "none"), ("plain", "NODE.PARAM=VALUE")] {
            let error = set_all(&mut methods, &[text.to_owned()]).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
