//! A video encoder with a synchronous interface.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use gstreamer::prelude::*;
use gstreamer::{
    Buffer, Bus, Caps, ClockTime, Element, EventView, FormattedSegment, Fraction, MessageView, Pad, PadDirection,
    Pipeline, State,
};
use gstreamer_video::{DownstreamForceKeyUnitEvent, VideoColorimetry, VideoFormat, VideoInfo};

use crate::MediaError;
use crate::elements::{init, make};
use crate::planes::{PlaneMut, bgr_to_bgrx, bgr_to_i420};

/// Parts of an FFV1 image that are encoded in parallel.
const FFV1_SLICES: i32 = 4;

/// Compression of images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VideoCodec {
    /// One JPEG per image; `quality_pct` from 1 to 100.
    Mjpeg {
        /// Quality, %.
        quality_pct: u8,
    },
    /// H.264 with x264.
    H264 {
        /// Quality or bit rate.
        rate: RateControl,
    },
    /// H.264 with x264 in the constrained baseline profile, which every browser decodes.
    H264Baseline {
        /// Quality or bit rate.
        rate: RateControl,
    },
    /// HEVC with x265.
    Hevc {
        /// Quality or bit rate.
        rate: RateControl,
    },
    /// MPEG-4 part 2; `quality_pct` from 1 to 100.
    Mpeg4 {
        /// Quality, %.
        quality_pct: u8,
    },
    /// VP8; `quality_pct` from 1 to 100.
    Vp8 {
        /// Quality, %.
        quality_pct: u8,
    },
    /// FFV1 version 3 of BGR pixels: lossless, every image is decoded independently.
    Ffv1,
}

/// Rate control of an H.264 or HEVC encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RateControl {
    /// Constant quality, by the encoder's constant rate factor: 1 is nearly lossless, 50 is poor.
    Crf(u8),
    /// Constant bit rate in kbit/s.
    Kbits(u32),
}

/// Framing of H.264 and HEVC packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Framing {
    /// For files: lengths before the units, parameter sets in the caps.
    Lengths,
    /// For networks: start codes, parameter sets before every key frame.
    StartCodes,
}

/// Settings of an [`Encoder`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncoderSettings {
    /// Compression.
    pub codec: VideoCodec,
    /// Framing of H.264 and HEVC.
    pub framing: Framing,
    /// Columns and rows of the video in px. H.264 and HEVC have even sizes: an odd last column or row is repeated.
    pub size_px: (usize, usize),
    /// Frames per second, used for bit rates and for files of constant rate. Each packet still keeps the time of its
    /// frame.
    pub rate_hz: Fraction,
    /// Distance of key frames in images, for codecs that have other frames.
    pub key_interval: u32,
}

/// A compressed image.
#[derive(Clone, Debug)]
pub struct Packet {
    /// Compressed bytes, with presentation time and flags.
    pub buffer: Buffer,
}

impl Packet {
    /// Whether a decoder can start here.
    pub fn is_key(&self) -> bool {
        !self.buffer.flags().contains(gstreamer::BufferFlags::DELTA_UNIT)
    }
}

#[derive(Default)]
struct Collected {
    caps: Option<Caps>,
    packets: Vec<Packet>,
}

/// Encodes in the thread of the caller: there is no queue, so a frame's packet is complete when [`Encoder::encode`]
/// returns, and none is lost if the process is killed later. Codecs may use more threads for parts of a frame.
pub struct Encoder {
    pipeline: Pipeline,
    bus: Bus,
    source: Pad,
    /// Receives the packets; kept here because a link does not keep a pad alive.
    sink: Pad,
    encoder: Element,
    settings: EncoderSettings,
    /// Format of the encoder's input.
    info: VideoInfo,
    has_begun: bool,
    /// Reused once the elements have released it.
    picture: Option<Buffer>,
    pictures: u64,
    /// Times of the frames whose packets are not complete yet. The elements count images at a constant rate, because
    /// codecs spend bits by the time between images and some cannot hold a time in ms; packets come in the order of
    /// their images.
    times_ns: VecDeque<u64>,
    collected: Arc<Mutex<Collected>>,
}

impl VideoCodec {
    /// The encoding element and the parser behind it.
    fn elements(self) -> (&'static str, Option<&'static str>) {
        match self {
            Self::Mjpeg { .. } => ("jpegenc", None),
            Self::H264 { .. } | Self::H264Baseline { .. } => ("x264enc", None),
            Self::Hevc { .. } => ("x265enc", Some("h265parse")),
            Self::Mpeg4 { .. } => ("avenc_mpeg4", None),
            Self::Vp8 { .. } => ("vp8enc", None),
            Self::Ffv1 => ("avenc_ffv1", None),
        }
    }

