//! Decodes image files.

use std::fs;
use std::io::Cursor;
use std::path::Path;
use std::time::Duration;

use image::metadata::Orientation;
use panoscope_media::input::{CameraMode, Input, InputName, InputOptions, Signal};
use tiff::ColorType;
use tiff::decoder::DecodingResult;
use tiff::tags::Tag;

use super::compressed::{decode, decode_jpeg};
use super::error::PictureError;
use super::frames::Frames;
use super::picture::{Picture, Samples};
use super::plain;

/// Time limit for a file that GStreamer decodes.
const LIMIT: Duration = Duration::from_secs(10);

/// Reads an image file as BGR. A truncated file is an error, never an image with old or gray parts.
///
/// # Errors
/// The file cannot be read or decoded.
pub fn read(path: &Path) -> Result<Picture, PictureError> {
    let bytes = fs::read(path).map_err(|cause| PictureError::Read { cause })?;
    if bytes.is_empty() {
        return Err(PictureError::Empty);
    }
    decode_picture(&bytes).unwrap_or_else(|| decode_other(path))
}

/// Decodes an image in memory as BGR; `None` for formats that GStreamer decodes from a file.
///
/// # Errors
/// The bytes are damaged or of an unsupported format.
pub fn decode_picture(bytes: &[u8]) -> Option<Result<Picture, PictureError>> {
    Some(match image::guess_format(bytes) {
        Ok(image::ImageFormat::Jpeg) => decode_jpeg(bytes),
        Ok(format @ (image::ImageFormat::Png | image::ImageFormat::OpenExr)) => decode(bytes, format),
        Ok(image::ImageFormat::Tiff) => decode_tiff(bytes),
        Ok(image::ImageFormat::Bmp) => plain::bmp(bytes),
        Ok(image::ImageFormat::Pnm) => plain::pnm(bytes),
        // A BigTIFF, which the guess does not know.
        _ if bytes.starts_with(b"II+\0") || bytes.starts_with(b"MM\0+") => decode_tiff(bytes),
        _ => return None,
    })
}

/// Number of pages of a TIFF, without reduced copies of other pages.
fn pages(decoder: &mut tiff::decoder::Decoder<Cursor<&[u8]>>) -> Result<usize, tiff::TiffError> {
    /// Bit of `NewSubfileType` that marks a reduced copy.
    const REDUCED: u32 = 1;
    let mut count = 0;
    loop {
        let kind = decoder.find_tag_unsigned::<u32>(Tag::NewSubfileType)?;
        count += usize::from(kind.unwrap_or(0) & REDUCED == 0);
        if !decoder.more_images() {
            decoder.seek_to_image(0)?;
            return Ok(count);
        }
        decoder.next_image()?;
    }
}

/// Decodes a TIFF with one page, of unsigned 8 or 16 bits or of floats.
fn decode_tiff(bytes: &[u8]) -> Result<Picture, PictureError> {
    let damaged = |cause: tiff::TiffError| match cause {
        tiff::TiffError::UnsupportedError(kind) => PictureError::Unsupported { format: format!("TIFF, {kind}") },
        cause => PictureError::Tiff { cause },
    };
    let mut decoder = tiff::decoder::Decoder::new(Cursor::new(bytes)).map_err(damaged)?;
    let (width, height) = decoder.dimensions().map_err(damaged)?;
    let pages = pages(&mut decoder).map_err(damaged)?;
    if pages > 1 {
        return Err(PictureError::Pages { count: pages });
    }
    let tag = decoder.find_tag_unsigned::<u16>(Tag::Orientation).map_err(damaged)?;
    const APART: u16 = 2;
    let color = decoder.colortype().map_err(damaged)?;
    let planes = decoder.find_tag_unsigned::<u16>(Tag::PlanarConfiguration).map_err(damaged)?;
    if planes == Some(APART) && color.num_samples() > 1 {
        return Err(PictureError::Unsupported { format: "TIFF, one plane for each colour".to_owned() });
    }
    if color.bit_depth() < 8 {
        return Err(PictureError::Unsupported { format: format!("TIFF, {color:?}") });
    }
    let channels = match color {
        ColorType::Gray(_) => 1,
        ColorType::GrayA(_) => 2,
        ColorType::RGB(_) => 3,
        ColorType::RGBA(_) => 4,
        other => return Err(PictureError::Unsupported { format: format!("{other:?}") }),
    };
    let (width, height) = (width as usize, height as usize);
    let samples = match decoder.read_image().map_err(damaged)? {
        DecodingResult::U8(values) => Samples::Eight(plain::bgr(&values, channels).into()),
        DecodingResult::U16(values) => Samples::Sixteen(plain::bgr(&values, channels)),
        DecodingResult::F32(values) => Samples::Float(plain::bgr(&values, channels)),
        DecodingResult::F64(values) => {
            let values: Vec<f32> = values.into_iter().map(|value| value as f32).collect();
            Samples::Float(plain::bgr(&values, channels))
        }
        DecodingResult::I8(_) => return Err(PictureError::Unsupported { format: "signed 8-bit".to_owned() }),
        DecodingResult::I16(_) => return Err(PictureError::Unsupported { format: "signed 16-bit".to_owned() }),
        _ => return Err(PictureError::Unsupported { format: format!("{color:?}") }),
    };
    let orientation = tag.and_then(|tag| Orientation::from_exif(u8::try_from(tag).ok()?));
    let picture = Picture {
        orientation: orientation.unwrap_or(Orientation::NoTransforms),
        ..Picture::new((width, height), samples)
    };
    let values = 3 * width * height;
    let is_whole = match &picture.samples {
        Samples::Eight(bgr) => bgr.len() == values,
        Samples::Sixteen(bgr) => bgr.len() == values,
        Samples::Float(bgr) => bgr.len() == values,
        Samples::Decoded(_) => true,
    };
    if is_whole { Ok(picture) } else { Err(PictureError::Incomplete) }
}

/// Decodes formats that only GStreamer supports.
fn decode_other(path: &Path) -> Result<Picture, PictureError> {
    let name = InputName::File(path.to_owned());
    let options = InputOptions { mode: CameraMode::default(), is_lossless: true, capacity: 1, limit: LIMIT };
    let mut frames = Frames::default();
    let unknown = |cause: &dyn std::fmt::Display| PictureError::Unknown { reason: cause.to_string() };
    let input = Input::open(&name, &options, Signal::default().into(), move |received| frames.of_sample(&received))
        .map_err(|cause| unknown(&cause))?;
    let item = input.queue().pop(LIMIT).ok_or(PictureError::Incomplete)?;
    item.content.map_err(|cause| unknown(&cause))
}
