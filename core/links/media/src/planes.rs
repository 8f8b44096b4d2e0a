//! Conversions of pixels for encoders and decoders.

use panoscope_base::gray::convert_row;
use panoscope_base::{Simd, dispatch};

/// Columns and rows, px.
type Size = (usize, usize);

/// Weights of blue, green and red, in 1/65536.
struct Matrix {
    luma: [i32; 3],
    luma_offset: i32,
    cb: [i32; 3],
    cr: [i32; 3],
}

/// BT.601, 0 to 255: JPEG.
const FULL: Matrix =
    Matrix { luma: [7471, 38470, 19595], luma_offset: 0, cb: [32768, -21709, -11059], cr: [-5329, -27439, 32768] };

/// BT.601, 16 to 235 and 16 to 240: other codecs.
const LIMITED: Matrix =
    Matrix { luma: [6416, 33039, 16829], luma_offset: 16, cb: [28784, -19070, -9714], cr: [-4681, -24103, 28784] };

/// A plane to fill.
pub struct PlaneMut<'a> {
    /// Rows, `stride` bytes apart.
    pub data: &'a mut [u8],
    /// Bytes from row to row.
    pub stride: usize,
}

impl Matrix {
    fn luma(&self, bgr: [u8; 3]) -> u8 {
        (weighted(&self.luma, bgr.map(i32::from), 16) + self.luma_offset) as u8
    }

    /// Chroma of the sum of four pixels.
    fn chroma(&self, sum: [i32; 3]) -> (u8, u8) {
        let byte = |value: i32| (value + 128).clamp(0, 255) as u8;
        (byte(weighted(&self.cb, sum, 18)), byte(weighted(&self.cr, sum, 18)))
    }
}

fn weighted(weights: &[i32; 3], [b, g, r]: [i32; 3], shift: u32) -> i32 {
    (weights[0] * b + weights[1] * g + weights[2] * r + (1 << (shift - 1))) >> shift
}

fn pixel(row: &[u8], x: usize) -> [u8; 3] {
    [row[3 * x], row[3 * x + 1], row[3 * x + 2]]
}

/// BGR rows without padding to planes of luma, Cb and Cr by BT.601, chroma averaged over 2x2 px. `to` may be one column
/// and one row larger than `size`: the last ones are repeated.
pub fn bgr_to_i420(bgr: &[u8], size: Size, to: Size, is_full_range: bool, planes: [PlaneMut<'_>; 3]) {
    let matrix = if is_full_range { &FULL } else { &LIMITED };
    let [luma, cb, cr] = planes;
    let (width, height) = size;
    for (y, (cb, cr)) in cb.data.chunks_mut(cb.stride).zip(cr.data.chunks_mut(cr.stride)).enumerate() {
        if 2 * y >= to.1 {
            break;
        }
        let row = |y: usize| &bgr[y.min(height - 1) * width * 3..][..width * 3];
        let (above, below) = (row(2 * y), row(2 * y + 1));
        let rest = &mut luma.data[2 * y * luma.stride..];
        let (luma_above, luma_below) = rest.split_at_mut(luma.stride.min(rest.len()));
        let has_below = 2 * y + 1 < to.1;
        luma_row(matrix, is_full_range, above, luma_above, to.0);
        if has_below {
            luma_row(matrix, is_full_range, below, luma_below, to.0);
        }
        chroma_row(matrix, [above, below], cb, cr);
        if width % 2 == 1 {
            let (a, b) = (pixel(above, width - 1), pixel(below, width - 1));
            let sum = [0, 1, 2].map(|c| 2 * (i32::from(a[c]) + i32::from(b[c])));
            (cb[width / 2], cr[width / 2]) = matrix.chroma(sum);
        }
    }
}

/// Number of chroma blocks per step; their sums are on the stack.
const BLOCKS: usize = 256;

fn chroma_row(matrix: &Matrix, rows: [&[u8]; 2], cb: &mut [u8], cr: &mut [u8]) {
    dispatch!(Simd::detect(), chroma_blocks(matrix: &Matrix, rows: [&[u8]; 2], cb: &mut [u8], cr: &mut [u8]));
}

/// Chroma of two rows. Each step is a branch-free loop over one type, which compilers vectorize.
#[inline(always)]
fn chroma_blocks(matrix: &Matrix, [above, below]: [&[u8]; 2], cb: &mut [u8], cr: &mut [u8]) {
    let blocks = (above.len() / 6).min(cb.len()).min(cr.len());
    let mut columns = [0_u16; 6 * BLOCKS];
    let mut sums = [[0_u16; BLOCKS]; 3];
    for start in (0..blocks).step_by(BLOCKS) {
        let count = BLOCKS.min(blocks - start);
        let pixels = 6 * start..6 * (start + count);
        for (sum, (a, b)) in columns.iter_mut().zip(above[pixels.clone()].iter().zip(&below[pixels])) {
            *sum = u16::from(*a) + u16::from(*b);
        }
        let [blue, green, red] = &mut sums;
        let columns = columns.as_chunks::<6>().0.iter().take(count);
        for (((block, blue), green), red) in columns.zip(&mut *blue).zip(&mut *green).zip(&mut *red) {
            (*blue, *green, *red) = (block[0] + block[3], block[1] + block[4], block[2] + block[5]);
        }
        let parts = blue.iter().zip(&*green).zip(&*red).take(count);
        let targets = cb[start..start + count].iter_mut().zip(&mut cr[start..start + count]);
        for ((cb, cr), ((blue, green), red)) in targets.zip(parts) {
            (*cb, *cr) = matrix.chroma([blue, green, red].map(|sum| i32::from(*sum)));
        }
    }
}

#[inline(always)]
fn weighted_luma(matrix: &Matrix, bgr: &[u8], luma: &mut [u8]) {
    for (bgr, luma) in bgr.as_chunks::<3>().0.iter().zip(luma) {
        *luma = matrix.luma(*bgr);
    }
}

fn luma_row(matrix: &Matrix, is_full_range: bool, bgr: &[u8], luma: &mut [u8], to_width: usize) {
    let width = bgr.len() / 3;
    if is_full_range {
        // The same weights, in 1/16384.
        convert_row(Simd::detect(), bgr, 3, &mut luma[..width]);
    } else {
        dispatch!(Simd::detect(), weighted_luma(matrix: &Matrix, bgr: &[u8], luma: &mut [u8]));
    }
    if to_width > width {
        luma[width] = luma[width - 1];
    }
}

/// A plane to read.
pub struct Plane<'a> {
    /// Rows, `stride` bytes apart.
    pub data: &'a [u8],
    /// Bytes from row to row.
    pub stride: usize,
}

