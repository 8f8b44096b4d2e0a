//! A whole procedure with the keyboard alone: start, checklist, views, a distance, a still, a clip, the arm stopped and released, a fault and the
//! recovery from it, the end. In each language. The same again by pedal and touch.

use std::cell::RefCell;
use std::collections::BTreeSet;

use crate::common::window::{Window, options};
use crate::common::{Folder, has_plugin, input};
use eframe::egui::Key;
use egui_kittest::kittest::Queryable;
use panoscope_editor_model::texts::{Language, set_language};
use panoscope_graph::{GraphText, check};
use panoscope_host::loader::lock::{ALWAYS_LOCKED, Lock};
use panoscope_host::loader::{self as loader, Loader};
use panoscope_theatre::{Check, Layout, State, Theatre};

/// Stereo cameras on a box that stands still, its surface, an arm, and a stage that fails at the request of a setting.
pub const GRAPH: &str = r#"name = "procedure"
plugins = ["phantom", "stereo", "flow", "fixtures", "sinks"]
[nodes.scope]
type = "phantom"
params = { scene = "box", width = 320, height = 240, speed_mm_s = 0.0, breathing_mm = 0.0 }
[nodes.points]
type = "reproject"
inputs = { image = "scope.left", disparity = "scope.disparity", calibration = "scope.calibration" }
[nodes.polish]
type = "failing"
inputs = { image = "scope.left" }
params = { first = 0, ticks = 0 }
[nodes.arm]
type = "device"
inputs = { image = "polish.image" }
[preset]
views = ["scope.left", "points.cloud"]
pinned = [{ param = "polish.ticks", label = "faults" }]
"#;

/// Moves the focus with Tab until a widget has it.
fn tab_to(window: &mut Window, name: &str) {
    for _ in 0..40 {
        if input::focused(&window.harness).is_some_and(|focused| focused.contains(name)) {
            return;
        }
        window.key(Key::Tab);
    }
    panic!("`{name}` is not reached by Tab; the last is {:?}", input::focused(&window.harness));
}

