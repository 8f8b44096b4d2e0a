//! Pointer and key input for tests of both windows.

use eframe::egui::accesskit::{Action, Role};
use eframe::egui::{Event, Key, Modifiers, PointerButton, Pos2, TouchDeviceId, TouchId, TouchPhase};
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};

/// Presses and releases the pointer at one position.
pub fn tap<S>(harness: &mut Harness<'_, S>, at: Pos2) {
    drag(harness, at, at);
}

/// Presses the pointer at one position and releases it at another.
pub fn drag<S>(harness: &mut Harness<'_, S>, from: Pos2, to: Pos2) {
    harness.hover_at(from);
    harness.step();
    harness.drag_at(from);
    harness.step();
    if from != to {
        for share in [0.3, 0.7, 1.0] {
            harness.hover_at(from + (to - from) * share);
            harness.step();
        }
    }
    harness.drop_at(to);
    harness.step();
    harness.step();
}

/// Types into a named field and moves the focus away.
pub fn fill<S>(harness: &mut Harness<'_, S>, label: &str, text: &str) {
    harness.get_by_label(label).focus();
    steps(harness, 2);
    harness.key_press_modifiers(Modifiers::COMMAND, Key::A);
    harness.get_by_label(label).type_text(text);
    harness.key_press_modifiers(Modifiers::NONE, Key::Enter);
    steps(harness, 4);
}

pub fn steps<S>(harness: &mut Harness<'_, S>, count: usize) {
    (0..count).for_each(|_| harness.step());
}

/// Roles of interactive widgets.
const TOUCHED: [Role; 13] = [
    Role::Button,
    Role::CheckBox,
    Role::ComboBox,
    Role::Slider,
    Role::SpinButton,
    Role::TextInput,
    Role::MultilineTextInput,
    Role::Link,
    Role::RadioButton,
    Role::ListBoxOption,
    Role::MenuItem,
    Role::Tab,
    Role::Switch,
];

/// Asserts that every interactive widget has a name, and that there are at least `at_least` of them.
pub fn all_named<S>(harness: &Harness<'_, S>, what: &str, at_least: usize) {
    let all = harness.root().children_recursive();
    let touched: Vec<_> = all.filter(|node| TOUCHED.contains(&node.accesskit_node().role())).collect();
    let nameless = touched.iter().filter(|node| {
        let node = node.accesskit_node();
        let named = node.label().is_some_and(|label| !label.trim().is_empty());
        !named && node.labelled_by().next().is_none()
    });
    let nameless: Vec<String> =
        nameless.map(|node| format!("{:?} at {:?}", node.accesskit_node().role(), node.rect())).collect();
    assert!(nameless.is_empty(), "{what}: {nameless:#?}");
    let count = touched.len();
    assert!(count >= at_least, "{what}: only {count} interactive widgets");
}

/// Names of all widgets that can have the focus, of any role; a nameless one is listed by its position.
pub fn focusable<S>(harness: &Harness<'_, S>) -> Vec<String> {
    let all = harness.root().children_recursive();
    let takes = all.filter(|node| {
        let node = node.accesskit_node();
        node.data().supports_action(Action::Focus) && !node.is_disabled()
    });
    takes
        .map(|node| node.accesskit_node().label().unwrap_or_else(|| format!("nameless at {:?}", node.rect())))
        .collect()
}

/// Name of the focused widget.
pub fn focused<S>(harness: &Harness<'_, S>) -> Option<String> {
    let mut all = harness.root().children_recursive();
    all.find(|node| node.accesskit_node().is_focused()).and_then(|node| node.accesskit_node().label())
}

/// Names of the widgets that Tab reaches in one round.
pub fn round_by_tab<S>(harness: &mut Harness<'_, S>) -> Vec<String> {
    let mut round: Vec<String> = Vec::new();
    for _ in 0..200 {
        harness.key_press_modifiers(Modifiers::NONE, Key::Tab);
        steps(harness, 2);
        match focused(harness) {
            Some(name) if round.first() == Some(&name) => break,
            Some(name) => round.push(name),
            None if round.is_empty() => {}
            None => break,
        }
    }
    round
}

/// Touches the screen at a position, moves the finger through others, and lifts it at the last one; sent as the window's system sends it.
pub fn touch<S>(harness: &mut Harness<'_, S>, path: &[Pos2]) {
    let (Some(first), Some(last)) = (path.first(), path.last()) else { return };
    touch_down(harness, *first);
    for at in &path[1..] {
        harness.event(touch_event(TouchPhase::Move, *at));
        harness.event(Event::PointerMoved(*at));
        harness.step();
    }
    touch_up(harness, *last);
}

/// Puts a finger on the screen.
pub fn touch_down<S>(harness: &mut Harness<'_, S>, at: Pos2) {
    harness.event(touch_event(TouchPhase::Start, at));
    harness.event(Event::PointerMoved(at));
    harness.event(button(at, true));
    steps(harness, 2);
}

/// Lifts the finger.
pub fn touch_up<S>(harness: &mut Harness<'_, S>, at: Pos2) {
    harness.event(touch_event(TouchPhase::End, at));
    harness.event(button(at, false));
    harness.event(Event::PointerGone);
    steps(harness, 2);
}

fn touch_event(phase: TouchPhase, pos: Pos2) -> Event {
    Event::Touch { device_id: TouchDeviceId(1), id: TouchId(1), phase, pos, force: None }
}

fn button(pos: Pos2, pressed: bool) -> Event {
    Event::PointerButton { pos, button: PointerButton::Primary, pressed, modifiers: Modifiers::NONE }
}
