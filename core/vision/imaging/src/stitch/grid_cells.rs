//! The cells of a grid on the area that two views share, and the ends of that area.

use std::ops::Range;

use crate::Rect;

/// Share of the matched pixels, in per mille, that may be beyond each side of the shared area: wrong matches.
const BEYOND_PER_MILLE: u64 = 10;

/// A grid on an area, px.
pub(super) struct Cells {
    pub area: Rect,
    pub rows: usize,
    pub columns: usize,
    /// Spacing of the pixels that are used.
    pub step: usize,
}

impl Cells {
    pub fn column(&self, at: usize) -> Range<usize> {
        let Rect { x, width, .. } = self.area;
        x + at * width / self.columns..x + (at + 1) * width / self.columns
    }

    pub fn row(&self, at: usize) -> Range<usize> {
        let Rect { y, height, .. } = self.area;
        y + at * height / self.rows..y + (at + 1) * height / self.rows
    }

    /// The pixels of a cell that are used, along one axis.
    pub fn sampled(&self, range: Range<usize>) -> impl Iterator<Item = usize> + use<> {
        (range.start + self.step / 2..range.end).step_by(self.step)
    }
}

/// Position of the entry at which the sum first exceeds `few`.
fn beyond<'a>(mut counts: impl Iterator<Item = &'a u32>, few: u32) -> Option<usize> {
    let mut sum = 0;
    counts.position(|count| {
        sum += count;
        sum > few
    })
}

/// First entry and length of the part of `counts` that holds all of `total` but a few at each end.
pub(super) fn bounds(counts: &[u32], total: u32, step: usize) -> (usize, usize) {
    let few = (u64::from(total) * BEYOND_PER_MILLE / 1000) as u32;
    let (Some(first), Some(last)) = (beyond(counts.iter(), few), beyond(counts.iter().rev(), few)) else {
        return (0, 0);
    };
    let (start, end) = (first.saturating_sub(step / 2), (counts.len() - last + step / 2).min(counts.len()));
    (start, end.saturating_sub(start))
}
