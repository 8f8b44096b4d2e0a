//! Parts: shown folded and opened, edited in their files, made of a selection and dissolved.

use crate::common;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::common::{Folder, Window, has_plugin, nothing_lost};
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::document::Document;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::ops;
use panoscope_engine::{Engine, Options};
use panoscope_graph::edit::EditError;
use panoscope_graph::{GraphOptions, GraphText, check};
use panoscope_host::loader::{self as loader, Loader};

const NONE: Modifiers = Modifiers::NONE;
const CTRL: Modifiers = Modifiers::COMMAND;

/// Averages, then a copy.
const CALM: &str = r#"# Calm pictures.
plugins = ["flow"]

[part]
inputs = { image = "mean.image" }
outputs = { image = "copy.image" }
params = { weight = "mean.past_weight" }

# Averages.
[nodes.mean]
type = "smooth"
params = { past_weight = 100 } # of 256

[nodes.copy]
type = "pass"
inputs = { image = "mean.image" }
"#;

/// One path that nobody touches, and one through a part.
const GRAPH: &str = r#"# Two paths.
name = "two"
mode = "live"
plugins = ["flow", "fixtures"]   # small nodes

[nodes.a]            # the path that nobody touches
type = "frames"
params = { width_px = 16, height_px = 16, rate_hz = 50.0 }

[nodes.kept]
type = "ledger"
inputs = { images = [{ from = "a.image", queue = 64 }] }
params = { path = "kept.jsonl" }

[nodes.b]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 50.0 }

[nodes.calm]
graph = "parts/calm.toml"
inputs = { image = "b.image" }

[nodes.sink]
type = "drain"
inputs = { image = "calm.image" }
params = { digest = true }

[preset]
pinned = [{ param = "calm.weight", range = [50, 150] }]
"#;

fn write(folder: &Folder) -> (PathBuf, PathBuf) {
    std::fs::create_dir_all(folder.0.join("parts")).expect("a folder");
    let part = folder.write("parts/calm.toml", CALM);
    (folder.write("g.toml", GRAPH), part)
}

fn open(path: &Path) -> Document {
    let text = std::fs::read_to_string(path).expect("the graph is there");
    Document::new(path, &text, Arc::new(Loader::search(&loader::search_path(&[]))))
}

fn ids(doc: &Document) -> Vec<String> {
    doc.view().nodes.iter().map(|n| n.id().to_owned()).collect()
}

fn wires(doc: &Document) -> Vec<String> {
    let view = doc.view();
    let wire = |w: &panoscope_editor_model::graph_view::Wire| {
        format!("{}.{} -> {}.{}", view.nodes[w.from].id(), w.output, view.nodes[w.to].id(), w.input)
    };
    view.wires.iter().map(wire).collect()
}

#[test]
fn a_part_is_one_node_until_it_is_opened() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("part_view");
    let (path, _) = write(&folder);
    let mut doc = open(&path);
    assert!(doc.view().valid, "{:?}", doc.view().diagnostics);
    assert_eq!(ids(&doc), ["a", "kept", "b", "calm", "sink"]);
    assert_eq!(wires(&doc), ["a.image -> kept.images", "b.image -> calm.image", "calm.image -> sink.image"]);
    let view = doc.view().clone();
    let calm = &view.nodes[view.node("calm").expect("a node")];
    let node_type = calm.node_type.as_ref().expect("made of the part");
    assert!(calm.is_part && node_type.doc == "Calm pictures.", "{node_type:?}");
    assert_eq!(node_type.inputs[0].packet.name, "image");
    assert!(!node_type.inputs[0].optional, "an input that the nodes inside need");
    let default = panoscope_editor_model::document::default_value(&node_type.params[0].kind);
    assert_eq!((node_type.params[0].name.as_str(), default), ("weight", 100.into()), "the value of the part's file");
    assert_eq!(view.running_output("calm", "image"), Output::new("calm/copy", "image"));
    // A loop through the part is seen, and nothing else is one.
    let at = |id: &str| view.node(id).expect("a node");
    assert!(view.check_wire(at("calm"), "image", at("calm"), "image").is_err());
    assert!(view.check_wire(at("a"), "image", at("calm"), "image").is_ok());

    let running = doc.runnable().clone();
    ops::set_open(&mut doc, "calm", true).expect("opened");
    assert_eq!(ids(&doc), ["a", "kept", "b", "calm/mean", "calm/copy", "sink"]);
    let inside = ["b.image -> calm/mean.image", "calm/mean.image -> calm/copy.image", "calm/copy.image -> sink.image"];
    assert_eq!(wires(&doc)[1..], inside);
    assert!(doc.view().part("calm").is_some_and(|p| p.open));
    assert!(doc.runnable().contains("[nodes.\"calm/mean\"]") && running.contains("[nodes.\"calm/mean\"]"));
    ops::move_nodes(&mut doc, &[("calm/mean".to_owned(), (24.0, 40.0)), ("calm".to_owned(), (8.0, 8.0))])
        .expect("moved");
    let opened = doc.text().clone();
    ops::set_open(&mut doc, "calm", false).expect("folded");
    assert_eq!(doc.view().nodes[3].position, Some((8.0, 8.0)));
    assert_ne!(*doc.text(), opened);
    ops::set_open(&mut doc, "calm", true).expect("opened");
    assert_eq!(*doc.text(), opened, "positions inside are kept while a part is folded");
    assert_eq!(doc.view().nodes[3].position, Some((24.0, 40.0)));
    while doc.undo().is_some() {}
    assert_eq!(**doc.text(), *GRAPH);
    ops::set_open(&mut doc, "calm", true).expect("opened");
    ops::set_open(&mut doc, "calm", false).expect("folded");
    assert_eq!(**doc.text(), *GRAPH, "open and fold leave no trace");
}

