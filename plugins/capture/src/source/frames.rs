//! Converts samples of a pipeline to frames. Runs on the pipeline's thread.

use std::sync::Arc;

use gstreamer as gst;
use gstreamer_video::prelude::*;
use gstreamer_video::video_frame::Readable;
use gstreamer_video::{VideoColorRange, VideoConverter, VideoFormat, VideoFrame, VideoInfo};
use image::metadata::Orientation;
use panoscope_media::input::{Received, YUV_FORMATS, jpeg};
use panoscope_media::{Component, FromYuv, Plane, yuv_to_bgr};

use super::compressed::decode_jpeg;
use super::error::FrameError;
use super::picture::{Picture, Samples};

/// Converts samples: JPEGs are checked and decoded, BGR stays in the decoder's memory, 16-bit gray keeps its depth, and any other format is converted
/// to BGR.
#[derive(Default)]
pub struct Frames {
    info: Option<VideoInfo>,
    converter: Option<(VideoInfo, VideoConverter, VideoInfo)>,
}

impl Frames {
    /// Converts a sample to a frame.
    ///
    /// # Errors
    /// Why it must not be shown.
    pub fn of_sample(&mut self, received: &Received<'_>) -> Result<Picture, FrameError> {
        let mut picture = self.stored(received)?;
        if let Some(orientation) = Orientation::from_exif(received.exif_orientation) {
            picture.orientation = orientation;
        }
        Ok(picture)
    }

    /// Converts a sample without rotating it.
    fn stored(&mut self, received: &Received<'_>) -> Result<Picture, FrameError> {
        if let Some(reason) = &received.damage {
            return Err(FrameError::Damaged { reason: reason.clone() });
        }
        let (Some(buffer), Some(caps)) = (received.sample.buffer_owned(), received.sample.caps()) else {
            return Err(FrameError::Empty);
        };
        let Some(structure) = caps.structure(0) else { return Err(FrameError::Empty) };
        if structure.name() == "image/jpeg" {
            return of_jpeg(&buffer, structure);
        }
        let info = match self.info.take() {
            Some(info) if info.to_caps().is_ok_and(|known| known.as_ref() == caps) => info,
            _ => VideoInfo::from_caps(caps).map_err(|_| FrameError::Unsupported { format: caps.to_string() })?,
        };
        self.info = Some(info.clone());
        let (expected, bytes) = (info.size(), buffer.size());
        let short = move |_| FrameError::Short { bytes, expected };
        let frame = VideoFrame::from_buffer_readable(buffer, &info).map_err(short)?;
        match info.format() {
            VideoFormat::Bgr => Ok(decoded(frame)),
            VideoFormat::Gray16Le => Ok(deep_gray(&frame)),
            _ => match of_yuv(&frame) {
                Some(picture) => Ok(picture),
                None => self.converted(&frame),
            },
        }
    }

    fn converted(&mut self, frame: &VideoFrame<Readable>) -> Result<Picture, FrameError> {
        let info = frame.info();
        let unsupported = || FrameError::Unsupported { format: format!("{:?}", info.format()) };
        if self.converter.as_ref().is_none_or(|(known, ..)| known != info) {
            // The converter changes the format only: rate and fields must be the same.
            let target = VideoInfo::builder(VideoFormat::Bgr, info.width(), info.height())
                .fps(info.fps())
                .interlace_mode(info.interlace_mode())
                .build()
                .map_err(|_| unsupported())?;
            let converter = VideoConverter::new(info, &target, None).map_err(|_| unsupported())?;
            self.converter = Some((info.clone(), converter, target));
        }
        let Some((_, converter, target)) = &self.converter else { return Err(unsupported()) };
        let buffer = gst::Buffer::with_size(target.size()).map_err(|_| unsupported())?;
        let mut out = VideoFrame::from_buffer_writable(buffer, target).map_err(|_| unsupported())?;
        converter.frame(frame, &mut out);
        let out = VideoFrame::from_buffer_readable(out.into_buffer(), target).map_err(|_| unsupported())?;
        Ok(decoded(out))
    }
}

/// Converts 8-bit luma and chroma of any layout to BGR; `None` for other formats. GStreamer's converter makes such frames 2 to 3 levels too dark.
fn of_yuv(frame: &VideoFrame<Readable>) -> Option<Picture> {
    let (info, format) = (frame.info(), frame.format_info());
    if !YUV_FORMATS.contains(&format.format().to_str().as_str()) {
        return None;
    }
    let colorimetry = info.colorimetry();
    let (red_share, blue_share) = colorimetry.matrix().kr_kb().unwrap_or((0.299, 0.114));
    let is_full_range = colorimetry.range() == VideoColorRange::Range0_255;
    let component = |index: usize| {
        let number = index as u32;
        let stride = usize::try_from(frame.comp_stride(number)).ok()?;
        let step = usize::try_from(frame.comp_pstride(number)).ok()?;
        let shift = (*format.w_sub().get(index)?, *format.h_sub().get(index)?);
        Some(Component { plane: Plane { data: frame.comp_data(number).ok()?, stride }, step, shift })
    };
    let components = [component(0)?, component(1)?, component(2)?];
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let mut bgr = vec![0; 3 * width * height];
    yuv_to_bgr(FromYuv::new(red_share, blue_share, is_full_range), components, (width, height), 3 * width, &mut bgr);
    Some(Picture::new((width, height), Samples::Eight(bgr.into())))
}

fn decoded(frame: VideoFrame<Readable>) -> Picture {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    Picture::new((width, height), Samples::Decoded(Arc::new(frame)))
}

fn deep_gray(frame: &VideoFrame<Readable>) -> Picture {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let stride = usize::try_from(frame.plane_stride()[0]).unwrap_or(0);
    let plane = frame.plane_data(0).unwrap_or(&[]);
    let mut values = Vec::with_capacity(3 * width * height);
    for row in plane.chunks(stride.max(1)).take(height) {
        let row = row.as_chunks::<2>().0.iter().take(width);
        values.extend(row.flat_map(|bytes| [u16::from_le_bytes(*bytes); 3]));
    }
    Picture::new((width, height), Samples::Sixteen(values))
}

fn of_jpeg(buffer: &gst::BufferRef, structure: &gst::StructureRef) -> Result<Picture, FrameError> {
    let map = buffer.map_readable().map_err(|_| FrameError::Empty)?;
    if map.is_empty() {
        return Err(FrameError::Empty);
    }
    jpeg::check(&map).map_err(super::error::PictureError::from)?;
    let picture = decode_jpeg(&map)?;
    let announced = |name: &str| structure.get::<i32>(name).map_or(0, |value| usize::try_from(value).unwrap_or(0));
    let (announced_width, announced_height) = (announced("width"), announced("height"));
    let (width, height) = (picture.width, picture.height);
    if announced_width > 0 && announced_height > 0 && (announced_width, announced_height) != (width, height) {
        return Err(FrameError::OtherSize { width, height, announced_width, announced_height });
    }
    Ok(picture)
}
