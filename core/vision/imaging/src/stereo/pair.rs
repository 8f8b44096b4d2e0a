//! The views and maps of a pair in the memory where they are matched: the host's, or that of a GPU.
//!
//! A [`PairMatcher`] changes whole maps by limits of their rows, which it finds from few of their columns. So frames on a
//! GPU stay there.
//!
//! [`PairMatcher`]: super::PairMatcher

use std::ops::Range;

use super::StereoError;
use super::matching::again;
use super::stereo_kernel::StereoKernel;
use super::tile::Tile;
use crate::{Parallel, Rect, SharedMut, View, ViewMut};

/// Rows of a map per chunk.
const ROWS: usize = 32;

/// What a row of a disparity map keeps, and what is filled in after that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowEdit {
    /// First column that stays, and the one after the last; the others become NaN.
    pub keep: [u32; 2],
    /// First and last column of the other view, px, between which the counterpart of a pixel that stays must lie.
    pub there: [f32; 2],
    /// First column that is filled in; [`RowEdit::NOWHERE`] for none.
    pub from: u32,
    /// Disparity that is filled in, px.
    pub value: f32,
    /// Whether known disparities are overwritten, too.
    pub overwrites: bool,
}

impl RowEdit {
    /// A column beyond all views.
    pub const NOWHERE: u32 = u32::MAX;
    /// Counterparts may lie anywhere.
    pub const ANYWHERE: [f32; 2] = [f32::MIN, f32::MAX];
    /// Changes nothing.
    pub const NONE: Self = Self {
        keep: [0, Self::NOWHERE],
        there: Self::ANYWHERE,
        from: Self::NOWHERE,
        value: f32::NAN,
        overwrites: false,
    };
    /// Sets all to NaN.
    pub const CLEAR: Self = Self { keep: [0; 2], ..Self::NONE };

    /// Keeps these columns.
    pub fn keep(columns: Range<usize>) -> Self {
        Self { keep: [columns.start, columns.end].map(|x| x as u32), ..Self::NONE }
    }

    /// Changes a row of the left (0) or right (1) map.
    fn apply(&self, side: usize, row: &mut [f32]) {
        let [start, end] = self.keep.map(|x| (x as usize).min(row.len()));
        row[..start].fill(f32::NAN);
        row[end..].fill(f32::NAN);
        if self.there != Self::ANYWHERE && start < end {
            let sign = if side == 1 { 1.0 } else { -1.0 };
            let [first, last] = self.there;
            for (x, value) in row[start..end].iter_mut().enumerate() {
                let at = (start + x) as f32 + sign * *value;
                // NaN fails.
                *value = if (at >= first) & (at <= last) { *value } else { f32::NAN };
            }
        }
        let from = (self.from as usize).min(row.len());
        row[from..].iter_mut().filter(|d| self.overwrites || d.is_nan()).for_each(|d| *d = self.value);
    }
}

/// A rectified gray pair. Side 0 is the left view, 1 the right one.
pub trait PairViews {
    /// Columns and rows of both views.
    fn size(&self) -> (usize, usize);

    /// Writes means of `factor` x `factor` px of a view into `plane`, row after row. What no whole block covers is left
    /// out.
    ///
    /// # Errors
    /// [`StereoError::Device`].
    fn shrink(&mut self, side: usize, factor: usize, plane: &mut Vec<u8>) -> Result<(), StereoError>;

