//! One video file: frames in, an encoder, a container.

use std::fs::File;
use std::path::{Path, PathBuf};

use gstreamer::{Buffer, Caps, Fraction};
use image::{ImageBuffer, Rgb, imageops};
use panoscope_base::files::create;
use panoscope_media::{ContainerFile, Encoder, EncoderSettings, MediaError, Packet};
use panoscope_node::{NodeError, Result as NodeResult};

use super::codec::{Codec, FileKind};
use super::timeline::{Pacing, Timeline};
use crate::formats::mkv::{Muxer, Track};
use crate::target::{SinkError, sync};

/// Frame rate if frames have their own times or there is only one.
const FALLBACK_FPS: f64 = 30.0;

/// Distance of keyframes: a damaged frame spoils at most this many.
const KEY_INTERVAL: u32 = 60;

/// How a video is written.
#[derive(Clone, Debug)]
pub struct VideoSettings {
    /// The requested file.
    pub path: PathBuf,
    /// Kind of the file.
    pub kind: FileKind,
    /// Compression.
    pub codec: Codec,
    /// Constant rate of the file in Hz; 0 gives each frame its own time.
    pub fps: f64,
    /// Constant rate factor of H.264 and HEVC.
    pub crf: u8,
}

/// A frame to write.
pub struct Picture<'a> {
    /// Blue, green, red; rows without padding.
    pub bgr: &'a [u8],
    /// Columns and rows in px. The first frame sets the size of the video; others are fitted into it with black borders.
    pub size_px: (usize, usize),
    /// Its capture time, ns.
    pub at_ns: i64,
    /// Quality of JPEG, MPEG-4 and VP8, %.
    pub quality_pct: u8,
}

/// When the frames of a file are shown.
enum Pace {
    /// Each frame at its capture time.
    Timed(Timeline),
    /// At a constant rate: frames are repeated if they are further apart.
    Repeated {
        pacing: Pacing,
        /// The newest frame, to be repeated.
        last: Vec<u8>,
        rate: FrameCount,
    },
    /// At a constant rate: frames are counted.
    Counted(FrameCount),
}

/// Times of frames at a constant rate.
struct FrameCount {
    frames: u64,
    rate_hz: f64,
}

impl FrameCount {
    fn next_ns(&mut self) -> u64 {
        let time_ns = (self.frames as f64 * 1e9 / self.rate_hz).round() as u64;
        self.frames += 1;
        time_ns
    }
}

/// Destination of packets, once the first one exists.
enum Output {
    None,
    Matroska(Box<Muxer<File>>),
    Indexed(ContainerFile),
}

struct Video {
    encoder: Encoder,
    /// Size of the first frame, px.
    size_px: (usize, usize),
    pace: Pace,
    output: Output,
}

enum State {
    /// No frame has arrived.
    New,
    /// The first frame waits for the second one, whose time gives the frame rate.
    First { bgr: Vec<u8>, size_px: (usize, usize), at_ns: i64, quality_pct: u8 },
    /// Boxed, because the other states are small.
    Open(Box<Video>),
}

/// Writes one video file. In a Matroska file, an accepted frame has been passed to the system.
pub struct VideoWriter {
    settings: VideoSettings,
    /// Path of the newest part.
    path: PathBuf,
    state: State,
}

fn failed(path: &Path, error: MediaError) -> SinkError {
    match error {
        MediaError::DiskFull { .. } => SinkError::io(path, std::io::ErrorKind::StorageFull.into()),
        other => SinkError::Encode { path: path.to_owned(), reason: other.to_string() },
    }
}

/// Fits an image of `from` columns and rows into `to`, with its proportions kept and black borders.
fn letterbox(bgr: &[u8], from: (usize, usize), to: (usize, usize)) -> Option<Vec<u8>> {
    let scale = (to.0 as f64 / from.0 as f64).min(to.1 as f64 / from.1 as f64);
    let width = ((from.0 as f64 * scale).round() as usize).clamp(1, to.0);
    let height = ((from.1 as f64 * scale).round() as usize).clamp(1, to.1);
    // The order of the channels makes no difference.
    let picture = ImageBuffer::<Rgb<u8>, &[u8]>::from_raw(from.0 as u32, from.1 as u32, bgr)?;
    let small = imageops::resize(&picture, width as u32, height as u32, imageops::FilterType::Triangle);
    let mut out = vec![0; to.0 * to.1 * 3];
    let (left, top) = ((to.0 - width) / 2, (to.1 - height) / 2);
    for (y, row) in small.as_raw().chunks_exact(width * 3).enumerate() {
        let at = ((top + y) * to.0 + left) * 3;
        out[at..at + width * 3].copy_from_slice(row);
    }
    Some(out)
}

