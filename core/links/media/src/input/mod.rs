//! Video in: cameras, files, addresses and pipelines as a queue of images.
//!
//! An [`Input`] runs one pipeline. Its decoders and the reader's conversion run on GStreamer's threads; images wait in
//! a bounded [`Queue`]. Images made from damaged data are marked ([`guard`]), and every image has the time at which it
//! arrived at this machine ([`arrival`]).

mod access_unit;
mod arrival;
mod build;
mod guard;
pub mod jpeg;
mod jpeg_error;
mod jpeg_scan;
mod libav_log;
mod modes;
mod queue;

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use gstreamer as gst;
use gstreamer::prelude::*;
use gstreamer_app::AppSinkCallbacks;
use gstreamer_video::VideoInterlaceMode;

use crate::MediaError;
use arrival::Arrivals;
use guard::Guards;

pub use modes::CameraMode;
pub use queue::{End, Item, Policy, Queue, Signal};

/// Formats of luma and chroma that are delivered as decoded; [`crate::yuv_to_bgr`] converts them. Other formats are
/// converted to BGR or GRAY16_LE.
pub const YUV_FORMATS: [&str; 9] = ["I420", "YV12", "NV12", "NV21", "Y42B", "Y444", "YUY2", "UYVY", "YVYU"];

/// Maximum wait for a pipeline to stop; then its thread is abandoned.
const CLOSE_LIMIT: Duration = Duration::from_secs(2);

/// The input to open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InputName {
    /// A V4L2 device.
    Camera(PathBuf),
    /// A video file.
    File(PathBuf),
    /// An address, such as `rtsp://...`.
    Address(String),
    /// A pipeline in the syntax of `gst-launch-1.0`.
    Text(String),
}

/// Options for opening an input.
#[derive(Clone, Debug)]
pub struct InputOptions {
    /// Requested mode of a camera.
    pub mode: CameraMode,
    /// Whether frames of live sources are kept too: the source waits for its reader.
    pub is_lossless: bool,
    /// Maximum number of waiting frames.
    pub capacity: usize,
    /// Maximum wait for the first frame.
    pub limit: Duration,
}

/// Properties of a stream's images.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Format {
    /// Media type, such as `image/jpeg`.
    pub media: String,
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Frames per second, if the stream has a rate.
    pub fps: Option<f64>,
    /// Width and height of a pixel; 1, 1 for square ones.
    pub pixel_aspect: (i32, i32),
    /// Whether the stream is interlaced; its fields are combined into frames.
    pub is_interlaced: bool,
    /// EXIF orientation of its images; 1 is upright.
    pub exif_orientation: u8,
}

/// State shared by the pipeline's threads and its reader, independent of the type of items.
pub(crate) struct Shared {
    format: Mutex<Format>,
    guards: Guards,
    /// Latest end of an image, by the container's clock, ns.
    reached_ns: AtomicU64,
    arrivals: Arrivals,
    failure: Mutex<Option<String>>,
    on_failure: Box<dyn Fn(&str) + Send + Sync>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// Records a failure; only the first is kept, because it causes the later ones.
    fn fail(&self, words: String) {
        let mut failure = locked(&self.failure);
        if failure.is_none() {
            (self.on_failure)(&words);
            *failure = Some(words);
        }
    }

    fn set_interlaced(&self, is_interlaced: bool) {
        locked(&self.format).is_interlaced |= is_interlaced;
    }

    fn note_caps(&self, caps: &gst::CapsRef) {
        let Some(structure) = caps.structure(0) else { return };
        let size = |name: &str| structure.get::<i32>(name).map_or(0, |value| usize::try_from(value).unwrap_or(0));
        let rate = structure.get::<gst::Fraction>("framerate").ok();
        let fps = rate.map(|rate| f64::from(rate.numer()) / f64::from(rate.denom().max(1)));
        let aspect =
            structure.get::<gst::Fraction>("pixel-aspect-ratio").map_or((1, 1), |ratio| (ratio.numer(), ratio.denom()));
        let mut format = locked(&self.format);
        let is_interlaced = format.is_interlaced
            || structure
                .get::<&str>("interlace-mode")
                .is_ok_and(|mode| VideoInterlaceMode::from_string(mode) != VideoInterlaceMode::Progressive);
        *format = Format {
            media: structure.name().to_string(),
            width: size("width"),
            height: size("height"),
            fps: fps.filter(|fps| *fps > 0.1 && *fps <= 1000.0),
            pixel_aspect: aspect,
            is_interlaced,
            exif_orientation: format.exif_orientation,
        };
    }

