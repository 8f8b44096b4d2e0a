//! Errors of pipelines.

use std::time::Duration;

use gstreamer::message::Error as BusError;
use gstreamer::prelude::*;

/// Error of a pipeline.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MediaError {
    /// GStreamer itself cannot be started.
    #[error("GStreamer cannot start: {reason}")]
    Init {
        /// GStreamer's message.
        reason: String,
    },
    /// An element is not installed.
    #[error("the GStreamer element `{element}` is not installed: `apt install {package}`")]
    MissingElement {
        /// Name of the element.
        element: String,
        /// Debian package that holds it.
        package: &'static str,
    },
    /// An encoder or a muxer refused its settings or failed without a report.
    #[error("{encoder}: {reason}")]
    Encoder {
        /// Name of the element.
        encoder: String,
        /// What happened.
        reason: String,
    },
    /// No space is left on the disk that an element writes to.
    #[error("{element}: no space is left on the disk")]
    DiskFull {
        /// Name of the element.
        element: String,
    },
    /// An element reported an error on the bus.
    #[error("{element}: {reason}{}", details.as_deref().map(|text| format!(" ({text})")).unwrap_or_default())]
    Bus {
        /// Name of the element that reported it.
        element: String,
        /// What the element reported.
        reason: String,
        /// Details for developers.
        details: Option<String>,
    },
    /// No decoder for a stream is installed.
    #[error("no installed GStreamer element decodes {format}: `apt install {package}`")]
    MissingDecoder {
        /// Name of the format.
        format: String,
        /// Debian package that holds decoders of it.
        package: &'static str,
    },
    /// A pipeline that cannot be built or started.
    #[error("{reason}")]
    Refused {
        /// GStreamer's message.
        reason: String,
    },
    /// No frame arrived in time.
    #[error("no image arrived within {} s", limit.as_secs_f64())]
    Silent {
        /// The limit.
        limit: Duration,
    },
}

/// Formats with decoders outside gstreamer1.0-libav, by the start of their media type.
const PACKAGES: &[(&str, &str)] = &[
    ("video/x-vp8", "gstreamer1.0-plugins-good"),
    ("video/x-vp9", "gstreamer1.0-plugins-good"),
    ("video/x-theora", "gstreamer1.0-plugins-base"),
    ("video/x-av1", "gstreamer1.0-plugins-bad"),
    ("image/webp", "gstreamer1.0-plugins-bad"),
    ("application/x-rtp", "gstreamer1.0-plugins-good"),
];

impl MediaError {
    /// The error for a `missing-plugin` message of a decoder.
    pub(crate) fn of_missing_plugin(structure: &gstreamer::StructureRef) -> Option<Self> {
        if structure.name() != "missing-plugin" || structure.get::<&str>("type").ok()? != "decoder" {
            return None;
        }
        let caps = structure.get::<gstreamer::Caps>("detail").ok()?;
        let media = caps.structure(0)?.name().to_string();
        // Sound and subtitles are not needed.
        if !["video/", "image/", "application/x-rtp"].iter().any(|kind| media.starts_with(kind)) {
            return None;
        }
        let package =
            PACKAGES.iter().find(|(kind, _)| media.starts_with(kind)).map_or("gstreamer1.0-libav", |(_, p)| p);
        let name = structure.get::<&str>("name").map_or_else(|_| media.clone(), |name| format!("{name} ({media})"));
        Some(Self::MissingDecoder { format: name, package })
    }
}

impl From<&BusError> for MediaError {
    fn from(message: &BusError) -> Self {
        let element = message.src().map_or_else(|| "pipeline".to_owned(), |source| source.name().to_string());
        if message.error().matches(gstreamer::ResourceError::NoSpaceLeft) {
            return Self::DiskFull { element };
        }
        Self::Bus {
            element,
            reason: message.error().message().to_owned(),
            details: message.debug().map(|text| text.to_string()),
        }
    }
}