/// A rate as a fraction that is exact for integer rates and for those of NTSC.
fn fraction(rate_hz: f64) -> Fraction {
    let ntsc = (rate_hz * 1.001).round();
    if (ntsc * 1000.0 / 1001.0 - rate_hz).abs() < 1e-4 && (rate_hz - rate_hz.round()).abs() > 1e-6 {
        return Fraction::new(ntsc as i32 * 1000, 1001);
    }
    Fraction::new((rate_hz * 1000.0).round() as i32, 1000)
}

impl VideoWriter {
    /// Creates nothing before the first frame.
    pub fn new(settings: VideoSettings) -> Self {
        Self { path: settings.path.clone(), settings, state: State::New }
    }

    /// Appends a frame. Before it creates a file it calls `begin`, which returns the path to create.
    ///
    /// # Errors
    /// Of the encoder and of the file. The file is then complete and ends with the previous frame; the next frame starts another file.
    pub fn push(
        &mut self,
        picture: &Picture<'_>,
        begin: impl FnOnce(&Path) -> NodeResult<PathBuf>,
    ) -> Result<(), NodeError> {
        if matches!(self.state, State::New) {
            self.path = begin(&self.settings.path)?;
        }
        let pushed = self.append(picture);
        if pushed.is_err() {
            // The first error is the one to report.
            let _ = self.finish();
        }
        Ok(pushed?)
    }

    fn append(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        let Picture { bgr, size_px, at_ns, quality_pct } = *picture;
        match &self.state {
            State::New if self.settings.fps > 0.0 => {
                let rate = FrameCount { frames: 0, rate_hz: self.settings.fps };
                self.open(size_px, quality_pct, Pace::Counted(rate))?;
            }
            State::New if self.settings.kind.has_constant_rate() => {
                self.state = State::First { bgr: bgr.to_owned(), size_px, at_ns, quality_pct };
                return Ok(());
            }
            State::New => self.open(size_px, quality_pct, Pace::Timed(Timeline::default()))?,
            State::First { at_ns: first_ns, .. } => {
                let step_ns = at_ns - first_ns;
                self.open_paced(if step_ns > 0 { (1e9 / step_ns as f64).clamp(0.1, 1000.0) } else { FALLBACK_FPS })?;
            }
            State::Open(_) => {}
        }
        let State::Open(video) = &mut self.state else { return Ok(()) };
        video.append(&self.settings, &self.path, picture)
    }

    /// Opens a file of a constant rate and writes the frame that was held back for it.
    fn open_paced(&mut self, rate_hz: f64) -> Result<(), SinkError> {
        let State::First { bgr, size_px, at_ns, quality_pct } = std::mem::replace(&mut self.state, State::New) else {
            return Ok(());
        };
        let pace =
            Pace::Repeated { pacing: Pacing::new(rate_hz), last: Vec::new(), rate: FrameCount { frames: 0, rate_hz } };
        self.open(size_px, quality_pct, pace)?;
        let State::Open(video) = &mut self.state else { return Ok(()) };
        video.append(&self.settings, &self.path, &Picture { bgr: &bgr, size_px, at_ns, quality_pct })
    }

    fn open(&mut self, size_px: (usize, usize), quality_pct: u8, pace: Pace) -> Result<(), SinkError> {
        let rate_hz = match &pace {
            Pace::Timed(_) => fraction(FALLBACK_FPS),
            Pace::Counted(rate) | Pace::Repeated { rate, .. } => fraction(rate.rate_hz),
        };
        let encoder = Encoder::new(EncoderSettings {
            codec: self.settings.codec.with(quality_pct, self.settings.crf),
            framing: self.settings.kind.framing(),
            size_px,
            rate_hz,
            key_interval: KEY_INTERVAL,
        })
        .map_err(|error| failed(&self.path, error))?;
        self.state = State::Open(Box::new(Video { encoder, size_px, pace, output: Output::None }));
        Ok(())
    }

    /// How far the video lags because frames come faster than the rate of its file, ms.
    pub fn behind_ms(&self) -> f64 {
        match &self.state {
            State::Open(video) => match &video.pace {
                Pace::Repeated { pacing, .. } => pacing.behind_ms(),
                _ => 0.0,
            },
            _ => 0.0,
        }
    }

    /// Path of the video.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Completes the file and flushes it to the disk.
    ///
    /// # Errors
    /// Of the encoder and of the file.
    pub fn finish(&mut self) -> Result<(), SinkError> {
        if matches!(self.state, State::First { .. }) {
            self.open_paced(FALLBACK_FPS)?;
        }
        match std::mem::replace(&mut self.state, State::New) {
            State::Open(video) => video.finish(&self.settings, &self.path),
            _ => Ok(()),
        }
    }
}

