//! Maps of numbers: NPY, PFM, TIFF, EXR and PNG.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use exr::prelude::{FlatSamples, MetaData, ReadChannels, ReadLayers};
use image::DynamicImage;
use panoscope_imaging::stereo::{FloatImage, StereoError, formats};
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult};

/// Extensions of the files that [`read`] accepts.
pub const ENDINGS: [&str; 6] = ["npy", "pfm", "tif", "tiff", "exr", "png"];

/// Maximum number of columns or rows.
const MAX_SIDE: usize = 1 << 16;
/// Maximum number of pixels of a map: because a small file can announce many more than it has.
const MAX_PIXELS: usize = 1 << 26;
/// Divisor of KITTI's 16-bit PNG values to pixels.
pub const KITTI_DIVISOR: f32 = 256.0;

/// A file without a valid map.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The file cannot be read.
    #[error("{path}: {cause}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        cause: std::io::Error,
    },
    /// The extension is not that of a map.
    #[error("{path}: maps are read from .npy, .pfm, .tif, .exr and .png files", path = path.display())]
    Ending {
        /// The file.
        path: PathBuf,
    },
    /// The file is damaged or of another kind.
    #[error("{path}: {cause}", path = path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// The mistake in its bytes.
        cause: ContentError,
    },
}

