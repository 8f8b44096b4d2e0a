//! The theatre of a graph that needs arguments.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::{Folder, PATIENCE, has_plugin};
use eframe::egui::{Key, Ui, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::arguments;
use panoscope_graph::{GraphOptions, GraphText, ParamValue};
use panoscope_theatre::{Guard, Opening, Options, Program, Ready};

const GRAPH: &str = r#"name = "asked"
plugins = ["flow", "fixtures"]

[args.calm]
type = "whole"
doc = "Share of the past in each picture"
range = [0, 255]

[nodes.camera]
type = "frames"
params = { width_px = 64, height_px = 48, rate_hz = 30.0 }

[nodes.mean]
type = "smooth"
inputs = { image = "camera.image" }
params = { past_weight = { arg = "calm" } }

[nodes.sink]
type = "drain"
inputs = { image = "mean.image" }

[preset]
views = ["mean.image"]
pinned = [{ param = "mean.past_weight", range = [0, 255], label = "weight" }]
"#;

struct Window(Harness<'static, Option<Opening>>);

impl Window {
    fn open(path: &Path, given: &GraphOptions, folder: &Folder, guarded: bool) -> Self {
        let (path, given) = (path.to_owned(), given.clone());
        let options = Options { folder: folder.0.join("kept"), ..Options::default() };
        let config = folder.0.join("config");
        let program =
            Program { file: env!("CARGO_BIN_EXE_panoscope-theatre").into(), arguments: vec![path.clone().into()] };
        let draw = move |ui: &mut Ui, opening: &mut Option<Opening>| {
            let open = || {
                let graph = GraphText::load_with(&path, &given).expect("it is there");
                if guarded {
                    let guard = Guard::new(program.clone(), path.clone()).expect("a thread");
                    let opened = graph.missing_args().is_empty().then(|| {
                        guard.prepare(graph.text(), &given);
                        guard.wait_prepared().expect("it opens")
                    });
                    let (given, config, options) = (given.clone(), Some(config.clone()), options.clone());
                    return Opening::guarded(ui.ctx(), &graph, given, opened, config, options, guard).expect("threads");
                }
                let ready = Ready::of(&graph, &options).ok();
                Opening::new(ui.ctx(), &graph, given.clone(), ready, Some(config.clone()), options.clone())
                    .expect("threads")
            };
            opening.get_or_insert_with(open).ui(ui);
        };
        Self(Harness::builder().with_size(vec2(1440.0, 960.0)).build_ui_state(draw, None))
    }

    fn opening(&self) -> &Opening {
        self.0.state().as_ref().expect("it is open")
    }

    fn until(&mut self, what: &str, holds: impl Fn(&Opening) -> bool) {
        let until = Instant::now() + PATIENCE;
        loop {
            self.0.step();
            if holds(self.opening()) {
                return;
            }
            assert!(Instant::now() < until, "waited for: {what}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn weight(&self) -> Option<ParamValue> {
        self.opening().theatre()?.param_values("mean")?.first().cloned()
    }
}

#[test]
fn the_theatre_asks_for_arguments_and_a_panel_changes_them() {
    ask("theatre_form", false);
}

#[test]
fn a_guarded_graph_asks_for_its_arguments_too() {
    ask("theatre_form_guarded", true);
}

fn ask(name: &str, guarded: bool) {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new(name);
    let path = folder.write("g.toml", GRAPH);
    let mut window = Window::open(&path, &GraphOptions::default(), &folder, guarded);
    window.until("the form", |o| o.form().is_some());
    assert!(window.opening().theatre().is_none());
    window.0.get_by_label("Start").click();
    window.until("a reason", |o| o.form().is_some_and(|f| f.problems == ["`calm` needs a value"]));
    window.0.get_by_label("Argument calm").focus();
    window.0.step();
    window.0.key_press(Key::ArrowUp);
    window.0.step();
    window.0.step();
    let first = window.opening().form().expect("the form").values["calm"].clone();
    window.0.get_by_label("Start").click();
    let runs = |o: &Opening| o.theatre().is_some_and(|t| t.param_values("mean").is_some());
    window.until("it runs", runs);
    assert_eq!(window.weight(), Some(ParamValue::Int(first.parse().expect("a number"))));
    assert_eq!(
        arguments::recall(&folder.0.join("config"), &path).expect("remembered").args,
        [("calm".to_owned(), first.clone())]
    );

    window.until("a picture", |o| o.theatre().is_some_and(|t| t.has_picture()));
    window.0.key_press(Key::A);
    window.until("the panel", |o| o.form().is_some());
    window.0.step();
    window.0.get_by_label("Argument calm").focus();
    window.0.step();
    for _ in 0..4 {
        window.0.key_press(Key::ArrowUp);
        window.0.step();
    }
    window.0.step();
    let second = window.opening().form().expect("the panel").values["calm"].clone();
    assert_ne!(first, second);
    window.0.get_by_label("Apply").click();
    window.until("the panel is closed", |o| o.form().is_none());
    let until = Instant::now() + PATIENCE;
    while window.weight() != Some(ParamValue::Int(second.parse().expect("a number"))) {
        assert!(Instant::now() < until, "the value is applied");
        window.0.step();
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(std::fs::read_to_string(&path).expect("read"), GRAPH, "the graph's file is not changed");
    drop(window);

    let given = GraphOptions { args: vec![("calm".to_owned(), "7".to_owned())], ..GraphOptions::default() };
    let mut window = Window::open(&path, &given, &folder, guarded);
    window.until("it runs without a question", runs);
    assert_eq!(window.weight(), Some(ParamValue::Int(7)));
}
