//! Devices, video files, network streams and pipelines, through OpenCV's `VideoCapture`.

use std::time::{Duration, Instant};

use opencv::core::{Mat, Vector};
use opencv::prelude::*;
use opencv::videoio::{self, VideoCapture};

use super::images::copy_mat;
use super::opening::Opening;
use super::picture::Picture;
use super::{CaptureError, Grab, SourceName, elements, jpeg};
use crate::devices;

const FIRST_WAIT: Duration = Duration::from_millis(250);
const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// A network stream that is silent for so long is lost. Shorter than what the host takes for a call that hangs.
const READ_LIMIT: Duration = Duration::from_millis(1500);

/// V4L2's "manual" in the terms of OpenCV's `CAP_PROP_AUTO_EXPOSURE`.
const MANUAL_EXPOSURE: f64 = 1.0;

/// A video may miss so many frames of what its header says: many headers hold an estimate.
const UNSAID_FRAMES: u64 = 2;
/// Frames up to which a position is reached by reading, which is exact, instead of seeking, which is fast.
const READ_TO: u64 = 500;
/// Times of a container that are rounded to milliseconds are no news beside the frame rate.
const ROUNDING_S: f64 = 0.0015;

/// What a device is asked for; 0 leaves it as it is. And how long opening may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demands {
    /// Columns in px.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames per second.
    pub fps: f64,
    /// Longest time that opening may take.
    pub open_limit: Duration,
}

/// What a lock holds: exposure and gain, white balance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lock {
    /// Exposure and gain in the driver's units.
    pub exposure: Option<(f64, f64)>,
    /// Colour temperature in K.
    pub white_balance_k: Option<f64>,
}

/// Whether there is something to grab from.
enum State {
    Open(VideoCapture),
    /// Lost; to be opened at this time, and how long to wait if that fails.
    Waiting(Instant, Duration),
    /// Being opened; how long to wait if that fails.
    Opening(Opening, Duration),
}

/// An open stream, or a device that is waited for.
pub struct Stream {
    name: SourceName,
    demands: Demands,
    state: State,
    mat: Mat,
    /// It has an end of its own.
    is_finite: bool,
    /// Frames since the start.
    frames: u64,
    /// Frames that its header, or the pipeline, promises; 0 when it does not say.
    expected: u64,
    fps: Option<f64>,
    first_pos_s: Option<f64>,
    media_s: Option<f64>,
    /// Frames to be passed over before the next one is grabbed.
    go_to: u64,
    lock: Lock,
}

/// Opens what `name` says. Waits as long as it takes: see [`Opening`].
pub(super) fn open(name: &SourceName, demands: Demands) -> Result<VideoCapture, CaptureError> {
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
        let wishes = [
            (videoio::CAP_PROP_FRAME_WIDTH, f64::from(demands.width)),
            (videoio::CAP_PROP_FRAME_HEIGHT, f64::from(demands.height)),
            (videoio::CAP_PROP_FPS, demands.fps),
        ];
        for (property, value) in wishes {
            if value > 0.0 {
                // A driver takes the nearest mode; what came of it is seen in the first picture.
                let _ = capture.set(property, value);
            }
        }
        // One waiting picture instead of several: age matters more than completeness.
        let _ = capture.set(videoio::CAP_PROP_BUFFERSIZE, 1.0);
    }
    take_jpegs(&mut capture, name);
    Ok(capture)
}

/// Asks for the JPEGs of a Motion JPEG as they are. OpenCV's decoders leave the picture before where a frame is damaged, and say nothing.
fn take_jpegs(capture: &mut VideoCapture, name: &SourceName) {
    let code = capture.get(videoio::CAP_PROP_FOURCC).unwrap_or(0.0) as i64 as u32;
    if !matches!(&code.to_le_bytes(), b"MJPG" | b"JPEG" | b"mjpg" | b"jpeg") {
        return;
    }
    // Where the answer is no, decoded pictures come as before.
    let _ = match name {
        SourceName::Device(_) => capture.set(videoio::CAP_PROP_CONVERT_RGB, 0.0),
        SourceName::Video(_) | SourceName::Address(_) => capture.set(videoio::CAP_PROP_FORMAT, -1.0),
        _ => return,
    };
}

/// Pictures after which a pipeline ends, and whether it is made of files.
fn end_of(text: &str) -> (u64, bool) {
    let count = text.split("num-buffers").nth(1).map(|rest| {
        let digits = rest.trim_start().trim_start_matches('=').trim_start();
        digits.split(|c: char| !c.is_ascii_digit()).next().unwrap_or("").parse().unwrap_or(0)
    });
    let has_files = text.contains("filesrc") || text.contains("file://");
    (count.unwrap_or(0), has_files || count.is_some_and(|count| count > 0))
}

