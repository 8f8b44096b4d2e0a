//! Devices, video files, network streams and pipelines, through GStreamer.

mod report;

use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use panoscope_base::secret::{redact, resolve};
use panoscope_media::MediaError;
use panoscope_media::input::{CameraMode, End, Input, InputName, InputOptions, Signal};

use super::controls::Controls;
use super::demands::{Clock, Demands, Grab, Lock};
use super::elements;
use super::error::{CaptureError, FrameError};
use super::frames::Frames;
use super::kind::FileKind;
use super::name::SourceName;
use super::opening::{Opening, too_late};
use super::picture::Picture;
use crate::devices;

/// Pause before the first attempt to reopen a lost source.
const FIRST_WAIT: Duration = Duration::from_millis(250);
/// Maximum pause between two attempts, so that a source that is back is shown within 2 s.
const MAX_WAIT: Duration = Duration::from_secs(1);
/// Time limit of the first attempt to reopen a lost source. An attempt that does not return is abandoned, and the next one may take twice as long.
const FIRST_ATTEMPT: Duration = Duration::from_millis(1500);
/// Minimum silence of a live source after which the other views are delivered without it. Well below the time after which a screen marks images as
/// old.
const MIN_PAUSE: Duration = Duration::from_millis(500);
/// The same in frame periods.
const PAUSE_FRAMES: u32 = 3;
/// A file that delivers nothing for this long is closed.
const FILE_LIMIT: Duration = Duration::from_secs(10);

/// Maximum number of decoded frames of a file in the queue.
const FILE_QUEUE: usize = 4;
/// Maximum number of frames of a live source that wait for a partner.
const LIVE_QUEUE: usize = 8;
/// Frames that a video may lack compared with the number in its header, which is often an estimate.
const HEADER_ERROR_FRAMES: u64 = 2;
/// Up to this distance, in frames, a position is reached by reading, which is exact; beyond it by seeking, which is fast.
const READ_TO: u64 = 500;
/// Containers round timestamps to milliseconds: smaller differences from the frame rate's times are ignored, s.
const ROUNDING_S: f64 = 0.0015;

/// Entry of an input's queue: a frame, or why it must not be shown.
type Content = Result<Picture, FrameError>;

/// State of the connection.
enum State {
    Open(Input<Content>),
    /// Lost. Host time of the next attempt (ns), and the last pause before it.
    Waiting(i64, Duration),
    /// Being reopened since this host time (ns), and the last pause before it.
    Opening(Opening<Input<Content>>, i64, Duration),
}

/// An open stream, or a lost one that is being reopened.
pub struct Stream {
    name: SourceName,
    demands: Demands,
    signal: Arc<Signal>,
    state: State,
    is_live: bool,
    /// Whether the stream has an end.
    is_finite: bool,
    /// Number of the newest frame taken, from 1.
    frames: u64,
    /// Number of frames of earlier connections.
    frames_before: u64,
    /// Number of frames by the file's header, the pipeline, or its length and rate; 0 when unknown.
    expected: u64,
    /// Length that the file states, if it states no number of frames.
    length: Option<Duration>,
    /// Maximum time between consecutive frames so far, s: the last one may be shown for this long.
    max_step_s: f64,
    /// Number and time (s) of the previous frame.
    before: Option<(u64, f64)>,
    fps: Option<f64>,
    first_pos_s: Option<f64>,
    media_s: Option<f64>,
    /// The frame that was grabbed.
    current: Option<Content>,
    /// Index of the frame that the next grab must return; 0 for the next one.
    go_to: u64,
    lock: Lock,
    /// Time limit of the next attempt to reopen it.
    attempt_limit: Duration,
    /// Why the source was lost.
    loss: String,
    /// Number of frames of the connection, and the host time (ns) at which that number was reached.
    heard: (u64, i64),
    /// Silence longer than this is not a pause between two frames: other views are delivered without this one.
    pause: Duration,
    damaged: Arc<AtomicU64>,
    dropped_before: u64,
}

