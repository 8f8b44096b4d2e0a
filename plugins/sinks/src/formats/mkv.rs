//! Matroska (RFC 9559) with one video track, written so that a file that is truncated anywhere still plays.
//!
//! Every frame is a separate cluster with its size in front, and the segment's size is unknown until [`Muxer::finish`] writes it together with the
//! duration, the index and the position of the index. GStreamer's `matroskamux` collects several frames in a cluster and reports failed writes only
//! after the call that caused them, so it does not replace this module.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};

const EBML: u32 = 0x1A45_DFA3;
const SEGMENT: u32 = 0x1853_8067;
const SEEK_HEAD: u32 = 0x114D_9B74;
const INFO: u32 = 0x1549_A966;
const TRACKS: u32 = 0x1654_AE6B;
const CLUSTER: u32 = 0x1F43_B675;
const CUES: u32 = 0x1C53_BB6B;
const DURATION: u32 = 0x4489;
const DEFAULT_DURATION: u32 = 0x23_E383;
const VOID: u32 = 0xEC;

fn id(out: &mut Vec<u8>, id: u32) {
    let bytes = id.to_be_bytes();
    let skip = bytes.iter().take_while(|&&b| b == 0).count();
    out.extend_from_slice(&bytes[skip..]);
}

/// Writes a size in eight bytes, whatever its value.
fn size8(out: &mut Vec<u8>, size: u64) {
    out.extend_from_slice(&(size | 1 << 56).to_be_bytes());
}

fn element(out: &mut Vec<u8>, tag: u32, body: &[u8]) {
    id(out, tag);
    if body.len() < 127 {
        out.push(0x80 | body.len() as u8);
    } else {
        size8(out, body.len() as u64);
    }
    out.extend_from_slice(body);
}

fn number(out: &mut Vec<u8>, tag: u32, value: u64) {
    let bytes = value.to_be_bytes();
    let skip = bytes.iter().take_while(|&&b| b == 0).count().min(7);
    element(out, tag, &bytes[skip..]);
}

/// Writes a void element of `len` bytes (2..=128), to be overwritten later.
fn reserve(out: &mut Vec<u8>, len: usize) {
    element(out, VOID, &vec![0; len - 2]);
}

fn master(out: &mut Vec<u8>, tag: u32, fill: impl FnOnce(&mut Vec<u8>)) {
    let mut body = Vec::new();
    fill(&mut body);
    element(out, tag, &body);
}

/// Destination of the video.
pub trait Output: Write + Seek {
    /// Truncates the file to `len` bytes; writing continues there.
    ///
    /// # Errors
    /// Those of the system.
    fn cut(&mut self, len: u64) -> io::Result<()>;

    /// Flushes everything to the disk.
    ///
    /// # Errors
    /// Those of the system, including deferred writes.
    fn sync(&mut self) -> io::Result<()>;
}

impl Output for File {
    fn cut(&mut self, len: u64) -> io::Result<()> {
        self.set_len(len)?;
        self.seek(SeekFrom::Start(len)).map(drop)
    }

    fn sync(&mut self) -> io::Result<()> {
        crate::target::sync(self)
    }
}

/// The video track of a file.
#[derive(Clone, Debug)]
pub struct Track {
    /// Matroska's name of the codec, such as `V_MJPEG`.
    pub codec: &'static str,
    /// Initialisation data of the decoder; empty if it needs none.
    pub private: Vec<u8>,
    /// Columns and rows, px.
    pub size_px: (usize, usize),
    /// Whether the file is WebM, a subset of Matroska.
    pub is_webm: bool,
}

/// Writes one Matroska file.
#[derive(Debug)]
pub struct Muxer<W: Output> {
    out: W,
    /// Offset of the segment's body; all positions inside the file count from here.
    segment_at: u64,
    seek_head_at: u64,
    duration_at: u64,
    default_duration_at: u64,
    /// End of the last complete frame.
    at: u64,
    /// Time (ms) and position of each keyframe.
    cues: Vec<(u64, u64)>,
    frames: u64,
    /// Times of the first and the newest frame, ms.
    span_ms: (u64, u64),
    head: Vec<u8>,
}

/// Reserved bytes for elements that are known only at the end of a recording.
const SEEK_HEAD_LEN: usize = 40;
const DURATION_LEN: usize = 2 + 1 + 8;
const DEFAULT_DURATION_LEN: usize = 3 + 1 + 8;

