//! A graph prepared for evaluation: it writes no files, processes every frame, and has an `evaluate_stitch` after each
//! composite.

use std::collections::BTreeSet;

use crate::error::{Result, bail};
use crate::inputs::references::{for_evaluation, from, kind_of, node_of, references, remove_sinks, upstream};
use panoscope_graph::{Catalog, GraphText};
use toml::{Table, Value};

/// A composite of the graph and its inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Composite {
    /// Name in the graph.
    pub id: String,
    /// Outputs `node.port` of its views; the first is the reference, in whose plane the panorama lies.
    pub views: Vec<String>,
    /// Outputs of the homographies of the further views.
    pub homographies: Vec<String>,
}

impl Composite {
    /// Number of further views; each has its own evaluating node.
    pub fn pairs(&self) -> usize {
        self.homographies.len()
    }

    /// Name in tables and figures: its name in the graph file, or that of the part it belongs to.
    pub fn name(&self) -> &str {
        self.id.split('/').next().unwrap_or(&self.id)
    }

    /// Name of the evaluating node of further view `pair`, from 0.
    pub fn judge(&self, pair: usize) -> String {
        let id = self.id.replace('/', "_");
        if self.pairs() == 1 { format!("judge_{id}") } else { format!("judge_{id}_{}", pair + 1) }
    }
}

/// Inputs of the evaluating nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JudgeInputs {
    /// All available inputs.
    Pictures,
    /// Only those for registration, because comparing images takes longer than stitching.
    Registration,
    /// Those for registration, and the area that the panorama covers.
    Area,
}

/// A parsed graph with the nodes of its parts.
#[derive(Clone, Debug)]
pub struct Wiring {
    /// The text as read; it maps parameters of parts to those of their nodes.
    source: GraphText,
    graph: Table,
    /// Name of the graph.
    pub name: String,
    /// All composites.
    pub composites: Vec<Composite>,
}

/// Node type that maps a view by a mesh.
const MESH: &str = "composite_mesh";
/// Node types whose panoramas are evaluated.
const COMPOSITES: [&str; 3] = ["composite", MESH, "composite_opencv"];

/// Splits `NODE.PARAM=VALUE`; a value that is not TOML is taken as text.
pub fn setting(text: &str) -> Option<(&str, &str, Value)> {
    let (target, value) = text.split_once('=')?;
    let (node, param) = target.split_once('.')?;
    let parsed = format!("v = {value}").parse::<Table>().ok().and_then(|mut t| t.remove("v"));
    Some((node.trim(), param.trim(), parsed.unwrap_or_else(|| value.trim().into())))
}

/// Number of the phantom's camera that an output shows, 1 to 3; `None` for other outputs.
fn camera_of(reference: &str) -> Option<u8> {
    match reference.split_once('.')?.1 {
        "right" | "view1" => Some(1),
        "view2" => Some(2),
        "view3" => Some(3),
        _ => None,
    }
}

impl Wiring {
    /// Parses a graph with its settings applied. The catalog tells which values are paths.
    ///
    /// # Errors
    /// The text is not TOML or has no composite of two views.
    pub fn of(source: &GraphText, catalog: &Catalog) -> Result<Self> {
        let mut graph: Table = source.flattened(catalog).parse()?;
        let name = source.name().to_owned();
        let Some(nodes) = for_evaluation(&mut graph) else { bail!("the graph has no nodes") };
        remove_sinks(nodes);
        let mut composites = Vec::new();
        for (id, node) in nodes.iter() {
            if !COMPOSITES.iter().any(|kind| kind_of(node) == *kind) {
                continue;
            }
            let input = |name: &str| node.get("inputs")?.get(name);
            let one = |name: &str| input(name).and_then(from).map(str::to_owned);
            let list = |name: &str| -> Option<Vec<String>> {
                input(name)?.as_array()?.iter().map(|value| from(value).map(str::to_owned)).collect()
            };
            let (views, homographies) = match (one("left"), one("right"), one("homography")) {
                (Some(left), Some(right), Some(homography)) => (vec![left, right], vec![homography]),
                _ => match (list("views"), list("homographies")) {
                    (Some(views), Some(maps)) if views.len() == maps.len() + 1 && !maps.is_empty() => (views, maps),
                    _ => continue,
                },
            };
            composites.push(Composite { id: id.clone(), views, homographies });
        }
        if composites.is_empty() {
            bail!(
                "the graph has no composite with `left`, `right` and `homography`, or `views` and `homographies`: there is nothing to evaluate"
            );
        }
        let mut wiring = Self { source: source.clone(), graph, name, composites };
        for (node, param, value) in source.settings().iter().filter_map(|text| setting(text)) {
            wiring.set(node, param, value);
        }
        Ok(wiring)
    }

