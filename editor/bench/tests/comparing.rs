//! Two branches of a graph in numbers, one value over another, and how a value spreads over time.

use crate::common::{Folder, GRAPH, Window, has_plugin, input};
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::comparing::Measures;
use panoscope_editor_model::observe::Output;

const NONE: Modifiers = Modifiers::NONE;

#[test]
fn two_branches_are_compared_side_by_side_and_in_numbers() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("numbers");
    let past = "image = \"b.image\", past = { from = \"mean.image\", delay = 1 }";
    let text = GRAPH.replacen("image = \"b.image\"", past, 1).replace("past_weight = 100", "past_weight = 250");
    let mut window = Window::run(&folder.write("g.toml", &text));
    window.select("b");
    window.key(NONE, Key::V);
    window.until_shown("Viewer of b.image");
    assert!(window.app().comparison().is_none());
    // Each output in its turn, until the smoothed one.
    let second = Output::new("mean", "image");
    let until = std::time::Instant::now() + crate::common::PATIENCE;
    while window.app().compared_with() != Some(&second) {
        assert!(std::time::Instant::now() < until, "it is never compared with mean.image");
        window.key(NONE, Key::C);
    }
    window.until("numbers of one tick", |app| app.comparison().is_some_and(|found| found.measures.is_some()));
    let found = window.app().comparison().expect("it is compared");
    match found.measures {
        // An average of shifted ramps resembles the newest one.
        Some(Measures::Images { psnr_db, ssim }) => {
            assert!((5.0..80.0).contains(&psnr_db) && (-1.0..=1.0).contains(&ssim), "{psnr_db} dB, {ssim}");
        }
        other => panic!("{other:?}"),
    }
    window.until_shown("PSNR ");
    window.harness.get_by_label("Side by side").click_accesskit();
    window.steps(3);
    let painted = window.painted_at();
    let at = |name: &str| {
        let below_the_bar = painted.iter().filter(|(text, rect)| text == name && rect.top() > 100.0);
        below_the_bar.map(|(_, rect)| *rect).next().unwrap_or_else(|| panic!("no `{name}`: {painted:?}"))
    };
    let (left, right) = (at("b.image"), at("mean.image"));
    assert!((left.top() - right.top()).abs() < 1.0 && left.right() < right.left(), "{left:?} {right:?}");
    // Other sizes have no numbers, and say so.
    let first = Output::new("a", "image");
    while window.app().compared_with() != Some(&first) {
        assert!(std::time::Instant::now() < until, "it is never compared with a.image");
        window.key(NONE, Key::C);
    }
    window.until_shown("no tick of both outputs yet");
}

#[test]
fn a_comparison_with_an_output_that_sends_nothing_says_so() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("shut");
    let shut = "\n[nodes.shut]\ntype = \"gate\"\ninputs = { image = \"b.image\" }\nparams = { open = false }\n";
    let mut window = Window::run(&folder.write("g.toml", &format!("{GRAPH}{shut}")));
    window.select("b");
    window.key(NONE, Key::V);
    window.until("a picture", |app| app.has_picture());
    let until = std::time::Instant::now() + crate::common::PATIENCE;
    while window.app().compared_with() != Some(&Output::new("shut", "image")) {
        assert!(std::time::Instant::now() < until, "it is never compared with shut.image");
        window.key(NONE, Key::C);
    }
    window.until_shown("no tick of both outputs yet");
}

#[test]
fn a_value_is_plotted_over_another_and_its_spread_over_time() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("scatter");
    let mut window = Window::run(&folder.write("g.toml", crate::looks_graph::GRAPH));
    window.key(NONE, Key::P);
    window.harness.get_by_label("One over another").click_accesskit();
    window.until_painted(" pairs");
    input::all_named(&window.harness, "one value over another", 8);
    window.harness.get_by_label("Histogram over time").click_accesskit();
    window.until_painted("standard deviation");
    assert!(!window.painted().iter().any(|text| text == "Across"), "a histogram is of one value");
}