/// What the window says on the way.
struct Said {
    view: &'static str,
    checklist: &'static str,
    nearly_full: &'static str,
    /// Lines of the checklist; the disk's with the beginning of its name for a screen reader.
    lines: [&'static str; 5],
    check_disk: &'static str,
    measure: &'static str,
    still: &'static str,
    stopped: &'static str,
    fault: &'static str,
}

#[test]
fn a_whole_procedure_is_driven_by_keys_alone() {
    drive(
        Language::English,
        &Said {
            view: "View Scope",
            checklist: "Checklist: ",
            nearly_full: "nearly full",
            lines: ["camera", "Calibration", "Arm arm", "Disk", "Lock"],
            check_disk: "Check Disk: ",
            measure: "Measure here",
            still: "still_0001.png is saved",
            stopped: "Emergency stop: the arm is stopped",
            fault: "Stage `polish`",
        },
    );
}

#[test]
fn a_whole_procedure_is_driven_in_german() {
    drive(
        Language::German,
        &Said {
            view: "Ansicht Scope",
            checklist: "Checkliste: ",
            nearly_full: "fast voll",
            lines: ["Kamera", "Kalibrierung", "Arm arm", "Speicher", "Freigabe"],
            check_disk: "Prüfpunkt Speicher: ",
            measure: "Hier messen",
            still: "still_0001.png ist gespeichert",
            stopped: "Not-Halt: Arm gestoppt",
            fault: "Stufe „polish“",
        },
    );
}

fn drive(language: Language, said: &Said) {
    set_language(language);
    for plugin in ["flow", "phantom", "stereo", "sinks"] {
        if !has_plugin(plugin) {
            return;
        }
    }
    let folder = Folder::new(&format!("procedure_{}", language.code()));
    let path = folder.write("g.toml", GRAPH);
    let text = GraphText::load(&path).expect("it is there");
    let loader = Loader::search(&loader::search_path(&[]));
    let catalog = loader.catalog(&text.plugins());
    let (graph, _) = check(&text, &catalog).into_result().expect("it is right");
    Lock::of(&graph, &catalog, &loader, &text, &ALWAYS_LOCKED).write(&path).expect("it is written");
    let options = options(&folder);

    // Start: the camera's picture, then the checklist until all is ready.
    let mut window = Window::open_with(folder, &path, options);
    window.until("a picture", Theatre::has_picture);
    let wide = window.harness.get_by_label_contains(said.view).rect();
    window.key(Key::C);
    // Each line becomes ready, not all in one moment: on a loaded machine an image is older than 200 ms now and then, and an arm's rate counts
    // half a second. A disk with less than 2 GiB is no fault of the theatre.
    let ready = RefCell::new(BTreeSet::new());
    window.until("all lines are ready", |t| {
        let is_ready = |check: &&Check| check.state == State::Ready || check.words.starts_with(said.nearly_full);
        ready.borrow_mut().extend(t.checklist().iter().filter(is_ready).map(|check| check.name.clone()));
        t.checklist().len() >= 5 && t.checklist().iter().all(|check| ready.borrow().contains(&check.name))
    });
    window.until_shown(said.checklist);
    let names: Vec<String> = window.theatre().checklist().iter().map(|check| check.name.clone()).collect();
    for name in said.lines {
        assert!(names.iter().any(|known| known.contains(name)), "{name}: {names:?}");
    }
    let list = window.harness.get_by_label_contains(said.check_disk).rect();
    let beside = window.harness.get_by_label_contains(said.view).rect();
    assert!(!list.intersects(beside), "the checklist covers no picture: {list:?} {beside:?}");
    window.key(Key::C);
    assert!(!window.theatre().shows_checklist());
    assert_eq!(window.harness.get_by_label_contains(said.view).rect().width(), wide.width());

    // Views.
    window.key(Key::Space);
    assert_eq!(window.theatre().layout(), Layout::One(0));
    window.key(Key::Num2);
    assert_eq!(window.theatre().layout(), Layout::One(1));
    window.key(Key::Num2);
    assert_eq!(window.theatre().layout(), Layout::All);

    // A distance, with its error.
    window.key(Key::M);
    window.until_shown(said.measure);
    for key in [Key::ArrowLeft, Key::ArrowLeft, Key::ArrowLeft, Key::Enter] {
        window.key(key);
    }
    (0..6).for_each(|_| window.key(Key::ArrowRight));
    window.key(Key::Enter);
    window.until("a distance with its error", |t| t.distance().is_some());
    window.key(Key::M);
    assert!(!window.theatre().is_frozen());

    // A still and a clip.
    window.key(Key::S);
    window.until("the still is saved", |t| t.remark().is_some_and(|r| r.contains(said.still)));
    window.key(Key::R);
    window.until("the clip runs", |t| {
        let engine = t.session().expect("it runs here").handle().engine().expect("it runs");
        engine.report().nodes.get("theatre_clip").is_some_and(|node| node.count > 5)
    });
    window.key(Key::R);
    window.until("the clip is over", |t| t.clip_file().is_none());

    // The arm is stopped, and released by holding.
    window.key(Key::E);
    assert!(window.theatre().is_stopped());
    window.until_notice(said.stopped);
    window.harness.key_down(Key::E);
    window.until("it is released", |t| !t.is_stopped());
    window.harness.key_up(Key::E);
    window.harness.step();

    // A fault, and the recovery from it.
    tab_to(&mut window, "aults");
    window.key(Key::ArrowRight);
    window.until_notice(said.fault);
    assert!(window.theatre().has_picture(), "the camera's picture stays");
    window.key(Key::ArrowLeft);
    // On a busy machine pictures may be late for long, which is another notice.
    window.until("it works again", |t| t.notices().iter().all(|notice| !notice.message.contains(said.fault)));

    // The end.
    window.harness.key_down(Key::Escape);
    window.until("it closes", Theatre::is_closing);
    assert_eq!(window.kept(), ["clip_0002.mkv", "still_0001.png"]);
}
