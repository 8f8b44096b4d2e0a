//! An H.264 decoder with a synchronous interface.

use std::sync::{Arc, Mutex, PoisonError};

use gstreamer::prelude::*;
use gstreamer::{
    Buffer, Bus, Caps, ClockTime, EventView, FormattedSegment, MessageView, Pad, PadDirection, Pipeline, State,
};
use gstreamer_video::{VideoFormat, VideoFrameExt, VideoFrameRef, VideoInfo};

use crate::MediaError;
use crate::elements::{init, make};
use crate::planes::{Plane, i420_to_bgr};

/// The decoding element.
const ELEMENT: &str = "avdec_h264";

#[derive(Default)]
struct Collected {
    info: Option<VideoInfo>,
    pictures: Vec<Buffer>,
}

/// Decodes H.264 with start codes, without reordered images, in the thread of the caller: the image is complete when
/// [`Decoder::decode`] returns.
pub struct Decoder {
    pipeline: Pipeline,
    bus: Bus,
    source: Pad,
    /// Receives the images; kept here because a link does not keep a pad alive.
    sink: Pad,
    packets: u64,
    collected: Arc<Mutex<Collected>>,
}

fn failure(reason: &str) -> MediaError {
    MediaError::Encoder { encoder: ELEMENT.to_owned(), reason: reason.to_owned() }
}

impl Decoder {
    /// Makes the element, once.
    ///
    /// # Errors
    /// GStreamer cannot start, or the element is missing: the error names the package to install.
    pub fn check() -> Result<(), MediaError> {
        make(ELEMENT).map(drop)
    }

    /// Sets up the element.
    ///
    /// # Errors
    /// GStreamer cannot start, or the element is missing or does not start.
    pub fn new() -> Result<Self, MediaError> {
        init()?;
        let decoder = make(ELEMENT)?;
        // With threads for whole pictures each would come some packets later.
        decoder.set_property("max-threads", 1_i32);
        decoder.set_property("output-corrupt", false);
        let pipeline = Pipeline::new();
        pipeline.add(&decoder).map_err(|error| failure(&error.to_string()))?;
        let (Some(first), Some(last)) = (decoder.static_pad("sink"), decoder.static_pad("src")) else {
            return Err(failure("it has no pads"));
        };
        let collected = Arc::new(Mutex::new(Collected::default()));
        let source = Pad::builder(PadDirection::Src).name("packets").build();
        let (pictures, events) = (Arc::clone(&collected), Arc::clone(&collected));
        let sink = Pad::builder(PadDirection::Sink)
            .name("pictures")
            .chain_function(move |_, _, buffer| {
                pictures.lock().unwrap_or_else(PoisonError::into_inner).pictures.push(buffer);
                Ok(gstreamer::FlowSuccess::Ok)
            })
            .event_function(move |_, _, event| {
                if let EventView::Caps(event) = event.view() {
                    let info = VideoInfo::from_caps(event.caps()).ok();
                    events.lock().unwrap_or_else(PoisonError::into_inner).info = info;
                }
                true
            })
            .build();
        let wired = |error: &dyn std::fmt::Display| failure(&error.to_string());
        sink.set_active(true).map_err(|error| wired(&error))?;
        source.set_active(true).map_err(|error| wired(&error))?;
        source.link(&first).map_err(|error| wired(&error))?;
        last.link(&sink).map_err(|error| wired(&error))?;
        let bus = pipeline.bus().ok_or_else(|| failure("the pipeline has no bus"))?;
        let this = Self { pipeline, bus, source, sink, packets: 0, collected };
        if this.pipeline.set_state(State::Playing).is_err() {
            return Err(this.error("it does not start"));
        }
        let caps = Caps::builder("video/x-h264").field("stream-format", "byte-stream").field("alignment", "au").build();
        this.source.push_event(gstreamer::event::StreamStart::new("packets"));
        this.source.push_event(gstreamer::event::Caps::new(&caps));
        this.source.push_event(gstreamer::event::Segment::new(&FormattedSegment::<ClockTime>::new()));
        Ok(this)
    }

