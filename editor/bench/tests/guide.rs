//! The guided tour of the first start: shown once, each stop ends by what it asks for, skipped by a key.

use crate::common::{Folder, GRAPH, Window, has_plugin, input, nothing_lost};
use eframe::egui::{Key, Modifiers};
use egui_kittest::kittest::Queryable;
use panoscope_editor::app::Options;

const NONE: Modifiers = Modifiers::NONE;
const CTRL: Modifiers = Modifiers::COMMAND;

#[test]
fn the_first_start_is_guided_once_while_frames_flow() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("guide");
    let options = Options { config: Some(folder.0.join("config")), ..Options::default() };
    let path = folder.write("g.toml", GRAPH);
    let mut window = Window::open_with(&path, options.clone());
    window.until_shown("Tour 1 of 6");
    input::all_named(&window.harness, "guide", 4);
    window.harness.get_by_label("Next stop").click_accesskit();
    window.until_shown("Tour 2 of 6");
    window.select("mean");
    window.until("a selected node ends the stop", |app| app.guide_stop() == Some(2));
    window.key(CTRL, Key::K);
    window.type_text("past");
    window.until_shown("Pick mean.past_weight");
    window.key(NONE, Key::Enter);
    window.steps(3);
    window.key(NONE, Key::ArrowRight);
    window.until("a changed value ends the stop", |app| app.guide_stop() == Some(3));
    window.key(NONE, Key::Escape);
    window.until("a key skips it", |app| app.guide_stop().is_none());
    let report = window.close();
    nothing_lost(&folder, &report);

    // It does not come again by itself, and comes when it is asked for.
    let mut window = Window::open_with(&path, options);
    window.steps(5);
    assert_eq!(window.app().guide_stop(), None);
    window.key(CTRL, Key::F1);
    window.until_shown("Tour 1 of 6");
    window.harness.get_by_label("Skip the tour").click_accesskit();
    window.steps(3);
    assert_eq!(window.app().guide_stop(), None);
}
