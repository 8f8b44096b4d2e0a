//! Edits of graphs with parts: made, dissolved, and wired across their edges.

use crate::common;
use panoscope_graph::edit::{EditError, FileEdits};
use panoscope_graph::{Graph, GraphOptions, GraphText, check};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A graph of files that exist in memory only.
#[derive(Clone, Debug, PartialEq)]
struct Files {
    root: PathBuf,
    texts: BTreeMap<PathBuf, String>,
    with: Vec<PathBuf>,
}

impl Files {
    fn new(files: &[(&str, &str)]) -> Self {
        let texts = files.iter().map(|(name, text)| (Self::path(name), (*text).to_owned())).collect();
        Self { root: Self::path(files[0].0), texts, with: Vec::new() }
    }

    fn path(name: &str) -> PathBuf {
        Path::new("/nowhere/graphs").join(name)
    }

    fn text(&self, name: &str) -> &str {
        &self.texts[&Self::path(name)]
    }

    fn parsed(&self) -> GraphText {
        let options = GraphOptions { texts: self.texts.clone(), with: self.with.clone(), ..GraphOptions::default() };
        GraphText::parse_with(&self.root, &self.texts[&self.root], &options)
    }

    fn graph(&self) -> Graph {
        let checked = check(&self.parsed(), &common::catalog());
        checked.into_result().unwrap_or_else(|d| panic!("{}\n{self:#?}", d.render(false))).0
    }

    fn edit<T>(&mut self, act: impl FnOnce(&mut FileEdits<'_>) -> Result<T, EditError>) -> Result<T, EditError> {
        let parsed = self.parsed();
        let mut edits = FileEdits::new(&parsed);
        let result = act(&mut edits)?;
        for (path, before, text) in edits.into_texts() {
            assert_eq!(before.as_ref(), self.texts.get(&path));
            self.texts.insert(path, text);
        }
        Ok(result)
    }

    fn make(&mut self, nodes: &[&str], name: &str) -> Result<String, EditError> {
        let nodes: Vec<String> = nodes.iter().map(|&n| n.to_owned()).collect();
        let file = Self::path(&format!("parts/{name}.toml"));
        self.edit(|edits| edits.make_part(&common::catalog(), &nodes, name, &file))
    }

    fn dissolve(&mut self, part: &str) -> Result<Vec<(String, String)>, EditError> {
        self.edit(|edits| edits.dissolve(&common::catalog(), part))
    }
}

/// What a graph means, whatever the order of its nodes; `rename` gives nodes other names.
fn meaning(graph: &Graph, rename: &dyn Fn(&str) -> String) -> Vec<String> {
    let id = |n: usize| rename(&graph.nodes[n].id);
    let nodes = graph.nodes.iter().map(|n| {
        let policy = (n.on_fault, n.budget_ms, n.max_rate_hz, n.cpu);
        // The same files, whichever folder a path starts from.
        let params = format!("{:?}", n.params).replace("/parts/../../", "/../");
        format!("{}: {}/{} {params} {policy:?}", rename(&n.id), n.plugin, n.type_name)
    });
    let edges = graph.edges.iter().map(|e| {
        let how = (e.align, e.queue, e.delay, e.trigger, e.convert);
        format!("{}.{} -> {}.{}[{}] {how:?}", id(e.from_node), e.from_port, id(e.to_node), e.to_port, e.list_index)
    });
    let views = graph.preset.views.iter().map(|v| format!("view {}.{} {}", id(v.node), v.port, rename(&v.label)));
    let pins = graph.preset.pinned.iter().map(|p| format!("pin {}.{} {:?}", id(p.node), p.param, p.range));
    let mut all: Vec<String> = nodes.chain(edges).chain(views).chain(pins).collect();
    all.sort();
    all
}

fn same(graph: &Graph) -> Vec<String> {
    meaning(graph, &str::to_owned)
}

const FLAT: &str = r#"# Depth of two views.
name = "depth"
mode = "batch"
plugins = ["phantom", "stereo", "stitch", "sinks"]   # four

[args.seed]
type = "whole"
default = 5

# The source.
[nodes.scope]
type = "phantom"
params = { seed = { arg = "seed" } }

[nodes.rectify]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }

