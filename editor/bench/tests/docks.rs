//! Panels are moved, split, put into tabs, torn off, closed and restored, by pointer and by keys, while a graph runs.

use std::path::Path;

use crate::common::{Folder, GRAPH, Window, has_plugin, input, nothing_lost};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Modifiers, Pos2, Rect, pos2};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::Options;
use panoscope_editor_model::docks::Panel;
use panoscope_editor_model::session::Phase;

const NONE: Modifiers = Modifiers::NONE;
const SHIFT: Modifiers = Modifiers::SHIFT;
const ALT: Modifiers = Modifiers::ALT;
const CTRL: Modifiers = Modifiers::COMMAND;

fn rect(window: &Window, panel: Panel) -> Rect {
    let rect = window.app().docks().rect(panel);
    rect.unwrap_or_else(|| panic!("{panel:?} is not shown: {:#?}", window.app().docks().layout))
}

/// Drags the tab of a panel to a point of the window.
fn drag_tab(window: &mut Window, name: &str, to: Pos2) {
    let from = window.harness.get_by_label(&format!("Panel {name}")).rect().center();
    input::drag(&mut window.harness, from, to);
    window.steps(2);
}

/// A window with a folder for settings, in which the tour was seen already.
fn with_settings(graph: &Path, config: &Path) -> Window {
    std::fs::create_dir_all(config).expect("a folder");
    std::fs::write(config.join("guide_seen"), "").expect("written");
    let options = Options { config: Some(config.to_owned()), ..Options::default() };
    let mut window = Window::open_with(graph, options);
    window.until("it runs", |app| app.session().status().phase == Phase::Running);
    window
}

fn layout_file(config: &Path) -> std::path::PathBuf {
    let files = std::fs::read_dir(config.join("layouts")).expect("a folder of layouts");
    files.flatten().next().expect("a layout").path()
}

