//! Where pictures come from: one [`Source`] per camera, file, image sequence or pipeline.

mod avi;
mod compressed;
mod controls;
mod decode;
mod demands;
mod elements;
mod error;
mod frames;
mod images;
mod kind;
mod name;
mod opening;
mod picture;
mod plain;
mod stream;

use std::path::Path;
use std::sync::Arc;

use panoscope_media::input::Signal;

pub use decode::{decode_picture, read};
pub use demands::{Clock, Demands, Grab, Lock};
pub use elements::unknown_element;
pub use error::{CaptureError, PictureError};
pub use name::SourceName;
pub use picture::{Picture, Samples};
pub use stream::Stream;

use images::Images;

/// One source.
pub enum Source {
    /// Image files, read one by one.
    Images(Images),
    /// A device, a video file or a pipeline.
    Stream(Box<Stream>),
}

impl Source {
    /// Opens `name`. With `is_repeated` decoded images stay in memory. `signal` is notified of every picture of a stream.
    ///
    /// # Errors
    /// The source is missing, damaged, refused, or does not open in time.
    pub fn open(
        name: &SourceName,
        demands: Demands,
        is_repeated: bool,
        signal: &Arc<Signal>,
    ) -> Result<Self, CaptureError> {
        match name {
            SourceName::Images(files) => Ok(Self::Images(Images::new(files.clone(), is_repeated))),
            SourceName::Image(file) => Ok(Self::Images(Images::still(file.clone()))),
            other => Ok(Self::Stream(Box::new(Stream::open(other, demands, signal)?))),
        }
    }

    /// Steps to the next picture. Images are read by [`Self::retrieve`]; pictures of streams are decoded already.
    pub fn grab(&mut self, clock: Clock<'_>) -> Grab {
        match self {
            Self::Images(images) => images.grab(),
            Self::Stream(stream) => stream.grab(clock),
        }
    }

    /// Returns the picture that was grabbed.
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

    /// Starts again at the first picture.
    ///
    /// # Errors
    /// A video that no longer opens.
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

    /// Frames per second by the file or the driver.
    pub fn native_fps(&self) -> Option<f64> {
        match self {
            Self::Images(_) => None,
            Self::Stream(stream) => stream.native_fps(),
        }
    }

    /// Number of pictures grabbed since the start.
    pub fn grabbed(&self) -> u64 {
        match self {
            Self::Images(images) => images.grabbed(),
            Self::Stream(stream) => stream.frames(),
        }
    }

    /// Number of pictures left, as far as it is known.
    pub fn left(&self) -> u64 {
        match self {
            Self::Images(images) if images.is_still() => 0,
            Self::Images(images) => images.left(),
            Self::Stream(stream) => stream.left(),
        }
    }

    /// Time of the grabbed picture since the first one, in s. `rate_hz` is the rate of pictures without a time of their own and, when `is_forced`, of all.
    /// `None` for stills and live sources.
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

    /// The stream, if only its newest pictures count: pictures of such streams are paired by their arrival.
    pub fn newest_mut(&mut self) -> Option<&mut Stream> {
        match self {
            Self::Stream(stream) if stream.is_newest_wins() => Some(stream),
            _ => None,
        }
    }

    /// The stream of a camera, video, address or pipeline.
    pub fn stream(&self) -> Option<&Stream> {
        match self {
            Self::Stream(stream) => Some(stream),
            Self::Images(_) => None,
        }
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

    /// The next file, where every picture is a file.
    pub fn next_file(&self) -> Option<&Path> {
        match self {
            Self::Images(images) => images.next_file(),
            Self::Stream(_) => None,
        }
    }

    /// Continues after `grabbed` pictures, or at `file` where it still exists.
    pub fn go_to(&mut self, grabbed: u64, file: Option<&Path>) {
        match self {
            Self::Images(images) if !images.is_still() => images.go_to(file, grabbed),
            Self::Stream(stream) if !stream.is_live() => stream.go_to(grabbed),
            _ => {}
        }
    }
}
