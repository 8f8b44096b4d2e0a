//! Graphs that are right, and what comes out of them.

use crate::common;
use crate::common::graphs::{EVERY_KEY, PANORAMA};
use panoscope_graph::{Align, GraphText, Mode, OnFault, ParamValue, check};
use std::path::{Path, PathBuf};

fn checked(text: &str) -> panoscope_graph::Graph {
    let text = GraphText::parse(Path::new("graphs/test.toml"), text);
    match check(&text, &common::catalog()).into_result() {
        Ok((graph, warnings)) => {
            assert!(warnings.is_empty(), "{warnings}");
            graph
        }
        Err(diagnostics) => panic!("{diagnostics}"),
    }
}

#[test]
fn the_designs_example_is_read_whole() {
    let text = GraphText::parse(Path::new("graphs/panorama.toml"), PANORAMA);
    assert_eq!(text.plugins(), ["phantom", "stitch", "sinks"]);
    let graph = checked(PANORAMA);
    assert_eq!((graph.name.as_str(), graph.mode), ("panorama", Mode::Live));
    let ids: Vec<&str> = graph.nodes.iter().map(|n| n.id.as_str()).collect();
    assert_eq!(ids, ["scope", "register", "wide", "out"]);
    assert_eq!(graph.order, [0, 1, 2, 3]);
    assert_eq!(graph.edges.len(), 6);
    assert_eq!(graph.inputs_of(2).len(), 3);
    assert_eq!(graph.outputs_of(0).count(), 4);
    // The registration wants gray8 of a bgr8 source, the composite takes it as it is.
    assert!(graph.inputs_of(1).iter().all(|e| e.convert));
    assert!(graph.inputs_of(2).iter().all(|e| !e.convert));
    assert_eq!(graph.nodes[0].params, [ParamValue::Int(7)]);
    assert_eq!(graph.nodes[1].params[..3], [ParamValue::Bool(true), ParamValue::Int(2), ParamValue::Float(0.7)]);
    assert_eq!(graph.nodes[1].params[3], ParamValue::Choice { index: 0, name: "ransac".to_owned() });
    assert_eq!(graph.nodes[3].params[0], ParamValue::Path(PathBuf::from("graphs/out/panorama.mkv")));
    assert_eq!((graph.nodes[0].line, graph.nodes[3].line), (6, 19));
    let pin = &graph.preset.pinned[0];
    assert_eq!((pin.node, pin.param, pin.range, pin.label.as_str()), (2, 0, Some((0.0, 40.0)), "Seam softness"));
    let views: Vec<_> = graph.preset.views.iter().map(|v| (v.node, v.port, v.label.as_str())).collect();
    assert_eq!(views, [(2, 0, "wide"), (0, 0, "Left camera")]);
}

#[test]
fn every_key_of_nodes_and_inputs_is_kept() {
    let graph = checked(EVERY_KEY);
    assert_eq!((graph.name.as_str(), graph.mode), ("test", Mode::Batch));
    assert_eq!(graph.editor["scope"]["x"].as_float(), Some(1.5));
    let show = &graph.nodes[0];
    assert_eq!(
        (show.on_fault, show.budget_ms, show.max_rate_hz, show.cpu),
        (OnFault::Bypass, Some(4.0), Some(12.5), Some(1))
    );
    // File order is kept, yet the order runs from sources to sinks.
    let id = |i: &usize| graph.nodes[*i].id.as_str();
    let order: Vec<&str> = graph.order.iter().map(id).collect();
    assert_eq!(order, ["scope", "tip", "show", "pid", "arm", "room", "edge", "pics", "see"]);
    let tip = graph.inputs_of(0)[1].clone();
    assert_eq!((tip.align, tip.queue, tip.delay), (Align::Latest, Some(3), 0));
    let pics = graph.inputs_of(graph.node("pics").expect("a node"));
    assert_eq!(pics.iter().map(|e| e.list_index).collect::<Vec<_>>(), [0, 1, 2]);
    assert_eq!(pics[2].align, Align::Nearest { tolerance_ms: 5.0 });
    assert_eq!(graph.inputs_of(1)[0].delay, 1);
    assert!(graph.inputs_of(graph.node("see").expect("a node"))[0].trigger);
    assert_eq!(graph.nodes[graph.node("edge").expect("a node")].plugin, "filters_c");
}

