//! The encoders behind `write_video`: JPEG frames in our own Matroska file, or what OpenCV's FFmpeg offers.

use std::fs::File;
use std::path::{Path, PathBuf};

use opencv::core::{Mat, Scalar, Size, Vec3b, Vector};
use opencv::prelude::*;
use opencv::videoio::{CAP_FFMPEG, VideoCapture, VideoWriter};
use opencv::{core, imgcodecs, imgproc};
use panoscope_node::{NodeError, Result as NodeResult};

use super::codec::Codec;
use super::timeline::{Pacing, Timeline};
use crate::formats::mkv::Muxer;
use crate::target::{SinkError, sync};

/// Frame rate of a video of one picture.
const FALLBACK_FPS: f64 = 30.0;

enum State {
    /// No picture has arrived.
    New,
    /// The first picture waits for the second one, whose time gives the frame rate.
    First {
        bgr: Vec<u8>,
        at_ns: i64,
    },
    Mkv {
        muxer: Box<Muxer<File>>,
        timeline: Timeline,
    },
    OpenCv {
        writer: VideoWriter,
        /// None where pictures are counted instead of timed.
        pacing: Option<Pacing>,
        /// The newest picture, to be repeated.
        last: Vec<u8>,
    },
}

/// Writes one video file.
pub struct Encoder {
    requested: PathBuf,
    /// Path of the newest part.
    path: PathBuf,
    codec: Codec,
    own: bool,
    fps: f64,
    size: (usize, usize),
    state: State,
    jpeg: Vector<u8>,
}

