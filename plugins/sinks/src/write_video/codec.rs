//! Compression of videos, and which container holds which codec.

use panoscope_media::{Container, Framing, RateControl, VideoCodec};
use panoscope_node::Choice;

/// Compression of a video.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// Every frame is a JPEG: fast, and each frame decodes independently.
    Mjpg,
    /// H.264: small files that play everywhere.
    H264,
    /// HEVC (H.265): smaller files than H.264, slower.
    Hevc,
    /// MPEG-4 part 2.
    Mpeg4,
    /// VP8, for .webm.
    Vp8,
    /// FFV1: lossless, large files.
    Ffv1,
}

/// Extensions of video files.
pub const ENDINGS: &str = "mkv, avi, mp4, mov, webm";

/// Kind of a video file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// Matroska, or WebM, its subset: plays to the last complete frame wherever it is truncated.
    Matroska {
        /// Whether it is WebM.
        is_webm: bool,
    },
    /// A container that a crash leaves unplayable.
    Indexed(Container),
}

impl FileKind {
    /// The kind of a file with one of the [`ENDINGS`].
    pub fn of(ending: &str) -> Self {
        match ending {
            "avi" => Self::Indexed(Container::Avi),
            "mp4" => Self::Indexed(Container::Mp4),
            "mov" => Self::Indexed(Container::Mov),
            other => Self::Matroska { is_webm: other == "webm" },
        }
    }

    /// Whether a file of this kind can hold a video of `codec`.
    pub fn holds(self, codec: Codec) -> bool {
        match self {
            Self::Matroska { is_webm: false } => true,
            Self::Matroska { is_webm: true } => codec == Codec::Vp8,
            Self::Indexed(Container::Avi) => matches!(codec, Codec::Mjpg | Codec::H264 | Codec::Mpeg4),
            Self::Indexed(Container::Mp4) => !matches!(codec, Codec::Vp8 | Codec::Ffv1),
            Self::Indexed(Container::Mov) => codec != Codec::Ffv1,
        }
    }

    /// Framing of H.264 and HEVC in such a file.
    pub fn framing(self) -> Framing {
        if self == Self::Indexed(Container::Avi) { Framing::StartCodes } else { Framing::Lengths }
    }

    /// Whether all frames are shown for the same time.
    pub fn has_constant_rate(self) -> bool {
        self == Self::Indexed(Container::Avi)
    }
}

impl Codec {
    /// Settings of the encoder for these qualities.
    pub fn with(self, quality_pct: u8, crf: u8) -> VideoCodec {
        match self {
            Self::Mjpg => VideoCodec::Mjpeg { quality_pct },
            Self::H264 => VideoCodec::H264 { rate: RateControl::Crf(crf) },
            Self::Hevc => VideoCodec::Hevc { rate: RateControl::Crf(crf) },
            Self::Mpeg4 => VideoCodec::Mpeg4 { quality_pct },
            Self::Vp8 => VideoCodec::Vp8 { quality_pct },
            Self::Ffv1 => VideoCodec::Ffv1,
        }
    }

    /// Matroska's name of the codec.
    pub fn matroska_id(self) -> &'static str {
        match self {
            Self::Mjpg => "V_MJPEG",
            Self::H264 => "V_MPEG4/ISO/AVC",
            Self::Hevc => "V_MPEGH/ISO/HEVC",
            Self::Mpeg4 => "V_MPEG4/ISO/ASP",
            Self::Vp8 => "V_VP8",
            Self::Ffv1 => "V_FFV1",
        }
    }
}