    /// Whether the chroma planes need even sizes.
    fn is_even_sized(self) -> bool {
        matches!(self, Self::H264 { .. } | Self::H264Baseline { .. } | Self::Hevc { .. })
    }

    /// Pixel format of the encoder's input.
    fn format(self) -> VideoFormat {
        if self == Self::Ffv1 { VideoFormat::Bgrx } else { VideoFormat::I420 }
    }

    /// Colours by BT.601 for all sizes, because decoders that ignore the file's own colorimetry assume it.
    fn colorimetry(self) -> Option<VideoColorimetry> {
        match self {
            Self::Ffv1 => None,
            Self::Mjpeg { .. } => "1:4:0:0".parse().ok(),
            _ => "bt601".parse().ok(),
        }
    }

    /// Video format of the encoder's input for a size.
    fn info(self, (width, height): (usize, usize), rate_hz: Fraction) -> Option<VideoInfo> {
        let (width, height) = (u32::try_from(width).ok()?, u32::try_from(height).ok()?);
        let mut info = VideoInfo::builder(self.format(), width, height).fps(rate_hz);
        let colorimetry = self.colorimetry();
        if let Some(colorimetry) = &colorimetry {
            info = info.colorimetry(colorimetry);
        }
        info.build().ok()
    }

    fn output_caps(self, framing: Framing) -> Option<Caps> {
        let (name, lengths) = match self {
            Self::H264 { .. } | Self::H264Baseline { .. } => ("video/x-h264", "avc"),
            Self::Hevc { .. } => ("video/x-h265", "hvc1"),
            _ => return None,
        };
        let format = if framing == Framing::Lengths { lengths } else { "byte-stream" };
        let mut caps = Caps::builder(name).field("stream-format", format).field("alignment", "au");
        if matches!(self, Self::H264Baseline { .. }) {
            caps = caps.field("profile", "constrained-baseline");
        }
        Some(caps.build())
    }

    fn configure(self, encoder: &Element, key_interval: u32) {
        match self {
            Self::Mjpeg { quality_pct } => {
                encoder.set_property("quality", i32::from(quality_pct));
                encoder.set_property_from_str("idct-method", "islow");
            }
            Self::H264 { rate } | Self::H264Baseline { rate } => {
                encoder.set_property_from_str("tune", "zerolatency");
                encoder.set_property_from_str("speed-preset", "veryfast");
                encoder.set_property("key-int-max", key_interval);
                match rate {
                    RateControl::Crf(crf) => {
                        encoder.set_property_from_str("pass", "qual");
                        encoder.set_property("quantizer", u32::from(crf));
                    }
                    RateControl::Kbits(rate_kbits) => {
                        encoder.set_property("bitrate", rate_kbits);
                        // A short buffer keeps single pictures from delaying the next ones.
                        encoder.set_property("vbv-buf-capacity", 300_u32);
                    }
                }
            }
            Self::Hevc { rate } => {
                encoder.set_property_from_str("tune", "zerolatency");
                encoder.set_property_from_str("speed-preset", "ultrafast");
                encoder.set_property("key-int-max", key_interval as i32);
                match rate {
                    RateControl::Crf(crf) => {
                        encoder.set_property("option-string", format!("crf={crf}"));
                    }
                    RateControl::Kbits(rate_kbits) => encoder.set_property("bitrate", rate_kbits),
                }
            }
            Self::Mpeg4 { quality_pct } => {
                let quantizer = 1 + (100 - i32::from(quality_pct)) * 30 / 100;
                // Its own mode of constant quality ignores the quantizer.
                encoder.set_property("qmin", quantizer);
                encoder.set_property("qmax", quantizer);
                encoder.set_property("gop-size", key_interval as i32);
            }
            Self::Vp8 { quality_pct } => {
                let quantizer = (100 - i32::from(quality_pct)) * 63 / 100;
                encoder.set_property("min-quantizer", quantizer);
                encoder.set_property("max-quantizer", quantizer);
                encoder.set_property("deadline", 1_i64);
                encoder.set_property("cpu-used", 8_i32);
                encoder.set_property("lag-in-frames", 0_i32);
                encoder.set_property("keyframe-max-dist", key_interval as i32);
            }
            Self::Ffv1 => {
                encoder.set_property("gop-size", 1_i32);
                encoder.set_property("slices", FFV1_SLICES);
                encoder.set_property_from_str("threads", "auto");
            }
        }
    }

    /// Makes each element that an encoder of this codec needs, once.
    ///
    /// # Errors
    /// GStreamer cannot start, or an element is missing: the error names the package to install.
    pub fn check(self) -> Result<(), MediaError> {
        let (encoder, parser) = self.elements();
        ["capsfilter", encoder].into_iter().chain(parser).try_for_each(|name| make(name).map(drop))
    }
}

