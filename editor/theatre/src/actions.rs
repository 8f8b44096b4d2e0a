//! The actions of the theatre, what they do, and their keys. Those of a foot pedal are in [`crate::pedal`].

use eframe::egui::{Event, InputState, Key, Modifiers};

use panoscope_editor_model::texts::{language, set_language, text};

use super::measure::Measure;
use super::pedal::PedalKey;
use super::zoom::Zoom;
use super::{Layout, Theatre, time};

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
    /// Zoom into the main view.
    ZoomIn,
    /// Zoom out.
    ZoomOut,
    /// Show another view in a corner of the one that is shown alone, or end that.
    Inset,
    /// Show the stereo pair for a 3-D display: the next way.
    ThreeD,
    /// Speak the next language.
    Language,
    /// End the theatre, held for two seconds.
    End,
}

/// Actions with their keys; the first key is shown.
pub const KEYS: &[(Action, &[Key])] = &[
    (Action::Next, &[Key::Space, Key::PageDown]),
    (Action::Previous, &[Key::PageUp]),
    (Action::Freeze, &[Key::F]),
    (Action::Still, &[Key::S]),
    (Action::Record, &[Key::R]),
    (Action::Measure, &[Key::M]),
    (Action::Stop, &[Key::E]),
    (Action::Again, &[Key::Enter]),
    (Action::More, &[Key::T]),
    (Action::Checklist, &[Key::C]),
    (Action::ZoomIn, &[Key::Plus, Key::Equals]),
    (Action::ZoomOut, &[Key::Minus]),
    (Action::Inset, &[Key::I]),
    (Action::ThreeD, &[Key::D]),
    (Action::Language, &[Key::L]),
    (Action::One(0), &[Key::Num1]),
    (Action::One(1), &[Key::Num2]),
    (Action::One(2), &[Key::Num3]),
    (Action::One(3), &[Key::Num4]),
    (Action::One(4), &[Key::Num5]),
    (Action::One(5), &[Key::Num6]),
];

/// Consumes a key; returns whether it was pressed anew. A key that is held counts once.
fn take(input: &mut InputState, modifiers: Modifiers, key: Key) -> bool {
    let fresh = |e: &Event| matches!(e, Event::Key { key: k, pressed: true, repeat: false, .. } if *k == key);
    let is_new = input.events.iter().any(fresh);
    input.consume_key(modifiers, key) && is_new
}

/// Consumes the keys of a pedal, then those of the keyboard, and returns the actions. Keys in `reserved` are not consumed, except by a pedal.
pub fn pressed(input: &mut InputState, reserved: &[Key], pedal: &[PedalKey]) -> Vec<Action> {
    let mut found = pressed_by_pedal(input, pedal);
    for (action, keys) in KEYS {
        for key in keys.iter().filter(|key| !reserved.contains(key)) {
            if take(input, Modifiers::NONE, *key) {
                found.push(*action);
            }
        }
    }
    found
}

/// As [`pressed`], for the keys of a foot pedal only.
pub fn pressed_by_pedal(input: &mut InputState, pedal: &[PedalKey]) -> Vec<Action> {
    // Keys with more modifiers first, so that Ctrl+B does not count as B.
    let mut keys: Vec<&PedalKey> = pedal.iter().collect();
    keys.sort_by_key(|(m, ..)| std::cmp::Reverse(u8::from(m.command) + u8::from(m.shift) + u8::from(m.alt)));
    keys.into_iter().filter(|(modifiers, key, _)| take(input, *modifiers, *key)).map(|(.., action)| *action).collect()
}

/// Whether a key of a pedal enters a text, so that it does nothing else while one is typed.
pub fn enters_text((modifiers, key, _): &PedalKey) -> bool {
    !modifiers.command && !modifiers.alt && (key.name().chars().count() == 1 || matches!(key, Key::Space | Key::Enter))
}

/// Whether a key of an action is held.
pub fn is_held(input: &InputState, action: Action, pedal: &[PedalKey]) -> bool {
    let keys = KEYS.iter().find(|(known, _)| *known == action).map_or(&[][..], |(_, keys)| keys);
    let by_pedal = pedal.iter().filter(|(.., known)| *known == action).map(|(_, key, _)| key);
    keys.iter().chain(by_pedal).any(|key| input.key_down(*key))
}

/// The name of an action's key, in the language of the window.
pub fn key_name(action: Action) -> &'static str {
    let keys = KEYS.iter().find(|(a, _)| *a == action).map_or(&[][..], |(_, keys)| keys);
    match keys.first() {
        Some(Key::Space) => text!("key-space"),
        Some(Key::Enter) => text!("key-enter"),
        Some(key) => key.name(),
        None => "",
    }
}

impl Theatre {
    /// Performs an action.
    pub fn perform(&mut self, action: Action) {
        let count = self.plan.views.len();
        match action {
            Action::Next => self.layout = self.layout.next(count),
            Action::Previous => self.layout = self.layout.previous(count),
            Action::One(n) if n < count => {
                self.layout = if self.layout == Layout::One(n) { Layout::All } else { Layout::One(n) };
            }
            Action::One(_) => {}
            Action::Freeze if self.shows_raw() => self.notify(text!("view-never-frozen"), false),
            Action::Freeze if self.frozen.is_none() && !self.has_picture() => {
                self.notify(text!("view-no-image-yet"), true)
            }
            Action::Freeze => {
                self.frozen = if self.frozen.is_some() { None } else { Some(time::now()) };
                self.measure = Measure::default();
            }
            Action::Still => self.still(),
            Action::Record | Action::Again if self.machine.is_some() => self.notify(text!("attached-elsewhere"), true),
            Action::Record => self.record(),
            Action::Measure => self.toggle_measuring(),
            // Stopped already: holding releases the arm.
            Action::Stop if self.machine.is_some() => self.notify(text!("attached-elsewhere"), true),
            Action::Stop if self.emergency => self.releasing = Some(time::now()),
            Action::Stop => self.emergency_stop(true),
            Action::Again => self.again(),
            Action::More => self.page += 1,
            Action::Checklist => self.checking ^= true,
            Action::ZoomIn | Action::ZoomOut => self.zoom_by(action == Action::ZoomIn),
            Action::Inset => self.inset ^= true,
            Action::ThreeD => self.next_three_d(),
            Action::Language => {
                set_language(language().next());
                self.notify(text!("language-is"), false);
            }
            // Only holding it ends the theatre.
            Action::End => {}
        }
        if matches!(action, Action::Next | Action::Previous | Action::One(_)) {
            self.zoom = Zoom::default();
            if self.measure.is_on() {
                self.measure = Measure::default();
                self.frozen = None;
            }
        }
    }

    pub(super) fn toggle_measuring(&mut self) {
        if self.measure.is_on() {
            self.measure = Measure::default();
            self.frozen = None;
        } else if self.plan.cloud.is_none() || self.shows_raw() {
            self.notify(text!("measure-none"), true);
        } else {
            self.frozen = None;
            self.measure = Measure::begin();
        }
    }
}
