//! Every kind of notice: its urgency, its text, its usual cause and what to do. The README has the same table, which a test compares.
//!
//! Ideas of IEC 60601-1-8 that are followed: three priorities that differ by colour, sign and size, the most urgent first, each with its cause in
//! plain words, shown until the cause is gone. No sound is made, and no compliance is claimed.

use panoscope_editor_model::texts;

/// Urgency of a notice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Urgency {
    /// For information: gray.
    Note,
    /// Needs attention soon: yellow, with a sign.
    Warning,
    /// Needs attention now: orange, with a sign.
    Alarm,
}

/// A kind of notice. Its words are in the files of texts, under one name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alarm {
    /// Its urgency.
    pub urgency: Urgency,
    /// The name of its text.
    pub name: &'static str,
    cause: &'static str,
    action: &'static str,
}

impl Alarm {
    /// The usual cause, in the language of the window.
    pub fn cause(&self) -> &'static str {
        texts::plain(self.cause)
    }

    /// What to do, in the language of the window.
    pub fn action(&self) -> &'static str {
        texts::plain(self.action)
    }
}

macro_rules! alarms {
    ($($name:ident = $urgency:ident, $text:literal;)*) => {
        $(
            #[doc = $text]
            pub const $name: Alarm = {
                texts::assert_declared(concat!($text, ".cause"), &[]);
                texts::assert_declared(concat!($text, ".action"), &[]);
                let (cause, action) = (concat!($text, ".cause"), concat!($text, ".action"));
                Alarm { urgency: Urgency::$urgency, name: $text, cause, action }
            };
        )*
        /// All kinds, the most harmful first: the order in which notices are shown.
        pub const ALL: &[Alarm] = &[$($name),*];
    };
}

alarms! {
    NO_IMAGE = Alarm, "alarm-no-image";
    RESTARTING = Alarm, "alarm-restarting";
    MACHINE_LOST = Alarm, "alarm-machine-lost";
    CAMERA_LOST = Alarm, "alarm-camera-lost";
    CAMERA_STUCK = Alarm, "alarm-camera-stuck";
    EMERGENCY = Alarm, "alarm-emergency";
    SWAPPED = Alarm, "alarm-swapped";
    WAS_SWAPPED = Alarm, "alarm-was-swapped";
    STALE_IMAGE = Alarm, "alarm-image-stale";
    DRIFTED = Alarm, "alarm-drifted";
    OUT_OF_STEP = Alarm, "alarm-out-of-step";
    CAMERA_ONLY = Alarm, "alarm-camera-only";
    STOPPED = Alarm, "alarm-stopped";
    VIEW_STOPPED = Alarm, "alarm-view-stopped";
    STAGE = Alarm, "alarm-stage";
    DISK_FULL = Alarm, "alarm-disk-full";
    ENDED = Warning, "alarm-ended";
    OLD_IMAGE = Warning, "alarm-image-old";
    NOT_CHANGED = Warning, "alarm-not-changed";
    DISK_LOW = Warning, "alarm-disk-low";
    AUDIT = Warning, "alarm-audit";
    PEDAL = Warning, "alarm-pedal";
    ATTACHED = Note, "alarm-attached";
    UNLIKE = Note, "alarm-unlike";
    UNLOCKED = Note, "alarm-unlocked";
    PUBLIC = Note, "alarm-public";
}

impl Alarm {
    /// Its place in the order of notices, from 0: the most harmful first.
    pub fn rank(&self) -> usize {
        ALL.iter().position(|alarm| alarm.name == self.name).unwrap_or(ALL.len())
    }
}

#[cfg(test)]
mod tests {
    use panoscope_editor_model::texts::{Language, Value};

    use super::*;

    #[test]
    fn the_most_urgent_come_first_and_each_says_what_to_do() {
        assert!(ALL.is_sorted_by_key(|alarm| std::cmp::Reverse(alarm.urgency)));
        for language in Language::ALL {
            texts::set_language(language);
            for alarm in ALL {
                assert!(!alarm.cause().is_empty() && !alarm.action().is_empty(), "{alarm:?}");
                assert!(alarm.cause() != alarm.action(), "{alarm:?}");
            }
        }
    }

    #[test]
    fn the_readme_has_the_same_table() {
        let readme =
            std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../README.md")).expect("it is there");
        // What changes is in capitals.
        let text = |alarm: &Alarm| {
            let (_, variables) = texts::declared().iter().find(|(name, _)| *name == alarm.name).expect("a text");
            let values: Vec<(&str, Value)> =
                variables.iter().map(|name| (*name, Value::from(name.to_uppercase()))).collect();
            texts::filled(alarm.name, &values)
        };
        let row = |alarm: &Alarm| {
            let urgency = format!("{:?}", alarm.urgency).to_lowercase();
            format!("| {urgency} | {} | {} | {} |", text(alarm), alarm.cause(), alarm.action())
        };
        let missing: Vec<String> = ALL.iter().map(row).filter(|row| !readme.contains(row)).collect();
        assert!(missing.is_empty(), "the README lacks:\n{}", missing.join("\n"));
        let rows = readme.lines().filter(|line| line.starts_with("| alarm |") || line.starts_with("| warning |"));
        let notes = readme.lines().filter(|line| line.starts_with("| note |"));
        assert_eq!(rows.count() + notes.count(), ALL.len());
    }
}
