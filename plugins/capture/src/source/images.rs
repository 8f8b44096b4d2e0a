//! Image files, read one by one or kept when they are shown again.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use opencv::core::{Mat, Vector};
use opencv::imgcodecs;
use opencv::prelude::*;

use super::{CaptureError, Grab, Picture};

/// Decoded images that a loop keeps, in bytes; beyond that files are read again.
const KEPT_BYTES: usize = 256 << 20;

/// Image files in order.
pub struct Images {
    files: Vec<PathBuf>,
    looped: bool,
    next: usize,
    grabbed: usize,
    kept: Vec<Option<Picture>>,
    kept_bytes: usize,
}

impl Images {
    /// `files` in order, from the start again when `looped`.
    pub fn new(files: Vec<PathBuf>, looped: bool) -> Self {
        let kept = if looped { vec![None; files.len()] } else { Vec::new() };
        Self { files, looped, next: 0, grabbed: 0, kept, kept_bytes: 0 }
    }

    /// One file again and again.
    pub fn repeated(file: PathBuf) -> Self {
        Self::new(vec![file], true)
    }

    /// Steps to the next file.
    pub fn grab(&mut self) -> Grab {
        if self.next == self.files.len() {
            if !self.looped {
                return Grab::End;
            }
            self.next = 0;
        }
        self.grabbed = self.next;
        self.next += 1;
        Grab::Ready(Instant::now())
    }

    /// Reads the file that was grabbed.
    ///
    /// # Errors
    /// [`CaptureError::Unreadable`] with the file's name.
    pub fn retrieve(&mut self, out: &mut Picture) -> Result<(), CaptureError> {
        if let Some(Some(kept)) = self.kept.get(self.grabbed) {
            (out.width, out.height) = (kept.width, kept.height);
            out.bgr.clone_from(&kept.bgr);
            return Ok(());
        }
        let Some(path) = self.files.get(self.grabbed) else { return Ok(()) };
        *out = read(path)?;
        if let Some(slot) = self.kept.get_mut(self.grabbed)
            && self.kept_bytes + out.bgr.len() <= KEPT_BYTES
        {
            self.kept_bytes += out.bgr.len();
            *slot = Some(out.clone());
        }
        Ok(())
    }
}

/// Reads an image file as BGR. A file that ends too early is an error, never a picture with old or gray parts.
///
/// # Errors
/// [`CaptureError::Unreadable`].
pub fn read(path: &Path) -> Result<Picture, CaptureError> {
    let unreadable = |reason: String| CaptureError::Unreadable { path: path.to_owned(), reason };
    let bytes = fs::read(path).map_err(|error| unreadable(error.to_string()))?;
    if bytes.is_empty() {
        return Err(unreadable("the file is empty".into()));
    }
    match image::guess_format(&bytes) {
        Ok(image::ImageFormat::Jpeg) => {
            // Decoders fill the rest of a cut-off JPEG with gray: its end marker tells. Some cameras pad behind it.
            if !bytes.windows(2).rev().take(4096).any(|w| w == [0xFF, 0xD9]) {
                return Err(unreadable("the JPEG is cut off: its end is missing".into()));
            }
            decode(&bytes, image::ImageFormat::Jpeg).map_err(unreadable)
        }
        Ok(format @ image::ImageFormat::Png) => decode(&bytes, format).map_err(unreadable),
        _ => decode_opencv(&bytes).map_err(unreadable),
    }
}

fn decode(bytes: &[u8], format: image::ImageFormat) -> Result<Picture, String> {
    let picture = image::load_from_memory_with_format(bytes, format)
        .map_err(|error| format!("the image is damaged: {error}"))?
        .into_rgb8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let mut bgr = picture.into_raw();
    for pixel in bgr.as_chunks_mut::<3>().0 {
        pixel.swap(0, 2);
    }
    Ok(Picture { width, height, bgr })
}

fn decode_opencv(bytes: &[u8]) -> Result<Picture, String> {
    let buffer = Vector::<u8>::from_slice(bytes);
    let mat = imgcodecs::imdecode(&buffer, imgcodecs::IMREAD_COLOR).map_err(|error| error.message)?;
    let mut out = Picture::default();
    copy_mat(&mat, &mut out).map_err(|error| error.message)?;
    if out.bgr.is_empty() {
        return Err("the file is no image that OpenCV knows, or it is damaged".into());
    }
    Ok(out)
}

/// Copies an 8-bit gray, BGR or BGRA matrix.
///
/// # Errors
/// OpenCV's; a matrix of another type.
pub fn copy_mat(mat: &Mat, out: &mut Picture) -> opencv::Result<()> {
    (out.width, out.height) = (mat.cols().max(0) as usize, mat.rows().max(0) as usize);
    out.bgr.clear();
    if out.width == 0 || out.height == 0 {
        return Ok(());
    }
    let channels = mat.channels();
    if mat.depth() != opencv::core::CV_8U || !matches!(channels, 1 | 3 | 4) {
        let message = format!("{channels} channels of depth {} are no picture", mat.depth());
        return Err(opencv::Error::new(opencv::core::StsUnsupportedFormat, message));
    }
    let whole;
    let mat = if mat.is_continuous() {
        mat
    } else {
        whole = mat.try_clone()?;
        &whole
    };
    let bytes = mat.data_bytes()?;
    match channels {
        3 => out.bgr.extend_from_slice(bytes),
        1 => out.bgr.extend(bytes.iter().flat_map(|&g| [g, g, g])),
        _ => out.bgr.extend(bytes.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]])),
    }
    Ok(())
}
