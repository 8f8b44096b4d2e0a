//! Picture files that match a pattern, in the order of their numbers.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

/// Endings of image files.
const IMAGE_ENDINGS: [&str; 11] = ["png", "jpg", "jpeg", "bmp", "tif", "tiff", "exr", "webp", "pgm", "ppm", "jp2"];

/// Whether a file's ending is that of an image.
pub fn is_image(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    IMAGE_ENDINGS.contains(&ending.as_str())
}

/// Position of `%d` or `%04d` in a text: start, end, digits.
fn counter(text: &str) -> Option<(usize, usize, usize)> {
    text.match_indices('%').find_map(|(start, _)| {
        let rest = &text[start + 1..];
        let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
        (rest.as_bytes().get(digits) == Some(&b'd'))
            .then(|| (start, start + digits + 2, rest[..digits].parse().unwrap_or(0)))
    })
}

fn matches_glob(pattern: &[u8], name: &[u8]) -> bool {
    match (pattern.first(), name.first()) {
        (None, None) => true,
        (Some(b'*'), _) => matches_glob(&pattern[1..], name) || !name.is_empty() && matches_glob(pattern, &name[1..]),
        (Some(b'?'), Some(_)) => matches_glob(&pattern[1..], &name[1..]),
        (Some(a), Some(b)) if a == b => matches_glob(&pattern[1..], &name[1..]),
        _ => false,
    }
}

fn matches_counter(pattern: &str, name: &str) -> bool {
    let Some((start, end, digits)) = counter(pattern) else { return false };
    let (prefix, suffix) = (&pattern[..start], &pattern[end..]);
    name.strip_prefix(prefix).and_then(|rest| rest.strip_suffix(suffix)).is_some_and(|number| {
        // As printf: padded to `digits`, longer when the number needs it.
        let wide = number.len() == digits.max(1) || number.len() > digits.max(1) && !number.starts_with('0');
        wide && number.bytes().all(|b| b.is_ascii_digit())
    })
}

/// Orders `img_2` before `img_10`: a name as letters and numbers in turn, to be compared with others.
pub fn natural_order(name: &str) -> Vec<(String, u64)> {
    let mut key = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let letters = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let digits = rest[letters..].find(|c: char| !c.is_ascii_digit()).map_or(rest.len(), |d| letters + d);
        key.push((rest[..letters].to_owned(), rest[letters..digits].parse().unwrap_or(u64::MAX)));
        rest = &rest[digits..];
    }
    key
}

/// Whether a path is a pattern: its last part holds `*`, `?` or a counter such as `%04d`.
pub fn is_pattern(path: &str) -> bool {
    let name = path.rsplit('/').next().unwrap_or(path);
    name.contains(['*', '?']) || counter(name).is_some()
}

/// Why no file matches a pattern.
#[derive(Debug, thiserror::Error)]
pub enum PatternError {
    /// Its last part is not a name.
    #[error("the pattern names no file")]
    NoName,
    /// Its folder cannot be read.
    #[error("the folder {} cannot be read: {cause}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The folder holds files of the kind under other names.
    #[error("the folder holds {count} {what}s, {} among them", example.display())]
    OtherNames {
        /// Number of these files.
        count: usize,
        /// Their kind, such as `image`.
        what: String,
        /// The name of one.
        example: OsString,
    },
    /// The folder holds no file of the kind.
    #[error("the folder holds {count} files and no {what}")]
    OtherKinds {
        /// Number of all files.
        count: usize,
        /// The kind that was wanted.
        what: String,
    },
}

/// Image files that match `dir/*.png` or `dir/img_%04d.png`, in the order of their numbers. Only the last part of the path
/// is a pattern.
///
/// # Errors
/// When no file matches; the message lists what the folder holds instead.
pub fn image_files(pattern: &Path) -> Result<Vec<PathBuf>, PatternError> {
    numbered_files(pattern, "image", is_image)
}

