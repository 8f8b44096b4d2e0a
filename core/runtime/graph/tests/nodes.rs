//! Tests of checks by nodes, of files that several nodes use, and of defaults from plugins.

use crate::common;
use std::path::{Path, PathBuf};

use panoscope_graph::{
    Catalog, Diagnostics, Graph, GraphText, NodeSetup, ParamKind, ParamValue, Pick, Severity, check,
};

const PENALTIES: &str = "plugins = [\"phantom\", \"stereo\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n\
    [nodes.stereo]\ntype = \"stereo_sgbm\"\ninputs = { left = \"scope.left\", right = \"scope.right\" }\n\
    [nodes.out]\ntype = \"preview\"\ninputs = { packet = \"stereo.disparity\" }\n";

fn run(text: &str, settings: &[&str], catalog: &Catalog) -> (Option<Graph>, Diagnostics) {
    let mut text = GraphText::parse(Path::new("folder/test.toml"), text);
    settings.iter().for_each(|set| text.set(set));
    let checked = check(&text, catalog);
    (checked.graph, checked.diagnostics)
}

#[test]
fn a_setting_that_a_node_refuses_is_shown_where_it_was_typed() {
    let (graph, diagnostics) = run(PENALTIES, &["stereo.small_penalty=105"], &common::catalog());
    assert!(graph.is_none());
    let told: Vec<_> = diagnostics.iter().map(|d| (d.code, d.file.as_str(), d.column)).collect();
    assert_eq!(told, [("invalid-param", "command line", 28)], "{}", diagnostics.render(false));
    // A setting that mends the file is as good as the file.
    let wrong = PENALTIES.replace("[nodes.out]", "params = { small_penalty = 105 }\n[nodes.out]");
    assert!(run(&wrong, &[], &common::catalog()).0.is_none());
    assert!(run(&wrong, &["stereo.large_penalty=110"], &common::catalog()).0.is_some());
}

#[test]
fn a_warning_of_a_node_leaves_the_graph_usable() {
    let (graph, diagnostics) = run(PENALTIES, &["stereo.large_penalty=115"], &common::catalog());
    assert!(graph.is_some(), "{}", diagnostics.render(false));
    assert_eq!((diagnostics.errors(), diagnostics.warnings()), (0, 1), "{}", diagnostics.render(false));
}

#[test]
fn a_running_node_is_refused_only_what_is_new() {
    let catalog = common::catalog();
    let node_type = catalog.node_types.iter().find(|t| t.name == "stereo_sgbm").expect("a node type");
    let validator = node_type.validator.as_ref().expect("it checks itself");
    let values = |small: i64, large: i64, mask: &str| {
        [ParamValue::Int(small), ParamValue::Int(large), ParamValue::Path(PathBuf::from(mask))]
    };
    let refusal = |old: &[ParamValue], new: &[ParamValue]| {
        let setup = NodeSetup { node_id: "n", params: new, graph_dir: Path::new("."), batch: false, wiring: None };
        validator.refusal(&setup, old)
    };
    let good = values(10, 100, "");
    assert_eq!(refusal(&good, &values(20, 100, "")), None);
    let told = refusal(&good, &values(110, 100, "")).expect("out of order");
    assert_eq!(
        told,
        "`small_penalty` is 110, not below `large_penalty`, which is 100; lower `small_penalty` or raise `large_penalty`"
    );
    // What was wrong before does not hinder another change.
    assert_eq!(refusal(&values(10, 100, "m.jpg"), &values(20, 100, "m.jpg")), None);
}

#[test]
fn a_file_per_port_is_a_file_of_its_own() {
    let graph = |second: &str| {
        format!(
            "plugins = [\"phantom\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.a]\ntype = \"write_video\"\n\
             inputs = {{ image = \"scope.left\" }}\nparams = {{ path = \"out/{{port}}.x\" }}\n[nodes.b]\n{second}\n\
             params = {{ path = \"out/{{port}}.x\" }}\n"
        )
    };
    let other = graph("type = \"write_images\"\ninputs = { images = \"scope.left\" }");
    let same = graph("type = \"write_video\"\ninputs = { image = \"scope.right\" }");
    let (found, diagnostics) = run(&other, &[], &common::catalog());
    assert!(found.is_some() && diagnostics.is_empty(), "{}", diagnostics.render(false));
    let (found, diagnostics) = run(&same, &[], &common::catalog());
    assert!(found.is_none());
    assert!(diagnostics.render(false).contains("are one file, out/image.x"), "{}", diagnostics.render(false));
}

