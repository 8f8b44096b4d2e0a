//! Texts that are put into words later.

use std::borrow::Cow;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::number::written;
use super::{Language, catalog, language};

/// The value of a variable in a text.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Value {
    /// Words, as they are.
    Text(String),
    /// A number, written as the language does.
    Number {
        /// The number.
        value: f64,
        /// Its number of decimal places.
        places: u8,
    },
    /// A text of its own.
    Phrase(Box<Phrase>),
}

impl Value {
    /// Adds it as a language writes it.
    pub(crate) fn write(&self, language: Language, out: &mut String) {
        match self {
            Self::Text(text) => out.push_str(text),
            Self::Number { value, places: 0 } if value.fract() == 0.0 => out.push_str(&value.to_string()),
            Self::Number { value, places } => out.push_str(&written(language, *value, *places)),
            Self::Phrase(phrase) => out.push_str(&phrase.in_language(language)),
        }
    }
}

impl PartialEq for Value {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Text(a), Self::Text(b)) => a == b,
            (Self::Number { value: a, places: m }, Self::Number { value: b, places: n }) => {
                a.total_cmp(b).is_eq() && m == n
            }
            (Self::Phrase(a), Self::Phrase(b)) => a == b,
            _ => false,
        }
    }
}

impl Eq for Value {}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<&String> for Value {
    fn from(text: &String) -> Self {
        Self::Text(text.clone())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<Cow<'_, str>> for Value {
    fn from(text: Cow<'_, str>) -> Self {
        Self::Text(text.into_owned())
    }
}

impl From<Phrase> for Value {
    fn from(phrase: Phrase) -> Self {
        Self::Phrase(Box::new(phrase))
    }
}

impl From<&Phrase> for Value {
    fn from(phrase: &Phrase) -> Self {
        Self::from(phrase.clone())
    }
}

macro_rules! whole_numbers {
    ($($kind:ty)*) => {$(
        impl From<$kind> for Value {
            fn from(number: $kind) -> Self {
                Self::Number { value: number as f64, places: 0 }
            }
        }
    )*};
}

whole_numbers!(u8 u16 u32 u64 usize i32 i64 isize);

/// A text without its language: it is put into words when it is shown, and can be sent to another process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Phrase {
    id: Cow<'static, str>,
    values: Vec<(Cow<'static, str>, Value)>,
}

impl Phrase {
    /// See [`crate::phrase!`].
    #[doc(hidden)]
    #[must_use]
    pub fn new(id: &'static str, values: Vec<(&'static str, Value)>) -> Self {
        let values = values.into_iter().map(|(name, value)| (Cow::Borrowed(name), value)).collect();
        Self { id: Cow::Borrowed(id), values }
    }

    /// The text in a language.
    #[must_use]
    pub fn in_language(&self, language: Language) -> String {
        catalog::filled(language, &self.id, self.values.iter().map(|(name, value)| (name.as_ref(), value)))
    }

    /// The text for files, logs and terminals.
    #[must_use]
    pub fn english(&self) -> String {
        self.in_language(Language::English)
    }
}

/// The text in the language of this thread.
impl fmt::Display for Phrase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.in_language(language()))
    }
}