    /// Applies `NODE.PARAM=VALUE`, where the node may be a part. Returns whether the graph has such a node.
    pub fn apply(&mut self, text: &str) -> bool {
        let mut source = self.source.clone();
        let known = source.settings().len();
        source.set(text);
        let settings = source.settings();
        let mut applied = false;
        for (node, param, value) in settings[known..].iter().filter_map(|text| setting(text)) {
            applied |= self.has(node);
            self.set(node, param, value);
        }
        applied
    }

    fn nodes(&mut self) -> Option<&mut Table> {
        self.graph.get_mut("nodes")?.as_table_mut()
    }

    fn node(&self, id: &str) -> Option<&Value> {
        self.graph.get("nodes")?.get(id)
    }

    /// Output that a view comes from; for a rectified view that of the unrectified one.
    fn origin(&self, view: &str) -> String {
        let mut at = view.to_owned();
        // A graph may be wired in a circle.
        for _ in 0..self.graph.get("nodes").and_then(Value::as_table).map_or(0, Table::len) {
            let before = at.split_once('.').and_then(|(node, port)| {
                let node = self.node(node).filter(|node| kind_of(node) == "rectify")?;
                from(node.get("inputs")?.get(port)?).map(str::to_owned)
            });
            let Some(before) = before else { break };
            at = before;
        }
        at
    }

    /// Name of the phantom that the first composite's first view comes from; `None` for other sources.
    pub fn phantom(&self) -> Option<String> {
        let origin = self.origin(self.composites.first()?.views.first()?);
        let id = node_of(&origin);
        (kind_of(self.node(id)?) == "phantom").then(|| id.to_owned())
    }

    /// The same graph with other views: `source`, whose type has the outputs `ports`, replaces the source of the first
    /// composite's views; the nodes `more` feed it.
    ///
    /// # Errors
    /// The graph reads an output of its source that the new one does not have.
    pub fn with_source(&self, source: Table, ports: &[&str], more: &[(&str, Table)], plugins: &[&str]) -> Result<Self> {
        let mut out = self.clone();
        let id = self.source();
        let Some(nodes) = out.nodes() else { bail!("the graph has no nodes") };
        for (name, node) in nodes.iter().filter(|(name, _)| **name != id) {
            for (node_id, port) in references(node).iter().filter_map(|r| r.split_once('.')) {
                if node_id == id && !ports.contains(&port) {
                    bail!("`{name}` reads `{id}.{port}`, which this source does not have");
                }
            }
        }
        nodes.insert(id, source.into());
        for (name, node) in more {
            nodes.insert((*name).to_owned(), node.clone().into());
        }
        plugins.iter().for_each(|name| out.plugin(name));
        Ok(out)
    }

    /// Sets a parameter.
    pub fn set(&mut self, node: &str, param: &str, value: impl Into<Value>) {
        let Some(node) = self.nodes().and_then(|nodes| nodes.get_mut(node)?.as_table_mut()) else { return };
        let params = node.entry("params").or_insert_with(|| Value::Table(Table::new()));
        if let Some(params) = params.as_table_mut() {
            params.insert(param.to_owned(), value.into());
        }
    }

    /// Adds a plugin to the list of plugins.
    pub fn plugin(&mut self, name: &str) {
        let list = self.graph.entry("plugins").or_insert_with(|| Value::Array(Vec::new()));
        if let Some(list) = list.as_array_mut()
            && !list.iter().any(|p| p.as_str() == Some(name))
        {
            list.push(name.into());
        }
    }

    /// Adds a node.
    pub fn add(&mut self, id: &str, kind: &str, inputs: &[(&str, String)], params: Table) {
        let inputs: Table = inputs.iter().map(|(port, from)| ((*port).to_owned(), from.clone().into())).collect();
        let mut node = Table::new();
        node.insert("type".to_owned(), kind.into());
        node.insert("inputs".to_owned(), inputs.into());
        node.insert("params".to_owned(), params.into());
        // Comparing pictures and OpenCV's cuts may take seconds; that is no hang.
        node.insert("budget_ms".to_owned(), 60_000.into());
        if let Some(nodes) = self.nodes() {
            nodes.insert(id.to_owned(), node.into());
        }
    }

