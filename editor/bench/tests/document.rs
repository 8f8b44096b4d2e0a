//! Edits of the text, without a window and without a run.

use std::sync::Arc;

use crate::common::{GRAPH, has_plugin};
use panoscope_editor_model::document::Document;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::ops::{self, PendingWire};
use panoscope_editor_model::{Mark, copying};
use panoscope_host::loader::{self as loader, Loader};

fn document(text: &str) -> Option<Document> {
    let loader = Arc::new(Loader::search(&loader::search_path(&[])));
    has_plugin("flow").then(|| Document::new("g.toml".as_ref(), text, loader))
}

/// Asserts that the document is valid and that undoing everything restores the first text byte for byte.
fn valid_and_undone(mut doc: Document, first: &str) {
    assert!(doc.view().valid, "{:#?}\n{}", doc.view().diagnostics, doc.text());
    while doc.undo().is_some() {}
    assert_eq!(**doc.text(), *first);
}

#[test]
fn changes_of_one_slider_are_one_step() {
    let Some(mut doc) = document(GRAPH) else { return };
    for value in [10, 20, 30] {
        ops::set_param(&mut doc, "mean", "past_weight", Some(&value.into())).expect("set");
    }
    assert_eq!(doc.steps(), 1);
    doc.end_merge();
    ops::set_param(&mut doc, "mean", "past_weight", Some(&40.into())).expect("set");
    assert_eq!(doc.steps(), 2);
    doc.undo();
    assert_eq!(**doc.text(), GRAPH.replace("past_weight = 100", "past_weight = 30"));
    let view = doc.view().clone();
    assert!(doc.differs_from_file(&view.nodes[view.node("mean").expect("a node")], "past_weight"));
    valid_and_undone(doc, GRAPH);
}

#[test]
fn resetting_a_parameter_removes_it_from_the_file() {
    let Some(mut doc) = document(GRAPH) else { return };
    ops::set_param(&mut doc, "mean", "past_weight", None).expect("unset");
    assert!(!doc.text().contains("past_weight"), "{}", doc.text());
    valid_and_undone(doc, GRAPH);
}