#[test]
fn tabs_are_dragged_to_all_places_while_frames_flow() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("docks_pointer");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.key(NONE, Key::P);
    window.key(NONE, Key::Y);
    // Both are tabs below the graph; the last one is in front.
    let graph = rect(&window, Panel::Graph);
    assert_eq!(window.app().docks().rect(Panel::Plots), None);
    assert!(rect(&window, Panel::History).top() > graph.bottom());
    window.harness.get_by_label("Panel Plots").click();
    window.steps(3);
    assert!(rect(&window, Panel::Plots).top() > graph.bottom());

    // Split: beside the graph, at its left.
    drag_tab(&mut window, "Plots", pos2(graph.left() + 60.0, graph.center().y));
    assert!(rect(&window, Panel::Plots).right() < rect(&window, Panel::Graph).left());
    assert!(rect(&window, Panel::History).top() > rect(&window, Panel::Graph).bottom(), "the other stays");

    // Tab: behind the panel of the node.
    let node = rect(&window, Panel::Node);
    drag_tab(&mut window, "Plots", node.center());
    assert_eq!(rect(&window, Panel::Plots), node);
    assert!(window.app().docks().rect(Panel::Node).is_none());
    window.harness.get_by_label("Panel Node").click();
    window.steps(3);
    assert_eq!(rect(&window, Panel::Node), node);

    // Split of tabs: out of them, below.
    drag_tab(&mut window, "Plots", pos2(node.center().x, node.bottom() - 40.0));
    assert!(rect(&window, Panel::Plots).top() > rect(&window, Panel::Node).bottom());
    assert_eq!(rect(&window, Panel::Plots).width(), node.width());

    // Edge of the window: above everything.
    let edge = pos2(600.0, rect(&window, Panel::Graph).top() + 3.0);
    drag_tab(&mut window, "History", edge);
    let top = rect(&window, Panel::History);
    assert!(top.bottom() < rect(&window, Panel::Graph).top() && top.bottom() < rect(&window, Panel::Node).top());
    assert!(top.width() > 1300.0, "{top:?}");

    // Escape while dragging changes nothing.
    let before = window.app().docks().layout.clone();
    let from = window.harness.get_by_label("Panel Plots").rect().center();
    window.harness.hover_at(from);
    window.harness.drag_at(from);
    window.steps(1);
    window.harness.hover_at(graph.center());
    window.steps(2);
    assert_eq!(window.app().docks().dragged(), Some(Panel::Plots));
    window.key(NONE, Key::Escape);
    window.harness.drop_at(graph.center());
    window.steps(2);
    assert_eq!(window.app().docks().layout, before);

    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_tab_that_is_dropped_outside_becomes_a_window() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("docks_outside");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    drag_tab(&mut window, "Node", pos2(1520.0, 300.0));
    assert!(window.app().docks().layout.is_torn(Panel::Node));
    assert!(window.harness.query_by_label("Panel Node").is_none(), "its place in the window is free");
    assert!(rect(&window, Panel::Graph).width() > 1400.0);
    // Its contents are in the window of its own, and work there.
    window.select("mean");
    window.steps(3);
    window.harness.get_by_role_and_label(Role::Slider, "past_weight");
    window.harness.get_by_label("Dock: Node").click();
    window.steps(3);
    assert!(!window.app().docks().layout.is_torn(Panel::Node));
    assert_eq!(rect(&window, Panel::Node).width(), 320.0, "it is where it was");
    // The buttons on its tab do the same, and close it.
    window.harness.get_by_label("Tear off Node").click();
    window.steps(3);
    assert!(window.app().docks().layout.is_torn(Panel::Node));
    window.harness.get_by_label("Close: Node").click();
    window.steps(3);
    assert!(!window.app().docks().is_shown(Panel::Node));
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn every_way_of_a_dock_has_a_key() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("docks_keys");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.key(NONE, Key::P);
    assert_eq!(window.app().docks().focused(), Panel::Plots, "an opened panel has the keys");
    // Into the tabs at the right, out of them, above the graph.
    window.key(ALT, Key::ArrowRight);
    assert_eq!(rect(&window, Panel::Plots).width(), 320.0);
    assert!(window.app().docks().rect(Panel::Node).is_none());
    window.key(ALT, Key::ArrowRight);
    assert!(rect(&window, Panel::Plots).left() > rect(&window, Panel::Node).right());
    let width = rect(&window, Panel::Plots).width();
    window.key(ALT, Key::Minus);
    assert_eq!(rect(&window, Panel::Plots).width(), width - 32.0);
    window.key(ALT, Key::Plus);
    assert_eq!(rect(&window, Panel::Plots).width(), width);
    window.key(ALT, Key::ArrowUp);
    assert!(rect(&window, Panel::Plots).bottom() < rect(&window, Panel::Graph).top());
    // A window of its own, and back.
    window.key(ALT, Key::Enter);
    assert!(window.app().docks().layout.is_torn(Panel::Plots));
    window.key(ALT, Key::Enter);
    assert!(rect(&window, Panel::Plots).bottom() < rect(&window, Panel::Graph).top());
    // The next panels, in a round.
    let mut round = Vec::new();
    for _ in 0..3 {
        window.key(NONE, Key::F6);
        round.push(window.app().docks().focused());
    }
    assert_eq!(round, [Panel::Graph, Panel::Node, Panel::Plots]);
    window.key(SHIFT, Key::F6);
    assert_eq!(window.app().docks().focused(), Panel::Node);
    assert_eq!(input::focused(&window.harness).as_deref(), Some("Panel Node"), "a screen reader follows");
    window.key(CTRL, Key::W);
    assert!(!window.app().docks().is_shown(Panel::Node));
    window.key(SHIFT, Key::I);
    assert!(window.app().docks().is_shown(Panel::Node));
    // The graph keeps its place.
    window.key(NONE, Key::F6);
    while window.app().docks().focused() != Panel::Graph {
        window.key(NONE, Key::F6);
    }
    let before = window.app().docks().layout.clone();
    for key in [Key::ArrowLeft, Key::ArrowUp, Key::Enter, Key::Plus] {
        window.key(ALT, key);
    }
    window.key(CTRL, Key::W);
    assert_eq!(window.app().docks().layout, before);
    // Everything as at first, from the palette.
    window.key(CTRL, Key::K);
    window.type_text("reset the layout");
    window.key(NONE, Key::Enter);
    window.steps(3);
    assert!(rect(&window, Panel::Plots).top() > rect(&window, Panel::Graph).bottom());
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn borders_move_by_pointer_and_by_arrow_keys() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("docks_borders");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    let width = rect(&window, Panel::Node).width();
    let border = window.harness.get_by_label("Border between Graph and Node");
    let from = border.rect().center();
    input::drag(&mut window.harness, from, from - eframe::egui::vec2(100.0, 0.0));
    window.steps(2);
    assert!((rect(&window, Panel::Node).width() - width - 100.0).abs() < 2.0, "{:?}", rect(&window, Panel::Node));
    let width = rect(&window, Panel::Node).width();
    window.harness.get_by_label("Border between Graph and Node").focus();
    window.steps(2);
    window.key(NONE, Key::ArrowRight);
    assert_eq!(rect(&window, Panel::Node).width(), width - 16.0);
}

