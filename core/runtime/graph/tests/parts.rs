//! Arguments, parts and overlays: what they are flattened to, and where their values come from.

use crate::common;
use panoscope_graph::edit::{EditError, GraphEdit, NoHome};
use panoscope_graph::{Edge, FileKind, Graph, GraphOptions, GraphText, HomeEntry, Node, ParamHome, ParamValue, check};
use panoscope_testing::Folder;
use std::path::Path;

fn open(folder: &Folder, options: &GraphOptions) -> GraphText {
    GraphText::load_with(&folder.at("graph.toml"), options).expect("the graph is there")
}

fn checked(text: &GraphText) -> Graph {
    let (graph, warnings) =
        check(text, &common::catalog()).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    assert!(warnings.is_empty(), "{}", warnings.render(false));
    graph
}

/// The graph without the locations of its nodes and edges.
fn unlocated(mut graph: Graph) -> Graph {
    graph.nodes = graph.nodes.into_iter().map(|n| Node { span: 0..0, line: 0, ..n }).collect();
    graph.edges = graph.edges.into_iter().map(|e| Edge { span: 0..0, ..e }).collect();
    graph
}

const GRAPH: &str = r#"name = "depth"
mode = "batch"
plugins = ["phantom", "sinks"]

[args.seed]
type = "whole"
doc = "Seed of the scene"
default = 5

[nodes.scope]
type = "phantom"
params = { seed = { arg = "seed" } }

[nodes.depth]
graph = "parts/depth.toml"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }
params = { search_px = 128 }

[nodes.show]
type = "preview"
inputs = { packet = { from = "depth.disparity", align = "latest", queue = 3 } }

[nodes.film]
type = "write_images"
inputs = { images = ["depth.left", "scope.wide"] }

[preset]
views = [{ from = "depth.disparity", label = "Depth" }]
pinned = [{ param = "depth.search_px", range = [32, 128] }, { param = "scope.seed" }]
"#;

const DEPTH: &str = r#"plugins = ["stereo"]

[part]
inputs = { left = "eyes.left", right = "eyes.right", calibration = "eyes.calibration" }
outputs = { disparity = "match.disparity", left = "eyes.left" }
params = { search_px = "match.search_px", roi = "match.roi" }

[nodes.eyes]
graph = "eyes.toml"

[nodes.match]
type = "stereo_bm"
inputs = { left = "eyes.left", right = "eyes.right" }
params = { search_px = 64, block_px = 21 }
"#;

const EYES: &str = r#"plugins = ["stereo"]

[part]
inputs = { left = "rectify.left", right = "rectify.right", calibration = "rectify.calibration" }
outputs = { left = "rectify.left", right = "rectify.right" }

[nodes.rectify]
type = "rectify"
"#;

const FLAT: &str = r#"name = "depth"
mode = "batch"
plugins = ["phantom", "sinks", "stereo"]

[nodes.scope]
type = "phantom"
params = { seed = 5 }

[nodes."depth/eyes/rectify"]
type = "rectify"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }

[nodes."depth/match"]
type = "stereo_bm"
inputs = { left = "depth/eyes/rectify.left", right = "depth/eyes/rectify.right" }
params = { block_px = 21, search_px = 128 }

[nodes.show]
type = "preview"
inputs = { packet = { from = "depth/match.disparity", align = "latest", queue = 3 } }

[nodes.film]
type = "write_images"
inputs = { images = ["depth/eyes/rectify.left", "scope.wide"] }

[preset]
views = [{ from = "depth/match.disparity", label = "Depth" }]
pinned = [{ param = "depth/match.search_px", range = [32, 128] }, { param = "scope.seed" }]
"#;

fn depth(name: &str) -> Folder {
    Folder::new(name, &[("graph.toml", GRAPH), ("parts/depth.toml", DEPTH), ("parts/eyes.toml", EYES)])
}

