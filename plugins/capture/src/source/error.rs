//! Errors of sources and of image decoding.

use std::path::PathBuf;

use panoscope_media::input::jpeg::JpegError;

/// Why a source delivers no frame.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The file does not exist.
    #[error("there is no file {path}{hint}", path = path.display())]
    Missing {
        /// Absolute path.
        path: PathBuf,
        /// More about the location, or empty.
        hint: String,
    },
    /// The camera does not exist.
    #[error("there is no camera {path}: {present}", path = path.display())]
    NoDevice {
        /// Path of the device.
        path: PathBuf,
        /// The cameras of this machine, as text.
        present: String,
    },
    /// No image matches a pattern or folder.
    #[error("no image matches {pattern}; {hint}")]
    NoMatch {
        /// Absolute pattern.
        pattern: String,
        /// What to do.
        hint: String,
    },
    /// A file that cannot be read or is not an image.
    #[error("{path}{place} cannot be read: {cause}", path = path.display())]
    Unreadable {
        /// Absolute path.
        path: PathBuf,
        /// Its number in a series, or empty.
        place: String,
        /// What is wrong with the file.
        cause: PictureError,
    },
    /// A device, video or pipeline that does not open.
    #[error("{name} does not open: {reason}")]
    Closed {
        /// Name of the source, for messages.
        name: String,
        /// Why, and what to do.
        reason: String,
    },
    /// A frame of a device, video or pipeline that cannot be decoded.
    #[error("{name}: frame {frame}{of_expected} cannot be decoded: {cause}")]
    Frame {
        /// Name of the source, for messages.
        name: String,
        /// Number of the frame, from 1.
        frame: u64,
        /// Number of frames that the source announces, as ` of N`, or empty.
        of_expected: String,
        /// What is wrong with the frame.
        cause: FrameError,
    },
}

/// Why a frame of a stream cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// No frame was grabbed.
    #[error("no frame is there")]
    NotThere,
    /// The decoder returned an image without pixels.
    #[error("an empty picture came")]
    Empty,
    /// The frame was decoded from damaged or missing data.
    #[error("its data are damaged: {reason}")]
    Damaged {
        /// What the source or the decoder reported.
        reason: String,
    },
    /// Fewer bytes than the format needs.
    #[error("{bytes} bytes came, its format needs {expected}")]
    Short {
        /// Number of bytes received.
        bytes: usize,
        /// Number of bytes of a complete frame.
        expected: usize,
    },
    /// The format does not describe an image of rows and columns.
    #[error("the format {format} is not supported")]
    Unsupported {
        /// GStreamer's name of the format.
        format: String,
    },
    /// A JPEG of another size than the stream announces.
    #[error(
        "a JPEG of {width}x{height} came where {announced_width}x{announced_height} was announced (interlaced?): convert it to another format"
    )]
    OtherSize {
        /// Columns of the JPEG, px.
        width: usize,
        /// Rows of the JPEG, px.
        height: usize,
        /// Columns announced, px.
        announced_width: usize,
        /// Rows announced, px.
        announced_height: usize,
    },
    /// The frame contains a damaged image.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// Why the bytes of an image cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file cannot be read.
    #[error("{cause}")]
    Read {
        /// The system's error.
        cause: std::io::Error,
    },
    /// The file has no bytes.
    #[error("the file is empty")]
    Empty,
    /// No decoder supports the format.
    #[error("the file is no image that can be read, or it is damaged: {reason}")]
    Unknown {
        /// GStreamer's message.
        reason: String,
    },
    /// A PNG, JPEG or EXR that its decoder refuses.
    #[error("the image is damaged: {cause}")]
    Damaged {
        /// The decoder's error.
        cause: image::ImageError,
    },
    /// An image that needs too much memory.
    #[error("an image of {width}x{height} px exceeds the limit of 512 MiB of decoded pixels: make it smaller")]
    TooLarge {
        /// Columns, px.
        width: u32,
        /// Rows, px.
        height: u32,
    },
    /// A TIFF that its decoder refuses.
    #[error("the TIFF is damaged or of an unknown kind: {cause}")]
    Tiff {
        /// The decoder's error.
        cause: tiff::TiffError,
    },
    /// The file contains several images.
    #[error("it holds {count} pages: write each to a file of its own")]
    Pages {
        /// Number of images.
        count: usize,
    },
    /// Parts of the image are missing in the file.
    #[error("the image is damaged: parts of it cannot be decoded")]
    Incomplete,
    /// Values or channels that cannot be shown as an image.
    #[error(
        "its format ({format}) is not supported: convert it to gray or colour of 8 or 16 bits without sign, or of 32-bit floats"
    )]
    Unsupported {
        /// The format, as text.
        format: String,
    },
    /// A JPEG that is truncated.
    #[error(transparent)]
    Jpeg(#[from] JpegError),
}