    fn upstream(&self, outputs: &[&str], stop: Option<&str>) -> BTreeSet<String> {
        self.graph
            .get("nodes")
            .and_then(Value::as_table)
            .map_or_else(BTreeSet::new, |nodes| upstream(nodes, outputs, stop))
    }

    /// Name of the node that the first composite's first view comes from.
    pub fn source(&self) -> String {
        node_of(&self.origin(&self.composites[0].views[0])).to_owned()
    }

    /// The nodes between the source and the first composite's first homography, by name.
    pub fn registration(&self) -> Vec<(String, Table)> {
        let ids = self.upstream(&[&self.composites[0].homographies[0]], Some(&self.source()));
        ids.into_iter().filter_map(|id| Some((id.clone(), self.node(&id)?.as_table()?.clone()))).collect()
    }

    /// Whether the graph has a node of this name.
    pub fn has(&self, node: &str) -> bool {
        self.node(node).is_some()
    }

    /// The same source with OpenCV's registration and composite instead of the graph's; without a composite for
    /// [`JudgeInputs::Registration`]. `None` for more than two views, which OpenCV's node does not support.
    pub fn peer(&self, judged: JudgeInputs, seam_megapixels: f64, threads: i64) -> Option<Self> {
        let mut out = self.clone();
        let [left, right] = &self.composites[0].views[..] else { return None };
        let keep = self.upstream(&[left, right], None);
        if let Some(nodes) = out.nodes() {
            nodes.retain(|id, _| keep.contains(id));
        }
        out.plugin("opencv");
        let with = |more: &[(&str, Value)]| {
            let mut params: Table = more.iter().map(|(k, v)| ((*k).to_owned(), v.clone())).collect();
            params.insert("threads".to_owned(), threads.into());
            params
        };
        let views = [("left", left.clone()), ("right", right.clone())];
        out.add("peer_register", "register_opencv", &views, with(&[]));
        let homography = "peer_register.homography".to_owned();
        if judged != JudgeInputs::Registration {
            let inputs = [views[0].clone(), views[1].clone(), ("homography", homography.clone())];
            out.add("peer_wide", "composite_opencv", &inputs, with(&[("seam_megapixels", seam_megapixels.into())]));
        }
        out.composites = vec![Composite {
            id: "peer_wide".to_owned(),
            views: self.composites[0].views.clone(),
            homographies: vec![homography],
        }];
        Some(out)
    }