#[test]
fn a_list_gets_another_wire_and_loses_one() {
    let Some(mut doc) = document(GRAPH) else { return };
    ops::wire(&mut doc, &Output::new("mean", "image"), ("kept", "images"), None, None).expect("wired");
    assert!(doc.text().contains(r#"images = [{ from = "a.image", queue = 64 }, "mean.image"]"#), "{}", doc.text());
    ops::unwire(&mut doc, "kept", "images", 0).expect("unwired");
    assert!(doc.text().contains(r#"images = ["mean.image"]"#), "{}", doc.text());
    valid_and_undone(doc, GRAPH);
}

#[test]
fn rewiring_keeps_the_other_keys_of_an_input() {
    let text = GRAPH.replace("\"mean.image\"", "{ from = \"mean.image\", queue = 8 }");
    let Some(mut doc) = document(&text) else { return };
    ops::wire(&mut doc, &Output::new("b", "image"), ("sink", "image"), None, None).expect("wired");
    assert!(doc.text().contains(r#"{ from = "b.image", queue = 8 }"#), "{}", doc.text());
    valid_and_undone(doc, &text);
}

#[test]
fn a_node_is_inserted_into_a_wire() {
    let Some(mut doc) = document(GRAPH) else { return };
    let pass = doc.catalog().node_types.iter().find(|t| t.name == "pass").cloned().expect("a type");
    let id = ops::add(&mut doc, "", &pass, Some((8.0, 16.0)), None).expect("added");
    assert!(!doc.view().valid, "it waits for its wire");
    ops::insert(&mut doc, &id, ("sink", "image", 0)).expect("inserted");
    let view = doc.view().clone();
    let (node, sink) = (view.node(&id).expect("a node"), view.node("sink").expect("a node"));
    assert_eq!(view.nodes[view.wires_into(node, "image").next().expect("a wire").from].id(), "mean");
    assert_eq!(view.wires_into(sink, "image").next().expect("a wire").from, node);
    assert_eq!(view.nodes[node].position, Some((8.0, 16.0)));
    valid_and_undone(doc, GRAPH);
}

#[test]
fn a_node_is_added_with_its_wire_in_one_step() {
    let Some(mut doc) = document(GRAPH) else { return };
    let types = doc.catalog().clone();
    let drain = types.node_types.iter().find(|t| t.name == "drain").expect("a type");
    let pending = PendingWire::Output(Output::new("mean", "image"));
    let id = ops::add(&mut doc, "", drain, Some((0.0, 0.0)), Some(&pending)).expect("added");
    assert_eq!((id.as_str(), doc.steps()), ("drain", 1));
    let smooth = types.node_types.iter().find(|t| t.name == "smooth").expect("a type");
    assert_eq!(
        ops::fitting_port(doc.view(), smooth, &PendingWire::Input("sink".into(), "image".into())).as_deref(),
        Some("image")
    );
    valid_and_undone(doc, GRAPH);
}

#[test]
fn copies_are_wired_among_themselves() {
    let Some(mut doc) = document(GRAPH) else { return };
    let nodes = ["mean", "sink"].map(|id| (id.to_owned(), Some((0.0, 0.0))));
    let copies = ops::duplicate(&mut doc, &nodes).expect("copied");
    assert_eq!(copies, ["mean_2", "sink_2"]);
    let again = ops::duplicate(&mut doc, &[("mean_2".to_owned(), Some((0.0, 0.0)))]).expect("copied");
    assert_eq!(again, ["mean_3"]);
    let view = doc.view();
    let from = |id: &str| {
        view.nodes[view.wires_into(view.node(id).expect("it is there"), "image").next().expect("a wire").from].id()
    };
    assert_eq!((from("mean_2"), from("sink_2"), from("mean_3")), ("b", "mean_2", "b"));
    assert!(doc.text().contains("past_weight = 100"), "{}", doc.text());
    valid_and_undone(doc, GRAPH);
}

#[test]
fn removal_includes_wires_and_renaming_applies_everywhere() {
    let Some(mut doc) = document(GRAPH) else { return };
    ops::rename(&mut doc, "mean", "average").expect("renamed");
    assert!(doc.text().contains("inputs = { image = \"average.image\" }"), "{}", doc.text());
    assert!(ops::rename(&mut doc, "average", "sink").is_err());
    ops::remove(&mut doc, &["average".to_owned(), "sink".to_owned()]).expect("removed");
    assert_eq!(doc.view().nodes.len(), 3);
    valid_and_undone(doc, GRAPH);
}

#[test]
fn loops_and_wrong_types_are_refused_with_a_reason() {
    let Some(doc) =
        document(&GRAPH.replace(
            "[nodes.sink]",
            "[nodes.more]\ntype = \"pass\"\ninputs = { image = \"mean.image\" }\n\n[nodes.sink]",
        ))
    else {
        return;
    };
    let view = doc.view();
    let at = |id: &str| view.node(id).expect("a node");
    let why = view.check_wire(at("more"), "image", at("mean"), "image").expect_err("a loop");
    assert!(why.to_string().contains("loop"), "{why}");
    assert!(view.check_wire(at("a"), "image", at("mean"), "image").is_ok());
    assert!(view.check_wire(at("a"), "nothing", at("mean"), "image").is_err());
}

#[test]
fn nodes_are_copied_into_another_graph_as_text() {
    let Some(doc) = document(GRAPH) else { return };
    let text = ops::copy(&doc, &["b".to_owned(), "mean".to_owned()]).expect("copied");
    assert!(text.starts_with("plugins = [\"flow\"]"), "{text}");
    let Some(mut other) = document("# Empty.\n") else { return };
    assert_eq!(ops::paste(&mut other, &text, Some((0.0, 0.0))).expect("pasted"), ["b", "mean"]);
    assert_eq!(ops::paste(&mut other, &text, None).expect("pasted"), ["b_2", "mean_2"]);
    assert!(other.text().contains("inputs = { image = \"b_2.image\" }"), "{}", other.text());
    valid_and_undone(other, "# Empty.\n");
    let Some(mut doc) = document(GRAPH) else { return };
    assert!(ops::paste(&mut doc, "no graph at all", None).is_err());
    assert_eq!(**doc.text(), *GRAPH);
}

#[test]
fn frames_and_notes_are_stored_in_the_file_and_comments_stay() {
    let Some(mut doc) = document(GRAPH) else { return };
    let marks = [
        Mark { text: "Two \"paths\"".to_owned(), at: (8.0, -16.0), size: Some((400.0, 240.0)) },
        Mark { text: "look\nhere".to_owned(), at: (0.0, 64.0), size: None },
    ];
    ops::set_marks(&mut doc, &marks, &[("a".to_owned(), (16.0, 24.0))]).expect("it can be edited");
    assert_eq!(doc.view().marks, marks);
    assert!(doc.text().starts_with(GRAPH.trim_end()), "{}", doc.text());
    ops::set_marks(&mut doc, &marks[1..], &[]).expect("it can be edited");
    assert_eq!(doc.view().marks, marks[1..]);
    valid_and_undone(doc, GRAPH);
}

#[test]
fn a_parameter_of_a_part_is_written_into_the_parts_file() {
    let folder = std::env::temp_dir().join(format!("panoscope-document-part-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let part = "[part]\nparams = { outer = \"b.outer\" }\n[nodes.b]\ntype = \"x\"\nparams = { inner = 1, outer = 1 }\n";
    std::fs::write(folder.join("part.toml"), part).expect("written");
    let root = "[args.depth]\ntype = \"whole\"\ndefault = 4\n[nodes.a]\ngraph = \"part.toml\"\nparams = { outer = 2 }\n\
                [nodes.c]\ntype = \"y\"\nparams = { depth = { arg = \"depth\" } }\n";
    let mut doc = Document::new(&folder.join("g.toml"), root, Arc::new(Loader::default()));
    let ids: Vec<&str> = doc.view().nodes.iter().map(|n| n.id()).collect();
    assert_eq!(ids, ["a", "c"], "a part is one node until it is opened");
    ops::set_param(&mut doc, "a/b", "inner", Some(&7.into())).expect("set");
    assert!(doc.is_changed() && **doc.text() == *root);
    let changed: Vec<_> =
        doc.changed_files().into_iter().map(|(path, text, _)| (path.to_owned(), text.to_string())).collect();
    assert_eq!(changed, [(folder.join("part.toml"), part.replace("inner = 1", "inner = 7"))]);
    assert_eq!(
        doc.view().flat().nodes[0].outline.params["inner"].as_integer(),
        Some(7),
        "the window shows what is not saved yet"
    );
    ops::set_param(&mut doc, "a/b", "outer", Some(&9.into())).expect("set");
    ops::set_param(&mut doc, "c", "depth", Some(&5.into())).expect("set");
    assert_eq!(**doc.text(), root.replace("outer = 2", "outer = 9").replace("default = 4", "default = 5"));
    for _ in 0..3 {
        doc.undo();
    }
    assert!(!doc.is_changed() && doc.changed_files().is_empty() && **doc.text() == *root);
    doc.redo();
    doc.file_now_saved(&folder.join("part.toml"));
    assert!(!doc.is_changed(), "the only change is saved");
    doc.undo();
    assert!(doc.is_changed(), "undo after a save brings the old text back");
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_copy_takes_parts_and_unsaved_changes_along() {
    let part = "[part]\n[nodes.b]\ntype = \"x\"\nparams = { inner = 1 }\n";
    let text =
        "[nodes.a]\ngraph = \"parts/part.toml\"\n[nodes.c]\ntype = \"y\"\nparams = { path = \"../out/c.mkv\" }\n";
    let root = std::env::temp_dir().join(format!("panoscope_copying_{}", std::process::id()));
    let graphs = root.join("graphs");
    std::fs::create_dir_all(graphs.join("parts")).expect("a folder");
    std::fs::write(graphs.join("wide.toml"), text).expect("a file");
    std::fs::write(graphs.join("parts/part.toml"), part).expect("a file");
    let graph = graphs.join("wide.toml");
    assert_eq!(copying::destination(&graph), None, "it belongs to no installation");
    std::fs::write(root.join(panoscope_graph::installed::MARKER), "").expect("a file");
    let copy = copying::destination(&graph).expect("a destination");
    assert!(copy.ends_with("wide/wide.toml") && !copy.starts_with(&root), "{}", copy.display());

    let mut document = Document::new(&graph, text, Arc::new(Loader::default()));
    ops::set_param(&mut document, "a/b", "inner", Some(&7.into())).expect("set");
    let copy = root.join("mine/wide/wide.toml");
    copying::save_as(&mut document, &copy).expect("saved");
    assert_eq!(std::fs::read_to_string(&copy).expect("a file"), text);
    let copied = root.join("mine/wide/parts/part.toml");
    assert_eq!(std::fs::read_to_string(&copied).expect("a file"), part.replace("inner = 1", "inner = 7"));
    assert_eq!(std::fs::read_to_string(graphs.join("parts/part.toml")).expect("a file"), part);
    assert_eq!(document.path(), copy);
    assert!(!document.is_changed());

    // Undo and the next change are of the copy.
    document.undo();
    let changed: Vec<_> =
        document.changed_files().into_iter().map(|(path, text, _)| (path.to_owned(), text.to_string())).collect();
    assert_eq!(changed, [(copied, part.to_owned())]);
    assert_eq!(document.view().flat().nodes[0].outline.params["inner"].as_integer(), Some(1));
    std::fs::remove_dir_all(root).expect("removed");
}
