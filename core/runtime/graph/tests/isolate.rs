//! Groups of isolated nodes: whose they are, and what they survive.

use crate::common;
use panoscope_graph::edit::FileEdits;
use panoscope_graph::{Graph, GraphOptions, GraphText, NodeKind, Offer, check, to_dot};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const GRAPH: &str = r#"plugins = ["phantom", "stereo", "sinks"]
[isolate]
phantom = "renderer"
stereo = "matching"

[nodes.scope]
type = "phantom"

[nodes.depth]
graph = "parts/depth.toml"
inputs = { left = "scope.left", right = "scope.right", calibration = "scope.calibration" }

[nodes.show]
type = "preview"
isolate = "views"
inputs = { packet = "depth.disparity" }
"#;

const DEPTH: &str = r#"plugins = ["stereo"]
[part]
inputs = { left = "eyes.left", right = "eyes.right", calibration = "eyes.calibration" }
outputs = { disparity = "match.disparity" }

[nodes.eyes]
type = "rectify"

[nodes.match]
type = "stereo_bm"
isolate = "own"
inputs = { left = "eyes.left", right = "eyes.right" }
"#;

fn path(name: &str) -> PathBuf {
    Path::new("/nowhere/graphs").join(name)
}

fn parsed(graph: &str, overlay: Option<&str>) -> GraphText {
    let mut texts = BTreeMap::from([(path("parts/depth.toml"), DEPTH.to_owned())]);
    texts.extend(overlay.map(|text| (path("over.toml"), text.to_owned())));
    let with = overlay.iter().map(|_| path("over.toml")).collect();
    GraphText::parse_with(&path("graph.toml"), graph, &GraphOptions { texts, with, ..GraphOptions::default() })
}

fn checked(text: &GraphText) -> Graph {
    check(text, &common::catalog()).into_result().unwrap_or_else(|d| panic!("{}", d.render(false))).0
}

fn groups(graph: &Graph) -> Vec<(&str, Option<&str>)> {
    graph.nodes.iter().map(|n| (n.id.as_str(), n.isolate.as_deref())).collect()
}

#[test]
fn a_node_goes_before_its_plugin_and_the_use_of_a_part_before_its_nodes() {
    let graph = checked(&parsed(GRAPH, None));
    let expected = [
        ("scope", Some("renderer")),
        ("depth/eyes", Some("matching")),
        ("depth/match", Some("own")),
        ("show", Some("views")),
    ];
    assert_eq!(groups(&graph), expected);
    let whole = GRAPH.replace("graph = \"parts/depth.toml\"", "graph = \"parts/depth.toml\"\nisolate = \"depth\"");
    let graph = checked(&parsed(&whole, None));
    assert_eq!(groups(&graph)[1..3], [("depth/eyes", Some("depth")), ("depth/match", Some("depth"))]);
    let plain = GRAPH.replace("[isolate]\nphantom = \"renderer\"\nstereo = \"matching\"\n", "");
    assert_eq!(groups(&checked(&parsed(&plain, None)))[..2], [("scope", None), ("depth/eyes", None)]);
    let graph = checked(&parsed(GRAPH, Some("[isolate]\nstereo = \"other\"\n")));
    assert_eq!(groups(&graph)[1], ("depth/eyes", Some("other")), "an overlay decides for a plugin");
}

#[test]
fn a_flattened_graph_has_the_same_groups() {
    let text = parsed(GRAPH, Some("[isolate]\nstereo = \"other\"\n"));
    let flat = text.flattened(&common::catalog()).into_owned();
    let again = checked(&GraphText::parse(&path("graph.toml"), &flat));
    assert_eq!(groups(&again), groups(&checked(&text)), "{flat}");
}

#[test]
fn a_dissolved_part_leaves_its_group_to_its_nodes() {
    let graph = GRAPH.replace("graph = \"parts/depth.toml\"", "graph = \"parts/depth.toml\"\nisolate = \"depth\"");
    let text = parsed(&graph, None);
    let before: Vec<Option<String>> = checked(&text).nodes.into_iter().map(|n| n.isolate).collect();
    let mut edits = FileEdits::new(&text);
    edits.dissolve(&common::catalog(), "depth").expect("dissolved");
    let texts = edits.into_texts();
    let (_, _, new) = texts.iter().find(|(file, _, _)| file.ends_with("graph.toml")).expect("the graph changed");
    let after = checked(&GraphText::parse(&path("graph.toml"), new));
    let mut after: Vec<Option<String>> = after.nodes.into_iter().map(|n| n.isolate).collect();
    let mut before = before;
    before.sort();
    after.sort();
    assert_eq!(before, after, "{new}");
}

#[test]
fn dot_draws_a_process_as_a_cluster() {
    let graph = checked(&parsed(GRAPH, None));
    let dot = to_dot(&graph, &common::catalog());
    for part in [
        "subgraph \"cluster_process_renderer\" {",
        "label = \"process renderer\"; style = dashed;",
        "cluster_process_depth/own",
    ] {
        assert!(dot.contains(part), "no {part} in\n{dot}");
    }
    assert_eq!(dot.matches('{').count(), dot.matches('}').count());
    for node in 0..graph.nodes.len() {
        assert_eq!(dot.matches(&format!("n{node} [label")).count(), 1, "{dot}");
    }
}

#[test]
fn a_control_loop_is_not_isolated() {
    let mut catalog = common::catalog();
    for node_type in catalog.node_types.iter_mut().filter(|t| t.name == "preview") {
        node_type.kind = NodeKind::Realtime;
    }
    let diagnostics = check(&parsed(GRAPH, None), &catalog).diagnostics;
    let text = diagnostics.render(false);
    assert!(text.contains("isolated-realtime") && text.contains("`show` (preview) is a control loop"), "{text}");
}

