//! Decodes PNG, EXR and JPEG in memory.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageError, ImageReader, Limits};
use panoscope_media::input::jpeg;

use super::error::PictureError;
use super::picture::{Picture, Samples};
use super::plain::bgr_of_rgb;

/// Decodes a PNG or an EXR, or a JPEG that is known to be complete.
///
/// # Errors
/// The image is damaged.
pub fn decode(bytes: &[u8], format: image::ImageFormat) -> Result<Picture, PictureError> {
    let decoded = || {
        let mut decoder = ImageReader::with_format(Cursor::new(bytes), format).into_decoder()?;
        let mut limits = Limits::default();
        limits.reserve(decoder.total_bytes())?;
        decoder.set_limits(limits)?;
        // A tag that cannot be read turns nothing.
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        Ok((DynamicImage::from_decoder(decoder)?, orientation))
    };
    let (picture, orientation) = decoded().map_err(|cause| match cause {
        ImageError::Limits(_) => {
            let size = ImageReader::with_format(Cursor::new(bytes), format).into_dimensions();
            size.map_or_else(
                |cause| PictureError::Damaged { cause },
                |(width, height)| PictureError::TooLarge { width, height },
            )
        }
        cause => PictureError::Damaged { cause },
    })?;
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
    Ok(Picture { orientation, ..Picture::new((width, height), samples) })
}

/// Decodes a JPEG, or a frame of a Motion JPEG, which may lack the standard Huffman tables.
///
/// # Errors
/// The JPEG is damaged or truncated.
pub fn decode_jpeg(bytes: &[u8]) -> Result<Picture, PictureError> {
    decode(&jpeg::whole(bytes)?, image::ImageFormat::Jpeg)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Makes a chunk of a PNG.
    fn chunk(name: &[u8; 4], data: &[u8]) -> Vec<u8> {
        let body = [&name[..], data].concat();
        let crc = !body.iter().fold(!0_u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 })
        });
        [&(data.len() as u32).to_be_bytes()[..], &body, &crc.to_be_bytes()].concat()
    }

    #[test]
    fn an_image_that_is_too_large_is_not_called_damaged() {
        let size = 30_000_u32.to_be_bytes();
        let head = chunk(b"IHDR", &[&size[..], &size, &[8, 2, 0, 0, 0]].concat());
        let bytes =
            [&b"\x89PNG\r\n\x1a\n"[..], &head, &chunk(b"IDAT", &[0x78, 0x9C, 1]), &chunk(b"IEND", &[])].concat();
        let error = decode(&bytes, image::ImageFormat::Png).expect_err("2.7 GB").to_string();
        assert!(error.contains("30000x30000 px") && error.contains("512 MiB"), "{error}");
    }
}