/// A picture to be written.
pub struct Picture<'a> {
    /// Blue, green, red; rows without padding.
    pub bgr: &'a [u8],
    /// Width and height in px, the same for all pictures of a file.
    pub size: (usize, usize),
    /// Its time, ns.
    pub at_ns: i64,
    /// Quality of JPEG, %.
    pub quality: i32,
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
        Self {
            requested: path.to_owned(),
            path: path.to_owned(),
            codec,
            own,
            fps,
            size: (0, 0),
            state: State::New,
            jpeg: Vector::new(),
        }
    }

    /// Appends a picture. Calls `begin` before it creates a file, which returns the path to create.
    ///
    /// # Errors
    /// Of the encoder and of the file, which is complete then and ends with the picture before; the next picture begins another one.
    pub fn push(
        &mut self,
        picture: &Picture<'_>,
        begin: impl FnOnce(&Path) -> NodeResult<PathBuf>,
    ) -> Result<(), NodeError> {
        if matches!(self.state, State::New) {
            self.path = begin(&self.requested)?;
        }
        let pushed = self.append(picture);
        if pushed.is_err() {
            // The first error is the one to report.
            let _ = self.finish();
        }
        Ok(pushed?)
    }

    fn append(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        let Picture { bgr, size, at_ns, quality } = *picture;
        self.size = size;
        match &self.state {
            State::New if self.own => {
                let io = |error| SinkError::io(&self.path, error);
                let file = File::create(&self.path).map_err(io)?;
                let muxer = Muxer::new(file, size.0, size.1).map_err(|error| {
                    // Without a head it is no video.
                    if self.path.symlink_metadata().is_ok_and(|found| found.is_file()) {
                        let _ = std::fs::remove_file(&self.path);
                    }
                    io(error)
                })?;
                self.state = State::Mkv { muxer: Box::new(muxer), timeline: Timeline::new(self.fps) };
            }
            State::New if self.fps > 0.0 => {
                let writer = self.open_writer(self.fps)?;
                self.state = State::OpenCv { writer, pacing: None, last: Vec::new() };
            }
            State::New => {
                self.state = State::First { bgr: bgr.to_owned(), at_ns };
                return Ok(());
            }
            State::First { bgr: first, at_ns: first_ns } => {
                let step_ns = at_ns - first_ns;
                let fps = if step_ns > 0 { (1e9 / step_ns as f64).clamp(0.1, 1000.0) } else { FALLBACK_FPS };
                let mut pacing = Pacing::new(fps);
                pacing.repeats(*first_ns);
                let mut writer = self.open_writer(fps)?;
                self.write(&mut writer, first)?;
                self.state = State::OpenCv { writer, pacing: Some(pacing), last: first.clone() };
            }
            _ => {}
        }
        match &mut self.state {
            State::Mkv { muxer, timeline } => {
                let params = Vector::from_slice(&[imgcodecs::IMWRITE_JPEG_QUALITY, quality]);
                mat(bgr, size)
                    .and_then(|picture| imgcodecs::imencode(".jpg", &picture, &mut self.jpeg, &params))
                    .map_err(|error| failed(&self.path, error))?;
                let time_ms = timeline.next_ms(at_ns);
                muxer.push(time_ms, self.jpeg.as_slice()).map_err(|error| SinkError::io(&self.path, error))
            }
            State::OpenCv { .. } => {
                let State::OpenCv { mut writer, mut pacing, mut last } = std::mem::replace(&mut self.state, State::New)
                else {
                    return Ok(());
                };
                let repeats = pacing.as_mut().map_or(0, |pacing| pacing.repeats(at_ns));
                let mut written = (0..repeats).try_for_each(|_| self.write(&mut writer, &last));
                written = written.and_then(|()| self.write(&mut writer, bgr));
                if pacing.is_some() {
                    last.clear();
                    last.extend_from_slice(bgr);
                }
                self.state = State::OpenCv { writer, pacing, last };
                written
            }
            _ => Ok(()),
        }
    }

    /// How far the video has fallen behind because pictures come faster than the rate of its file, in ms.
    pub fn behind_ms(&self) -> f64 {
        match &self.state {
            State::OpenCv { pacing: Some(pacing), .. } => pacing.behind_ms(),
            _ => 0.0,
        }
    }

    /// Where the video is written.
    pub fn path(&self) -> &Path {
        &self.path
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
        // Distinguishes a file that cannot be created from a missing codec.
        File::create(&self.path).map_err(|error| SinkError::io(&self.path, error))?;
        let (width, height) = self.even_size();
        let size = Size::new(width as i32, height as i32);
        let path = self.path.to_str().ok_or_else(|| refuse("the path is not UTF-8".into()))?;
        let fourcc = i32::from_le_bytes(*letters);
        let writer = VideoWriter::new_with_backend(path, CAP_FFMPEG, fourcc, fps, size, true)
            .map_err(|error| failed(&self.path, error))?;
        if !writer.is_opened().unwrap_or(false) {
            let _ = std::fs::remove_file(&self.path);
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

    /// Completes the file and hands it to the disk.
    ///
    /// # Errors
    /// Of the encoder and of the file.
    pub fn finish(&mut self) -> Result<(), SinkError> {
        let mut writer = match std::mem::replace(&mut self.state, State::New) {
            State::New => return Ok(()),
            State::Mkv { mut muxer, .. } => return muxer.finish().map_err(|error| SinkError::io(&self.path, error)),
            State::First { bgr, .. } => {
                let mut writer = self.open_writer(FALLBACK_FPS)?;
                self.write(&mut writer, &bgr)?;
                writer
            }
            State::OpenCv { writer, .. } => writer,
        };
        writer.release().map_err(|error| failed(&self.path, error))?;
        File::open(&self.path).and_then(|file| sync(&file)).map_err(|error| SinkError::io(&self.path, error))?;
        // FFmpeg does not report failed writes.
        let plays = self.path.to_str().is_some_and(|path| {
            VideoCapture::from_file(path, CAP_FFMPEG).and_then(|video| video.is_opened()).unwrap_or(false)
        });
        let unplayable = || SinkError::Encode {
            path: self.path.clone(),
            reason: "the completed file does not play: the disk may be full".to_owned(),
        };
        if plays { Ok(()) } else { Err(unplayable()) }
    }
}