impl Stream {
    /// Opens what `name` says, within the limit.
    ///
    /// # Errors
    /// [`CaptureError::Closed`].
    pub fn open(name: &SourceName, demands: Demands) -> Result<Self, CaptureError> {
        let capture = Opening::start(name, demands)?.wait()?;
        let count = capture.get(videoio::CAP_PROP_FRAME_COUNT).unwrap_or(0.0);
        let count = if count > 0.0 && count < 1e12 { count as u64 } else { 0 };
        let (is_finite, expected) = match name {
            SourceName::Device(_) => (false, 0),
            SourceName::Address(_) => (count > 0, count),
            SourceName::Pipeline(text) => match end_of(text) {
                (0, is_finite) => (is_finite, count),
                (buffers, is_finite) => (is_finite, buffers),
            },
            _ => (true, count),
        };
        let fps = capture.get(videoio::CAP_PROP_FPS).ok().filter(|fps| *fps > 0.1 && *fps <= 1000.0);
        Ok(Self {
            name: name.clone(),
            demands,
            state: State::Open(capture),
            mat: Mat::default(),
            is_finite,
            frames: 0,
            expected,
            fps,
            first_pos_s: None,
            media_s: None,
            go_to: 0,
            lock: Lock::default(),
        })
    }

    /// Whether pictures come at their own pace and may come back after a loss.
    pub fn is_live(&self) -> bool {
        !self.is_finite
    }

    /// Frames per second as the file or the driver says.
    pub fn native_fps(&self) -> Option<f64> {
        self.fps
    }

    /// Frames grabbed since the start.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Frames that should still come, as far as the source promises.
    pub fn left(&self) -> u64 {
        self.expected.saturating_sub(self.frames)
    }

    /// Time of the frame that was grabbed since the first one, in s of the file.
    pub fn media_s(&self) -> Option<f64> {
        self.media_s
    }

    /// Goes on at frame `frame` with the next grab.
    pub fn go_to(&mut self, frame: u64) {
        self.go_to = frame;
    }

    /// Starts anew. Opening is exact for every container; seeking is not.
    ///
    /// # Errors
    /// [`CaptureError::Closed`].
    pub fn rewind(&mut self) -> Result<(), CaptureError> {
        self.state = State::Open(Opening::start(&self.name, self.demands)?.wait()?);
        (self.frames, self.first_pos_s, self.media_s) = (0, None, None);
        Ok(())
    }

    /// Whether there is something to grab from; a lost source is opened again with growing pauses, without waiting for it here.
    fn is_open(&mut self) -> bool {
        loop {
            let (next, is_settled) = match &self.state {
                State::Open(_) => return true,
                State::Waiting(when, _) if Instant::now() < *when => return false,
                State::Waiting(_, wait) => match Opening::start(&self.name, self.demands) {
                    Ok(opening) => (State::Opening(opening, *wait), false),
                    Err(_) => (again(*wait), true),
                },
                State::Opening(opening, wait) => match opening.poll() {
                    None => return false,
                    Some(Ok(capture)) => (State::Open(capture), false),
                    Some(Err(_)) => (again(*wait), true),
                },
            };
            self.state = next;
            if is_settled {
                return false;
            }
            if matches!(self.state, State::Open(_)) {
                self.apply_lock();
            }
        }
    }

    fn grab_one(&mut self) -> bool {
        let State::Open(capture) = &mut self.state else { return false };
        let is_grabbed = capture.grab().unwrap_or(false);
        self.frames += u64::from(is_grabbed);
        is_grabbed
    }

    /// Passes over what lies before the position asked for.
    fn pass_over(&mut self) -> bool {
        let target = std::mem::take(&mut self.go_to);
        if target > self.frames + READ_TO
            && let State::Open(capture) = &mut self.state
        {
            let seek = capture.set(videoio::CAP_PROP_POS_FRAMES, target as f64).unwrap_or(false);
            if seek && capture.get(videoio::CAP_PROP_POS_FRAMES).unwrap_or(-1.0) == target as f64 {
                self.frames = target;
            } else if self.rewind().is_err() {
                return false;
            }
        }
        while self.frames < target {
            if !self.grab_one() {
                return false;
            }
        }
        true
    }

    /// Takes the next picture without decoding it.
    pub fn grab(&mut self) -> Grab {
        if !self.is_open() {
            return Grab::Lost;
        }
        let is_there = if self.is_finite && self.go_to > 0 { self.pass_over() } else { true };
        if is_there && self.grab_one() {
            self.note_time();
            return Grab::Ready(Instant::now());
        }
        if self.is_finite {
            return match self.missing() {
                Some(words) => Grab::Failed(words),
                None => Grab::End,
            };
        }
        self.state = State::Waiting(Instant::now() + FIRST_WAIT, FIRST_WAIT);
        Grab::Lost
    }

