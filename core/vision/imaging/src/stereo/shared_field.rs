//! Clears disparities outside the field that both views share. Only one camera sees those pixels, so they cannot be matched.
//!
//! Close to the left view's left border only the small disparities have a counterpart inside the right view, and a matcher takes
//! the best of them: a false, consistent surface. The right view's first columns cover the whole search range, so their
//! disparities show where the shared field begins. The right view's right border is treated the same way, mirrored.

use std::ops::Range;

use super::StereoError;
use super::pair::{PairMaps, RowEdit};
use crate::lit::LitPart;
use crate::{Parallel, Rect, View};

/// Columns at the other view's border whose disparities are used.
const COLUMNS: usize = 24;
/// Rows per measurement of the border.
const BLOCK_ROWS: usize = 16;
/// A block needs one matched pixel in this many.
const MIN_SHARE: usize = 16;
/// Pixels this near to the edge are not cleared, px.
const SLACK_PX: f32 = 2.0;

/// Finds the edges of the field and clears what is outside. Allocates only for a larger size than before.
#[derive(Clone, Debug, Default)]
pub struct SharedField {
    known: Vec<f32>,
    /// Disparity at the border of the right view, and of the left one, for each block of rows; NaN where too little is known.
    borders: [Vec<f32>; 2],
    edits: Vec<RowEdit>,
}

impl SharedField {
    /// Sets pixels left of the shared field to NaN in the left map (px, inside `roi`), and, if the right map is read, pixels right of it there, in the
    /// rows of `roi`; views have this size. Rows where the other view's border is not matched stay unchanged. So do rows in which
    /// either view begins with a rim: the first columns of one then need not lie within the other. `lit` is what of the left and right view is matched, when
    /// that is not all.
    ///
    /// # Errors
    /// Those of the maps.
    pub fn clear_outside(
        &mut self,
        maps: &mut dyn PairMaps,
        (width, height): (usize, usize),
        roi: Rect,
        lit: Option<&[LitPart; 2]>,
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        let roi = roi.clamped(width, height);
        if roi.is_empty() {
            return Ok(());
        }
        let end = roi.x + roi.width;
        let begins = |y: usize| lit.is_none_or(|parts| parts.iter().all(|part| part.row(y).start < COLUMNS));
        let closes = |y: usize| lit.is_none_or(|parts| parts.iter().all(|part| part.row(y).end + COLUMNS > end));
        let right_is_read = maps.right_is_read();
        let [first, last] = &mut self.borders;
        border_disparities(maps.columns(1, 0..COLUMNS.min(width))?, begins, roi, &mut self.known, first);
        if right_is_read {
            let columns = end.saturating_sub(COLUMNS).max(roi.x)..end;
            border_disparities(maps.columns(0, columns)?, closes, roi, &mut self.known, last);
        }
        // What the right view's first column shows lies `d` columns from the left view's border, and the other way round.
        let until = |d: f32| (d - SLACK_PX).clamp(0.0, end as f32) as usize;
        let from = |d: f32| (end as f32 - d + SLACK_PX).clamp(0.0, width as f32) as usize;
        let edits = &mut self.edits;
        take_edits(edits, (roi, height), |row| {
            let d = at_row(&self.borders[0], row).filter(|_| begins(roi.y + row));
            d.map(until).filter(|until| *until > roi.x).map(|until| until..width)
        });
        maps.edit(0, edits, pool)?;
        if right_is_read {
            take_edits(edits, (roi, height), |row| {
                at_row(&self.borders[1], row).filter(|_| closes(roi.y + row)).map(|d| 0..from(d))
            });
            maps.edit(1, edits, pool)?;
        }
        Ok(())
    }
}

/// Sets the columns that stay in the region's rows; all stay in the others and where there is no answer.
fn take_edits(edits: &mut Vec<RowEdit>, (roi, height): (Rect, usize), keep: impl Fn(usize) -> Option<Range<usize>>) {
    edits.clear();
    edits.resize(height, RowEdit::NONE);
    for (row, edit) in edits[roi.y..roi.y + roi.height].iter_mut().enumerate() {
        *edit = keep(row).map_or(RowEdit::NONE, RowEdit::keep);
    }
}

/// Median disparity of these columns of a map, for each block of the region's rows, over those that `counts`.
fn border_disparities(
    columns: View<'_, f32>,
    counts: impl Fn(usize) -> bool,
    roi: Rect,
    known: &mut Vec<f32>,
    borders: &mut Vec<f32>,
) {
    let blocks = roi.height.div_ceil(BLOCK_ROWS);
    borders.clear();
    borders.reserve(blocks);
    known.reserve(BLOCK_ROWS * COLUMNS);
    for block in 0..blocks {
        known.clear();
        let rows = roi.y + block * BLOCK_ROWS..(roi.y + (block + 1) * BLOCK_ROWS).min(roi.y + roi.height);
        let pixels = rows.len() * columns.width;
        for y in rows.filter(|y| counts(*y)) {
            known.extend(columns.row(y).iter().copied().filter(|d| d.is_finite()));
        }
        let middle = known.len() / 2;
        let enough = known.len() * MIN_SHARE >= pixels.max(1);
        borders.push(if enough { *known.select_nth_unstable_by(middle, f32::total_cmp).1 } else { f32::NAN });
    }
}

