//! Files and recordings are paused, stepped, repeated and played at another speed from the bar above.

use crate::common::{Folder, Window, has_plugin, input};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::App;
use panoscope_graph::ParamValue;

const NONE: Modifiers = Modifiers::NONE;
const GRAPH: &str = r#"name = "files"
mode = "live"
plugins = ["capture", "flow"]

[nodes.scope]
type = "capture"
params = { left = "l_*.png", right = "r_*.png", rate_hz = 50.0, loop = true }

[nodes.mean]
type = "smooth"
inputs = { image = "scope.left" }
params = { past_weight = 10 }

[nodes.sink]
type = "drain"
inputs = { image = "mean.image" }
"#;

/// The number of the frame that the source shows, as its counters say.
fn frame(app: &App) -> Option<f64> {
    let engine = app.session().handle().engine()?;
    engine.report().nodes["scope"].metrics.get("frame").copied()
}

fn count(app: &App, node: &str) -> u64 {
    app.session().handle().engine().map_or(0, |engine| engine.report().nodes[node].count)
}

/// The value with which a parameter of the source runs.
fn value(app: &App, param: &str) -> Option<ParamValue> {
    let view = app.document().view().flat();
    let declared = &view.nodes[view.node("scope")?].node_type.as_ref()?.params;
    let place = declared.iter().position(|declared| declared.name == param)?;
    app.session().handle().engine()?.param_values("scope")?.get(place).cloned()
}

#[test]
fn files_are_paused_stepped_repeated_and_played_at_another_speed() {
    if !has_plugin("capture") || !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("files");
    for number in 0..40u8 {
        for view in ["l", "r"] {
            let name = folder.0.join(format!("{view}_{number:02}.png"));
            image::RgbImage::from_pixel(32, 24, image::Rgb([6 * number; 3])).save(name).expect("written");
        }
    }
    let path = folder.write("files.toml", GRAPH);
    let mut window = Window::run(&path);
    window.until_shown("Pause");
    input::all_named(&window.harness, "a graph of files", 5);
    window.harness.get_by_label("Pause").click_accesskit();
    window.until("it is paused", |app| value(app, "paused") == Some(ParamValue::Bool(true)));
    window.until_shown("Play");
    let held = frame(window.app());
    let counted = count(window.app(), "mean");
    // The rest of the graph works on, on the same frame.
    window.until("the frame is repeated", |app| count(app, "mean") > counted + 3);
    let held_now = frame(window.app());
    assert!(held.is_some() && held_now.is_some(), "{held:?} {held_now:?}");
    let next = held_now.map(|at| (at + 1.0) % 40.0);
    window.harness.get_by_label("Step").click_accesskit();
    window.until("the next frame", |app| frame(app) == next);
    window.key(NONE, Key::Period);
    let next = next.map(|at| (at + 1.0) % 40.0);
    window.until("one more, by key", |app| frame(app) == next);
    // Twice as fast, four times, a quarter.
    for (caption, speed) in [("1 x", 2.0), ("2 x", 4.0), ("4 x", 0.25)] {
        window.harness.get_by_label(caption).click_accesskit();
        window.until(caption, |app| value(app, "speed") == Some(ParamValue::Float(speed)));
        window.steps(2);
    }
    assert_eq!(window.app().playing().map(|now| (now.plays, now.loops, now.speed)), Some((false, true, 0.25)));
    // A loop that is taken away opens the files again, at the same frame.
    window.harness.get_by_label("Loop").click_accesskit();
    window.until("it does not begin again", |app| value(app, "loop") == Some(ParamValue::Bool(false)));
    // Nothing of this is in the file, or a step of undo.
    assert_eq!(&**window.app().document().text(), GRAPH);
    assert!(!window.app().document().is_changed() && window.app().document().undo_label().is_none());
    // A change of another node keeps the pause.
    window.select("mean");
    window.harness.get_by_role_and_label(Role::Slider, "past_weight").focus();
    window.steps(2);
    window.key(NONE, Key::ArrowRight);
    assert_ne!(&**window.app().document().text(), GRAPH);
    window.settled();
    assert_eq!(value(window.app(), "paused"), Some(ParamValue::Bool(true)));
    window.key(NONE, Key::Q);
    window.until("it plays again", |app| value(app, "paused") == Some(ParamValue::Bool(false)));
}

#[test]
fn a_graph_without_files_has_no_such_buttons() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("no_files");
    let mut window = Window::run(&folder.write("g.toml", crate::common::GRAPH));
    window.until_painted(" fps");
    assert!(window.harness.query_by_label("Pause").is_none() && window.app().playing().is_none());
    window.key(NONE, Key::Q);
    window.until_painted("nothing to play");
}