#[test]
fn parts_of_parts_are_the_same_graph_as_a_flat_file() {
    let folder = depth("flat");
    let text = open(&folder, &GraphOptions::default());
    let graph = checked(&text);
    let by_hand = checked(&GraphText::parse(&folder.at("graph.toml"), FLAT));
    let mut expected = unlocated(by_hand);
    // The label of a pin without one is the parameter's name in the file.
    assert_eq!(graph.preset.pinned[0].label, "search_px");
    expected.plugins = graph.plugins.clone();
    assert_eq!(unlocated(graph), expected);
    let lines: Vec<usize> = checked(&text).nodes.iter().map(|n| n.line).collect();
    assert_eq!(lines, [10, 7, 11, 19, 23], "lines of the files they stand in");
}

#[test]
fn the_flattened_text_means_the_same() {
    let folder = depth("text");
    let options = GraphOptions { args: vec![("seed".into(), "9".into())], ..GraphOptions::default() };
    let text = open(&folder, &options);
    let flat = text.flattened(&common::catalog()).into_owned();
    let again = GraphText::parse(&folder.at("graph.toml"), &flat);
    assert!(again.is_plain());
    assert_eq!(unlocated(checked(&again)), unlocated(checked(&text)), "{flat}");
    assert_eq!(again.flattened(&common::catalog()), flat, "a plain text stays as it is");
    assert_eq!(checked(&again).nodes[0].params[0], ParamValue::Int(9));
}

#[test]
fn values_of_arguments_come_from_the_command_line_then_overlays_then_the_graph() {
    let folder = Folder::new(
        "args",
        &[
            ("graph.toml", GRAPH),
            ("parts/depth.toml", DEPTH),
            ("parts/eyes.toml", EYES),
            ("over.toml", "[args.seed]\ndefault = 6\n"),
        ],
    );
    let seed = |options: &GraphOptions| checked(&open(&folder, options)).nodes[0].params[0].clone();
    assert_eq!(seed(&GraphOptions::default()), ParamValue::Int(5));
    let with = GraphOptions { with: vec![folder.at("over.toml")], ..GraphOptions::default() };
    assert_eq!(seed(&with), ParamValue::Int(6));
    let both = GraphOptions { args: vec![("seed".into(), "7".into()), ("seed".into(), "8".into())], ..with.clone() };
    assert_eq!(seed(&both), ParamValue::Int(8));
    let set = GraphOptions { set: vec!["scope.seed=9".into()], ..both };
    assert_eq!(seed(&set), ParamValue::Int(9));
    let kinds: Vec<FileKind> = open(&folder, &with).files().iter().map(|f| f.kind).collect();
    assert_eq!(kinds, [FileKind::Graph, FileKind::Overlay, FileKind::Part, FileKind::Part]);
}

#[test]
fn every_type_of_argument_reaches_its_parameter() {
    let graph = r#"plugins = ["capture", "stitch", "tools", "sinks"]
plugin_paths = [{ arg = "folder" }]
[args]
left = { type = "source", doc = "Left view" }
model = { type = "file" }
film = { type = "path" }
folder = { type = "path", default = "more" }
rate = { type = "number", range = [1, 60], unit = "Hz" }
blend-width = { type = "whole", default = 12 }
again = { type = "flag", default = false }
method = { type = "choice", choices = ["ransac", "lmeds"], default = "lmeds" }
title = { type = "text", default = "wide" }
[nodes.scope]
type = "capture"
params = { source = { arg = "left" }, rate_hz = { arg = "rate" }, loop = { arg = "again" } }
[nodes.register]
type = "register_surf"
inputs = { left = "scope.left", right = "scope.right" }
params = { method = { arg = "method" } }
[nodes.wide]
type = "composite"
inputs = { left = "scope.left", right = "scope.right", homography = "register.homography" }
params = { blend_px = { arg = "blend_width" } }
[nodes.find]
type = "yolo"
inputs = { image = "wide.panorama" }
params = { model = { arg = "model" } }
[nodes.film]
type = "write_video"
inputs = { image = "wide.panorama" }
params = { path = { arg = "film" } }
[nodes.show]
type = "preview"
inputs = { packet = "find.detections" }
[preset]
views = [{ from = "wide.panorama", label = { arg = "title" } }]
"#;
    let folder = Folder::new("types", &[("sub/graph.toml", graph), ("sub/more/x", ""), ("net.onnx", "")]);
    let model = folder.at("net.onnx").display().to_string();
    let args = [
        ("left", "4"),
        ("model", &model),
        ("film", "made/film.mkv"),
        ("rate", "24.5"),
        ("again", ""),
        ("blend-width", "30"),
    ];
    let args = args.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned())).collect();
    let path = folder.at("sub/graph.toml");
    let text = GraphText::load_with(&path, &GraphOptions { args, ..GraphOptions::default() }).expect("there");
    let graph = checked(&text);
    let value = |node: &str, param: usize| graph.nodes[graph.node(node).expect("a node")].params[param].clone();
    assert_eq!(value("scope", 0), ParamValue::Text("4".into()));
    assert_eq!(value("scope", 1), ParamValue::Bool(true));
    assert_eq!(value("scope", 2), ParamValue::Float(24.5));
    assert_eq!(value("register", 3), ParamValue::Choice { index: 1, name: "lmeds".into() });
    assert_eq!(value("wide", 0), ParamValue::Int(30));
    assert_eq!(value("find", 0), ParamValue::Path(folder.at("net.onnx")));
    // What is given on the command line starts from the working folder, what stands in the file from the file.
    assert_eq!(value("film", 0), ParamValue::Path(std::env::current_dir().expect("a folder").join("made/film.mkv")));
    assert_eq!(text.plugin_paths(), [folder.at("sub/more")]);
    assert_eq!(graph.preset.views[0].label, "wide");
    let left = &text.args()[0];
    assert_eq!((left.name.as_str(), left.help().as_str()), ("left", "Left view [required]"));
    let rate = text.args().iter().find(|a| a.name == "rate").expect("declared");
    assert_eq!(
        (rate.option(), rate.value_name(), rate.help()),
        ("--rate".into(), "NUMBER".into(), "[1 to 60 Hz, required]".into())
    );
}

