//! The calls that open devices, files, addresses and pipelines.

use std::time::Duration;

use opencv::core::Vector;
use opencv::prelude::*;
use opencv::videoio::{self, VideoCapture};

use super::demands::Demands;
use super::elements;
use super::error::CaptureError;
use super::name::SourceName;
use crate::devices;

/// A network stream without data for this long is lost. Shorter than the time after which the host gives up a call.
const READ_LIMIT: Duration = Duration::from_millis(1500);

/// Opens `name`. May wait for ever: [`super::opening`] sets the limit.
///
/// # Errors
/// [`CaptureError::Closed`].
pub fn open(name: &SourceName, demands: Demands) -> Result<VideoCapture, CaptureError> {
    let closed = |reason: String| CaptureError::Closed { name: name.in_words(), reason };
    let millis = |limit: Duration| i32::try_from(limit.as_millis()).unwrap_or(i32::MAX);
    let opened = match name {
        SourceName::Device(number) => VideoCapture::new(*number, videoio::CAP_V4L2),
        SourceName::Pipeline(text) => {
            let has_sink = text.contains("appsink");
            let tail = " ! videoconvert ! video/x-raw,format=BGR ! appsink";
            let text = if has_sink { text.clone() } else { format!("{text}{tail}") };
            if let Some(missing) = elements::missing(&elements::names(&text)) {
                return Err(closed(format!(
                    "GStreamer has no element `{missing}`: is it spelt right, and is the package installed that brings it? gst-inspect-1.0 lists what there is"
                )));
            }
            VideoCapture::from_file(&text, videoio::CAP_GSTREAMER)
        }
        SourceName::Address(text) => {
            let limits = [
                videoio::CAP_PROP_OPEN_TIMEOUT_MSEC,
                millis(demands.open_limit),
                videoio::CAP_PROP_READ_TIMEOUT_MSEC,
                millis(READ_LIMIT),
            ];
            VideoCapture::from_file_with_params(text, videoio::CAP_FFMPEG, &Vector::from_slice(&limits))
        }
        SourceName::Video(path) | SourceName::Image(path) => VideoCapture::from_file(path, videoio::CAP_FFMPEG),
        SourceName::Images(_) => VideoCapture::default(),
    };
    let mut capture = opened.map_err(|error| closed(error.message))?;
    if !capture.is_opened().unwrap_or(false) {
        return Err(closed(match name {
            SourceName::Device(_) => {
                format!("it may be in use by another program, or be no camera; {}", devices::in_words())
            }
            SourceName::Pipeline(_) => {
                "GStreamer refused it, or this OpenCV has no GStreamer: try it with gst-launch-1.0 first".into()
            }
            SourceName::Address(_) => "nothing answers at this address".into(),
            _ => "it is no video that FFmpeg knows, or it is damaged".into(),
        }));
    }
    if matches!(name, SourceName::Device(_)) {
        let settings = [
            (videoio::CAP_PROP_FRAME_WIDTH, f64::from(demands.width)),
            (videoio::CAP_PROP_FRAME_HEIGHT, f64::from(demands.height)),
            (videoio::CAP_PROP_FPS, demands.fps),
        ];
        for (property, value) in settings {
            if value > 0.0 {
                // A driver takes the nearest mode; the first picture shows which.
                let _ = capture.set(property, value);
            }
        }
        // One waiting picture instead of several: age matters more than completeness.
        let _ = capture.set(videoio::CAP_PROP_BUFFERSIZE, 1.0);
    }
    take_jpegs(&mut capture, name);
    Ok(capture)
}

/// Asks for the undecoded JPEGs of a Motion JPEG. OpenCV's decoders leave the previous picture where a frame is damaged, without an error.
fn take_jpegs(capture: &mut VideoCapture, name: &SourceName) {
    let code = capture.get(videoio::CAP_PROP_FOURCC).unwrap_or(0.0) as i64 as u32;
    if !matches!(&code.to_le_bytes(), b"MJPG" | b"JPEG" | b"mjpg" | b"jpeg") {
        return;
    }
    // A source that refuses delivers decoded pictures.
    let _ = match name {
        SourceName::Device(_) => capture.set(videoio::CAP_PROP_CONVERT_RGB, 0.0),
        SourceName::Video(_) | SourceName::Address(_) => capture.set(videoio::CAP_PROP_FORMAT, -1.0),
        _ => return,
    };
}
