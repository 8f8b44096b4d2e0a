//! Parses the text of a parameter into the kind of source that it names.

use std::path::{Path, PathBuf};

use image::metadata::Orientation;
use image::{ImageDecoder, ImageReader};
use panoscope_base::secret::redact;
use panoscope_data::calibration::pictures::{self, is_image, is_pattern};

use super::error::CaptureError;
use super::picture::turned_size;
use crate::devices;

/// The source that a text names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceName {
    /// A camera by its number.
    Device(i32),
    /// A GStreamer pipeline as text.
    Pipeline(String),
    /// An address such as `rtsp://...`.
    Address(String),
    /// A video file.
    Video(PathBuf),
    /// One image, shown repeatedly.
    Image(PathBuf),
    /// Images in order.
    Images(Vec<PathBuf>),
}

fn image_files(pattern: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    pictures::image_files(pattern)
        .map_err(|error| CaptureError::NoMatch { pattern: pattern.display().to_string(), hint: error.to_string() })
}

impl SourceName {
    /// Parses `text`; relative paths are in `folder`.
    ///
    /// - a number that is not a file's name, or `/dev/videoN`: a camera
    /// - a text with `!` that is not a file's name: a GStreamer pipeline
    /// - `scheme://...`: a network stream; its user and password may be names of environment variables, see [`panoscope_base::secret`]
    /// - `dir/*.png`, `img_%04d.png`, or a folder: images sorted by number
    /// - image files, one a line: those in that order
    /// - an image file: that image repeatedly
    /// - any other file: a video
    ///
    /// # Errors
    /// A device or file does not exist, or a pattern matches nothing.
    pub fn parse(text: &str, folder: &Path) -> Result<Self, CaptureError> {
        let text = text.trim();
        if text.contains('\n') {
            let files: Vec<PathBuf> =
                text.lines().map(str::trim).filter(|line| !line.is_empty()).map(|line| folder.join(line)).collect();
            if let Some(path) = files.iter().find(|path| !path.is_file()) {
                return Err(CaptureError::Missing { path: path.clone(), hint: String::new() });
            }
            return Ok(Self::Images(files));
        }
        let device = text.strip_prefix("/dev/video").unwrap_or(text);
        // What exists as a file goes first.
        if let Ok(number) = device.parse::<u16>()
            && (device != text || !folder.join(text).exists())
        {
            let path = PathBuf::from(format!("/dev/video{number}"));
            if !path.exists() {
                return Err(CaptureError::NoDevice { path, present: devices::in_words() });
            }
            return Ok(Self::Device(number.into()));
        }
        if text.contains('!') && !folder.join(text).exists() {
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
        if !path.exists() && (is_pattern(text)) {
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

    /// Width and height of the first frame, upright or as stored, from its header; `None` for sources that must be opened to know.
    pub fn picture_size(&self, is_upright: bool) -> Option<(usize, usize)> {
        let file = match self {
            Self::Image(file) => file,
            Self::Images(files) => files.first()?,
            _ => return None,
        };
        let mut decoder = ImageReader::open(file).ok()?.with_guessed_format().ok()?.into_decoder().ok()?;
        let (width, height) = decoder.dimensions();
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        let stored = (width as usize, height as usize);
        Some(if is_upright { turned_size(stored, orientation) } else { stored })
    }

    /// The source as text, for messages.
    pub fn in_words(&self) -> String {
        match self {
            Self::Device(number) => format!("camera /dev/video{number}"),
            Self::Pipeline(text) => format!("pipeline `{}`", redact(text)),
            Self::Address(text) => redact(text).into_owned(),
            Self::Video(path) => format!("video {}", path.display()),
            Self::Image(path) => path.display().to_string(),
            Self::Images(files) => files.first().map_or_else(String::new, |f| f.display().to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

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
        let listed = SourceName::parse("img_2.png\nimg_1.png\n", &folder).unwrap();
        assert_eq!(listed, SourceName::Images(vec![folder.join("img_2.png"), folder.join("img_1.png")]));
        let error = SourceName::parse("img_2.png\nimg_9.png", &folder).unwrap_err().to_string();
        assert!(error.contains("img_9.png"), "{error}");
        let error = image_files(&folder.join("*.jpg")).unwrap_err().to_string();
        assert!(error.contains("*.jpg") && error.contains("4 images"), "{error}");
        let error = SourceName::parse("img_3.png", &folder).unwrap_err().to_string();
        assert!(error.contains(&folder.join("img_3.png").display().to_string()), "{error}");
        let error = SourceName::parse("no/such.mkv", &folder).unwrap_err().to_string();
        assert!(error.contains("the folder"), "{error}");
        assert!(matches!(SourceName::parse("img_1.png", &folder), Ok(SourceName::Image(_))));
        assert!(matches!(SourceName::parse("notes.txt", &folder), Ok(SourceName::Video(_))));
        assert!(matches!(SourceName::parse("videotestsrc ! appsink", &folder), Ok(SourceName::Pipeline(_))));
        fs::write(folder.join("wow!.png"), b"").unwrap();
        assert!(matches!(SourceName::parse("wow!.png", &folder), Ok(SourceName::Image(_))));
        fs::create_dir_all(folder.join("7")).unwrap();
        fs::copy(folder.join("img_1.png"), folder.join("7/a_1.png")).unwrap();
        assert!(matches!(SourceName::parse("7", &folder), Ok(SourceName::Images(_))));
        let error = SourceName::parse("/dev/video4711", &folder).unwrap_err().to_string();
        assert!(error.contains("/dev/video4711"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
