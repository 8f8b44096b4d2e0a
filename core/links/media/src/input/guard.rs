//! Marks the images that a decoder makes from damaged data.
//!
//! Damaged data is missing (a discontinuity), flagged by the source, or reported by the decoder. Images of a predictive
//! codec are correct again from the next keyframe on; until then all decoded images are marked. Marked buffers carry
//! `GST_BUFFER_FLAG_CORRUPTED`; their times are kept as well, because some elements do not pass the flag on.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use gstreamer as gst;
use gstreamer::prelude::*;

use super::access_unit::{self, Codec};
use super::jpeg;
use super::libav_log::{self, DamageReport};

/// Times of marked images that are kept.
const KEPT: usize = 1024;
/// Maximum length of a decoder's message that is passed on.
const MAX_REASON: usize = 120;

/// How a decoder's input shows where decoding can begin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Format {
    /// Access units of this codec; bytes of the length before each unit, or start codes.
    Units(Codec, Option<usize>),
    /// Every buffer is one JPEG.
    Jpeg,
    /// Wherever GStreamer's flags allow it.
    #[default]
    Flags,
}

#[derive(Debug)]
struct Span {
    format: Format,
    has_begun: bool,
    /// Reason why the data that is decoded now is damaged.
    damage: Option<String>,
    /// Images shown before this time depend on data before the last keyframe.
    clean_from_ns: u64,
    /// Time of the access unit that is decoded now.
    decoding_ns: Option<u64>,
    bad: BTreeSet<u64>,
    /// The newest reason of a mark.
    reason: String,
}

/// The guard of one decoder.
pub struct Guard {
    span: Mutex<Span>,
    /// Whether anything was marked since the pipeline began.
    has_marks: Arc<AtomicBool>,
    complaints: AtomicU64,
    on_failure: FailFn,
}

/// Receives the reason why a decoder cannot go on.
type FailFn = Box<dyn Fn(&str) + Send + Sync>;

impl Guard {
    fn new(has_marks: Arc<AtomicBool>, on_failure: FailFn) -> Self {
        let span = Span {
            format: Format::default(),
            has_begun: false,
            damage: Some("the stream has not had a key picture yet".to_owned()),
            clean_from_ns: 0,
            decoding_ns: None,
            bad: BTreeSet::new(),
            reason: String::new(),
        };
        Self { span: Mutex::new(span), has_marks, complaints: AtomicU64::new(0), on_failure }
    }

    fn span(&self) -> MutexGuard<'_, Span> {
        self.span.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn mark(&self, span: &mut Span, pts_ns: u64, words: &str) {
        if span.bad.len() >= KEPT {
            span.bad.pop_first();
        }
        span.bad.insert(pts_ns);
        words.clone_into(&mut span.reason);
        self.has_marks.store(true, Ordering::Release);
    }

    /// The reason why the image of this time is damaged.
    pub fn reason_of(&self, pts_ns: u64) -> Option<String> {
        let span = self.span();
        span.bad.contains(&pts_ns).then(|| span.reason.clone())
    }

    fn set_format(&self, caps: &gst::CapsRef) {
        let Some(structure) = caps.structure(0) else { return };
        let codec = match structure.name().as_str() {
            "video/x-h264" => Some(Codec::H264),
            "video/x-h265" => Some(Codec::H265),
            _ => None,
        };
        let is_jpeg = structure.name() == "image/jpeg";
        let is_sized = structure.get::<&str>("stream-format").is_ok_and(|format| format != "byte-stream");
        let record = structure.get::<gst::Buffer>("codec_data").ok();
        let record = record.as_ref().and_then(|record| record.map_readable().ok());
        self.span().format = match codec {
            Some(codec) => {
                let length = |codec| record.map_or(4, |record| access_unit::length_bytes(codec, &record));
                Format::Units(codec, is_sized.then(|| length(codec)))
            }
            None if is_jpeg => Format::Jpeg,
            None => Format::Flags,
        };
    }

    /// Records the next input of the decoder.
    fn before(&self, buffer: &gst::BufferRef) {
        let mut span = self.span();
        let pts_ns = buffer.pts().map(gst::ClockTime::nseconds);
        span.decoding_ns = pts_ns;
        let flags = buffer.flags();
        let is_first = !std::mem::replace(&mut span.has_begun, true);
        let is_flagged = flags.contains(gst::BufferFlags::CORRUPTED);
        let is_gap = !is_first && flags.contains(gst::BufferFlags::DISCONT);
        let map = buffer.map_readable();
        let bytes = map.as_ref().map_or(&[][..], |map| map.as_slice());
        if span.format == Format::Jpeg {
            span.damage = None;
            let fault = if is_flagged { Some("the source marked it".to_owned()) } else { jpeg_fault(bytes) };
            if let (Some(words), Some(pts_ns)) = (fault, pts_ns) {
                self.mark(&mut span, pts_ns, &words);
            }
            return;
        }
        let is_key = match span.format {
            Format::Units(codec, length) => access_unit::is_key(codec, bytes, length),
            _ => !flags.contains(gst::BufferFlags::DELTA_UNIT),
        };
        if is_gap {
            span.damage = Some("data is missing before it".to_owned());
        }
        if is_key && span.damage.take().is_some() {
            span.clean_from_ns = pts_ns.unwrap_or(0);
        }
        if is_flagged {
            span.damage = Some("the source marked it".to_owned());
        }
        if let Format::Units(codec, length) = span.format
            && access_unit::is_broken(codec, bytes, length)
        {
            span.damage = Some("its data cannot be whole".to_owned());
        }
        let is_leading = pts_ns.is_some_and(|pts| pts < span.clean_from_ns);
        if let Some(pts_ns) = pts_ns
            && (span.damage.is_some() || is_leading)
        {
            let words = span.damage.clone().unwrap_or_else(|| "it needs pictures before the key picture".to_owned());
            self.mark(&mut span, pts_ns, &words);
        }
    }

