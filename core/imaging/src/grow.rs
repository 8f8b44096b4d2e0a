//! Pictures made larger: each pixel lies between four of the source.

use crate::{View, ViewMut};

/// Weights are multiples of a 128th: products of bytes and weights fit into 16 bits.
const ONE: u32 = 128;
const HALVES: u32 = 0x0040_0040;
const EVEN: u32 = 0x00ff_00ff;

/// Enlarges pictures of three bytes per pixel; reuses its buffers.
#[derive(Debug, Default)]
pub struct Grow {
    /// For each column the byte of the pixel to its left, and the weight of the one to its right.
    columns: Vec<(u32, u32)>,
    /// One row between two of the source, and four bytes behind it.
    row: Vec<u8>,
}

/// The pixel before the middle of pixel `at` of `target`, and the weight of the one behind it, where `source` pixels have become `target`.
fn between(at: usize, target: usize, source: usize) -> (usize, u32) {
    // In 256ths of a source pixel, measured from the first one's middle.
    let place = ((2 * at + 1) * source * 128 / target).saturating_sub(128);
    let (first, weight) = (place / 256, (place % 256) as u32 / 2);
    if first + 1 < source { (first, weight) } else { (source - 1, 0) }
}

/// Four bytes between those of `a` and `b`.
fn mix(a: u32, b: u32, weight: u32) -> u32 {
    let even = ((a & EVEN) * (ONE - weight) + (b & EVEN) * weight + HALVES) >> 7 & EVEN;
    let odd = (((a >> 8) & EVEN) * (ONE - weight) + ((b >> 8) & EVEN) * weight + HALVES) >> 7 & EVEN;
    even | odd << 8
}

impl Grow {
    /// Puts `picture` at `(x, y)` of `out` as `width` x `height` pixels, no fewer than it has. What leaves `out` is cut.
    pub fn place(
        &mut self,
        out: &mut ViewMut<'_, u8>,
        picture: &View<'_, u8>,
        (x, y): (usize, usize),
        (width, height): (usize, usize),
    ) {
        let (right, bottom) = ((x + width).min(out.width).max(x), (y + height).min(out.height));
        self.columns.clear();
        self.columns.extend((0..right - x).map(|at| {
            let (first, weight) = between(at, width, picture.width);
            (3 * first as u32, weight)
        }));
        let bytes = 3 * picture.width;
        self.row.clear();
        self.row.resize(bytes + 4, 0);
        for row in y..bottom {
            let (first, weight) = between(row - y, height, picture.height);
            let (above, below) = (picture.row(first), picture.row((first + 1).min(picture.height - 1)));
            let [keep, weight] = [ONE - weight, weight].map(|weight| weight as u16);
            for (value, (a, b)) in self.row.iter_mut().zip(above.iter().zip(below)) {
                *value = ((u16::from(*a) * keep + u16::from(*b) * weight + 64) >> 7) as u8;
            }
            let word = |at: usize| self.row.get(at..at + 4).and_then(|four| four.first_chunk()).copied();
            let word = |at: u32| word(at as usize).map_or(0, u32::from_le_bytes);
            let target = &mut out.row_mut(row)[x * 3..right * 3];
            for (pixel, (at, weight)) in target.as_chunks_mut::<3>().0.iter_mut().zip(&self.columns) {
                // Behind the last pixel are zeros, which have no weight.
                let [b, g, r, _] = mix(word(*at), word(*at + 3), *weight).to_le_bytes();
                *pixel = [b, g, r];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::random;

    fn grown(source: &View<'_, u8>, size: (usize, usize)) -> Vec<u8> {
        let mut out = vec![0; size.0 * size.1 * 3];
        Grow::default().place(&mut ViewMut::new(&mut out, size.0, size.1, 3), source, (0, 0), size);
        out
    }

    #[test]
    fn a_ramp_stays_a_ramp() {
        let source: Vec<u8> = (0..20 * 10).flat_map(|i| [(10 * (i % 20)) as u8, (20 * (i / 20)) as u8, 77]).collect();
        let out = grown(&View::new(&source, 20, 10, 3), (50, 23));
        for (y, row) in out.chunks_exact(150).enumerate() {
            for (x, pixel) in row.as_chunks::<3>().0.iter().enumerate() {
                let place = |at: usize, target: f32, source: f32| {
                    ((at as f32 + 0.5) * source / target - 0.5).clamp(0.0, source - 1.0)
                };
                let want = [10.0 * place(x, 50.0, 20.0), 20.0 * place(y, 23.0, 10.0), 77.0];
                assert!(
                    pixel.iter().zip(want).all(|(p, w)| (f32::from(*p) - w).abs() < 1.1),
                    "{x} {y}: {pixel:?} {want:?}"
                );
            }
        }
    }

    #[test]
    fn the_same_size_is_the_same_picture_and_what_leaves_the_other_is_cut() {
        let source: Vec<u8> = (0..37 * 23 * 3).map(|i| random::mix(i) as u8).collect();
        let source = View::new(&source, 37, 23, 3);
        assert_eq!(grown(&source, (37, 23)), source.data);
        let whole = grown(&source, (60, 40));
        let mut out = vec![9; 50 * 30 * 3];
        Grow::default().place(&mut ViewMut::new(&mut out, 50, 30, 3), &source, (5, 3), (60, 40));
        for y in 0..30 {
            let row = &out[y * 150..(y + 1) * 150];
            assert!(row[..15].iter().all(|v| *v == 9));
            if y >= 3 {
                assert_eq!(row[15..], whole[(y - 3) * 180..(y - 3) * 180 + 135]);
            }
        }
        assert_eq!(grown(&View::new(&[1, 2, 3], 1, 1, 3), (2, 2)), [1, 2, 3].repeat(4));
    }
}
