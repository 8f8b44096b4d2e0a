//! What can be done in the theatre, with its keys. A foot pedal sends keys: F13 to F17 and F20 stand for it.

use eframe::egui::{InputState, Key, Modifiers};

/// What can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// The next layout.
    Next,
    /// The layout before.
    Previous,
    /// One view alone.
    One(usize),
    /// Hold the picture still, or let it go on.
    Freeze,
    /// Keep a still.
    Still,
    /// Begin a clip, or end it.
    Record,
    /// Measure, or end it.
    Measure,
    /// Stop the arm.
    Stop,
    /// Start the graph again after it has stopped.
    Again,
    /// Show the settings that there was no room for.
    More,
}

/// Acts with their keys, the first one being shown.
pub const KEYS: &[(Act, &[Key])] = &[
    (Act::Next, &[Key::Space, Key::PageDown, Key::F13]),
    (Act::Previous, &[Key::PageUp]),
    (Act::Freeze, &[Key::F, Key::F14]),
    (Act::Still, &[Key::S, Key::F15]),
    (Act::Record, &[Key::R, Key::F16]),
    (Act::Measure, &[Key::M, Key::F17]),
    (Act::Stop, &[Key::E, Key::F20]),
    (Act::Again, &[Key::Enter]),
    (Act::More, &[Key::T]),
    (Act::One(0), &[Key::Num1]),
    (Act::One(1), &[Key::Num2]),
    (Act::One(2), &[Key::Num3]),
    (Act::One(3), &[Key::Num4]),
    (Act::One(4), &[Key::Num5]),
    (Act::One(5), &[Key::Num6]),
];

/// Takes the acts whose keys were pressed out of the input; a key that is held counts once. Keys in `left` are for something else now.
pub fn pressed(input: &mut InputState, left: &[Key]) -> Vec<Act> {
    let mut found = Vec::new();
    for (act, keys) in KEYS {
        for key in *keys {
            if left.contains(key) {
                continue;
            }
            let fresh = |e: &eframe::egui::Event| matches!(e, eframe::egui::Event::Key { key: k, pressed: true, repeat: false, .. } if k == key);
            let new = input.events.iter().any(fresh);
            if input.consume_key(Modifiers::NONE, *key) && new {
                found.push(*act);
            }
        }
    }
    found
}

/// The key of an act in words.
pub fn key_words(act: Act) -> &'static str {
    let keys = KEYS.iter().find(|(a, _)| *a == act).map_or(&[][..], |(_, keys)| keys);
    keys.first().map_or("", |key| key.name())
}
