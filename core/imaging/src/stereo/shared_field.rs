//! What lies left of the field that both views share is seen by the left camera alone: nothing can be known of it.
//!
//! Close to the left view's border only the small disparities have a counterpart inside the right view, and a matcher takes the best
//! of what there is: false surface that is consistent with itself. The right view's first columns see the whole search, so their
//! disparities tell where the shared field begins.

use crate::stereo::Roi;
use crate::{View, ViewMut};

/// Columns of the right view that are asked.
const COLUMNS: usize = 24;
/// Rows that answer together.
const BLOCK_ROWS: usize = 16;
/// Part of a block's pixels that must be matched.
const LEAST_SHARE: usize = 16;
/// A pixel this near to the edge is still believed, px.
const SLACK_PX: f32 = 2.0;

/// Finds the field's left edge and clears what lies before it; nothing is allocated once a size has been seen.
#[derive(Clone, Debug, Default)]
pub struct SharedField {
    known: Vec<f32>,
    edges: Vec<f32>,
}

impl SharedField {
    /// Clears the pixels of `disparity` (left view, px) inside `roi` that lie left of the shared field. `right` is the right view's
    /// map of the same call. Where its first columns are matched nowhere, nothing is cleared.
    pub fn keep(&mut self, disparity: &mut ViewMut<'_, f32>, right: View<'_, f32>, roi: Roi) {
        let roi = roi.clamped(disparity.width.min(right.width), disparity.height.min(right.height));
        if roi.is_empty() {
            return;
        }
        let blocks = roi.height.div_ceil(BLOCK_ROWS);
        self.edges.clear();
        self.edges.reserve(blocks);
        self.known.reserve(BLOCK_ROWS * COLUMNS);
        for block in 0..blocks {
            self.known.clear();
            let rows = roi.y + block * BLOCK_ROWS..(roi.y + (block + 1) * BLOCK_ROWS).min(roi.y + roi.height);
            let pixels = rows.len() * COLUMNS.min(right.width);
            for y in rows {
                let first = &right.row(y)[..COLUMNS.min(right.width)];
                self.known.extend(first.iter().copied().filter(|d| d.is_finite()));
            }
            // What the first column shows lies `d` columns from the left view's border.
            let middle = self.known.len() / 2;
            let enough = self.known.len() * LEAST_SHARE >= pixels.max(1);
            self.edges.push(if enough {
                *self.known.select_nth_unstable_by(middle, f32::total_cmp).1
            } else {
                f32::NAN
            });
        }
        for row in 0..roi.height {
            let Some(edge) = self.edge(row) else { return };
            let end = (edge - SLACK_PX).clamp(0.0, (roi.x + roi.width) as f32) as usize;
            if end > roi.x {
                disparity.row_mut(roi.y + row)[roi.x..end].fill(f32::NAN);
            }
        }
    }

    /// Edge in a row of the region, between the nearest blocks that know it.
    fn edge(&self, row: usize) -> Option<f32> {
        let at = (row as f32 + 0.5) / BLOCK_ROWS as f32 - 0.5;
        let below = at.floor().max(-1.0) as isize;
        let known = |block: &usize| self.edges[*block].is_finite();
        let before = (0..((below + 1).max(0) as usize).min(self.edges.len())).rev().find(known);
        let after = ((below + 1).max(0) as usize..self.edges.len()).find(known);
        match (before, after) {
            (Some(a), Some(b)) => {
                let part = ((at - a as f32) / (b - a) as f32).clamp(0.0, 1.0);
                Some(self.edges[a] * (1.0 - part) + self.edges[b] * part)
            }
            (a, b) => a.or(b).map(|block| self.edges[block]),
        }
    }
}

/// Whether the counterpart of column `x` at disparity `value` lies inside a right view of `width` columns. NaN does not.
#[inline]
pub(crate) fn is_seen_by_both(x: usize, value: f32, width: usize) -> bool {
    let other = x as f32 - value;
    (other >= -0.5) & (other <= width as f32 - 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (120, 70);

    #[test]
    fn what_only_the_left_camera_sees_is_cleared() {
        let edge = |y: usize| 30.0 + y as f32 * 0.1;
        let mut left = vec![5.0f32; SIZE.0 * SIZE.1];
        let mut right = vec![f32::NAN; SIZE.0 * SIZE.1];
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                if x as f32 >= edge(y) {
                    left[y * SIZE.0 + x] = edge(y);
                }
                // Rows 16 to 31 are not matched at the right view's border: their neighbours answer for them.
                if !(16..32).contains(&y) && x < 60 {
                    right[y * SIZE.0 + x] = edge(y);
                }
            }
        }
        let mut field = SharedField::default();
        let map = &mut ViewMut::new(&mut left, SIZE.0, SIZE.1, 1);
        field.keep(map, View::new(&right, SIZE.0, SIZE.1, 1), Roi::full(SIZE.0, SIZE.1));
        for y in 0..SIZE.1 {
            let row = &left[y * SIZE.0..(y + 1) * SIZE.0];
            let first = row.iter().position(|d| d.is_finite()).unwrap();
            assert!((first as f32 - edge(y)).abs() <= SLACK_PX + 2.0, "row {y}: {first}");
            assert!(row[edge(y).ceil() as usize..].iter().all(|d| d.is_finite()));
        }
    }

    #[test]
    fn without_an_answer_nothing_is_cleared() {
        let mut left = vec![5.0f32; SIZE.0 * SIZE.1];
        let right = vec![f32::NAN; SIZE.0 * SIZE.1];
        let map = &mut ViewMut::new(&mut left, SIZE.0, SIZE.1, 1);
        SharedField::default().keep(map, View::new(&right, SIZE.0, SIZE.1, 1), Roi::full(SIZE.0, SIZE.1));
        assert!(left.iter().all(|d| *d == 5.0));
    }

    #[test]
    fn a_counterpart_outside_the_right_view_is_seen_by_one() {
        assert!(is_seen_by_both(30, 30.0, 100) && !is_seen_by_both(30, 31.0, 100));
        assert!(is_seen_by_both(99, 0.0, 100) && !is_seen_by_both(99, -2.0, 100) && !is_seen_by_both(5, f32::NAN, 100));
    }
}