impl Video {
    fn append(&mut self, settings: &VideoSettings, path: &Path, picture: &Picture<'_>) -> Result<(), SinkError> {
        let Picture { bgr, size_px, at_ns, quality_pct } = *picture;
        let fitted = if size_px == self.size_px { None } else { letterbox(bgr, size_px, self.size_px) };
        let bgr = fitted.as_deref().unwrap_or(bgr);
        self.encoder.set_quality_pct(quality_pct);
        let time_ns = match &mut self.pace {
            Pace::Timed(timeline) => timeline.next_ms(at_ns) * 1_000_000,
            Pace::Counted(rate) => rate.next_ns(),
            Pace::Repeated { pacing, last, rate } => {
                for _ in 0..pacing.repeats(at_ns) {
                    let packets = self.encoder.encode(last, self.size_px, rate.next_ns());
                    let packets = packets.map_err(|error| failed(path, error))?;
                    self.output.write(settings, path, &self.encoder, packets)?;
                }
                last.clear();
                last.extend_from_slice(bgr);
                rate.next_ns()
            }
        };
        let packets = self.encoder.encode(bgr, self.size_px, time_ns).map_err(|error| failed(path, error))?;
        self.output.write(settings, path, &self.encoder, packets)
    }

    fn finish(mut self, settings: &VideoSettings, path: &Path) -> Result<(), SinkError> {
        let rest = self.encoder.finish().map_err(|error| failed(path, error));
        let rest = rest.and_then(|rest| self.output.write(settings, path, &self.encoder, rest));
        let finished = match &mut self.output {
            Output::None => Ok(()),
            Output::Matroska(muxer) => muxer.finish().map_err(|error| SinkError::io(path, error)),
            Output::Indexed(file) => file
                .finish()
                .map_err(|error| failed(path, error))
                .and_then(|()| File::open(path).and_then(|f| sync(&f)).map_err(|error| SinkError::io(path, error))),
        };
        rest.and(finished)
    }
}

impl Output {
    fn write(
        &mut self,
        settings: &VideoSettings,
        path: &Path,
        encoder: &Encoder,
        packets: Vec<Packet>,
    ) -> Result<(), SinkError> {
        for packet in packets {
            if matches!(self, Self::None) {
                *self = Self::create(settings, path, encoder)?;
            }
            match self {
                Self::None => {}
                Self::Matroska(muxer) => {
                    let time_ms = packet.buffer.pts().map_or(0, |time| (time.nseconds() + 500_000) / 1_000_000);
                    let bytes = map(path, &packet.buffer)?;
                    muxer.push(time_ms, &bytes, packet.is_key()).map_err(|error| SinkError::io(path, error))?;
                }
                Self::Indexed(file) => file.push(packet).map_err(|error| failed(path, error))?,
            }
        }
        Ok(())
    }

    fn create(settings: &VideoSettings, path: &Path, encoder: &Encoder) -> Result<Self, SinkError> {
        let caps = encoder.caps().ok_or_else(|| SinkError::Encode {
            path: path.to_owned(),
            reason: "the encoder did not describe its packets".to_owned(),
        })?;
        let io = |error| SinkError::io(path, error);
        match settings.kind {
            FileKind::Matroska { is_webm } => {
                let private = codec_private(&caps).map(|buffer| map(path, &buffer).map(|bytes| bytes.to_vec()));
                let track = Track {
                    codec: settings.codec.matroska_id(),
                    private: private.transpose()?.unwrap_or_default(),
                    size_px: encoder.size_px(),
                    is_webm,
                };
                let file = create(path).map_err(io)?;
                let muxer = Muxer::new(file, &track).map_err(|error| {
                    // Without a head it is no video.
                    if path.symlink_metadata().is_ok_and(|found| found.is_file()) {
                        let _ = std::fs::remove_file(path);
                    }
                    io(error)
                })?;
                Ok(Self::Matroska(Box::new(muxer)))
            }
            FileKind::Indexed(container) => {
                // Reports with the system's error where it cannot be created.
                create(path).map_err(io)?;
                ContainerFile::create(path, container, &caps).map(Self::Indexed).map_err(|error| failed(path, error))
            }
        }
    }
}

/// Initialisation data of the decoder.
fn codec_private(caps: &Caps) -> Option<Buffer> {
    caps.structure(0)?.get::<Buffer>("codec_data").ok()
}

fn map<'a>(
    path: &Path,
    buffer: &'a Buffer,
) -> Result<gstreamer::BufferMap<'a, gstreamer::buffer::Readable>, SinkError> {
    buffer.map_readable().map_err(|error| SinkError::Encode { path: path.to_owned(), reason: error.to_string() })
}
