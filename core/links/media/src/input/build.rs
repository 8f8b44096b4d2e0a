//! The pipeline of each kind of input, up to its appsink.

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app::AppSink;

use super::modes::{self, CameraMode};
use super::{InputName, Shared, YUV_FORMATS};
use crate::MediaError;
use crate::elements::make;

/// Maximum wait for RTP packets that are out of order, ms.
const JITTER_MS: u32 = 100;
/// Maximum wait for an answer of an RTSP server, and for its UDP packets before TCP is tried, us.
const RTSP_ANSWER_US: u64 = 2_000_000;
const RTSP_UDP_US: u64 = 1_000_000;

/// A pipeline and its end.
pub(super) struct Built {
    pub pipeline: gst::Pipeline,
    pub sink: AppSink,
}

/// Formats that a decoder leaves unchanged: JPEGs stay undecoded, so that damage can be detected.
fn wanted() -> gst::Caps {
    [gst::Structure::new_empty("image/jpeg"), gst::Structure::new_empty("video/x-raw")].into_iter().collect()
}

fn app_sink() -> Result<AppSink, MediaError> {
    let sink = make("appsink")?;
    let broken = |_| MediaError::MissingElement { element: "appsink".to_owned(), package: "gstreamer1.0-plugins-base" };
    sink.downcast::<AppSink>().map_err(broken)
}

/// Configures GStreamer's sources and demuxers for live video.
pub(super) fn configure(element: &gst::Element) {
    let Some(factory) = element.factory() else { return };
    match factory.name().as_str() {
        "rtspsrc" => {
            element.set_property("latency", JITTER_MS);
            element.set_property("drop-on-latency", true);
            element.set_property("tcp-timeout", RTSP_ANSWER_US);
            element.set_property("timeout", RTSP_UDP_US);
        }
        // Otherwise it waits for more streams before it shows its first.
        "multipartdemux" => element.set_property("single-stream", true),
        _ => {}
    }
}

/// Links the first video pad of a decoder to the appsink, through what its format needs.
fn link(pipeline: &gst::Pipeline, pad: &gst::Pad, sink: &AppSink, shared: &Shared) -> Result<(), MediaError> {
    let caps = pad.current_caps().unwrap_or_else(|| pad.query_caps(None));
    let Some(structure) = caps.structure(0) else { return Ok(()) };
    let target = sink.upcast_ref::<gst::Element>();
    let Some(end) = target.static_pad("sink") else { return Ok(()) };
    if end.is_linked() {
        return Ok(());
    }
    let unlinked = |error: String| MediaError::Bus { element: pad.name().to_string(), reason: error, details: None };
    if structure.name() != "video/x-raw" {
        return pad.link(&end).map(drop).map_err(|error| unlinked(error.to_string()));
    }
    let is_interlaced = structure.get::<&str>("interlace-mode").is_ok_and(|mode| mode != "progressive");
    let is_deep_gray = structure.get::<&str>("format").is_ok_and(|format| format.starts_with("GRAY16"));
    shared.set_interlaced(is_interlaced);
    let mut chain = Vec::new();
    if is_interlaced {
        let deinterlace = make("deinterlace")?;
        // From one field alone: other methods mix in pixels of earlier pictures. One picture for each frame.
        deinterlace.set_property_from_str("method", "linear");
        deinterlace.set_property_from_str("fields", "top");
        chain.push(deinterlace);
    }
    chain.push(make("videoconvert")?);
    let filter = make("capsfilter")?;
    let raw = gst::Caps::builder("video/x-raw");
    let raw = match is_deep_gray {
        true => raw.field("format", "GRAY16_LE"),
        false => raw.field("format", gst::List::new(["BGR"].into_iter().chain(YUV_FORMATS))),
    };
    filter.set_property("caps", raw.build());
    chain.push(filter);
    for element in &chain {
        pipeline.add(element).map_err(|error| unlinked(error.to_string()))?;
    }
    let elements: Vec<&gst::Element> = chain.iter().chain([target]).collect();
    gst::Element::link_many(elements).map_err(|error| unlinked(error.to_string()))?;
    for element in &chain {
        element.sync_state_with_parent().map_err(|error| unlinked(error.to_string()))?;
    }
    let Some(first) = chain[0].static_pad("sink") else { return Ok(()) };
    pad.link(&first).map(drop).map_err(|error| unlinked(error.to_string()))
}

