//! Where pictures come from: one [`Source`] per camera, file, image sequence or pipeline.

mod elements;
mod images;
mod name;
mod stream;

use std::path::PathBuf;
use std::time::Instant;

pub use elements::unknown_element;
pub use name::SourceName;
pub use stream::Lock;

use images::Images;
use stream::Stream;

/// Why a source gives no picture.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// A file that is not there.
    #[error("there is no file {path}{hint}", path = path.display())]
    Missing {
        /// Absolute path.
        path: PathBuf,
        /// What else there is.
        hint: String,
    },
    /// A camera that is not there.
    #[error("there is no camera {path}: {present}", path = path.display())]
    NoDevice {
        /// The device's file.
        path: PathBuf,
        /// Which there are.
        present: String,
    },
    /// A pattern or folder without any image.
    #[error("no image matches {pattern}; {hint}")]
    NoMatch {
        /// Absolute pattern.
        pattern: String,
        /// What would help.
        hint: String,
    },
    /// A file that cannot be read or is no image.
    #[error("{path} cannot be read: {reason}", path = path.display())]
    Unreadable {
        /// Absolute path.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A device, video or pipeline that does not open.
    #[error("{name} does not open: {reason}")]
    Closed {
        /// What was asked for.
        name: String,
        /// Why, and what would help.
        reason: String,
    },
    /// OpenCV's words.
    #[error("{name}: {reason}")]
    OpenCv {
        /// What was asked for.
        name: String,
        /// OpenCV's message.
        reason: String,
    },
}

/// One BGR picture.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Picture {
    /// Columns in px.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Blue, green, red; rows without padding.
    pub bgr: Vec<u8>,
}

/// What a device is asked for; 0 leaves it as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Request {
    /// Columns in px.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames per second.
    pub fps: f64,
}

/// What a grab found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grab {
    /// A picture waits, taken at this time.
    Ready(Instant),
    /// Nothing comes any more.
    End,
    /// The device is gone.
    Lost,
}

/// One source.
pub enum Source {
    /// Image files, read one by one.
    Images(Images),
    /// A device, a video file or a pipeline.
    Stream(Box<Stream>),
}

impl Source {
    /// Opens `name`.
    ///
    /// # Errors
    /// What is missing, damaged or refused, and what would help.
    pub fn open(name: &SourceName, request: Request, looped: bool) -> Result<Self, CaptureError> {
        match name {
            SourceName::Images(files) => Ok(Self::Images(Images::new(files.clone(), looped))),
            SourceName::Image(file) => Ok(Self::Images(Images::repeated(file.clone()))),
            other => Ok(Self::Stream(Box::new(Stream::open(other, request, looped)?))),
        }
    }

    /// Takes the next picture without decoding it, so that several sources are grabbed at nearly the same time.
    pub fn grab(&mut self) -> Grab {
        match self {
            Self::Images(images) => images.grab(),
            Self::Stream(stream) => stream.grab(),
        }
    }

    /// Decodes the picture that was grabbed.
    ///
    /// # Errors
    /// A damaged file, by name; never old pixels.
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        match self {
            Self::Images(images) => images.retrieve(out),
            Self::Stream(stream) => stream.retrieve(out),
        }
    }

    /// Frames per second that the source itself tells.
    pub fn native_fps(&self) -> Option<f64> {
        match self {
            Self::Images(_) => None,
            Self::Stream(stream) => stream.native_fps(),
        }
    }

    /// Why an ended source is to be doubted, in words.
    pub fn cut_off(&self) -> Option<String> {
        let Self::Stream(stream) = self else { return None };
        let (read, told) = stream.cut_off()?;
        Some(format!("{} ended after {read} of {told} frames: it is cut off or damaged", stream.in_words()))
    }

    /// Whether the source sets the pace by itself.
    pub fn is_device(&self) -> bool {
        matches!(self, Self::Stream(stream) if stream.is_live())
    }

    /// The device's stream.
    pub fn device_mut(&mut self) -> Option<&mut Stream> {
        match self {
            Self::Stream(stream) if stream.is_live() => Some(stream),
            _ => None,
        }
    }
}