/// Number of frames after which a pipeline ends, and whether it reads files.
fn end_of(text: &str) -> (u64, bool) {
    let count = text.split("num-buffers").nth(1).map(|rest| {
        let digits = rest.trim_start().trim_start_matches('=').trim_start();
        digits.split(|c: char| !c.is_ascii_digit()).next().unwrap_or("").parse().unwrap_or(0)
    });
    let has_files = text.contains("filesrc") || text.contains("file://");
    (count.unwrap_or(0), has_files || count.is_some_and(|count| count > 0))
}

/// Opens `name`. May block forever: [`Opening`] sets the limit.
fn open(
    name: &SourceName,
    demands: Demands,
    signal: Arc<Signal>,
    damaged: Arc<AtomicU64>,
) -> Result<Input<Content>, CaptureError> {
    let closed = |reason: String| CaptureError::Closed { name: name.in_words(), reason: redact(&reason).into_owned() };
    let resolved = |text| resolve(text).map(Cow::into_owned).map_err(|error| closed(error.to_string()));
    let input_name = match name {
        SourceName::Device(number) => InputName::Camera(PathBuf::from(format!("/dev/video{number}"))),
        SourceName::Pipeline(text) => {
            if let Some(missing) = elements::unknown_element(text) {
                return Err(closed(format!(
                    "GStreamer has no element `{missing}`: check its spelling, or install its package; gst-inspect-1.0 lists the installed elements"
                )));
            }
            InputName::Text(resolved(text)?)
        }
        SourceName::Address(text) => InputName::Address(resolved(text)?),
        SourceName::Video(path) if FileKind::of(path) == FileKind::Gif => {
            let help = "convert it, for example by `ffmpeg -i IN.gif OUT.mkv`, or one image to PNG";
            return Err(closed(format!("GIF files are not supported: {help}")));
        }
        SourceName::Video(path) => match path.to_str().filter(|_| FileKind::of(path) == FileKind::Jpegs) {
            Some(text) => InputName::Text(format!("filesrc location={} ! jpegparse", elements::quoted(text))),
            None => InputName::File(path.clone()),
        },
        SourceName::Image(path) => InputName::File(path.clone()),
        SourceName::Images(files) => InputName::File(files.first().cloned().unwrap_or_default()),
    };
    let options = InputOptions {
        mode: CameraMode { width: demands.width, height: demands.height, fps: demands.fps },
        is_lossless: demands.is_lossless,
        capacity: if matches!(name, SourceName::Video(_)) { FILE_QUEUE } else { LIVE_QUEUE },
        limit: demands.open_limit,
    };
    let mut frames = Frames::default();
    let opened = Input::open(&input_name, &options, signal, move |received| {
        let content = frames.of_sample(&received);
        damaged.fetch_add(u64::from(content.is_err()), Ordering::Relaxed);
        content
    });
    opened.map_err(|error| match error {
        MediaError::Silent { limit } => too_late(name, limit),
        error @ (MediaError::MissingDecoder { .. } | MediaError::MissingElement { .. }) => closed(error.to_string()),
        error => closed(match name {
            SourceName::Device(_) => {
                format!("{error}. It may be in use by another program, or may not be a camera; {}", devices::in_words())
            }
            SourceName::Pipeline(_) => format!("{error}. Try it with gst-launch-1.0"),
            SourceName::Address(_) => format!("{error}. Check that the address is correct and the sender is running"),
            _ => format!("it is not a video that GStreamer supports, or it is damaged: {error}"),
        }),
    })
}