# The match; 64 px suffice.
[nodes.match]
type = "stereo_bm"
inputs = { left = "rectify.left", right = { from = "rectify.right", queue = 2 } }
params = { search_px = 64, block_px = 21 }   # odd
budget_ms = 20

[nodes.show]
type = "preview"
inputs = { packet = { from = "match.disparity", align = "latest", queue = 3 } }

[nodes.film]
type = "write_images"
inputs = { images = ["rectify.left", "scope.wide"] }
params = { path = "../out/film_{seq}.png" }

[preset]
views = [{ from = "match.disparity", label = "Depth" }, "rectify.left"]
pinned = [{ param = "match.search_px", range = [32, 128] }, { param = "scope.seed" }]

[editor]
match = { x = 8, y = 16 }
"#;

#[test]
fn a_part_is_made_of_nodes_and_dissolved_again() {
    let mut files = Files::new(&[("graph.toml", FLAT)]);
    let before = same(&files.graph());
    assert_eq!(files.make(&["match", "rectify"], "depth").expect("made"), "depth");
    assert_eq!(
        files.text("parts/depth.toml"),
        r#"name = "depth"
plugins = ["stereo"]

[part]
inputs = { left = "rectify.left", right = "rectify.right", calibration = "rectify.calibration" }
outputs = { disparity = "match.disparity", left = "rectify.left" }
params = { search_px = "match.search_px" }

[nodes.rectify]
type = "rectify"

# The match; 64 px suffice.
[nodes.match]
type = "stereo_bm"
inputs = { left = "rectify.left", right = { from = "rectify.right", queue = 2 } }
params = { search_px = 64, block_px = 21 }   # odd
budget_ms = 20
"#
    );
    let root = files.text("graph.toml");
    let user = "[nodes.depth]\ngraph = \"parts/depth.toml\"\n\
                inputs = { left = \"scope.left\", right = \"scope.right\", calibration = \"scope.calibration\" }\n\n[nodes.show]";
    assert!(root.contains(user), "{root}");
    assert!(root.contains("views = [{ from = \"depth.disparity\", label = \"Depth\" }, \"depth.left\"]"), "{root}");
    assert!(root.contains("{ param = \"depth.search_px\", range = [32, 128] }"), "{root}");
    let inside = |id: &str| id.strip_prefix("depth/").unwrap_or(id).to_owned();
    assert_eq!(meaning(&files.graph(), &inside), before);

    let part = files.text("parts/depth.toml").to_owned();
    let names = files.dissolve("depth").expect("dissolved");
    assert_eq!(names[0], ("depth/rectify".to_owned(), "rectify".to_owned()));
    assert_eq!(same(&files.graph()), before);
    assert_eq!(files.text("parts/depth.toml"), part, "the file of a dissolved part stays");
    assert!(files.text("graph.toml").contains("# The match; 64 px suffice.\n[nodes.match]"), "{files:#?}");
}

#[test]
fn arguments_go_to_the_part_as_parameters_and_paths_stay_what_they_are() {
    let mut files = Files::new(&[("graph.toml", FLAT)]);
    let before = same(&files.graph());
    files.make(&["scope", "film"], "ends").expect_err("a list of inside and outside");
    let mut files = Files::new(&[(
        "graph.toml",
        &FLAT.replace("\"rectify.left\", \"scope.wide\"", "\"scope.left\", \"scope.wide\""),
    )]);
    let wired = same(&files.graph());
    assert_ne!(before, wired);
    files.make(&["scope", "film"], "ends").expect("made");
    assert!(files.text("graph.toml").contains("params = { seed = { arg = \"seed\" } }"), "{files:#?}");
    assert!(files.text("parts/ends.toml").contains("path = \"../../out/film_{seq}.png\""), "{files:#?}");
    let inside = |id: &str| id.strip_prefix("ends/").unwrap_or(id).to_owned();
    assert_eq!(meaning(&files.graph(), &inside), wired);
    files.dissolve("ends").expect("dissolved");
    assert_eq!(same(&files.graph()), wired);
    assert!(files.text("graph.toml").contains("path = \"../out/film_{seq}.png\""), "{files:#?}");
}

