//! A whole procedure by pedal and touch: no key of a keyboard, no mouse.

use crate::common::window::Window;
use crate::common::{has_plugin, input};
use crate::procedure::GRAPH;
use eframe::egui::{Key, Pos2, vec2};
use egui_kittest::kittest::Queryable;
use panoscope_theatre::{Layout, Theatre};

/// The middle of a widget.
fn middle(window: &Window, label: &str) -> Pos2 {
    let exact = window.harness.query_by_label(label);
    exact.unwrap_or_else(|| window.harness.get_by_label_contains(label)).rect().center()
}

/// Taps a widget with a finger.
fn tap(window: &mut Window, label: &str) {
    let at = middle(window, label);
    input::touch(&mut window.harness, &[at]);
}

/// Presses a pedal, which the system takes for a key.
fn pedal(window: &mut Window, key: Key) {
    assert!(matches!(key, Key::F13 | Key::F14 | Key::F15 | Key::F16 | Key::F17 | Key::F20));
    window.key(key);
}

#[test]
fn a_whole_procedure_is_driven_by_pedal_and_touch() {
    for plugin in ["flow", "phantom", "stereo", "sinks"] {
        if !has_plugin(plugin) {
            return;
        }
    }
    let mut window = Window::open("touch", GRAPH);
    window.until("a picture", Theatre::has_picture);

    // Views: by pedal, and a tap enlarges one and puts it back.
    pedal(&mut window, Key::F13);
    assert_eq!(window.theatre().layout(), Layout::One(0));
    pedal(&mut window, Key::F13);
    pedal(&mut window, Key::F13);
    assert_eq!(window.theatre().layout(), Layout::All);
    tap(&mut window, "View Scope");
    assert_eq!(window.theatre().layout(), Layout::One(0));
    tap(&mut window, "Layout");
    assert_eq!(window.theatre().layout(), Layout::One(1));
    tap(&mut window, "Layout");
    assert_eq!(window.theatre().layout(), Layout::All);

    // Frozen by pedal, continued by touch.
    pedal(&mut window, Key::F14);
    assert!(window.theatre().is_frozen());
    tap(&mut window, "Continue");
    assert!(!window.theatre().is_frozen());

    // A distance by two taps.
    pedal(&mut window, Key::F17);
    window.until_shown("Measure here");
    let view = window.harness.get_by_label("Measure here").rect();
    for share in [vec2(0.4, 0.5), vec2(0.6, 0.5)] {
        input::touch(&mut window.harness, &[view.min + view.size() * share]);
    }
    window.until("a distance with its error", |t| t.distance().is_some());

    // A still of it with its numbers, then a clip.
    pedal(&mut window, Key::F15);
    window.until("the still is saved", |t| t.remark().is_some_and(|r| r.contains("still_0001.png is saved")));
    tap(&mut window, "Measure");
    assert!(!window.theatre().is_frozen());
    pedal(&mut window, Key::F16);
    window.until("the clip runs", |t| {
        let engine = t.session().expect("it runs here").handle().engine().expect("it runs");
        engine.report().nodes.get("theatre_clip").is_some_and(|node| node.count > 5)
    });
    tap(&mut window, "End clip");
    window.until("the clip is over", |t| t.clip_file().is_none());

    // The arm is stopped by pedal and released by a finger that holds.
    pedal(&mut window, Key::F20);
    assert!(window.theatre().is_stopped());
    window.until_notice("Emergency stop: the arm is stopped");
    let stop = middle(&window, "Release the arm");
    input::touch_down(&mut window.harness, stop);
    window.until("it is released", |t| !t.is_stopped());
    input::steps(&mut window.harness, 5);
    assert!(!window.theatre().is_stopped(), "the finger that released it is still there");
    input::touch_up(&mut window.harness, stop);
    // The next touch stops it, and holding releases it again.
    input::touch_down(&mut window.harness, stop);
    assert!(window.theatre().is_stopped());
    input::touch_up(&mut window.harness, stop);
    input::touch_down(&mut window.harness, stop);
    window.until("it is released again", |t| !t.is_stopped());
    input::touch_up(&mut window.harness, stop);

    // A tap on the button does not end it, holding does.
    let end = middle(&window, "End the theatre");
    input::touch(&mut window.harness, &[end]);
    window.harness.step();
    assert!(!window.theatre().is_closing());
    input::touch_down(&mut window.harness, end);
    window.until("it closes", Theatre::is_closing);
    input::touch_up(&mut window.harness, end);
    assert_eq!(window.kept(), ["clip_0002.mkv", "still_0001.jsonl", "still_0001.png"]);
}