#[test]
fn settings_of_the_command_line_win() {
    let mut text = GraphText::parse(Path::new("graphs/panorama.toml"), PANORAMA);
    for set in
        ["scope.seed=9", "register.ratio=1", "register.method=lmeds", "out.path=/films/a b.mkv", "register.roi=false"]
    {
        text.set(set);
    }
    let (graph, _) = check(&text, &common::catalog()).into_result().expect("all are right");
    assert_eq!(graph.nodes[0].params[0], ParamValue::Int(9));
    assert_eq!(graph.nodes[1].params[0], ParamValue::Bool(false));
    assert_eq!(graph.nodes[1].params[2], ParamValue::Float(1.0));
    assert_eq!(graph.nodes[1].params[3], ParamValue::Choice { index: 1, name: "lmeds".to_owned() });
    assert_eq!(graph.nodes[3].params[0], ParamValue::Path(PathBuf::from("/films/a b.mkv")));
}

#[test]
fn wrong_settings_are_shown_as_typed() {
    let mut text = GraphText::parse(Path::new("graphs/panorama.toml"), PANORAMA);
    for set in
        ["wide.blend_px=500", "wid.blend_px=1", "wide.blend=1", "wide.blend_px=much", "seed", "register.method=fast"]
    {
        text.set(set);
    }
    let diagnostics = check(&text, &common::catalog()).into_result().expect_err("all are wrong");
    let rendered = diagnostics.render(false);
    assert_eq!(diagnostics.errors(), 6, "{rendered}");
    for line in [
        "1 | --set wide.blend_px=500\n",
        "|                     ^^^ expected 0 to 40 px\n",
        "did you mean `wide`?",
        "did you mean `blend_px`?",
        "`blend_px` must be a whole number, not a text",
        "a setting is written node.param=value",
        "choices: \"ransac\", \"lmeds\", \"prosac\"",
    ] {
        assert!(rendered.contains(line), "no {line:?} in\n{rendered}");
    }
}

#[test]
fn points_may_be_written_in_pairs() {
    let graph = checked(
        "plugins = ['phantom', 'stereo', 'sinks']\n[nodes.a]\ntype = 'phantom'\n[nodes.m]\ntype = 'measure'\n\
         inputs.depth = 'a.depth'\nparams.points = [[1, 2], [3.5, 4]]\n[nodes.t]\ntype = 'write_table'\ninputs.table = 'm.table'\n",
    );
    assert_eq!(graph.nodes[1].params, [ParamValue::Floats(vec![1.0, 2.0, 3.5, 4.0])]);
}

#[test]
fn a_missing_file_and_a_wrong_encoding_are_told() {
    let folder = std::env::temp_dir().join(format!("panoscope_graph_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(folder.join("panorama.toml"), PANORAMA).expect("a file");
    std::fs::write(folder.join("latin.toml"), b"name = \"a\"\n# \xe9t\xe9\n").expect("a file");
    let missing = GraphText::load(&folder.join("panorma.toml")).expect_err("no such file").render(false);
    assert!(missing.contains("the graph file does not exist") && missing.contains("panorama.toml`?"), "{missing}");
    let latin = GraphText::load(&folder.join("latin.toml")).expect_err("not UTF-8").render(false);
    assert!(latin.contains("not UTF-8") && latin.contains("line 2"), "{latin}");
    let directory = GraphText::load(&folder).expect_err("a folder").render(false);
    assert!(directory.contains("a folder"), "{directory}");
    assert!(GraphText::load(&folder.join("panorama.toml")).is_ok());
    std::fs::remove_dir_all(&folder).expect("a folder to remove");
}

#[test]
fn a_thousand_nodes_are_no_burden() {
    let mut text = String::from("plugins = ['phantom', 'overlay', 'sinks']\n[nodes.n0]\ntype = 'phantom'\n");
    let mut before = "n0.left".to_owned();
    for i in 1..1000 {
        text.push_str(&format!("[nodes.n{i}]\ntype = 'overlay'\ninputs.image = '{before}'\n"));
        before = format!("n{i}.image");
    }
    text.push_str(&format!("[nodes.out]\ntype = 'preview'\ninputs.packet = '{before}'\n"));
    let graph = checked(&text);
    assert_eq!((graph.nodes.len(), graph.edges.len()), (1001, 1000));
    assert_eq!(graph.order, (0..1001).collect::<Vec<_>>());
}
