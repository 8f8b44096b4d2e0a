//! The closest valid name for a misspelt one.

use std::path::{Path, PathBuf};

/// Edit distance with insertions, deletions, substitutions and swaps of neighbours (optimal string alignment), ignoring
/// case.
fn distance(a: &str, b: &str) -> usize {
    let a: Vec<char> = a.chars().flat_map(char::to_lowercase).collect();
    let b: Vec<char> = b.chars().flat_map(char::to_lowercase).collect();
    let mut before: Vec<usize> = vec![0; b.len() + 1];
    let mut last: Vec<usize> = (0..=b.len()).collect();
    let mut row = last.clone();
    for i in 1..=a.len() {
        row[0] = i;
        for j in 1..=b.len() {
            let change = usize::from(a[i - 1] != b[j - 1]);
            row[j] = (last[j - 1] + change).min(last[j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                row[j] = row[j].min(before[j - 2] + 1);
            }
        }
        std::mem::swap(&mut before, &mut last);
        std::mem::swap(&mut last, &mut row);
    }
    last[b.len()]
}

/// The candidate closest to `name`, if one is close enough to be what was meant: at most a third of the letters differ,
/// or one is a whole word of the other (`blend` for `blend_px`).
pub(crate) fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // Names longer than this are no misspellings, and the distance is quadratic.
    if name.is_empty() || name.len() > 100 {
        return None;
    }
    let mut best: Option<(usize, &str)> = None;
    for candidate in candidates {
        if candidate.is_empty() || candidate.len() > 100 || candidate == name {
            continue;
        }
        let longer = name.chars().count().max(candidate.chars().count());
        let edits = distance(name, candidate);
        // People rarely miss the first letter, nor the beginning.
        let other_start = usize::from(!name.chars().take(1).eq(candidate.chars().take(1)));
        let not_a_part = usize::from(!candidate.starts_with(name));
        let score = if edits <= longer.div_ceil(3) && edits < longer {
            4 * edits + 2 * other_start + not_a_part
        } else if shares_start(name, candidate) {
            4 * longer
        } else {
            continue;
        };
        if best.is_none_or(|(s, _)| score < s) {
            best = Some((score, candidate));
        }
    }
    best.map(|(_, c)| c)
}

/// Whether one name is the other's beginning or end, cut at an underscore.
fn shares_start(a: &str, b: &str) -> bool {
    let (short, long) = if a.len() < b.len() { (a, b) } else { (b, a) };
    short.len() >= 3
        && (long.strip_prefix(short).is_some_and(|rest| rest.starts_with('_'))
            || long.strip_suffix(short).is_some_and(|rest| rest.ends_with('_')))
}

/// `` `a`, `b` and `c` ``; at most `limit` names, then "and N more".
pub(crate) fn list<'a>(names: impl IntoIterator<Item = &'a str>, limit: usize, last: &str) -> String {
    let mut quoted: Vec<String> = names.into_iter().map(|n| format!("`{n}`")).collect();
    if quoted.len() > limit {
        let more = quoted.len() - limit;
        quoted.truncate(limit);
        return format!("{} and {more} more", quoted.join(", "));
    }
    match quoted.pop() {
        None => String::new(),
        Some(end) if quoted.is_empty() => end,
        Some(end) => format!("{} {last} {end}", quoted.join(", ")),
    }
}

/// A file with a similar name in the same folder.
pub(crate) fn sibling(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|n| n.ends_with(".toml"))
        .collect();
    names.sort();
    nearest(name, names.iter().map(String::as_str)).map(|n| path.with_file_name(n))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_misspellings_and_refuses_strangers() {
        let names = ["homography", "roi_left", "roi_right", "blend_px"];
        assert_eq!(nearest("homografy", names), Some("homography"));
        assert_eq!(nearest("roi_rihgt", names), Some("roi_right"));
        assert_eq!(nearest("blend", names), Some("blend_px"));
        assert_eq!(nearest("Blend_PX", names), Some("blend_px"));
        assert_eq!(nearest("detections", names), None);
        assert_eq!(nearest("", names), None);
        assert_eq!(distance("abcd", "abdc"), 1);
        assert_eq!(distance("", "abc"), 3);
    }

    #[test]
    fn lists_read_as_sentences() {
        assert_eq!(list(["a"], 3, "and"), "`a`");
        assert_eq!(list(["a", "b", "c"], 3, "or"), "`a`, `b` or `c`");
        assert_eq!(list(["a", "b", "c"], 2, "or"), "`a`, `b` and 1 more");
    }
}