#[test]
fn edits_inside_a_part_go_to_its_file_and_undo_spans_files() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("part_edits");
    let (path, part) = write(&folder);
    let mut doc = open(&path);
    ops::set_open(&mut doc, "calm", true).expect("opened");
    let opened = doc.text().clone();
    let pass = doc.catalog().node_types.iter().find(|t| t.name == "pass").cloned().expect("a type");
    let id = ops::add(&mut doc, "calm", &pass, Some((8.0, 8.0)), None).expect("added");
    assert_eq!(id, "calm/pass");
    ops::insert(&mut doc, &id, ("calm/copy", "image", 0)).expect("inserted");
    assert!(doc.view().valid, "{:?}", doc.view().diagnostics);
    assert_eq!(ops::rename(&mut doc, &id, "again").expect("renamed"), "calm/again");
    let text = doc.file_text(&part).expect("the part").clone();
    assert_eq!(*text, CALM.replace("[nodes.copy]\ntype = \"pass\"\ninputs = { image = \"mean.image\" }\n", "[nodes.copy]\ntype = \"pass\"\ninputs = { image = \"again.image\" }\n\n[nodes.again]\ntype = \"pass\"\ninputs = { image = \"mean.image\" }\n"));
    assert!(doc.text().contains("\"calm/again\" = { x = 8.0, y = 8.0 }"), "{}", doc.text());
    // A wire out of the part adds an output to it.
    ops::wire(&mut doc, &Output::new("calm/mean", "image"), ("sink", "image"), None, None).expect("wired");
    assert!(
        doc.text().contains("inputs = { image = \"calm.image_2\" }")
            || doc.text().contains("inputs = { image = \"calm.mean_image\" }"),
        "{}",
        doc.text()
    );
    assert!(doc.view().valid, "{:?}", doc.view().diagnostics);
    // A copy stays in the part.
    let copies = ops::duplicate(&mut doc, &[("calm/mean".to_owned(), Some((0.0, 0.0)))]).expect("copied");
    assert_eq!(copies, ["calm/mean_2"]);
    ops::remove(&mut doc, &["calm/mean_2".to_owned(), "calm/copy".to_owned()]).expect("removed");
    assert!(!doc.file_text(&part).expect("the part").contains("copy"));
    for _ in 0..6 {
        doc.undo();
    }
    assert_eq!((doc.text(), &**doc.file_text(&part).expect("the part")), (&opened, CALM));
    assert!(doc.changed_files().is_empty());
    for _ in 0..6 {
        doc.redo();
    }
    assert_eq!(doc.changed_files().len(), 1);
}

