//! A graph of the user's, run on the pictures of a case instead of its own.

use std::cell::Cell;
use std::path::PathBuf;

use panoscope_graph::{Catalog, GraphOptions, NodeType};
use panoscope_host::loader::graph_file;
use panoscope_imaging::stereo::length::Noise;
use toml::{Table, Value};

use super::data::Picture;
use super::picture;
use crate::error::{Context, EvalError, FileAction, OnFile, Result, bail, ensure};
use crate::inputs::references::{for_evaluation, node_of, references, upstream};
use crate::inputs::{Folder, level};
use crate::packets::floats;
use crate::run;
use crate::session::Session;

/// The graph, and where its disparity comes from.
#[derive(Clone, Debug)]
pub struct GraphRequest {
    /// Graph file.
    pub path: PathBuf,
    /// Overlays, arguments and settings.
    pub given: GraphOptions,
    /// `node.port` of the disparity that is judged; may be empty where the graph has only one at the end of its nodes.
    pub disparity: String,
}

/// What a case gives in place of the graph's own source.
const PORTS: [&str; 3] = ["left", "right", "calibration"];

/// A graph made ready to run on pairs.
pub struct OwnGraph {
    path: PathBuf,
    graph: Table,
    /// Node that is replaced.
    source: String,
    disparity: (String, String),
    /// Port of the same node that gives its confidence.
    confidence: Option<String>,
    /// Of its first node `measure`; the usual one without.
    pub disparity_noise_px: f64,
    work: Folder,
    pairs: Cell<usize>,
}

impl OwnGraph {
    /// Reads and checks the graph.
    ///
    /// # Errors
    /// The graph has mistakes, has no or several disparities to judge, or reads of its source what a pair does not have.
    pub fn open(request: &GraphRequest) -> Result<Self> {
        let refuse = |reason: String| EvalError::Options { reason: format!("{}: {reason}", request.path.display()) };
        let ready =
            graph_file::open(&request.path, &request.given).map_err(|diagnostics| EvalError::Check { diagnostics })?;
        let mut graph: Table = ready.text.settled(&ready.catalog).context("the settings")?.parse()?;
        let Some(nodes) = for_evaluation(&mut graph) else {
            return Err(refuse("it has no nodes".to_owned()));
        };
        let disparity = match &request.disparity[..] {
            "" => only_disparity(nodes, &ready.catalog, refuse)?,
            named => ready.text.resolve_output(named),
        };
        let Some((node, port)) = disparity.split_once('.').filter(|(node, _)| nodes.contains_key(*node)) else {
            return Err(refuse(format!("there is no output {disparity}")));
        };
        let (node, port) = (node.to_owned(), port.to_owned());
        let made_by = nodes.get(&node).and_then(|node| type_of(node, &ready.catalog));
        let confidence =
            made_by.and_then(|made_by| made_by.outputs.iter().find(|port| port.packet.name == "confidence"));
        let confidence = confidence.map(|port| port.name.clone());
        let disparity_noise_px = nodes.values().find_map(noise_of).unwrap_or(Noise::USUAL.disparity_px);
        let needed = upstream(nodes, &[&disparity], None);
        nodes.retain(|id, _| needed.contains(id));
        let sources: Vec<String> =
            nodes.iter().filter(|(_, node)| references(node).is_empty()).map(|(id, _)| id.clone()).collect();
        let [source] = &sources[..] else {
            return Err(refuse(format!("{disparity} comes from {} sources: a pair replaces one", sources.len())));
        };
        for (name, node) in nodes.iter() {
            let read = references(node);
            let other = read
                .iter()
                .filter(|r| node_of(r) == source)
                .find(|r| r.split_once('.').is_some_and(|(_, port)| !PORTS.contains(&port)));
            if let Some(other) = other {
                return Err(refuse(format!("`{name}` reads `{other}`, which a pair of pictures does not have")));
            }
        }
        let source = source.clone();
        // Its file names no longer hold.
        let plugins = graph.entry("plugins").or_insert_with(|| Value::Array(Vec::new()));
        if let Some(list) = plugins.as_array_mut()
            && !list.iter().any(|name| name.as_str() == Some("capture"))
        {
            list.push("capture".into());
        }
        let work = Folder::new("panoscope-eval-disparity")?;
        let path = std::path::absolute(&request.path).unwrap_or_else(|_| request.path.clone());
        let disparity = (node, port);
        Ok(Self { path, graph, source, disparity, confidence, disparity_noise_px, work, pairs: Cell::new(0) })
    }

