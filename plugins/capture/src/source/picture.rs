//! One image as its file or device delivers it, and the conversion of its values to eight bits.

use std::sync::Arc;

use gstreamer_video::VideoFrame;
use gstreamer_video::prelude::*;
use gstreamer_video::video_frame::Readable;
use image::metadata::Orientation;

/// Blue, green, red of every pixel.
#[derive(Clone, Debug)]
pub enum Samples {
    /// 0..=255, row after row without padding. Shared: an image that is shown again is not copied.
    Eight(Arc<Vec<u8>>),
    /// 0..=255, in the decoder's memory.
    Decoded(Arc<VideoFrame<Readable>>),
    /// As in the file; white may be any of 255, 1023, 4095, 16383, 65535. Rows have no padding.
    Sixteen(Vec<u16>),
    /// As in the file; white may be 1.0 or any of the above.
    Float(Vec<f32>),
}

/// An image with its orientation.
#[derive(Debug)]
pub struct Picture {
    /// Columns in px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Its values.
    pub samples: Samples,
    /// Rotation that its metadata asks for.
    pub orientation: Orientation,
}

impl Clone for Picture {
    fn clone(&self) -> Self {
        Self { samples: self.samples.clone(), ..*self }
    }

    /// Reuses the memory of the previous image: the system maps and clears a new block for each allocation of this size.
    fn clone_from(&mut self, source: &Self) {
        (self.width, self.height, self.orientation) = (source.width, source.height, source.orientation);
        match (&mut self.samples, &source.samples) {
            (Samples::Sixteen(own), Samples::Sixteen(new)) => own.clone_from(new),
            (Samples::Float(own), Samples::Float(new)) => own.clone_from(new),
            (own, new) => *own = new.clone(),
        }
    }
}

impl Default for Picture {
    fn default() -> Self {
        Self::new((0, 0), Samples::Eight(Arc::default()))
    }
}

/// Width and height after rotation.
pub fn turned_size((width, height): (usize, usize), orientation: Orientation) -> (usize, usize) {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    match orientation {
        Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH => (height, width),
        _ => (width, height),
    }
}

/// Rotates the pixels of an image of three values per pixel. Returns the size of the result and its pixels.
fn turned<T: Copy>(
    values: &[T],
    (width, height): (usize, usize),
    orientation: Orientation,
) -> ((usize, usize), Vec<T>) {
    use Orientation::{FlipHorizontal, FlipVertical, Rotate90, Rotate90FlipH, Rotate180, Rotate270, Rotate270FlipH};
    let size = turned_size((width, height), orientation);
    let mut out = Vec::with_capacity(values.len());
    for y in 0..size.1 {
        for x in 0..size.0 {
            let (right, down) = (size.0 - 1 - x, size.1 - 1 - y);
            let (column, row) = match orientation {
                Orientation::NoTransforms => (x, y),
                Rotate90 => (y, right),
                Rotate180 => (right, down),
                Rotate270 => (down, x),
                FlipHorizontal => (right, y),
                FlipVertical => (x, down),
                Rotate90FlipH => (y, x),
                Rotate270FlipH => (down, right),
            };
            let start = 3 * (row * width + column);
            out.extend_from_slice(&values[start..start + 3]);
        }
    }
    (size, out)
}

impl Picture {
    /// An image that is shown as stored.
    pub fn new((width, height): (usize, usize), samples: Samples) -> Self {
        Self { width, height, samples, orientation: Orientation::NoTransforms }
    }

    /// Rotates it as its metadata asks for.
    pub fn turn_upright(&mut self) {
        let orientation = std::mem::replace(&mut self.orientation, Orientation::NoTransforms);
        if orientation == Orientation::NoTransforms || self.width * self.height == 0 {
            return;
        }
        let size = (self.width, self.height);
        let mut of_decoder = Vec::new();
        let (size, samples) = match &self.samples {
            Samples::Decoded(_) => {
                of_decoder.resize(3 * size.0 * size.1, 0);
                for (y, row) in of_decoder.chunks_exact_mut(3 * size.0).enumerate() {
                    self.write_row(0, y, 255.0, row);
                }
                let (size, bgr) = turned(&of_decoder, size, orientation);
                (size, Samples::Eight(bgr.into()))
            }
            Samples::Eight(bgr) => {
                let (size, bgr) = turned(bgr, size, orientation);
                (size, Samples::Eight(bgr.into()))
            }
            Samples::Sixteen(bgr) => {
                let (size, bgr) = turned(bgr, size, orientation);
                (size, Samples::Sixteen(bgr))
            }
            Samples::Float(bgr) => {
                let (size, bgr) = turned(bgr, size, orientation);
                (size, Samples::Float(bgr))
            }
        };
        *self = Self::new(size, samples);
    }

    /// Drops the pixels, so that nothing of the previous image is shown after a failure.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Memory in use, bytes.
    pub fn bytes(&self) -> usize {
        match &self.samples {
            Samples::Eight(bgr) => bgr.len(),
            Samples::Decoded(_) => 3 * self.width * self.height,
            Samples::Sixteen(bgr) => 2 * bgr.len(),
            Samples::Float(bgr) => 4 * bgr.len(),
        }
    }

