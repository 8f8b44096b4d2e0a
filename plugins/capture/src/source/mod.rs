//! Where pictures come from: one [`Source`] per camera, file, image sequence or pipeline.

mod elements;
mod images;
mod jpeg;
mod name;
mod opening;
mod picture;
mod stream;

use std::path::{Path, PathBuf};
use std::time::Instant;

pub use elements::unknown_element;
pub use name::SourceName;
pub use picture::{Picture, Samples, white_of_bits};
pub use stream::{Demands, Lock};

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
    #[error("{path}{place} cannot be read: {reason}", path = path.display())]
    Unreadable {
        /// Absolute path.
        path: PathBuf,
        /// Its number in a series.
        place: String,
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

/// What a grab found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Grab {
    /// A picture waits, taken at this time.
    Ready(Instant),
    /// Nothing comes any more.
    End,
    /// Nothing comes any more, but more was promised: what is missing.
    Failed(String),
    /// The device is gone; it is opened again with growing pauses.
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
    /// Opens `name`; `keep` keeps decoded images, which are shown again.
    ///
    /// # Errors
    /// What is missing, damaged, refused or does not answer in time, and what would help.
    pub fn open(name: &SourceName, demands: Demands, keep: bool) -> Result<Self, CaptureError> {
        match name {
            SourceName::Images(files) => Ok(Self::Images(Images::new(files.clone(), keep))),
            SourceName::Image(file) => Ok(Self::Images(Images::still(file.clone()))),
            other => Ok(Self::Stream(Box::new(Stream::open(other, demands)?))),
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
    /// A damaged file or frame, by name and number; never old pixels.
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        out.clear();
        match self {
            Self::Images(images) => images.retrieve(out),
            Self::Stream(stream) => stream.retrieve(out),
        }
    }

    /// Starts anew.
    ///
    /// # Errors
    /// A video that does not open any more.
    pub fn rewind(&mut self) -> Result<(), CaptureError> {
        match self {
            Self::Images(images) => {
                images.go_to(None, 0);
                Ok(())
            }
            Self::Stream(stream) if stream.is_live() => Ok(()),
            Self::Stream(stream) => stream.rewind(),
        }
    }

    /// Frames per second that the source itself tells.
    pub fn native_fps(&self) -> Option<f64> {
        match self {
            Self::Images(_) => None,
            Self::Stream(stream) => stream.native_fps(),
        }
    }

    /// Pictures that have been grabbed since the start.
    pub fn grabbed(&self) -> u64 {
        match self {
            Self::Images(images) => images.grabbed(),
            Self::Stream(stream) => stream.frames(),
        }
    }

    /// Pictures that are left, as far as the source knows.
    pub fn left(&self) -> u64 {
        match self {
            Self::Images(images) if images.is_still() => 0,
            Self::Images(images) => images.left(),
            Self::Stream(stream) => stream.left(),
        }
    }

    /// Time of the picture that was grabbed since the first one, in s. `rate_hz` is that of pictures without a time of their own and, when
    /// `is_forced`, of all. `None` for what has no place in time: a still, a live source.
    pub fn media_s(&self, rate_hz: f64, is_forced: bool) -> Option<f64> {
        let by_rate = self.grabbed().saturating_sub(1) as f64 / rate_hz;
        match self {
            Self::Images(images) if images.is_still() => None,
            Self::Stream(stream) if stream.is_live() => None,
            Self::Stream(stream) if !is_forced => stream.media_s().or(Some(by_rate)),
            _ => Some(by_rate),
        }
    }

    /// Whether it is one image, which has no end of its own.
    pub fn is_still(&self) -> bool {
        matches!(self, Self::Images(images) if images.is_still())
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

    /// Largest values of some pictures with more than eight bits.
    pub fn peaks(&self) -> Vec<f32> {
        match self {
            Self::Images(images) => images.peaks(),
            Self::Stream(_) => Vec::new(),
        }
    }

    /// The file that comes next, where every picture has one of its own.
    pub fn next_file(&self) -> Option<&Path> {
        match self {
            Self::Images(images) => images.next_file(),
            Self::Stream(_) => None,
        }
    }

    /// Goes on behind `grabbed` pictures, or at `file` where that is still there.
    pub fn go_to(&mut self, grabbed: u64, file: Option<&Path>) {
        match self {
            Self::Images(images) if !images.is_still() => images.go_to(file, grabbed),
            Self::Stream(stream) if !stream.is_live() => stream.go_to(grabbed),
            _ => {}
        }
    }
}