impl Stream {
    /// Opens `name` within the time limit. Every frame notifies `signal`.
    ///
    /// # Errors
    /// [`CaptureError::Closed`].
    pub fn open(name: &SourceName, demands: Demands, signal: &Arc<Signal>) -> Result<Self, CaptureError> {
        let mut stream = Self {
            name: name.clone(),
            demands,
            signal: signal.clone(),
            state: State::Waiting(0, FIRST_WAIT),
            is_live: false,
            is_finite: false,
            frames: 0,
            frames_before: 0,
            expected: 0,
            length: None,
            max_step_s: 0.0,
            before: None,
            fps: None,
            first_pos_s: None,
            media_s: None,
            current: None,
            go_to: 0,
            lock: Lock::default(),
            attempt_limit: FIRST_ATTEMPT,
            loss: String::new(),
            heard: (0, i64::MIN),
            pause: demands.silence_limit,
            damaged: Arc::default(),
            dropped_before: 0,
        };
        let input = stream.start(demands.open_limit)?.wait()?;
        let format = input.format();
        stream.fps = format.fps;
        let (buffers, has_end) = match name {
            SourceName::Pipeline(text) => end_of(text),
            _ => (0, false),
        };
        let length = input.duration();
        stream.is_live = input.is_live();
        stream.is_finite = !stream.is_live || has_end || (matches!(name, SourceName::Address(_)) && length.is_some());
        if stream.is_finite {
            let by_length = length.zip(format.fps).map(|(length, fps)| (length.as_secs_f64() * fps).round() as u64);
            let announced = if let SourceName::Video(path) = name { super::avi::frames(path) } else { None };
            let counted = if buffers > 0 { Some(buffers) } else { announced };
            let is_stated = !matches!(name, SourceName::Video(path) if FileKind::of(path) == FileKind::Clocked);
            stream.length = length.filter(|_| is_stated && counted.is_none());
            // Demuxers mostly compute their number of frames from the length, too.
            let estimated = input.pictures().or(by_length).filter(|_| is_stated);
            stream.expected = counted.or(estimated).unwrap_or(0);
        }
        stream.state = State::Open(input);
        Ok(stream)
    }

    fn start(&self, limit: Duration) -> Result<Opening<Input<Content>>, CaptureError> {
        let (name, signal, damaged) = (self.name.clone(), self.signal.clone(), self.damaged.clone());
        let demands = Demands { open_limit: limit, ..self.demands };
        Opening::start(&self.name, limit, move || open(&name, demands, signal, damaged))
    }

    /// Whether frames arrive at the source's own pace.
    pub fn is_live(&self) -> bool {
        self.is_live
    }

    /// Whether frames are taken by arrival and only the newest is kept.
    pub fn is_newest_wins(&self) -> bool {
        self.is_live && !self.demands.is_lossless
    }

    /// Frame rate by the file or the driver, Hz.
    pub fn native_fps(&self) -> Option<f64> {
        self.fps
    }

    /// Number of frames since the start, including dropped ones.
    pub fn frames(&self) -> u64 {
        match &self.state {
            State::Open(input) if self.is_newest_wins() => self.frames_before + input.queue().pushed(),
            _ => self.frames,
        }
    }

    /// Number of frames left, as far as the source announces it.
    pub fn left(&self) -> u64 {
        self.expected.saturating_sub(self.frames)
    }

    /// Time of the grabbed frame since the first one by the file's timestamps, s.
    pub fn media_s(&self) -> Option<f64> {
        self.media_s
    }

    /// Number of damaged frames since the start; none of them was shown.
    pub fn damaged(&self) -> u64 {
        self.damaged.load(Ordering::Relaxed)
    }

    /// Number of frames of a live source that were dropped since the start because newer ones arrived.
    pub fn dropped(&self) -> u64 {
        let now = if let State::Open(input) = &self.state { input.queue().dropped() } else { 0 };
        self.dropped_before + now
    }

    /// Continues at frame `frame` with the next grab.
    pub fn go_to(&mut self, frame: u64) {
        self.go_to = frame;
        // At once: many pictures may have to be decoded on the way, for which the next picture's time is too short. What stops it on the way stops the
        // next picture too, which says so.
        if self.is_finite && matches!(self.state, State::Open(_)) {
            self.skip_to_target();
        }
    }

    /// Restarts from the beginning by reopening: seeking is not exact for every container.
    ///
    /// # Errors
    /// [`CaptureError::Closed`].
    pub fn rewind(&mut self) -> Result<(), CaptureError> {
        // Closed first: it may be a pipeline with a device.
        self.state = State::Waiting(i64::MAX, FIRST_WAIT);
        self.state = State::Open(self.start(self.demands.open_limit)?.wait()?);
        (self.frames, self.frames_before, self.first_pos_s, self.media_s) = (0, 0, None, None);
        Ok(())
    }

