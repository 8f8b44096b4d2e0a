//! The theatre on a graph that runs on another machine.

use std::time::Duration;

use crate::attachable::{Attachable, free_address};
use crate::common::window::{GRAPH, Window, options};
use crate::common::{Folder, has_plugin};
use crate::theatre::lengths::{MEASURED, measure};
use eframe::egui::{Ui, vec2};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use panoscope_graph::ParamValue;
use panoscope_host::attach::{Attachment, Target};
use panoscope_theatre::{Action, Theatre};

const THEATRE: &str = env!("CARGO_BIN_EXE_panoscope-theatre");

/// Runs a graph at an address and attaches a window to it.
fn attached(folder: Folder, graph: &str, address: &str, allows: &[&str]) -> Option<(Attachable, Window)> {
    let running = Attachable::start(THEATRE, &folder.write("g.toml", graph), address, allows);
    let Some(running) = running else {
        panoscope_testing::skipped!("there is no program `panoscope`");
        return None;
    };
    let target = Target::find(&format!("engine@{address}"), None).expect("a target");
    let mut attachment = Some(Attachment::open(target).expect("a thread"));
    let options = options(&folder);
    let draw = move |ui: &mut Ui, theatre: &mut Option<Theatre>| {
        let open = || {
            let attachment = attachment.take().expect("it is opened once");
            let opened = Theatre::attached(ui.ctx(), attachment, Duration::from_secs(30), options.clone());
            opened.unwrap_or_else(|error| panic!("{error}"))
        };
        theatre.get_or_insert_with(open).ui(ui);
    };
    let textures = panoscope_editor_widgets::golden::Textures::default();
    let builder = Harness::builder().with_size(vec2(1440.0, 960.0)).renderer(textures.clone());
    let mut window = Window { harness: builder.build_ui_state(draw, None), folder, textures, guard: None };
    window.until("a picture", Theatre::has_picture);
    Some((running, window))
}

fn past_weight(theatre: &Theatre) -> Option<i64> {
    theatre.param_values("calm")?.iter().find_map(|value| match value {
        ParamValue::Int(number) => Some(*number),
        _ => None,
    })
}

fn says(theatre: &Theatre, words: &str) -> bool {
    theatre.notices().iter().any(|notice| notice.message.contains(words))
}

#[test]
fn it_shows_what_runs_elsewhere_and_says_that_it_has_no_stop() {
    if !has_plugin("flow") {
        return;
    }
    let Some((_running, mut window)) = attached(Folder::new("attached_reads"), GRAPH, &free_address(), &[]) else {
        return;
    };
    window.until("the note", |t| says(t, "Attached to engine: no emergency stop from here"));
    window.until("a young picture", |t| t.camera_age_ms().is_some_and(|age| age < 500.0));
    assert!(window.theatre().plan().settings.is_empty(), "it only reads");
    for action in [Action::Record, Action::Again, Action::Stop] {
        window.harness.state_mut().as_mut().expect("it is open").perform(action);
        assert!(window.theatre().remark().is_some_and(|remark| remark.contains("where the graph runs")), "{action:?}");
    }
    assert!(window.harness.query_by_label("Emergency stop of the arm").is_none());
    window.harness.state_mut().as_mut().expect("it is open").perform(Action::Checklist);
    window.until("the clock in the checklist", |t| {
        t.checklist().iter().any(|line| line.name == "Machine engine" && line.words.contains("ages are right to"))
    });
}

#[test]
fn it_sets_what_the_preset_pins_where_it_may_and_comes_back_after_a_loss() {
    if !has_plugin("flow") {
        return;
    }
    let allows = ["--allow-edit", "unnamed"];
    let address = free_address();
    let Some((running, mut window)) = attached(Folder::new("attached_edits"), GRAPH, &address, &allows) else { return };
    window.until("its values", |t| past_weight(t) == Some(100));
    for weight in [120, 130, 140] {
        // Faster than the machine answers: none is lost.
        let theatre = window.harness.state_mut().as_mut().expect("it is open");
        theatre.choose("calm", "past_weight", ParamValue::Int(weight));
        window.harness.step();
    }
    window.until("the setting there", |t| past_weight(t) == Some(140));
    assert!(!window.theatre().notices().iter().any(|notice| notice.message.contains("changed elsewhere")));
    drop(running);
    window.until("what happened", |t| says(t, "engine is not reached"));
    assert!(!says(window.theatre(), "camera lost"), "nothing is known of its cameras");
    let graph = window.folder.0.join("g.toml");
    let _running = Attachable::start(THEATRE, &graph, &address, &allows).expect("a program");
    window.until("it is back", |t| says(t, "Attached to engine") && past_weight(t) == Some(100));
    window.until("a young picture", |t| t.camera_age_ms().is_some_and(|age| age < 500.0));
}

/// Without the confidence every length has its widest bound.
#[test]
fn lengths_on_another_machine_have_the_confidence_of_their_disparities() {
    if !has_plugin("phantom") || !has_plugin("stereo") {
        return;
    }
    let folder = Folder::new("attached_measures");
    let Some((_running, mut window)) = attached(folder, MEASURED, &free_address(), &[]) else { return };
    assert_eq!(measure(&mut window), [true; 2]);
}