    /// Prepares an element of the pipeline.
    fn prepare(self: &Arc<Self>, pipeline: &gst::glib::WeakRef<gst::Pipeline>, element: &gst::Element) {
        build::configure(element);
        let shared = Arc::downgrade(self);
        self.guards.attach(element, move |reason| {
            if let Some(shared) = shared.upgrade() {
                shared.fail(reason.to_owned());
            }
        });
        if element.element_flags().contains(gst::ElementFlags::SOURCE) {
            for pad in element.src_pads() {
                self.stamp(pipeline, &pad);
            }
            let (shared, pipeline) = (Arc::downgrade(self), pipeline.clone());
            element.connect_pad_added(move |_, pad| {
                if let Some(shared) = shared.upgrade().filter(|_| pad.direction() == gst::PadDirection::Src) {
                    shared.stamp(&pipeline, pad);
                }
            });
        }
    }

    /// Records when data leaves a source.
    fn stamp(self: &Arc<Self>, pipeline: &gst::glib::WeakRef<gst::Pipeline>, pad: &gst::Pad) {
        let (shared, pipeline) = (Arc::downgrade(self), pipeline.clone());
        let kinds = gst::PadProbeType::BUFFER | gst::PadProbeType::BUFFER_LIST;
        pad.add_probe(kinds, move |pad, info| {
            let pts = match &info.data {
                Some(gst::PadProbeData::Buffer(buffer)) => buffer.pts(),
                Some(gst::PadProbeData::BufferList(list)) => list.get(0).and_then(gst::BufferRef::pts),
                _ => None,
            };
            if let (Some(pts), Some(shared), Some(pipeline)) = (pts, shared.upgrade(), pipeline.upgrade()) {
                let now_ns = monotonic_ns();
                let segment = pad.sticky_event::<gst::event::Segment>(0);
                let running = segment.as_ref().and_then(|event| {
                    event.segment().downcast_ref::<gst::ClockTime>().and_then(|segment| segment.to_running_time(pts))
                });
                let stamp = running.zip(pipeline.base_time()).map(|(running, base)| nanos(base + running));
                shared.arrivals.note(pts.nseconds(), stamp, now_ns);
            }
            gst::PadProbeReturn::Ok
        });
    }
}

fn nanos(time: gst::ClockTime) -> i64 {
    i64::try_from(time.nseconds()).unwrap_or(i64::MAX)
}

/// The time of `CLOCK_MONOTONIC`, ns: the clock of [`Item::arrived_ns`].
pub fn monotonic_ns() -> i64 {
    nanos(gst::SystemClock::obtain().time())
}

/// One sample, passed to the reader on the pipeline's thread.
pub struct Received<'s> {
    /// Buffer, caps and segment.
    pub sample: &'s gst::Sample,
    /// The reason why the image must not be shown.
    pub damage: Option<String>,
    /// EXIF orientation of the stream's images; 0 if unknown.
    pub exif_orientation: u8,
}

/// A running pipeline and the items made of its samples.
pub struct Input<T: Send + 'static> {
    pipeline: gst::Pipeline,
    shared: Arc<Shared>,
    queue: Arc<Queue<T>>,
    is_live: bool,
}