impl<W: Output> Muxer<W> {
    /// Writes the header of a file.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(mut out: W, track: &Track) -> io::Result<Self> {
        let mut b = Vec::with_capacity(512);
        master(&mut b, EBML, |b| {
            number(b, 0x4286, 1); // EBMLVersion
            number(b, 0x42F7, 1); // EBMLReadVersion
            number(b, 0x42F2, 4); // EBMLMaxIDLength
            number(b, 0x42F3, 8); // EBMLMaxSizeLength
            element(b, 0x4282, if track.is_webm { b"webm" } else { b"matroska" });
            number(b, 0x4287, 4); // DocTypeVersion
            number(b, 0x4285, 2); // DocTypeReadVersion
        });
        id(&mut b, SEGMENT);
        size8(&mut b, (1 << 56) - 1); // unknown
        let segment_at = b.len() as u64;
        let seek_head_at = b.len() as u64;
        reserve(&mut b, SEEK_HEAD_LEN);
        master(&mut b, INFO, |b| {
            number(b, 0x2A_D7B1, 1_000_000); // one step of time is 1 ms
            element(b, 0x4D80, b"panoscope"); // MuxingApp
            element(b, 0x5741, b"panoscope"); // WritingApp
            reserve(b, DURATION_LEN);
        });
        // Both elements that are completed later end their masters.
        let duration_at = (b.len() - DURATION_LEN) as u64;
        master(&mut b, TRACKS, |b| {
            master(b, 0xAE, |b| {
                number(b, 0xD7, 1); // TrackNumber
                number(b, 0x73C5, 1); // TrackUID
                number(b, 0x83, 1); // video
                number(b, 0x9C, 0); // no lacing
                element(b, 0x86, track.codec.as_bytes());
                if !track.private.is_empty() {
                    element(b, 0x63A2, &track.private);
                }
                master(b, 0xE0, |b| {
                    number(b, 0xB0, track.size_px.0 as u64);
                    number(b, 0xBA, track.size_px.1 as u64);
                });
                reserve(b, DEFAULT_DURATION_LEN);
            });
        });
        let default_duration_at = (b.len() - DEFAULT_DURATION_LEN) as u64;
        out.write_all(&b)?;
        out.flush()?;
        let at = b.len() as u64;
        let (cues, frames, span_ms) = (Vec::new(), 0, (0, 0));
        Ok(Self { out, segment_at, seek_head_at, duration_at, default_duration_at, at, cues, frames, span_ms, head: b })
    }

    /// Appends a frame that is shown from `time_ms` on; times must increase. The frame has been passed to the system on return. Seeking starts at
    /// frames with `is_key`.
    ///
    /// # Errors
    /// Those of the file, which then ends with the previous frame.
    pub fn push(&mut self, time_ms: u64, frame: &[u8], is_key: bool) -> io::Result<()> {
        let mut block = Vec::with_capacity(32);
        number(&mut block, 0xE7, time_ms); // the cluster's time
        block.push(0xA3); // SimpleBlock
        size8(&mut block, frame.len() as u64 + 4);
        block.extend_from_slice(&[0x81, 0, 0, if is_key { 0x80 } else { 0 }]); // track 1, 0 ms after the cluster
        let head = &mut self.head;
        head.clear();
        id(head, CLUSTER);
        size8(head, (block.len() + frame.len()) as u64);
        head.extend_from_slice(&block);
        let written = self.out.write_all(head).and_then(|()| self.out.write_all(frame)).and_then(|()| self.out.flush());
        if let Err(error) = written {
            // Readers take a torn end for the end, where it cannot be cut off.
            let _ = self.out.cut(self.at);
            return Err(error);
        }
        if is_key {
            self.cues.push((time_ms, self.at - self.segment_at));
        }
        self.span_ms = (if self.frames == 0 { time_ms } else { self.span_ms.0 }, time_ms);
        self.frames += 1;
        self.at += (self.head.len() + frame.len()) as u64;
        Ok(())
    }

    /// Writes index, duration and sizes, and flushes the file to the disk.
    ///
    /// # Errors
    /// The first one of the file. The file plays as far as it was written; if only the index did not fit, it is complete without one.
    pub fn finish(&mut self) -> io::Result<()> {
        let mut cues = Vec::with_capacity(self.cues.len() * 24);
        master(&mut cues, CUES, |b| {
            for &(time, place) in &self.cues {
                master(b, 0xBB, |b| {
                    number(b, 0xB3, time);
                    master(b, 0xB7, |b| {
                        number(b, 0xF7, 1);
                        number(b, 0xF1, place);
                    });
                });
            }
        });
        let indexed = self.out.seek(SeekFrom::Start(self.at)).and_then(|_| self.out.write_all(&cues));
        let end = match &indexed {
            Ok(()) => self.at + cues.len() as u64,
            Err(_) => self.out.cut(self.at).map(|()| self.at)?,
        };
        self.complete(indexed.is_ok(), end)?;
        self.out.flush()?;
        self.out.sync()?;
        indexed
    }

    /// Fills in what is known only at the end; never makes the file longer.
    fn complete(&mut self, is_indexed: bool, end: u64) -> io::Result<()> {
        let mut patch = Vec::new();
        let (first_ms, last_ms) = self.span_ms;
        let step_ms = if self.frames > 1 { (last_ms - first_ms) as f64 / (self.frames - 1) as f64 } else { 0.0 };
        if self.frames > 0 {
            element(&mut patch, DURATION, &(last_ms as f64 + step_ms).to_be_bytes());
            self.patch(self.duration_at, &patch)?;
        }
        if step_ms > 0.0 {
            patch.clear();
            element(&mut patch, DEFAULT_DURATION, &((step_ms * 1e6) as u64).to_be_bytes());
            self.patch(self.default_duration_at, &patch)?;
        }
        if is_indexed {
            patch.clear();
            master(&mut patch, SEEK_HEAD, |b| {
                master(b, 0x4DBB, |b| {
                    element(b, 0x53AB, &CUES.to_be_bytes());
                    element(b, 0x53AC, &(self.at - self.segment_at).to_be_bytes());
                });
            });
            let rest = SEEK_HEAD_LEN - patch.len();
            reserve(&mut patch, rest);
            self.patch(self.seek_head_at, &patch)?;
        }
        patch.clear();
        size8(&mut patch, end - self.segment_at);
        self.patch(self.segment_at - 8, &patch)
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.out.seek(SeekFrom::Start(at))?;
        self.out.write_all(bytes)
    }
}