    /// Inputs and parameters of the evaluating node of a pair of views: the composite's outputs, and the ground truth
    /// of the source.
    fn judge_inputs(
        &self,
        composite: &Composite,
        pair: usize,
        judged: JudgeInputs,
    ) -> (Vec<(&'static str, String)>, Table) {
        let origin = self.origin(&composite.views[0]);
        let source = node_of(&origin);
        let is = |kind: &str| self.node(source).is_some_and(|node| kind_of(node) == kind);
        let mut inputs = vec![
            ("left", composite.views[0].clone()),
            ("right", composite.views[pair + 1].clone()),
            ("homography", composite.homographies[pair].clone()),
        ];
        let mut params = Table::new();
        params.insert("view".to_owned(), (pair as i64 + 2).into());
        let mut wire = |names: &[(&'static str, &str)], node: &str| {
            inputs.extend(names.iter().map(|(port, output)| (*port, format!("{node}.{output}"))));
        };
        // A mesh is part of the registration.
        if self.node(&composite.id).is_some_and(|node| kind_of(node) == MESH) {
            wire(&[("mesh", "mesh")], &composite.id);
        }
        if judged != JudgeInputs::Registration {
            wire(&[("panorama", "panorama"), ("canvas", "canvas"), ("shown", "shown")], &composite.id);
        }
        // The phantom's disparity is that of its first two cameras; the others stand as many baselines away from the first.
        let camera = camera_of(&self.origin(&composite.views[pair + 1]));
        match () {
            () if is("phantom") && camera == Some(1) => {
                wire(&[("disparity", "disparity"), ("visible", "visible"), ("truth", "homography")], source);
            }
            () if is("phantom") && camera.is_some() => {
                wire(&[("disparity", "disparity")], source);
                let camera = camera.unwrap_or_default();
                params.insert("along_x".to_owned(), f64::from(camera % 2).into());
                params.insert("along_y".to_owned(), f64::from(camera / 2).into());
            }
            () if is("cut_views") => wire(&[("truth", "homography"), ("left_in_wide", "left_in_image")], source),
            () => _ = params.insert("correlate".to_owned(), true.into()),
        }
        match judged {
            JudgeInputs::Pictures if is("phantom") => wire(&[("wide", "wide")], source),
            JudgeInputs::Area if is("phantom") => wire(&[("footprint", "footprint")], source),
            _ => {}
        }
        if judged == JudgeInputs::Pictures && is("cut_views") {
            let whole = self.node(source).map(references).unwrap_or_default();
            inputs.extend(whole.into_iter().map(|from| ("wide", from)));
        }
        (inputs, params)
    }

    /// Puts an `evaluate_stitch` for each pair of views of each composite, connected to the ground truth of the source.
    pub fn judged(&self, judged: JudgeInputs) -> Self {
        let mut out = self.clone();
        out.plugin("stitch");
        for composite in &self.composites {
            for pair in 0..composite.pairs() {
                let (inputs, params) = self.judge_inputs(composite, pair, judged);
                out.add(&composite.judge(pair), "evaluate_stitch", &inputs, params);
            }
        }
        out
    }

    /// The graph without stitching, and the outputs of the views and ground truth of the first composite's first pair:
    /// inputs of an evaluating node and `node.port`. `None` for more than two views.
    pub fn pictures(&self) -> Option<(Self, Vec<(&'static str, String)>)> {
        let composite = self.composites.first().filter(|composite| composite.pairs() == 1)?;
        let (mut inputs, _) = self.judge_inputs(composite, 0, JudgeInputs::Pictures);
        let keep = self.upstream(&composite.views.iter().map(String::as_str).collect::<Vec<_>>(), None);
        inputs.retain(|(_, from)| keep.contains(node_of(from)));
        let mut out = self.clone();
        if let Some(nodes) = out.nodes() {
            nodes.retain(|id, _| keep.contains(id));
        }
        Some((out, inputs))
    }

    /// The graph as text.
    pub fn text(&self) -> String {
        self.graph.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::{JudgeInputs, Table, Wiring};
    use panoscope_graph::{Catalog, GraphText};

    fn wiring(text: &str) -> crate::error::Result<Wiring> {
        Wiring::of(&GraphText::parse("x.toml".as_ref(), text), &Catalog::default())
    }

    const GRAPH: &str = r#"
plugins = ["phantom", "stitch", "sinks"]
[nodes.scope]
type = "phantom"
[nodes.register]
type = "register_surf"
inputs = { left = "scope.left", right = { from = "scope.right" } }
[nodes.wide]
type = "composite"
inputs = { left = "scope.left", right = { from = "scope.right" }, homography = "register.homography" }
[nodes.video]
type = "write_video"
inputs = { image = "wide.panorama" }
"#;

    #[test]
    fn sinks_go_and_a_judge_comes() {
        let mut wiring = wiring(GRAPH).unwrap();
        assert_eq!((wiring.name.as_str(), wiring.phantom()), ("x", Some("scope".to_owned())));
        wiring.set("scope", "noise", 0.5);
        let text = wiring.judged(JudgeInputs::Pictures).text();
        assert!(
            !text.contains("write_video") && text.contains("mode = \"batch\"") && text.contains("noise = 0.5"),
            "{text}"
        );
        let table: toml::Table = text.parse().unwrap();
        let judge = &table["nodes"]["judge_wide"]["inputs"];
        assert_eq!(judge["right"].as_str(), Some("scope.right"));
        assert_eq!(judge["truth"].as_str(), Some("scope.homography"));
        let text = wiring.judged(JudgeInputs::Registration).text();
        assert!(!text.contains("panorama =") && !text.contains("scope.wide"), "{text}");
    }

    #[test]
    fn rectified_views_are_judged_by_the_truth_of_their_source() {
        let rectify = "[nodes.level]\ntype = \"rectify\"\ninputs = { left = \"scope.left\", right = { from = \"scope.right\" } }\n";
        let level = |text: &str| {
            text.replace("left = \"scope.left\"", "left = \"level.left\"")
                .replace("from = \"scope.right\"", "from = \"level.right\"")
        };
        let wiring = wiring(&format!("{}{rectify}", level(GRAPH))).unwrap();
        assert_eq!((wiring.source(), wiring.phantom()), ("scope".to_owned(), Some("scope".to_owned())));
        let table: toml::Table = wiring.judged(JudgeInputs::Pictures).text().parse().unwrap();
        let judge = &table["nodes"]["judge_wide"]["inputs"];
        assert_eq!((judge["left"].as_str(), judge["truth"].as_str()), (Some("level.left"), Some("scope.homography")));
        let source: Table = "type = \"capture\"".parse().unwrap();
        let made = wiring.with_source(source, &["left", "right"], &[], &["capture"]).unwrap().text();
        assert!(made.contains("[nodes.level]") && !made.contains("\"phantom\"\n"), "{made}");
        let circle = "[nodes.level]\ntype = \"rectify\"\ninputs = { left = \"level.left\", right = \"level.right\" }\n";
        assert_eq!(
            super::Wiring::of(
                &GraphText::parse("x.toml".as_ref(), &format!("{}{circle}", level(GRAPH))),
                &Catalog::default()
            )
            .unwrap()
            .source(),
            "level"
        );
    }

    #[test]
    fn the_peer_keeps_the_source_only() {
        let text = wiring(GRAPH).unwrap().peer(JudgeInputs::Pictures, 0.1, 2).unwrap().text();
        assert!(text.contains("register_opencv") && !text.contains("register_surf"), "{text}");
        assert!(wiring("[nodes.a]\ntype = \"phantom\"\n").is_err());
    }

    #[test]
    fn a_mesh_is_judged_with_the_registration() {
        let graph = GRAPH.replace("\"composite\"", "\"composite_mesh\"");
        let wiring = wiring(&graph).unwrap();
        for judged in [JudgeInputs::Registration, JudgeInputs::Pictures] {
            let table: Table = wiring.judged(judged).text().parse().unwrap();
            assert_eq!(table["nodes"]["judge_wide"]["inputs"]["mesh"].as_str(), Some("wide.mesh"), "{judged:?}");
        }
    }

    #[test]
    fn four_views_have_three_judges_and_no_peer() {
        let graph = r#"
[nodes.scope]
type = "phantom"
[nodes.wide]
type = "composite"
inputs = { views = ["scope.view0", "scope.view1", "scope.view2", "scope.view3"], homographies = ["a.homography", "b.homography", "c.homography"] }
"#;
        let wiring = wiring(graph).unwrap();
        assert!(wiring.peer(JudgeInputs::Pictures, 0.1, 2).is_none());
        let table: toml::Table = wiring.judged(JudgeInputs::Pictures).text().parse().unwrap();
        assert_eq!(table["nodes"]["judge_wide_1"]["inputs"]["disparity"].as_str(), Some("scope.disparity"));
        let third = &table["nodes"]["judge_wide_3"];
        assert_eq!(third["inputs"]["right"].as_str(), Some("scope.view3"));
        assert_eq!(third["inputs"]["disparity"].as_str(), Some("scope.disparity"));
        assert_eq!(third["params"]["view"].as_integer(), Some(4));
        let along = ["along_x", "along_y"].map(|name| third["params"][name].as_float());
        assert_eq!((along, third["inputs"].get("truth")), ([Some(1.0), Some(1.0)], None));
        let table: toml::Table = wiring.judged(JudgeInputs::Area).text().parse().unwrap();
        let second = &table["nodes"]["judge_wide_2"];
        assert_eq!(second["inputs"]["footprint"].as_str(), Some("scope.footprint"));
        assert_eq!((second["params"]["along_x"].as_float(), second["inputs"].get("wide")), (Some(0.0), None));
    }

    #[test]
    fn another_source_must_have_what_is_read() {
        let wiring = wiring(GRAPH).unwrap();
        let source: Table = "type = \"cut_views\"\ninputs = { image = \"files.left\" }".parse().unwrap();
        let files: Table = "type = \"capture\"".parse().unwrap();
        let made = wiring.with_source(source.clone(), &["left", "right"], &[("files", files)], &["capture"]).unwrap();
        let table: toml::Table = made.judged(JudgeInputs::Pictures).text().parse().unwrap();
        let judge = &table["nodes"]["judge_wide"]["inputs"];
        assert_eq!(judge["wide"].as_str(), Some("files.left"));
        assert_eq!(judge["truth"].as_str(), Some("scope.homography"));
        let error = wiring.with_source(source, &["left"], &[], &[]).unwrap_err();
        assert!(error.to_string().contains("`scope.right`"), "{error}");
    }
}