#[test]
fn without_values_everything_else_is_checked() {
    let graph = "plugins = [\"capture\", \"sinks\"]\n[args.left]\ntype = \"source\"\n[nodes.scope]\ntype = \"capture\"\n\
                 params = { source = { arg = \"left\" }, rate_hz = 999.0 }\n[nodes.show]\ntype = \"preview\"\ninputs = { packet = \"scope.left\" }\n";
    let folder = Folder::new("missing", &[("graph.toml", graph)]);
    let codes = |options: &GraphOptions| {
        let diagnostics = check(&open(&folder, options), &common::catalog()).diagnostics;
        diagnostics.iter().map(|d| d.code).collect::<Vec<_>>()
    };
    assert_eq!(codes(&GraphOptions::default()), ["missing-arg", "param-range"]);
    let lenient = GraphOptions { allow_missing_args: true, ..GraphOptions::default() };
    assert_eq!(codes(&lenient), ["param-range"]);
    assert_eq!(open(&folder, &lenient).missing_args(), ["left"]);
    // A setting gives what the argument would give.
    let set =
        GraphOptions { set: vec!["scope.source=3".into(), "scope.rate_hz=30.0".into()], ..GraphOptions::default() };
    let text = GraphText::parse_with(&folder.at("graph.toml"), &graph.replace("999.0", "25.0"), &set);
    assert!(text.missing_args().is_empty());
    assert_eq!(checked(&text).nodes[0].params[0], ParamValue::Text("3".into()));
}

#[test]
fn overlays_replace_nodes_in_place_also_inside_parts() {
    let over = "plugins = [\"capture\", \"stereo\"]\n[args.left]\ntype = \"source\"\ndefault = \"left.mp4\"\n[nodes.scope]\ntype = \"capture\"\n\
                params = { source = { arg = \"left\" } }\n[nodes.\"depth/eyes/rectify\"]\ntype = \"rectify\"\n";
    let plain = GRAPH.replace(", \"scope.wide\"", "").replace(", { param = \"scope.seed\" }", "");
    let folder = Folder::new(
        "overlay",
        &[("graph.toml", &plain), ("parts/depth.toml", DEPTH), ("parts/eyes.toml", EYES), ("sources/files.toml", over)],
    );
    let options = GraphOptions { with: vec![folder.at("sources/files.toml")], ..GraphOptions::default() };
    let text = open(&folder, &options);
    // The graph's own argument is used by the replaced node alone; nothing is said of that.
    let graph = checked(&text);
    let ids: Vec<&str> = graph.nodes.iter().map(|n| n.id.as_str()).collect();
    assert_eq!(ids, ["scope", "depth/eyes/rectify", "depth/match", "show", "film"]);
    // A file of the overlay's folder.
    assert_eq!(graph.nodes[0].params[0], ParamValue::Text(folder.at("sources/left.mp4").display().to_string()));
    assert_eq!(graph.inputs_of(1).len(), 3, "the node inside is connected as the one it replaces");
}

