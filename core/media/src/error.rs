//! Errors of pipelines.

use gstreamer::message::Error as BusError;
use gstreamer::prelude::*;

/// What can go wrong in a pipeline.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MediaError {
    /// GStreamer itself cannot be started.
    #[error("GStreamer cannot start: {reason}")]
    Init {
        /// GStreamer's words.
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
        /// What it says for developers.
        details: Option<String>,
    },
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
