//! Sources of frames: one [`Source`] per camera, file, image sequence or pipeline.

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

/// A camera, file, image sequence or pipeline.
pub enum Source {
    /// Image files, read one by one.
    Images(Images),
    /// A device, a video file or a pipeline.
    Stream(Box<Stream>),
}

impl Source {
    /// Opens `name`. With `is_repeated` decoded images stay in memory. Every frame of a stream notifies `signal`.
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

    /// Advances to the next frame. Images are read by [`Self::retrieve`]; frames of streams are already decoded.
    pub fn grab(&mut self, clock: Clock<'_>) -> Grab {
        match self {
            Self::Images(images) => images.grab(),
            Self::Stream(stream) => stream.grab(clock),
        }
    }

    /// Moves the grabbed frame to `out`.
    ///
    /// # Errors
    /// The file or frame is damaged; names it. `out` never holds old pixels.
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        out.clear();
        match self {
            Self::Images(images) => images.retrieve(out),
            Self::Stream(stream) => stream.retrieve(out),
        }
    }

    /// Restarts at the first frame.
    ///
    /// # Errors
    /// The video no longer opens.
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

    /// Frame rate by the file or the driver, Hz.
    pub fn native_fps(&self) -> Option<f64> {
        match self {
            Self::Images(_) => None,
            Self::Stream(stream) => stream.native_fps(),
        }
    }

    /// Number of frames grabbed since the start.
    pub fn grabbed(&self) -> u64 {
        match self {
            Self::Images(images) => images.grabbed(),
            Self::Stream(stream) => stream.frames(),
        }
    }

    /// Number of frames left, if it is known.
    pub fn left(&self) -> u64 {
        match self {
            Self::Images(images) if images.is_still() => 0,
            Self::Images(images) => images.left(),
            Self::Stream(stream) => stream.left(),
        }
    }

    /// Time of the grabbed frame since the first one, s. `rate_hz`: rate of frames without a timestamp, or of all frames when `is_forced`. `None` for
    /// stills and live sources.
    pub fn media_s(&self, rate_hz: f64, is_forced: bool) -> Option<f64> {
        let by_rate = self.grabbed().saturating_sub(1) as f64 / rate_hz;
        match self {
            Self::Images(images) if images.is_still() => None,
            Self::Stream(stream) if stream.is_live() => None,
            Self::Stream(stream) if !is_forced => stream.media_s().or(Some(by_rate)),
            _ => Some(by_rate),
        }
    }

    /// Whether it is a single image, which has no end.
    pub fn is_still(&self) -> bool {
        matches!(self, Self::Images(images) if images.is_still())
    }

    /// Whether the source sets the pace itself.
    pub fn is_device(&self) -> bool {
        matches!(self, Self::Stream(stream) if stream.is_live())
    }

    /// The stream, if it delivers only its newest frames. Frames of such streams are paired by arrival.
    pub fn newest_mut(&mut self) -> Option<&mut Stream> {
        match self {
            Self::Stream(stream) if stream.is_newest_wins() => Some(stream),
            _ => None,
        }
    }

    /// The stream of a camera, video, address or pipeline; `None` for images.
    pub fn stream(&self) -> Option<&Stream> {
        match self {
            Self::Stream(stream) => Some(stream),
            Self::Images(_) => None,
        }
    }

    /// The stream of a device; `None` for other sources.
    pub fn device_mut(&mut self) -> Option<&mut Stream> {
        match self {
            Self::Stream(stream) if stream.is_live() => Some(stream),
            _ => None,
        }
    }

    /// Maximum values of some images of more than eight bits.
    pub fn peaks(&self) -> Vec<f32> {
        match self {
            Self::Images(images) => images.peaks(),
            Self::Stream(_) => Vec::new(),
        }
    }

    /// The next file, if every frame is a file.
    pub fn next_file(&self) -> Option<&Path> {
        match self {
            Self::Images(images) => images.next_file(),
            Self::Stream(_) => None,
        }
    }

    /// Continues after `grabbed` frames, or at `file` if it still exists.
    pub fn go_to(&mut self, grabbed: u64, file: Option<&Path>) {
        match self {
            Self::Images(images) if !images.is_still() => images.go_to(file, grabbed),
            Self::Stream(stream) if !stream.is_live() => stream.go_to(grabbed),
            _ => {}
        }
    }
}
