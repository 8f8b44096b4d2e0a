//! Foot pedals: which key, as a USB pedal sends it, does what. A settings file says it; without one the keys are F13 to F17 and F20.
//!
//! ```toml
//! [keys]
//! F13 = "next"
//! "Ctrl+B" = "freeze"
//! ```
//!
//! A file with a mistake is not used at all: the usual keys work, and a notice names the mistake.

use std::path::{Path, PathBuf};

use eframe::egui::{Key, Modifiers};
use panoscope_editor_model::disk;
use panoscope_editor_model::pedal::{self, Binding, PedalError};

use super::Action;

/// Maximum size of the file, bytes.
const MAX_BYTES: u64 = 64 << 10;

/// Names of the actions in the file.
pub const NAMES: &[(&str, Action)] = &[
    ("next", Action::Next),
    ("previous", Action::Previous),
    ("freeze", Action::Freeze),
    ("still", Action::Still),
    ("record", Action::Record),
    ("measure", Action::Measure),
    ("stop", Action::Stop),
    ("again", Action::Again),
    ("more", Action::More),
    ("checklist", Action::Checklist),
    ("zoom_in", Action::ZoomIn),
    ("zoom_out", Action::ZoomOut),
    ("inset", Action::Inset),
    ("three_d", Action::ThreeD),
    ("language", Action::Language),
    ("view1", Action::One(0)),
    ("view2", Action::One(1)),
    ("view3", Action::One(2)),
    ("view4", Action::One(3)),
    ("view5", Action::One(4)),
    ("view6", Action::One(5)),
    ("end", Action::End),
];

/// The keys of a pedal without a file.
const USUAL: &[(Key, Action)] = &[
    (Key::F13, Action::Next),
    (Key::F14, Action::Freeze),
    (Key::F15, Action::Still),
    (Key::F16, Action::Record),
    (Key::F17, Action::Measure),
    (Key::F20, Action::Stop),
];

/// A key with its modifiers, and what it does.
pub type PedalKey = (Modifiers, Key, Action);

/// The keys of a pedal.
#[derive(Clone, Debug, PartialEq)]
pub struct Pedal {
    /// The keys.
    pub keys: Vec<PedalKey>,
    /// The file that was read; `None` where there is none.
    pub file: Option<PathBuf>,
    /// Why the file is not used.
    pub problem: Option<String>,
}

impl Default for Pedal {
    fn default() -> Self {
        let keys = USUAL.iter().map(|(key, action)| (Modifiers::NONE, *key, *action)).collect();
        Self { keys, file: None, problem: None }
    }
}

impl Pedal {
    /// Reads a settings file; the usual keys where there is none, or where it has a mistake.
    pub fn load(file: Option<&Path>) -> Self {
        let Some(file) = file.filter(|file| file.exists()) else { return Self::default() };
        let path = Some(file.to_owned());
        match read(file) {
            Ok(keys) => Self { keys, file: path, problem: None },
            Err(reason) => {
                let problem = Some(format!("{}: {reason}", file.display()));
                Self { file: path, problem, ..Self::default() }
            }
        }
    }
}

fn read(file: &Path) -> Result<Vec<PedalKey>, PedalError> {
    let text = disk::read_text(file, MAX_BYTES)?;
    parse(&text.ok_or(PedalError::TooLong { max_kib: MAX_BYTES >> 10 })?)
}

/// Reads the text of a settings file.
///
/// # Errors
/// The first mistake, in words that name the key.
pub fn parse(text: &str) -> Result<Vec<PedalKey>, PedalError> {
    let found = pedal::parse(text, Key::from_name, NAMES)?;
    let key = |Binding { ctrl, shift, alt, key, action }: Binding<Key, Action>| {
        let held = [(ctrl, Modifiers::COMMAND), (shift, Modifiers::SHIFT), (alt, Modifiers::ALT)];
        let held = held.into_iter().filter(|(is_held, _)| *is_held);
        (held.fold(Modifiers::NONE, |all, (_, one)| all.plus(one)), key, action)
    };
    Ok(found.into_iter().map(key).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_read_with_modifiers() {
        let keys =
            parse("[keys]\nF13 = \"still\"\n\"Ctrl+Shift+B\" = \"stop\"\nPageDown = \"view2\"\n").expect("right");
        assert_eq!(keys.len(), 3);
        assert!(keys.contains(&(Modifiers::NONE, Key::F13, Action::Still)));
        assert!(keys.contains(&(Modifiers::COMMAND.plus(Modifiers::SHIFT), Key::B, Action::Stop)));
        assert!(keys.contains(&(Modifiers::NONE, Key::PageDown, Action::One(1))));
    }

    #[test]
    fn mistakes_are_named() {
        for (text, words) in [
            ("[keys]\nF99 = \"still\"", "there is no key `F99`"),
            ("[keys]\nF13 = \"stil\"", "there is no action `stil`; there are next, previous"),
            ("[keys]\nF13 = 3", "the name of an action in quotes"),
            ("[keys]\n\"Hyper+F13\" = \"still\"", "`Hyper` is none of Ctrl, Shift, Alt"),
            ("[keys]\n\"Ctrl+F13\" = \"still\"\n\"ctrl+F13\" = \"next\"", "given twice"),
            ("[keys]\nEscape = \"next\"", "Escape leaves the theatre"),
            ("[keys]\nF13 = \"still\"\nF13 = \"next\"", "duplicate key"),
            ("keys = 3", "not a table"),
            ("[pedal]\n", "no table `[keys]`"),
            ("[keys]\n", "is empty"),
            ("[keys]\nF13 = \"next\"\n[more]\n", "`more` is not known"),
            ("\u{0}\u{7f}", "line 1"),
        ] {
            let error = parse(text).expect_err(text).to_string();
            assert!(error.contains(words), "{text}: {error}");
        }
    }

    #[test]
    fn a_wrong_file_leaves_the_usual_keys() {
        let file = std::env::temp_dir().join(format!("panoscope_pedal_{}.toml", std::process::id()));
        assert_eq!(Pedal::load(Some(&file)), Pedal::default());
        std::fs::write(&file, "[keys]\nF13 = \"fly\"\n").expect("written");
        let pedal = Pedal::load(Some(&file));
        assert_eq!(pedal.keys, Pedal::default().keys);
        assert!(pedal.problem.is_some_and(|problem| problem.contains("fly") && problem.contains("panoscope_pedal")));
        std::fs::remove_file(&file).expect("removed");
    }
}