    /// Whether the decoder's output is damaged.
    fn is_bad(&self, pts: Option<gst::ClockTime>) -> bool {
        let span = self.span();
        match pts {
            Some(pts) => span.bad.contains(&pts.nseconds()),
            None => span.damage.is_some(),
        }
    }

    /// Resets the state after a seek.
    fn flush(&self) {
        let mut span = self.span();
        span.has_begun = false;
        span.bad.clear();
        span.clean_from_ns = 0;
        if span.format != Format::Jpeg {
            span.damage = Some("the stream has not had a key picture yet".to_owned());
        }
    }
}

impl DamageReport for Guard {
    /// Marks the data that the decoder decodes now as damaged.
    fn report(&self, words: &str) {
        self.complaints.fetch_add(1, Ordering::Relaxed);
        let words: String = words.trim().chars().take(MAX_REASON).collect();
        let mut span = self.span();
        let is_jpeg = span.format == Format::Jpeg;
        if let Some(now_ns) = span.decoding_ns {
            self.mark(&mut span, now_ns, &words);
        }
        if !is_jpeg {
            span.damage.get_or_insert(words);
        }
    }

    fn fail(&self, reason: &str) {
        (self.on_failure)(reason);
    }
}

fn jpeg_fault(bytes: &[u8]) -> Option<String> {
    jpeg::check(bytes).err().map(|error| error.to_string())
}

/// The guards of a pipeline's decoders.
#[derive(Default)]
pub struct Guards {
    list: Mutex<Vec<Arc<Guard>>>,
    has_marks: Arc<AtomicBool>,
}

impl Guards {
    /// The reason why the image of this time is damaged.
    pub fn reason_of(&self, pts_ns: Option<u64>) -> Option<String> {
        if !self.has_marks.load(Ordering::Acquire) {
            return None;
        }
        let list = self.list.lock().unwrap_or_else(PoisonError::into_inner);
        list.iter().find_map(|guard| guard.reason_of(pts_ns?))
    }

    /// The newest reason of a mark.
    pub fn newest_reason(&self) -> Option<String> {
        let list = self.list.lock().unwrap_or_else(PoisonError::into_inner);
        list.iter().map(|guard| guard.span().reason.clone()).find(|reason| !reason.is_empty())
    }

    /// Whether anything was damaged.
    pub fn has_marks(&self) -> bool {
        self.has_marks.load(Ordering::Acquire)
    }

    /// Guards `element` if it decodes video or images. `on_failure` is called when it cannot go on.
    pub fn attach(&self, element: &gst::Element, on_failure: impl Fn(&str) + Send + Sync + 'static) {
        let Some(factory) = element.factory() else { return };
        let class = factory.metadata("klass").unwrap_or("");
        if !class.contains("Decoder") || !(class.contains("Video") || class.contains("Image")) {
            return;
        }
        let (Some(sink), Some(source)) = (element.static_pad("sink"), element.static_pad("src")) else { return };
        if element.has_property_with_type("max-threads", i32::static_type()) {
            // FFmpeg's complaints come on the thread that decodes: only so are they this decoder's.
            element.set_property("max-threads", 1_i32);
        }
        let guard = Arc::new(Guard::new(self.has_marks.clone(), Box::new(on_failure)));
        self.list.lock().unwrap_or_else(PoisonError::into_inner).push(guard.clone());
        if let Some(caps) = sink.current_caps() {
            guard.set_format(&caps);
        }
        let kinds = gst::PadProbeType::BUFFER | gst::PadProbeType::EVENT_DOWNSTREAM | gst::PadProbeType::EVENT_FLUSH;
        let at_sink = guard.clone();
        sink.add_probe(kinds, move |_, info| {
            libav_log::attend(&at_sink);
            match &info.data {
                Some(gst::PadProbeData::Buffer(buffer)) => at_sink.before(buffer),
                Some(gst::PadProbeData::Event(event)) => match event.view() {
                    gst::EventView::Caps(caps) => at_sink.set_format(caps.caps()),
                    gst::EventView::FlushStop(_) => at_sink.flush(),
                    _ => {}
                },
                _ => {}
            }
            gst::PadProbeReturn::Ok
        });
        source.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
            if let Some(gst::PadProbeData::Buffer(buffer)) = &mut info.data
                && guard.is_bad(buffer.pts())
            {
                buffer.make_mut().set_flags(gst::BufferFlags::CORRUPTED);
            }
            gst::PadProbeReturn::Ok
        });
    }

    /// A warning of `element`, which may be a guarded decoder: marks its current data as damaged. Called on the thread
    /// that reports it.
    pub fn warned(&self, element: &gst::Object, words: &str) {
        let class = element.downcast_ref::<gst::Element>().and_then(|element| element.factory());
        let is_decoder = class.is_some_and(|factory| factory.metadata("klass").is_some_and(|k| k.contains("Decoder")));
        if is_decoder {
            for guard in self.list.lock().unwrap_or_else(PoisonError::into_inner).iter() {
                guard.report(words);
            }
        }
    }
}