    /// The last `columns` columns of the left view and the first ones of the right view, in the host's memory.
    ///
    /// # Errors
    /// [`StereoError::Device`].
    fn border(&mut self, columns: usize) -> Result<[View<'_, u8>; 2], StereoError>;

    /// Writes patches of a view, of `width` x `height` px each, into `out`, one after the other, row after row. `corners` are
    /// their first columns and rows; all of a patch is inside the view.
    ///
    /// # Errors
    /// [`StereoError::Device`].
    fn patches(
        &mut self,
        side: usize,
        corners: &[[usize; 2]],
        size: (usize, usize),
        out: &mut Vec<u8>,
    ) -> Result<(), StereoError>;
}

impl PairViews for [View<'_, u8>; 2] {
    fn size(&self) -> (usize, usize) {
        (self[0].width, self[0].height)
    }

    fn shrink(&mut self, side: usize, factor: usize, plane: &mut Vec<u8>) -> Result<(), StereoError> {
        let view = self[side];
        let (width, height) = (view.width / factor, view.height / factor);
        plane.resize(width * height, 0);
        let area = (factor * factor) as u32;
        for (row, out) in plane.chunks_exact_mut(width).enumerate() {
            for (column, out) in out.iter_mut().enumerate() {
                let mut sum = area / 2;
                for y in row * factor..(row + 1) * factor {
                    let pixels = &view.row(y)[column * factor..(column + 1) * factor];
                    sum += pixels.iter().map(|value| u32::from(*value)).sum::<u32>();
                }
                *out = (sum / area) as u8;
            }
        }
        Ok(())
    }

    fn border(&mut self, columns: usize) -> Result<[View<'_, u8>; 2], StereoError> {
        let [left, right] = *self;
        Ok([left.crop(left.width - columns, 0, columns, left.height), right.crop(0, 0, columns, right.height)])
    }

    fn patches(
        &mut self,
        side: usize,
        corners: &[[usize; 2]],
        (width, height): (usize, usize),
        out: &mut Vec<u8>,
    ) -> Result<(), StereoError> {
        out.clear();
        for [x, y] in corners {
            (*y..y + height).for_each(|row| out.extend_from_slice(&self[side].row(row)[*x..x + width]));
        }
        Ok(())
    }
}

/// Some pixels of a left map.
pub trait MapSamples {
    /// Writes each `step`-th pixel of each `step`-th row of `area`, px, into `out`.
    ///
    /// # Errors
    /// [`StereoError::Device`].
    fn samples(&mut self, area: Rect, step: usize, out: &mut Vec<f32>) -> Result<(), StereoError>;

    /// Known share of the map, 0..=1; an estimate from its samples where the map is not in the host's memory.
    ///
    /// # Errors
    /// [`StereoError::Device`].
    fn known_share(&mut self) -> Result<f64, StereoError>;
}

impl MapSamples for View<'_, f32> {
    fn samples(&mut self, area: Rect, step: usize, out: &mut Vec<f32>) -> Result<(), StereoError> {
        out.clear();
        for y in (area.y..area.y + area.height).step_by(step) {
            out.extend(self.row(y)[area.x..area.x + area.width].iter().step_by(step));
        }
        Ok(())
    }

    fn known_share(&mut self) -> Result<f64, StereoError> {
        let known: usize = (0..self.height).map(|y| self.row(y).iter().filter(|value| value.is_finite()).count()).sum();
        Ok(known as f64 / (self.width * self.height).max(1) as f64)
    }
}

/// Both maps of a pair and the kernel that makes them. Side 0 is the left map, 1 the right one.
pub trait PairMaps: MapSamples {
    /// Whether the right map is read after the call.
    fn right_is_read(&self) -> bool;

    /// Matches `roi` over `search_px` disparities from `first_px` on, see [`StereoKernel::match_roi`]. The right map is
    /// made where it `is_needed` or read.
    ///
    /// # Errors
    /// Those of the kernel, and [`StereoError::Device`].
    fn match_roi(
        &mut self,
        range: (i32, usize),
        roi: Rect,
        right_is_needed: bool,
        pool: &dyn Parallel,
    ) -> Result<(), StereoError>;

    /// Matches tiles, see [`StereoKernel::match_tiles`]; makes both maps.
    ///
    /// # Errors
    /// Those of the kernel, and [`StereoError::Device`].
    fn match_tiles(
        &mut self,
        tiles: &[Tile],
        left_right_px: Option<f32>,
        pool: &dyn Parallel,
    ) -> Result<(), StereoError>;

    /// Changes a map that was made: by one edit for each row, or by a single one for all.
    ///
    /// # Errors
    /// [`StereoError::Device`].
    fn edit(&mut self, side: usize, rows: &[RowEdit], pool: &dyn Parallel) -> Result<(), StereoError>;

    /// These columns of a map that was made, in the host's memory.
    ///
    /// # Errors
    /// [`StereoError::Device`].
    fn columns(&mut self, side: usize, columns: Range<usize>) -> Result<View<'_, f32>, StereoError>;

    /// Lets `change` change the left map in the host's memory.
    ///
    /// # Errors
    /// [`StereoError::Device`].
    fn change_left(&mut self, change: &mut dyn FnMut(ViewMut<'_, f32>)) -> Result<(), StereoError>;
}

/// Maps in the host's memory.
pub(super) struct HostMaps<'a, K> {
    pub kernel: &'a mut K,
    pub views: [View<'a, u8>; 2],
    pub left: ViewMut<'a, f32>,
    /// Where the right map is read.
    pub right: Option<ViewMut<'a, f32>>,
    /// The right map where it is needed alone.
    pub spare: &'a mut Vec<f32>,
}

/// The right map.
fn right_map<'a>(
    right: &'a mut Option<ViewMut<'_, f32>>,
    spare: &'a mut Vec<f32>,
    (width, height): (usize, usize),
) -> ViewMut<'a, f32> {
    match right {
        Some(right) => again(right),
        None => {
            spare.resize(width * height, f32::NAN);
            ViewMut::new(spare, width, height, 1)
        }
    }
}

