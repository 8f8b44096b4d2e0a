//! Devices, video files, network streams and pipelines, through OpenCV's `VideoCapture`.

use std::time::Duration;

use opencv::core::Mat;
use opencv::prelude::*;
use opencv::videoio::{self, VideoCapture};

use super::decode::{copy_mat, decode_jpeg};
use super::demands::{Clock, Demands, Grab, Lock};
use super::error::{CaptureError, FrameError, PictureError};
use super::name::SourceName;
use super::opening::Opening;
use super::picture::Picture;

/// Pause before the first attempt to open a lost source again.
const FIRST_WAIT: Duration = Duration::from_millis(250);
/// Longest pause between two attempts.
const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// V4L2's "manual" in the terms of OpenCV's `CAP_PROP_AUTO_EXPOSURE`.
const MANUAL_EXPOSURE: f64 = 1.0;

/// Frames that a video may lack of the number in its header, which is often an estimate.
const HEADER_ERROR_FRAMES: u64 = 2;
/// Frames up to which a position is reached by reading, which is exact, instead of seeking, which is fast.
const READ_TO: u64 = 500;
/// Containers round times to milliseconds: times that differ less from the frame rate's are ignored, s.
const ROUNDING_S: f64 = 0.0015;

/// State of the connection.
enum State {
    Open(VideoCapture),
    /// Lost. Opened again at this time of the host's clock (ns); the last pause before it.
    Waiting(i64, Duration),
    /// Being opened; the last pause before it.
    Opening(Opening, Duration),
}

/// An open stream, or a lost device that is opened again.
pub struct Stream {
    name: SourceName,
    demands: Demands,
    state: State,
    mat: Mat,
    /// It has an end of its own.
    is_finite: bool,
    /// Frames since the start.
    frames: u64,
    /// Number of frames by the file's header or the pipeline; 0 when unknown.
    expected: u64,
    fps: Option<f64>,
    first_pos_s: Option<f64>,
    media_s: Option<f64>,
    /// Index of the frame that the next grab returns; 0 for the next one.
    go_to: u64,
    lock: Lock,
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
    /// Opens `name` within the time limit.
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

    /// Whether there is something to grab from. Opens a lost source again with growing pauses, without waiting for it here.
    fn is_open(&mut self, clock: Clock<'_>) -> bool {
        loop {
            let (next, is_settled) = match &mut self.state {
                State::Open(_) => return true,
                State::Waiting(when, _) if clock() < *when => return false,
                State::Waiting(_, wait) => match Opening::start(&self.name, self.demands) {
                    Ok(opening) => (State::Opening(opening, *wait), false),
                    Err(_) => (again(*wait, clock()), true),
                },
                State::Opening(opening, wait) => match opening.poll(clock()) {
                    None => return false,
                    Some(Ok(capture)) => (State::Open(capture), false),
                    Some(Err(_)) => (again(*wait, clock()), true),
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

    /// Skips the frames before the one asked for.
    fn skip_to_target(&mut self) -> bool {
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
    pub fn grab(&mut self, clock: Clock<'_>) -> Grab {
        if !self.is_open(clock) {
            return Grab::Lost;
        }
        let is_there = if self.is_finite && self.go_to > 0 { self.skip_to_target() } else { true };
        if is_there && self.grab_one() {
            self.note_time();
            return Grab::Ready(clock());
        }
        if self.is_finite {
            return match self.missing() {
                Some(words) => Grab::Failed(words),
                None => Grab::End,
            };
        }
        self.state = waiting(FIRST_WAIT, clock());
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

    /// A message about missing frames at the end of a file or pipeline that announced more.
    fn missing(&self) -> Option<String> {
        let (read, announced) = (self.frames, self.expected);
        (announced > read + HEADER_ERROR_FRAMES + read / 100).then(|| {
            format!(
                "{} ended after {read} of {announced} frames: it is cut off or damaged, or a frame in it cannot be decoded",
                self.name.in_words()
            )
        })
    }

    /// Decodes the picture that was grabbed.
    ///
    /// # Errors
    /// [`CaptureError::Frame`]. `out` is empty then.
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        out.clear();
        let result = self.try_retrieve(out);
        if result.is_err() {
            // The next frame must not show parts of this one.
            self.mat = Mat::default();
            out.clear();
        }
        let expected = self.expected;
        result.map_err(|cause| CaptureError::Frame {
            name: self.name.in_words(),
            frame: self.frames,
            of_expected: if expected > 0 { format!(" of {expected}") } else { String::new() },
            cause,
        })
    }

    fn try_retrieve(&mut self, out: &mut Picture) -> Result<(), FrameError> {
        let State::Open(capture) = &mut self.state else { return Err(FrameError::NotOpen) };
        if !capture.retrieve(&mut self.mat, 0).map_err(PictureError::from)? {
            return Err(FrameError::NoPicture);
        }
        let mat = &self.mat;
        if mat.rows() == 1 && mat.cols() > 1 && mat.channels() == 1 && mat.depth() == opencv::core::CV_8U {
            *out = decode_jpeg(mat.data_bytes().map_err(PictureError::from)?)?;
            let announced = |property| capture.get(property).unwrap_or(0.0) as usize;
            let size = (announced(videoio::CAP_PROP_FRAME_WIDTH), announced(videoio::CAP_PROP_FRAME_HEIGHT));
            if size.0 > 0 && size.1 > 0 && size != (out.width, out.height) {
                return Err(FrameError::OtherSize {
                    width: out.width,
                    height: out.height,
                    announced_width: size.0,
                    announced_height: size.1,
                });
            }
            return Ok(());
        }
        copy_mat(mat, out).map_err(PictureError::from)?;
        if out.bytes() == 0 { Err(FrameError::Empty) } else { Ok(()) }
    }

    /// Values that the device's automatics have set.
    pub fn automatic_values(&self) -> Lock {
        let State::Open(capture) = &self.state else { return Lock::default() };
        let get = |property| capture.get(property).ok().filter(|value| *value > 0.0);
        let gain = get(videoio::CAP_PROP_GAIN).unwrap_or(0.0);
        Lock {
            exposure: get(videoio::CAP_PROP_EXPOSURE).map(|exposure| (exposure, gain)),
            white_balance_k: get(videoio::CAP_PROP_WB_TEMPERATURE),
        }
    }

    /// Switches the automatics off and sets `lock`, after a reconnection too. Returns whether the driver accepted all values.
    pub fn set_lock(&mut self, lock: Lock) -> bool {
        self.lock = lock;
        self.apply_lock()
    }

    fn apply_lock(&mut self) -> bool {
        let State::Open(capture) = &mut self.state else { return false };
        let mut is_accepted = true;
        let mut set = |property, value| is_accepted &= capture.set(property, value).unwrap_or(false);
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
        is_accepted
    }
}

/// The next attempt after twice the pause.
fn again(wait: Duration, now_ns: i64) -> State {
    waiting((wait * 2).min(LONGEST_WAIT), now_ns)
}

/// The next attempt after a pause.
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
