//! Pictures scaled into cells, and the range of the numbers in a map.

use panoscope_node::{AnyImage, Bgr8, Gray8, Rgba8, View, ViewMut};

/// The largest size with the proportions of `from` (width, height in px) that fits into `cell`.
pub fn fitted_size(from: (usize, usize), cell: (usize, usize)) -> (usize, usize) {
    if from.0 == 0 || from.1 == 0 {
        return (0, 0);
    }
    let scale = (cell.0 as f64 / from.0 as f64).min(cell.1 as f64 / from.1 as f64);
    let side = |length: usize, limit: usize| ((length as f64 * scale).round() as usize).clamp(1, limit.max(1));
    (side(from.0, cell.0), side(from.1, cell.1))
}

/// The pixels of an 8-bit picture, whatever its channels.
pub fn bytes<'f>(image: &AnyImage<'f>) -> Option<View<'f, u8>> {
    if let Some(plane) = image.as_plane::<Bgr8>() {
        return Some(plane.view());
    }
    if let Some(plane) = image.as_plane::<Gray8>() {
        return Some(plane.view());
    }
    image.as_plane::<Rgba8>().map(|plane| plane.view())
}

/// Scales pictures into others; reuses its buffers.
#[derive(Default)]
pub struct Fit {
    /// First byte of the first and of the last source pixel under each column.
    columns: Vec<[u32; 2]>,
    /// The source rows under one row, averaged.
    row: Vec<u8>,
    /// The same, added up.
    sums: Vec<u16>,
}

impl Fit {
    /// Scales `picture` (1 channel gray, 3 BGR, 4 RGBA) to `width` x `height` at `(x, y)` of a BGR picture: the mean of the
    /// source pixels under each pixel when it shrinks, the nearest one when it grows. What leaves `out` is cut.
    pub fn place(
        &mut self,
        out: &mut ViewMut<'_, u8>,
        picture: &View<'_, u8>,
        (x, y): (usize, usize),
        (width, height): (usize, usize),
    ) {
        let same = (width, height) == (picture.width, picture.height);
        let colored = picture.channels == 3 && out.channels == 3 && picture.width > 0 && picture.height > 0;
        // Sums of more rows than that could leave 16 bits.
        if same || !colored || picture.height > 256 * height {
            place(out, picture, x, y, width, height);
            return;
        }
        let span = |at: usize, target: usize, source: usize| {
            let first = at * source / target;
            (first, ((at + 1) * source / target).max(first + 1) - 1)
        };
        let (right, bottom) = ((x + width).min(out.width).max(x), (y + height).min(out.height));
        self.columns.clear();
        self.columns.extend((0..right - x).map(|at| {
            let (first, last) = span(at, width, picture.width);
            [3 * first as u32, 3 * last as u32]
        }));
        let at_most_two = picture.width <= 2 * width && picture.height <= 2 * height;
        let mut held = None;
        for row in y..bottom {
            let (top, end) = span(row - y, height, picture.height);
            let new = held != Some((top, end));
            held = Some((top, end));
            let target = &mut out.row_mut(row)[x * 3..right * 3];
            if at_most_two {
                if new {
                    self.average(picture.row(top), picture.row(end));
                }
                self.pairs(target);
            } else {
                if new {
                    self.add(picture, top, end);
                }
                self.means(target, end + 1 - top);
            }
        }
    }

    fn average(&mut self, above: &[u8], below: &[u8]) {
        // One byte more: pixels are read as four bytes.
        self.row.resize(above.len() + 1, 0);
        for (mean, (&a, &b)) in self.row.iter_mut().zip(above.iter().zip(below)) {
            *mean = u16::midpoint(u16::from(a), u16::from(b) + 1) as u8;
        }
    }

    /// The mean of one or two pixels under each column.
    fn pairs(&self, target: &mut [u8]) {
        let word = |at: u32| self.row[at as usize..].first_chunk().map_or(0, |four| u32::from_le_bytes(*four));
        for (pixel, [first, last]) in target.as_chunks_mut::<3>().0.iter_mut().zip(&self.columns) {
            let (a, b) = (word(*first), word(*last));
            // The rounded mean of each byte.
            let mean = ((a | b) - (((a ^ b) >> 1) & 0x7f7f_7f7f)).to_le_bytes();
            *pixel = [mean[0], mean[1], mean[2]];
        }
    }

