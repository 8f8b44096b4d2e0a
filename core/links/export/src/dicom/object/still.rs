//! A still as Secondary Capture (PS3.3, A.8.1): uncompressed pixels, or the unchanged bytes of a baseline JPEG.

use std::io::Write;
use std::path::Path;

use dicom_core::VR;
use dicom_dictionary_std::tags;
use image::{DynamicImage, ImageReader};
use sha2::{Digest, Sha256};

use super::{Identity, Study, jpeg, number_in_name};
use crate::dicom::element::{Set, number, text};
use crate::dicom::error::{DicomError, Result};
use crate::dicom::part10::{EXPLICIT, Pending, write};
use crate::dicom::time::Moment;

/// SOP class UID of Secondary Capture Image Storage.
pub const CLASS: &str = "1.2.840.10008.5.1.4.1.1.7";
/// Transfer syntax UID of JPEG baseline, process 1.
const JPEG_BASELINE: &str = "1.2.840.10008.1.2.4.50";
/// Number of the series of stills.
pub(super) const SERIES: (u32, &str) = (1, "Stills");
/// Maximum number of bytes of an image file.
const MAX_FILE_BYTES: u64 = 256 << 20;
/// Maximum number of pixels of an image.
const MAX_PIXELS: u64 = 1 << 26;

/// Pixels of a still.
enum Pixels {
    /// 8 bit, 1 or 3 samples a pixel, row by row.
    Plain(u16, Vec<u8>),
    /// A baseline JPEG with its photometric interpretation, and the ratio of compression.
    Jpeg(u16, &'static str, Vec<u8>),
}

/// A decoded image file.
pub struct Still {
    size: (u16, u16),
    pixels: Pixels,
    sha256: [u8; 32],
    moment: Moment,
    number: Option<u32>,
}

impl Still {
    /// Reads a PNG, JPEG or TIFF file of 8 bits.
    ///
    /// # Errors
    /// It cannot be read, or is not such an image.
    pub fn open(file: &Path) -> Result<Self> {
        let wrong = |problem: String| DicomError::Input { file: file.to_owned(), problem };
        let failed = |cause| DicomError::Read { file: file.to_owned(), cause };
        let about = std::fs::metadata(file).map_err(failed)?;
        if about.len() > MAX_FILE_BYTES {
            return Err(wrong(format!("{} bytes exceed the limit of {MAX_FILE_BYTES}", about.len())));
        }
        let bytes = std::fs::read(file).map_err(failed)?;
        let sha256: [u8; 32] = Sha256::digest(&bytes).into();
        let moment = Moment::of(about.modified().map_err(failed)?);
        let (size, pixels) = pixels(bytes).map_err(|error| wrong(error.to_string()))?;
        Ok(Self { size, pixels, sha256, moment, number: number_in_name(file) })
    }

    /// Width and height, px.
    pub fn size(&self) -> (u16, u16) {
        self.size
    }

    /// SOP class and instance UID within a study.
    pub fn reference(&self, study: &Study<'_>) -> (&'static str, String) {
        (CLASS, study.instance(CLASS, &self.sha256))
    }

    /// Writes it as an object into `folder`; `number` is used if the file's name has none.
    pub(crate) fn write(&self, study: &Study<'_>, number: u32, folder: &Path) -> Result<Pending> {
        let object = self.object(study, number);
        match &self.pixels {
            Pixels::Plain(_, pixels) => write(folder, &object, EXPLICIT, |out| pixel_data(out, pixels)),
            Pixels::Jpeg(.., bytes) => write(folder, &object, JPEG_BASELINE, |out| {
                encapsulated_head(out, bytes.len() as u64)?;
                out.write_all(bytes)?;
                encapsulated_end(out, bytes.len() as u64)
            }),
        }
    }

    fn object(&self, study: &Study<'_>, else_number: u32) -> Set {
        let (class, instance) = self.reference(study);
        let mut object = study.image(&Identity {
            class,
            instance,
            modality: "ES",
            series: SERIES,
            number: self.number.unwrap_or(else_number),
            moment: self.moment.clone(),
        });
        let (samples, photometric) = match &self.pixels {
            Pixels::Plain(1, _) => (1, "MONOCHROME2"),
            Pixels::Plain(..) => (3, "RGB"),
            Pixels::Jpeg(samples, photometric, _) => (*samples, *photometric),
        };
        object.put(text(tags::CONVERSION_TYPE, VR::CS, "WSD"));
        object.put(text(tags::IMAGE_TYPE, VR::CS, "DERIVED\\SECONDARY"));
        pixel_description(&mut object, self.size, samples, photometric);
        if let Pixels::Jpeg(_, _, bytes) = &self.pixels {
            let plain = f64::from(self.size.0) * f64::from(self.size.1) * f64::from(samples);
            lossy(&mut object, "ISO_10918_1", plain / bytes.len() as f64);
        }
        object
    }
}

/// Size and form of 8-bit pixels.
pub(super) fn pixel_description(object: &mut Set, (width, height): (u16, u16), samples: u16, photometric: &str) {
    object.put(number(tags::SAMPLES_PER_PIXEL, samples));
    object.put(text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, photometric));
    if samples > 1 {
        object.put(number(tags::PLANAR_CONFIGURATION, 0));
    }
    object.put(number(tags::ROWS, height));
    object.put(number(tags::COLUMNS, width));
    object.put(number(tags::BITS_ALLOCATED, 8));
    object.put(number(tags::BITS_STORED, 8));
    object.put(number(tags::HIGH_BIT, 7));
    object.put(number(tags::PIXEL_REPRESENTATION, 0));
}