#[test]
fn one_file_is_known_by_any_of_its_names() {
    let here = std::env::current_dir().expect("a folder");
    let text = format!(
        "plugins = [\"phantom\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.a]\ntype = \"write_video\"\n\
         inputs = {{ image = \"scope.left\" }}\nparams = {{ path = \"view.mkv\" }}\n[nodes.b]\ntype = \"write_video\"\n\
         inputs = {{ image = \"scope.left\" }}\nparams = {{ path = \"{}/folder/view.mkv\" }}\n",
        here.display()
    );
    let (_, diagnostics) = run(&text, &[], &common::catalog());
    let told: Vec<_> = diagnostics.iter().map(|d| (d.code, d.line, d.notes.len())).collect();
    assert_eq!(told, [("written-twice", 11, 1)], "{}", diagnostics.render(false));
    // A name of the command line has its place there.
    let (_, diagnostics) = run(&text, &["b.path=./view.mkv"], &common::catalog());
    let told: Vec<_> = diagnostics.iter().map(|d| (d.code, d.file.as_str())).collect();
    assert_eq!(told, [("written-twice", "command line")]);
    assert!(run(&text, &["b.path=other.mkv"], &common::catalog()).0.is_some());
}

#[test]
fn pictures_that_are_read_and_written_in_one_folder_are_warned_of() {
    let mut catalog = common::catalog();
    let capture = catalog.node_types.iter_mut().find(|t| t.name == "capture").expect("a node type");
    capture.params[0].pick = Pick::File;
    let graph = |source: &str| {
        format!(
            "plugins = [\"capture\", \"sinks\"]\n[nodes.cam]\ntype = \"capture\"\nparams = {{ source = \"{source}\" }}\n\
             [nodes.out]\ntype = \"write_images\"\ninputs = {{ images = \"cam.left\" }}\nparams = {{ path = \"shots/{{seq}}.png\" }}\n"
        )
    };
    for source in ["shots/*.png", "other.png; ../folder/shots/img_%d.png"] {
        let (found, diagnostics) = run(&graph(source), &[], &catalog);
        let told: Vec<_> = diagnostics.iter().map(|d| (d.code, d.severity)).collect();
        assert!(found.is_some());
        assert_eq!(told, [("read-while-written", Severity::Warning)], "{source}");
    }
    for source in ["shots/*.jpg", "pictures/*.png", "0"] {
        assert!(run(&graph(source), &[], &catalog).1.is_empty(), "{source}");
    }
}

#[test]
fn a_default_that_ships_is_found_beside_its_plugin() {
    let folder = std::env::temp_dir().join(format!("panoscope_shipped_{}", std::process::id()));
    std::fs::create_dir_all(folder.join("tools/models")).expect("a folder");
    let mut catalog = common::catalog();
    let yolo = catalog.node_types.iter_mut().find(|t| t.name == "yolo").expect("a node type");
    yolo.shipped_dir = folder.join("tools");
    yolo.params[0].shipped = true;
    yolo.params[0].kind = ParamKind::Path { default: "models/m.onnx".to_owned(), must_exist: true };
    let text = "plugins = [\"phantom\", \"tools\", \"sinks\"]\n[nodes.scope]\ntype = \"phantom\"\n[nodes.find]\ntype = \"yolo\"\n\
                inputs = { image = \"scope.left\" }\n[nodes.out]\ntype = \"preview\"\ninputs = { packet = \"find.detections\" }\n";
    let (found, diagnostics) = run(text, &[], &catalog);
    let rendered = diagnostics.render(false);
    assert!(found.is_none() && rendered.contains("it comes with plugin `tools`, as"), "{rendered}");
    let model = folder.join("tools/models/m.onnx");
    std::fs::write(&model, b"").expect("a file");
    let (found, diagnostics) = run(text, &[], &catalog);
    let found = found.unwrap_or_else(|| panic!("{}", diagnostics.render(false)));
    assert_eq!(found.nodes[1].params[0], ParamValue::Path(model));
    // What a graph names itself stays relative to the graph.
    let named = text.replace("[nodes.out]", "params = { model = \"models/m.onnx\" }\n[nodes.out]");
    assert!(run(&named, &[], &catalog).1.render(false).contains("missing-file"));
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn an_unreadable_line_makes_no_node_answer_for_it() {
    let broken = PENALTIES.replace("[nodes.out]", "params = { small_penalty = 115 }\ncpu = oops\n[nodes.out]");
    let (_, diagnostics) = run(&broken, &[], &common::catalog());
    let codes: Vec<_> = diagnostics.iter().map(|d| d.code).collect();
    assert_eq!(codes, ["toml-syntax"], "{}", diagnostics.render(false));
}
