//! The encoders behind `write_video`: JPEG frames in our own Matroska file, or what OpenCV's FFmpeg offers.

use std::fs::File;
use std::path::{Path, PathBuf};

use opencv::core::{Mat, Scalar, Size, Vec3b, Vector};
use opencv::prelude::*;
use opencv::videoio::{CAP_FFMPEG, VideoWriter};
use opencv::{core, imgcodecs, imgproc};

use super::Codec;
use crate::formats::mkv::Muxer;
use crate::target::SinkError;

/// Frame rate of a video whose pictures do not tell one.
const FALLBACK_FPS: f64 = 30.0;

enum State {
    /// Nothing has arrived.
    New,
    /// The first picture waits for the second one, whose time gives the frame rate.
    First {
        bgr: Vec<u8>,
        capture_ns: i64,
    },
    Mkv {
        muxer: Box<Muxer<File>>,
        start_ns: i64,
        last_ms: u64,
    },
    OpenCv(VideoWriter),
    Done,
}

/// Writes one video file.
pub struct Encoder {
    path: PathBuf,
    codec: Codec,
    own: bool,
    fps: f64,
    size: (usize, usize),
    state: State,
    jpeg: Vector<u8>,
}

fn mat(bgr: &[u8], size: (usize, usize)) -> opencv::Result<opencv::boxed_ref::BoxedRef<'_, Mat>> {
    let too_large = |_| opencv::Error::new(core::StsBadSize, format!("{}x{} is too large", size.0, size.1));
    let (width, height) = (i32::try_from(size.0).map_err(too_large)?, i32::try_from(size.1).map_err(too_large)?);
    Mat::new_rows_cols_with_bytes::<Vec3b>(height, width, bgr)
}

/// Fits a BGR picture of `from` (width, height) into `to` with its proportions kept and black borders.
///
/// # Errors
/// OpenCV's.
pub fn letterbox(bgr: &[u8], from: (usize, usize), to: (usize, usize)) -> opencv::Result<Vec<u8>> {
    let scale = (to.0 as f64 / from.0 as f64).min(to.1 as f64 / from.1 as f64);
    let width = ((from.0 as f64 * scale).round() as usize).clamp(1, to.0);
    let height = ((from.1 as f64 * scale).round() as usize).clamp(1, to.1);
    let mut small = Mat::default();
    let filter = if scale < 1.0 { imgproc::INTER_AREA } else { imgproc::INTER_LINEAR };
    imgproc::resize(&mat(bgr, from)?, &mut small, Size::new(width as i32, height as i32), 0.0, 0.0, filter)?;
    let small = small.data_bytes()?;
    let mut out = vec![0; to.0 * to.1 * 3];
    let (left, top) = ((to.0 - width) / 2, (to.1 - height) / 2);
    for (y, row) in small.chunks_exact(width * 3).enumerate() {
        let at = ((top + y) * to.0 + left) * 3;
        out[at..at + width * 3].copy_from_slice(row);
    }
    Ok(out)
}

fn failed(path: &Path, error: opencv::Error) -> SinkError {
    SinkError::Encode { path: path.to_owned(), reason: error.message }
}

impl Encoder {
    /// Nothing is created before the first picture.
    pub fn new(path: &Path, ending: &str, codec: Codec, fps: f64) -> Self {
        let own = codec == Codec::Mjpg && ending == "mkv";
        Self { path: path.to_owned(), codec, own, fps, size: (0, 0), state: State::New, jpeg: Vector::new() }
    }

