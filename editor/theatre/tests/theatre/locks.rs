//! Graphs that are locked, differ from their lock, or were never locked.

use std::path::Path;

use crate::common::window::{GRAPH, Window, options};
use crate::common::{Folder, has_plugin, input};
use eframe::egui::{Key, Ui, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use panoscope_editor_widgets::Shot;
use panoscope_host::loader::lock::{ALWAYS_LOCKED, Lock};
use panoscope_theatre::{OpenError, OpenFailed, Options, Ready, Theatre, Verified};

fn lock(path: &Path) {
    use panoscope_graph::{GraphText, check};
    use panoscope_host::loader::{self as loader, Loader};
    let loader = Loader::search(&loader::search_path(&[]));
    let text = GraphText::load(path).expect("it is there");
    let catalog = loader.catalog(&text.plugins());
    let (graph, _) = check(&text, &catalog).into_result().expect("it is right");
    let lock = Lock::of(&graph, &catalog, &loader, &text, &ALWAYS_LOCKED);
    assert!(lock.files.iter().all(|f| !f.sha256.is_empty()), "{lock:?}");
    lock.write(path).expect("it is written");
}

#[test]
fn a_locked_graph_opens_only_unchanged_or_with_unlocked() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("locked");
    let path = folder.write("g.toml", GRAPH);
    lock(&path);
    let open = |unlocked, text: &str| {
        let context = eframe::egui::Context::default();
        Theatre::open(&context, &path, text, Options { unlocked, ..options(&folder) }).map(drop)
    };
    open(false, GRAPH).expect("as it was locked");
    let other = GRAPH.replace("rate_hz = 30.0", "rate_hz = 25.0");
    match open(false, &other) {
        Err(OpenError::Locked(differences)) => {
            let message: Vec<String> = differences.iter().map(ToString::to_string).collect();
            assert_eq!(message, ["graph `g.toml` has changed since the graph was locked"]);
        }
        other => panic!("{other:?}"),
    }
    std::fs::write(&path, &other).expect("written");
    let options = Options { unlocked: true, ..options(&folder) };
    let mut window = Window::open_with(folder, &path, options);
    window.until_notice("Runs although it differs from its lock: graph `g.toml`");
}

#[test]
fn a_graph_without_lock_is_marked_for_as_long_as_it_runs() {
    if !has_plugin("flow") {
        return;
    }
    let message = "Not locked: this graph was not verified";
    let mut window = Window::open("never_locked", GRAPH);
    assert_eq!(*window.theatre().verified(), Verified::Never);
    window.until("a picture is there", Theatre::has_picture);
    let pictures = window.harness.get_by_label_contains("View Calm view").rect();
    let chip = window.harness.get_by_label(message).rect();
    assert!(chip.height() >= 34.0 && chip.bottom() <= pictures.top(), "{chip:?} above {pictures:?}");
    // It stays whatever else is shown.
    for key in [Key::F, Key::S, Key::R, Key::Space] {
        window.key(key);
        assert!(window.harness.query_by_label(message).is_some(), "after {key:?}");
    }
    drop(window);
    let folder = Folder::new("is_locked");
    let path = folder.write("g.toml", GRAPH);
    lock(&path);
    let options = options(&folder);
    let mut window = Window::open_with(folder, &path, options);
    window.until("a picture is there", Theatre::has_picture);
    assert_eq!(*window.theatre().verified(), Verified::AsLocked);
    assert!(window.harness.query_by_label_contains("not verified").is_none());
    assert!(window.harness.query_by_label_contains("ocked:").is_none());
}

#[test]
fn a_difference_from_the_lock_is_shown_in_the_window() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("refused");
    let path = folder.write("g.toml", GRAPH);
    lock(&path);
    let other = GRAPH.replace("rate_hz = 30.0", "rate_hz = 25.0");
    let error = Ready::check(&path, &other, &options(&folder)).err().expect("it differs");
    let draw = {
        let path = path.clone();
        move |ui: &mut Ui, refused: &mut Option<OpenFailed>| {
            refused.get_or_insert_with(|| OpenFailed::new(ui.ctx(), &path, &error, Shot::default())).ui(ui);
        }
    };
    let mut harness = Harness::builder().with_size(vec2(1440.0, 960.0)).build_ui_state(draw, None);
    input::steps(&mut harness, 3);
    for message in [
        "g.toml differs from its lock",
        "graph `g.toml` has changed since the graph was locked",
        "Restore the changed files",
        "panoscope lock ",
        "--unlocked",
    ] {
        let place = harness.get_by_label_contains(message).rect();
        assert!(harness.ctx.viewport_rect().contains_rect(place), "`{message}` at {place:?}");
    }
    assert!(!harness.state().as_ref().expect("it is shown").is_closing());
    harness.key_press_modifiers(eframe::egui::Modifiers::NONE, Key::Escape);
    input::steps(&mut harness, 2);
    assert!(harness.state().as_ref().expect("it is shown").is_closing());
}