#[test]
fn a_part_that_is_used_twice_changes_only_when_that_is_allowed() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("part_twice");
    let (_, part) = write(&folder);
    let twice = format!(
        "{GRAPH}\n[nodes.other]\ngraph = \"parts/calm.toml\"\ninputs = {{ image = \"a.image\" }}\n\n[nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"other.image\" }}\n"
    );
    let path = folder.write("g.toml", &twice);
    let mut doc = open(&path);
    let refused = ops::remove(&mut doc, &["calm/copy".to_owned()]).expect_err("two parts");
    let users = vec!["calm".to_owned(), "other".to_owned()];
    assert_eq!(refused, EditError::SharedPart { file: part.clone(), users });
    assert!(refused.to_string().contains("used 2 times in this graph (calm, other)"), "{refused}");
    assert!(!doc.is_changed());
    // The part's own entry in the graph is nobody else's.
    ops::set_param(&mut doc, "calm", "weight", Some(&30.into())).expect("set");
    assert!(doc.changed_files().is_empty() && doc.text().contains("params = { weight = 30 }"), "{}", doc.text());
    doc.allow_shared(&part);
    ops::set_param(&mut doc, "other/mean", "past_weight", Some(&40.into())).expect("set in the graph");
    let edges = ops::unwire(&mut doc, "calm/copy", "image", 0);
    edges.expect("allowed");
    assert_eq!(doc.changed_files().len(), 1);
    assert!(!doc.view().valid, "both lack the wire");
}

/// Digests of the frames that reach `sink`, from a batch run of the document.
fn digest(doc: &Document, folder: &Path) -> f64 {
    assert!(doc.view().valid, "{:?}", doc.view().diagnostics);
    let text = doc.runnable().replace("mode = \"live\"", "mode = \"batch\"");
    let parsed = GraphText::parse(&folder.join("g.toml"), &text);
    let loader = Loader::search(&loader::search_path(&[]));
    let catalog = loader.catalog(&parsed.plugins());
    let (graph, _) = check(&parsed, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
    let options = Options { frames: Some(40), paced: false, graph_dir: folder.to_owned(), ..Options::default() };
    let engine = Engine::start(graph, &catalog, &loader, options).expect("it starts");
    assert!(engine.wait(Some(Duration::from_secs(60))), "it ends");
    engine.close(Duration::from_secs(10));
    let sink = &engine.report().nodes["sink"];
    assert_eq!(sink.count, 40);
    sink.metrics["digest"]
}

#[test]
fn before_made_and_dissolved_give_the_same_bytes() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("part_bytes");
    let (path, _) = write(&folder);
    let mut doc = open(&path);
    let before = digest(&doc, &folder.0);
    let names = ops::dissolve(&mut doc, "calm").expect("dissolved");
    assert_eq!(names, ["mean", "copy"]);
    assert_eq!(digest(&doc, &folder.0), before);
    let flat = doc.text().clone();
    assert!(flat.contains("pinned = [{ param = \"mean.past_weight\", range = [50, 150] }]"), "{flat}");
    assert!(flat.contains("# Averages.\n[nodes.mean]") && flat.contains("# of 256"), "{flat}");
    ops::move_nodes(&mut doc, &[("copy".to_owned(), (100.0, 50.0)), ("mean".to_owned(), (40.0, 60.0))]).expect("moved");
    let id = ops::make_part(&mut doc, &["copy".to_owned(), "mean".to_owned()], "calmer").expect("made");
    assert_eq!(digest(&doc, &folder.0), before);
    assert_eq!(doc.view().nodes[doc.view().node(&id).expect("a node")].position, Some((40.0, 50.0)));
    ops::set_open(&mut doc, &id, true).expect("opened");
    assert_eq!(doc.view().nodes[doc.view().node("calmer/copy").expect("a node")].position, Some((60.0, 0.0)));
    ops::dissolve(&mut doc, &id).expect("dissolved");
    assert_eq!(digest(&doc, &folder.0), before);
    let places = ["copy", "mean"].map(|id| doc.view().nodes[doc.view().node(id).expect("a node")].position);
    assert_eq!(places, [Some((100.0, 50.0)), Some((40.0, 60.0))]);
    // Another value reaches the bytes, so the digests compare something.
    ops::set_param(&mut doc, "b", "width_px", Some(&32.into())).expect("set");
    assert_ne!(digest(&doc, &folder.0), before);
    // An existing file is not replaced by a new part.
    let taken = ops::make_part(&mut doc, &["mean".to_owned()], "calm").expect_err("the file exists");
    assert!(matches!(taken, EditError::FileExists { .. }), "{taken}");
}

