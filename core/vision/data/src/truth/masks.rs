//! Images of classes: each pixel has the colour or the number of its class. Their connected parts become boxes.

use std::path::{Path, PathBuf};

/// Maximum number of columns or rows.
const MAX_SIDE: u32 = 1 << 13;

/// A file without valid classes.
#[derive(Debug, thiserror::Error)]
pub enum MaskError {
    /// The file cannot be read.
    #[error("{path}: {cause}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        cause: std::io::Error,
    },
    /// The file is not a PNG, or damaged.
    #[error("{path}: the mask is damaged or not a PNG: {cause}", path = path.display())]
    Picture {
        /// The file.
        path: PathBuf,
        /// The decoder's error.
        cause: image::ImageError,
    },
}

/// Test for the pixels of a class.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Code {
    /// All pixels that are not black.
    Set,
    /// Pixels of one colour: red, green, blue. A number in a gray image is the same in all three.
    Colour([u8; 3]),
}

/// A mask: one colour per pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MaskPicture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue, row after row.
    pub colours: Vec<[u8; 3]>,
}

/// One connected part of a class.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Left, top, width, height in px.
    pub bounds: [usize; 4],
    /// Indices of its pixels, in no order.
    pub pixels: Vec<u32>,
}

impl MaskPicture {
    /// Reads a PNG of gray or colour, 8 or 16 bits; transparent pixels count as black.
    ///
    /// # Errors
    /// See [`MaskError`].
    pub fn read(path: &Path) -> Result<Self, MaskError> {
        let bytes = std::fs::read(path).map_err(|cause| MaskError::Read { path: path.to_owned(), cause })?;
        Self::decode(&bytes).map_err(|cause| MaskError::Picture { path: path.to_owned(), cause })
    }

    /// Decodes a mask in memory.
    ///
    /// # Errors
    /// The bytes are malformed.
    pub fn decode(bytes: &[u8]) -> Result<Self, image::ImageError> {
        let mut reader = image::ImageReader::with_format(std::io::Cursor::new(bytes), image::ImageFormat::Png);
        let mut limits = image::Limits::default();
        (limits.max_image_width, limits.max_image_height) = (Some(MAX_SIDE), Some(MAX_SIDE));
        reader.limits(limits);
        let picture = reader.decode()?.into_rgb8();
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        Ok(Self { width, height, colours: picture.pixels().map(|pixel| pixel.0).collect() })
    }

    /// The part of the mask at `x, y` of `width` x `height`; `None` when it leaves the mask.
    pub fn cropped(&self, [x, y, width, height]: [usize; 4]) -> Option<Self> {
        if x.checked_add(width)? > self.width || y.checked_add(height)? > self.height {
            return None;
        }
        let rows = (y..y + height).flat_map(|row| &self.colours[row * self.width + x..row * self.width + x + width]);
        Some(Self { width, height, colours: rows.copied().collect() })
    }

    /// Connected parts (by edges and corners) of the pixels of a class, from the top; those below `least` pixels are
    /// left out.
    pub fn parts(&self, code: &Code, least: usize) -> Vec<Part> {
        let is_set = |index: usize| match code {
            Code::Set => self.colours[index] != [0; 3],
            Code::Colour(colour) => self.colours[index] == *colour,
        };
        let mut seen = vec![false; self.colours.len()];
        let (mut parts, mut open) = (Vec::new(), Vec::new());
        for start in 0..self.colours.len() {
            if seen[start] || !is_set(start) {
                continue;
            }
            let (mut pixels, mut low, mut high) = (Vec::new(), [usize::MAX; 2], [0; 2]);
            seen[start] = true;
            open.push(start);
            while let Some(index) = open.pop() {
                let (x, y) = (index % self.width, index / self.width);
                pixels.push(index as u32);
                low = [low[0].min(x), low[1].min(y)];
                high = [high[0].max(x), high[1].max(y)];
                for row in y.saturating_sub(1)..(y + 2).min(self.height) {
                    for column in x.saturating_sub(1)..(x + 2).min(self.width) {
                        let next = row * self.width + column;
                        if !seen[next] && is_set(next) {
                            seen[next] = true;
                            open.push(next);
                        }
                    }
                }
            }
            if pixels.len() >= least.max(1) {
                let bounds = [low[0], low[1], high[0] - low[0] + 1, high[1] - low[1] + 1];
                parts.push(Part { bounds, pixels });
            }
        }
        parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two squares that touch by a corner, a speck and a bar of another colour.
    fn mask() -> MaskPicture {
        let mut mask = MaskPicture { width: 10, height: 6, colours: vec![[0; 3]; 60] };
        for (x, y, colour) in [(1, 1, 31), (2, 2, 31), (8, 0, 31), (5, 4, 32), (6, 4, 32), (7, 4, 32)] {
            mask.colours[y * 10 + x] = [colour; 3];
        }
        mask
    }

    #[test]
    fn parts_are_connected_by_corners_and_specks_left_out() {
        let mask = mask();
        let parts = mask.parts(&Code::Colour([31; 3]), 2);
        assert_eq!(parts.len(), 1);
        assert_eq!((parts[0].bounds, parts[0].pixels.len()), ([1, 1, 2, 2], 2));
        assert_eq!(mask.parts(&Code::Colour([31; 3]), 0).len(), 2);
        let all: Vec<[usize; 4]> = mask.parts(&Code::Set, 0).into_iter().map(|part| part.bounds).collect();
        assert_eq!(all, [[8, 0, 1, 1], [1, 1, 2, 2], [5, 4, 3, 1]]);
        assert!(mask.parts(&Code::Colour([9; 3]), 0).is_empty());
    }

    #[test]
    fn a_crop_stays_inside() {
        let cut = mask().cropped([5, 3, 3, 2]).expect("inside");
        assert_eq!(cut.parts(&Code::Set, 0)[0].bounds, [0, 1, 3, 1]);
        assert!(mask().cropped([5, 3, 6, 2]).is_none() && mask().cropped([usize::MAX, 0, 2, 2]).is_none());
    }

    #[test]
    fn damaged_masks_are_named() {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image::GrayImage::from_pixel(3, 2, image::Luma([31])).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        let bytes = bytes.into_inner();
        assert_eq!(MaskPicture::decode(&bytes).unwrap().colours, vec![[31; 3]; 6]);
        assert!(MaskPicture::decode(&bytes[..bytes.len() / 2]).is_err());
        let error = MaskPicture::read(Path::new("no/mask.png")).unwrap_err().to_string();
        assert!(error.contains("no/mask.png"), "{error}");
    }
}