impl<K> HostMaps<'_, K> {
    fn map(&mut self, side: usize) -> ViewMut<'_, f32> {
        let size = (self.left.width, self.left.height);
        if side == 0 { again(&mut self.left) } else { right_map(&mut self.right, self.spare, size) }
    }
}

impl<K> MapSamples for HostMaps<'_, K> {
    fn samples(&mut self, area: Rect, step: usize, out: &mut Vec<f32>) -> Result<(), StereoError> {
        self.left.as_view().samples(area, step, out)
    }

    fn known_share(&mut self) -> Result<f64, StereoError> {
        self.left.as_view().known_share()
    }
}

impl<K: StereoKernel> PairMaps for HostMaps<'_, K> {
    fn right_is_read(&self) -> bool {
        self.right.is_some()
    }

    fn match_roi(
        &mut self,
        range: (i32, usize),
        roi: Rect,
        right_is_needed: bool,
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        let size = (self.left.width, self.left.height);
        let right = (right_is_needed || self.right.is_some()).then(|| right_map(&mut self.right, self.spare, size));
        self.kernel.match_roi(range, self.views, roi, pool, again(&mut self.left), right)
    }

    fn match_tiles(
        &mut self,
        tiles: &[Tile],
        left_right_px: Option<f32>,
        pool: &dyn Parallel,
    ) -> Result<(), StereoError> {
        let right = right_map(&mut self.right, self.spare, (self.left.width, self.left.height));
        self.kernel.match_tiles(tiles, self.views, left_right_px, pool, again(&mut self.left), right)
    }

    fn edit(&mut self, side: usize, rows: &[RowEdit], pool: &dyn Parallel) -> Result<(), StereoError> {
        let map = self.map(side);
        let (width, height, stride) = (map.width, map.height, map.stride);
        let target = SharedMut::new(map.data);
        pool.run(height.div_ceil(ROWS), &|chunk| {
            for y in chunk * ROWS..(chunk * ROWS + ROWS).min(height) {
                // SAFETY: every row belongs to one chunk.
                let row = unsafe { target.part(y * stride, width) };
                rows[y.min(rows.len() - 1)].apply(side, row);
            }
        });
        Ok(())
    }

    fn columns(&mut self, side: usize, columns: Range<usize>) -> Result<View<'_, f32>, StereoError> {
        let ViewMut { data, width, height, stride, .. } = self.map(side);
        Ok(View::with_stride(data, width, height, 1, stride).crop(columns.start, 0, columns.len(), height))
    }

    fn change_left(&mut self, change: &mut dyn FnMut(ViewMut<'_, f32>)) -> Result<(), StereoError> {
        change(again(&mut self.left));
        Ok(())
    }
}

/// A kernel of maps that are given.
#[cfg(test)]
pub(super) mod testing {
    use super::*;

    pub struct Given;

    impl StereoKernel for Given {
        fn match_roi(
            &mut self,
            _: (i32, usize),
            _: [View<'_, u8>; 2],
            _: Rect,
            _: &dyn Parallel,
            _: ViewMut<'_, f32>,
            _: Option<ViewMut<'_, f32>>,
        ) -> Result<(), StereoError> {
            Ok(())
        }

        fn match_tiles(
            &mut self,
            _: &[Tile],
            _: [View<'_, u8>; 2],
            _: Option<f32>,
            _: &dyn Parallel,
            _: ViewMut<'_, f32>,
            _: ViewMut<'_, f32>,
        ) -> Result<(), StereoError> {
            Ok(())
        }
    }

    /// Calls `work` with these maps.
    pub fn with_maps(
        [left, right]: [&mut Vec<f32>; 2],
        (width, height): (usize, usize),
        right_is_read: bool,
        work: impl FnOnce(&mut dyn PairMaps) -> Result<(), StereoError>,
    ) {
        let empty = View::new(&[][..], 0, 0, 1);
        let left = ViewMut::new(left, width, height, 1);
        let mut spare = Vec::new();
        let (right, spare) = match right_is_read {
            true => (Some(ViewMut::new(right, width, height, 1)), &mut spare),
            false => (None, right),
        };
        work(&mut HostMaps { kernel: &mut Given, views: [empty; 2], left, right, spare }).expect("in memory");
    }
}