#[test]
fn every_selection_makes_a_part_and_dissolves_to_the_same_graph() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("part_all");
    let (path, _) = write(&folder);
    let flattened = |doc: &Document| {
        let parsed = GraphText::parse_with(doc.path(), doc.runnable(), &GraphOptions::default());
        let mut nodes: Vec<String> = parsed
            .outline()
            .iter()
            .map(|n| format!("{} {} {:?} {:?}", n.id, n.type_name, n.inputs, n.params))
            .collect();
        nodes.sort();
        nodes
    };
    let first = ids(&open(&path));
    for chosen in 1u32..1 << first.len() {
        let nodes: Vec<String> =
            first.iter().enumerate().filter(|(k, _)| chosen >> k & 1 == 1).map(|(_, id)| id.clone()).collect();
        let mut doc = open(&path);
        let before = flattened(&doc);
        let id = ops::make_part(&mut doc, &nodes, "new").unwrap_or_else(|e| panic!("{nodes:?}: {e}"));
        assert!(doc.view().valid, "{nodes:?}: {:?}", doc.view().diagnostics);
        assert_eq!(flattened(&doc).len(), before.len());
        ops::set_open(&mut doc, &id, true).expect("opened");
        ops::dissolve(&mut doc, &id).expect("dissolved");
        assert_eq!(flattened(&doc), before, "{nodes:?}");
        assert_eq!(doc.changed_files().len(), 1, "the file of a dissolved part is saved");
        while doc.undo().is_some() {}
        assert!(!doc.is_changed());
    }
}

