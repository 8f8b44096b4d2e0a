//! How a stream is compressed.

use panoscope_node::Choice;

/// How a stream is compressed.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamCodec {
    /// H.264 without delay: plays everywhere.
    H264,
    /// HEVC (H.265) without delay: better at the same rate, slower.
    Hevc,
    /// One JPEG per picture: a lost packet costs one picture; many bits; pictures up to 2040x2040 px.
    Mjpg,
}
