//! How videos are compressed.

use panoscope_node::Choice;

/// How a video is compressed.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// Every frame is a JPEG: fast, each frame has its own time, and a crash loses no frame (.mkv).
    Mjpg,
    /// H.264: small files; needs an encoder in the system's FFmpeg.
    H264,
    /// MPEG-4 part 2.
    Mpeg4,
    /// VP8.
    Vp8,
    /// FFV1: lossless, large files.
    Ffv1,
}
