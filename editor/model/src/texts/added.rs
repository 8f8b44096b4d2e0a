//! Languages that are added by files while the program runs, one file each.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::{DECLARED, FILES, syntax};

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
    /// Its texts.
    pub(crate) text: &'static str,
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
    let is_added = (0..count()).filter_map(get).any(|known| known.code == code);
    if is_added || FILES.iter().any(|(known, ..)| *known == code) {
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
    let unused = 1 + unused.count();
    // Kept as long as the program runs, as the embedded texts are.
    let leaked = |text: String| -> &'static str { Box::leak(text.into_boxed_str()) };
    let text = leaked(text);
    let own = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)?.trim_start().strip_prefix('='));
    let decimal_sign = own(SIGN).and_then(|sign| sign.trim().chars().next()).unwrap_or('.');
    let code = leaked(code.to_owned());
    let added = Added { code, name: own(NAME).map_or(code, str::trim), decimal_sign, text };
    ADDED.lock().unwrap_or_else(PoisonError::into_inner).push(Box::leak(Box::new(added)));
    match first {
        Some(first) => Err(TextsError::Unused { file: file.to_owned(), count: unused, first }),
        None => Ok(()),
    }
}