    fn add(&mut self, picture: &View<'_, u8>, top: usize, end: usize) {
        let wide = |v: &u8| u16::from(*v);
        self.sums.clear();
        let first = picture.row(top);
        // Two or three rows at once: the usual shrinking, without a sum that is stored and read again.
        let next = match end - top {
            0 => {
                self.sums.extend(first.iter().map(wide));
                top + 1
            }
            1 => {
                let rows = first.iter().zip(picture.row(top + 1));
                self.sums.extend(rows.map(|(a, b)| wide(a) + wide(b)));
                top + 2
            }
            _ => {
                let rows = first.iter().zip(picture.row(top + 1)).zip(picture.row(top + 2));
                self.sums.extend(rows.map(|((a, b), c)| wide(a) + wide(b) + wide(c)));
                top + 3
            }
        };
        for row in next..=end {
            self.sums.iter_mut().zip(picture.row(row)).for_each(|(sum, v)| *sum += wide(v));
        }
        // One value more: pixels are read as four.
        self.sums.push(0);
    }

    /// The mean of all pixels under each column, of as many rows.
    fn means(&self, target: &mut [u8], rows: usize) {
        let (mut count, mut share) = (0, 0);
        for (pixel, [first, last]) in target.as_chunks_mut::<3>().0.iter_mut().zip(&self.columns) {
            let under = &self.sums[*first as usize..*last as usize + 4];
            let pixels = rows * (under.len() / 3);
            if pixels > LANE_PIXELS {
                *pixel = wide_mean(under, rows);
                continue;
            }
            if pixels != count {
                count = pixels;
                share = ((1 << SHARE_BITS) + count as u32 / 2) / count as u32;
            }
            *pixel = packed_sum(under).map(|sum| ((sum * share + (1 << (SHARE_BITS - 1))) >> SHARE_BITS) as u8);
        }
    }
}

/// Binary places of the reciprocal of a count of pixels.
const SHARE_BITS: u32 = 20;
/// So many pixels of eight bits add up to at most sixteen bits.
const LANE_PIXELS: usize = 257;

/// Sums of the three channels of at most [`LANE_PIXELS`] pixels, one value behind them: all channels in one addition.
fn packed_sum(pixels: &[u16]) -> [u32; 3] {
    let mut sum = 0u64;
    for four in pixels.windows(4).step_by(3) {
        let word = four.iter().rev().fold(0, |word, v| word << 16 | u64::from(*v));
        sum = sum.wrapping_add(word);
    }
    [0, 16, 32].map(|shift| (sum >> shift) as u32 & 0xffff)
}

/// Means of the three channels of any number of columns that hold sums of `rows` pixels.
fn wide_mean(columns: &[u16], rows: usize) -> [u8; 3] {
    let columns = columns.as_chunks::<3>().0;
    let mut sum = [0u32; 3];
    for three in columns {
        sum.iter_mut().zip(three).for_each(|(s, v)| *s += u32::from(*v));
    }
    let share = 1.0 / (rows * columns.len()) as f32;
    sum.map(|s| (s as f32 * share + 0.5) as u8)
}

/// [`Fit::place`] for any number of channels and any scale.
fn place(out: &mut ViewMut<'_, u8>, picture: &View<'_, u8>, x: usize, y: usize, width: usize, height: usize) {
    if picture.width == 0 || picture.height == 0 || out.channels != 3 {
        return;
    }
    let (right, bottom) = ((x + width).min(out.width), (y + height).min(out.height));
    let same = (width, height) == (picture.width, picture.height);
    let order: [usize; 3] = match picture.channels {
        1 => [0, 0, 0],
        3 => [0, 1, 2],
        4 => [2, 1, 0],
        _ => return,
    };
    let channels = picture.channels;
    let span = |at: usize, target: usize, source: usize| {
        let start = at * source / target;
        (start, ((at + 1) * source / target).max(start + 1))
    };
    for row in y..bottom {
        let (top, end) = span(row - y, height, picture.height);
        let target = &mut out.row_mut(row)[x * 3..right.max(x) * 3];
        if same && channels == 3 {
            target.copy_from_slice(&picture.row(top)[..target.len()]);
            continue;
        }
        // Where a column's pixels begin, without a division for each: quotient and remainder step on together.
        let (whole, rest) = (picture.width / width, picture.width % width);
        let (mut left, mut over) = (0, 0);
        for pixel in target.as_chunks_mut::<3>().0 {
            let (mut next, mut next_over) = (left + whole, over + rest);
            if next_over >= width {
                (next, next_over) = (next + 1, next_over - width);
            }
            let stop = next.max(left + 1);
            let count = ((end - top) * (stop - left)) as u32;
            if count == 1 {
                let source = &picture.row(top)[left * channels..stop * channels];
                *pixel = order.map(|o| source[o]);
            } else {
                let mut sum = [0_u32; 3];
                for source_row in top..end {
                    for source in picture.row(source_row)[left * channels..stop * channels].chunks_exact(channels) {
                        for (s, o) in sum.iter_mut().zip(order) {
                            *s += u32::from(source[o]);
                        }
                    }
                }
                *pixel = match count {
                    2 => sum.map(|s| ((s + 1) >> 1) as u8),
                    4 => sum.map(|s| ((s + 2) >> 2) as u8),
                    _ => sum.map(|s| ((s + count / 2) / count) as u8),
                };
            }
            (left, over) = (next, next_over);
        }
    }
}

