//! Compression of a stream.

use panoscope_node::Choice;

/// Compression of a stream.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamCodec {
    /// H.264 without delay; plays everywhere.
    H264,
    /// HEVC (H.265) without delay; better quality at the same rate, slower.
    Hevc,
    /// One JPEG per frame: a lost packet costs one frame; high bit rate; frames up to 2040x2040 px.
    Mjpg,
}