/// A mistake in the bytes of a map.
#[derive(Debug, thiserror::Error)]
pub enum ContentError {
    /// A PFM or NPY that is refused.
    #[error(transparent)]
    Floats(#[from] StereoError),
    /// A TIFF that its decoder refuses.
    #[error("the TIFF is damaged or of an unknown kind: {0}")]
    Tiff(#[from] tiff::TiffError),
    /// A PNG that its decoder refuses.
    #[error("the PNG is damaged: {0}")]
    Png(#[from] image::ImageError),
    /// An EXR that its decoder refuses.
    #[error("the EXR is damaged or of an unknown kind: {0}")]
    Exr(#[from] exr::error::Error),
    /// More pixels than a map may have.
    #[error("its size {width}x{height} exceeds the limit of {MAX_PIXELS} pixels")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// An image in colours.
    #[error("it is a colour image, but a map has one number per pixel")]
    Colour,
    /// Samples that are not a map.
    #[error("its samples are {samples}: use unsigned integers of 8, 16 or 32 bits, or floats")]
    Samples {
        /// The decoder's words.
        samples: String,
    },
    /// No channel of an EXR is a map.
    #[error("its channels are {channels}: name the map's channel Z, Y or depth, or store it alone")]
    Channels {
        /// Names of the channels.
        channels: String,
    },
    /// An image that is not a map of points.
    #[error("it has {channels} number(s) per pixel, but points are three floats per pixel, x, y and z")]
    Points {
        /// Numbers per pixel.
        channels: usize,
    },
    /// Values are missing.
    #[error("it has {found} values, expected {expected}")]
    Short {
        /// Actual number of values.
        found: usize,
        /// Number of values of a complete map.
        expected: usize,
    },
}

/// Storage of a file's numbers, which determines their scale in data sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stored {
    /// Whole numbers of 8 bits.
    EightBits,
    /// Whole numbers of 16 bits in a PNG.
    Png16,
    /// Whole numbers of 16 or 32 bits in a TIFF.
    Whole,
    /// Floats.
    Floats,
}

/// One unscaled number per pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct RawMap {
    /// The numbers.
    pub image: FloatImage,
    /// Storage in the file.
    pub stored: Stored,
}

impl RawMap {
    /// The map with values divided by `divisor`; NaN where the number is not finite and positive.
    pub fn divided(self, divisor: f32) -> FloatImage {
        let known = |v: f32| if v.is_finite() && v > 0.0 { v / divisor } else { f32::NAN };
        FloatImage { data: self.image.data.into_iter().map(known).collect(), ..self.image }
    }

    /// The disparity in px: 16-bit PNG files are divided by 256, as KITTI writes them; others hold px.
    pub fn disparity_divisor(&self) -> f32 {
        if self.stored == Stored::Png16 { KITTI_DIVISOR } else { 1.0 }
    }
}

/// Reads the map of a file; its extension selects the format.
///
/// - NPY of two dimensions, f4 or f8; PFM of one channel
/// - TIFF of 8, 16 or 32 bits without sign, or floats. Of three channels of floats the third one is taken: SCARED's
///   points are x, y and z in mm of the raw left camera, and z is not the depth of the rectified view;
///   [`crate::truth::points`] reads all three and moves them there
/// - EXR: the only channel, or the one called Z, Y, V or depth; or three channels that hold the same
/// - PNG of 8 or 16 bits, gray
///
/// # Errors
/// See [`MapError`]; each names the file.
pub fn read(path: &Path) -> Result<RawMap, MapError> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    if !ENDINGS.contains(&ending.as_str()) {
        return Err(MapError::Ending { path: path.to_owned() });
    }
    let bytes = std::fs::read(path).map_err(|cause| MapError::Read { path: path.to_owned(), cause })?;
    decode(&ending, &bytes).map_err(|cause| MapError::Content { path: path.to_owned(), cause })
}

/// Decodes a map in memory; `ending` is one of [`ENDINGS`].
///
/// # Errors
/// The bytes are malformed.
pub fn decode(ending: &str, bytes: &[u8]) -> Result<RawMap, ContentError> {
    let floats = |image| Ok(RawMap { image, stored: Stored::Floats });
    match ending {
        "pfm" => floats(formats::read_pfm(bytes)?),
        "npy" => floats(formats::read_npy(bytes)?),
        "exr" => floats(exr_map(bytes)?),
        "png" => png(bytes),
        _ => tiff_map(bytes),
    }
}

/// Number of pixels of a size that a map may have.
fn pixels(width: usize, height: usize) -> Result<usize, ContentError> {
    let is_large = width > MAX_SIDE || height > MAX_SIDE || width * height > MAX_PIXELS;
    if is_large || width * height == 0 { Err(ContentError::Size { width, height }) } else { Ok(width * height) }
}

fn png(bytes: &[u8]) -> Result<RawMap, ContentError> {
    let mut reader = image::ImageReader::with_format(Cursor::new(bytes), image::ImageFormat::Png);
    reader.limits(image::Limits::default());
    let picture = reader.decode()?;
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    pixels(width, height)?;
    // Gray that was stored as colours has the same number in all of them.
    fn gray<T: Copy + PartialEq + Into<f32>>(values: &[T], channels: usize) -> Result<Vec<f32>, ContentError> {
        let colours = if channels > 2 { 3 } else { 1 };
        if values.chunks_exact(channels).any(|pixel| pixel[..colours].iter().any(|v| *v != pixel[0])) {
            return Err(ContentError::Colour);
        }
        Ok(values.chunks_exact(channels).map(|pixel| pixel[0].into()).collect())
    }
    let channels = usize::from(picture.color().channel_count());
    let (data, stored) = match &picture {
        DynamicImage::ImageLuma8(_)
        | DynamicImage::ImageLumaA8(_)
        | DynamicImage::ImageRgb8(_)
        | DynamicImage::ImageRgba8(_) => (gray(picture.as_bytes(), channels)?, Stored::EightBits),
        DynamicImage::ImageLuma16(image) => (gray(image.as_raw(), channels)?, Stored::Png16),
        DynamicImage::ImageLumaA16(image) => (gray(image.as_raw(), channels)?, Stored::Png16),
        DynamicImage::ImageRgb16(image) => (gray(image.as_raw(), channels)?, Stored::Png16),
        DynamicImage::ImageRgba16(image) => (gray(image.as_raw(), channels)?, Stored::Png16),
        other => return Err(ContentError::Samples { samples: format!("{:?}", other.color()) }),
    };
    Ok(RawMap { image: FloatImage { width, height, data }, stored })
}

/// All numbers of a TIFF.
pub(crate) struct TiffValues {
    pub width: usize,
    pub height: usize,
    /// Numbers per pixel: 1 or 3.
    pub channels: usize,
    /// All values, pixel after pixel.
    pub data: Vec<f32>,
    pub stored: Stored,
}

pub(crate) fn tiff_values(bytes: &[u8]) -> Result<TiffValues, ContentError> {
    let mut decoder = Decoder::new(Cursor::new(bytes))?;
    let (width, height) = decoder.dimensions()?;
    let (width, height) = (width as usize, height as usize);
    let count = pixels(width, height)?;
    let color = decoder.colortype()?;
    let channels = match color {
        ColorType::Gray(_) => 1,
        ColorType::RGB(_) => 3,
        ColorType::Multiband { num_samples, .. } if matches!(num_samples, 1 | 3) => usize::from(num_samples),
        other => return Err(ContentError::Samples { samples: format!("{other:?}") }),
    };
    let (mut data, stored): (Vec<f32>, Stored) = match decoder.read_image()? {
        DecodingResult::F32(values) => (values, Stored::Floats),
        DecodingResult::F64(values) => (values.into_iter().map(|v| v as f32).collect(), Stored::Floats),
        DecodingResult::F16(values) => (values.into_iter().map(f32::from).collect(), Stored::Floats),
        DecodingResult::U8(values) => (values.into_iter().map(f32::from).collect(), Stored::EightBits),
        DecodingResult::U16(values) => (values.into_iter().map(f32::from).collect(), Stored::Whole),
        DecodingResult::U32(values) => (values.into_iter().map(|v| v as f32).collect(), Stored::Whole),
        _ => return Err(ContentError::Samples { samples: format!("{color:?}") }),
    };
    if channels == 3 && stored != Stored::Floats {
        return Err(ContentError::Colour);
    }
    if data.len() < count * channels {
        return Err(ContentError::Short { found: data.len(), expected: count * channels });
    }
    data.truncate(count * channels);
    Ok(TiffValues { width, height, channels, data, stored })
}

fn tiff_map(bytes: &[u8]) -> Result<RawMap, ContentError> {
    let TiffValues { width, height, channels, data, stored } = tiff_values(bytes)?;
    let data = match channels {
        3 => data.as_chunks::<3>().0.iter().map(|point| point[2]).collect(),
        _ => data,
    };
    Ok(RawMap { image: FloatImage { width, height, data }, stored })
}

fn exr_map(bytes: &[u8]) -> Result<FloatImage, ContentError> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false)?;
    for header in &meta.headers {
        pixels(header.layer_size.0, header.layer_size.1)?;
    }
    let reader = exr::prelude::read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
    let picture = reader.all_attributes().non_parallel().from_buffered(Cursor::new(bytes))?;
    let layer = picture.layer_data;
    let (width, height) = (layer.size.0, layer.size.1);
    let count = pixels(width, height)?;
    let channels = &layer.channel_data.list;
    let all = || channels.iter().map(|c| c.name.to_string());
    let last = |name: &str| name.rsplit('.').next().unwrap_or(name).to_ascii_lowercase();
    let named = channels.iter().find(|c| ["z", "y", "v", "depth"].contains(&last(&c.name.to_string()).as_str()));
    let values = |samples: &FlatSamples| -> Vec<f32> { samples.values_as_f32().collect() };
    // Gray that was stored as colours has the same number in all of them; transparency is not a number of the map.
    let mut opaque = channels.iter().filter(|c| channels.len() == 1 || last(&c.name.to_string()) != "a");
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let data = match (named, opaque.next()) {
        (Some(channel), _) => values(&channel.sample_data),
        (None, Some(first)) => {
            let data = values(&first.sample_data);
            if !opaque.all(|c| bits(&values(&c.sample_data)) == bits(&data)) {
                return Err(ContentError::Channels { channels: all().collect::<Vec<_>>().join(", ") });
            }
            data
        }
        (None, None) => return Err(ContentError::Channels { channels: "none".to_owned() }),
    };
    if data.len() != count {
        return Err(ContentError::Short { found: data.len(), expected: count });
    }
    Ok(FloatImage { width, height, data })
}

#[cfg(test)]
mod tests;