#[test]
fn every_selection_makes_a_part_of_the_same_graph_or_says_why_not() {
    let ids = ["scope", "rectify", "match", "show", "film"];
    let before = same(&Files::new(&[("graph.toml", FLAT)]).graph());
    let (mut made, mut refused) = (0, 0);
    for chosen in 1u32..1 << ids.len() {
        let nodes: Vec<&str> =
            ids.iter().enumerate().filter(|(k, _)| chosen >> k & 1 == 1).map(|(_, id)| *id).collect();
        let mut files = Files::new(&[("graph.toml", FLAT)]);
        let unchanged = files.clone();
        match files.make(&nodes, "whole") {
            Ok(_) => {
                let inside = |id: &str| id.strip_prefix("whole/").unwrap_or(id).to_owned();
                assert_eq!(meaning(&files.graph(), &inside), before, "{nodes:?}");
                // A part of the part.
                if nodes.len() > 1 {
                    let within = format!("whole/{}", nodes[1]);
                    let inner = files.make(&[&within], "inner").unwrap_or_else(|e| panic!("{nodes:?}: {e}"));
                    assert_eq!(inner, "whole/inner");
                    let inside = |id: &str| id.rsplit('/').next().unwrap_or(id).to_owned();
                    assert_eq!(meaning(&files.graph(), &inside), before, "{nodes:?}");
                    files.dissolve("whole/inner").expect("dissolved");
                }
                files.dissolve("whole").expect("dissolved");
                assert_eq!(same(&files.graph()), before, "{nodes:?}");
                made += 1;
            }
            Err(error) => {
                assert!(matches!(error, EditError::MixedInput { .. }), "{nodes:?}: {error}");
                assert_eq!(files, unchanged, "{nodes:?}");
                refused += 1;
            }
        }
    }
    assert_eq!((made, refused), (23, 8), "only a list that reads inside and outside is refused");
}

const TWICE: &str = r#"name = "twice"
mode = "batch"
plugins = ["phantom", "sinks"]

[nodes.scope]
type = "phantom"

[nodes.one]
graph = "pair.toml"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }

[nodes.two]
graph = "pair.toml"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }

[nodes.show]
type = "preview"
inputs = { packet = "one.disparity" }

[nodes.also]
type = "preview"
inputs = { packet = "two.disparity" }

[preset]
views = ["one.disparity", "two.disparity"]
pinned = [{ param = "one.search_px" }]

[editor]
one = { x = 0, y = 0 }
"one/match" = { x = 8, y = 8 }
"#;

const PAIR: &str = r#"# A pair.
plugins = ["stereo"]

[part]
inputs = { left = ["eyes.left"], right = "eyes.right", calibration = "eyes.calibration" }
outputs = { disparity = "match.disparity" }  # one
params = { search_px = "match.search_px" }

[nodes.eyes]
type = "rectify"

[nodes.match]
type = "stereo_bm"
inputs = { left = "eyes.left", right = "eyes.right" }
"#;

fn twice() -> Files {
    Files::new(&[("graph.toml", TWICE), ("pair.toml", PAIR)])
}

