//! What is wrong, where and what to do about it: the tour of problems, and help of nodes.

use crate::common::{Folder, GRAPH, PATIENCE, Window, has_plugin, input, nothing_lost};
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::Options;
use panoscope_graph::GraphText;

const NONE: Modifiers = Modifiers::NONE;
const SHIFT: Modifiers = Modifiers::SHIFT;

#[test]
fn a_tour_leads_through_all_problems() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("tour");
    // A gate that lets nothing through, and a stage that fails with its first tick.
    let text = GRAPH.replace(
        "type = \"smooth\"\ninputs = { image = \"b.image\" }\nparams = { past_weight = 100 } # of 256",
        "type = \"gate\"\ninputs = { image = \"b.image\" }\nparams = { open = false }\n\n\
         [nodes.polish]\ntype = \"failing\"\ninputs = { image = \"b.image\" }\non_fault = \"bypass\"\n\
         params = { first = 5, ticks = 1000000 }\n[nodes.polished]\ntype = \"drain\"\ninputs = { image = \"polish.image\" }",
    );
    let mut window = Window::run(&folder.write("g.toml", &text));
    window.until("the fault is known", |app| {
        app.session().handle().engine().is_some_and(|engine| !engine.recent_faults().is_empty())
    });
    window.steps(3);
    // Counters are read twice per second; faults come with them.
    let until = std::time::Instant::now() + PATIENCE;
    let mut nodes = Vec::new();
    while !(nodes.contains(&"polish".to_owned()) && nodes.contains(&"sink".to_owned())) {
        assert!(std::time::Instant::now() < until, "problems at {nodes:?}");
        window.key(NONE, Key::F8);
        let Some(shown) = window.app().shown_problem().cloned() else { continue };
        window.until_shown("What to do: ");
        assert!(!shown.remedy.is_empty() && !shown.cause.is_empty(), "{shown:?}");
        let node = shown.node.expect("a node");
        assert_eq!(window.app().selected().as_deref(), Some(node.as_str()), "the tour goes there");
        nodes.push(node);
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let last = window.app().shown_problem().expect("a problem").clone();
    window.key(SHIFT, Key::F8);
    assert_ne!(window.app().shown_problem(), Some(&last), "one back");
    window.key(NONE, Key::Escape);
    assert_eq!(window.app().shown_problem(), None);
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn a_graph_without_problems_says_so() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("no_tour");
    let mut window = Window::run(&folder.write("g.toml", GRAPH));
    window.until("every node works", |app| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.report().nodes.values().all(|node| node.count > 10)
    });
    // On a loaded machine ticks may be dropped, which is a problem that the tour shows.
    let until = std::time::Instant::now() + PATIENCE;
    let is_drop = |window: &Window| window.app().shown_problem().is_some_and(|p| p.cause.contains("were dropped"));
    while window.harness.query_by_label_contains("nothing is wrong").is_none() && !is_drop(&window) {
        assert!(std::time::Instant::now() < until, "{:?}", window.app().shown_problem());
        window.key(NONE, Key::Escape);
        window.key(NONE, Key::F8);
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let report = window.close();
    nothing_lost(&folder, &report);
}

#[test]
fn the_help_of_a_node_has_its_limits_and_an_example_that_opens() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("help");
    folder.write("smooth_alone.toml", "plugins = [\"flow\"]\n[nodes.s]\ntype = \"frames\"\n[nodes.m]\ntype = \"smooth\"\ninputs = { image = \"s.image\" }\n");
    // Instead of a window, a program that writes down what it is to open.
    let opener = folder.write("opener.sh", "#!/bin/sh\necho \"$1\" > \"$(dirname \"$0\")/opened\"\n");
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    std::fs::set_permissions(&opener, mode).expect("permissions");
    let options = Options { opener: Some(opener), ..Options::default() };
    let mut window = Window::open_with(&folder.write("g.toml", GRAPH), options);
    window.until("it runs", |app| !app.session().status().running.is_empty());
    window.select("mean");
    window.key(SHIFT, Key::F1);
    window.until_shown("Help of smooth");
    window.until_shown("Limits of past_weight: 0 to 255");
    input::all_named(&window.harness, "node help", 4);
    window.harness.get_by_label("Open example smooth_alone").click_accesskit();
    window.steps(3);
    let until = std::time::Instant::now() + PATIENCE;
    let opened = loop {
        match std::fs::read_to_string(folder.0.join("opened")) {
            Ok(text) if text.ends_with('\n') => break text,
            _ => assert!(std::time::Instant::now() < until, "nothing was opened"),
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    };
    let example = GraphText::load(opened.trim().as_ref()).expect("a graph");
    assert!(example.outline().iter().any(|node| node.type_name == "smooth"));
    window.key(NONE, Key::Escape);
    window.steps(3);
    assert!(window.harness.query_by_label("Help of smooth").is_none());
    // The button in the panel does the same.
    window.harness.get_by_label("Help of the node").click_accesskit();
    window.until_shown("Help of smooth");
    window.key(NONE, Key::Escape);
    window.steps(2);
    let report = window.close();
    nothing_lost(&folder, &report);
}

/// A stage that takes longer than the time between two ticks of its source.
fn slow_graph() -> String {
    GRAPH.replace(
        "type = \"smooth\"\ninputs = { image = \"b.image\" }\nparams = { past_weight = 100 } # of 256",
        "type = \"pass_blocking\"\ninputs = { image = \"b.image\" }\nparams = { wait_ms = 60.0 }",
    )
}

#[test]
fn a_click_on_a_drop_shows_the_path_of_the_tick_that_was_in_its_way() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("trace");
    let mut window = Window::run(&folder.write("g.toml", &slow_graph()));
    window.until("ticks are dropped", |app| {
        let engine = app.session().handle().engine().expect("it runs");
        engine.report().nodes["b"].dropped > 3
    });
    window.select("b");
    // Counters are read twice per second.
    window.until_shown("Why ticks are dropped");
    window.click_until_shown("Why ticks are dropped", "which was in the way of tick");
    let path = window.app().trace_panel().path().expect("a path").clone();
    let nodes: Vec<&str> = path.steps.iter().map(|step| step.node.as_str()).collect();
    assert_eq!(nodes, ["b", "mean", "sink"]);
    let slow = &path.steps[1];
    assert!(slow.work_ms() > 50.0 && slow.after.as_deref() == Some("b"), "{slow:?}");
    assert!(path.steps.windows(2).all(|pair| pair[0].end_ms <= pair[1].start_ms), "{path:?}");
    window.until_shown("`mean` worked longest");
    let reason = window.app().trace_panel().list()[0].dropped.clone().expect("the newest drop");
    assert!(reason.at == ["mean"] || reason.at == ["sink"], "{reason:?}");
    let late = window.app().trace_panel().list().iter().filter(|entry| entry.dropped.is_none());
    assert!(late.clone().any(|entry| entry.source == "b" && entry.total_ms > 50.0), "late ticks are listed");
    // From a step to its node.
    window.harness.get_by_label_contains("Step mean: ").click_accesskit();
    window.steps(2);
    assert_eq!(window.app().selected().as_deref(), Some("mean"));
    let report = window.close();
    nothing_lost(&folder, &report);
}
