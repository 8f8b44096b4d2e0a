//! The editor on a graph that runs on another machine.

use crate::attachable::{Attachable, free_address};
use crate::common;
use crate::common::{Folder, GRAPH, Window, has_plugin};
use eframe::egui::{Key, Modifiers, Ui, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::{App, Options};
use panoscope_editor_model::observe::Output;
use panoscope_host::attach::{Attachment, Target};

const EDITOR: &str = env!("CARGO_BIN_EXE_panoscope-editor");

fn attachment(address: &str) -> Attachment {
    let target = Target::find(&format!("engine@{address}"), None).expect("a target");
    let attachment = Attachment::open(target).expect("a thread");
    assert!(attachment.wait_opened(common::PATIENCE), "{:?}", attachment.state());
    attachment
}

fn open(folder: &Folder, address: &str) -> Window {
    let mut given = Some(attachment(address));
    let path = folder.0.join("copy.toml");
    let draw = move |ui: &mut Ui, app: &mut Option<App>| {
        let open = || {
            let given = given.take().expect("it is opened once");
            App::attached(ui.ctx(), &path, given, Options::default()).expect("threads")
        };
        app.get_or_insert_with(open).ui(ui);
    };
    let textures = panoscope_editor_widgets::golden::Textures::default();
    let builder = Harness::builder().with_size(vec2(1440.0, 900.0)).renderer(textures.clone());
    Window { harness: builder.build_ui_state(draw, None), textures }
}

fn runs(app: &App) -> String {
    let machine = app.session().attachment().expect("it is attached");
    machine.state().opened.map(|opened| opened.text.clone()).unwrap_or_default()
}

#[test]
fn edits_are_made_there_and_conflicts_are_shown() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("attached_editor");
    let address = free_address();
    let allows = ["--allow-edit", "unnamed"];
    let Some(running) = Attachable::start(EDITOR, &folder.write("g.toml", GRAPH), &address, &allows) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let mut window = open(&folder, &address);
    window.until_shown("Runs on engine: this window edits it");
    window.until("a picture", |app| app.canvas().visible().next().is_some());
    // Values come from there, paths of ticks and sources do not.
    let output = Output::new("b", "image");
    window.select("b");
    window.until("values of a picture", |app| app.probe(&output).is_some_and(|p| p.size == (64, 48)));
    window.key(Modifiers::NONE, Key::D);
    window.until_shown("which sends no paths of ticks");
    window.key(Modifiers::NONE, Key::D);
    window.key(Modifiers::NONE, Key::X);
    window.until_shown("the source of nodes is on `engine`");
    // Deleted here, gone there.
    window.select("sink");
    window.key(Modifiers::NONE, Key::Delete);
    window.until("the change there", |app| !runs(app).contains("[nodes.sink]"));
    window.until("nothing is unsaved", |app| !app.document().is_changed());
    // Changed by another window, shown here.
    let other = attachment(&address);
    let base = other.state().opened.expect("a graph").text.clone();
    other.run(&base, &base.replace("past_weight = 100", "past_weight = 90"), || true).expect("it is allowed");
    window.until("the change of another window", |app| app.document().text().contains("past_weight = 90"));
    window.until_shown("was changed by a window on `unnamed`");
    // A mistake is shown as at home, and the graph there runs on.
    let before = runs(window.app());
    drop(running);
    window.until_shown("engine is not reached");
    assert_eq!(runs(window.app()), before, "what was known stays");
    let _running = Attachable::start(EDITOR, &folder.0.join("g.toml"), &address, &allows).expect("a program");
    window.until_shown("Runs on engine: this window edits it");
    window.until("the graph that runs there now", |app| app.document().text().contains("past_weight = 100"));
    window.key(Modifiers::COMMAND, Key::S);
    window.until("a copy", |app| {
        let copy = std::fs::read_to_string(app.document().path()).unwrap_or_default();
        copy == **app.document().text()
    });
}

#[test]
fn a_window_that_only_reads_says_so_and_changes_nothing() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("attached_reader");
    let address = free_address();
    let Some(_running) = Attachable::start(EDITOR, &folder.write("g.toml", GRAPH), &address, &[]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let mut window = open(&folder, &address);
    window.until_shown("Runs on engine: this window only reads");
    let before = window.app().document().text().to_string();
    window.select("sink");
    window.key(Modifiers::NONE, Key::Delete);
    window.until_shown("lets this window only read");
    assert_eq!((runs(window.app()), window.app().document().text().to_string()), (before.clone(), before));
    assert!(window.harness.query_by_label_contains("No emergency stop from here").is_some());
}

#[test]
fn two_outputs_of_a_machine_are_compared_tick_by_tick() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("attached_comparison");
    let address = free_address();
    // Images so large that the second output is always behind the first one.
    let text = GRAPH.replacen("width_px = 64, height_px = 48", "width_px = 1280, height_px = 720", 1);
    let Some(_running) = Attachable::start(EDITOR, &folder.write("g.toml", &text), &address, &[]) else {
        return panoscope_testing::skipped!("there is no program `panoscope`");
    };
    let mut window = open(&folder, &address);
    window.until_shown("Runs on engine: this window only reads");
    window.select("b");
    window.key(Modifiers::NONE, Key::V);
    window.until_shown("Viewer of b.image");
    let second = Output::new("mean", "image");
    let until = std::time::Instant::now() + common::PATIENCE;
    while window.app().compared_with() != Some(&second) {
        assert!(std::time::Instant::now() < until, "it is never compared with mean.image");
        window.key(Modifiers::NONE, Key::C);
    }
    // One tick after the other, not one by luck.
    for _ in 0..5 {
        let last = window.app().comparison().map(|found| found.seq);
        window.until("numbers of a later tick", |app| {
            app.comparison().is_some_and(|found| Some(found.seq) > last && found.measures.is_some())
        });
    }
}