    /// Whether the stream is open. Reopens a lost source with growing pauses and does not wait for it.
    fn is_open(&mut self, clock: Clock<'_>) -> bool {
        loop {
            let (next, is_settled) = match &mut self.state {
                State::Open(_) => return true,
                State::Waiting(when, _) if clock() < *when => return false,
                State::Waiting(_, wait) => {
                    let wait = *wait;
                    match self.start(self.attempt_limit.min(self.demands.open_limit)) {
                        Ok(opening) => (State::Opening(opening, clock(), wait), false),
                        Err(_) => (again(wait, clock()), true),
                    }
                }
                State::Opening(opening, since_ns, wait) => match opening.poll(clock()) {
                    None => return false,
                    Some(Ok(input)) => {
                        self.attempt_limit = FIRST_ATTEMPT;
                        (State::Open(input), false)
                    }
                    Some(Err(error)) => {
                        self.loss = error.to_string();
                        let took_ns = clock().saturating_sub(*since_ns);
                        // Not refused, but without an answer: it may be slow.
                        if took_ns >= self.attempt_limit.as_nanos() as i64 * 9 / 10 {
                            self.attempt_limit = (self.attempt_limit * 2).min(self.demands.open_limit);
                        }
                        (again(*wait, clock()), true)
                    }
                },
            };
            self.state = next;
            if is_settled {
                return false;
            }
            if matches!(self.state, State::Open(_)) {
                self.heard = (0, clock());
                self.pause = Duration::ZERO;
                self.apply_lock();
            }
        }
    }

    /// Closes the connection so that it is reopened.
    fn lose(&mut self, why: &str, clock: Clock<'_>) -> Grab {
        if let State::Open(input) = &self.state {
            self.frames_before = if self.is_newest_wins() { self.frames() } else { self.frames };
            self.dropped_before += input.queue().dropped();
        }
        self.loss = format!("{} disappeared after {} frames: {why}", self.name.in_words(), self.frames_before);
        self.current = None;
        self.state = waiting(FIRST_WAIT, clock());
        Grab::Lost(self.loss.clone())
    }

    fn end_words(&self, end: Option<End>) -> String {
        match end {
            Some(End::Failed(reason)) => redact(&reason).into_owned(),
            Some(End::EndOfStream) => "the stream has ended".to_owned(),
            None => format!("no data for {} s", self.demands.silence_limit.as_secs_f64()),
        }
    }

    /// For streams of which only the newest frame is kept: reopens a lost one, and returns whether it is connected.
    pub fn poll(&mut self, clock: Clock<'_>) -> Grab {
        if !self.is_open(clock) {
            return Grab::Lost(self.loss.clone());
        }
        let State::Open(input) = &self.state else { return Grab::Lost(self.loss.clone()) };
        let (end, pushed, now_ns) = (input.queue().ended(), input.queue().pushed(), clock());
        if self.heard.1 == i64::MIN {
            self.heard = (pushed, now_ns);
        } else if pushed > self.heard.0 {
            self.pause = MIN_PAUSE.max(PAUSE_FRAMES * self.silence(now_ns));
            self.heard = (pushed, now_ns);
        }
        let silent = self.silence(now_ns);
        if end == Some(End::EndOfStream) && self.is_finite {
            return if input.queue().wait_for_item(Duration::ZERO) { Grab::Ready(None) } else { Grab::End };
        }
        if end.is_some() || silent > self.demands.silence_limit {
            let words = self.end_words(end);
            return self.lose(&words, clock);
        }
        Grab::Ready(None)
    }

    /// Time since the newest frame or since the connection, as of the last [`Self::poll`].
    fn silence(&self, now_ns: i64) -> Duration {
        Duration::from_nanos(u64::try_from(now_ns.saturating_sub(self.heard.1)).unwrap_or(0))
    }

