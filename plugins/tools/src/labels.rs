//! Names of classes, from a file or from what the export says of itself.

use std::path::Path;

/// Reads one name a line; empty lines at the end do not count.
pub fn from_file(path: &Path) -> Result<Vec<String>, String> {
    let text = std::fs::read_to_string(path)
        .map_err(|e| format!("cannot read the labels {}: {e}; one name a line is expected", path.display()))?;
    let names: Vec<String> = text.trim_end().lines().map(|l| l.trim().to_owned()).collect();
    if names.iter().all(String::is_empty) { Err(format!("{} holds no names", path.display())) } else { Ok(names) }
}

/// Reads `{0: 'grasper', 1: "hook"}` and `['grasper', 'hook']`, as exports write them.
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
        // A table of more than a few thousand names serves no detector.
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