/// The 2 % and 98 % quantiles of the finite values of `plane`, from every `step`-th value in both directions. `work` is reused. `None` when no value
/// is finite.
pub fn usual_range(plane: &View<'_, f32>, step: usize, work: &mut Vec<f32>) -> Option<(f32, f32)> {
    work.clear();
    for y in (0..plane.height).step_by(step.max(1)) {
        work.extend(plane.row(y).iter().step_by(step.max(1)).filter(|v| v.is_finite()));
    }
    if work.is_empty() {
        return None;
    }
    let at = |share: usize| (work.len() - 1) * share / 100;
    let (low, high) = (at(2), at(98));
    let low = *work.select_nth_unstable_by(low, f32::total_cmp).1;
    let high = *work.select_nth_unstable_by(high, f32::total_cmp).1;
    Some((low, high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_node::random;

    #[test]
    fn sizes_keep_their_proportions() {
        assert_eq!(fitted_size((640, 480), (320, 320)), (320, 240));
        assert_eq!(fitted_size((100, 400), (320, 320)), (80, 320));
        assert_eq!(fitted_size((0, 4), (320, 320)), (0, 0));
        assert_eq!(fitted_size((10_000, 1), (10, 10)), (10, 1));
    }

    #[test]
    fn shrinking_takes_the_mean() {
        let source = [0, 100, 50, 50];
        let mut out = [9; 2 * 2 * 3];
        place(&mut ViewMut::new(&mut out, 2, 2, 3), &View::new(&source, 2, 2, 1), 1, 1, 1, 1);
        assert_eq!(out[9..], [50, 50, 50]);
        assert_eq!(out[..9], [9; 9]);
        // RGBA becomes BGR, and what leaves the picture is cut.
        place(&mut ViewMut::new(&mut out, 2, 2, 3), &View::new(&[1, 2, 3, 255], 1, 1, 4), 1, 0, 5, 5);
        assert_eq!(out[3..6], [3, 2, 1]);
        assert_eq!(out[0..3], [9; 3]);
    }

    #[test]
    fn rows_and_columns_one_after_the_other_give_the_same_picture() {
        let source: Vec<u8> = (0..37 * 23 * 3).map(|i| random::mix(i) as u8).collect();
        let source = View::new(&source, 37, 23, 3);
        for (width, height) in [(37, 20), (30, 23), (19, 12), (50, 40), (36, 22), (17, 11), (9, 7), (40, 5), (1, 1)] {
            let mut outs = [vec![7u8; 60 * 50 * 3], vec![7u8; 60 * 50 * 3]];
            place(&mut ViewMut::new(&mut outs[0], 60, 50, 3), &source, 15, 13, width, height);
            let mut fit = Fit::default();
            fit.place(&mut ViewMut::new(&mut outs[1], 60, 50, 3), &source, (15, 13), (width, height));
            let apart = outs[0].iter().zip(&outs[1]).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(apart <= Some(1), "{width}x{height}: {apart:?}");
        }
    }

    #[test]
    fn outliers_and_unknown_places_do_not_count() {
        let mut plane: Vec<f32> = (0..1000).map(|i| i as f32).collect();
        plane[0] = f32::NAN;
        plane[999] = f32::INFINITY;
        plane[998] = 1e9;
        let (low, high) = usual_range(&View::new(&plane, 50, 20, 1), 1, &mut Vec::new()).unwrap();
        assert!((15.0..25.0).contains(&low) && (970.0..990.0).contains(&high), "{low} {high}");
        assert!(usual_range(&View::new(&[f32::NAN], 1, 1, 1), 1, &mut Vec::new()).is_none());
    }
}
