//! Commands, nodes and parameters found by typing; why a node is idle; the map of the graph; the names of wires.

use crate::common;
use crate::common::{Folder, GRAPH, Window, has_plugin, nothing_lost};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Modifiers, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::Options;
use panoscope_editor_widgets::theme;
use panoscope_graph::ParamValue;

const NONE: Modifiers = Modifiers::NONE;
const CTRL: Modifiers = Modifiers::COMMAND;

#[test]
fn a_parameter_is_found_by_typing_and_gets_the_keys() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("find");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.key(CTRL, Key::K);
    window.type_text("past");
    window.until_shown("Pick mean.past_weight");
    window.key(NONE, Key::Enter);
    window.steps(3);
    assert_eq!(window.app().selected().as_deref(), Some("mean"));
    let slider = window.harness.get_by_role_and_label(Role::Slider, "past_weight");
    assert!(slider.is_focused(), "the slider gets the keys");
    window.key(NONE, Key::ArrowRight);
    window.until("the value is applied", |app| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.param_values("mean").is_some_and(|v| v[0] == ParamValue::Int(101))
    });
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn commands_are_found_by_what_they_do() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("commands");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.key(CTRL, Key::K);
    window.type_text("plots");
    window.key(NONE, Key::Enter);
    window.until_shown("Values");
    window.key(CTRL, Key::K);
    window.type_text("light");
    assert!(!theme::is_light());
    window.key(NONE, Key::Enter);
    window.steps(2);
    assert!(theme::is_light());
    window.key(Modifiers::SHIFT, Key::T);
    window.steps(2);
    assert!(!theme::is_light());
    window.key(CTRL, Key::K);
    window.type_text("zzzz");
    window.until_shown("no match");
    window.key(NONE, Key::Escape);
    window.steps(3);
    assert!(window.harness.query_by_label("Palette").is_none());
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_parameter_inside_a_folded_part_is_shown_with_its_part_opened() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("inside");
    std::fs::create_dir_all(folder.0.join("parts")).expect("a folder");
    let part = "plugins = [\"flow\"]\n[part]\ninputs = { image = \"mean.image\" }\noutputs = { image = \"mean.image\" }\n\
                [nodes.mean]\ntype = \"smooth\"\n";
    folder.write("parts/calm.toml", part);
    let text = GRAPH.replace(
        "type = \"smooth\"\ninputs = { image = \"b.image\" }\nparams = { past_weight = 100 } # of 256",
        "graph = \"parts/calm.toml\"\ninputs = { image = \"b.image\" }",
    );
    let mut window = Window::run(&folder.write("g.toml", &text));
    assert!(window.app().document().view().node("mean/mean").is_none(), "it is folded");
    window.key(CTRL, Key::K);
    window.type_text("past");
    window.until_shown("Pick mean/mean.past_weight");
    window.key(NONE, Key::Enter);
    window.steps(4);
    assert_eq!(window.app().selected().as_deref(), Some("mean/mean"));
    assert!(window.harness.get_by_role_and_label(Role::Slider, "past_weight").is_focused());
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_slider_keeps_the_keys_when_a_line_comes_above_it() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("keeps_keys");
    let path = folder.write("g.toml", GRAPH);
    let mut window = Window::run(&path);
    window.key(CTRL, Key::K);
    window.type_text("past");
    window.until_shown("Pick mean.past_weight");
    window.key(NONE, Key::Enter);
    window.steps(3);
    let has_keys = |window: &Window| window.harness.get_by_role_and_label(Role::Slider, "past_weight").is_focused();
    assert!(has_keys(&window));
    // A mistake, which the panel shows above the parameters.
    folder.write("g.toml", &GRAPH.replace("past_weight = 100", "past_weight = 100, nothing = 1"));
    window.until("the mistake is read", |app| {
        let view = app.document().view();
        view.node("mean").is_some_and(|node| !view.nodes[node].mistakes.is_empty())
    });
    window.steps(3);
    assert!(has_keys(&window));
    window.key(NONE, Key::ArrowRight);
    assert!(window.app().document().text().contains("past_weight = 101"));
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn the_panel_says_why_a_node_is_idle_and_leads_to_the_cause() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("idle");
    let text = GRAPH.replace(
        "type = \"smooth\"\ninputs = { image = \"b.image\" }\nparams = { past_weight = 100 } # of 256",
        "type = \"gate\"\ninputs = { image = \"b.image\" }\nparams = { open = false }\n\n\
         [nodes.after]\ntype = \"pass\"\ninputs = { image = \"mean.image\" }",
    );
    let end = "type = \"drain\"\ninputs = { image = ";
    let text = text.replace(&format!("{end}\"mean.image\""), &format!("{end}\"after.image\""));
    let mut window = Window::run(&folder.write("g.toml", &text));
    window.select("sink");
    window.until_shown("is empty");
    assert!(window.harness.query_by_label("WHY IT IS IDLE").is_some());
    window.select("b");
    window.steps(3);
    assert!(window.harness.query_by_label("WHY IT IS IDLE").is_none(), "a source that works is not idle");
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn the_map_shows_what_is_outside_of_the_view_and_moves_it() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("map");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.steps(3);
    assert!(window.harness.query_by_label("Map of the graph").is_none(), "the whole graph is in view");
    (0..8).for_each(|_| window.key(NONE, Key::Plus));
    window.until_shown("Map of the graph");
    let node = |window: &Window| window.app().canvas().node_rects()[0].1.center();
    let before = node(&window);
    let map = window.harness.get_by_label("Map of the graph").rect();
    common::input::tap(&mut window.harness, map.min + vec2(8.0, 8.0));
    window.steps(2);
    let right = node(&window) - before;
    common::input::tap(&mut window.harness, map.max - vec2(8.0, 8.0));
    window.steps(2);
    let left = node(&window) - before;
    assert!(right.x > left.x && right.y > left.y, "{right:?} {left:?}");
    window.key(NONE, Key::F);
    window.steps(2);
    assert!(window.harness.query_by_label("Map of the graph").is_none());
}

#[test]
fn wires_under_the_pointer_are_named() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("names_of_wires");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.steps(3);
    let at = |window: &Window, label: &str| window.harness.get_by_label(label).rect().center();
    let middle = at(&window, "Output b.image").lerp(at(&window, "Input mean.image"), 0.5);
    window.harness.hover_at(middle);
    window.until_shown("b.image to mean.image  (image)");
}

#[test]
fn a_light_window_is_light() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("light");
    let options = Options { theme: theme::Choice::Light, ..Options::default() };
    let mut window = Window::open_with(&folder.write("g.toml", GRAPH), options);
    window.steps(3);
    assert!(!window.harness.ctx.global_style().visuals.dark_mode);
    assert_eq!(window.harness.ctx.global_style().visuals.panel_fill, theme::ground());
    assert!(theme::ground().r() > 200);
    drop(window);
    theme::apply(&eframe::egui::Context::default());
}
