//! The form for arguments and overlays of a graph.

use crate::common::{Folder, Window, has_plugin};
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::{App, Options};
use panoscope_editor_model::arguments;
use panoscope_editor_model::session::Phase;
use panoscope_graph::ParamValue;

const NONE: Modifiers = Modifiers::NONE;

/// A graph that needs a value.
const GRAPH: &str = r#"name = "asked"
plugins = ["flow", "fixtures"]

[args.calm]
type = "whole"
doc = "Share of the past in each picture"
unit = "/256"
range = [0, 255]

[args.shade]
type = "choice"
choices = ["dark", "light"]
default = "dark"

[args.rate]
type = "number"
unit = "Hz"
range = [1, 100]
default = 50

[nodes.b]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = { arg = "rate" } }

[nodes.mean]
type = "smooth"
inputs = { image = "b.image" }
params = { past_weight = { arg = "calm" } }

[nodes.kept]
type = "drain"
inputs = { image = "mean.image" }
"#;

/// Other pictures.
const OVERLAY: &str = r#"# Wide pictures.
plugins = ["flow"]

[nodes.b]
type = "frames"
params = { width_px = 128, height_px = 48 }
"#;

fn weight(app: &App) -> Option<ParamValue> {
    app.session().handle().engine()?.param_values("mean")?.first().cloned()
}

#[test]
fn a_graph_without_values_asks_for_them_and_remembers_them() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("form");
    let path = folder.write("g.toml", GRAPH);
    let config = folder.0.join("config");
    std::fs::create_dir_all(folder.0.join("sources")).expect("a folder");
    folder.write("sources/wide.toml", OVERLAY);
    folder.write("sources/other.toml", "plugins = [\"flow\"]\n[nodes.scope]\ntype = \"frames\"\n");
    let options = Options { config: Some(config.clone()), ..Options::default() };
    let mut window = Window::open_with(&path, options.clone());
    window.until_shown("Arguments of asked");
    for shown in ["Share of the past in each picture", "0 to 255 /256", "required", "Overlay wide", "1 to 100 Hz"] {
        window.until_shown(shown);
    }
    assert!(window.harness.query_by_label("Overlay other").is_none(), "it does not fit");
    assert_eq!(window.app().session().status().phase, Phase::Idle);
    // Without the value it says so and stays.
    window.harness.get_by_label("Start").click();
    window.until_shown("`calm` needs a value");
    assert!(window.app().arguments().is_some());
    window.harness.get_by_label("Argument calm").focus();
    window.steps(2);
    for _ in 0..3 {
        window.key(NONE, Key::ArrowUp);
    }
    let value = window.app().arguments().expect("the form").values["calm"].clone();
    window.harness.get_by_label("Start").click();
    window.until("it runs", |app| app.session().status().phase == Phase::Running);
    let number: i64 = value.parse().expect("a whole number");
    assert!(number > 0, "{number}");
    assert_eq!(weight(window.app()), Some(ParamValue::Int(number)));
    assert_eq!(**window.app().document().text(), *GRAPH, "nothing is written into the graph");
    assert!(!window.app().document().is_changed());
    assert!(arguments::recall(&config, &path).expect("remembered").args.contains(&("calm".to_owned(), value.clone())));

    // Changed while it runs, with an overlay.
    window.key(NONE, Key::I);
    window.until_shown("Arguments of asked");
    window.harness.get_by_label("Overlay wide").click();
    window.steps(2);
    window.harness.get_by_label("Apply").click();
    window.until("the overlay runs", |app| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.param_values("b").is_some_and(|v| v.contains(&ParamValue::Int(128)))
    });
    assert_eq!(weight(window.app()), Some(ParamValue::Int(number)));
    drop(window);

    // The next window offers what was given last, and asks all the same.
    let mut window = Window::open_with(&path, options);
    window.until_shown("Arguments of asked");
    let form = window.app().arguments().expect("the form");
    assert_eq!((form.values["calm"].as_str(), form.with.len()), (value.as_str(), 1));
    window.key(NONE, Key::Enter);
    window.until("it runs", |app| app.session().status().phase == Phase::Running);
    assert_eq!(weight(window.app()), Some(ParamValue::Int(number)));
    assert_eq!(std::fs::read_to_string(&path).expect("read"), GRAPH);
}

#[test]
fn dropped_files_go_into_the_form() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("form_drop");
    let text = format!("[args.left]\ntype = \"source\"\n\n{GRAPH}");
    let mut window = Window::open(&folder.write("g.toml", &text));
    window.until_shown("Arguments of");
    let file = folder.write("l.mp4", "");
    window.harness.state_mut().as_mut().expect("it is open").dropped(vec![file.clone()]);
    window.steps(2);
    assert_eq!(window.app().arguments().expect("the form").values["left"], file.display().to_string());
    assert_eq!(**window.app().document().text(), *text);
    window.key(NONE, Key::Escape);
    window.steps(2);
    assert!(window.app().arguments().is_none());
    window.until_shown("State: the file has mistakes");
}
