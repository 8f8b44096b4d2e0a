//! Languages that are added by files while the program runs, one file each.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::catalog::Catalog;
use super::{DECLARED, Language, syntax};

/// The message with the name of the language in the language itself.
const NAME: &str = "language-name";
/// The message with the sign between whole and decimal places; without it a point.
const SIGN: &str = "language-decimal-sign";
/// Limit of a file, bytes.
const MAX_BYTES: u64 = 4 << 20;

/// What is wrong with a file of texts.
#[derive(Debug, thiserror::Error)]
pub enum TextsError {
    /// The file cannot be read.
    #[error("the texts in {file} cannot be read: {cause}", file = file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The system's error.
        cause: std::io::Error,
    },
    /// The file is not a file of texts; none of them is used.
    #[error("the texts in {file} are not used: {reason}", file = file.display())]
    Unusable {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Some texts are not used; English stands in for them.
    #[error("{file}: {count} texts are not used, the first one is {first}", file = file.display())]
    Unused {
        /// The file.
        file: PathBuf,
        /// How many.
        count: usize,
        /// The first one, with the reason.
        first: String,
    },
}

/// A language that was added.
pub(crate) struct Added {
    pub(crate) code: &'static str,
    pub(crate) name: &'static str,
    pub(crate) decimal_sign: char,
    pub(crate) catalog: Catalog,
}

static ADDED: Mutex<Vec<&'static Added>> = Mutex::new(Vec::new());

/// The language at a place of the list.
pub(crate) fn get(at: u8) -> Option<&'static Added> {
    ADDED.lock().unwrap_or_else(PoisonError::into_inner).get(usize::from(at)).copied()
}

/// How many there are.
pub(crate) fn count() -> u8 {
    u8::try_from(ADDED.lock().unwrap_or_else(PoisonError::into_inner).len()).unwrap_or(u8::MAX)
}

/// Adds the languages of a folder: `CODE.ftl` has the texts of language CODE, in the format of Fluent, with its name as `language-name` and its decimal
/// sign as `language-decimal-sign`. English stands in for texts that a file lacks. Returns what is wrong; a folder that is not there has no languages.
pub fn add_languages(folder: &Path) -> Vec<TextsError> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "ftl"));
    files.sort();
    files.into_iter().filter_map(|file| add(&file).err()).collect()
}