/// From luma and chroma to blue, green and red, in 1/65536.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FromYuv {
    offset: i32,
    luma: i32,
    blue: i32,
    /// Weights of Cb and Cr in green.
    green: [i32; 2],
    red: i32,
}

/// Chroma value of gray.
const CHROMA_ZERO: i32 = 128;

impl FromYuv {
    /// BT.601, 16 to 235 and 16 to 240.
    pub const BT601: Self = Self { offset: 16, luma: 76309, blue: 132201, green: [-25675, -53279], red: 104597 };

    /// A matrix from the shares of red and blue in luma. Full range is 0 to 255, else luma is 16 to 235 and chroma 16
    /// to 240.
    pub fn new(red_share: f64, blue_share: f64, is_full_range: bool) -> Self {
        let (offset, luma, chroma) = if is_full_range { (0, 1.0, 2.0) } else { (16, 255.0 / 219.0, 255.0 / 112.0) };
        let fixed = |value: f64| (value * 65536.0).round() as i32;
        let green_share = 1.0 - red_share - blue_share;
        let (blue, red) = (chroma * (1.0 - blue_share), chroma * (1.0 - red_share));
        let green = [-blue * blue_share / green_share, -red * red_share / green_share].map(fixed);
        Self { offset, luma: fixed(luma), blue: fixed(blue), green, red: fixed(red) }
    }
}

/// A component of an image in memory: its values are `step` bytes apart, and each covers 2 to the power of `shift`
/// columns and rows.
pub struct Component<'a> {
    /// The first value is that of the upper left corner.
    pub plane: Plane<'a>,
    /// Bytes from value to value.
    pub step: usize,
    /// Binary logarithm of the columns and rows that a value covers.
    pub shift: (u32, u32),
}

impl Component<'_> {
    /// The values of row `y`, one for each pixel.
    fn expand(&self, y: usize, out: &mut [u8]) {
        let row = &self.plane.data[(y >> self.shift.1) * self.plane.stride..];
        if (self.step, self.shift.0) == (1, 0) {
            out.copy_from_slice(&row[..out.len()]);
        } else if self.shift.0 == 1 {
            let values = row.iter().step_by(self.step);
            out.chunks_mut(2).zip(values).for_each(|(pair, value)| pair.fill(*value));
        } else {
            out.iter_mut().enumerate().for_each(|(x, out)| *out = row[(x >> self.shift.0) * self.step]);
        }
    }
}

