//! Clears disparities outside the lit parts of a pair.
//!
//! A rim lies at one place in both views. Blocks that reach over it match it to itself, at a disparity that has nothing to do with the tissue beside it.

use super::StereoError;
use super::pair::{PairMaps, RowEdit};
use crate::Parallel;
use crate::lit::LitPart;

/// The lit parts of both views. Computes only when they change.
#[derive(Debug, Default)]
pub struct LitPair {
    given: [LitPart; 2],
    rim_px: usize,
    /// What is far enough from a rim.
    clear: [LitPart; 2],
    /// What becomes of the rows of both maps, and in the end of the left one's.
    edits: [Vec<RowEdit>; 2],
    rim: Vec<RowEdit>,
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
        for (side, edits) in self.edits.iter_mut().enumerate() {
            edits.clear();
            edits.extend((0..size.1).map(|y| {
                let there = self.clear[1 - side].row(y);
                let there = [there.start as f32 - 0.5, there.end as f32 - 0.5];
                RowEdit { there, ..RowEdit::keep(self.clear[side].row(y)) }
            }));
        }
        self.rim.clear();
        self.rim.extend((0..size.1).map(|y| RowEdit::keep(self.given[0].row(y))));
    }

    /// The parts of views of this size that are matched; `None` when both are lit as a whole.
    pub fn clear_parts(&self, size: (usize, usize)) -> Option<&[LitPart; 2]> {
        (self.is_set && self.clear.iter().all(|part| part.size() == size)).then_some(&self.clear)
    }

    /// Sets pixels of the left (0) or right (1) map of views of this size to NaN that lie, or whose counterparts lie, on a
    /// rim or near it.
    ///
    /// # Errors
    /// Those of the maps.
    pub fn clear_map(
        &self,
        maps: &mut dyn PairMaps,
        side: usize,
        size: (usize, usize),
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        if self.clear_parts(size).is_none() { Ok(()) } else { maps.edit(side, &self.edits[side], pool) }
    }

    /// Sets pixels of the left map, of this size, that lie on the rim to NaN.
    ///
    /// # Errors
    /// Those of the maps.
    pub fn clear_rim(
        &self,
        maps: &mut dyn PairMaps,
        size: (usize, usize),
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        let is_there = self.is_set && self.given[0].size() == size;
        if is_there { maps.edit(0, &self.rim, pool) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Serial;
    use crate::stereo::pair::testing::with_maps;

    const SIZE: (usize, usize) = (60, 20);

    fn columns(range: std::ops::Range<usize>) -> LitPart {
        let mut part = LitPart::whole(SIZE.0, SIZE.1);
        (0..SIZE.1).for_each(|y| part.set_row(y, range.clone()));
        part
    }

    fn known(map: &[f32]) -> Vec<usize> {
        (0..SIZE.0).filter(|x| map[5 * SIZE.0 + x].is_finite()).collect()
    }

    /// Columns that are known of a map of 5 px that `clear` has changed.
    fn left_known(side: usize, clear: impl FnOnce(&mut dyn PairMaps) -> Result<(), StereoError>) -> Vec<usize> {
        let mut maps = [(); 2].map(|()| vec![5.0f32; SIZE.0 * SIZE.1]);
        with_maps(maps.each_mut(), SIZE, true, clear);
        known(&maps[side])
    }

    #[test]
    fn a_pixel_counts_only_when_both_blocks_are_lit() {
        let (left, right) = (columns(10..60), columns(0..45));
        let mut pair = LitPair::default();
        pair.set([Some(&left), Some(&right)], 3);
        // Left from 13 on, right up to 41, which lies 5 px further right in the left view.
        assert_eq!(left_known(0, |maps| pair.clear_map(maps, 0, SIZE, &Serial)), (13..47).collect::<Vec<_>>());
        assert_eq!(left_known(1, |maps| pair.clear_map(maps, 1, SIZE, &Serial)), (8..42).collect::<Vec<_>>());
        assert_eq!(left_known(0, |maps| pair.clear_rim(maps, SIZE, &Serial)), (10..60).collect::<Vec<_>>());
        // Without parts nothing is cleared.
        pair.set([None, None], 3);
        assert_eq!(left_known(0, |maps| pair.clear_map(maps, 0, SIZE, &Serial)).len(), SIZE.0);
    }
}