fn lock(collected: &Mutex<Collected>) -> std::sync::MutexGuard<'_, Collected> {
    collected.lock().unwrap_or_else(PoisonError::into_inner)
}

fn filter(caps: &Caps) -> Result<Element, MediaError> {
    let filter = make("capsfilter")?;
    filter.set_property("caps", caps);
    Ok(filter)
}

fn refused(what: &str) -> impl FnOnce(gstreamer::glib::BoolError) -> MediaError {
    let what = what.to_owned();
    move |error| MediaError::Encoder { encoder: what, reason: error.to_string() }
}

impl Encoder {
    /// Sets up the elements.
    ///
    /// # Errors
    /// GStreamer cannot start; an element is missing, with the package to install; the encoder refuses the settings.
    pub fn new(settings: EncoderSettings) -> Result<Self, MediaError> {
        init()?;
        let EncoderSettings { codec, framing, size_px, rate_hz, key_interval } = settings;
        let size_px = if codec.is_even_sized() {
            (size_px.0.next_multiple_of(2), size_px.1.next_multiple_of(2))
        } else {
            size_px
        };
        let settings = EncoderSettings { codec, framing, size_px, rate_hz, key_interval };
        let (name, parser) = codec.elements();
        let encoder = make(name)?;
        codec.configure(&encoder, key_interval);
        let wired =
            |error: &dyn std::fmt::Display| MediaError::Encoder { encoder: name.to_owned(), reason: error.to_string() };
        let info = codec.info(size_px, rate_hz);
        let info =
            info.ok_or_else(|| wired(&format!("{}x{} px is not a valid size of a video", size_px.0, size_px.1)))?;
        let mut chain = vec![encoder.clone()];
        if let Some(parser) = parser {
            chain.push(make(parser)?);
        }
        if let Some(caps) = codec.output_caps(framing) {
            chain.push(filter(&caps)?);
        }
        let pipeline = Pipeline::new();
        pipeline.add_many(&chain).map_err(refused(name))?;
        Element::link_many(&chain).map_err(refused(name))?;
        let (first, last) = (chain[0].static_pad("sink"), chain[chain.len() - 1].static_pad("src"));
        let (Some(first), Some(last)) = (first, last) else {
            return Err(MediaError::Encoder { encoder: name.to_owned(), reason: "it has no pads".to_owned() });
        };
        let collected = Arc::new(Mutex::new(Collected::default()));
        let source = Pad::builder(PadDirection::Src).name("pictures").build();
        let (packets, events) = (Arc::clone(&collected), Arc::clone(&collected));
        let sink = Pad::builder(PadDirection::Sink)
            .name("packets")
            .chain_function(move |_, _, buffer| {
                lock(&packets).packets.push(Packet { buffer });
                Ok(gstreamer::FlowSuccess::Ok)
            })
            .event_function(move |_, _, event| {
                if let EventView::Caps(event) = event.view() {
                    lock(&events).caps = Some(event.caps_owned());
                }
                true
            })
            .build();
        sink.set_active(true).map_err(refused(name))?;
        source.set_active(true).map_err(refused(name))?;
        source.link(&first).map_err(|error| wired(&error))?;
        last.link(&sink).map_err(|error| wired(&error))?;
        let bus = pipeline.bus().ok_or_else(|| wired(&"the pipeline has no bus"))?;
        let encoder = Self {
            pipeline,
            bus,
            source,
            sink,
            encoder,
            settings,
            info,
            has_begun: false,
            picture: None,
            pictures: 0,
            times_ns: VecDeque::new(),
            collected,
        };
        if encoder.pipeline.set_state(State::Playing).is_err() {
            return Err(encoder.error("it does not start"));
        }
        Ok(encoder)
    }

    /// Columns and rows of the video, px.
    pub fn size_px(&self) -> (usize, usize) {
        self.settings.size_px
    }

    /// Caps of the packets; known with the first packet.
    pub fn caps(&self) -> Option<Caps> {
        lock(&self.collected).caps.clone()
    }

    /// Changes the quality of `Mjpeg`; other codecs keep theirs.
    pub fn set_quality_pct(&mut self, quality_pct: u8) {
        if let VideoCodec::Mjpeg { quality_pct: current } = &mut self.settings.codec
            && *current != quality_pct
        {
            *current = quality_pct;
            self.encoder.set_property("quality", i32::from(quality_pct));
        }
    }

    /// Makes the next image a key frame.
    pub fn force_key(&self) {
        self.source.push_event(DownstreamForceKeyUnitEvent::builder().all_headers(true).build());
    }