#[test]
fn a_part_can_be_checked_alone() {
    // Its output `again` is one of a part inside, which nothing else reads.
    let other = "[nodes.other]\ngraph = \"eyes.toml\"\ninputs = { left = \"eyes.left\", right = \"eyes.right\" }\n";
    let depth = format!("{DEPTH}\n{other}")
        .replace("left = \"eyes.left\" }\nparams", "left = \"eyes.left\", again = \"other.left\" }\nparams")
        .replace("= \"eyes.calibration\" }", "= [\"eyes.calibration\", \"other.calibration\"] }");
    let folder = Folder::new("alone", &[("graph.toml", &depth), ("eyes.toml", EYES)]);
    let text = open(&folder, &GraphOptions { allow_missing_args: true, ..GraphOptions::default() });
    assert!(text.is_part());
    let checked = check(&text, &common::catalog());
    assert!(checked.diagnostics.is_empty(), "{}", checked.diagnostics.render(false));
    // What its user connects makes a node of a loop run, and its user gives the values that it names.
    let looped = "plugins = [\"stereo\", \"stitch\"]\n[part]\ninputs = { left = [\"match.left\", \"register.left\"], right = [\"match.right\", \"register.right\"] }\n\
                  outputs = { disparity = \"match.disparity\" }\n[nodes.match]\ntype = \"stereo_bm\"\n\
                  inputs = { roi = { from = \"register.roi_left\", delay = 1 } }\n[nodes.register]\ntype = \"register_surf\"\n";
    let options = GraphOptions { allow_missing_args: true, ..GraphOptions::default() };
    let diagnostics =
        check(&GraphText::parse_with(&folder.at("graph.toml"), looped, &options), &common::catalog()).diagnostics;
    assert!(diagnostics.is_empty(), "{}", diagnostics.render(false));
}

#[test]
fn paths_of_a_part_start_from_its_own_folder() {
    let part = "plugins = [\"tools\"]\n[part]\ninputs = { image = \"find.image\" }\noutputs = { found = \"find.detections\" }\n\
                params = { model = \"find.model\" }\n[nodes.find]\ntype = \"yolo\"\nparams = { model = \"net.onnx\" }\n";
    let graph = "plugins = [\"phantom\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.one]\ngraph = \"parts/find.toml\"\n\
                 inputs = { image = \"scope.left\" }\n[nodes.two]\ngraph = \"parts/find.toml\"\ninputs = { image = \"scope.left\" }\n\
                 params = { model = \"own.onnx\" }\n[nodes.a]\ntype = \"preview\"\ninputs = { packet = \"one.found\" }\n[nodes.b]\n\
                 type = \"preview\"\ninputs = { packet = \"two.found\" }\n";
    let files = [("graph.toml", graph), ("parts/find.toml", part), ("parts/net.onnx", ""), ("own.onnx", "")];
    let folder = Folder::new("paths", &files);
    let text = open(&folder, &GraphOptions::default());
    let model = |text: &GraphText, node: usize| match &checked(text).nodes[node].params[0] {
        ParamValue::Path(path) => path.canonicalize().expect("it is there"),
        other => panic!("{other:?}"),
    };
    let there = |file: &str| folder.at(file).canonicalize().expect("it is there");
    assert_eq!((model(&text, 1), model(&text, 2)), (there("parts/net.onnx"), there("own.onnx")));
    let flat = text.flattened(&common::catalog()).into_owned();
    let again = GraphText::parse(&folder.at("graph.toml"), &flat);
    assert_eq!((model(&again, 1), model(&again, 2)), (there("parts/net.onnx"), there("own.onnx")));
    assert_eq!(text.files().len(), 2, "one part, used twice");
}

