//! Values in the window: sweeps, history, picking on images and from files, queues of wires.

use crate::common;
use std::time::Instant;

use crate::common::{Folder, PATIENCE, Window, has_plugin, input};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::history::Origin;
use panoscope_graph::ParamValue;

const NONE: Modifiers = Modifiers::NONE;

/// A path with measured levels, and one that no test changes.
const GRAPH: &str = r#"# Levels.
plugins = ["flow", "fixtures"]

[nodes.a]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 50.0 }

[nodes.kept]
type = "ledger"
inputs = { images = [{ from = "a.image", queue = 64 }] }
params = { path = "kept.jsonl" }

[nodes.b]
type = "frames"
params = { width_px = 64, height_px = 48, format = "gray8", rate_hz = 50.0 }

[nodes.level]
type = "level"
inputs = { image = "b.image" }
params = { gain = 1.0 } # a factor
"#;

fn value(window: &Window, at: usize) -> Option<ParamValue> {
    let engine = window.app().session().handle().engine()?;
    engine.param_values("level")?.get(at).cloned()
}

fn until_value(window: &mut Window, at: usize, wanted: &ParamValue) {
    let until = Instant::now() + PATIENCE;
    while value(window, at).as_ref() != Some(wanted) {
        assert!(Instant::now() < until, "it is {:?}, not {wanted:?}", value(window, at));
        window.steps(1);
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
}

#[test]
fn a_sweep_runs_beside_the_graph_and_its_points_are_drawn() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("sweep");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.select("level");
    window.click_until_shown("Sweep a parameter", "Sweep measure");
    input::fill(&mut window.harness, "Sweep measure", "level.levels.mean");
    window.harness.get_by_label("Start the sweep").click();
    window.until("the sweep is done", |app| app.sweep().is_some_and(|p| p.done));
    let progress = window.app().sweep().expect("a sweep");
    assert_eq!((progress.param.as_str(), progress.total), ("level.gain", 9));
    assert_eq!(progress.failed, None);
    let mean = |k: usize| progress.points[k].result.as_ref().expect("it was measured").mean;
    assert_eq!(progress.points.len(), 9);
    assert_eq!(mean(0), 0.0);
    assert!(mean(1) > 1.0 && (mean(8) - 8.0 * mean(1)).abs() < 1e-6, "{progress:?}");
    window.until_shown("Sweep: 0: 0, 1.00: ");
    assert_eq!(value(&window, 0), Some(ParamValue::Float(1.0)), "the graph here is as it was");
    assert!(!window.app().document().is_changed());
    // An unknown measure is an error.
    input::fill(&mut window.harness, "Sweep measure", "level.levels.middle");
    window.harness.get_by_label("Start the sweep").click();
    window.until_shown("columns are mean, min, max, spots");
    window.until("it is over", |app| app.sweep().is_some_and(|p| p.done));
    window.steps(2);
    input::fill(&mut window.harness, "Sweep measure", "levl.levels.mean");
    window.harness.get_by_label("Start the sweep").click();
    window.until_shown("there is no node `levl`");
    window.until("it is over", |app| app.sweep().is_some_and(|p| p.done));
    window.steps(2);
    // A very long sweep can be cancelled.
    input::fill(&mut window.harness, "Sweep measure", "level.level");
    input::fill(&mut window.harness, "Frames per value", "1000000");
    window.harness.get_by_label("Start the sweep").click();
    window.until_shown("Cancel");
    window.harness.get_by_label("Cancel").click();
    window.until("it is cancelled", |app| app.sweep().is_some_and(|p| p.done && p.cancelled));
    let report = window.close();
    common::nothing_lost(&folder, &report);
}

