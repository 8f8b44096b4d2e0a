//! From the text of a parameter to the kind of source that it names.

use std::fs;
use std::path::{Path, PathBuf};

use super::CaptureError;
use crate::devices;

/// Endings of image files.
const IMAGE_ENDINGS: [&str; 10] = ["png", "jpg", "jpeg", "bmp", "tif", "tiff", "webp", "pgm", "ppm", "jp2"];

/// What a text names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceName {
    /// A camera by its number.
    Device(i32),
    /// A pipeline in GStreamer's words.
    Pipeline(String),
    /// An address such as `rtsp://...`.
    Address(String),
    /// A video file.
    Video(PathBuf),
    /// One image, shown again and again.
    Image(PathBuf),
    /// Images in order.
    Images(Vec<PathBuf>),
}

fn is_image(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    IMAGE_ENDINGS.contains(&ending.as_str())
}

impl SourceName {
    /// Reads `text`; relative paths stand in `folder`.
    ///
    /// - a number or `/dev/videoN`: a camera
    /// - a text with `!`: a GStreamer pipeline
    /// - `scheme://...`: a stream of the network
    /// - `dir/*.png`, `img_%04d.png`, or a folder: images in the order of their numbers
    /// - an image file: that image again and again
    /// - any other file: a video
    ///
    /// # Errors
    /// A device or file that is not there, a pattern without matches.
    pub fn parse(text: &str, folder: &Path) -> Result<Self, CaptureError> {
        let text = text.trim();
        let device = text.strip_prefix("/dev/video").unwrap_or(text);
        if let Ok(number) = device.parse::<u16>() {
            let path = PathBuf::from(format!("/dev/video{number}"));
            if !path.exists() {
                return Err(CaptureError::Missing { path, hint: format!(": {}", devices::in_words()) });
            }
            return Ok(Self::Device(number.into()));
        }
        if text.contains('!') {
            return Ok(Self::Pipeline(text.to_owned()));
        }
        if text.contains("://") {
            return Ok(Self::Address(text.to_owned()));
        }
        let path = std::path::absolute(folder.join(text)).unwrap_or_else(|_| folder.join(text));
        if path.is_dir() {
            return Ok(Self::Images(image_files(&path.join("*"))?));
        }
        // A file may have a star in its name.
        if !path.exists() && (text.contains(['*', '?']) || counter(text).is_some()) {
            return Ok(Self::Images(image_files(&path)?));
        }
        if !path.exists() {
            let hint = match path.parent() {
                Some(parent) if !parent.is_dir() => format!(": the folder {} does not exist", parent.display()),
                _ => String::new(),
            };
            return Err(CaptureError::Missing { path, hint });
        }
        Ok(if is_image(&path) { Self::Image(path) } else { Self::Video(path) })
    }

    /// For messages.
    pub fn in_words(&self) -> String {
        match self {
            Self::Device(number) => format!("camera /dev/video{number}"),
            Self::Pipeline(text) => format!("pipeline `{text}`"),
            Self::Address(text) => text.clone(),
            Self::Video(path) => format!("video {}", path.display()),
            Self::Image(path) => path.display().to_string(),
            Self::Images(files) => files.first().map_or_else(String::new, |f| f.display().to_string()),
        }
    }
}

/// The place of `%d` or `%04d` in a text: start, end, digits.
fn counter(text: &str) -> Option<(usize, usize, usize)> {
    let start = text.find('%')?;
    let rest = &text[start + 1..];
    let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
    (rest.as_bytes().get(digits) == Some(&b'd'))
        .then(|| (start, start + digits + 2, rest[..digits].parse().unwrap_or(0)))
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

/// Orders `img_2` before `img_10`.
fn natural(name: &str) -> Vec<(u64, String)> {
    let mut key = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let letters = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let digits = rest[letters..].find(|c: char| !c.is_ascii_digit()).map_or(rest.len(), |d| letters + d);
        // The number stands behind its letters: pairs are compared letters first.
        key.push((rest[letters..digits].parse().unwrap_or(u64::MAX), rest[..letters].to_owned()));
        rest = &rest[digits..];
    }
    key
}

/// Image files that match `dir/*.png` or `dir/img_%04d.png`, in the order of their numbers. Only the last part of the path
/// is a pattern.
///
/// # Errors
/// When there is none.
pub fn image_files(pattern: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let nothing = |hint: String| CaptureError::NoMatch { pattern: pattern.display().to_string(), hint };
    let folder = pattern.parent().unwrap_or(Path::new("."));
    let Some(last) = pattern.file_name().and_then(|n| n.to_str()) else {
        return Err(nothing("the pattern names no file".into()));
    };
    let entries = fs::read_dir(folder)
        .map_err(|error| nothing(format!("the folder {} cannot be read: {error}", folder.display())))?;
    let names: Vec<String> = entries.flatten().filter_map(|e| e.file_name().into_string().ok()).collect();
    let by_counter = counter(last).is_some();
    let fits = |name: &&String| {
        let path = Path::new(name);
        is_image(path)
            && if by_counter { matches_counter(last, name) } else { matches_glob(last.as_bytes(), name.as_bytes()) }
    };
    let mut found: Vec<&String> = names.iter().filter(fits).collect();
    if found.is_empty() {
        let images = names.iter().filter(|n| is_image(Path::new(n))).count();
        let hint = match names.iter().find(|n| is_image(Path::new(n))) {
            Some(one) => format!("the folder holds {images} images, {one} among them"),
            None => format!("the folder holds {} files and no image", names.len()),
        };
        return Err(nothing(hint));
    }
    found.sort_by_cached_key(|name| {
        let key = natural(name);
        (key.iter().map(|(number, letters)| (letters.clone(), *number)).collect::<Vec<_>>(), (*name).clone())
    });
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
    }

    #[test]
    fn files_come_in_the_order_of_their_numbers() {
        let folder = std::env::temp_dir().join(format!("panoscope_names_{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        for name in ["img_10.png", "img_2.png", "img_1.png", "notes.txt", "other_3.png"] {
            fs::write(folder.join(name), b"").unwrap();
        }
        let names = |pattern: &str| -> Vec<String> {
            let files = image_files(&folder.join(pattern)).unwrap();
            files.iter().map(|f| f.file_name().unwrap().to_str().unwrap().to_owned()).collect()
        };
        assert_eq!(names("img_*.png"), ["img_1.png", "img_2.png", "img_10.png"]);
        assert_eq!(names("img_%d.png"), ["img_1.png", "img_2.png", "img_10.png"]);
        assert_eq!(names("*").len(), 4);
        let error = image_files(&folder.join("*.jpg")).unwrap_err().to_string();
        assert!(error.contains("*.jpg") && error.contains("4 images"), "{error}");
        let error = SourceName::parse("img_3.png", &folder).unwrap_err().to_string();
        assert!(error.contains(&folder.join("img_3.png").display().to_string()), "{error}");
        let error = SourceName::parse("no/such.mkv", &folder).unwrap_err().to_string();
        assert!(error.contains("the folder"), "{error}");
        assert!(matches!(SourceName::parse("img_1.png", &folder), Ok(SourceName::Image(_))));
        assert!(matches!(SourceName::parse("notes.txt", &folder), Ok(SourceName::Video(_))));
        assert!(matches!(SourceName::parse("videotestsrc ! appsink", &folder), Ok(SourceName::Pipeline(_))));
        let error = SourceName::parse("/dev/video4711", &folder).unwrap_err().to_string();
        assert!(error.contains("/dev/video4711"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