#[test]
fn a_change_goes_back_to_where_the_value_came_from() {
    let folder = depth("home");
    let text = open(&folder, &GraphOptions::default());
    let home = |node: &str, param: &str| {
        let ParamHome { file, entry } = text.param_home(node, param).expect("a home");
        let file = file.strip_prefix(folder.path()).expect("in the folder").display().to_string();
        match entry {
            HomeEntry::Param { node, param } => format!("{file}: {node}.{param}"),
            HomeEntry::ArgDefault { arg } => format!("{file}: default of {arg}"),
        }
    };
    assert_eq!(home("depth/match", "search_px"), "graph.toml: depth.search_px");
    assert_eq!(home("depth", "search_px"), "graph.toml: depth.search_px");
    assert_eq!(home("depth/match", "block_px"), "parts/depth.toml: match.block_px");
    assert_eq!(home("depth/match", "roi"), "graph.toml: depth.roi", "nowhere given: the part's user sets it");
    assert_eq!(home("scope", "seed"), "graph.toml: default of seed");
    assert_eq!(text.param_home("depth/mach", "roi"), Err(NoHome::NoNode("depth/mach".into())));
    let given = open(&folder, &GraphOptions { args: vec![("seed".into(), "3".into())], ..GraphOptions::default() });
    let (param, arg) = ("scope.seed".to_owned(), "seed".to_owned());
    assert_eq!(given.param_home("scope", "seed"), Err(NoHome::CommandLine { param, arg }));

    let mut edit = GraphEdit::parse(GRAPH).expect("TOML");
    text.param_home("scope", "seed").expect("a home").entry.set(&mut edit, Some(&77.into())).expect("set");
    assert_eq!(edit.text(), GRAPH.replace("default = 5", "default = 77"));
    let inside = edit.set_param("depth/match", "block_px", &9.into());
    assert_eq!(inside, Err(EditError::InPart { id: "depth/match".into() }));
}

#[test]
fn texts_stand_in_for_files() {
    let folder = depth("texts");
    let changed = DEPTH.replace("block_px = 21", "block_px = 33");
    let options = GraphOptions { texts: [(folder.at("parts/depth.toml"), changed)].into(), ..GraphOptions::default() };
    let block = |options: &GraphOptions| checked(&open(&folder, options)).nodes[2].params[1].clone();
    assert_eq!((block(&GraphOptions::default()), block(&options)), (ParamValue::Int(21), ParamValue::Int(33)));
}

#[test]
fn names_of_parts_stand_for_nodes_everywhere() {
    let folder = depth("names");
    let text = open(&folder, &GraphOptions { set: vec!["depth.search_px=32".into()], ..GraphOptions::default() });
    assert_eq!(text.settings(), ["depth/match.search_px=32"]);
    assert_eq!(checked(&text).nodes[2].params[0], ParamValue::Int(32));
    assert_eq!(text.resolve_param("depth.search_px"), "depth/match.search_px");
    assert_eq!(text.resolve_param("scope.seed"), "scope.seed");
    assert_eq!(text.resolve_output("depth.left"), "depth/eyes/rectify.left");
    assert_eq!(text.resolve_output("depth.left.x[2]"), "depth/eyes/rectify.left.x[2]");
}

#[test]
fn parts_that_multiply_without_end_are_refused() {
    // Each level uses the next one ten times: 10^6 nodes.
    let level = |next: &str| {
        let nodes: String = (0..10).map(|i| format!("[nodes.n{i}]\ngraph = \"{next}\"\n")).collect();
        format!("plugins = [\"phantom\"]\n[part]\n{nodes}")
    };
    let leaf = "plugins = [\"phantom\"]\n[part]\n[nodes.scope]\ntype = \"phantom\"\n".to_owned();
    let names = ["b.toml", "c.toml", "d.toml", "e.toml", "f.toml", "leaf.toml"];
    let mut files: Vec<(&str, String)> = names.windows(2).map(|w| (w[0], level(w[1]))).collect();
    files.push(("leaf.toml", leaf));
    files.push(("graph.toml", level("b.toml")));
    let files: Vec<(&str, &str)> = files.iter().map(|(n, t)| (*n, t.as_str())).collect();
    let folder = Folder::new("multiply", &files);
    let text = open(&folder, &GraphOptions { allow_missing_args: true, ..GraphOptions::default() });
    assert!(text.diagnostics().iter().any(|d| d.code == "too-many-nodes"));
}