/// As [`image_files`], of the files that `fits` takes; `what` names one of them in messages.
///
/// # Errors
/// When no file matches; the message lists what the folder holds instead.
pub fn numbered_files(pattern: &Path, what: &str, fits: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>, PatternError> {
    let folder = pattern.parent().unwrap_or(Path::new("."));
    let Some(last) = pattern.file_name().and_then(|n| n.to_str()) else {
        return Err(PatternError::NoName);
    };
    let entries = fs::read_dir(folder).map_err(|cause| PatternError::Folder { folder: folder.to_owned(), cause })?;
    // Names need not be UTF-8.
    let names: Vec<OsString> = entries.flatten().map(|e| e.file_name()).collect();
    let by_counter = counter(last).is_some();
    // As in a shell, a pattern finds no hidden files: a Mac leaves `._name.png` next to each file of a foreign disk.
    let is_hidden = |name: &OsString| name.as_encoded_bytes().starts_with(b".") && !last.starts_with('.');
    let matches = |name: &&OsString| {
        fits(Path::new(name))
            && !is_hidden(name)
            && match by_counter {
                true => matches_counter(last, &name.to_string_lossy()),
                false => matches_glob(last.as_bytes(), name.as_encoded_bytes()),
            }
    };
    let mut found: Vec<&OsString> = names.iter().filter(matches).collect();
    if found.is_empty() {
        let others: Vec<&OsString> = names.iter().filter(|name| fits(Path::new(name)) && !is_hidden(name)).collect();
        let (what, count) = (what.to_owned(), others.len());
        return Err(match others.first() {
            Some(example) => PatternError::OtherNames { count, what, example: (*example).clone() },
            None => PatternError::OtherKinds { count: names.len(), what },
        });
    }
    found.sort_by_cached_key(|name| (natural_order(&name.to_string_lossy()), (*name).clone()));
    Ok(found.into_iter().map(|name| folder.join(name)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_as_in_a_shell_and_in_printf() {
        assert!(matches_glob(b"a*.png", b"a12.png") && matches_glob(b"*", b"x") && matches_glob(b"a?c", b"abc"));
        assert!(!matches_glob(b"a*.png", b"a12.jpg") && !matches_glob(b"a?c", b"ac"));
        assert!(matches_counter("img_%04d.png", "img_0007.png") && matches_counter("img_%04d.png", "img_12345.png"));
        assert!(!matches_counter("img_%04d.png", "img_7.png") && !matches_counter("img_%04d.png", "img_00007.png"));
        assert!(matches_counter("%d.png", "7.png") && !matches_counter("%d.png", "x.png"));
        assert!(counter("100%.png").is_none());
        assert!(matches_counter("50% of %02d.png", "50% of 07.png"));
        assert!(is_pattern("50% %d/img_%04d.png") && is_pattern("*.png") && !is_pattern("%d?/still.png"));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn names_that_are_not_utf_8_are_found() {
        use std::os::unix::ffi::OsStringExt;

        let folder = std::env::temp_dir().join(format!("panoscope_pictures_{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let names = ["\u{e9}_10.png", "\u{e9}_2.png"].map(|name| name.chars().map(|c| c as u8).collect::<Vec<u8>>());
        let files = names.map(|name| folder.join(OsString::from_vec(name)));
        files.iter().for_each(|file| fs::write(file, b"").unwrap());
        let in_order = [files[1].clone(), files[0].clone()];
        assert_eq!(image_files(&folder.join("*")).unwrap(), in_order);
        assert_eq!(image_files(&folder.join("?_*.png")).unwrap(), in_order);
        // Hidden files are found only by patterns of hidden files.
        let hidden = folder.join("._1.png");
        fs::write(&hidden, b"").unwrap();
        assert_eq!(image_files(&folder.join("*")).unwrap(), in_order);
        assert_eq!(image_files(&folder.join("._*.png")).unwrap(), [hidden]);
        assert!(image_files(&folder.join("*.jpg")).unwrap_err().to_string().contains("2 images"));
        fs::remove_dir_all(&folder).unwrap();
    }
}