impl<T: Send + 'static> Input<T> {
    /// Starts `name` and waits for its first image. `convert` runs on the pipeline's thread; `signal` is notified of
    /// every frame.
    ///
    ///
    ///
    /// # Errors
    /// An element is missing, refuses its setting, or fails; no frame arrives within the limit.
    pub fn open(
        name: &InputName,
        options: &InputOptions,
        signal: Arc<Signal>,
        convert: impl FnMut(Received<'_>) -> T + Send + 'static,
    ) -> Result<Self, MediaError> {
        crate::init()?;
        libav_log::install();
        let begin = Instant::now();
        // Whether it is live is known once it has been started, which may already give pictures: they all stay until then.
        let queue: Arc<Queue<T>> = Arc::new(Queue::new(Policy::Lossless, options.capacity));
        let on_failure = {
            let (queue, signal) = (queue.clone(), signal.clone());
            Box::new(move |words: &str| {
                queue.end(End::Failed(words.to_owned()));
                signal.notify();
            })
        };
        let shared = Arc::new(Shared {
            format: Mutex::default(),
            guards: Guards::default(),
            reached_ns: AtomicU64::new(0),
            arrivals: Arrivals::default(),
            failure: Mutex::default(),
            on_failure,
        });
        let built = build::build(name, options.mode, &shared)?;
        let input = Self { pipeline: built.pipeline, shared, queue, is_live: false };
        input.watch(&built.sink, signal, convert);
        input.start(name, options, begin)
    }

    fn watch(
        &self,
        sink: &gstreamer_app::AppSink,
        signal: Arc<Signal>,
        mut convert: impl FnMut(Received<'_>) -> T + Send + 'static,
    ) {
        let (pipeline, shared) = (&self.pipeline, &self.shared);
        pipeline.use_clock(Some(&gst::SystemClock::obtain()));
        let weak = pipeline.downgrade();
        for element in pipeline.iterate_recurse().into_iter().flatten() {
            shared.prepare(&weak, &element);
        }
        let (to_prepare, weak_pipeline) = (Arc::downgrade(shared), weak.clone());
        pipeline.connect_deep_element_added(move |_, _, element| {
            if let Some(shared) = to_prepare.upgrade() {
                shared.prepare(&weak_pipeline, element);
            }
        });
        if let Some(bus) = pipeline.bus() {
            let shared = Arc::downgrade(shared);
            bus.set_sync_handler(move |_, message| {
                if let Some(shared) = shared.upgrade() {
                    heard(&shared, message);
                }
                gst::BusSyncReply::Drop
            });
        }
        // It is read at once; what waits, waits in the queue.
        sink.set_sync(false);
        sink.set_max_buffers(1);
        sink.set_drop(false);
        sink.set_enable_last_sample(false);
        let (queue, at_end, shared) = (self.queue.clone(), self.queue.clone(), shared.clone());
        let end_signal = signal.clone();
        let mut caps: Option<gst::Caps> = None;
        let callbacks = AppSinkCallbacks::builder()
            .new_sample(move |sink| {
                let sample = sink.pull_sample().map_err(|_| gst::FlowError::Eos)?;
                let now_ns = monotonic_ns();
                let Some(buffer) = sample.buffer() else { return Ok(gst::FlowSuccess::Ok) };
                if sample.caps() != caps.as_deref() {
                    caps = sample.caps_owned();
                    if let Some(caps) = &caps {
                        shared.note_caps(caps);
                    }
                }
                let pts = buffer.pts();
                if let Some(end) = pts.map(|pts| pts + buffer.duration().unwrap_or_default()) {
                    shared.reached_ns.fetch_max(end.nseconds(), Ordering::Relaxed);
                }
                let reason = shared.guards.reason_of(pts.map(gst::ClockTime::nseconds));
                let is_flagged = buffer.flags().contains(gst::BufferFlags::CORRUPTED);
                let damage = reason.or_else(|| {
                    let words = || shared.guards.newest_reason().unwrap_or_else(|| "the source marked it".to_owned());
                    is_flagged.then(words)
                });
                let segment = sample.segment().and_then(|segment| segment.downcast_ref::<gst::ClockTime>());
                let stream_ns = segment.zip(pts).and_then(|(segment, pts)| segment.to_stream_time(pts)).map(nanos);
                let running = segment.zip(pts).and_then(|(segment, pts)| segment.to_running_time(pts));
                let noted = pts.and_then(|pts| shared.arrivals.of(pts.nseconds()));
                let nominal = || Some(nanos(sink.base_time()? + running?));
                let arrived_ns = noted.or_else(nominal).unwrap_or(now_ns).min(now_ns);
                let exif_orientation = locked(&shared.format).exif_orientation;
                let content = convert(Received { sample: &sample, damage, exif_orientation });
                if !queue.push(stream_ns, arrived_ns, content) {
                    return Err(gst::FlowError::Eos);
                }
                signal.notify();
                Ok(gst::FlowSuccess::Ok)
            })
            .eos(move |_| {
                at_end.end(End::EndOfStream);
                end_signal.notify();
            })
            .build();
        sink.set_callbacks(callbacks);
    }

    fn start(mut self, name: &InputName, options: &InputOptions, begin: Instant) -> Result<Self, MediaError> {
        let failed = |input: &Self, fallback: String| {
            let reason = locked(&input.shared.failure).clone().unwrap_or(fallback);
            MediaError::Refused { reason }
        };
        match self.pipeline.set_state(gst::State::Paused) {
            Ok(success) => self.is_live = success == gst::StateChangeSuccess::NoPreroll,
            Err(error) => return Err(failed(&self, error.to_string())),
        }
        // A stream of the network may come as a file does, at its own rate.
        self.is_live |= matches!(name, InputName::Camera(_));
        if self.is_live && !options.is_lossless {
            self.queue.set_policy(Policy::NewestWins);
        }
        if let Err(error) = self.pipeline.set_state(gst::State::Playing) {
            return Err(failed(&self, error.to_string()));
        }
        if !self.queue.wait(options.limit.saturating_sub(begin.elapsed())) {
            return Err(MediaError::Silent { limit: options.limit });
        }
        match self.queue.ended() {
            Some(End::Failed(reason)) if self.queue.pushed() == 0 => return Err(MediaError::Refused { reason }),
            Some(End::EndOfStream) if self.queue.pushed() == 0 => {
                return Err(MediaError::Refused { reason: "it has no picture".to_owned() });
            }
            _ => {}
        }
        if matches!(name, InputName::Address(_)) && self.duration().is_none() {
            self.is_live = true;
            if !options.is_lossless {
                self.queue.set_policy(Policy::NewestWins);
            }
        }
        Ok(self)
    }

    /// Whether frames arrive at the source's pace.
    pub fn is_live(&self) -> bool {
        self.is_live
    }

    /// The queue of frames.
    pub fn queue(&self) -> &Queue<T> {
        &self.queue
    }

    /// Properties of the stream's images.
    pub fn format(&self) -> Format {
        locked(&self.shared.format).clone()
    }

    /// Length of the stream, if it is known.
    pub fn duration(&self) -> Option<Duration> {
        self.pipeline.query_duration::<gst::ClockTime>().map(|time| Duration::from_nanos(time.nseconds()))
    }

    /// Latest end of an image so far, by the container's clock, which need not begin at 0.
    pub fn reached(&self) -> Duration {
        Duration::from_nanos(self.shared.reached_ns.load(Ordering::Relaxed))
    }

    /// Whether a decoder met damaged data.
    pub fn has_damage(&self) -> bool {
        self.shared.guards.has_marks()
    }

    /// Number of images, if the container states it.
    pub fn pictures(&self) -> Option<u64> {
        self.pipeline.query_duration::<gst::format::Default>().map(|count| *count).filter(|count| *count > 0)
    }

    /// Seeks exactly to the frame at `time`; the next frame gets number `number`. Returns whether the stream can seek.
    pub fn seek(&self, time: Duration, number: u64) -> bool {
        let flags = gst::SeekFlags::FLUSH | gst::SeekFlags::ACCURATE;
        let time = gst::ClockTime::from_nseconds(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX - 1));
        // The thread of the pipeline may wait for space in the queue, and the seek for that thread.
        self.queue.refuse(true);
        let is_done = self.pipeline.seek_simple(flags, time).is_ok();
        self.queue.refuse(false);
        self.queue.restart(number.saturating_sub(1));
        is_done
    }
}