    /// The file's own time where it says more than its frame rate.
    fn note_time(&mut self) {
        let State::Open(capture) = &self.state else { return };
        if !self.is_finite {
            return;
        }
        let index = (self.frames - 1) as f64;
        let by_rate = self.fps.map(|fps| index / fps);
        let pos_s = capture.get(videoio::CAP_PROP_POS_MSEC).ok().filter(|ms| ms.is_finite()).map(|ms| ms / 1e3);
        // After a seek the first time is that of a later frame.
        let first = *self.first_pos_s.get_or_insert(pos_s.unwrap_or(0.0) - by_rate.unwrap_or(0.0));
        let by_file = pos_s.map(|pos| pos - first).filter(|pos| self.media_s.is_none_or(|last| *pos > last));
        self.media_s = match (by_file, by_rate) {
            (Some(file), Some(rate)) if (file - rate).abs() > ROUNDING_S => Some(file),
            (Some(file), None) => Some(file),
            (_, rate) => rate,
        };
    }

    /// What is missing at the end of a file or pipeline that promised more.
    fn missing(&self) -> Option<String> {
        let (read, told) = (self.frames, self.expected);
        (told > read + UNSAID_FRAMES + read / 100).then(|| {
            format!(
                "{} ended after {read} of {told} frames: it is cut off or damaged, or a frame in it cannot be decoded",
                self.name.in_words()
            )
        })
    }

    /// Decodes the picture that was grabbed.
    ///
    /// # Errors
    /// [`CaptureError::OpenCv`] with the number of the frame. `out` is empty then.
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        out.clear();
        let result = self.try_retrieve(out);
        if result.is_err() {
            // Nothing of a failure is left for the next frame.
            self.mat = Mat::default();
            out.clear();
        }
        let expected = self.expected;
        let count = if expected > 0 { format!(" of {expected}") } else { String::new() };
        result.map_err(|reason| CaptureError::OpenCv {
            name: self.name.in_words(),
            reason: format!("frame {}{count} cannot be decoded: {reason}", self.frames),
        })
    }

    fn try_retrieve(&mut self, out: &mut Picture) -> Result<(), String> {
        let words = |error: opencv::Error| error.message;
        let State::Open(capture) = &mut self.state else { return Err("the source is not open".to_owned()) };
        if !capture.retrieve(&mut self.mat, 0).map_err(words)? {
            return Err("the decoder gave nothing".to_owned());
        }
        let mat = &self.mat;
        if mat.rows() == 1 && mat.cols() > 1 && mat.channels() == 1 && mat.depth() == opencv::core::CV_8U {
            *out = jpeg::decode(mat.data_bytes().map_err(words)?)?;
            let told = |property| capture.get(property).unwrap_or(0.0) as usize;
            let size = (told(videoio::CAP_PROP_FRAME_WIDTH), told(videoio::CAP_PROP_FRAME_HEIGHT));
            if size.0 > 0 && size.1 > 0 && size != (out.width, out.height) {
                return Err(format!(
                    "a JPEG of {}x{} came where {}x{} was announced (interlaced?): convert it to another format",
                    out.width, out.height, size.0, size.1
                ));
            }
            return Ok(());
        }
        copy_mat(mat, out).map_err(words)?;
        if out.bytes() == 0 { Err("an empty picture came".to_owned()) } else { Ok(()) }
    }

    /// What the device's automatics have found.
    pub fn found(&self) -> Lock {
        let State::Open(capture) = &self.state else { return Lock::default() };
        let get = |property| capture.get(property).ok().filter(|value| *value > 0.0);
        let gain = get(videoio::CAP_PROP_GAIN).unwrap_or(0.0);
        Lock {
            exposure: get(videoio::CAP_PROP_EXPOSURE).map(|exposure| (exposure, gain)),
            white_balance_k: get(videoio::CAP_PROP_WB_TEMPERATURE),
        }
    }

    /// Switches the automatics off and holds `lock`, after a reconnection too. Answers whether the driver took everything.
    pub fn set_lock(&mut self, lock: Lock) -> bool {
        self.lock = lock;
        self.apply_lock()
    }

    fn apply_lock(&mut self) -> bool {
        let State::Open(capture) = &mut self.state else { return false };
        let mut taken = true;
        let mut set = |property, value| taken &= capture.set(property, value).unwrap_or(false);
        if let Some((exposure, gain)) = self.lock.exposure {
            set(videoio::CAP_PROP_AUTO_EXPOSURE, MANUAL_EXPOSURE);
            set(videoio::CAP_PROP_EXPOSURE, exposure);
            if gain > 0.0 {
                set(videoio::CAP_PROP_GAIN, gain);
            }
        }
        if let Some(temperature) = self.lock.white_balance_k {
            set(videoio::CAP_PROP_AUTO_WB, 0.0);
            set(videoio::CAP_PROP_WB_TEMPERATURE, temperature);
        }
        taken
    }
}

/// Waits twice as long before the next attempt.
fn again(wait: Duration) -> State {
    let wait = (wait * 2).min(LONGEST_WAIT);
    State::Waiting(Instant::now() + wait, wait)
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
