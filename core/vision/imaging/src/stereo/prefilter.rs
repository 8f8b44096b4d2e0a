//! What the matchers compare: a horizontal Sobel response, clipped, or the gray value itself.

use crate::{Parallel, SharedMut, Simd, View};

/// Largest value a filtered plane holds; keeps sums over a 31 x 31 window inside 16 bits.
pub(crate) const MAX_VALUE: u8 = 63;

/// A filtered plane whose rows are padded left and right with their outermost values.
#[derive(Debug, Default)]
pub(crate) struct PaddedPlane {
    /// Row after row, `stride` bytes each.
    pub data: Vec<u8>,
    pub stride: usize,
    pub pad: usize,
    pub width: usize,
    pub height: usize,
    /// First image row held.
    pub first_row: usize,
}

impl PaddedPlane {
    /// Row `y` of the image with its padding; rows outside the held ones are the nearest held one.
    pub fn row(&self, y: isize) -> &[u8] {
        let last = (self.first_row + self.height) as isize - 1;
        let y = y.clamp(self.first_row as isize, last) as usize - self.first_row;
        &self.data[y * self.stride..(y + 1) * self.stride]
    }

    /// Filters rows `rows` of `gray`: `cap` in 1..=31 clips a horizontal Sobel response to
    /// `-cap..=cap` and adds `cap`; 0 keeps the gray value's upper six bits.
    pub fn fill(
        &mut self,
        gray: View<'_, u8>,
        rows: std::ops::Range<usize>,
        cap: u8,
        pad: usize,
        avx2: bool,
        pool: &dyn Parallel,
    ) {
        self.pad = pad;
        self.width = gray.width;
        self.height = rows.len();
        self.first_row = rows.start;
        self.stride = gray.width + 2 * pad;
        self.data.resize(self.stride * self.height, 0);
        if self.width == 0 || self.height == 0 {
            return;
        }
        let (stride, height) = (self.stride, self.height);
        let chunk_rows = 32;
        let data = SharedMut::new(&mut self.data);
        pool.run(height.div_ceil(chunk_rows), &|chunk| {
            let first = chunk * chunk_rows;
            for index in first..(first + chunk_rows).min(height) {
                // SAFETY: each row belongs to one chunk only.
                let out = unsafe { data.part(index * stride, stride) };
                filter_row(gray, rows.start + index, cap, pad, avx2, out);
            }
        });
    }
}

fn filter_row(gray: View<'_, u8>, y: usize, cap: u8, pad: usize, avx2: bool, out: &mut [u8]) {
    let width = gray.width;
    let middle = &mut out[pad..pad + width];
    let current = gray.row(y);
    let above = gray.row(y.saturating_sub(1));
    let below = gray.row((y + 1).min(gray.height - 1));
    if cap == 0 {
        for (target, source) in middle.iter_mut().zip(current) {
            *target = *source >> 2;
        }
    } else {
        #[cfg(target_arch = "x86_64")]
        if avx2 && Simd::detect().avx2() {
            // SAFETY: AVX2 was found.
            unsafe { sobel_row_avx2(above, current, below, cap, middle) };
        } else {
            sobel_row(above, current, below, cap, middle);
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            let _ = avx2 && Simd::detect().avx2();
            sobel_row(above, current, below, cap, middle);
        }
    }
    let (first, last) = (out[pad], out[pad + width - 1]);
    out[..pad].fill(first);
    out[pad + width..].fill(last);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn sobel_row_avx2(above: &[u8], current: &[u8], below: &[u8], cap: u8, out: &mut [u8]) {
    sobel_row(above, current, below, cap, out);
}

#[inline(always)]
fn sobel_row(above: &[u8], current: &[u8], below: &[u8], cap: u8, out: &mut [u8]) {
    let width = out.len();
    let cap = i16::from(cap);
    let at = |left: usize, right: usize, out: &mut u8| {
        let difference = |row: &[u8]| i16::from(row[right]) - i16::from(row[left]);
        let response = difference(above) + 2 * difference(current) + difference(below);
        *out = (response.clamp(-cap, cap) + cap) as u8;
    };
    if width < 3 {
        for x in 0..width {
            at(x.saturating_sub(1), (x + 1).min(width - 1), &mut out[x]);
        }
        return;
    }
    at(0, 1, &mut out[0]);
    at(width - 2, width - 1, &mut out[width - 1]);
    let n = width - 2;
    let (al, ar) = (&above[..n], &above[2..2 + n]);
    let (cl, cr) = (&current[..n], &current[2..2 + n]);
    let (bl, br) = (&below[..n], &below[2..2 + n]);
    let middle = &mut out[1..1 + n];
    for i in 0..n {
        let response = (i16::from(ar[i]) - i16::from(al[i]))
            + 2 * (i16::from(cr[i]) - i16::from(cl[i]))
            + (i16::from(br[i]) - i16::from(bl[i]));
        middle[i] = (response.max(-cap).min(cap) + cap) as u8;
    }
}