    /// Whether the stream is connected.
    pub fn is_connected(&self) -> bool {
        matches!(self.state, State::Open(_))
    }

    /// Whether a frame has arrived within `time`, as of the last [`Self::poll`].
    pub fn is_heard_within(&self, time: Duration, clock: Clock<'_>) -> bool {
        self.is_connected() && self.silence(clock()) <= time
    }

    /// Whether frames keep arriving, as of the last [`Self::poll`].
    pub fn delivers(&self, clock: Clock<'_>) -> bool {
        self.is_heard_within(self.pause, clock)
    }

    /// Arrival times of the waiting frames, oldest first, ns of `CLOCK_MONOTONIC`.
    pub fn arrivals(&self, out: &mut Vec<i64>) {
        out.clear();
        if let State::Open(input) = &self.state {
            input.queue().arrivals(out);
        }
    }

    /// Drops the waiting frames that arrived before `arrived_ns`; returns how many.
    pub fn discard_before(&self, arrived_ns: i64) -> u64 {
        if let State::Open(input) = &self.state { input.queue().discard_before(arrived_ns) } else { 0 }
    }

    /// Takes the waiting frame that arrived at `arrived_ns`, if it is still in the queue.
    pub fn take(&mut self, arrived_ns: i64) -> bool {
        let State::Open(input) = &self.state else { return false };
        let Some(item) = input.queue().pop(Duration::ZERO) else { return false };
        if item.arrived_ns != arrived_ns {
            return false;
        }
        self.frames = self.frames_before + item.number;
        self.current = Some(item.content);
        true
    }

    /// Waits for the next frame in order and takes it; returns its arrival.
    fn grab_one(&mut self, limit: Duration) -> Option<i64> {
        let State::Open(input) = &self.state else { return None };
        let item = input.queue().pop(limit)?;
        self.frames = self.frames_before + item.number;
        self.note_time(item.pts_ns);
        self.current = Some(item.content);
        Some(item.arrived_ns)
    }

    /// Skips the frames before the requested one.
    fn skip_to_target(&mut self) -> bool {
        let target = std::mem::take(&mut self.go_to);
        if target > self.frames + READ_TO && !self.seek_before(target) && self.rewind().is_err() {
            return false;
        }
        while self.frames < target {
            if self.grab_one(FILE_LIMIT).is_none() {
                return false;
            }
        }
        true
    }

    /// Seeks to a frame shortly before number `target`, by the file's timestamps. Returns whether that is possible.
    fn seek_before(&mut self, target: u64) -> bool {
        let (State::Open(input), Some(fps)) = (&self.state, self.fps) else { return false };
        // Between two frames, for times that are rounded; the first frame that comes says which one it is.
        if !input.seek(Duration::from_secs_f64((target as f64 - 1.5).max(0.0) / fps), 1) {
            return false;
        }
        let Some(item) = input.queue().pop(FILE_LIMIT) else { return false };
        let Some(pts_ns) = item.pts_ns else { return false };
        let index = (pts_ns as f64 * 1e-9 * fps).round().max(0.0) as u64;
        self.frames_before = index + 1 - item.number;
        self.frames = index + 1;
        self.frames <= target
    }

    /// Takes the next frame in order.
    pub fn grab(&mut self, clock: Clock<'_>) -> Grab {
        if !self.is_open(clock) {
            return Grab::Lost(self.loss.clone());
        }
        let is_there = if self.is_finite && self.go_to > 0 { self.skip_to_target() } else { true };
        let limit = if self.is_live { self.demands.silence_limit } else { FILE_LIMIT };
        if is_there && let Some(arrived_ns) = self.grab_one(limit) {
            return Grab::Ready(self.is_live.then_some(arrived_ns));
        }
        let end = if let State::Open(input) = &self.state { input.queue().ended() } else { None };
        if !self.is_finite {
            let words = self.end_words(end);
            return self.lose(&words, clock);
        }
        match (end, self.missing()) {
            (Some(End::EndOfStream), None) => Grab::End,
            (Some(End::EndOfStream), Some(words)) => Grab::Failed(words),
            (Some(End::Failed(reason)), words) => Grab::Failed(format!(
                "{}: {reason}",
                words.unwrap_or_else(|| format!("{} failed after {} frames", self.name.in_words(), self.frames))
            )),
            (None, _) => Grab::Failed(format!(
                "{} delivered no data for {} s after {} frames",
                self.name.in_words(),
                limit.as_secs_f64(),
                self.frames
            )),
        }
    }

