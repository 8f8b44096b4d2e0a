//! The texts of the editor and the theatre, in every language. English is the source and stands in for what a language lacks: a window never
//! lacks a text. The files are `texts/LANGUAGE/AREA.ftl`, in the format of Project Fluent, and embedded; [`add_languages`] adds more while the program
//! runs.
//!
//! ```
//! use panoscope_editor_model::texts::{Language, decimal, set_language, text};
//!
//! assert_eq!(text!("alarm-image-old", seconds = decimal(0.42, 1)), "Image is 0.4 s old");
//! set_language(Language::German);
//! assert_eq!(text!("alarm-image-old", seconds = decimal(0.42, 1)), "Bild ist 0,4 s alt");
//! ```
//!
//! The macros check names and variables when they are compiled; the tests compare the languages. The language belongs to a thread, as a window
//! does: other threads speak English, which is the language of files and logs.

mod added;
mod catalog;
mod language;
#[cfg(test)]
mod languages;
mod number;
mod phrase;
mod syntax;

include!(concat!(env!("OUT_DIR"), "/texts.rs"));

pub use crate::{phrase, text};
pub use added::{TextsError, add_languages};
pub use language::{Language, language, set_language};
pub use number::{bytes, decimal, number, with_decimal_sign};
pub use phrase::{Phrase, Value};

/// The text of a name in the language of this thread: a `&'static str`, or a `String` where it has variables.
#[macro_export]
macro_rules! text {
    ($id:expr) => {{
        const { $crate::texts::assert_declared($id, &[]) };
        $crate::texts::plain($id)
    }};
    ($id:expr, $($name:ident = $value:expr),+ $(,)?) => {{
        const { $crate::texts::assert_declared($id, &[$(stringify!($name)),+]) };
        $crate::texts::filled($id, &[$((stringify!($name), $crate::texts::Value::from($value))),+])
    }};
}

/// As [`text!`], as a [`Phrase`] that is put into words later, perhaps in another language.
#[macro_export]
macro_rules! phrase {
    ($id:expr $(, $name:ident = $value:expr)* $(,)?) => {{
        const { $crate::texts::assert_declared($id, &[$(stringify!($name)),*]) };
        $crate::texts::Phrase::new($id, vec![$((stringify!($name), $crate::texts::Value::from($value))),*])
    }};
}

/// The text of a name without variables in the language of this thread.
#[doc(hidden)]
#[must_use]
pub fn plain(id: &'static str) -> &'static str {
    catalog::plain(language(), id)
}

/// The text of a name with variables in the language of this thread.
#[doc(hidden)]
#[must_use]
pub fn filled(id: &str, values: &[(&'static str, Value)]) -> String {
    catalog::filled(language(), id, values.iter().map(|(name, value)| (*name, value)))
}

/// Names and variables of all texts.
#[must_use]
pub fn declared() -> &'static [(&'static str, &'static [&'static str])] {
    DECLARED
}

/// The embedded files: language, area, text.
#[must_use]
pub fn files() -> &'static [(&'static str, &'static str, &'static str)] {
    FILES
}

/// Fails to compile where no text has this name and these variables.
#[doc(hidden)]
pub const fn assert_declared(id: &str, variables: &[&str]) {
    let (mut low, mut high) = (0, DECLARED.len());
    while low < high {
        let middle = usize::midpoint(low, high);
        match order(id.as_bytes(), DECLARED[middle].0.as_bytes()) {
            0 => {
                let known = DECLARED[middle].1;
                assert!(known.len() == variables.len(), "the text has another number of variables");
                let mut at = 0;
                while at < variables.len() {
                    assert!(contains(known, variables[at]), "the text has no variable of this name");
                    at += 1;
                }
                return;
            }
            1 => low = middle + 1,
            _ => high = middle,
        }
    }
    panic!("no English text has this name; the files are in editor/model/texts/en");
}

const fn contains(names: &[&str], name: &str) -> bool {
    let mut at = 0;
    while at < names.len() {
        if order(names[at].as_bytes(), name.as_bytes()) == 0 {
            return true;
        }
        at += 1;
    }
    false
}

/// 0 for equal names, 1 where the first one comes later, 2 where it comes earlier.
const fn order(a: &[u8], b: &[u8]) -> u8 {
    let mut at = 0;
    while at < a.len() && at < b.len() {
        if a[at] != b[at] {
            return if a[at] > b[at] { 1 } else { 2 };
        }
        at += 1;
    }
    if a.len() == b.len() {
        0
    } else if a.len() > b.len() {
        1
    } else {
        2
    }
}