    /// Decodes a packet into rows of blue, green and red: `size_px` columns and rows, `stride` bytes from row to row.
    /// The video may be one column and one row larger.
    ///
    /// # Errors
    /// The packet has no image of this size, or is damaged.
    ///
    /// # Panics
    /// When the rows do not lie inside `bgr`.
    pub fn decode(
        &mut self,
        packet: Vec<u8>,
        size_px: (usize, usize),
        stride: usize,
        bgr: &mut [u8],
    ) -> Result<(), MediaError> {
        let mut buffer = Buffer::from_mut_slice(packet);
        if let Some(buffer) = buffer.get_mut() {
            // Only their order matters.
            buffer.set_pts(ClockTime::from_mseconds(self.packets * 10));
        }
        self.packets += 1;
        if let Err(error) = self.source.push(buffer) {
            return Err(self.error(&error.to_string()));
        }
        let (info, picture) = {
            let mut collected = self.collected.lock().unwrap_or_else(PoisonError::into_inner);
            let picture = collected.pictures.pop();
            collected.pictures.clear();
            (collected.info.clone(), picture)
        };
        let (Some(info), Some(picture)) = (info, picture) else { return Err(self.error("a packet has no image")) };
        let even_px = (size_px.0.next_multiple_of(2), size_px.1.next_multiple_of(2));
        let video_px = (info.width() as usize, info.height() as usize);
        if info.format() != VideoFormat::I420 || video_px != even_px {
            let (width, height) = video_px;
            return Err(failure(&format!("expected an image of {}x{} px, got {width}x{height}", size_px.0, size_px.1)));
        }
        let damaged = |_| failure("an image does not match its description");
        let frame = VideoFrameRef::from_buffer_ref_readable(&picture, &info).map_err(damaged)?;
        let plane = |index: u32| {
            let data = frame.plane_data(index).map_err(|_| failure("an image lacks a plane"))?;
            Ok::<_, MediaError>(Plane { data, stride: frame.plane_stride()[index as usize].unsigned_abs() as usize })
        };
        i420_to_bgr([plane(0)?, plane(1)?, plane(2)?], size_px, stride, bgr);
        Ok(())
    }

    /// The error that the element reported, or `otherwise`.
    fn error(&self, otherwise: &str) -> MediaError {
        let reported = self.bus.iter().find_map(|message| match message.view() {
            MessageView::Error(error) => Some(MediaError::from(error)),
            _ => None,
        });
        reported.unwrap_or_else(|| failure(otherwise))
    }
}

impl Drop for Decoder {
    fn drop(&mut self) {
        // Stopping cannot fail in a way that anybody could repair.
        let _ = self.pipeline.set_state(State::Null);
        let _ = self.source.set_active(false);
        let _ = self.sink.set_active(false);
    }
}

#[cfg(test)]
mod tests {
    use gstreamer::Fraction;

    use super::*;
    use crate::{Encoder, EncoderSettings, Framing, RateControl, VideoCodec};

    fn picture(size: (usize, usize), shift: usize) -> Vec<u8> {
        let pixel = |at: usize| {
            let (x, y) = (at % size.0 + shift, at / size.0);
            [(x * 2) as u8, (y * 3) as u8, 128 + ((x / 16 + y / 16) % 2 * 60) as u8]
        };
        (0..size.0 * size.1).flat_map(pixel).collect()
    }

    #[test]
    fn each_packet_is_a_picture_at_once() {
        for size in [(64, 48), (63, 47)] {
            let settings = EncoderSettings {
                codec: VideoCodec::H264 { rate: RateControl::Crf(12) },
                framing: Framing::StartCodes,
                size_px: size,
                rate_hz: Fraction::new(30, 1),
                key_interval: 250,
            };
            let mut encoder = Encoder::new(settings).expect("an encoder");
            let mut decoder = Decoder::new().expect("a decoder");
            for number in 0..12 {
                let sent = picture(size, number);
                let packets = encoder.encode(&sent, size, number as u64).expect("it encodes");
                let [packet] = &packets[..] else { panic!("{} packets", packets.len()) };
                assert_eq!(packet.is_key(), number == 0);
                let bytes = packet.buffer.map_readable().expect("memory").to_vec();
                let stride = size.0 * 3 + 5;
                let mut rows = vec![0; stride * size.1];
                decoder.decode(bytes, size, stride, &mut rows).expect("it decodes");
                let arrived = rows.chunks(stride).flat_map(|row| &row[..size.0 * 3]);
                let error: u64 = arrived.zip(&sent).map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2)).sum();
                let psnr_db = 10.0 * (255.0 * 255.0 * sent.len() as f64 / error as f64).log10();
                assert!(psnr_db > 26.0, "picture {number} of {size:?}: {psnr_db} dB");
            }
        }
    }

    #[test]
    fn what_is_no_video_is_an_error() {
        let mut decoder = Decoder::new().expect("a decoder");
        let mut rows = vec![0; 64 * 48 * 3];
        assert!(decoder.decode(b"no video".to_vec(), (64, 48), 192, &mut rows).is_err());
    }
}