    /// The graph's disparity of a rectified pair, in px of the left view, and its confidence where the same node gives one.
    ///
    /// # Errors
    /// The run fails, or gives no disparity of the pair's size.
    pub fn disparity(
        &self,
        session: &dyn Session,
        left: &Picture,
        right: &Picture,
    ) -> Result<(Vec<f32>, Option<Vec<f32>>)> {
        // Each pair has files of its own: nothing of an earlier one is read.
        let folder = self.work.path().join(self.pairs.replace(self.pairs.get() + 1).to_string());
        std::fs::create_dir_all(&folder).on_file(FileAction::Create, &folder)?;
        let file = |name: &str| folder.join(name);
        for (name, view) in [("left.png", left), ("right.png", right)] {
            picture::view(&file(name), (view.width, view.height), view.bgr.clone())?;
        }
        let size = (left.width as u32, left.height as u32);
        panoscope_data::calibration::write(&file("scope.yml"), &level::calibration(size))?;
        let text = |name: &str| Value::from(file(name).to_string_lossy().into_owned());
        let params = [("left", "left.png"), ("right", "right.png"), ("calibration", "scope.yml")];
        let params: Table = params.into_iter().map(|(param, name)| (param.to_owned(), text(name))).collect();
        let node: Table = [("type", Value::from("capture")), ("params", params.into())]
            .into_iter()
            .map(|(key, value)| (key.to_owned(), value))
            .collect();
        let mut graph = self.graph.clone();
        if let Some(nodes) = graph.get_mut("nodes").and_then(Value::as_table_mut) {
            nodes.insert(self.source.clone(), node.into());
        }
        let (node, port) = (&self.disparity.0, &self.disparity.1);
        let mut ports = vec![(&node[..], &port[..])];
        ports.extend(self.confidence.iter().map(|port| (&node[..], &port[..])));
        let text = graph.to_string();
        let plan = run::Plan { text: &text, path: &self.path, frames: Some(1), ports: &ports, ..run::Plan::default() };
        let seen = run::run(session, &plan)?;
        let Some(packet) = &seen.packets[0] else { bail!("{node}.{port} gave nothing") };
        let described = packet.frame();
        let found = (described.width as usize, described.height as usize);
        ensure!(
            found == (left.width, left.height),
            "{node}.{port} is {}x{}, the views are {}x{}",
            found.0,
            found.1,
            left.width,
            left.height
        );
        let disparity = floats(packet).context("the disparity is cut off")?;
        let confidence = seen.packets.get(1).and_then(Option::as_ref).and_then(floats);
        let confidence = confidence.filter(|confidence| confidence.len() == disparity.len());
        Ok((disparity, confidence))
    }
}

/// Standard deviation of a disparity as a node `measure` has it, where it is not the usual one.
fn noise_of(node: &Value) -> Option<f64> {
    let is_measure = node.get("type")?.as_str()? == "measure";
    let noise = node.get("params")?.get("disparity_noise_px").filter(|_| is_measure)?;
    noise.as_float().or_else(|| noise.as_integer().map(|px| px as f64))
}

/// The type of a node of a graph.
fn type_of<'a>(node: &Value, catalog: &'a Catalog) -> Option<&'a NodeType> {
    let name = node.get("type").and_then(Value::as_str)?;
    catalog.find(name).first().map(|index| &catalog.node_types[*index])
}

/// The disparity that no other node makes a disparity of; an error names all where there are several.
fn only_disparity(nodes: &Table, catalog: &Catalog, refuse: impl FnOnce(String) -> EvalError) -> Result<String> {
    let of = |id: &str| {
        let node_type = nodes.get(id).and_then(|node| type_of(node, catalog)).filter(|node_type| !node_type.source)?;
        let port = node_type.outputs.iter().find(|port| port.packet.name == "disparity")?;
        Some(format!("{id}.{}", port.name))
    };
    let made: Vec<String> = nodes.keys().filter_map(|id| of(id)).collect();
    let is_read = |output: &String| {
        let node = node_of(output);
        made.iter().any(|other| {
            let other = node_of(other);
            other != node && nodes.get(other).is_some_and(|n| references(n).iter().any(|r| node_of(r) == node))
        })
    };
    let ends: Vec<&String> = made.iter().filter(|output| !is_read(output)).collect();
    match &ends[..] {
        [one] => Ok((*one).clone()),
        [] => Err(refuse("no node gives a disparity: there is nothing to judge".to_owned())),
        several => {
            let list: Vec<&str> = several.iter().map(|output| output.as_str()).collect();
            Err(refuse(format!("it has several disparities, {}: name one with --disparity", list.join(", "))))
        }
    }
}