#[test]
fn parts_without_nodes_that_multiply_are_refused() {
    // Each level uses the next one ten times, and the last has no node: 10^11 parts.
    let level = |next: &str| {
        let nodes: String = (0..10).map(|i| format!("[nodes.n{i}]\ngraph = \"{next}\"\n")).collect();
        format!("[part]\n{nodes}")
    };
    let names: Vec<String> = (0..11).map(|i| format!("p{i}.toml")).collect();
    let mut files: Vec<(&str, String)> = names.windows(2).map(|w| (w[0].as_str(), level(&w[1]))).collect();
    files.push(("p10.toml", "[part]\n".to_owned()));
    files.push(("graph.toml", level("p0.toml")));
    let files: Vec<(&str, &str)> = files.iter().map(|(n, t)| (*n, t.as_str())).collect();
    let folder = Folder::new("multiply-empty", &files);
    let text = open(&folder, &GraphOptions { allow_missing_args: true, ..GraphOptions::default() });
    assert!(text.diagnostics().iter().any(|d| d.code == "too-many-nodes"));
}

#[test]
fn names_of_parts_that_multiply_are_refused() {
    // Each level hands its two names on to both names of the next one: 2^40 names for 40 parts.
    let level = |next: &str| {
        format!(
            "[part]\nparams = {{ a = [\"in.a\", \"in.b\"], b = [\"in.a\", \"in.b\"] }}\n[nodes.in]\ngraph = \"{next}\"\nparams = {{ a = 1, b = 2 }}\n"
        )
    };
    let names: Vec<String> = (0..40).map(|i| format!("p{i}.toml")).collect();
    let mut files: Vec<(&str, String)> = names.windows(2).map(|w| (w[0].as_str(), level(&w[1]))).collect();
    let leaf = "plugins = [\"phantom\"]\n[part]\nparams = { a = \"scope.seed\", b = \"scope.seed\" }\n[nodes.scope]\ntype = \"phantom\"\n";
    files.push(("p39.toml", leaf.to_owned()));
    files.push(("graph.toml", "[nodes.top]\ngraph = \"p0.toml\"\nparams = { a = 3 }\n".to_owned()));
    let files: Vec<(&str, &str)> = files.iter().map(|(n, t)| (*n, t.as_str())).collect();
    let folder = Folder::new("multiply-names", &files);
    let text = open(&folder, &GraphOptions { set: vec!["top.a=4".into()], ..GraphOptions::default() });
    assert!(text.diagnostics().iter().any(|d| d.code == "too-many-nodes"), "{:?}", text.diagnostics());
    let seed = format!("top/{}scope.seed", "in/".repeat(39));
    assert_eq!(text.settings(), [format!("{seed}=4")], "one node has the parameter");
}

#[test]
fn parts_in_parts_have_a_limit() {
    let names: Vec<String> = (0..100).map(|i| format!("p{i}.toml")).collect();
    let level = |next: &str| format!("[part]\n[nodes.in]\ngraph = \"{next}\"\n");
    let mut files: Vec<(&str, String)> = names.windows(2).map(|w| (w[0].as_str(), level(&w[1]))).collect();
    files.push(("p99.toml", "[part]\n".to_owned()));
    files.push(("graph.toml", level("p0.toml")));
    let files: Vec<(&str, &str)> = files.iter().map(|(n, t)| (*n, t.as_str())).collect();
    let folder = Folder::new("deep-parts", &files);
    let text = open(&folder, &GraphOptions { allow_missing_args: true, ..GraphOptions::default() });
    let wrong = text.diagnostics();
    assert!(wrong.iter().any(|d| d.code == "part-recursion" && d.message.contains("64 deep")), "{wrong:?}");
}

#[test]
fn a_device_is_no_part_and_no_graph() {
    let folder = Folder::new("device", &[("graph.toml", "[nodes.a]\ngraph = \"/dev/zero\"\n")]);
    let text = open(&folder, &GraphOptions::default());
    let wrong = text.diagnostics();
    assert!(wrong.iter().any(|d| d.code == "part-unreadable" && d.message.contains("device")), "{wrong:?}");
    let error = GraphText::load(Path::new("/dev/zero")).expect_err("no graph").render(false);
    assert!(error.contains("graph-unreadable") && error.contains("not a regular file"), "{error}");
}

