//! The first minutes of a new user: templates, added nodes, a save that would lose another program's text.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::{Folder, GRAPH, PATIENCE, Window, has_plugin};
use eframe::egui::{Key, Modifiers, Rect};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::templates;
use panoscope_engine::{Engine, Options, Outcome};
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::{self as loader, Loader};

const NONE: Modifiers = Modifiers::NONE;
const CTRL: Modifiers = Modifiers::COMMAND;

/// Runs a graph text for a few frames; every node takes part and none fails.
fn runs(name: &str, path: &Path, text: &str, frames: u64) {
    let parsed = GraphText::parse(path, text);
    let loader = Loader::search(&loader::search_path(&[]));
    let catalog = loader.catalog(&parsed.plugins());
    let (graph, warnings) =
        check(&parsed, &catalog).into_result().unwrap_or_else(|m| panic!("{name}: {}", m.render(false)));
    assert!(warnings.is_empty(), "{name}: {}", warnings.render(false));
    let graph_dir = path.parent().expect("a folder").to_owned();
    let options = Options { frames: Some(frames), paced: false, graph_dir, ..Options::default() };
    let engine = Engine::start(graph, &catalog, &loader, options).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert!(engine.wait(Some(Duration::from_secs(120))), "{name} does not end: {:?}", engine.recent_log());
    assert_eq!(engine.close(Duration::from_secs(30)), Outcome::Done, "{name}");
    for (node, counts) in engine.report().nodes {
        assert!(
            counts.count > 0 && counts.faults == 0,
            "{name}: `{node}` made {}, {} faults",
            counts.count,
            counts.faults
        );
    }
}

#[test]
fn every_template_is_valid_and_runs() {
    for plugin in ["phantom", "stitch", "stereo", "overlay", "sinks", "capture"] {
        if !has_plugin(plugin) {
            return;
        }
    }
    let folder = Folder::new("templates");
    let mut count = 0;
    for (name, text) in templates() {
        let first = text.lines().next().unwrap_or_default();
        assert!(first.trim_start_matches('#').trim().len() > 10, "{name} does not open with what it shows: {first:?}");
        let path = folder.0.join("g.toml");
        match name {
            "Empty" => {
                // There is nothing to run and no mistake.
                let mut window = Window::open(&folder.write("empty.toml", text));
                window.steps(3);
                let view = window.app().document().view().clone();
                assert!(view.diagnostics.is_empty(), "{:?}", view.diagnostics);
                window.until_shown("State: no nodes yet");
                assert!(window.harness.query_by_label("Problems").is_some(), "no problem is counted");
            }
            // Images in place of cameras.
            "Two cameras" => {
                let mut files = text.to_owned();
                for (side, device) in [("left", "0"), ("right", "2")] {
                    for k in 0..3 {
                        let file = folder.0.join(format!("{side}_{k}.png"));
                        image::RgbImage::new(64, 48).save(file).expect("a picture");
                    }
                    let before = files.clone();
                    files = files.replace(&format!("{side} = \"{device}\""), &format!("{side} = \"{side}_?.png\""));
                    assert_ne!(before, files, "{name} names a {side} camera");
                }
                check_only(name, &path, text);
                runs(name, &path, &files, 3);
            }
            _ => runs(name, &path, text, 2),
        }
        count += 1;
    }
    assert_eq!(count, 4);
}

/// Checks that the template's text has no mistakes.
fn check_only(name: &str, path: &Path, text: &str) {
    let parsed = GraphText::parse(path, text);
    let catalog = Loader::search(&loader::search_path(&[])).catalog(&parsed.plugins());
    let checked = check(&parsed, &catalog);
    assert!(checked.graph.is_some(), "{name}: {}", checked.diagnostics.render(false));
}

/// Rectangles of all nodes, in the window's points.
fn rects(window: &Window) -> Vec<(String, Rect)> {
    let nodes = window.app().document().view().nodes.clone();
    nodes.iter().map(|n| (n.id().to_owned(), window.harness.get_by_label(&format!("Node {}", n.id())).rect())).collect()
}

fn none_overlaps(window: &Window, what: &str) {
    let all = rects(window);
    for (k, (a, first)) in all.iter().enumerate() {
        for (b, second) in &all[..k] {
            let overlap = first.shrink(1.0).intersect(second.shrink(1.0));
            assert!(!overlap.is_positive(), "{what}: {a} at {first:?} lies on {b} at {second:?}");
        }
    }
}

#[test]
fn nodes_added_by_key_overlap_no_other() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("add");
    // One file without positions, and one where some nodes have them.
    let partly = format!("{GRAPH}\n[editor]\na = {{ x = 0, y = 0 }}\nsink = {{ x = 240, y = 8 }}\n");
    for (name, text) in [("free.toml", GRAPH.to_owned()), ("partly.toml", partly)] {
        let mut window = Window::open(&folder.write(name, &text));
        window.steps(3);
        let before = rects(&window).len();
        none_overlaps(&window, name);
        for k in 0..10 {
            let node_type = if k % 2 == 0 { "pass" } else { "frames" };
            window.key(NONE, Key::A);
            window.type_text(node_type);
            let row = format!("Pick {node_type}");
            let until = Instant::now() + PATIENCE;
            while window.harness.query_by_label(&row).is_none() {
                assert!(Instant::now() < until, "`{row}` is not offered");
                window.steps(1);
            }
            window.key(NONE, Key::Enter);
            window.steps(3);
            none_overlaps(&window, &format!("{name}, node {k}"));
        }
        assert_eq!(rects(&window).len(), before + 10);
        // One undo removes a node with its position.
        window.key(CTRL, Key::Z);
        assert_eq!(window.app().document().view().nodes.len(), before + 9);
        (0..9).for_each(|_| window.key(CTRL, Key::Z));
        assert_eq!(**window.app().document().text(), *text);
    }
}

#[test]
fn copies_overlap_no_other_node() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("copies");
    let mut window = Window::open(&folder.write("g.toml", GRAPH));
    window.steps(3);
    window.select("mean");
    for k in 0..4 {
        window.key(CTRL, Key::D);
        window.steps(2);
        none_overlaps(&window, &format!("copy {k}"));
    }
}

#[test]
fn a_save_during_a_conflict_says_what_to_do() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("refused_save");
    let path = folder.write("g.toml", GRAPH);
    let mut window = Window::run(&path);
    window.select("sink");
    window.key(NONE, Key::Delete);
    window.settled();
    let theirs = GRAPH.replace("Two paths", "Theirs");
    std::fs::write(&path, &theirs).expect("written");
    // Before the change was noticed, and again after it.
    for _ in 0..2 {
        window.key(CTRL, Key::S);
        window.steps(2);
        assert_eq!(std::fs::read_to_string(&path).expect("read"), theirs, "nothing is written over");
        for words in
            ["Not saved.", "Choose which text to keep", "Take the file's", "Keep this one", "choose in the bar above"]
        {
            assert!(window.harness.query_by_label_contains(words).is_some(), "`{words}` is not on the screen");
        }
        window.until_shown("Take the file's");
    }
    let ours = window.app().document().text().to_string();
    window.harness.get_by_label("Keep this one").click();
    window.steps(3);
    assert!(window.harness.query_by_label_contains("Not saved.").is_none());
    window.key(CTRL, Key::S);
    window.steps(2);
    assert_eq!(std::fs::read_to_string(&path).expect("read"), ours);
    assert_eq!(std::fs::read_to_string(folder.0.join("g.toml.bak")).expect("read"), theirs, "theirs is kept beside");
}