fn add(file: &Path) -> Result<(), TextsError> {
    let unreadable = |cause| TextsError::Unreadable { file: file.to_owned(), cause };
    let unusable = |reason: String| TextsError::Unusable { file: file.to_owned(), reason };
    let code = file.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    if !(2..=8).contains(&code.len()) || !code.bytes().all(|byte| byte.is_ascii_lowercase()) {
        return Err(unusable(format!("`{code}` is not the code of a language, such as fr")));
    }
    if Language::all().any(|known| known.code() == code) {
        return Err(unusable(format!("there are texts of `{code}` already")));
    }
    if std::fs::metadata(file).map_err(unreadable)?.len() > MAX_BYTES {
        return Err(unusable(format!("it is larger than {} MiB", MAX_BYTES >> 20)));
    }
    let text = std::fs::read_to_string(file).map_err(unreadable)?;
    let texts = syntax::texts(&text).map_err(unusable)?;
    let declared: BTreeMap<&str, &[&str]> = DECLARED.iter().copied().collect();
    let mut unused = texts.iter().filter_map(|(name, variables)| match declared.get(name.as_str()) {
        Some(known) if variables.iter().all(|variable| known.contains(&variable.as_str())) => None,
        Some(_) => Some(format!("`{name}`, which has a variable that the English text has not")),
        None if [NAME, SIGN].contains(&name.as_str()) => None,
        None => Some(format!("`{name}`, which no window has")),
    });
    let first = unused.next();
    let count = 1 + unused.count();
    let catalog = Catalog::read(code, [text.as_str()].into_iter());
    let own = |name: &str| catalog.text(name, None).map(|(text, _)| text);
    let leaked = |text: String| -> &'static str { Box::leak(text.into_boxed_str()) };
    let (name, sign) = (own(NAME).unwrap_or_else(|| code.to_owned()), own(SIGN));
    let decimal_sign = sign.and_then(|sign| sign.chars().next()).unwrap_or('.');
    // Kept as long as the program runs, as the embedded texts are.
    let added = Added { code: leaked(code.to_owned()), name: leaked(name), decimal_sign, catalog };
    ADDED.lock().unwrap_or_else(PoisonError::into_inner).push(Box::leak(Box::new(added)));
    match first {
        Some(first) => Err(TextsError::Unused { file: file.to_owned(), count, first }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texts::{Value, decimal, files, filled, plain, set_language, text};

    /// The English texts with every word in brackets, as a file of another language.
    fn bracketed() -> String {
        let mut all = String::new();
        for (_, _, text) in files().iter().filter(|(code, ..)| *code == "en") {
            let resource = fluent_syntax::parser::parse(*text).expect("English has no mistakes");
            all.push_str(&fluent_syntax::serializer::serialize(&resource));
        }
        // A text begins after ` = `, of a message or of an attribute, and after `] ` where there are several.
        let line = |line: &str| match (line.trim_start().chars().next(), line.split_once(" = "), line.split_once("] "))
        {
            (Some('[' | '*'), _, Some((name, text))) => format!("{name}] ⟦{text}"),
            (_, Some((name, text)), _) => format!("{name} = ⟦{text}"),
            _ => line.to_owned(),
        };
        let texts = all.lines().map(line).collect::<Vec<_>>().join("\n");
        format!("language-name = Probe\nlanguage-decimal-sign = ,\n{texts}\n")
    }

    #[test]
    fn one_file_adds_a_language_and_english_stands_in_for_what_it_lacks() {
        let folder = std::env::temp_dir().join(format!("panoscope_texts_{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("created");
        let whole = bracketed();
        std::fs::write(folder.join("xx.ftl"), &whole).expect("written");
        let some =
            "language-name = Français\ntop-save = Enregistrer\nno-such-text = Rien\nalarm-image-old = { $inconnu }\n";
        std::fs::write(folder.join("fr.ftl"), some).expect("written");
        for (name, text) in [("de.ftl", "top-save = Anders\n"), ("yy.ftl", "top-save"), ("Nope.ftl", "a = b\n")] {
            std::fs::write(folder.join(name), text).expect("written");
        }
        let problems: Vec<String> = add_languages(&folder).iter().map(ToString::to_string).collect();
        std::fs::remove_dir_all(&folder).expect("removed");
        let says = |words: &[&str]| problems.iter().any(|problem| words.iter().all(|word| problem.contains(word)));
        assert!(says(&["de.ftl", "already"]) && says(&["yy.ftl"]) && says(&["Nope.ftl", "code"]), "{problems:#?}");
        assert!(says(&["fr.ftl", "2 texts"]), "{problems:#?}");
        assert_eq!(problems.len(), 4, "{problems:#?}");
        let of = |code: &str| Language::of_locale(code).expect("it was added");

        // Every text of the windows comes from the file.
        let other = of("xx_YY.UTF-8");
        assert_eq!((other.code(), other.name()), ("xx", "Probe"));
        set_language(other);
        let mut left = Vec::new();
        for (id, variables) in DECLARED {
            let shown = match variables.is_empty() {
                true => plain(id).to_owned(),
                false => filled(id, &variables.iter().map(|name| (*name, Value::from(2))).collect::<Vec<_>>()),
            };
            if !shown.contains('⟦') {
                left.push((*id, shown));
            }
        }
        assert!(left.is_empty(), "not from the file: {left:#?}");
        assert!(text!("alarm-image-old", seconds = decimal(0.42, 1)).contains("0,4"), "its decimal sign");

        // What a file lacks, or has with another variable, is English.
        set_language(of("fr"));
        assert_eq!((text!("top-save"), text!("top-undo")), ("Enregistrer", "Undo"));
        assert_eq!(text!("alarm-image-old", seconds = decimal(0.42, 1)), "Image is 0.4 s old");
        // The languages go round, and end in English.
        let round: Vec<&str> = std::iter::successors(Some(Language::English), |now| Some(now.next()))
            .take(5)
            .map(Language::code)
            .collect();
        assert_eq!(round, ["en", "de", "fr", "xx", "en"]);
    }
}
