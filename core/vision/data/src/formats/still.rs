//! Encodes images as PNG and JPEG.

use std::io::Write;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::error::{ImageFormatHint, UnsupportedError, UnsupportedErrorKind};
use image::{ExtendedColorType, ImageEncoder, ImageError};

use crate::formats::Pixels;

/// Extensions that [`encode`] knows.
pub const ENDINGS: &str = "png, jpg, jpeg";

/// Encodes `pixels` in the format of `ending`; `work` is reused. JPEG drops alpha.
///
/// # Errors
/// Errors of the encoder; `Unsupported` for pixels that the format cannot hold (f32; 16 bits in JPEG).
pub fn encode(
    out: &mut dyn Write,
    ending: &str,
    pixels: &Pixels<'_>,
    jpeg_quality: u8,
    work: &mut Vec<u8>,
) -> Result<(), ImageError> {
    let jpeg = ending != "png";
    let (width, height) = pixels.size();
    work.clear();
    let color = match pixels {
        Pixels::Gray8(v) => {
            (0..height).for_each(|y| work.extend_from_slice(v.row(y)));
            ExtendedColorType::L8
        }
        Pixels::Bgr8(v) => {
            (0..height).for_each(|y| work.extend(v.row(y).chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]])));
            ExtendedColorType::Rgb8
        }
        Pixels::Rgba8(v) if jpeg => {
            (0..height).for_each(|y| work.extend(v.row(y).chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]])));
            ExtendedColorType::Rgb8
        }
        Pixels::Rgba8(v) => {
            (0..height).for_each(|y| work.extend_from_slice(v.row(y)));
            ExtendedColorType::Rgba8
        }
        // The encoder takes 16-bit samples in the machine's byte order.
        Pixels::Gray16(v) => {
            (0..height).for_each(|y| work.extend(v.row(y).iter().flat_map(|p| p.to_ne_bytes())));
            ExtendedColorType::L16
        }
        Pixels::F32(_) => {
            let kind = UnsupportedErrorKind::Color(ExtendedColorType::Rgb32F);
            let error = UnsupportedError::from_format_and_kind(ImageFormatHint::Unknown, kind);
            return Err(ImageError::Unsupported(error));
        }
    };
    if jpeg {
        JpegEncoder::new_with_quality(out, jpeg_quality).write_image(work, width as u32, height as u32, color)
    } else {
        PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Adaptive).write_image(
            work,
            width as u32,
            height as u32,
            color,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::View;

    #[test]
    fn png_brings_back_the_same_pixels() {
        let bgr: Vec<u8> = (0..4 * 3 * 3).map(|i| (i * 7) as u8).collect();
        let gray16: Vec<u16> = (0..12).map(|i| i * 5000).collect();
        let mut out = Vec::new();
        encode(&mut out, "png", &Pixels::Bgr8(View::new(&bgr, 4, 3, 3)), 90, &mut Vec::new()).unwrap();
        let back = image::load_from_memory(&out).unwrap().into_rgb8();
        assert_eq!(back.dimensions(), (4, 3));
        assert!(back.as_raw().chunks(3).zip(bgr.chunks(3)).all(|(a, b)| a == [b[2], b[1], b[0]]));
        out.clear();
        encode(&mut out, "png", &Pixels::Gray16(View::new(&gray16, 4, 3, 1)), 90, &mut Vec::new()).unwrap();
        assert_eq!(image::load_from_memory(&out).unwrap().into_luma16().as_raw(), &gray16);
    }

    #[test]
    fn floats_are_refused_by_the_encoder() {
        let pixels = Pixels::F32(View::new(&[0.5], 1, 1, 1));
        assert!(encode(&mut Vec::new(), "png", &pixels, 90, &mut Vec::new()).is_err());
    }
}