#[test]
fn the_history_is_stepped_through_by_key_and_by_click() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("history");
    let path = folder.write("g.toml", GRAPH);
    let mut window = Window::run(&path);
    window.select("level");
    for _ in 0..2 {
        window.harness.get_by_role_and_label(Role::Slider, "gain").focus();
        window.steps(2);
        window.key(NONE, Key::ArrowRight);
        window.settled();
    }
    let after = value(&window, 0).expect("it runs");
    window.harness.get_by_role_and_label(Role::Slider, "gain").focus();
    window.key(NONE, Key::Escape);
    // Another program writes the file.
    std::fs::write(&path, GRAPH.replace("gain = 1.0", "gain = 4.0")).expect("written");
    window.until_shown("Take the file's");
    window.harness.get_by_label("Take the file's").click();
    until_value(&mut window, 0, &ParamValue::Float(4.0));
    window.settled();
    window.until("all changes have a tick", |app| !app.document().history().has_pending());
    let ticks: Vec<Option<u64>> = window.app().document().history().changes().map(|c| c.tick).collect();
    assert!(ticks.iter().all(|t| t.is_some_and(|t| t > 0)) && ticks.is_sorted(), "{ticks:?}");
    let by: Vec<Origin> = window.app().document().history().changes().map(|c| c.by).collect();
    assert_eq!(by.last(), Some(&Origin::File), "{by:?}");
    let count = by.len();
    window.key(NONE, Key::Y);
    window.until_shown(&format!("{count} change"));
    window.until_shown("Change 1: level.gain from");
    // Back by key, to the beginning by click, and forward again.
    window.key(NONE, Key::OpenBracket);
    until_value(&mut window, 0, &after);
    assert_eq!(window.app().document().history().at(), count - 1);
    for _ in 1..count {
        window.harness.get_by_label("Back").click();
        window.steps(3);
    }
    until_value(&mut window, 0, &ParamValue::Float(1.0));
    window.settled();
    assert!(window.app().document().text().contains("gain = 1.0 } # a factor"), "the comment stays");
    window.harness.get_by_label_contains(&format!("Change {count}: level.gain")).click();
    until_value(&mut window, 0, &ParamValue::Float(4.0));
    assert_eq!(window.app().document().history().changes().len(), count, "steps are no changes");
    // A step is an edit: it can be undone, and the undo is recorded.
    window.key(Modifiers::COMMAND, Key::Z);
    until_value(&mut window, 0, &ParamValue::Float(1.0));
    let last = window.app().document().history().changes().last().map(|c| c.by);
    assert_eq!(last, Some(Origin::Undo));
    let report = window.close();
    common::nothing_lost(&folder, &report);
}

#[test]
fn points_are_picked_by_click_drag_and_keys() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("points");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.select("level");
    window.click_until_shown("Pick spots", "Pick level.spots here");
    assert_eq!(window.app().viewed().map(ToString::to_string).as_deref(), Some("b.image"), "the picture that it reads");
    let rect = window.harness.get_by_label("Pick level.spots here").rect();
    let at = |x: f32, y: f32| rect.min + eframe::egui::vec2(x / 64.0 * rect.width(), y / 48.0 * rect.height());
    let spots = |window: &Window| match value(window, 2) {
        Some(ParamValue::Floats(list)) => list,
        other => panic!("{other:?}"),
    };
    // A click adds a point.
    input::tap(&mut window.harness, at(16.0, 12.0));
    until_value(&mut window, 2, &ParamValue::Floats(vec![16.0, 12.0]));
    assert!(window.app().document().text().contains("spots = [16, 12]"), "{}", window.app().document().text());
    // A drag moves it.
    input::drag(&mut window.harness, at(16.0, 12.0), at(32.0, 12.0));
    until_value(&mut window, 2, &ParamValue::Floats(vec![32.0, 12.0]));
    // By keys alone: add a point in the middle, move it, remove the first one.
    window.harness.get_by_label("Add a point").click_accesskit();
    window.steps(3);
    window.key(NONE, Key::ArrowRight);
    window.key(Modifiers::SHIFT, Key::ArrowUp);
    until_value(&mut window, 2, &ParamValue::Floats(vec![32.0, 12.0, 33.0, 14.0]));
    window.harness.get_by_label("Point 1 of level.spots").focus();
    window.steps(2);
    window.key(NONE, Key::Delete);
    until_value(&mut window, 2, &ParamValue::Floats(vec![33.0, 14.0]));
    assert!(window.app().document().view().node("level").is_some(), "Delete was for the point");
    assert_eq!(spots(&window).len(), 2);
    window.key(NONE, Key::Escape);
    assert_eq!((window.app().picked(), window.app().viewed()), (None, None));
    let report = window.close();
    common::nothing_lost(&folder, &report);
}

