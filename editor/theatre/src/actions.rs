//! The actions of the theatre and their keys. The keys F13 to F17 and F20 are for a foot pedal.

use eframe::egui::{InputState, Key, Modifiers};

/// An action of the theatre.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Switch to the next layout.
    Next,
    /// Switch to the previous layout.
    Previous,
    /// Show one view alone.
    One(usize),
    /// Freeze the images, or continue.
    Freeze,
    /// Save a still.
    Still,
    /// Start or end a clip.
    Record,
    /// Start or end measuring.
    Measure,
    /// Stop the arm.
    Stop,
    /// Start the graph again after it has stopped.
    Again,
    /// Show the next page of settings.
    More,
    /// Show or hide the checklist.
    Checklist,
}

/// Actions with their keys; the first key is shown.
pub const KEYS: &[(Action, &[Key])] = &[
    (Action::Next, &[Key::Space, Key::PageDown, Key::F13]),
    (Action::Previous, &[Key::PageUp]),
    (Action::Freeze, &[Key::F, Key::F14]),
    (Action::Still, &[Key::S, Key::F15]),
    (Action::Record, &[Key::R, Key::F16]),
    (Action::Measure, &[Key::M, Key::F17]),
    (Action::Stop, &[Key::E, Key::F20]),
    (Action::Again, &[Key::Enter]),
    (Action::More, &[Key::T]),
    (Action::Checklist, &[Key::C]),
    (Action::One(0), &[Key::Num1]),
    (Action::One(1), &[Key::Num2]),
    (Action::One(2), &[Key::Num3]),
    (Action::One(3), &[Key::Num4]),
    (Action::One(4), &[Key::Num5]),
    (Action::One(5), &[Key::Num6]),
];

/// Consumes the keys of actions and returns the actions; a key that is held counts once. Keys in `reserved` are not consumed.
pub fn pressed(input: &mut InputState, reserved: &[Key]) -> Vec<Action> {
    let mut found = Vec::new();
    for (action, keys) in KEYS {
        for key in *keys {
            if reserved.contains(key) {
                continue;
            }
            let fresh = |e: &eframe::egui::Event| matches!(e, eframe::egui::Event::Key { key: k, pressed: true, repeat: false, .. } if k == key);
            let new = input.events.iter().any(fresh);
            if input.consume_key(Modifiers::NONE, *key) && new {
                found.push(*action);
            }
        }
    }
    found
}

/// As [`pressed`], for the keys of a foot pedal only.
pub fn pressed_by_pedal(input: &mut InputState) -> Vec<Action> {
    let pedal = [Key::F13, Key::F14, Key::F15, Key::F16, Key::F17, Key::F20];
    let others: Vec<Key> =
        KEYS.iter().flat_map(|(_, keys)| keys.iter().copied()).filter(|key| !pedal.contains(key)).collect();
    pressed(input, &others)
}

/// The name of an action's key.
pub fn key_name(action: Action) -> &'static str {
    let keys = KEYS.iter().find(|(a, _)| *a == action).map_or(&[][..], |(_, keys)| keys);
    keys.first().map_or("", |key| key.name())
}
