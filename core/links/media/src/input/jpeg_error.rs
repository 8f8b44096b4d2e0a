//! Errors of the JPEG check.

/// A JPEG that is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JpegError {
    /// The first bytes are not those of a JPEG.
    #[error("it does not begin like a JPEG")]
    NotJpeg,
    /// The end marker is missing.
    #[error("the JPEG is truncated after {bytes} bytes: its end is missing")]
    CutOff {
        /// Number of bytes.
        bytes: usize,
    },
    /// There is no scan before the end marker.
    #[error("the JPEG has no image")]
    NoPicture,
    /// Its coded data do not match the blocks in its header.
    #[error("the JPEG is damaged near block {block}")]
    Broken {
        /// Number of the block, or group of blocks, at which this was noticed.
        block: usize,
    },
}