impl<T: Send + 'static> Drop for Input<T> {
    fn drop(&mut self) {
        self.queue.close();
        if let Some(bus) = self.pipeline.bus() {
            bus.unset_sync_handler();
        }
        // Elements may wait for a disk or a network: then the thread is left behind.
        let (pipeline, (stopped, has_stopped)) = (self.pipeline.clone(), channel());
        let started = std::thread::Builder::new().name("close input".to_owned()).spawn(move || {
            let _ = pipeline.set_state(gst::State::Null);
            drop(pipeline);
            let _ = stopped.send(());
        });
        if started.is_ok() {
            let _ = has_stopped.recv_timeout(CLOSE_LIMIT);
        }
    }
}

/// EXIF number of GStreamer's name of an orientation; 0 for unknown names.
fn exif_of(orientation: &str) -> u8 {
    let names = [
        "rotate-0",
        "flip-rotate-0",
        "rotate-180",
        "flip-rotate-180",
        "flip-rotate-270",
        "rotate-90",
        "flip-rotate-90",
        "rotate-270",
    ];
    names.iter().position(|name| *name == orientation).map_or(0, |index| index as u8 + 1)
}

/// Handles a message of the bus, on the thread that posts it.
fn heard(shared: &Shared, message: &gst::Message) {
    match message.view() {
        gst::MessageView::Error(error) => shared.fail(MediaError::from(error).to_string()),
        gst::MessageView::Warning(warning) => {
            if let Some(source) = warning.src() {
                shared.guards.warned(source, warning.error().message());
            }
        }
        gst::MessageView::Tag(tag) => {
            if let Some(orientation) = tag.tags().get::<gst::tags::ImageOrientation>() {
                locked(&shared.format).exif_orientation = exif_of(orientation.get());
            }
        }
        gst::MessageView::Element(element) => {
            if let Some(error) = element.structure().and_then(MediaError::of_missing_plugin) {
                shared.fail(error.to_string());
            }
        }
        _ => {}
    }
}
