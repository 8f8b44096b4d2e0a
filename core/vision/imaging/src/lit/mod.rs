//! The lit part of a view: the area that the scope's optics show, without the dark rim around it.
//!
//! Round and bordered scopes, letterboxed recordings and rectified views have rims. A rim has the same position in both
//! views, so that matching mistakes it for a surface, and a panorama shows it as a black wedge. [`LitFinder`] finds the
//! part from the frames; later stages use a [`LitPart`].

mod finder;

pub use finder::LitFinder;

use crate::{View, ViewMut};

/// For each row of a view, the columns that are lit: one run, which may be empty.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LitPart {
    width: usize,
    rows: Vec<[u32; 2]>,
}

impl LitPart {
    /// A view of which everything is lit.
    pub fn whole(width: usize, height: usize) -> Self {
        Self { width, rows: vec![[0, width as u32]; height] }
    }

    /// Whether everything is lit.
    pub fn is_whole(&self) -> bool {
        self.rows.iter().all(|row| *row == [0, self.width as u32])
    }

    /// Columns and rows of the view.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.rows.len())
    }

    /// Lit columns of a row; none below the last row.
    pub fn row(&self, y: usize) -> std::ops::Range<usize> {
        let [start, end] = self.rows.get(y).copied().unwrap_or_default();
        start as usize..end as usize
    }

    /// Whether a pixel is lit.
    pub fn contains(&self, x: usize, y: usize) -> bool {
        self.row(y).contains(&x)
    }

    /// Sets the lit columns of a row; columns beyond the view are clipped.
    pub(crate) fn set_row(&mut self, y: usize, columns: std::ops::Range<usize>) {
        let (start, end) = (columns.start.min(self.width), columns.end.min(self.width));
        self.rows[y] = if start < end { [start as u32, end as u32] } else { [0, 0] };
    }

    /// Sets the part from a mask: the longest run of pixels above 0 in each row.
    pub fn read_mask(&mut self, mask: View<'_, u8>) {
        self.width = mask.width;
        self.rows.clear();
        for y in 0..mask.height {
            let row = mask.row(y);
            let (mut best, mut x) = ([0, 0], 0);
            while let Some(start) = row[x..].iter().position(|value| *value > 0).map(|skip| x + skip) {
                x = row[start..].iter().position(|value| *value == 0).map_or(row.len(), |length| start + length);
                if x - start > best[1] - best[0] {
                    best = [start, x];
                }
            }
            self.rows.push(best.map(|x| x as u32));
        }
    }

    /// Writes 255 where the view is lit and 0 elsewhere. `mask` has the view's size.
    pub fn write_mask(&self, mut mask: ViewMut<'_, u8>) {
        for y in 0..mask.height {
            let lit = self.row(y);
            let row = mask.row_mut(y);
            row.fill(0);
            row[lit].fill(255);
        }
    }

    /// Keeps the pixels that are lit in both, which have one size.
    pub fn intersect(&mut self, other: &Self) {
        for y in 0..self.rows.len() {
            let (a, b) = (self.row(y), other.row(y));
            self.set_row(y, a.start.max(b.start)..a.end.min(b.end));
        }
    }

    /// Removes pixels within `px` of the rim in all directions. The border of the view is not a rim.
    pub fn inset(&self, px: usize, out: &mut Self) {
        out.width = self.width;
        out.rows.clear();
        out.rows.resize(self.rows.len(), [0, 0]);
        for y in 0..self.rows.len() {
            let (mut start, mut end) = (0, self.width);
            for near in y.saturating_sub(px)..(y + px + 1).min(self.rows.len()) {
                let row = self.row(near);
                (start, end) = (start.max(row.start), end.min(row.end));
            }
            let start = if start > 0 { start + px } else { 0 };
            let end = if end < self.width { end.saturating_sub(px) } else { end };
            out.set_row(y, start..end);
        }
    }

    /// The same part of a view shrunk by a whole factor: blocks that are lit as a whole.
    pub fn shrunk(&self, factor: usize, out: &mut Self) {
        out.width = self.width / factor;
        out.rows.clear();
        out.rows.resize(self.rows.len() / factor, [0, 0]);
        for y in 0..out.rows.len() {
            let (mut start, mut end) = (0, self.width);
            for row in (y * factor..(y + 1) * factor).map(|y| self.row(y)) {
                (start, end) = (start.max(row.start), end.min(row.end));
            }
            out.set_row(y, start.div_ceil(factor)..end / factor);
        }
    }

    /// Share of the view's pixels that are lit, 0..=1.
    pub fn share(&self) -> f64 {
        let lit: usize = self.rows.iter().map(|[start, end]| (end - start) as usize).sum();
        lit as f64 / (self.width * self.rows.len()).max(1) as f64
    }

    /// Share of a rectangle's area that is lit, 0..=1; `[x0, y0, x1, y1]` in px.
    pub fn share_of(&self, [x0, y0, x1, y1]: [f32; 4]) -> f32 {
        let (height, width) = (self.rows.len() as f32, self.width as f32);
        let (top, bottom) = (y0.clamp(0.0, height) as usize, y1.ceil().clamp(0.0, height) as usize);
        let (x0, x1) = (x0.clamp(0.0, width), x1.clamp(0.0, width));
        if top >= bottom || x0 >= x1 {
            return 0.0;
        }
        let lit: f32 = (top..bottom)
            .map(|y| {
                let row = self.row(y);
                ((row.end as f32).min(x1) - (row.start as f32).max(x0)).max(0.0)
            })
            .sum();
        lit / ((bottom - top) as f32 * (x1 - x0))
    }
}

