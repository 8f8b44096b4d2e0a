//! Clears disparities outside the lit parts of a pair.
//!
//! A rim lies at one place in both views. Blocks that reach over it match it to itself, at a disparity that has nothing to do with the tissue beside it.

use crate::lit::LitPart;
use crate::{Parallel, SharedMut, ViewMut};

/// Rows of a map per chunk.
const ROWS: usize = 32;

/// The lit parts of both views. Computes only when they change.
#[derive(Debug, Default)]
pub struct LitPair {
    given: [LitPart; 2],
    rim_px: usize,
    /// What is far enough from a rim.
    clear: [LitPart; 2],
    is_set: bool,
}

impl LitPair {
    /// Takes the parts of the left and right view, of one size; a view without one is lit as a whole. Pixels within
    /// `rim_px` of a rim are not matched.
    pub fn set(&mut self, parts: [Option<&LitPart>; 2], rim_px: usize) {
        let Some(size) = parts.iter().flatten().next().map(|part| part.size()) else {
            self.is_set = false;
            return;
        };
        let is_same = |held: &LitPart, part: Option<&LitPart>| match part {
            Some(part) => held == part,
            None => held.size() == size && held.is_whole(),
        };
        if self.is_set && self.rim_px == rim_px && (0..2).all(|view| is_same(&self.given[view], parts[view])) {
            return;
        }
        (self.is_set, self.rim_px) = (true, rim_px);
        for (view, part) in parts.into_iter().enumerate() {
            self.given[view] = part.cloned().unwrap_or_else(|| LitPart::whole(size.0, size.1));
            self.given[view].inset(rim_px, &mut self.clear[view]);
        }
    }

    /// The parts of views of this size that are matched; `None` when both are lit as a whole.
    pub fn clear_parts(&self, size: (usize, usize)) -> Option<&[LitPart; 2]> {
        (self.is_set && self.clear.iter().all(|part| part.size() == size)).then_some(&self.clear)
    }

    /// Sets pixels of `map` (of the left view, or of the right one with `is_right`) to NaN that lie, or whose counterparts lie, on
    /// a rim or near it.
    pub fn clear_map(&self, map: &mut ViewMut<'_, f32>, is_right: bool, pool: &dyn Parallel) {
        let (width, height, stride) = (map.width, map.height, map.stride);
        let Some(parts) = self.clear_parts((width, height)) else { return };
        let (own, other) = (&parts[usize::from(is_right)], &parts[usize::from(!is_right)]);
        let sign = if is_right { 1.0 } else { -1.0 };
        let target = SharedMut::new(&mut *map.data);
        pool.run(height.div_ceil(ROWS), &|chunk| {
            for y in chunk * ROWS..(chunk * ROWS + ROWS).min(height) {
                // SAFETY: every row belongs to one chunk.
                let row = unsafe { target.part(y * stride, width) };
                let (lit, there) = (own.row(y), other.row(y));
                row[..lit.start].fill(f32::NAN);
                row[lit.end..].fill(f32::NAN);
                let (first, last) = (there.start as f32 - 0.5, there.end as f32 - 0.5);
                for (x, value) in row[lit.clone()].iter_mut().enumerate() {
                    let at = (lit.start + x) as f32 + sign * *value;
                    // NaN fails.
                    *value = if (at >= first) & (at <= last) { *value } else { f32::NAN };
                }
            }
        });
    }

    /// Sets pixels of the left map that lie on the rim to NaN.
    pub fn clear_rim(&self, map: &mut ViewMut<'_, f32>) {
        if !self.is_set || self.given[0].size() != (map.width, map.height) {
            return;
        }
        for y in 0..map.height {
            let lit = self.given[0].row(y);
            let row = map.row_mut(y);
            row[..lit.start].fill(f32::NAN);
            row[lit.end..].fill(f32::NAN);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Serial;

    const SIZE: (usize, usize) = (60, 20);

    fn columns(range: std::ops::Range<usize>) -> LitPart {
        let mut part = LitPart::whole(SIZE.0, SIZE.1);
        (0..SIZE.1).for_each(|y| part.set_row(y, range.clone()));
        part
    }

    fn known(map: &[f32]) -> Vec<usize> {
        (0..SIZE.0).filter(|x| map[5 * SIZE.0 + x].is_finite()).collect()
    }

    #[test]
    fn a_pixel_counts_only_when_both_blocks_are_lit() {
        let (left, right) = (columns(10..60), columns(0..45));
        let mut pair = LitPair::default();
        pair.set([Some(&left), Some(&right)], 3);
        let mut map = vec![5.0f32; SIZE.0 * SIZE.1];
        pair.clear_map(&mut ViewMut::new(&mut map, SIZE.0, SIZE.1, 1), false, &Serial);
        // Left from 13 on, right up to 41, which lies 5 px further right in the left view.
        assert_eq!(known(&map), (13..47).collect::<Vec<_>>());
        let mut map = vec![5.0f32; SIZE.0 * SIZE.1];
        pair.clear_map(&mut ViewMut::new(&mut map, SIZE.0, SIZE.1, 1), true, &Serial);
        assert_eq!(known(&map), (8..42).collect::<Vec<_>>());
        let mut map = vec![5.0f32; SIZE.0 * SIZE.1];
        pair.clear_rim(&mut ViewMut::new(&mut map, SIZE.0, SIZE.1, 1));
        assert_eq!(known(&map), (10..60).collect::<Vec<_>>());
        // Without parts nothing is cleared.
        pair.set([None, None], 3);
        let mut map = vec![5.0f32; SIZE.0 * SIZE.1];
        pair.clear_map(&mut ViewMut::new(&mut map, SIZE.0, SIZE.1, 1), false, &Serial);
        assert_eq!(known(&map).len(), SIZE.0);
    }
}
