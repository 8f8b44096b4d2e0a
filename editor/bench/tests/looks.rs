//! Compares screenshots of the editor with golden images, and checks that every widget has a name.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::{Folder, Window, has_plugin, input};
use eframe::egui::{Key, Modifiers, Pos2, Rect, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::Options;
use panoscope_editor_model::session::Phase;
use panoscope_editor_widgets::golden::{compare, paint};
use panoscope_editor_widgets::theme::ground;

const NONE: Modifiers = Modifiers::NONE;

use crate::looks_graph::{GRAPH, TICKS};

/// The window after the last tick of each source, when nothing changes any more.
fn at_rest(graph: &Path) -> Window {
    let options = Options { frames: Some(TICKS), ..Options::default() };
    let mut window = Window::open_with(graph, options);
    window.until("it has ended", |app| app.session().status().phase == Phase::Ended);
    // Rates cover the last half second; previews count as old after two seconds.
    let until = Instant::now() + Duration::from_millis(3500);
    while Instant::now() < until {
        window.steps(1);
        std::thread::sleep(Duration::from_millis(20));
    }
    window
}

fn looks(window: &mut Window, name: &str) {
    window.harness.remove_cursor();
    window.steps(3);
    let picture = paint(&window.harness.ctx, window.harness.output(), &window.textures, ground());
    compare(name, picture, &times(window));
}

/// Where the window shows times, which differ from run to run: in the bar, below the pictures of nodes, in the panel beside the graph.
fn times(window: &Window) -> Vec<Rect> {
    let canvas = window.app().canvas();
    let footer = canvas.zoom_factor() * 32.0;
    // While something is picked, the viewer stands over the graph.
    let nodes = if window.app().viewed().is_some() { Vec::new() } else { canvas.node_rects() };
    let rects = nodes.into_iter().map(|(_, rect)| rect.with_min_y(rect.bottom() - footer).intersect(canvas.rect));
    let size = window.harness.ctx.content_rect().size();
    let bar = Rect::from_min_size(Pos2::ZERO, vec2(480.0, 48.0));
    let is_time = |text: &str| {
        text.chars().any(|c| c.is_ascii_digit()) && [" ms", " us", " s"].iter().any(|unit| text.contains(unit))
    };
    let beside =
        window.painted_at().into_iter().filter(|(text, rect)| is_time(text) && rect.left() > canvas.rect.right());
    let rows = beside.map(|(_, rect)| {
        let (left, right) = (canvas.rect.right() + 2.0, size.x);
        Rect::from_x_y_ranges(left..=right, rect.center().y - 10.0..=rect.center().y + 10.0)
    });
    rects.chain([bar]).chain(rows).collect()
}

#[test]
fn the_editor_matches_the_golden_images() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("looks");
    let mut window = at_rest(&folder.write("looks.toml", GRAPH));
    looks(&mut window, "bench");
    window.select("level");
    looks(&mut window, "bench_node");
    window.harness.get_by_label("Sweep a parameter").click_accesskit();
    window.steps(2);
    for (label, text) in [("Sweep measure", "level.levels.mean"), ("Frames per value", "3")] {
        input::fill(&mut window.harness, label, text);
    }
    window.harness.get_by_label("Start the sweep").click_accesskit();
    window.until("the sweep is done", |app| app.sweep().is_some_and(|p| p.done));
    looks(&mut window, "bench_sweep");
    // The history, moved out of the tabs below the graph.
    window.key(NONE, Key::Y);
    window.key(Modifiers::ALT, Key::ArrowLeft);
    looks(&mut window, "bench_docks");
    window.key(NONE, Key::Y);
    window.key(NONE, Key::S);
    window.harness.get_by_label("Pick spots").click_accesskit();
    window.until_shown("Pick level.spots here");
    // The age of the image, in seconds, may be shown on it.
    let picture = window.harness.get_by_label("Pick level.spots here").rect();
    window.harness.remove_cursor();
    window.steps(3);
    let now = paint(&window.harness.ctx, window.harness.output(), &window.textures, ground());
    let age = Rect::from_min_size(picture.center_top(), vec2(0.0, 48.0)).expand2(vec2(160.0, 0.0));
    let mut masked = times(&window);
    masked.push(age);
    compare("bench_picker", now, &masked);
}

/// The compositions of `screen` for views of four shapes, with and without smaller images, on screens of two sizes.
fn compositions() -> String {
    let mut text = String::from(
        "# What `screen` makes of views.\nname = \"screens\"\nmode = \"batch\"\nplugins = [\"flow\", \"overlay\"]\n",
    );
    for (shape, width, height) in [("4_3", 640, 480), ("16_9", 640, 360), ("5_4", 600, 480), ("square", 480, 480)] {
        text += &format!(
            "[nodes.view_{shape}]\ntype = \"frames\"\nparams = {{ width_px = {width}, height_px = {height}, rate_hz = 20.0 }}\n\
             [nodes.alone_{shape}]\ntype = \"screen\"\ninputs = {{ main = \"view_{shape}.image\" }}\n\
             params = {{ titles = \"panorama\" }}\n\
             [nodes.all_{shape}]\ntype = \"screen\"\ninputs = {{ main = \"view_{shape}.image\", side = [\"view_{shape}.image\", \"view_{shape}.image\", \"view_{shape}.image\"] }}\n\
             params = {{ width = 1920, height = 1080, titles = \"panorama; tools; surface; depth\" }}\n"
        );
    }
    text
}

#[test]
fn the_compositions_of_screens_match_the_golden_image() {
    if !has_plugin("flow") || !has_plugin("overlay") {
        return;
    }
    let folder = Folder::new("compositions");
    let mut window = at_rest(&folder.write("screens.toml", &compositions()));
    looks(&mut window, "bench_screens");
}

#[test]
fn every_widget_has_a_name() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("names");
    let mut window = Window::run(&folder.write("looks.toml", GRAPH));
    let check = |window: &mut Window, what: &str| {
        window.steps(3);
        input::all_named(&window.harness, what, 6);
    };
    check(&mut window, "bench");
    for node in ["camera", "calm", "level"] {
        window.select(node);
        check(&mut window, node);
    }
    for (key, what) in
        [(Key::P, "curves"), (Key::S, "sweep"), (Key::Y, "history"), (Key::M, "problems"), (Key::T, "text")]
    {
        window.key(NONE, key);
        check(&mut window, what);
        window.key(NONE, key);
    }
    for (key, what) in [(Key::A, "palette"), (Key::U, "plugins"), (Key::F1, "keys")] {
        window.key(NONE, key);
        check(&mut window, what);
        window.key(NONE, Key::Escape);
        window.steps(3);
    }
    window.select("level");
    window.key(NONE, Key::V);
    check(&mut window, "viewer");
    window.key(NONE, Key::Escape);
    window.select("level");
    window.harness.get_by_label("Pick window").click_accesskit();
    window.until_shown("Pick level.window here");
    check(&mut window, "picker");
}