/// The lit part of a view according to a mask, read only when the mask changes.
#[derive(Debug, Default)]
pub struct HeldMask {
    mask: Vec<u8>,
    part: LitPart,
    is_set: bool,
}

impl HeldMask {
    /// Follows the mask of this frame; without one everything is lit. Returns whether the part has changed.
    pub fn update(&mut self, mask: Option<View<'_, u8>>) -> bool {
        let Some(mask) = mask else { return std::mem::replace(&mut self.is_set, false) };
        let size = (mask.width, mask.height);
        let is_same = self.is_set
            && self.part.size() == size
            && (0..size.1).all(|y| self.mask[y * size.0..(y + 1) * size.0] == *mask.row(y));
        if is_same {
            return false;
        }
        self.mask.clear();
        (0..size.1).for_each(|y| self.mask.extend_from_slice(mask.row(y)));
        self.part.read_mask(mask);
        self.is_set = true;
        true
    }

    /// The lit part; `None` if everything is lit.
    pub fn part(&self) -> Option<&LitPart> {
        self.is_set.then_some(&self.part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (40, 30);

    fn disc() -> LitPart {
        let mut part = LitPart::whole(SIZE.0, SIZE.1);
        for y in 0..SIZE.1 {
            let half = (196.0 - (y as f64 - 14.5).powi(2)).max(0.0).sqrt();
            part.set_row(y, (20.0 - half).ceil() as usize..(20.0 + half) as usize);
        }
        part
    }

    #[test]
    fn a_mask_gives_back_the_part() {
        let mut bytes = vec![7; SIZE.0 * SIZE.1];
        disc().write_mask(ViewMut::new(&mut bytes, SIZE.0, SIZE.1, 1));
        let mut part = LitPart::default();
        part.read_mask(View::new(&bytes, SIZE.0, SIZE.1, 1));
        assert_eq!(part, disc());
        // A speck outside is not the lit part of its row.
        bytes[10 * SIZE.0 + 1] = 255;
        part.read_mask(View::new(&bytes, SIZE.0, SIZE.1, 1));
        assert_eq!(part, disc());
        assert!(LitPart::whole(4, 4).is_whole() && !part.is_whole());
    }

    #[test]
    fn an_inset_part_keeps_its_distance_from_the_rim_only() {
        let (disc, mut inset) = (disc(), LitPart::default());
        disc.inset(3, &mut inset);
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                let near = |a: usize, size: usize| a.saturating_sub(3)..(a + 4).min(size);
                let clear = near(y, SIZE.1).all(|y| near(x, SIZE.0).all(|x| disc.contains(x, y)));
                assert_eq!(inset.contains(x, y), clear, "{x}, {y}");
            }
        }
        let mut whole = LitPart::default();
        LitPart::whole(9, 9).inset(2, &mut whole);
        assert!(whole.is_whole());
    }

    #[test]
    fn a_shrunk_part_holds_whole_blocks() {
        let (disc, mut small) = (disc(), LitPart::default());
        disc.shrunk(2, &mut small);
        assert_eq!(small.size(), (20, 15));
        for y in 0..15 {
            for x in 0..20 {
                let all = (0..4).all(|i| disc.contains(2 * x + i % 2, 2 * y + i / 2));
                assert_eq!(small.contains(x, y), all);
            }
        }
    }

    #[test]
    fn shares_count_lit_area() {
        let mut part = LitPart::whole(10, 10);
        (0..10).for_each(|y| part.set_row(y, 4..10));
        assert!((part.share() - 0.6).abs() < 1e-9);
        assert!((part.share_of([0.0, 0.0, 8.0, 5.0]) - 0.5).abs() < 1e-6);
        assert_eq!(part.share_of([-9.0, 0.0, -1.0, 5.0]), 0.0);
        let mut other = LitPart::whole(10, 10);
        (0..10).for_each(|y| other.set_row(y, 0..6));
        part.intersect(&other);
        assert_eq!(part.row(3), 4..6);
    }

    #[test]
    fn a_mask_that_stays_is_read_once() {
        let mut bytes = vec![0; SIZE.0 * SIZE.1];
        disc().write_mask(ViewMut::new(&mut bytes, SIZE.0, SIZE.1, 1));
        let mut held = HeldMask::default();
        assert!(held.update(Some(View::new(&bytes, SIZE.0, SIZE.1, 1))) && held.part() == Some(&disc()));
        assert!(!held.update(Some(View::new(&bytes, SIZE.0, SIZE.1, 1))));
        bytes[15 * SIZE.0 + 20] = 0;
        assert!(held.update(Some(View::new(&bytes, SIZE.0, SIZE.1, 1))));
        assert!(held.update(None) && held.part().is_none() && !held.update(None));
    }
}