/// Marks pixels as compressed with losses.
pub(super) fn lossy(object: &mut Set, method: &str, ratio: f64) {
    object.put(text(tags::LOSSY_IMAGE_COMPRESSION, VR::CS, "01"));
    object.put(text(tags::LOSSY_IMAGE_COMPRESSION_RATIO, VR::DS, format!("{ratio:.2}")));
    object.put(text(tags::LOSSY_IMAGE_COMPRESSION_METHOD, VR::CS, method));
}

const PIXEL_DATA: [u8; 4] = [0xE0, 0x7F, 0x10, 0x00];
const ITEM: [u8; 4] = [0xFE, 0xFF, 0x00, 0xE0];

/// Writes the element of uncompressed pixels, explicit VR.
fn pixel_data(out: &mut dyn Write, pixels: &[u8]) -> std::io::Result<()> {
    let length = u32::try_from(pixels.len() + pixels.len() % 2).map_err(std::io::Error::other)?;
    out.write_all(&PIXEL_DATA)?;
    out.write_all(b"OB\0\0")?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(pixels)?;
    out.write_all(&[0][..pixels.len() % 2])
}

/// Writes the start of compressed pixels in one fragment of `length` bytes, which follow: an empty offset table and the
/// head of the fragment.
pub(super) fn encapsulated_head(out: &mut dyn Write, length: u64) -> std::io::Result<()> {
    let length = u32::try_from(length + length % 2).map_err(std::io::Error::other)?;
    out.write_all(&PIXEL_DATA)?;
    out.write_all(b"OB\0\0\xFF\xFF\xFF\xFF")?;
    out.write_all(&ITEM)?;
    out.write_all(&[0; 4])?;
    out.write_all(&ITEM)?;
    out.write_all(&length.to_le_bytes())
}

/// Writes the end of a fragment of `length` bytes: padding and the end of the sequence.
pub(super) fn encapsulated_end(out: &mut dyn Write, length: u64) -> std::io::Result<()> {
    out.write_all(&[0][..(length % 2) as usize])?;
    out.write_all(&[0xFE, 0xFF, 0xDD, 0xE0, 0, 0, 0, 0])
}

/// An image that cannot become a still.
#[derive(Debug, thiserror::Error)]
enum StillError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// It cannot be decoded.
    #[error(transparent)]
    Decode(#[from] image::ImageError),
    /// A truncated JPEG.
    #[error("the JPEG is truncated: its end is missing")]
    CutOff,
    /// It is empty or too large.
    #[error("{width} x {height} px; DICOM holds at most 65535 in each direction")]
    Size { width: u32, height: u32 },
    /// Its pixels are of another kind.
    #[error("its pixels are {color:?}; stills must have 8 bits, gray or RGB")]
    Color { color: image::ColorType },
}

fn pixels(bytes: Vec<u8>) -> Result<((u16, u16), Pixels), StillError> {
    if let Some(found) = jpeg::parse(&bytes).filter(|found| found.is_baseline && found.size.0 > 0 && found.size.1 > 0) {
        if !found.is_whole {
            return Err(StillError::CutOff);
        }
        let photometric = match (found.components, found.is_rgb) {
            (1, _) => Some("MONOCHROME2"),
            (3, true) => Some("RGB"),
            // The name of YCbCr that the standard has for JPEG, whatever the sampling of chroma (PS3.5, 8.2.1).
            (3, false) if found.sampling == 0x11 => Some("YBR_FULL"),
            (3, false) => Some("YBR_FULL_422"),
            _ => None,
        };
        if let Some(photometric) = photometric {
            return Ok((found.size, Pixels::Jpeg(u16::from(found.components), photometric, bytes)));
        }
    }
    let mut reader = ImageReader::new(std::io::Cursor::new(&bytes)).with_guessed_format()?;
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MAX_PIXELS * 8);
    reader.limits(limits);
    let picture = reader.decode()?;
    let size = |width: u32, height: u32| match (u16::try_from(width), u16::try_from(height)) {
        (Ok(width), Ok(height)) if width > 0 && height > 0 => Ok((width, height)),
        _ => Err(StillError::Size { width, height }),
    };
    let size = size(picture.width(), picture.height())?;
    let (samples, pixels) = match picture {
        DynamicImage::ImageLuma8(gray) => (1, gray.into_raw()),
        DynamicImage::ImageRgb8(rgb) => (3, rgb.into_raw()),
        DynamicImage::ImageRgba8(_) => (3, picture.into_rgb8().into_raw()),
        other => return Err(StillError::Color { color: other.color() }),
    };
    Ok((size, Pixels::Plain(samples, pixels)))
}