#[test]
fn a_group_is_denied_what_the_file_or_the_last_overlay_says() {
    let deny = |graph: &Graph| -> Vec<(String, Vec<&str>)> {
        graph.nodes.iter().map(|n| (n.id.clone(), n.deny.words().collect())).collect()
    };
    let graph = format!("deny = {{ matching = [\"network\"], views = [\"new_files\", \"network\"] }}\n{GRAPH}");
    let text = parsed(&graph, None);
    let expected = [
        ("scope".to_owned(), vec![]),
        ("depth/eyes".to_owned(), vec!["network"]),
        ("depth/match".to_owned(), vec![]),
        ("show".to_owned(), vec!["network", "new_files"]),
    ];
    assert_eq!(deny(&checked(&text)), expected);
    let flat = text.flattened(&common::catalog()).into_owned();
    assert_eq!(deny(&checked(&GraphText::parse(&path("graph.toml"), &flat))), expected, "{flat}");
    let over = parsed(&graph, Some("[deny]\nmatching = []\n"));
    assert_eq!(deny(&checked(&over))[1].1, Vec::<&str>::new(), "an overlay decides for a group");
}

#[test]
fn a_plugin_is_isolated_if_all_its_nodes_are() {
    let catalog = common::catalog();
    let offers: Vec<Offer> = ["phantom", "stereo", "sinks"]
        .into_iter()
        .map(|plugin| {
            let types = catalog.node_types.iter().filter(|node_type| node_type.plugin == plugin);
            Offer { plugin: plugin.to_owned(), node_types: types.map(|node_type| node_type.name.clone()).collect() }
        })
        .collect();
    let both = |text: &GraphText| {
        let isolated = text.isolated_plugins(&offers);
        assert_eq!(checked(text).isolated_plugins, isolated, "the text and the checked graph agree");
        isolated
    };
    assert_eq!(both(&parsed(GRAPH, None)), ["phantom", "stereo", "sinks"]);
    let plain = GRAPH.replace("isolate = \"views\"\n", "");
    assert_eq!(
        both(&parsed(&plain, None)),
        ["phantom", "stereo"],
        "a node of the process of the graph needs its plugin"
    );
    let two = format!("{GRAPH}[nodes.also]\ntype = \"preview\"\ninputs = {{ packet = \"depth.disparity\" }}\n");
    assert_eq!(both(&parsed(&two, None)), ["phantom", "stereo"], "one of two nodes");
    let nobody = GRAPH.replace("stereo = \"matching\"", "");
    assert_eq!(both(&parsed(&nobody, None)), ["phantom", "sinks"], "one of two nodes, in a part");
    // Types by the name of their plugin, and types that no note has.
    let long = plain.replace("type = \"preview\"", "type = \"sinks/preview\"");
    assert_eq!(both(&parsed(&long, None)), ["phantom", "stereo"]);
    let lacking: Vec<Offer> = offers.iter().filter(|offer| offer.plugin != "sinks").cloned().collect();
    let only_phantom = GRAPH
        .replace("[isolate]\nphantom = \"renderer\"\n", "[isolate]\n")
        .replace("\"phantom\"\n", "\"phantom\"\nisolate = \"a\"\n");
    assert_eq!(parsed(&only_phantom, None).isolated_plugins(&offers), ["phantom", "stereo", "sinks"]);
    let only_phantom = only_phantom.replace("isolate = \"views\"\n", "");
    assert_eq!(parsed(&only_phantom, None).isolated_plugins(&offers), ["phantom", "stereo"]);
    assert_eq!(parsed(&only_phantom, None).isolated_plugins(&lacking), ["stereo"], "the node may be of any plugin");
}

#[test]
fn what_is_denied_to_nobody_is_a_mistake() {
    let mistakes = |deny: &str| {
        let text = parsed(&format!("deny = {deny}\n{GRAPH}"), None);
        check(&text, &common::catalog()).diagnostics.render(false)
    };
    assert_eq!(mistakes("{ renderer = [\"network\"] }"), "");
    for (deny, code, words) in [
        ("{ rendrer = [\"network\"] }", "unknown-group", "did you mean `renderer`?"),
        ("{ renderer = [\"netwrk\"] }", "unknown-word", "did you mean \"network\"?"),
        ("{ renderer = \"network\" }", "wrong-type", "a list of texts"),
    ] {
        let found = mistakes(deny);
        assert!(found.contains(code) && found.contains(words), "{deny}: {found}");
    }
}

#[test]
fn a_plugin_is_isolated_from_outside_whatever_the_file_says() {
    let plain = GRAPH.replace("isolate = \"views\"\n", "");
    let mut graph = checked(&parsed(&plain, None));
    let deny = panoscope_graph::Deny { network: true, new_files: true };
    graph.isolate_plugins(&["sinks".to_owned(), "stereo".to_owned()], "foreign", deny);
    let expected = [
        ("scope", Some("renderer")),
        ("depth/eyes", Some("matching")),
        ("depth/match", Some("own")),
        ("show", Some("foreign")),
    ];
    assert_eq!(groups(&graph), expected, "groups of the file stay");
    let denied: Vec<bool> = graph.nodes.iter().map(|n| n.deny == deny).collect();
    assert_eq!(denied, [false, true, true, true], "but not their rights");
    let shared = GRAPH.replace("renderer", "views");
    let mut graph = checked(&parsed(&shared, None));
    graph.isolate_plugins(&["sinks".to_owned()], "foreign", deny);
    assert_eq!(graph.nodes[0].deny, deny, "a node that shares the process has its rights");
}