    /// Appends a picture of always the same `size`.
    ///
    /// # Errors
    /// Of the encoder and of the file.
    pub fn push(&mut self, bgr: &[u8], size: (usize, usize), capture_ns: i64, quality: i32) -> Result<(), SinkError> {
        self.size = size;
        match &self.state {
            State::New if self.own => {
                let file = File::create(&self.path).map_err(|error| SinkError::io(&self.path, error))?;
                let muxer = Muxer::new(file, size.0, size.1).map_err(|error| SinkError::io(&self.path, error))?;
                self.state = State::Mkv { muxer: Box::new(muxer), start_ns: capture_ns, last_ms: 0 };
            }
            State::New if self.fps > 0.0 => self.state = State::OpenCv(self.open_writer(self.fps)?),
            State::New => {
                self.state = State::First { bgr: bgr.to_owned(), capture_ns };
                return Ok(());
            }
            State::First { bgr: first, capture_ns: first_ns } => {
                let step_ns = capture_ns - first_ns;
                let fps = if step_ns > 0 { (1e9 / step_ns as f64).clamp(0.1, 1000.0) } else { FALLBACK_FPS };
                let mut writer = self.open_writer(fps)?;
                self.write(&mut writer, first)?;
                self.state = State::OpenCv(writer);
            }
            _ => {}
        }
        match &mut self.state {
            State::Mkv { muxer, start_ns, last_ms } => {
                let frames = muxer.frames() as u64;
                let mut time_ms = if self.fps > 0.0 {
                    (frames as f64 * 1000.0 / self.fps).round() as u64
                } else {
                    (capture_ns.saturating_sub(*start_ns).max(0) as u64 + 500_000) / 1_000_000
                };
                if frames > 0 {
                    time_ms = time_ms.max(*last_ms + 1);
                }
                *last_ms = time_ms;
                let params = Vector::from_slice(&[imgcodecs::IMWRITE_JPEG_QUALITY, quality]);
                mat(bgr, size)
                    .and_then(|picture| imgcodecs::imencode(".jpg", &picture, &mut self.jpeg, &params))
                    .map_err(|error| failed(&self.path, error))?;
                muxer.push(time_ms, self.jpeg.as_slice()).map_err(|error| SinkError::io(&self.path, error))
            }
            State::OpenCv(_) => {
                let State::OpenCv(mut writer) = std::mem::replace(&mut self.state, State::Done) else {
                    return Ok(());
                };
                let written = self.write(&mut writer, bgr);
                self.state = State::OpenCv(writer);
                written
            }
            _ => Ok(()),
        }
    }

    /// OpenCV's writer cuts odd sides off: they are made even by repeating the last row or column.
    fn even_size(&self) -> (usize, usize) {
        (self.size.0.next_multiple_of(2), self.size.1.next_multiple_of(2))
    }

    fn open_writer(&self, fps: f64) -> Result<VideoWriter, SinkError> {
        let letters = match self.codec {
            Codec::Mjpg => b"MJPG",
            Codec::H264 => b"avc1",
            Codec::Mpeg4 => b"mp4v",
            Codec::Vp8 => b"VP80",
            Codec::Ffv1 => b"FFV1",
        };
        let refuse = |reason: String| SinkError::Encode { path: self.path.clone(), reason };
        // A file that cannot be made is told apart from a codec that is missing.
        File::create(&self.path).map_err(|error| SinkError::io(&self.path, error))?;
        let (width, height) = self.even_size();
        let size = Size::new(width as i32, height as i32);
        let path = self.path.to_str().ok_or_else(|| refuse("the path is not UTF-8".into()))?;
        let fourcc = i32::from_le_bytes(*letters);
        let writer = VideoWriter::new_with_backend(path, CAP_FFMPEG, fourcc, fps, size, true)
            .map_err(|error| failed(&self.path, error))?;
        if !writer.is_opened().unwrap_or(false) {
            return Err(refuse(format!(
                "this OpenCV has no {:?} encoder for such a file: try codec = \"mjpg\" with .mkv",
                self.codec
            )));
        }
        Ok(writer)
    }

    fn write(&self, writer: &mut VideoWriter, bgr: &[u8]) -> Result<(), SinkError> {
        let written = if self.even_size() == self.size {
            mat(bgr, self.size).and_then(|picture| writer.write(&picture))
        } else {
            let (right, below) = (self.size.0 % 2, self.size.1 % 2);
            let mut padded = Mat::default();
            mat(bgr, self.size)
                .and_then(|picture| {
                    let (right, below) = (right as i32, below as i32);
                    core::copy_make_border(
                        &picture,
                        &mut padded,
                        0,
                        below,
                        0,
                        right,
                        core::BORDER_REPLICATE,
                        Scalar::default(),
                    )
                })
                .and_then(|()| writer.write(&padded))
        };
        written.map_err(|error| failed(&self.path, error))
    }

    /// Completes the file.
    ///
    /// # Errors
    /// Of the encoder and of the file.
    pub fn finish(&mut self) -> Result<(), SinkError> {
        match std::mem::replace(&mut self.state, State::Done) {
            State::New | State::Done => Ok(()),
            State::First { bgr, .. } => {
                let mut writer = self.open_writer(FALLBACK_FPS)?;
                self.write(&mut writer, &bgr)?;
                writer.release().map_err(|error| failed(&self.path, error))
            }
            State::Mkv { muxer, .. } => muxer.finish().map(drop).map_err(|error| SinkError::io(&self.path, error)),
            State::OpenCv(mut writer) => writer.release().map_err(|error| failed(&self.path, error)),
        }
    }
}