#[test]
fn wires_inside_a_part_change_its_file_only() {
    let mut files = twice();
    files.edit(|e| e.connect(("one/eyes", "right"), ("one/match", "left"), false, 0)).expect("wired");
    assert_eq!(files.text("graph.toml"), TWICE);
    assert_eq!(
        files.text("pair.toml"),
        PAIR.replace(
            "{ left = \"eyes.left\", right = \"eyes.right\" }",
            "{ left = \"eyes.right\", right = \"eyes.right\" }"
        )
    );
    files.edit(|e| e.disconnect("two/match", "left", 0)).expect("unwired");
    assert!(files.text("pair.toml").contains("inputs = { right = \"eyes.right\" }"), "{files:#?}");
}

#[test]
fn a_wire_across_the_edge_of_a_part_goes_through_its_names() {
    let mut files = twice();
    // Out of a part: a new output.
    files.edit(|e| e.connect(("one/eyes", "left"), ("show", "packet"), false, 0)).expect("wired");
    assert_eq!(
        files.text("pair.toml"),
        PAIR.replace("\"match.disparity\" }", "\"match.disparity\", left = \"eyes.left\" }")
    );
    assert_eq!(files.text("graph.toml"), TWICE.replace("packet = \"one.disparity\"", "packet = \"one.left\""));
    // Into a part: the name that is there.
    files.edit(|e| e.connect(("scope", "left"), ("one/eyes", "right"), false, 0)).expect("wired");
    let wired = "[nodes.one]\ngraph = \"pair.toml\"\ninputs = { left = \"scope.left\", right = \"scope.left\",";
    assert!(files.text("graph.toml").contains(wired), "{files:#?}");
    // Into an input that was connected inside: a new name, in every part of the file.
    files.edit(|e| e.connect(("scope", "left"), ("one/match", "left"), false, 0)).expect("wired");
    let error = check(&files.parsed(), &common::catalog());
    assert!(
        files.text("pair.toml").contains("left_2") || files.text("pair.toml").contains("match_left = \"match.left\""),
        "{files:#?}"
    );
    assert!(
        error.diagnostics.render(false).contains("two"),
        "the other part lacks the input: {}",
        error.diagnostics.render(false)
    );
    files.edit(|e| e.connect(("scope", "left"), ("two/match", "left"), false, 0)).expect("wired");
    files.graph();
    // From part to part.
    files.edit(|e| e.connect(("one/eyes", "left"), ("two/eyes", "right"), false, 0)).expect("wired");
    assert!(files.text("graph.toml").contains("right = \"one.left\""), "{files:#?}");
    files.graph();
    // Away again, at the graph's wire.
    files.edit(|e| e.disconnect("two/eyes", "right", 0)).expect("unwired");
    assert!(!files.text("graph.toml").contains("right = \"one.left\""), "{files:#?}");
}

#[test]
fn one_of_several_inputs_behind_a_name_gets_its_own() {
    let pair = PAIR
        .replace("left = [\"eyes.left\"]", "left = [\"eyes.left\", \"match.left\"]")
        .replace("{ left = \"eyes.left\", right = \"eyes.right\" }", "{ right = \"eyes.right\" }");
    let mut files = Files::new(&[("graph.toml", TWICE), ("pair.toml", &pair)]);
    let before = same(&files.graph());
    files.edit(|e| e.connect(("scope", "right"), ("one/match", "left"), false, 0)).expect("wired");
    let edges = |part: &str| {
        let graph = files.graph();
        let node = graph.node(&format!("{part}/match")).expect("a node");
        let edge = graph.inputs_of(node)[0].clone();
        let from = &graph.nodes[edge.from_node];
        let outputs = &common::catalog().node_types[from.type_index].outputs;
        format!("{}.{}", from.id, outputs[edge.from_port].name)
    };
    assert_eq!((edges("one").as_str(), edges("two").as_str()), ("scope.right", "scope.left"), "{files:#?}");
    let mut back = files.clone();
    back.edit(|e| e.connect(("scope", "left"), ("one/match", "left"), false, 0)).expect("wired");
    assert_eq!(same(&back.graph()), before);
}

