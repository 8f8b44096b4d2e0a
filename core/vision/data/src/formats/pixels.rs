//! Pixels of any format for the writers.

use panoscope_base::View;

/// The pixels of a frame, borrowed.
#[derive(Clone, Copy, Debug)]
pub enum Pixels<'a> {
    /// Gray or mask.
    Gray8(View<'a, u8>),
    /// Blue, green, red.
    Bgr8(View<'a, u8>),
    /// Red, green, blue, alpha.
    Rgba8(View<'a, u8>),
    /// 16 bits.
    Gray16(View<'a, u16>),
    /// Floats.
    F32(View<'a, f32>),
}

impl<'a> Pixels<'a> {
    /// Columns and rows.
    pub fn size(&self) -> (usize, usize) {
        match self {
            Self::Gray8(v) | Self::Bgr8(v) | Self::Rgba8(v) => (v.width, v.height),
            Self::Gray16(v) => (v.width, v.height),
            Self::F32(v) => (v.width, v.height),
        }
    }

    /// The format's name in graph files.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Gray8(_) => "gray8",
            Self::Bgr8(_) => "bgr8",
            Self::Rgba8(_) => "rgba8",
            Self::Gray16(_) => "gray16",
            Self::F32(_) => "f32",
        }
    }

    /// The pixels as BGR rows without padding: those of the frame if possible, else of `buffer`, which is reused.
    /// `None` for 16-bit and float pixels.
    pub fn bgr<'b>(&self, buffer: &'b mut Vec<u8>) -> Option<&'b [u8]>
    where
        'a: 'b,
    {
        match self {
            Self::Bgr8(v) if v.stride == 3 * v.width => v.data.get(..3 * v.width * v.height),
            _ => self.to_bgr(buffer).then_some(buffer),
        }
    }

    /// Writes the pixels as BGR rows without padding; `out` is reused. Returns `false` for 16-bit and float pixels.
    pub fn to_bgr(&self, out: &mut Vec<u8>) -> bool {
        let (width, height) = self.size();
        out.clear();
        out.reserve(width * height * 3);
        match self {
            Self::Bgr8(v) => (0..height).for_each(|y| out.extend_from_slice(v.row(y))),
            Self::Gray8(v) => (0..height).for_each(|y| out.extend(v.row(y).iter().flat_map(|&g| [g, g, g]))),
            Self::Rgba8(v) => {
                (0..height).for_each(|y| out.extend(v.row(y).chunks_exact(4).flat_map(|p| [p[2], p[1], p[0]])))
            }
            Self::Gray16(_) | Self::F32(_) => return false,
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_keep_their_order_and_padding_is_dropped() {
        let mut out = Vec::new();
        let padded = [1, 2, 3, 4, 5, 6, 99, 7, 8, 9, 10, 11, 12, 99];
        assert!(Pixels::Bgr8(View::with_stride(&padded, 2, 2, 3, 7)).to_bgr(&mut out));
        assert_eq!(out, (1..=12).collect::<Vec<u8>>());
        assert!(Pixels::Rgba8(View::new(&[1, 2, 3, 255], 1, 1, 4)).to_bgr(&mut out));
        assert_eq!(out, [3, 2, 1]);
        assert!(Pixels::Gray8(View::new(&[9], 1, 1, 1)).to_bgr(&mut out));
        assert_eq!(out, [9, 9, 9]);
        assert!(!Pixels::F32(View::new(&[0.5], 1, 1, 1)).to_bgr(&mut out));
    }

    #[test]
    fn rows_without_padding_are_not_copied() {
        let mut buffer = Vec::new();
        let data = [1, 2, 3, 4, 5, 6, 99];
        let whole = Pixels::Bgr8(View::new(&data, 1, 2, 3)).bgr(&mut buffer).unwrap().as_ptr();
        assert_eq!((whole, buffer.len()), (data.as_ptr(), 0));
        let padded = [1, 2, 3, 99, 4, 5, 6];
        assert_eq!(Pixels::Bgr8(View::with_stride(&padded, 1, 2, 3, 4)).bgr(&mut buffer), Some(&data[..6]));
        assert_eq!(Pixels::F32(View::new(&[0.5], 1, 1, 1)).bgr(&mut buffer), None);
    }
}
