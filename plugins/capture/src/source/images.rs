//! Image files, read one by one or kept when they are shown again.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use image::DynamicImage;
use opencv::core::{CV_8U, CV_16U, CV_32F, CV_64F, Mat, Scalar, Vector};
use opencv::imgcodecs;
use opencv::prelude::*;

use super::picture::{Picture, Samples};
use super::{CaptureError, Grab, jpeg};

/// Decoded images that are kept because they are shown again, in bytes; beyond that files are read again.
const KEPT_BYTES: usize = 256 << 20;
/// Files that are looked at to find how deep the pictures of a series are.
const PROBES: usize = 5;

/// Image files in order.
pub struct Images {
    files: Vec<PathBuf>,
    /// One file, shown as long as others have pictures.
    still: bool,
    next: usize,
    grabbed: usize,
    kept: Vec<Option<Picture>>,
    kept_bytes: usize,
}

impl Images {
    /// `files` in order; `keep` keeps what was decoded.
    pub fn new(files: Vec<PathBuf>, keep: bool) -> Self {
        let kept = if keep { vec![None; files.len()] } else { Vec::new() };
        Self { files, still: false, next: 0, grabbed: 0, kept, kept_bytes: 0 }
    }

    /// One file again and again.
    pub fn still(file: PathBuf) -> Self {
        Self { still: true, ..Self::new(vec![file], true) }
    }

    /// Whether it is one file that has no end of its own.
    pub fn is_still(&self) -> bool {
        self.still
    }

    /// Pictures that have been stepped over: the number of the next one.
    pub fn grabbed(&self) -> u64 {
        self.next as u64
    }

    /// Pictures that are left.
    pub fn left(&self) -> u64 {
        self.files.len().saturating_sub(self.next) as u64
    }

    /// Steps to the next file.
    pub fn grab(&mut self) -> Grab {
        if self.still {
            self.next = 0;
        }
        if self.next >= self.files.len() {
            return Grab::End;
        }
        self.grabbed = self.next;
        self.next += 1;
        Grab::Ready(Instant::now())
    }

    /// The file that comes next, to go on there; `None` at the end.
    pub fn next_file(&self) -> Option<&Path> {
        self.files.get(self.next).map(PathBuf::as_path)
    }

    /// Goes on at `file`, or at number `next` when there is no such file any more.
    pub fn go_to(&mut self, file: Option<&Path>, next: u64) {
        let here = file.and_then(|file| self.files.iter().position(|path| path == file));
        self.next = here.unwrap_or(usize::try_from(next).unwrap_or(usize::MAX)).min(self.files.len());
    }

    /// Reads the file that was grabbed.
    ///
    /// # Errors
    /// [`CaptureError::Unreadable`] with the file's name and number.
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        if let Some(Some(kept)) = self.kept.get(self.grabbed) {
            out.clone_from(kept);
            return Ok(());
        }
        let Some(path) = self.files.get(self.grabbed) else { return Ok(()) };
        let count = self.files.len();
        *out = read(path).map_err(|reason| CaptureError::Unreadable {
            path: path.clone(),
            place: if count > 1 { format!(" (picture {} of {count})", self.grabbed + 1) } else { String::new() },
            reason,
        })?;
        if let Some(slot) = self.kept.get_mut(self.grabbed)
            && self.kept_bytes + out.bytes() <= KEPT_BYTES
        {
            self.kept_bytes += out.bytes();
            *slot = Some(out.clone());
        }
        Ok(())
    }

    /// The largest values of a few pictures spread over the series; pictures of eight bits and damaged ones tell none.
    pub fn peaks(&self) -> Vec<f32> {
        let count = self.files.len();
        let probes = count.min(PROBES);
        let files = (0..probes).filter_map(|probe| self.files.get((2 * probe + 1) * count / (2 * probes)));
        files.filter_map(|path| read(path).ok()?.peak()).collect()
    }
}

/// Reads an image file as BGR. A file that ends too early is an error, never a picture with old or gray parts.
///
/// # Errors
/// Why it is no picture.
pub fn read(path: &Path) -> Result<Picture, String> {
    let bytes = fs::read(path).map_err(|error| error.to_string())?;
    if bytes.is_empty() {
        return Err("the file is empty".into());
    }
    match image::guess_format(&bytes) {
        Ok(image::ImageFormat::Jpeg) => jpeg::decode(&bytes),
        Ok(format @ image::ImageFormat::Png) => decode(&bytes, format),
        _ => decode_opencv(&bytes),
    }
}

/// Decodes a PNG or a JPEG that is known to be whole.
pub(super) fn decode(bytes: &[u8], format: image::ImageFormat) -> Result<Picture, String> {
    let picture =
        image::load_from_memory_with_format(bytes, format).map_err(|error| format!("the image is damaged: {error}"))?;
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

fn bgr_of_rgb<T>(mut values: Vec<T>) -> Vec<T> {
    for pixel in values.as_chunks_mut::<3>().0 {
        pixel.swap(0, 2);
    }
    values
}

/// Decodes what only OpenCV knows. It leaves the memory of damaged areas as it was: the picture is decoded twice onto different
/// grounds, and where these show through it is damaged.
fn decode_opencv(bytes: &[u8]) -> Result<Picture, String> {
    const UNKNOWN: &str = "the file is no image that OpenCV knows, or it is damaged";
    let words = |error: opencv::Error| error.message;
    let buffer = Vector::<u8>::from_slice(bytes);
    let flags = imgcodecs::IMREAD_UNCHANGED;
    let first = imgcodecs::imdecode(&buffer, flags).map_err(words)?;
    let mut out = Picture::default();
    copy_mat(&first, &mut out).map_err(words)?;
    if out.bytes() == 0 {
        return Err(UNKNOWN.to_owned());
    }
    for ground in [0.0, 77.0] {
        let mut again = Mat::new_rows_cols_with_default(first.rows(), first.cols(), first.typ(), Scalar::all(ground))
            .map_err(words)?;
        imgcodecs::imdecode_to(&buffer, flags, &mut again).map_err(words)?;
        if again.empty() {
            return Err(UNKNOWN.to_owned());
        }
        // Bytes and not values: NaN is equal to itself here.
        if again.data_bytes().map_err(words)? != first.data_bytes().map_err(words)? {
            return Err("the image is damaged: parts of it cannot be decoded".to_owned());
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
    // SAFETY: every bit pattern is a value of the three number types that this is called for; what is not aligned is cut off, which
    // OpenCV's buffers (aligned to 64 bytes) never are.
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