#[test]
fn paths_are_relative_to_the_file_that_names_them() {
    let folder = depth("relative");
    let text = open(&folder, &GraphOptions::default());
    let files: Vec<String> = text.files().iter().map(|f| f.path.to_owned()).collect();
    let expected = ["graph.toml", "parts/depth.toml", "parts/eyes.toml"].map(|f| folder.at(f).display().to_string());
    assert_eq!(files, expected);
    assert_eq!(text.path(), Path::new(&expected[0]));
}

/// A source on a carrier that says where it is, and a graph that uses that where there is one.
const CARRIED: &str = r#"plugins = ["phantom", "stereo"]
[part]
outputs = { left = "view.left", wide = "view.wide", disparity = "match.disparity" }
params = { seed = "view.seed", block_px = "match.block_px" }
[nodes.view]
type = "phantom"
[nodes.match]
type = "stereo_bm"
inputs = { left = "view.left", right = "view.right" }
"#;

const USER: &str = r#"plugins = ["phantom", "capture", "sinks"]
[nodes.scope]
graph = "carried.toml"
[nodes.film]
type = "write_images"
inputs = { images = ["scope.left", { from = "scope.wide", optional = true }] }
[nodes.map]
type = "preview"
inputs = { packet = { from = "scope.disparity", align = "latest", optional = true } }
[preset]
views = ["scope.left", { from = "scope.disparity", optional = true }]
pinned = [{ param = "scope.seed", optional = true }, { param = "scope.block_px", optional = true }]
"#;

fn carried(name: &str) -> Folder {
    let over = |kind: &str| format!("plugins = [\"capture\", \"phantom\"]\n[nodes.scope]\ntype = \"{kind}\"\n");
    let files = [
        ("graph.toml", USER),
        ("carried.toml", CARRIED),
        ("capture.toml", &over("capture")),
        ("phantom.toml", &over("phantom")),
        ("part.toml", "[nodes.scope]\ngraph = \"plain.toml\"\n"),
        (
            "plain.toml",
            "plugins = [\"capture\"]\n[part]\noutputs = { left = \"view.left\" }\n[nodes.view]\ntype = \"capture\"\n",
        ),
    ];
    Folder::new(name, &files)
}

#[test]
fn optional_connections_hold_where_nothing_was_replaced() {
    let folder = carried("optional");
    let graph = checked(&open(&folder, &GraphOptions::default()));
    let ids: Vec<&str> = graph.nodes.iter().map(|n| n.id.as_str()).collect();
    assert_eq!(ids, ["scope/view", "scope/match", "film", "map"]);
    assert_eq!((graph.preset.views.len(), graph.preset.pinned.len()), (2, 2));
    assert_eq!(graph.inputs_of(2).len(), 2);
    // A wrong name is an error: nothing was replaced that could have had it.
    let wrong = USER.replace("from = \"scope.disparity\", align", "from = \"scope.disparty\", align");
    let text = GraphText::parse(&folder.at("graph.toml"), &wrong);
    let codes: Vec<&str> = check(&text, &common::catalog()).diagnostics.iter().map(|d| d.code).collect();
    assert_eq!(codes, ["unknown-part-output"]);
}

#[test]
fn optional_connections_are_left_out_with_a_source_that_does_not_have_them() {
    let folder = carried("left-out");
    // A node without that output, a node that has it, and a part without it.
    for (over, ids, views, pins, inputs) in [
        ("capture.toml", &["scope", "film"][..], 1, 0, 1),
        ("phantom.toml", &["scope", "film", "map"], 2, 1, 2),
        ("part.toml", &["scope/view", "film"], 1, 0, 1),
    ] {
        let options = GraphOptions { with: vec![folder.at(over)], ..GraphOptions::default() };
        let text = open(&folder, &options);
        let (graph, _) =
            check(&text, &common::catalog()).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
        let found: Vec<&str> = graph.nodes.iter().map(|n| n.id.as_str()).collect();
        assert_eq!(found, ids, "{over}");
        assert_eq!((graph.preset.views.len(), graph.preset.pinned.len()), (views, pins), "{over}");
        assert_eq!(graph.inputs_of(graph.node("film").expect("film")).len(), inputs, "{over}");
        // One text without overlay means the same.
        let flat = text.flattened(&common::catalog()).into_owned();
        let again = check(&GraphText::parse(&folder.at("graph.toml"), &flat), &common::catalog());
        let (again, _) = again.into_result().unwrap_or_else(|d| panic!("{flat}{}", d.render(false)));
        let found: Vec<&str> = again.nodes.iter().map(|n| n.id.as_str()).collect();
        assert_eq!(found, ids, "{over}: {flat}");
        assert_eq!((again.preset.views.len(), again.preset.pinned.len()), (views, pins), "{over}: {flat}");
    }
}

