//! Presets stored, applied and morphed, and snapshots taken and restored, while frames flow.

use crate::common::{Folder, GRAPH, Window, has_plugin, input, nothing_lost};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::App;
use panoscope_graph::ParamValue;

const NONE: Modifiers = Modifiers::NONE;
const CTRL: Modifiers = Modifiers::COMMAND;

fn until_weight(window: &mut Window, wanted: i64) {
    window.until(&format!("past_weight is {wanted}"), |app| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.param_values("mean").is_some_and(|values| values[0] == ParamValue::Int(wanted))
    });
}

/// Adds to `mean.past_weight` by its slider.
fn add_weight(window: &mut Window, steps: usize) {
    window.key(CTRL, Key::K);
    window.type_text("past");
    window.until_shown("Pick mean.past_weight");
    window.key(NONE, Key::Enter);
    window.steps(3);
    (0..steps).for_each(|_| window.key(NONE, Key::ArrowRight));
}

#[test]
fn presets_are_applied_and_morphed_while_frames_flow() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("presets");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.key(NONE, Key::R);
    window.until_shown("Store preset");
    let store = |window: &mut Window, name: &str| {
        input::fill(&mut window.harness, "Name of the preset", name);
        window.until_shown(&format!("Apply preset {name}"));
    };
    store(&mut window, "soft");
    add_weight(&mut window, 10);
    until_weight(&mut window, 110);
    store(&mut window, "hard");
    let file = std::fs::read_to_string(folder.0.join("g.presets.toml")).expect("beside the graph");
    assert!(file.contains("name = \"soft\"") && file.contains("\"mean.past_weight\" = 110"), "{file}");

    window.harness.get_by_label("Apply preset soft").click_accesskit();
    until_weight(&mut window, 100);
    assert_eq!(window.app().document().undo_label(), Some("preset soft"));
    // Half way, by the slider's keys.
    window.harness.get_by_role_and_label(Role::Slider, "Morph").focus();
    window.steps(2);
    (0..50).for_each(|_| window.key(NONE, Key::ArrowRight));
    until_weight(&mut window, 105);
    let steps = window.app().document().steps();
    (0..50).for_each(|_| window.key(NONE, Key::ArrowRight));
    until_weight(&mut window, 110);
    assert_eq!(window.app().document().steps(), steps, "a morph is one step");
    window.harness.ctx.memory_mut(|memory| memory.stop_text_input());
    window.harness.get_by_label("Remove preset hard").click_accesskit();
    window.steps(3);
    assert!(window.harness.query_by_label("Apply preset hard").is_none());
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn the_graph_goes_back_to_a_snapshot_while_frames_flow() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("snapshot");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.until("a picture", App::has_picture);
    window.key(Modifiers::SHIFT, Key::R);
    window.key(NONE, Key::R);
    window.until_shown("Go back to snapshot 1");
    // Another value, and a node less.
    add_weight(&mut window, 5);
    until_weight(&mut window, 105);
    window.harness.ctx.memory_mut(|memory| memory.stop_text_input());
    window.select("sink");
    window.key(NONE, Key::Delete);
    window.settled();
    assert!(!window.running().contains(&"sink".to_owned()));
    window.harness.get_by_label("Go back to snapshot 1").click_accesskit();
    until_weight(&mut window, 100);
    window.settled();
    assert!(window.running().contains(&"sink".to_owned()));
    assert_eq!(**window.app().document().text(), *GRAPH, "byte for byte");
    let picture = image::open(folder.0.join("g.snapshots/snapshot_0001.png")).expect("a picture");
    assert!(picture.width() >= 16, "{picture:?}");
    window.harness.get_by_label("Remove snapshot 1").click_accesskit();
    window.steps(3);
    assert!(!folder.0.join("g.snapshots/snapshot_0001.toml").exists());
    let report = window.close();
    nothing_lost(&folder, &report);
}