/// Luma, Cb and Cr of 8 bits to BGR rows that are `stride` bytes apart; the components may be larger than `size`.
/// Values follow the standard, rounded; chroma is not interpolated.
///
/// # Panics When rows are not inside their memory.
pub fn yuv_to_bgr(from: FromYuv, components: [Component<'_>; 3], size: Size, stride: usize, bgr: &mut [u8]) {
    let (width, height) = size;
    let mut rows = [const { Vec::new() }; 3];
    rows.iter_mut().for_each(|row| row.resize(width, 0));
    for y in 0..height {
        for (component, row) in components.iter().zip(&mut rows) {
            component.expand(y, row);
        }
        let [luma, cb, cr] = &rows;
        let out = &mut bgr[y * stride..][..width * 3];
        dispatch!(Simd::detect(), yuv_row(from: FromYuv, luma: &[u8], cb: &[u8], cr: &[u8], out: &mut [u8]));
    }
}

#[inline(always)]
fn yuv_row(from: FromYuv, luma: &[u8], cb: &[u8], cr: &[u8], bgr: &mut [u8]) {
    let pixels = luma.iter().zip(cb).zip(cr);
    for (((luma, cb), cr), to) in pixels.zip(bgr.as_chunks_mut::<3>().0) {
        let luma = (i32::from(*luma) - from.offset) * from.luma + (1 << 15);
        let (cb, cr) = (i32::from(*cb) - CHROMA_ZERO, i32::from(*cr) - CHROMA_ZERO);
        let byte = |value: i32| (value >> 16).clamp(0, 255) as u8;
        *to = [
            byte(luma + from.blue * cb),
            byte(luma + from.green[0] * cb + from.green[1] * cr),
            byte(luma + from.red * cr),
        ];
    }
}

/// Planes of luma, Cb and Cr by BT.601 (16 to 235) to BGR rows that are `stride` bytes apart; the planes may be larger
/// than `size`.
pub fn i420_to_bgr([luma, cb, cr]: [Plane<'_>; 3], size: Size, stride: usize, bgr: &mut [u8]) {
    let component = |plane, shift| Component { plane, step: 1, shift };
    let components = [component(luma, (0, 0)), component(cb, (1, 1)), component(cr, (1, 1))];
    yuv_to_bgr(FromYuv::BT601, components, size, stride, bgr);
}

/// BGR rows without padding to rows of BGR and an unused byte.
pub fn bgr_to_bgrx(bgr: &[u8], size: Size, to: PlaneMut<'_>) {
    for (row, to) in bgr.chunks_exact(size.0 * 3).zip(to.data.chunks_mut(to.stride)) {
        for (bgr, to) in row.as_chunks::<3>().0.iter().zip(to.as_chunks_mut::<4>().0) {
            *to = [bgr[0], bgr[1], bgr[2], 255];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planes(bgr: &[u8], size: Size, to: Size, is_full_range: bool) -> [Vec<u8>; 3] {
        let chroma = to.0.div_ceil(2);
        let mut data = [vec![0; to.0 * to.1], vec![0; chroma * to.1.div_ceil(2)], vec![0; chroma * to.1.div_ceil(2)]];
        let [luma, cb, cr] = &mut data;
        let planes = [(luma, to.0), (cb, chroma), (cr, chroma)].map(|(data, stride)| PlaneMut { data, stride });
        bgr_to_i420(bgr, size, to, is_full_range, planes);
        data
    }

    #[test]
    fn colours_have_the_values_of_the_standard() {
        // Blue, green, red, white, black of BT.601, by its definition.
        for (bgr, full, limited) in [
            ([255, 0, 0], [29, 255, 107], [41, 240, 110]),
            ([0, 255, 0], [150, 44, 21], [145, 54, 34]),
            ([0, 0, 255], [76, 85, 255], [81, 90, 240]),
            ([255, 255, 255], [255, 128, 128], [235, 128, 128]),
            ([0, 0, 0], [0, 128, 128], [16, 128, 128]),
        ] {
            for (is_full, expected) in [(true, full), (false, limited)] {
                let found = planes(&bgr.repeat(4), (2, 2), (2, 2), is_full).map(|plane| plane[0]);
                let difference = found.iter().zip(&expected).map(|(a, b): (&u8, &u8)| a.abs_diff(*b)).max();
                assert!(difference <= Some(1), "{bgr:?}: {found:?} for {expected:?}");
            }
        }
    }

    #[test]
    fn colours_come_back() {
        for bgr in [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255], [0, 0, 0], [40, 90, 200]] {
            let data = planes(&bgr.repeat(9), (3, 3), (4, 4), false);
            let mut rows = [0; 3 * 11];
            i420_to_bgr(
                [(&data[0], 4), (&data[1], 2), (&data[2], 2)].map(|(data, stride)| Plane { data, stride }),
                (3, 3),
                11,
                &mut rows,
            );
            for row in rows.chunks(11) {
                let difference = row[..9].iter().zip(bgr.repeat(3)).map(|(a, b): (&u8, u8)| a.abs_diff(b)).max();
                assert!(difference <= Some(3), "{bgr:?}: {row:?}");
            }
        }
    }

    #[test]
    fn every_layout_gives_the_values_of_the_standard() {
        assert_eq!(FromYuv::new(0.299, 0.114, false), FromYuv::BT601);
        // BT.709: white, black, gray and a colour, by its definition.
        let from = FromYuv::new(0.2126, 0.0722, false);
        for (yuv, bgr) in [
            ([235, 128, 128], [255; 3]),
            ([16, 128, 128], [0; 3]),
            ([126, 128, 128], [128; 3]),
            ([110, 110, 150], [71, 102, 149]),
        ] {
            let [y, u, v] = yuv;
            let (luma, cb, cr, pairs, packed) = ([y; 15], [u; 6], [v; 6], [u, v].repeat(6), [y, u, y, v].repeat(9));
            let of = |data, stride, step, shift| Component { plane: Plane { data, stride }, step, shift };
            let luma = || of(&luma, 5, 1, (0, 0));
            let planar = [luma(), of(&cb, 3, 1, (1, 1)), of(&cr, 3, 1, (1, 1))];
            let semi_planar = [luma(), of(&pairs, 6, 2, (1, 1)), of(&pairs[1..], 6, 2, (1, 1))];
            let interleaved =
                [of(&packed, 12, 2, (0, 0)), of(&packed[1..], 12, 4, (1, 0)), of(&packed[3..], 12, 4, (1, 0))];
            for components in [planar, semi_planar, interleaved] {
                let mut rows = [7; 3 * 16];
                yuv_to_bgr(from, components, (5, 3), 16, &mut rows);
                for row in rows.chunks(16) {
                    assert_eq!(row[..15], bgr.repeat(5), "{yuv:?}");
                    assert_eq!(row[15], 7, "nothing is written between rows");
                }
            }
        }
        assert_eq!(FromYuv::new(0.299, 0.114, true).luma, 65536);
    }

    #[test]
    fn odd_sides_repeat_the_last_column_and_row() {
        // 3 x 3: gray levels by position.
        let bgr: Vec<u8> = (0..9).flat_map(|i| [i * 20; 3]).collect();
        let odd = planes(&bgr, (3, 3), (3, 3), true);
        assert_eq!(odd[0], (0..9).map(|i| i * 20).collect::<Vec<u8>>());
        assert!(odd[1].iter().chain(&odd[2]).all(|&c| c == 128) && odd[1].len() == 4);
        let even = planes(&bgr, (3, 3), (4, 4), true);
        assert_eq!(even[0][..4], [0, 20, 40, 40]);
        assert_eq!(even[0][12..], [120, 140, 160, 160]);
    }

    #[test]
    fn chroma_is_the_average_of_four() {
        let bgr = [[255, 0, 0], [0; 3], [0; 3], [0; 3]].concat();
        let [_, cb, cr] = planes(&bgr, (2, 2), (2, 2), true);
        assert_eq!((cb[0], cr[0]), (160, 123));
    }

    #[test]
    fn wide_rows_have_the_values_of_single_pixels() {
        for width in [2, 511, 512, 1031] {
            let bgr: Vec<u8> =
                (0..width * 2 * 3).map(|i| (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).to_le_bytes()[7]).collect();
            for is_full in [true, false] {
                let wide = planes(&bgr, (width, 2), (width, 2), is_full);
                let matrix = if is_full { &FULL } else { &LIMITED };
                for (at, (luma, pixel)) in wide[0].iter().zip(bgr.as_chunks::<3>().0).enumerate() {
                    assert!(luma.abs_diff(matrix.luma(*pixel)) <= 1, "pixel {at} of {width}: {pixel:?}");
                }
                for x in 0..width / 2 {
                    let four = [0, 1, width, width + 1].map(|at| pixel(&bgr, 2 * x + at));
                    let sum = [0, 1, 2].map(|c| four.iter().map(|pixel| i32::from(pixel[c])).sum());
                    assert_eq!((wide[1][x], wide[2][x]), matrix.chroma(sum), "block {x} of {width}");
                }
            }
        }
    }
}
