//! The languages, and which one a thread speaks.

use std::cell::Cell;

use super::added;

/// A language of the windows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Language {
    /// English, the source of all texts.
    #[default]
    English,
    /// German.
    German,
    /// One that was added by a file, by its place in the order of the files.
    Added(u8),
}

thread_local! {
    static CURRENT: Cell<Language> = const { Cell::new(Language::English) };
}

/// The language of the windows that this thread draws; English unless another one was set.
#[must_use]
pub fn language() -> Language {
    CURRENT.get()
}

/// Sets the language of the windows that this thread draws.
pub fn set_language(language: Language) {
    CURRENT.set(language);
}

impl Language {
    /// The embedded languages; English first.
    pub const ALL: [Self; 2] = [Self::English, Self::German];

    /// All languages: the embedded ones, then those that were added.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().chain((0..added::count()).map(Self::Added))
    }

    /// Its code, which is also the name of its folder in `texts`.
    #[must_use]
    pub fn code(self) -> &'static str {
        match self {
            Self::English => "en",
            Self::German => "de",
            Self::Added(at) => added::get(at).map_or("en", |added| added.code),
        }
    }

    /// Its name in the language itself.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::English => "English",
            Self::German => "Deutsch",
            Self::Added(at) => added::get(at).map_or("English", |added| added.name),
        }
    }

    /// The sign between whole and decimal places.
    pub(crate) fn decimal_sign(self) -> char {
        match self {
            Self::English => '.',
            Self::German => ',',
            Self::Added(at) => added::get(at).map_or('.', |added| added.decimal_sign),
        }
    }

    /// The language after this one, and English after the last.
    #[must_use]
    pub fn next(self) -> Self {
        Self::all().skip_while(|known| *known != self).nth(1).unwrap_or_default()
    }

    /// The language of a code or a locale, such as `de` or `de_AT.UTF-8`.
    #[must_use]
    pub fn of_locale(locale: &str) -> Option<Self> {
        let code = locale.split(['_', '-', '.', '@']).next().unwrap_or_default();
        Self::all().find(|language| language.code().eq_ignore_ascii_case(code))
    }

    /// The language that an environment asks for: the first of LC_ALL, LC_MESSAGES and LANG that is set decides, as for all programs. English where
    /// there are no texts of it.
    #[must_use]
    pub fn of_environment(variable: impl Fn(&str) -> Option<String>) -> Self {
        let set = ["LC_ALL", "LC_MESSAGES", "LANG"].into_iter().filter_map(variable).find(|value| !value.is_empty());
        set.and_then(|locale| Self::of_locale(&locale)).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_environment_is_asked_in_the_order_of_posix() {
        let of = |set: &[(&str, &str)]| {
            Language::of_environment(|name| {
                set.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned())
            })
        };
        assert_eq!(of(&[]), Language::English);
        assert_eq!(of(&[("LANG", "de_DE.UTF-8")]), Language::German);
        assert_eq!(of(&[("LANG", "de_DE.UTF-8"), ("LC_ALL", "C")]), Language::English);
        assert_eq!(of(&[("LANG", "en_US.UTF-8"), ("LC_MESSAGES", "de_AT")]), Language::German);
        assert_eq!(of(&[("LC_ALL", ""), ("LANG", "de")]), Language::German, "an empty one is not set");
        assert_eq!(of(&[("LANG", "deutsch")]), Language::English);
        assert_eq!(of(&[("LANG", "fr_FR")]), Language::English);
    }

    #[test]
    fn all_languages_are_listed_in_order() {
        for (at, language) in Language::ALL.into_iter().enumerate() {
            assert_eq!(language, Language::all().nth(at).unwrap_or_default());
            assert_eq!(Language::of_locale(language.code()), Some(language));
        }
    }

    #[test]
    fn every_language_follows_another_and_threads_do_not_share_theirs() {
        assert_eq!(Language::English.next(), Language::German);
        assert_eq!(Language::German.next(), Language::English);
        set_language(Language::German);
        assert_eq!(std::thread::spawn(language).join().ok(), Some(Language::English));
        assert_eq!(language(), Language::German);
    }
}
