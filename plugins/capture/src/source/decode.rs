//! Decodes image files and matrices to pictures.

use std::fs;
use std::path::Path;

use image::DynamicImage;
use opencv::core::{CV_8U, CV_16U, CV_32F, CV_64F, Mat, Scalar, Vector};
use opencv::imgcodecs;
use opencv::prelude::*;

use super::error::PictureError;
use super::jpeg;
use super::picture::{Picture, Samples};

/// Reads an image file as BGR. A file that ends too early is an error, never a picture with old or gray parts.
///
/// # Errors
/// What is wrong with the file.
pub fn read(path: &Path) -> Result<Picture, PictureError> {
    let bytes = fs::read(path).map_err(|cause| PictureError::Read { cause })?;
    if bytes.is_empty() {
        return Err(PictureError::Empty);
    }
    match image::guess_format(&bytes) {
        Ok(image::ImageFormat::Jpeg) => decode_jpeg(&bytes),
        Ok(format @ image::ImageFormat::Png) => decode(&bytes, format),
        _ => decode_opencv(&bytes),
    }
}

/// Decodes a PNG, or a JPEG that is known to be whole.
pub fn decode(bytes: &[u8], format: image::ImageFormat) -> Result<Picture, PictureError> {
    let picture =
        image::load_from_memory_with_format(bytes, format).map_err(|cause| PictureError::Damaged { cause })?;
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let is_deep = matches!(
        picture,
        DynamicImage::ImageLuma16(_)
            | DynamicImage::ImageLumaA16(_)
            | DynamicImage::ImageRgb16(_)
            | DynamicImage::ImageRgba16(_)
    );
    let samples = if is_deep {
        Samples::Sixteen(bgr_of_rgb(picture.into_rgb16().into_raw()))
    } else {
        Samples::Eight(bgr_of_rgb(picture.into_rgb8().into_raw()))
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

fn bgr_of_rgb<T>(mut values: Vec<T>) -> Vec<T> {
    for pixel in values.as_chunks_mut::<3>().0 {
        pixel.swap(0, 2);
    }
    values
}

/// Decodes formats that only OpenCV knows. OpenCV leaves the memory of damaged areas unchanged, so the picture is decoded twice onto different
/// backgrounds: where a background shows, the picture is damaged.
fn decode_opencv(bytes: &[u8]) -> Result<Picture, PictureError> {
    let buffer = Vector::<u8>::from_slice(bytes);
    let flags = imgcodecs::IMREAD_UNCHANGED;
    let first = imgcodecs::imdecode(&buffer, flags)?;
    let mut out = Picture::default();
    copy_mat(&first, &mut out)?;
    if out.bytes() == 0 {
        return Err(PictureError::Unknown);
    }
    for background in [0.0, 77.0] {
        let mut again =
            Mat::new_rows_cols_with_default(first.rows(), first.cols(), first.typ(), Scalar::all(background))?;
        imgcodecs::imdecode_to(&buffer, flags, &mut again)?;
        if again.empty() {
            return Err(PictureError::Unknown);
        }
        // Bytes and not values: NaN is equal to itself here.
        if again.data_bytes()? != first.data_bytes()? {
            return Err(PictureError::Incomplete);
        }
    }
    Ok(out)
}

/// Copies a gray, BGR or BGRA matrix of 8 or 16 bits or floats.
///
/// # Errors
/// OpenCV's; a matrix of another type.
pub fn copy_mat(mat: &Mat, out: &mut Picture) -> opencv::Result<()> {
    out.clear();
    let (width, height) = (mat.cols().max(0) as usize, mat.rows().max(0) as usize);
    if width == 0 || height == 0 {
        return Ok(());
    }
    let channels = mat.channels();
    let unsupported = |message: String| opencv::Error::new(opencv::core::StsUnsupportedFormat, message);
    if !matches!(channels, 1 | 3 | 4) {
        return Err(unsupported(format!("{channels} channels are no picture: convert it to gray or colour")));
    }
    let whole;
    let mat = if mat.is_continuous() {
        mat
    } else {
        whole = mat.try_clone()?;
        &whole
    };
    match mat.depth() {
        CV_8U => {
            let bytes = mat.data_bytes()?;
            if let Samples::Eight(bgr) = &mut out.samples {
                bgr_of(bytes, channels, bgr);
            }
        }
        CV_16U => out.samples = Samples::Sixteen(collected(values::<u16>(mat)?, channels)),
        CV_32F => out.samples = Samples::Float(collected(values::<f32>(mat)?, channels)),
        CV_64F => {
            let values: Vec<f32> = values::<f64>(mat)?.iter().map(|value| *value as f32).collect();
            out.samples = Samples::Float(collected(&values, channels));
        }
        depth => {
            let kind = ["", "signed 8-bit", "", "signed 16-bit", "signed 32-bit", "", "", "16-bit floating"];
            let kind = usize::try_from(depth).ok().and_then(|depth| kind.get(depth)).copied().unwrap_or("unknown");
            return Err(unsupported(format!(
                "its {kind} values are not supported: convert it to 8 or 16 bits without sign, or to 32-bit floats"
            )));
        }
    }
    (out.width, out.height) = (width, height);
    Ok(())
}

/// The values of a continuous matrix of any number of channels.
fn values<T: Copy>(mat: &Mat) -> opencv::Result<&[T]> {
    let bytes = mat.data_bytes()?;
    // SAFETY: `copy_mat` calls this for `u16`, `f32` and `f64` only, of which every bit pattern is a value. `align_to` returns unaligned bytes
    // apart; OpenCV's buffers are aligned to 64 bytes, and the check below refuses any other.
    let (head, values, _) = unsafe { bytes.align_to::<T>() };
    if head.is_empty() {
        Ok(values)
    } else {
        Err(opencv::Error::new(opencv::core::StsError, "a matrix that is not aligned"))
    }
}

fn collected<T: Copy>(values: &[T], channels: i32) -> Vec<T> {
    let mut bgr = Vec::new();
    bgr_of(values, channels, &mut bgr);
    bgr
}

fn bgr_of<T: Copy>(values: &[T], channels: i32, bgr: &mut Vec<T>) {
    match channels {
        3 => bgr.extend_from_slice(values),
        1 => bgr.extend(values.iter().flat_map(|&gray| [gray; 3])),
        _ => bgr.extend(values.as_chunks::<4>().0.iter().flat_map(|&[blue, green, red, _]| [blue, green, red])),
    }
}
