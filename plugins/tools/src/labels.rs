//! Names of classes, from a file or from the metadata of an export.

use std::path::{Path, PathBuf};

/// Why there are no usable names.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum LabelsError {
    /// The file cannot be read.
    #[error("cannot read the labels {path}: {cause}; expected one name per line", path = path.display())]
    Unreadable { path: PathBuf, cause: std::io::Error },
    /// The number of names differs from the model's number of classes.
    #[error("{model} has {classes} classes, but the label table has {names} names", model = model.display())]
    Count { model: PathBuf, classes: usize, names: usize },
    /// The file has no names.
    #[error("{path} contains no names: write one name per line", path = path.display())]
    Empty { path: PathBuf },
}

/// Reads one name per line; empty lines at the end are ignored.
///
/// # Errors
/// The file cannot be read or has no names.
pub fn from_file(path: &Path) -> Result<Vec<String>, LabelsError> {
    let text =
        std::fs::read_to_string(path).map_err(|cause| LabelsError::Unreadable { path: path.to_owned(), cause })?;
    let names: Vec<String> = text.trim_end().lines().map(|l| l.trim().to_owned()).collect();
    if names.iter().all(String::is_empty) { Err(LabelsError::Empty { path: path.to_owned() }) } else { Ok(names) }
}

/// Names of the `classes` classes of a model, separated by line feeds: those of `file` if it is not empty, else those of the model's `metadata`, else
/// numbers. 0 classes: as many as there are names.
///
/// # Errors
/// The file cannot be read, or the number of names is wrong.
pub fn table(model: &Path, metadata: Option<&str>, file: &Path, classes: usize) -> Result<String, LabelsError> {
    let mut names = match file.as_os_str().is_empty() {
        true => metadata.and_then(from_metadata).unwrap_or_default(),
        false => from_file(file)?,
    };
    if classes > 0 && !names.is_empty() && names.len() != classes {
        return Err(LabelsError::Count { model: model.to_owned(), classes, names: names.len() });
    }
    (names.len()..classes).for_each(|i| names.push(format!("class {i}")));
    Ok(names.join("\n"))
}

/// Parses `{0: 'grasper', 1: "hook"}` and `['grasper', 'hook']`, as exports write them.
pub fn from_metadata(text: &str) -> Option<Vec<String>> {
    let (mut names, mut rest, mut next) = (Vec::<String>::new(), text.trim(), 0usize);
    if !(rest.starts_with('{') || rest.starts_with('[')) {
        return None;
    }
    loop {
        let quote_at = rest.find(['\'', '"'])?;
        let (before, quoted) = rest.split_at(quote_at);
        let digits: String = before.chars().filter(char::is_ascii_digit).collect();
        let index = digits.parse().unwrap_or(next);
        let quote = quoted.chars().next()?;
        let (mut name, mut end, mut escaped) = (String::new(), None, false);
        for (at, c) in quoted.char_indices().skip(1) {
            match c {
                _ if escaped => {
                    name.push(c);
                    escaped = false;
                }
                '\\' => escaped = true,
                _ if c == quote => {
                    end = Some(at + c.len_utf8());
                    break;
                }
                _ => name.push(c),
            }
        }
        // No detector has more than a few thousand classes.
        if index > 9999 {
            return None;
        }
        if names.len() <= index {
            names.resize(index + 1, String::new());
        }
        // Line feeds separate names in the label table that travels with the detections.
        names[index] = name.replace(['\n', '\r'], " ");
        next = index + 1;
        rest = &quoted[end?..];
        if !rest.contains(['\'', '"']) {
            return Some(names);
        }
    }
}