    /// Maximum value of an image of more than eight bits; `None` for one of eight. NaN is ignored.
    pub fn peak(&self) -> Option<f32> {
        match &self.samples {
            Samples::Eight(_) | Samples::Decoded(_) => None,
            Samples::Sixteen(bgr) => Some(f32::from(bgr.iter().copied().max().unwrap_or(0))),
            Samples::Float(bgr) => Some(bgr.iter().copied().fold(0.0, f32::max)),
        }
    }

    /// Whether its values are floats.
    pub fn is_float(&self) -> bool {
        matches!(self.samples, Samples::Float(_))
    }

    /// Writes columns `x..` of row `y` as eight bits. `white` and brighter values become 255.
    pub fn write_row(&self, x: usize, y: usize, white: f32, out: &mut [u8]) {
        let start = (y * self.width + x) * 3;
        let end = start + out.len();
        match &self.samples {
            Samples::Eight(bgr) => out.copy_from_slice(&bgr[start..end]),
            Samples::Decoded(frame) => {
                let first = y * usize::try_from(frame.plane_stride()[0]).unwrap_or(0) + 3 * x;
                // The frame was mapped with this size; see `frames::of_sample`.
                if let Some(row) = frame.plane_data(0).ok().and_then(|plane| plane.get(first..first + out.len())) {
                    out.copy_from_slice(row);
                }
            }
            Samples::Sixteen(bgr) => {
                let scale = 255.0 / white;
                for (out, value) in out.iter_mut().zip(&bgr[start..end]) {
                    // A cast of a float ends at 255.
                    *out = f32::from(*value).mul_add(scale, 0.5) as u8;
                }
            }
            Samples::Float(bgr) => {
                let scale = 255.0 / white;
                for (out, value) in out.iter_mut().zip(&bgr[start..end]) {
                    // It ends at 0 for negative values and NaN, too.
                    *out = value.mul_add(scale, 0.5) as u8;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(picture: &Picture, white: f32) -> Vec<u8> {
        let mut out = vec![0; picture.width * 3];
        picture.write_row(0, 0, white, &mut out);
        out
    }

    #[test]
    fn a_picture_shares_its_bytes_and_keeps_its_memory_for_deeper_values() {
        let mut picture = Picture::default();
        let eight = Picture::new((30, 2), Samples::Eight(Arc::new(vec![7; 180])));
        picture.clone_from(&eight);
        assert_eq!((picture.width, picture.height, picture.bytes()), (30, 2, 180));
        let (Samples::Eight(own), Samples::Eight(shared)) = (&picture.samples, &eight.samples) else {
            panic!("eight bits")
        };
        assert!(Arc::ptr_eq(own, shared), "shown again without a copy");
        let deep = |value: u16, count: usize| Picture::new((count / 3, 1), Samples::Sixteen(vec![value; count]));
        let address = |picture: &Picture| match &picture.samples {
            Samples::Sixteen(bgr) => bgr.as_ptr(),
            _ => panic!("sixteen bits"),
        };
        picture.clone_from(&deep(1, 240));
        let before = address(&picture);
        picture.clone_from(&deep(7, 180));
        assert_eq!((picture.width, address(&picture)), (60, before));
        picture.clear();
        assert_eq!(picture.bytes(), 0);
    }

    /// The eight orientations of EXIF, compared with the rotation of the `image` crate.
    #[test]
    fn pictures_are_turned_as_their_tag_says() {
        let rgb = image::RgbImage::from_fn(3, 2, |x, y| image::Rgb([x as u8, y as u8, (3 * y + x) as u8]));
        for orientation in (1..=8).filter_map(Orientation::from_exif) {
            let mut expected = image::DynamicImage::ImageRgb8(rgb.clone());
            expected.apply_orientation(orientation);
            let mut picture = Picture::new((3, 2), Samples::Eight(Arc::new(rgb.as_raw().clone())));
            picture.orientation = orientation;
            picture.turn_upright();
            let Samples::Eight(turned) = &picture.samples else { panic!("eight bits") };
            assert_eq!((picture.width, picture.height), (expected.width() as usize, expected.height() as usize));
            assert_eq!(turned[..], expected.as_bytes()[..], "{orientation:?}");
        }
    }

    #[test]
    fn values_are_scaled_to_white() {
        let deep = Picture::new((1, 1), Samples::Sixteen(vec![0, 2048, 4095]));
        assert_eq!((deep.peak(), row(&deep, 4095.0)), (Some(4095.0), vec![0, 128, 255]));
        assert_eq!(row(&deep, 1023.0), [0, 255, 255]);
        let float = Picture::new((2, 1), Samples::Float(vec![-1.0, 0.5, 1.0, f32::NAN, 0.25, 0.0]));
        assert_eq!((float.peak(), row(&float, 1.0)), (Some(1.0), vec![0, 128, 255, 0, 64, 0]));
    }
}