/// Disparity at the border in a row of the region, between the nearest blocks that know it.
fn at_row(borders: &[f32], row: usize) -> Option<f32> {
    let at = (row as f32 + 0.5) / BLOCK_ROWS as f32 - 0.5;
    let below = at.floor().max(-1.0) as isize;
    let known = |block: &usize| borders[*block].is_finite();
    let before = (0..((below + 1).max(0) as usize).min(borders.len())).rev().find(known);
    let after = ((below + 1).max(0) as usize..borders.len()).find(known);
    match (before, after) {
        (Some(a), Some(b)) => {
            let part = ((at - a as f32) / (b - a) as f32).clamp(0.0, 1.0);
            Some(borders[a] * (1.0 - part) + borders[b] * part)
        }
        (a, b) => a.or(b).map(|block| borders[block]),
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
    use crate::Serial;
    use crate::stereo::pair::testing::with_maps;

    const SIZE: (usize, usize) = (120, 70);

    fn clear(maps: [&mut Vec<f32>; 2], right_is_read: bool, roi: Rect, lit: Option<&[LitPart; 2]>) {
        let mut field = SharedField::default();
        with_maps(maps, SIZE, right_is_read, |maps| field.clear_outside(maps, SIZE, roi, lit, &Serial));
    }

    #[test]
    fn what_only_one_camera_sees_is_cleared() {
        let edge = |y: usize| 30.0 + y as f32 * 0.1;
        let mut left = vec![5.0f32; SIZE.0 * SIZE.1];
        let mut right = vec![5.0f32; SIZE.0 * SIZE.1];
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                let at = y * SIZE.0 + x;
                if x as f32 >= edge(y) {
                    left[at] = edge(y);
                }
                if x as f32 <= SIZE.0 as f32 - edge(y) {
                    right[at] = edge(y);
                }
                // Rows 16 to 31 are not matched at the views' borders: their neighbours' value is used.
                if (16..32).contains(&y) {
                    if x < COLUMNS {
                        right[at] = f32::NAN;
                    }
                    if x >= SIZE.0 - COLUMNS {
                        left[at] = f32::NAN;
                    }
                }
            }
        }
        let (map, map_right) = (left.clone(), right.clone());
        clear([&mut left, &mut right], true, Rect::whole(SIZE.0, SIZE.1), None);
        for y in 0..SIZE.1 {
            let at = y * SIZE.0..(y + 1) * SIZE.0;
            let (row, before) = (&left[at.clone()], &map[at.clone()]);
            let first = row.iter().position(|d| d.is_finite()).unwrap();
            assert!((first as f32 - edge(y)).abs() <= SLACK_PX + 2.0, "row {y}: {first}");
            let inside = edge(y).ceil() as usize;
            assert!(row[inside..].iter().zip(&before[inside..]).all(|(a, b)| a.to_bits() == b.to_bits()));
            let (row, before) = (&right[at.clone()], &map_right[at]);
            let last = row.iter().rposition(|d| d.is_finite()).unwrap();
            assert!((last as f32 - (SIZE.0 as f32 - edge(y))).abs() <= SLACK_PX + 2.0, "right, row {y}: {last}");
            let inside = SIZE.0 - inside;
            assert!(row[..inside].iter().zip(&before[..inside]).all(|(a, b)| a.to_bits() == b.to_bits()));
        }
    }

    #[test]
    fn rows_that_begin_with_a_rim_stay() {
        // Up to row 32 the right view begins at column 40: farther in than a border is.
        let mut right_part = LitPart::whole(SIZE.0, SIZE.1);
        (0..32).for_each(|y| right_part.set_row(y, 40..SIZE.0));
        let parts = [LitPart::whole(SIZE.0, SIZE.1), right_part];
        let mut maps = [vec![9.0f32; SIZE.0 * SIZE.1], vec![9.0f32; SIZE.0 * SIZE.1]];
        clear(maps.each_mut(), false, Rect::whole(SIZE.0, SIZE.1), Some(&parts));
        for (y, row) in maps[0].chunks_exact(SIZE.0).enumerate() {
            assert_eq!(row.iter().position(|d| d.is_finite()), Some(if y < 32 { 0 } else { 7 }), "row {y}");
        }
    }

    #[test]
    fn without_an_answer_nothing_is_cleared() {
        for unknown in 0..2 {
            let mut maps = [vec![5.0f32; SIZE.0 * SIZE.1], vec![5.0f32; SIZE.0 * SIZE.1]];
            maps[unknown].fill(f32::NAN);
            clear(maps.each_mut(), true, Rect::whole(SIZE.0, SIZE.1), None);
            assert!(maps[1 - unknown].iter().all(|d| *d == 5.0));
        }
    }

    #[test]
    fn other_rows_stay() {
        let mut maps = [vec![9.0f32; SIZE.0 * SIZE.1], vec![9.0f32; SIZE.0 * SIZE.1]];
        clear(maps.each_mut(), true, Rect { x: 0, y: 20, width: SIZE.0, height: 30 }, None);
        for map in &maps {
            for (y, row) in map.chunks_exact(SIZE.0).enumerate() {
                let gone = row.iter().filter(|d| d.is_nan()).count();
                assert_eq!(gone, if (20..50).contains(&y) { 7 } else { 0 }, "row {y}");
            }
        }
    }

    #[test]
    fn a_counterpart_outside_the_right_view_is_seen_by_one() {
        assert!(is_seen_by_both(30, 30.0, 100) && !is_seen_by_both(30, 31.0, 100));
        assert!(is_seen_by_both(99, 0.0, 100) && !is_seen_by_both(99, -2.0, 100) && !is_seen_by_both(5, f32::NAN, 100));
    }
}