#[test]
fn an_optional_connection_is_left_out_where_the_type_has_no_such_input() {
    let check_with = |input: &str| {
        let text = format!(
            r#"plugins = ["phantom", "stereo"]
[nodes.view]
type = "phantom"
[nodes.match]
type = "stereo_bm"
inputs = {{ left = "view.left", right = "view.right", {input} = {{ from = "view.left", optional = true }} }}
"#
        );
        check(&GraphText::parse(Path::new("graph.toml"), &text), &common::catalog()).into_result()
    };
    // `packet` is an input of other types, such as the one that stood here before.
    let (graph, _) = check_with("packet").unwrap_or_else(|d| panic!("{}", d.render(false)));
    assert_eq!(graph.edges.len(), 2);
    let said = check_with("packett").expect_err("a spelling mistake").render(false);
    assert!(said.contains("has no input `packett`"), "{said}");
}

#[test]
fn an_optional_connection_is_left_out_where_the_type_has_no_such_output() {
    let check_with = |output: &str| {
        let text = format!(
            r#"plugins = ["capture", "stereo"]
[nodes.view]
type = "capture"
[nodes.match]
type = "stereo_bm"
inputs = {{ left = "view.left", right = "view.right", mask_left = {{ from = "view.{output}", optional = true }} }}
"#
        );
        check(&GraphText::parse(Path::new("graph.toml"), &text), &common::catalog()).into_result()
    };
    // `disparity` is an output of other types, such as the one that stood here before.
    let (graph, _) = check_with("disparity").unwrap_or_else(|d| panic!("{}", d.render(false)));
    assert_eq!(graph.edges.len(), 2);
    let said = check_with("disparityy").expect_err("a spelling mistake").render(false);
    assert!(said.contains("has no output `disparityy`"), "{said}");
}

#[test]
fn other_connections_to_a_replaced_source_are_errors_that_name_the_overlay() {
    let folder = carried("lacks");
    let needs = USER.replacen(", optional = true", "", 1);
    let options = GraphOptions { with: vec![folder.at("capture.toml")], ..GraphOptions::default() };
    let text = GraphText::parse_with(&folder.at("graph.toml"), &needs, &options);
    let said = check(&text, &common::catalog()).into_result().expect_err("an error").render(false);
    assert!(said.contains("has no output `wide`") && said.contains("capture.toml:2:8"), "{said}");
}

#[test]
fn nothing_of_files_that_are_no_graphs_is_shown() {
    let graph = "[nodes.a]\ngraph = \"site.env\"\n[nodes.b]\ngraph = \"link.toml\"\n[nodes.c]\ngraph = \"/proc/self/environ\"\n";
    let folder =
        Folder::new("not_shown", &[("graph.toml", graph), ("site.env", "PASSWORD = \"geheim\"\nTOKEN = geheim\n")]);
    std::os::unix::fs::symlink(folder.at("site.env"), folder.at("link.toml")).expect("a link");
    let text = GraphText::load_with(&folder.at("graph.toml"), &GraphOptions::default()).expect("it is there");
    let errors = check(&text, &common::catalog()).into_result().expect_err("mistakes").render(false);
    for part in ["site.env", "link.toml", "/proc/self/environ"] {
        assert!(errors.contains(&format!("`{part}` is not a part: names of graph files end in .toml")), "{errors}");
    }
    for secret in ["geheim", "PASSWORD", "TOKEN", "PATH="] {
        assert!(!errors.contains(secret), "{errors}");
    }
}