#[test]
fn rectangles_are_drawn_and_changed_by_their_handles() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("rectangles");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.select("level");
    window.click_until_shown("Pick window", "Pick level.window here");
    let rect = window.harness.get_by_label("Pick level.window here").rect();
    let at = |x: f32, y: f32| rect.min + eframe::egui::vec2(x / 64.0 * rect.width(), y / 48.0 * rect.height());
    let drag = |window: &mut Window, from: (f32, f32), to: (f32, f32)| {
        input::drag(&mut window.harness, at(from.0, from.1), at(to.0, to.1));
    };
    drag(&mut window, (8.0, 6.0), (40.0, 30.0));
    until_value(&mut window, 1, &ParamValue::Floats(vec![8.0, 6.0, 32.0, 24.0]));
    drag(&mut window, (40.0, 30.0), (48.0, 36.0));
    until_value(&mut window, 1, &ParamValue::Floats(vec![8.0, 6.0, 40.0, 30.0]));
    window.harness.get_by_label("Rectangle 1 of level.window").focus();
    window.steps(2);
    window.key(NONE, Key::ArrowDown);
    until_value(&mut window, 1, &ParamValue::Floats(vec![8.0, 7.0, 40.0, 30.0]));
    window.harness.get_by_label("Clear").click_accesskit();
    until_value(&mut window, 1, &ParamValue::Floats(vec![]));
    window.harness.get_by_label("Done").click_accesskit();
    window.steps(3);
    assert_eq!(window.app().picked(), None);
}

#[test]
fn a_file_is_picked_out_of_folders_by_keys() {
    if !has_plugin("flow") || !has_plugin("capture") {
        return;
    }
    let folder = Folder::new("files");
    std::fs::create_dir_all(folder.0.join("views")).expect("a folder");
    image::RgbImage::new(32, 24).save(folder.0.join("views/first.png")).expect("a picture");
    image::RgbImage::new(32, 24).save(folder.0.join("views/other.png")).expect("a picture");
    let text = "plugins = [\"capture\", \"flow\"]\n[nodes.scope]\ntype = \"capture\"\nparams = { left = \"views/first.png\" }\n[nodes.sink]\ntype = \"drain\"\ninputs = { image = \"scope.left\" }\n";
    let mut window = Window::open(&folder.write("g.toml", text));
    window.steps(3);
    window.select("scope");
    window.click_until_shown("Browse left", "File first.png");
    // To the parent folder and back, by keys alone.
    window.key(NONE, Key::Backspace);
    window.until_shown("Folder views");
    window.key(NONE, Key::Enter);
    window.until_shown("File other.png");
    window.key(NONE, Key::ArrowDown);
    window.key(NONE, Key::Enter);
    window.steps(3);
    let now = window.app().document().text().to_string();
    assert!(now.contains("left = \"views/other.png\""), "{now}");
    // A new name is accepted; Escape picks nothing.
    window.harness.get_by_label("Browse calibration").click_accesskit();
    window.until_shown("File name");
    window.harness.get_by_label("File name").type_text("new.yml");
    window.steps(2);
    window.key(NONE, Key::Escape);
    window.steps(3);
    assert_eq!(**window.app().document().text(), *now);
    window.harness.get_by_label("Browse calibration").click_accesskit();
    window.until_shown("File name");
    window.harness.get_by_label("File name").type_text("new.yml");
    window.steps(2);
    window.key(NONE, Key::Enter);
    window.steps(3);
    assert!(window.app().document().text().contains("calibration = \"new.yml\""), "{}", window.app().document().text());
}

#[test]
fn queues_of_wires_are_drawn() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("queues");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.key(NONE, Key::P);
    window.until_shown("Queues");
    window.harness.get_by_label("Queues").click();
    window.until("something is counted", |app| {
        app.queues().iter().any(|(wire, most)| wire == "a.image to kept.images" && *most >= 1.0)
    });
    // A node that runs inline after its producer has an empty queue.
    let queues = window.app().queues();
    assert!(queues.iter().any(|(wire, _)| wire == "b.image to level.image"), "{queues:?}");
    let report = window.close();
    common::nothing_lost(&folder, &report);
}
