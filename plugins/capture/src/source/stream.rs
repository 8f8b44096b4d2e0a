//! Devices, video files, network streams and pipelines, through OpenCV's `VideoCapture`.

use std::time::{Duration, Instant};

use opencv::core::Mat;
use opencv::prelude::*;
use opencv::videoio::{self, VideoCapture};

use super::images::copy_mat;
use super::{CaptureError, Grab, Picture, Request, SourceName};
use crate::devices;

const FIRST_WAIT: Duration = Duration::from_millis(250);
const LONGEST_WAIT: Duration = Duration::from_secs(5);

/// V4L2's "manual" in the terms of OpenCV's `CAP_PROP_AUTO_EXPOSURE`.
const MANUAL_EXPOSURE: f64 = 1.0;

/// What a lock holds: exposure and gain, white balance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lock {
    /// Exposure and gain in the driver's units.
    pub exposure: Option<(f64, f64)>,
    /// Colour temperature in K.
    pub white_balance_k: Option<f64>,
}

/// An open stream, or a device that is waited for.
pub struct Stream {
    name: SourceName,
    request: Request,
    looped: bool,
    capture: VideoCapture,
    mat: Mat,
    frames: u64,
    expected: u64,
    retry: Option<(Instant, Duration)>,
    lock: Lock,
}

fn open(name: &SourceName, request: Request) -> Result<VideoCapture, CaptureError> {
    let opened = match name {
        SourceName::Device(number) => VideoCapture::new(*number, videoio::CAP_V4L2),
        SourceName::Pipeline(text) => {
            let has_sink = text.contains("appsink");
            let tail = " ! videoconvert ! video/x-raw,format=BGR ! appsink";
            let text = if has_sink { text.clone() } else { format!("{text}{tail}") };
            VideoCapture::from_file(&text, videoio::CAP_GSTREAMER)
        }
        SourceName::Address(text) => VideoCapture::from_file(text, videoio::CAP_FFMPEG),
        SourceName::Video(path) | SourceName::Image(path) => VideoCapture::from_file(path, videoio::CAP_FFMPEG),
        SourceName::Images(_) => VideoCapture::default(),
    };
    let closed = |reason: String| CaptureError::Closed { name: name.in_words(), reason };
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
            (videoio::CAP_PROP_FRAME_WIDTH, f64::from(request.width)),
            (videoio::CAP_PROP_FRAME_HEIGHT, f64::from(request.height)),
            (videoio::CAP_PROP_FPS, request.fps),
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
    Ok(capture)
}

impl Stream {
    /// Opens what `name` says.
    ///
    /// # Errors
    /// [`CaptureError::Closed`].
    pub fn open(name: &SourceName, request: Request, looped: bool) -> Result<Self, CaptureError> {
        let capture = open(name, request)?;
        let count = capture.get(videoio::CAP_PROP_FRAME_COUNT).unwrap_or(0.0);
        let expected = if matches!(name, SourceName::Video(_)) && count > 0.0 { count as u64 } else { 0 };
        Ok(Self {
            name: name.clone(),
            request,
            looped,
            capture,
            mat: Mat::default(),
            frames: 0,
            expected,
            retry: None,
            lock: Lock::default(),
        })
    }

    /// Whether pictures come at their own pace and may come back after a loss.
    pub fn is_live(&self) -> bool {
        matches!(self.name, SourceName::Device(_) | SourceName::Address(_))
    }

    /// Frames per second as the file or the driver says.
    pub fn native_fps(&self) -> Option<f64> {
        self.capture.get(videoio::CAP_PROP_FPS).ok().filter(|fps| *fps > 0.1 && *fps <= 1000.0)
    }

    /// Takes the next picture without decoding it.
    pub fn grab(&mut self) -> Grab {
        if let Some((when, wait)) = self.retry {
            if Instant::now() < when {
                return Grab::Lost;
            }
            match open(&self.name, self.request) {
                Ok(capture) => {
                    self.capture = capture;
                    self.retry = None;
                    self.apply_lock();
                }
                Err(_) => {
                    let wait = (wait * 2).min(LONGEST_WAIT);
                    self.retry = Some((Instant::now() + wait, wait));
                    return Grab::Lost;
                }
            }
        }
        if self.capture.grab().unwrap_or(false) {
            self.frames += 1;
            return Grab::Ready(Instant::now());
        }
        if self.is_live() {
            let _ = self.capture.release();
            self.retry = Some((Instant::now() + FIRST_WAIT, FIRST_WAIT));
            return Grab::Lost;
        }
        if self.looped && self.frames > 0 && matches!(self.name, SourceName::Video(_)) {
            // Opening anew is exact for every container; seeking is not.
            if let Ok(capture) = open(&self.name, self.request) {
                self.capture = capture;
                self.frames = 0;
                if self.capture.grab().unwrap_or(false) {
                    self.frames = 1;
                    return Grab::Ready(Instant::now());
                }
            }
        }
        Grab::End
    }

    /// A video that ended long before the length that its header tells: frames read, frames told.
    pub fn cut_off(&self) -> Option<(u64, u64)> {
        (self.expected > self.frames + 2 + self.frames / 20).then_some((self.frames, self.expected))
    }

    /// For messages.
    pub fn in_words(&self) -> String {
        self.name.in_words()
    }

    /// Decodes the picture that was grabbed.
    ///
    /// # Errors
    /// [`CaptureError::OpenCv`].
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        let retrieved = self.capture.retrieve(&mut self.mat, 0);
        let error = |reason: String| CaptureError::OpenCv { name: self.name.in_words(), reason };
        if !retrieved.map_err(|e| error(e.message))? {
            return Err(error("the picture cannot be decoded".into()));
        }
        copy_mat(&self.mat, out).map_err(|e| error(e.message))?;
        if out.bgr.is_empty() {
            return Err(error("an empty picture came".into()));
        }
        Ok(())
    }

    /// What the device's automatics have found.
    pub fn found(&self) -> Lock {
        let get = |property| self.capture.get(property).ok().filter(|value| *value > 0.0);
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
        let mut taken = true;
        let mut set = |property, value| taken &= self.capture.set(property, value).unwrap_or(false);
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
