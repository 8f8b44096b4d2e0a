//! Bit masks, and conversions from and to COCO's run lengths and polygons.

/// A mask; bits run down the columns, as COCO's run lengths do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    words: Vec<u64>,
    /// Bits that are set.
    pub area: u64,
    /// First column and row, last column and row of the set bits; updated with every change, because images are large
    /// and objects small.
    extent: Option<[usize; 4]>,
}

impl Mask {
    /// An empty mask.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, words: vec![0; (width * height).div_ceil(64)], area: 0, extent: None }
    }

    /// Whether a pixel is set; positions outside are not.
    pub fn at(&self, x: usize, y: usize) -> bool {
        let bit = x * self.height + y;
        x < self.width && y < self.height && self.words[bit / 64] >> (bit % 64) & 1 == 1
    }

    /// Sets a pixel.
    pub fn set(&mut self, x: usize, y: usize) {
        if x < self.width && y < self.height && !self.at(x, y) {
            let bit = x * self.height + y;
            self.words[bit / 64] |= 1 << (bit % 64);
            self.area += 1;
            self.extend([x, y, x, y]);
        }
    }

    fn extend(&mut self, [x0, y0, x1, y1]: [usize; 4]) {
        let [a, b, c, d] = self.extent.unwrap_or([x0, y0, x1, y1]);
        self.extent = Some([a.min(x0), b.min(y0), c.max(x1), d.max(y1)]);
    }

    /// Sets the bits from `at` to before `end`, a word at a time.
    fn fill(&mut self, at: usize, end: usize) {
        if at >= end {
            return;
        }
        let (first, last) = (at / 64, (end - 1) / 64);
        for word in first..=last {
            let from = if word == first { at % 64 } else { 0 };
            let to = if word == last { (end - 1) % 64 } else { 63 };
            self.words[word] |= (u64::MAX >> (63 - (to - from))) << from;
        }
        self.area += (end - at) as u64;
        let (x0, x1) = (at / self.height, (end - 1) / self.height);
        // A run over the end of a column holds the last row and the first.
        let (y0, y1) = if x0 == x1 { (at % self.height, (end - 1) % self.height) } else { (0, self.height - 1) };
        self.extend([x0, y0, x1, y1]);
    }

    /// From COCO's uncompressed run lengths, which begin with zeros. `None` if their sum is not the size of the image.
    pub fn from_runs(width: usize, height: usize, runs: &[u64]) -> Option<Self> {
        let total = runs.iter().try_fold(0u64, |sum, run| sum.checked_add(*run))?;
        if width.checked_mul(height).is_none_or(|area| area as u64 != total) {
            return None;
        }
        let (mut mask, mut at) = (Self::new(width, height), 0usize);
        for (index, &run) in runs.iter().enumerate() {
            let end = at + run as usize;
            if index % 2 == 1 {
                mask.fill(at, end);
            }
            at = end;
        }
        Some(mask)
    }

    /// From COCO's run lengths packed into text (`rleToString` of its tools).
    pub fn from_packed(width: usize, height: usize, text: &str) -> Option<Self> {
        let mut runs: Vec<i64> = Vec::new();
        let mut bytes = text.bytes();
        while let Some(mut byte) = bytes.next() {
            let (mut value, mut shift) = (0i64, 0u32);
            loop {
                let part = i64::from(byte.checked_sub(48)?);
                if shift > 55 {
                    return None;
                }
                value |= (part & 0x1f) << shift;
                shift += 5;
                if part & 0x20 == 0 {
                    if part & 0x10 != 0 {
                        value |= -1 << shift;
                    }
                    break;
                }
                byte = bytes.next()?;
            }
            if runs.len() > 2 {
                value = value.checked_add(runs[runs.len() - 2])?;
            }
            runs.push(value);
        }
        let runs: Vec<u64> = runs.into_iter().map(|r| u64::try_from(r).ok()).collect::<Option<_>>()?;
        Self::from_runs(width, height, &runs)
    }

    /// Adds a polygon of x, y pairs by the even-odd rule, evaluated at pixel centres.
    pub fn add_polygon(&mut self, points: &[[f64; 2]]) {
        let mut crossings = Vec::new();
        let (top, bottom) =
            points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p[1]), b.max(p[1])));
        // A cast of a float ends at 0; rows outside the polygon have no crossing.
        for y in (top - 1.0) as usize..self.height.min((bottom + 1.0) as usize) {
            let middle = y as f64 + 0.5;
            crossings.clear();
            for (index, a) in points.iter().enumerate() {
                let b = points[(index + 1) % points.len()];
                if (a[1] <= middle) != (b[1] <= middle) {
                    crossings.push(a[0] + (middle - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
                }
            }
            crossings.sort_by(f64::total_cmp);
            for pair in crossings.chunks_exact(2) {
                let from = (pair[0] - 0.5).ceil().max(0.0) as usize;
                let to = (pair[1] - 0.5).ceil().clamp(0.0, self.width as f64) as usize;
                (from..to).for_each(|x| self.set(x, y));
            }
        }
    }

    /// Run lengths, beginning with zeros.
    pub fn runs(&self) -> Vec<u64> {
        let (mut out, mut run, mut last) = (Vec::new(), 0, false);
        for bit in 0..self.width * self.height {
            let set = self.words[bit / 64] >> (bit % 64) & 1 == 1;
            if set != last {
                out.push(run);
                (run, last) = (0, set);
            }
            run += 1;
        }
        out.push(run);
        out
    }

    /// Number of pixels that both have; masks of different sizes share none.
    pub fn common(&self, other: &Self) -> u64 {
        if (self.width, self.height) != (other.width, other.height) {
            return 0;
        }
        self.words.iter().zip(&other.words).map(|(a, b)| u64::from((a & b).count_ones())).sum()
    }

    /// Left, top, width, height of the set bits; all zero if none is set.
    pub fn bounds(&self) -> [f64; 4] {
        let Some([x0, y0, x1, y1]) = self.extent else { return [0.0; 4] };
        [x0 as f64, y0 as f64, (x1 - x0 + 1) as f64, (y1 - y0 + 1) as f64]
    }
}

