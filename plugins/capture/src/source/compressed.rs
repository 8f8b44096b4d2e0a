//! Decodes PNG, EXR and JPEG in memory.

use image::DynamicImage;
use panoscope_media::input::jpeg;

use super::error::PictureError;
use super::picture::{Picture, Samples};
use super::plain::bgr_of_rgb;

/// Decodes a PNG or an EXR, or a JPEG that is known to be whole.
///
/// # Errors
/// A picture that is damaged.
pub fn decode(bytes: &[u8], format: image::ImageFormat) -> Result<Picture, PictureError> {
    let picture =
        image::load_from_memory_with_format(bytes, format).map_err(|cause| PictureError::Damaged { cause })?;
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let samples = match picture {
        DynamicImage::ImageLuma16(_)
        | DynamicImage::ImageLumaA16(_)
        | DynamicImage::ImageRgb16(_)
        | DynamicImage::ImageRgba16(_) => Samples::Sixteen(bgr_of_rgb(picture.into_rgb16().into_raw())),
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
            Samples::Float(bgr_of_rgb(picture.into_rgb32f().into_raw()))
        }
        _ => Samples::Eight(bgr_of_rgb(picture.into_rgb8().into_raw()).into()),
    };
    Ok(Picture { width, height, samples })
}

/// Decodes a JPEG, or a frame of a Motion JPEG, which may lack the standard Huffman tables.
///
/// # Errors
/// A JPEG that is damaged or not whole.
pub fn decode_jpeg(bytes: &[u8]) -> Result<Picture, PictureError> {
    decode(&jpeg::whole(bytes)?, image::ImageFormat::Jpeg)
}
