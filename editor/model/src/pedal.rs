//! The settings file of a foot pedal: which key does what. Knows no window: keys are what the caller makes of their names.
//!
//! ```toml
//! [keys]
//! F13 = "next"
//! "Ctrl+B" = "freeze"
//! ```

/// A key with its modifiers, and what it does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Binding<K, A> {
    /// Whether Ctrl is held.
    pub ctrl: bool,
    /// Whether Shift is held.
    pub shift: bool,
    /// Whether Alt is held.
    pub alt: bool,
    /// The key.
    pub key: K,
    /// What it does.
    pub action: A,
}

/// The first mistake of a settings file.
#[derive(Debug, thiserror::Error)]
pub enum PedalError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] std::io::Error),
    /// The file is too large.
    #[error("it has more than {max_kib} KiB")]
    TooLong {
        /// The limit, KiB.
        max_kib: u64,
    },
    /// The file is not TOML.
    #[error("{problem}")]
    Syntax {
        /// The mistake, with its line.
        problem: String,
    },
    /// There is no table of keys.
    #[error("there is no table `[keys]`")]
    NoKeys,
    /// `keys` is something else.
    #[error("`keys` is not a table")]
    NoTable,
    /// The table is empty.
    #[error("`[keys]` is empty")]
    Empty,
    /// Something else is in the file.
    #[error("`{name}` is not known; only `[keys]` is")]
    Unknown {
        /// Its name.
        name: String,
    },
    /// A key has no action.
    #[error("`{name}`: the name of an action in quotes is expected")]
    NoText {
        /// The key.
        name: String,
    },
    /// There is no such action.
    #[error("`{name}`: there is no action `{action}`; there are {known}")]
    NoAction {
        /// The key.
        name: String,
        /// The action in the file.
        action: String,
        /// The names of all actions.
        known: String,
    },
    /// There is no such modifier.
    #[error("`{name}`: `{modifier}` is none of Ctrl, Shift, Alt")]
    NoModifier {
        /// The key with its modifiers.
        name: String,
        /// The modifier in the file.
        modifier: String,
    },
    /// There is no such key.
    #[error("`{name}`: there is no key `{key}`; keys are named F13, B, 7, PageDown, Space")]
    NoKey {
        /// The key with its modifiers.
        name: String,
        /// The key in the file.
        key: String,
    },
    /// Escape has a use of its own.
    #[error("`{name}`: Escape leaves the theatre and has no other use")]
    Reserved {
        /// The key with its modifiers.
        name: String,
    },
    /// A key is there twice, perhaps under two names.
    #[error("the key `{name}` is given twice")]
    Twice {
        /// The second one.
        name: String,
    },
}

/// Reads the text of a settings file. `key` knows the keys by their names; the one called `Escape` is refused.
///
/// # Errors
/// The first mistake, in words that name the key.
pub fn parse<K: Copy + PartialEq, A: Copy>(
    text: &str,
    key: impl Fn(&str) -> Option<K>,
    actions: &[(&str, A)],
) -> Result<Vec<Binding<K, A>>, PedalError> {
    let syntax = |error: toml::de::Error| PedalError::Syntax { problem: error.to_string().trim().to_owned() };
    let mut table: toml::Table = text.parse().map_err(syntax)?;
    let keys = table.remove("keys").ok_or(PedalError::NoKeys)?;
    if let Some(name) = table.keys().next() {
        return Err(PedalError::Unknown { name: name.clone() });
    }
    let keys = keys.as_table().ok_or(PedalError::NoTable)?;
    if keys.is_empty() {
        return Err(PedalError::Empty);
    }
    let mut found: Vec<Binding<K, A>> = Vec::new();
    for (name, value) in keys {
        let action = value.as_str().ok_or_else(|| PedalError::NoText { name: name.clone() })?;
        let known = actions.iter().find(|(known, _)| *known == action);
        let (_, action) = known.ok_or_else(|| PedalError::NoAction {
            name: name.clone(),
            action: action.to_owned(),
            known: actions.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "),
        })?;
        let binding = binding(name, &key, *action)?;
        let is_same = |other: &Binding<K, A>| {
            (other.ctrl, other.shift, other.alt, other.key) == (binding.ctrl, binding.shift, binding.alt, binding.key)
        };
        if found.iter().any(is_same) {
            return Err(PedalError::Twice { name: name.clone() });
        }
        found.push(binding);
    }
    Ok(found)
}

/// A key such as `F13` or `Ctrl+Shift+B`.
fn binding<K: PartialEq, A>(
    name: &str,
    key: &impl Fn(&str) -> Option<K>,
    action: A,
) -> Result<Binding<K, A>, PedalError> {
    let mut parts: Vec<&str> = name.split('+').map(str::trim).collect();
    let last = parts.pop().unwrap_or_default();
    let (mut ctrl, mut shift, mut alt) = (false, false, false);
    for part in parts {
        match part.to_ascii_lowercase().as_str() {
            "ctrl" => ctrl = true,
            "shift" => shift = true,
            "alt" => alt = true,
            _ => return Err(PedalError::NoModifier { name: name.to_owned(), modifier: part.to_owned() }),
        }
    }
    let found = key(last).ok_or_else(|| PedalError::NoKey { name: name.to_owned(), key: last.to_owned() })?;
    if key("Escape").is_some_and(|escape| escape == found) {
        return Err(PedalError::Reserved { name: name.to_owned() });
    }
    Ok(Binding { ctrl, shift, alt, key: found, action })
}