/// Sets `decoder` to leave JPEGs undecoded, and links it to the appsink once it knows its stream.
fn decode_to(decoder: &gst::Element, built: &Built, shared: &std::sync::Arc<Shared>) {
    // Decoders are chosen by what they could give, from any memory.
    let mut caps = gst::Caps::new_empty_simple("image/jpeg");
    caps.merge(gst::Caps::builder("video/x-raw").any_features().build());
    decoder.set_property("caps", caps);
    decoder.set_property("expose-all-streams", false);
    let (pipeline, sink, shared) =
        (built.pipeline.downgrade(), built.sink.downgrade(), std::sync::Arc::downgrade(shared));
    decoder.connect_pad_added(move |_, pad| {
        let (Some(pipeline), Some(sink), Some(shared)) = (pipeline.upgrade(), sink.upgrade(), shared.upgrade()) else {
            return;
        };
        if let Err(error) = link(&pipeline, pad, &sink, &shared) {
            shared.fail(error.to_string());
        }
    });
}

fn add(pipeline: &gst::Pipeline, elements: &[&gst::Element]) -> Result<(), MediaError> {
    let refused = |error: gst::glib::BoolError| MediaError::Refused { reason: error.to_string() };
    pipeline.add_many(elements.iter().copied()).map_err(refused)
}

fn connect(elements: &[&gst::Element]) -> Result<(), MediaError> {
    gst::Element::link_many(elements.iter().copied()).map_err(|error| MediaError::Refused { reason: error.to_string() })
}

/// Builds the pipeline of `name`. No device or file is opened yet, except that a camera is asked for its modes.
pub(super) fn build(name: &InputName, mode: CameraMode, shared: &std::sync::Arc<Shared>) -> Result<Built, MediaError> {
    match name {
        InputName::Camera(path) => {
            let built = Built { pipeline: gst::Pipeline::new(), sink: app_sink()? };
            let (source, filter, decoder) = (make("v4l2src")?, make("capsfilter")?, make("decodebin")?);
            source.set_property("device", path.display().to_string());
            add(&built.pipeline, &[&source, &filter, &decoder, built.sink.upcast_ref()])?;
            connect(&[&source, &filter, &decoder])?;
            filter.set_property("caps", camera_mode(&source, mode));
            decode_to(&decoder, &built, shared);
            Ok(built)
        }
        InputName::File(path) => {
            let refused = |error: gst::glib::Error| MediaError::Refused { reason: error.to_string() };
            from_uri(&gst::glib::filename_to_uri(path, None).map_err(refused)?, shared)
        }
        InputName::Address(address) => from_uri(address, shared),
        InputName::Text(text) => from_text(text, shared),
    }
}

fn from_uri(uri: &str, shared: &std::sync::Arc<Shared>) -> Result<Built, MediaError> {
    let built = Built { pipeline: gst::Pipeline::new(), sink: app_sink()? };
    let decoder = make("uridecodebin")?;
    decoder.set_property("uri", uri);
    add(&built.pipeline, &[&decoder, built.sink.upcast_ref()])?;
    decode_to(&decoder, &built, shared);
    Ok(built)
}

/// The camera's mode that is nearest to the requested one, read while the device is open but does not stream.
fn camera_mode(source: &gst::Element, mode: CameraMode) -> gst::Caps {
    if mode == CameraMode::default() || source.set_state(gst::State::Ready).is_err() {
        return modes::readable();
    }
    let offered = source.static_pad("src").map(|pad| pad.query_caps(None));
    offered.and_then(|offered| modes::nearest(&offered, mode)).unwrap_or_else(modes::readable)
}

const DECODER: &str = "panoscope_decoder";

/// A pipeline in the syntax of `gst-launch-1.0`. Its output is decoded unless it has its own appsink.
fn from_text(text: &str, shared: &std::sync::Arc<Shared>) -> Result<Built, MediaError> {
    let refused = |error: gst::glib::Error| MediaError::Refused { reason: error.message().to_owned() };
    let parsed = |text: &str| {
        let parsed = gst::parse::launch(text).map_err(refused)?;
        parsed.downcast::<gst::Pipeline>().or_else(|element| {
            // One element alone is returned as it is.
            let pipeline = gst::Pipeline::new();
            add(&pipeline, &[&element]).map(|()| pipeline)
        })
    };
    let own_sink = |pipeline: &gst::Pipeline| {
        pipeline.iterate_recurse().into_iter().flatten().find_map(|element| element.downcast::<AppSink>().ok())
    };
    if text.contains("appsink") {
        let pipeline = parsed(text)?;
        if let Some(sink) = own_sink(&pipeline) {
            if sink.caps().is_none_or(|caps| caps.is_any()) {
                sink.set_caps(Some(&wanted()));
            }
            return Ok(Built { pipeline, sink });
        }
    }
    let pipeline = parsed(&format!("{text} ! decodebin name={DECODER}"))?;
    let built = Built { pipeline, sink: app_sink()? };
    add(&built.pipeline, &[built.sink.upcast_ref()])?;
    if let Some(decoder) = built.pipeline.by_name(DECODER) {
        decode_to(&decoder, &built, shared);
    }
    Ok(built)
}