#[cfg(test)]
mod tests {
    use super::Mask;

    #[test]
    fn runs_go_down_the_columns_and_come_back() {
        let mask = Mask::from_runs(3, 2, &[0, 2, 1, 2, 1]).unwrap();
        assert!(mask.at(0, 0) && mask.at(0, 1) && !mask.at(1, 0) && mask.at(1, 1) && mask.at(2, 0) && !mask.at(2, 1));
        assert_eq!((mask.area, mask.runs(), mask.bounds()), (4, vec![0, 2, 1, 2, 1], [0.0, 0.0, 3.0, 2.0]));
        assert_eq!(Mask::from_runs(3, 2, &[0, 2, 1]), None, "too short");
        assert_eq!(Mask::from_runs(3, 2, &[u64::MAX, 7]), None);
    }

    #[test]
    fn packed_runs_are_read_as_cocos_tools_write_them() {
        // A block of 3 x 2 in 5 x 4: 5, 2, 2, 2, 2, 2, 5 is written as 5, 2, 2, then differences to the value two before: 0, 0, 0, 3.
        let mask = Mask::from_packed(5, 4, "5220003").unwrap();
        assert_eq!(mask.runs(), [5, 2, 2, 2, 2, 2, 5]);
        assert_eq!(Mask::from_packed(5, 4, "52200"), None);
        assert_eq!(Mask::from_packed(5, 4, "\u{1}"), None);
        // Each difference adds 2^59 to the value two before: the sum leaves 64 bits.
        assert_eq!(Mask::from_packed(5, 4, &"ooooooooooo?".repeat(40)), None);
        assert_eq!(Mask::from_runs(1 << 32, 1 << 32, &[0]), None, "an area beyond 64 bits");
    }

    #[test]
    fn runs_over_words_and_columns_set_every_bit() {
        for (start, len) in [(0, 1), (3, 60), (60, 8), (0, 64), (63, 130), (127, 1), (64, 64), (5, 195)] {
            let mask = Mask::from_runs(10, 20, &[start, len, 200 - start - len]).unwrap();
            let mut slow = Mask::new(10, 20);
            (start..start + len).for_each(|bit| slow.set(bit as usize / 20, bit as usize % 20));
            assert_eq!(mask, slow, "{start} {len}");
        }
    }

    #[test]
    fn a_polygon_covers_the_pixels_whose_centres_it_holds() {
        let mut mask = Mask::new(6, 5);
        mask.add_polygon(&[[1.0, 1.0], [4.0, 1.0], [4.0, 3.0], [1.0, 3.0]]);
        assert_eq!((mask.area, mask.bounds()), (6, [1.0, 1.0, 3.0, 2.0]));
        mask.add_polygon(&[[-5.0, 3.4], [60.0, 3.4], [60.0, 40.0], [-5.0, 40.0]]);
        assert_eq!(mask.area, 6 + 12, "cut off at the edges");
    }
}