#[test]
fn a_part_is_opened_edited_and_saved_in_the_window() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("part_window");
    let (path, part) = write(&folder);
    let mut window = Window::run(&path);
    window.steps(3);
    window.select("calm");
    window.harness.get_by_label("Open calm").click_accesskit();
    window.until_shown("Node calm/mean");
    window.until_shown("Part calm");
    assert!(window.harness.query_by_label("Node calm").is_none());
    window.settled();
    let frame = window.harness.get_by_label("Part calm").rect();
    for node in ["calm/mean", "calm/copy"] {
        let rect = window.harness.get_by_label(&format!("Node {node}")).rect();
        assert!(
            frame.min.x < rect.min.x && rect.max.x < frame.max.x && frame.min.y < rect.min.y,
            "{node}: {rect:?} in {frame:?}"
        );
    }
    for node in ["a", "kept", "b", "sink"] {
        let rect = window.harness.get_by_label(&format!("Node {node}")).rect();
        let whole = frame.with_max_y(window.harness.get_by_label("Node calm/mean").rect().max.y);
        assert!(!whole.shrink(1.0).intersects(rect.shrink(1.0)), "{node}: {rect:?} outside {frame:?}");
    }
    window.select("calm/copy");
    window.key(NONE, Key::Delete);
    window.steps(2);
    assert!(window.app().document().changed_files().len() == 1);
    window.key(CTRL, Key::Z);
    window.settled();
    // A value of the part's file.
    window.select("calm/mean");
    // A key has no effect in a frame in which the panel moves.
    let until = std::time::Instant::now() + common::PATIENCE;
    while window.app().document().changed_files().is_empty() {
        assert!(std::time::Instant::now() < until, "the slider moves: {}", window.app().document().text());
        window.harness.get_by_role_and_label(eframe::egui::accesskit::Role::Slider, "past_weight").focus();
        window.steps(2);
        window.key(NONE, Key::ArrowRight);
    }
    window.settled();
    let changed = CALM.replace("past_weight = 100", "past_weight = 101");
    assert_eq!(**window.app().document().file_text(&part).expect("the part"), *changed);
    window.key(NONE, Key::Escape);
    window.key(CTRL, Key::S);
    assert_eq!(std::fs::read_to_string(&part).expect("read"), changed);
    let opened = format!("{GRAPH}\n[editor]\n\":open\" = [\"calm\"]\n");
    assert_eq!(std::fs::read_to_string(&path).expect("read"), opened);
    assert!(!window.app().document().is_changed());
    // E folds the part around the selected node.
    window.select("calm/mean");
    window.key(NONE, Key::E);
    window.until_shown("Node calm");
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_part_is_made_and_dissolved_while_it_runs() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("part_make");
    let (path, part) = write(&folder);
    let mut window = Window::run(&path);
    window.steps(3);
    window.select("calm");
    window.key(Modifiers::SHIFT, Key::K);
    window.until_shown("Node copy");
    window.settled();
    window.select("mean");
    window.key(Modifiers::SHIFT, Key::N);
    assert_eq!(window.app().canvas().selected.len(), 2);
    window.key(NONE, Key::K);
    window.until_shown("Name of the part");
    window.harness.get_by_label("Name of the part").focus();
    window.steps(1);
    window.key(CTRL, Key::A);
    window.harness.get_by_label("Name of the part").type_text("calmer");
    window.steps(2);
    window.harness.get_by_label("Make the part").click();
    window.until_shown("Node calmer");
    window.settled();
    let running = window.running();
    assert!(running.contains(&"calmer/mean".to_owned()) && !running.contains(&"mean".to_owned()), "{running:?}");
    let made = folder.0.join("parts/calmer.toml");
    assert!(!made.exists(), "nothing is written before it is saved");
    window.key(CTRL, Key::S);
    let text = std::fs::read_to_string(&made).expect("written");
    assert!(text.contains("[part]\n") && text.contains("# Averages.\n[nodes.mean]"), "{text}");
    assert_eq!(std::fs::read_to_string(&part).expect("read"), CALM, "the dissolved part's file stays");
    let saved = GraphText::load(&path).expect("read");
    let catalog = Loader::search(&loader::search_path(&[])).catalog(&saved.plugins());
    assert!(check(&saved, &catalog).graph.is_some());
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_part_that_is_used_twice_is_changed_after_a_question() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("part_question");
    let (_, part) = write(&folder);
    let twice = format!(
        "{GRAPH}\n[nodes.other]\ngraph = \"parts/calm.toml\"\ninputs = {{ image = \"a.image\" }}\n\n[nodes.end]\ntype = \"drain\"\ninputs = {{ image = \"other.image\" }}\n\n[editor]\n\":open\" = [\"calm\"]\n"
    );
    let mut window = Window::run(&folder.write("g.toml", &twice));
    window.steps(3);
    window.select("calm/copy");
    window.key(NONE, Key::Delete);
    window.until_shown("used 2 times in this graph");
    assert!(!window.app().document().is_changed(), "nothing changes before the answer");
    window.harness.get_by_label("Change all 2").click();
    window.steps(3);
    assert!(!window.app().document().file_text(&part).expect("the part").contains("copy"));
    assert_eq!(std::fs::read_to_string(&part).expect("read"), CALM);
    window.key(CTRL, Key::Z);
    window.steps(2);
    assert!(!window.app().document().is_changed());
}

#[test]
fn a_parts_file_that_changed_on_disk_is_read_again_or_asked_about() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("part_disk");
    let (path, part) = write(&folder);
    let mut window = Window::run(&path);
    window.steps(3);
    std::fs::write(&part, CALM.replace("past_weight = 100", "past_weight = 77")).expect("written");
    let weight = |app: &panoscope_editor::app::App| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.param_values("calm/mean").and_then(|v| v.first().cloned())
    };
    window.until("the part is read again", |app| weight(app) == Some(panoscope_graph::ParamValue::Int(77)));
    // Both changed: nothing is overwritten.
    window.select("calm");
    window.key(NONE, Key::E);
    window.until_shown("Node calm/copy");
    window.select("calm/copy");
    window.key(NONE, Key::Delete);
    window.steps(2);
    let theirs = CALM.replace("Calm pictures", "Theirs");
    std::fs::write(&part, &theirs).expect("written");
    window.key(CTRL, Key::S);
    window.until_shown("Take the file's");
    assert_eq!(std::fs::read_to_string(&part).expect("read"), theirs);
    assert_eq!(std::fs::read_to_string(&path).expect("read"), GRAPH, "no file is written while one is in conflict");
    window.harness.get_by_label("Keep this one").click();
    window.steps(3);
    window.key(CTRL, Key::S);
    assert!(!std::fs::read_to_string(&part).expect("read").contains("copy"));
    assert!(std::fs::read_to_string(&path).expect("read").contains(":open"));
}