    /// Encodes an image with presentation time `time_ns`; times must increase. `bgr`: rows of blue, green, red without
    /// padding, `size_px` columns and rows as in the settings.
    ///
    /// # Errors
    /// The encoder fails, or the image does not have this size.
    pub fn encode(&mut self, bgr: &[u8], size_px: (usize, usize), time_ns: u64) -> Result<Vec<Packet>, MediaError> {
        let buffer = self.fill(bgr, size_px)?;
        self.times_ns.push_back(time_ns);
        self.picture = Some(buffer.clone());
        let pushed = self.source.push(buffer);
        if let Err(error) = pushed {
            return Err(self.error(&error.to_string()));
        }
        Ok(self.take())
    }

    /// Ends the video and returns the packets that the encoder still held.
    ///
    /// # Errors
    /// The encoder fails.
    pub fn finish(&mut self) -> Result<Vec<Packet>, MediaError> {
        if self.has_begun {
            self.source.push_event(gstreamer::event::Eos::new());
            if let Some(error) = self.bus_error() {
                return Err(error);
            }
        }
        Ok(self.take())
    }

    fn take(&mut self) -> Vec<Packet> {
        let mut packets = std::mem::take(&mut lock(&self.collected).packets);
        for packet in &mut packets {
            let writable = packet.buffer.make_mut();
            writable.set_pts(self.times_ns.pop_front().map(ClockTime::from_nseconds));
            writable.set_dts(None);
            writable.set_duration(None);
        }
        packets
    }

    /// Announces the images that follow.
    fn begin(&mut self) -> Result<(), MediaError> {
        let caps = self.info.to_caps().map_err(|error| self.failure(error.to_string()))?;
        self.source.push_event(gstreamer::event::StreamStart::new("pictures"));
        self.source.push_event(gstreamer::event::Caps::new(&caps));
        self.source.push_event(gstreamer::event::Segment::new(&FormattedSegment::<ClockTime>::new()));
        self.has_begun = true;
        Ok(())
    }

    fn fill(&mut self, bgr: &[u8], size_px: (usize, usize)) -> Result<Buffer, MediaError> {
        let (columns, rows) = size_px;
        if columns == 0 || rows == 0 || bgr.len() != columns * rows * 3 {
            return Err(self.failure(format!("an image of {columns}x{rows} px has {} bytes", bgr.len())));
        }
        let video_px = self.settings.size_px;
        // But for a repeated last column or row.
        if video_px != size_px && !self.settings.codec.is_even_sized()
            || video_px.0.wrapping_sub(columns) > 1
            || video_px.1.wrapping_sub(rows) > 1
        {
            let message =
                format!("a picture of {columns}x{rows} px came into a video of {}x{}", video_px.0, video_px.1);
            return Err(self.failure(message));
        }
        if !self.has_begun {
            self.begin()?;
        }
        let info = &self.info;
        let last = self.picture.take().filter(|last| last.size() == info.size() && last.is_writable());
        let mut buffer = match last {
            Some(last) => last,
            None => Buffer::with_size(info.size()).map_err(|error| self.failure(error.to_string()))?,
        };
        let Some(writable) = buffer.get_mut() else { return Err(self.failure("its image is in use".to_owned())) };
        let rate_hz = self.settings.rate_hz;
        let (frames, seconds) = (rate_hz.numer().max(1) as u64, rate_hz.denom().max(1) as u64);
        writable.set_pts(ClockTime::SECOND.mul_div_round(self.pictures * seconds, frames));
        self.pictures += 1;
        {
            let mut map = writable.map_writable().map_err(|error| self.failure(error.to_string()))?;
            let plane = |data, index: usize| PlaneMut { data, stride: info.stride()[index] as usize };
            if self.settings.codec.format() == VideoFormat::Bgrx {
                bgr_to_bgrx(bgr, size_px, plane(&mut map, 0));
            } else {
                let (luma, chroma) = map.split_at_mut(info.offset()[1]);
                let (cb, cr) = chroma.split_at_mut(info.offset()[2] - info.offset()[1]);
                let is_full_range = matches!(self.settings.codec, VideoCodec::Mjpeg { .. });
                bgr_to_i420(bgr, size_px, video_px, is_full_range, [plane(luma, 0), plane(cb, 1), plane(cr, 2)]);
            }
        }
        Ok(buffer)
    }

    fn failure(&self, reason: String) -> MediaError {
        MediaError::Encoder { encoder: self.settings.codec.elements().0.to_owned(), reason }
    }

    fn bus_error(&self) -> Option<MediaError> {
        self.bus.iter().find_map(|message| match message.view() {
            MessageView::Error(error) => Some(MediaError::from(error)),
            _ => None,
        })
    }

    /// The error that an element reported, or `otherwise`.
    fn error(&self, otherwise: &str) -> MediaError {
        self.bus_error().unwrap_or_else(|| self.failure(otherwise.to_owned()))
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // Stopping cannot fail in a way that anybody could repair.
        let _ = self.pipeline.set_state(State::Null);
        let _ = self.source.set_active(false);
        let _ = self.sink.set_active(false);
    }
}
