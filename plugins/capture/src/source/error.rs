//! Errors of sources and pictures.

use std::path::PathBuf;

use panoscope_media::input::jpeg::JpegError;

/// Why a source gives no picture.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The file does not exist.
    #[error("there is no file {path}{hint}", path = path.display())]
    Missing {
        /// Absolute path.
        path: PathBuf,
        /// More about the place, or empty.
        hint: String,
    },
    /// The camera does not exist.
    #[error("there is no camera {path}: {present}", path = path.display())]
    NoDevice {
        /// The device's file.
        path: PathBuf,
        /// The cameras of this machine, in words.
        present: String,
    },
    /// A pattern or folder without any image.
    #[error("no image matches {pattern}; {hint}")]
    NoMatch {
        /// Absolute pattern.
        pattern: String,
        /// What to do.
        hint: String,
    },
    /// A file that cannot be read or is no image.
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
        /// The source, in words.
        name: String,
        /// Why, and what to do.
        reason: String,
    },
    /// A frame of a device, video or pipeline that cannot be decoded.
    #[error("{name}: frame {frame}{of_expected} cannot be decoded: {cause}")]
    Frame {
        /// The source, in words.
        name: String,
        /// Number of the frame, from 1.
        frame: u64,
        /// Number of frames that the source announces, as ` of N`, or empty.
        of_expected: String,
        /// What is wrong with the frame.
        cause: FrameError,
    },
}

/// What is wrong with a frame of a stream.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// Nothing was grabbed.
    #[error("no frame is there")]
    NotThere,
    /// The decoder returned a picture of no pixels.
    #[error("an empty picture came")]
    Empty,
    /// It was made from damaged or missing data.
    #[error("its data are damaged: {reason}")]
    Damaged {
        /// What the source or the decoder reported.
        reason: String,
    },
    /// Fewer bytes than the format needs.
    #[error("{bytes} bytes came, its format needs {expected}")]
    Short {
        /// Bytes that came.
        bytes: usize,
        /// Bytes of a whole frame.
        expected: usize,
    },
    /// A format that is no picture of rows and columns.
    #[error("the format {format} is not supported")]
    Unsupported {
        /// GStreamer's name.
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
    /// The frame holds a damaged picture.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// What is wrong with the bytes of a picture.
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
    /// No decoder takes it.
    #[error("the file is no image that can be read, or it is damaged: {reason}")]
    Unknown {
        /// GStreamer's words.
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
    /// A file of several images.
    #[error("it holds {count} pages: write each to a file of its own")]
    Pages {
        /// How many.
        count: usize,
    },
    /// Parts of the picture are not in the file.
    #[error("the image is damaged: parts of it cannot be decoded")]
    Incomplete,
    /// Values or channels that are no picture.
    #[error(
        "its format ({format}) is not supported: convert it to gray or colour of 8 or 16 bits without sign, or of 32-bit floats"
    )]
    Unsupported {
        /// The format in words.
        format: String,
    },
    /// A JPEG that is not whole.
    #[error(transparent)]
    Jpeg(#[from] JpegError),
}
