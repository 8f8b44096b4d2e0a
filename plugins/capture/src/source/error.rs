//! Errors of sources and of image decoding.

use std::path::PathBuf;

use panoscope_media::input::jpeg::JpegError;

/// Why a source delivers no frame.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum CaptureError {
    /// The file does not exist.
    #[error("the file {path} does not exist{hint}", path = path.display())]
    Missing { path: PathBuf, hint: String },
    /// The camera does not exist.
    #[error("the camera {path} does not exist: {present}", path = path.display())]
    NoDevice {
        path: PathBuf,
        /// The cameras of this machine, as text.
        present: String,
    },
    /// No image matches a pattern or folder.
    #[error("no image matches {pattern}; {hint}")]
    NoMatch { pattern: String, hint: String },
    /// A file that cannot be read or is not an image.
    #[error("{path}{place} cannot be read: {cause}", path = path.display())]
    Unreadable {
        path: PathBuf,
        /// Its number in a series, or empty.
        place: String,
        cause: PictureError,
    },
    /// A device, video or pipeline that does not open.
    #[error("{name} does not open: {reason}")]
    Closed { name: String, reason: String },
    /// A frame of a device, video or pipeline that cannot be decoded.
    #[error("{name}: frame {frame}{of_expected} cannot be decoded: {cause}")]
    Frame {
        name: String,
        frame: u64,
        /// Number of frames that the source announces, as ` of N`, or empty.
        of_expected: String,
        cause: FrameError,
    },
}

/// Why a frame of a stream cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum FrameError {
    /// No frame was grabbed.
    #[error("no frame was grabbed")]
    NotThere,
    /// The decoder returned an image without pixels.
    #[error("the decoder returned an empty frame")]
    Empty,
    /// The frame was decoded from damaged or missing data.
    #[error("its data are damaged: {reason}")]
    Damaged {
        /// What the source or the decoder reported.
        reason: String,
    },
    /// Fewer bytes than the format needs.
    #[error("it has {bytes} bytes, but its format needs {expected}")]
    Short {
        bytes: usize,
        /// Number of bytes of a complete frame.
        expected: usize,
    },
    /// The format does not describe an image of rows and columns.
    #[error("the format {format} is not supported")]
    Unsupported { format: String },
    /// A JPEG of another size than the stream announces.
    #[error(
        "the JPEG is {width}x{height}, but the stream announces {announced_width}x{announced_height} (interlaced?): convert it to another format"
    )]
    OtherSize { width: usize, height: usize, announced_width: usize, announced_height: usize },
    /// The frame contains a damaged image.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// Why the bytes of an image cannot be decoded.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum PictureError {
    /// The file cannot be read.
    #[error("{cause}")]
    Read { cause: std::io::Error },
    /// The file has no bytes.
    #[error("the file is empty")]
    Empty,
    /// No decoder supports the format.
    #[error("the file is not a supported image, or is damaged: {reason}")]
    Unknown { reason: String },
    /// A PNG, JPEG or EXR that its decoder refuses.
    #[error("the image is damaged: {cause}")]
    Damaged { cause: image::ImageError },
    /// An image that needs too much memory.
    #[error("an image of {width}x{height} px exceeds the limit of 512 MiB of decoded pixels: make it smaller")]
    TooLarge { width: u32, height: u32 },
    /// A TIFF that its decoder refuses.
    #[error("the TIFF is damaged or unsupported: {cause}")]
    Tiff { cause: tiff::TiffError },
    /// The file contains several images.
    #[error("it has {count} pages: write each one to a separate file")]
    Pages { count: usize },
    /// Parts of the image are missing in the file.
    #[error("the image is damaged: parts of it cannot be decoded")]
    Incomplete,
    /// Values or channels that cannot be shown as an image.
    #[error(
        "its format ({format}) is not supported: convert it to gray or colour of 8 or 16 bits without sign, or of 32-bit floats"
    )]
    Unsupported { format: String },
    /// A JPEG that is truncated.
    #[error(transparent)]
    Jpeg(#[from] JpegError),
}