    /// Records the file's own timestamp if it is more precise than the frame rate.
    fn note_time(&mut self, pts_ns: Option<i64>) {
        if !self.is_finite {
            return;
        }
        let index = self.frames.saturating_sub(1) as f64;
        let by_rate = self.fps.map(|fps| index / fps);
        let pos_s = pts_ns.map(|pts| pts as f64 * 1e-9);
        if let Some((_, before_s)) = self.before.filter(|(number, _)| number + 1 == self.frames) {
            self.max_step_s = self.max_step_s.max(pos_s.unwrap_or(before_s) - before_s);
        }
        self.before = pos_s.map(|pos_s| (self.frames, pos_s));
        // After a seek the first time is that of a later frame.
        let first = *self.first_pos_s.get_or_insert(pos_s.unwrap_or(0.0) - by_rate.unwrap_or(0.0));
        let by_file = pos_s.map(|pos| pos - first).filter(|pos| self.media_s.is_none_or(|last| *pos > last));
        self.media_s = match (by_file, by_rate) {
            (Some(file), Some(rate)) if (file - rate).abs() > ROUNDING_S => Some(file),
            (Some(file), None) => Some(file),
            (_, rate) => rate,
        };
    }

    /// Moves the grabbed frame to `out`.
    ///
    /// # Errors
    /// [`CaptureError::Frame`]; `out` is empty then.
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        out.clear();
        match self.current.take().unwrap_or(Err(FrameError::NotThere)) {
            Ok(picture) => {
                *out = picture;
                Ok(())
            }
            Err(cause) => Err(CaptureError::Frame {
                name: self.name.in_words(),
                frame: self.frames,
                of_expected: if self.expected > 0 { format!(" of {}", self.expected) } else { String::new() },
                cause,
            }),
        }
    }

    fn controls(&self) -> Option<Controls> {
        let SourceName::Device(number) = self.name else { return None };
        Controls::open(&PathBuf::from(format!("/dev/video{number}")))
    }

    /// Values that the device's automatic controls have chosen.
    pub fn automatic_values(&self) -> Lock {
        self.controls().map(|controls| controls.automatic_values()).unwrap_or_default()
    }

    /// Switches the automatic controls off and sets `lock`, also after reconnecting. Returns whether the driver accepted all values.
    pub fn set_lock(&mut self, lock: Lock) -> bool {
        self.lock = lock;
        self.apply_lock()
    }

    fn apply_lock(&self) -> bool {
        self.lock == Lock::default() || self.controls().is_some_and(|controls| controls.apply(self.lock))
    }
}

/// Schedules the next attempt after twice the pause.
fn again(wait: Duration, now_ns: i64) -> State {
    waiting((wait * 2).min(MAX_WAIT), now_ns)
}

/// Schedules the next attempt after a pause.
fn waiting(wait: Duration, now_ns: i64) -> State {
    State::Waiting(now_ns.saturating_add(wait.as_nanos() as i64), wait)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pipeline_of_files_or_with_a_count_has_an_end() {
        assert_eq!(end_of("videotestsrc num-buffers=5 ! appsink"), (5, true));
        assert_eq!(end_of("videotestsrc num-buffers = 12 pattern=ball ! appsink"), (12, true));
        assert_eq!(end_of("filesrc location=a.mkv ! decodebin"), (0, true));
        assert_eq!(end_of("v4l2src num-buffers=-1 ! appsink"), (0, false));
        assert_eq!(end_of("rtspsrc location=rtsp://scope ! appsink"), (0, false));
    }
}
