//! Elements by name, with the package to install when one is missing.

use std::sync::OnceLock;

use gstreamer::{Element, ElementFactory};

use crate::MediaError;

/// Elements that are used by name, and Debian's package of each.
const PACKAGES: &[(&str, &[&str])] = &[
    ("libgstreamer1.0-0", &["capsfilter", "filesink"]),
    (
        "gstreamer1.0-plugins-base",
        &["appsink", "appsrc", "decodebin", "uridecodebin", "videoconvert", "videoscale", "videorate", "videotestsrc"],
    ),
    (
        "gstreamer1.0-plugins-good",
        &[
            "v4l2src",
            "rtspsrc",
            "rtpbin",
            "jpegdec",
            "jpegenc",
            "matroskamux",
            "matroskademux",
            "avimux",
            "avidemux",
            "qtdemux",
            "qtmux",
            "mp4mux",
            "vp8enc",
            "udpsink",
            "deinterlace",
            "rtph264pay",
            "rtph265pay",
            "rtpjpegpay",
            "rtph264depay",
            "souphttpsrc",
            "multipartdemux",
        ],
    ),
    ("libgstreamer1.0-0", &["capsfilter", "filesrc", "queue"]),
    (
        "gstreamer1.0-plugins-bad",
        &[
            "h264parse",
            "h265parse",
            "jpegparse",
            "openh264enc",
            "openh264dec",
            "x265enc",
            "webrtcbin",
            "dtlssrtpenc",
            "dtlssrtpdec",
            "srtpenc",
            "srtpdec",
        ],
    ),
    ("gstreamer1.0-nice", &["nicesrc", "nicesink"]),
    ("gstreamer1.0-plugins-ugly", &["x264enc"]),
    ("gstreamer1.0-libav", &["avdec_h264", "avdec_h265", "avdec_mjpeg", "avenc_ffv1", "avdec_ffv1", "avenc_mpeg4"]),
    ("gstreamer1.0-rtsp", &["rtspclientsink"]),
];

/// Starts GStreamer; later calls return the first call's result.
///
/// # Errors
/// GStreamer cannot be initialized.
pub fn init() -> Result<(), MediaError> {
    static STARTED: OnceLock<Result<(), gstreamer::glib::Error>> = OnceLock::new();
    STARTED.get_or_init(gstreamer::init).clone().map_err(|error| MediaError::Init { reason: error.to_string() })
}

/// Makes the element `name`.
///
/// # Errors
/// GStreamer cannot start, or no plugin has the element: the error names the package to install.
pub fn make(name: &str) -> Result<Element, MediaError> {
    init()?;
    ElementFactory::make(name)
        .build()
        .map_err(|_| MediaError::MissingElement { element: name.to_owned(), package: package_of(name) })
}

/// Whether an element `name` is installed; `None` when GStreamer does not start.
pub fn is_installed(name: &str) -> Option<bool> {
    init().ok()?;
    Some(ElementFactory::find(name).is_some())
}

/// Debian's package that holds `element`.
fn package_of(element: &str) -> &'static str {
    PACKAGES
        .iter()
        .find(|(_, elements)| elements.contains(&element))
        .map_or("gstreamer1.0-plugins-bad", |(package, _)| package)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_element_names_its_package() {
        let error = make("nosuchencoder").expect_err("there is no such element").to_string();
        assert!(error.contains("`nosuchencoder`") && error.contains("apt install gstreamer1.0-"), "{error}");
    }

    #[test]
    fn every_listed_element_is_installed() {
        for (package, elements) in PACKAGES {
            for element in *elements {
                assert!(make(element).is_ok(), "{element} of {package}");
            }
        }
    }
}