#[test]
fn each_graph_opens_as_it_was_left() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("docks_kept");
    let config = folder.0.join("settings");
    let (one, two) = (folder.write("one.toml", GRAPH), folder.write("two.toml", GRAPH));
    let mut window = with_settings(&one, &config);
    window.key(NONE, Key::P);
    window.key(ALT, Key::ArrowUp);
    window.key(NONE, Key::Y);
    window.key(ALT, Key::Enter);
    let left = window.app().docks().layout.clone();
    drop(window);
    assert!(layout_file(&config).starts_with(config.join("layouts")), "beside other settings, not beside the graph");

    let window = with_settings(&one, &config);
    assert_eq!(window.app().docks().layout, left);
    assert!(rect(&window, Panel::Plots).bottom() < rect(&window, Panel::Graph).top());
    assert!(window.app().docks().layout.is_torn(Panel::History));
    drop(window);
    let window = with_settings(&two, &config);
    assert!(!window.app().docks().is_shown(Panel::Plots), "another graph has its own");
}

#[test]
fn a_broken_file_gives_a_note_and_the_first_arrangement() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("docks_broken");
    let config = folder.0.join("settings");
    let graph = folder.write("g.toml", GRAPH);
    let mut window = with_settings(&graph, &config);
    window.key(NONE, Key::P);
    drop(window);
    let file = layout_file(&config);
    let good = std::fs::read(&file).expect("a layout");
    std::fs::write(&file, &good[..good.len() - 20]).expect("written");
    let mut window = with_settings(&graph, &config);
    window.until_shown("is not used");
    assert!(!window.app().docks().is_shown(Panel::Plots));
    // The next change replaces it.
    window.key(NONE, Key::P);
    drop(window);
    let window = with_settings(&graph, &config);
    assert!(window.app().docks().is_shown(Panel::Plots));
    assert!(window.harness.query_by_label_contains("is not used").is_none());
}

#[test]
fn the_viewer_is_a_panel_too() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("docks_viewer");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.select("mean");
    window.key(SHIFT, Key::V);
    window.key(NONE, Key::V);
    assert!(rect(&window, Panel::Viewer).left() > rect(&window, Panel::Graph).right());
    window.until_shown("Viewer of mean.image");
    window.harness.get_by_label("Node mean");
    window.until_shown("64 x 48 px");
    window.key(NONE, Key::Escape);
    window.steps(2);
    assert!(!window.app().docks().is_shown(Panel::Viewer));
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn everything_on_the_docks_has_a_name() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("docks_names");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    for key in [Key::P, Key::Y, Key::M, Key::T, Key::S, Key::R, Key::J, Key::D] {
        window.key(NONE, key);
    }
    window.steps(3);
    input::all_named(&window.harness, "docks", 20);
    let borders: Vec<String> = input::focusable(&window.harness);
    for name in ["Panel Plots", "Panel Text", "Border between Graph and Node", "Border between Text and Graph"] {
        assert!(borders.iter().any(|known| known == name), "{name}: {borders:#?}");
    }
}
