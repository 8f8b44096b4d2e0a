//! How many clicks, keys, drags and texts the usual tasks take. Whoever needs more has found a step too many.

use std::time::Instant;

use crate::common::{Folder, GRAPH, PATIENCE, Window, has_plugin, input};
use eframe::egui::accesskit::Role;
use eframe::egui::{Key, Modifiers, Pos2, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::observe::Output;
use panoscope_editor_model::session::Phase;

const NONE: Modifiers = Modifiers::NONE;
const SHIFT: Modifiers = Modifiers::SHIFT;

/// Actions of a user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Actions {
    clicks: usize,
    keys: usize,
    drags: usize,
    texts: usize,
}

/// A user whose actions are counted.
struct User {
    window: Window,
    actions: Actions,
}

impl User {
    fn new(window: Window) -> Self {
        Self { window, actions: Actions::default() }
    }

    fn key(&mut self, modifiers: Modifiers, key: Key) {
        self.actions.keys += 1;
        self.window.key(modifiers, key);
    }

    fn node(&mut self, id: &str) {
        self.actions.clicks += 1;
        self.window.select(id);
    }

    fn click(&mut self, label: &str) {
        self.actions.clicks += 1;
        self.window.harness.get_by_label(label).click_accesskit();
        self.window.steps(3);
    }

    fn drag(&mut self, from: Pos2, to: Pos2) {
        self.actions.drags += 1;
        input::drag(&mut self.window.harness, from, to);
    }

    /// Clicks a field, types into it and presses Enter.
    fn fill(&mut self, label: &str, text: &str) {
        (self.actions.clicks, self.actions.texts, self.actions.keys) =
            (self.actions.clicks + 1, self.actions.texts + 1, self.actions.keys + 1);
        input::fill(&mut self.window.harness, label, text);
    }

    /// Opens the palette by a key, types, and takes the first entry once that is `row`.
    fn take(&mut self, key: Key, typed: &str, row: &str) {
        self.key(NONE, key);
        if !typed.is_empty() {
            self.actions.texts += 1;
            self.window.type_text(typed);
        }
        let until = Instant::now() + PATIENCE;
        while self.window.harness.query_by_label(row).is_none() {
            assert!(Instant::now() < until, "`{row}` is not offered for `{typed}`");
            self.window.steps(1);
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        self.key(NONE, Key::Enter);
        self.window.steps(3);
    }

    fn middle(&self, label: &str) -> Pos2 {
        self.window.harness.get_by_label(label).rect().center()
    }

    /// Asserts the number of actions.
    fn took(&self, task: &str, [clicks, keys, drags, texts]: [usize; 4]) {
        println!("{task}: {:?}", self.actions);
        assert_eq!(self.actions, Actions { clicks, keys, drags, texts }, "{task}");
    }
}

#[test]
fn a_panorama_from_an_empty_file() {
    if !["phantom", "stitch", "sinks"].into_iter().all(has_plugin) {
        return;
    }
    let folder = Folder::new("task_panorama");
    let empty = "# A panorama.\nmode = \"live\"\nplugins = []\n";
    let mut user = User::new(Window::open(&folder.write("g.toml", empty)));
    user.window.steps(3);
    user.take(Key::A, "panorama", "Pick panorama_surf");
    user.take(Key::A, "phantom", "Pick phantom");
    user.take(Key::W, "", "Pick connect left, right to panorama_surf");
    user.window.until("it runs", |app| app.session().status().phase == Phase::Running);
    user.node("panorama_surf");
    user.key(NONE, Key::V);
    user.window.until("a panorama is shown", |app| app.has_picture() && app.viewed().is_some());
    user.took("panorama from an empty file", [1, 7, 0, 2]);
}

#[test]
fn a_value_is_tuned() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("task_tune");
    let mut user = User::new(Window::run(&folder.write("g.toml", GRAPH)));
    user.node("mean");
    // By focus and key: the panel moves once the picture of the node arrives, and a drag would miss.
    user.actions.clicks += 1;
    user.window.harness.get_by_role_and_label(Role::Slider, "past_weight").focus();
    user.window.steps(2);
    user.key(NONE, Key::ArrowRight);
    user.window.until("the value is applied", |app| app.document().text().contains("past_weight = 101"));
    user.took("tune", [2, 1, 0, 0]);
}

#[test]
fn a_part_is_made() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("task_part");
    let mut user = User::new(Window::run(&folder.write("g.toml", GRAPH)));
    user.node("mean");
    user.key(SHIFT, Key::N);
    user.key(NONE, Key::K);
    user.window.until_shown("Name of the part");
    user.window.steps(2);
    user.actions.texts += 1;
    user.window.harness.get_by_label("Name of the part").type_text("calm");
    user.window.steps(2);
    user.key(NONE, Key::Enter);
    user.window.until_shown("Node calm");
    user.window.settled();
    user.took("make a part", [1, 3, 0, 1]);
}

#[test]
fn a_wire_is_broken_and_mended() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("task_wire");
    let mut user = User::new(Window::run(&folder.write("g.toml", GRAPH)));
    let wires = |user: &User| user.window.app().document().view().wires.len();
    let before = wires(&user);
    let aside = user.window.app().canvas().rect.left_bottom() + vec2(40.0, -40.0);
    user.drag(user.middle("Input sink.image"), aside);
    assert_eq!(wires(&user), before - 1, "{}", user.window.app().document().text());
    // A node without a wire has another place.
    user.window.steps(3);
    user.drag(user.middle("Output mean.image"), user.middle("Input sink.image"));
    user.window.settled();
    assert_eq!(wires(&user), before);
    user.took("break and mend a wire", [0, 0, 2, 0]);
}

#[test]
fn a_recording_is_opened_and_compared() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("task_recording");
    let mut user = User::new(Window::run(&folder.write("g.toml", GRAPH)));
    user.window.key(SHIFT, Key::J);
    user.window.until("some ticks are recorded", |app| {
        let engine = app.session().handle().engine();
        let is_recorded = app.session().status().recording.is_some();
        is_recorded && engine.is_some_and(|engine| engine.report().nodes["mean"].count > 10)
    });
    user.window.key(SHIFT, Key::J);
    user.window.until("the recording is shown", |app| app.timeline().is_some());
    user.window.click_until_shown("Close recording", "Open recording");
    // From here on, as with a recording of last week.
    user.click("List the recordings");
    user.window.until_painted("g_0001.mcap");
    user.key(NONE, Key::Enter);
    user.window.until("it is open", |app| app.timeline().is_some());
    user.node("b");
    user.key(NONE, Key::V);
    let smoothed = Output::new("mean", "image");
    let until = Instant::now() + PATIENCE;
    while user.window.app().compared_with() != Some(&smoothed) {
        assert!(Instant::now() < until, "it is never compared with mean.image");
        user.key(NONE, Key::C);
    }
    user.window.until_shown("PSNR ");
    user.took("open and compare a recording", [2, 4, 0, 0]);
}

#[test]
fn a_parameter_is_swept() {
    if !has_plugin("flow") {
        return;
    }
    let folder = Folder::new("task_sweep");
    let mut user = User::new(Window::run(&folder.write("g.toml", crate::looks_graph::GRAPH)));
    user.node("level");
    user.key(NONE, Key::S);
    user.window.until_shown("Sweep measure");
    user.fill("Sweep measure", "level.levels.mean");
    user.click("Start the sweep");
    user.window.until("the sweep is done", |app| app.sweep().is_some_and(|progress| progress.done));
    assert_eq!(user.window.app().sweep().expect("a sweep").failed, None);
    user.took("sweep", [3, 2, 0, 1]);
}