#[test]
fn a_node_of_a_part_is_renamed_copied_and_removed_in_all_files() {
    let mut files = twice();
    assert_eq!(files.edit(|e| e.rename_node("two/match", "search")).expect("renamed"), "two/search");
    assert!(files.text("pair.toml").contains("outputs = { disparity = \"search.disparity\" }  # one"), "{files:#?}");
    assert!(files.text("graph.toml").contains("\"one/search\" = { x = 8, y = 8 }"), "{files:#?}");
    files.graph();
    assert_eq!(files.edit(|e| e.duplicate_node("one/eyes", "eyes_2")).expect("copied"), "one/eyes_2");
    assert!(files.text("pair.toml").contains("left = [\"eyes.left\", \"eyes_2.left\"]"), "{files:#?}");
    files.graph();
    files.edit(|e| e.remove_node("one/eyes_2")).expect("removed");
    files.edit(|e| e.remove_node("one/search")).expect("removed");
    let root = files.text("graph.toml");
    assert!(!root.contains("disparity") && !root.contains("search"), "{root}");
    assert!(root.contains("one = { x = 0, y = 0 }"), "{root}");
    let part = files.text("pair.toml");
    assert!(!part.contains("search") && part.contains("outputs = {  }") | part.contains("outputs = {}"), "{part}");
    let added = files.edit(|e| e.add_node("two", "match", "stereo_bm", "stereo")).expect("added");
    assert_eq!(added, "two/match");
    files.edit(|e| e.connect(("two/match", "disparity"), ("also", "packet"), false, 0)).expect("wired");
    files
        .edit(|e| {
            e.connect(("two/eyes", "left"), ("two/match", "left"), false, 0)?;
            e.connect(("two/eyes", "right"), ("two/match", "right"), false, 0)?;
            e.remove_node("show")
        })
        .expect("wired");
    files.graph();
}

#[test]
fn nodes_of_overlays_are_named_as_such() {
    let mut files = twice();
    let overlay = Files::path("other.toml");
    files.texts.insert(overlay.clone(), "plugins = [\"phantom\"]\n[nodes.scope]\ntype = \"phantom\"\n".to_owned());
    files.with = vec![overlay.clone()];
    let of_overlay = EditError::FromOverlay { id: "scope".into(), file: overlay.display().to_string() };
    assert_eq!(files.edit(|e| e.remove_node("scope")), Err(of_overlay.clone()));
    assert_eq!(files.make(&["scope"], "source"), Err(of_overlay));
    let unchanged = files.clone();
    files.edit(|e| e.disconnect("one/eyes", "left", 0)).expect("unwired");
    assert!(!files.text("graph.toml").contains("inputs = { left = \"scope.left\", right = \"scope.right\", calibration = \"scope.calibration\" }\n\n[nodes.two]"));
    assert_eq!(files.texts[&overlay], unchanged.texts[&overlay]);
}

#[test]
fn what_cannot_be_a_part_is_refused() {
    let mut files = twice();
    let unchanged = files.clone();
    assert_eq!(files.make(&[], "p"), Err(EditError::NothingSelected));
    assert_eq!(files.make(&["show", "one/match"], "p"), Err(EditError::SeveralLevels { id: "one/match".into() }));
    assert_eq!(files.make(&["show"], "also"), Err(EditError::NodeExists { id: "also".into() }));
    assert_eq!(files.make(&["show"], "1st"), Err(EditError::BadId { id: "1st".into() }));
    assert_eq!(files.make(&["nothing"], "p"), Err(EditError::NoNode { id: "nothing".into() }));
    assert_eq!(files.dissolve("show").map(|_| ()), Err(EditError::NoPart { id: "show".into() }));
    assert_eq!(files, unchanged);
    let with_budget = FLAT.replace("budget_ms = 20", "budget_ms = { arg = \"seed\" }");
    let mut files = Files::new(&[("graph.toml", &with_budget)]);
    let refused = files.make(&["match"], "p");
    assert_eq!(refused, Err(EditError::ArgInPart { id: "match".into(), key: "budget_ms".into() }));
}
