//! A graph made fit for judging: no files written, every frame processed, an `evaluate_stitch` behind each composite.

use std::collections::BTreeSet;

use anyhow::{Result, bail};
use toml::{Table, Value};

/// A composite of the graph and what feeds it.
#[derive(Clone, Debug, PartialEq)]
pub struct Composite {
    /// Its name in the graph.
    pub id: String,
    /// Where its views come from: `node.port`.
    pub left: String,
    /// As `left`.
    pub right: String,
    /// Where its homography comes from.
    pub homography: String,
}

/// A graph file, taken apart.
#[derive(Clone, Debug)]
pub struct Wiring {
    graph: Table,
    /// Its name.
    pub name: String,
    /// All two-view composites.
    pub composites: Vec<Composite>,
}

fn from(value: &Value) -> Option<&str> {
    match value {
        Value::String(text) => Some(text),
        Value::Table(table) => table.get("from")?.as_str(),
        _ => None,
    }
}

fn node_of(reference: &str) -> &str {
    reference.split_once('.').map_or(reference, |(node, _)| node)
}

fn is_type(node: &Value, wanted: &str) -> bool {
    let name = node.get("type").and_then(Value::as_str).unwrap_or_default();
    name.rsplit('/').next() == Some(wanted)
}

impl Wiring {
    /// Takes a graph apart.
    ///
    /// # Errors
    /// When the text is no TOML or holds no composite of two views.
    pub fn of(text: &str, stem: &str) -> Result<Self> {
        let mut graph: Table = text.parse()?;
        let name = graph.get("name").and_then(Value::as_str).unwrap_or(stem).to_owned();
        graph.remove("preset");
        graph.remove("editor");
        graph.insert("mode".to_owned(), "batch".into());
        let Some(nodes) = graph.get_mut("nodes").and_then(Value::as_table_mut) else { bail!("the graph has no nodes") };
        let is_sink = |node: &Value| {
            let name = node.get("type").and_then(Value::as_str).unwrap_or_default();
            name.rsplit('/').next().is_some_and(|name| name.starts_with("write_") || name == "preview")
        };
        nodes.retain(|_, node| !is_sink(node));
        let mut composites = Vec::new();
        for (id, node) in nodes.iter() {
            if !is_type(node, "composite") && !is_type(node, "composite_opencv") {
                continue;
            }
            let input = |name: &str| node.get("inputs")?.get(name).and_then(from).map(str::to_owned);
            if let (Some(left), Some(right), Some(homography)) = (input("left"), input("right"), input("homography")) {
                composites.push(Composite { id: id.clone(), left, right, homography });
            }
        }
        if composites.is_empty() {
            bail!("the graph has no composite with `left`, `right` and `homography`: there is nothing to judge");
        }
        Ok(Self { graph, name, composites })
    }

    fn nodes(&mut self) -> Option<&mut Table> {
        self.graph.get_mut("nodes")?.as_table_mut()
    }

    /// Name of the phantom that the first composite's left view comes from, if it does.
    pub fn phantom(&self) -> Option<String> {
        let id = node_of(&self.composites.first()?.left);
        is_type(self.graph.get("nodes")?.get(id)?, "phantom").then(|| id.to_owned())
    }

    /// Sets a parameter.
    pub fn set(&mut self, node: &str, param: &str, value: impl Into<Value>) {
        let Some(node) = self.nodes().and_then(|nodes| nodes.get_mut(node)?.as_table_mut()) else { return };
        let params = node.entry("params").or_insert_with(|| Value::Table(Table::new()));
        if let Some(params) = params.as_table_mut() {
            params.insert(param.to_owned(), value.into());
        }
    }

    /// Loads this plugin too.
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

    /// The same source with OpenCV's registration and composite in place of all that stitches.
    pub fn peer(&self, seam_megapixels: f64, threads: i64) -> Self {
        let mut out = self.clone();
        let (left, right) = (self.composites[0].left.clone(), self.composites[0].right.clone());
        let mut keep = BTreeSet::new();
        let mut next = vec![node_of(&left).to_owned(), node_of(&right).to_owned()];
        while let Some(id) = next.pop() {
            let inputs = self.graph.get("nodes").and_then(|n| n.get(&id)?.get("inputs")?.as_table());
            next.extend(
                inputs
                    .into_iter()
                    .flat_map(Table::values)
                    .filter_map(from)
                    .map(|r| node_of(r).to_owned())
                    .filter(|n| !keep.contains(n)),
            );
            keep.insert(id);
        }
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
        let inputs = [views[0].clone(), views[1].clone(), ("homography", "peer_register.homography".to_owned())];
        out.add("peer_wide", "composite_opencv", &inputs, with(&[("seam_megapixels", seam_megapixels.into())]));
        out.composites = vec![Composite {
            id: "peer_wide".to_owned(),
            left,
            right,
            homography: "peer_register.homography".to_owned(),
        }];
        out
    }

    /// Puts an `evaluate_stitch` named `judge_ID` behind each composite, wired to what truth the source has.
    pub fn judged(&self) -> Self {
        let mut out = self.clone();
        out.plugin("stitch");
        for composite in &self.composites {
            let source = node_of(&composite.left);
            let mut inputs = vec![
                ("left", composite.left.clone()),
                ("right", composite.right.clone()),
                ("homography", composite.homography.clone()),
            ];
            for port in ["panorama", "canvas", "shown"] {
                inputs.push((port, format!("{}.{port}", composite.id)));
            }
            let node = self.graph.get("nodes").and_then(|nodes| nodes.get(source));
            if node.is_some_and(|node| is_type(node, "phantom")) {
                for (port, output) in
                    [("disparity", "disparity"), ("visible", "visible"), ("truth", "homography"), ("wide", "wide")]
                {
                    inputs.push((port, format!("{source}.{output}")));
                }
            }
            out.add(&format!("judge_{}", composite.id), "evaluate_stitch", &inputs, Table::new());
        }
        out
    }

    /// As graph text.
    pub fn text(&self) -> String {
        self.graph.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::Wiring;

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
        let mut wiring = Wiring::of(GRAPH, "x").unwrap();
        assert_eq!((wiring.name.as_str(), wiring.phantom()), ("x", Some("scope".to_owned())));
        wiring.set("scope", "noise", 0.5);
        let text = wiring.judged().text();
        assert!(
            !text.contains("write_video") && text.contains("mode = \"batch\"") && text.contains("noise = 0.5"),
            "{text}"
        );
        let table: toml::Table = text.parse().unwrap();
        let judge = &table["nodes"]["judge_wide"]["inputs"];
        assert_eq!(judge["right"].as_str(), Some("scope.right"));
        assert_eq!(judge["truth"].as_str(), Some("scope.homography"));
    }

    #[test]
    fn the_peer_keeps_the_source_only() {
        let text = Wiring::of(GRAPH, "x").unwrap().peer(0.1, 2).text();
        assert!(text.contains("register_opencv") && !text.contains("register_surf"), "{text}");
        assert!(Wiring::of("[nodes.a]\ntype = \"phantom\"\n", "x").is_err());
    }
}
