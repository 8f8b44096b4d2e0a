//! Tiles of the left view that are matched over ranges of their own, and the right view's map from the left one.

use super::matching::fill_nan;
use crate::{Parallel, Rect, SharedMut, ViewMut};

/// A part of the left view and the disparities that are searched there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Pixels whose disparity is found.
    pub area: Rect,
    /// Smallest disparity searched, px.
    pub first_px: i32,
    /// Disparities searched from there on, 1 to 512, rounded up to a multiple of 32.
    pub search_px: usize,
}

impl Tile {
    /// The area with up to `columns` more on both sides, inside a view of `width` columns.
    pub fn widened(&self, columns: usize, width: usize) -> Rect {
        let x = self.area.x.saturating_sub(columns);
        let end = (self.area.x + self.area.width + columns).min(width);
        Rect { x, width: end.saturating_sub(x), ..self.area }
    }
}

/// Lanes of the widest search.
pub(super) fn max_lanes(tiles: &[Tile]) -> usize {
    tiles.iter().map(|tile| tile.search_px.next_multiple_of(32)).max().unwrap_or(0)
}

/// Work memory of one tile.
#[derive(Debug, Default)]
pub(super) struct TileWork<B> {
    pub band: B,
    /// One row of the view.
    pub line: Vec<f32>,
}

/// Makes room for `count` tiles of views of `width` columns.
pub(super) fn make_room<B: Default>(work: &mut Vec<TileWork<B>>, count: usize, width: usize) {
    if work.len() < count {
        work.resize_with(count, TileWork::default);
    }
    for tile in &mut work[..count] {
        tile.line.resize(width, f32::NAN);
    }
}

/// The map that tiles fill from several threads.
pub(super) struct TileMap<'a> {
    data: SharedMut<'a, f32>,
    stride: usize,
}

impl<'a> TileMap<'a> {
    /// A map that is NaN wherever no tile writes.
    pub fn new(mut map: ViewMut<'a, f32>, pool: &dyn Parallel) -> Self {
        fill_nan(&mut map, pool);
        Self { stride: map.stride, data: SharedMut::new(map.data) }
    }

    /// Copies the columns of `area` from `line`, a row of the view, into row `y`.
    ///
    /// # Safety
    /// No other call may write pixels of `area` at the same time: areas of tiles do not overlap.
    pub unsafe fn put(&self, area: Rect, y: usize, line: &[f32]) {
        // SAFETY: the caller promises that nobody else writes these pixels.
        let out = unsafe { self.data.part(y * self.stride + area.x, area.width) };
        out.copy_from_slice(&line[area.x..area.x + area.width]);
    }
}

/// Largest step between neighbours of one surface, px: a gap of one pixel between them is closed.
const SAME_SURFACE_PX: f32 = 2.0;

/// Writes the right view's map that `left` implies, each right pixel with the nearest surface that lands on it, and clears left pixels that are
/// hidden behind it: those whose disparity differs by more than `max_px` from the right view's, `None` keeps them.
///
/// Maps have one size. Serves where each tile was matched on its own, so that no search saw all left pixels that compete for a right one.
pub fn project_right(
    left: &mut ViewMut<'_, f32>,
    right: &mut ViewMut<'_, f32>,
    max_px: Option<f32>,
    pool: &dyn Parallel,
) {
    let (width, height) = (left.width.min(right.width), left.height.min(right.height));
    let (stride, stride_right) = (left.stride, right.stride);
    let (left, right) = (SharedMut::new(&mut *left.data), SharedMut::new(&mut *right.data));
    const CHUNK_ROWS: usize = 16;
    pool.run(height.div_ceil(CHUNK_ROWS), &|chunk| {
        for y in chunk * CHUNK_ROWS..((chunk + 1) * CHUNK_ROWS).min(height) {
            // SAFETY: row `y` of both maps belongs to this chunk alone.
            let (left, right) = unsafe { (left.part(y * stride, width), right.part(y * stride_right, width)) };
            project_row(left, right, max_px);
        }
    });
}

fn project_row(left: &mut [f32], right: &mut [f32], max_px: Option<f32>) {
    right.fill(f32::NAN);
    for (x, d) in left.iter().enumerate() {
        if let Some(to) = target(x, *d, right.len()) {
            // `max` drops NaN.
            right[to] = right[to].max(*d);
        }
    }
    for x in 1..right.len().saturating_sub(1) {
        let (before, after) = (right[x - 1], right[x + 1]);
        if right[x].is_nan() && (before - after).abs() <= SAME_SURFACE_PX {
            right[x] = 0.5 * (before + after);
        }
    }
    let Some(max_px) = max_px else { return };
    for (x, d) in left.iter_mut().enumerate() {
        let agrees = target(x, *d, right.len()).is_some_and(|to| (right[to] - *d).abs() <= max_px);
        *d = if agrees { *d } else { f32::NAN };
    }
}

/// The right view's column of a left pixel.
#[inline]
fn target(x: usize, d: f32, width: usize) -> Option<usize> {
    // Rounds without the call that `round` is on a processor without such an instruction. NaN fails.
    let to = x as f32 - d + 0.5;
    (to >= 0.0 && to < width as f32).then_some(to as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Serial;

    const WIDTH: usize = 60;

    fn project(left: &mut [f32], max_px: Option<f32>) -> Vec<f32> {
        let mut right = vec![7.0; left.len()];
        let height = left.len() / WIDTH;
        let (left, out) = (&mut ViewMut::new(left, WIDTH, height, 1), &mut ViewMut::new(&mut right, WIDTH, height, 1));
        project_right(left, out, max_px, &Serial);
        right
    }

    #[test]
    fn the_nearest_surface_wins_and_what_it_hides_is_cleared() {
        // A bar at 20 px of disparity before a ground at 5 px; nothing is matched in column 50.
        let mut left: Vec<f32> = (0..WIDTH).map(|x| if (30..40).contains(&x) { 20.0 } else { 5.0 }).collect();
        left[50] = f32::NAN;
        let right = project(&mut left, Some(1.0));
        for (x, d) in right.iter().enumerate() {
            match x {
                10..20 => assert_eq!(*d, 20.0, "{x}"),
                // Hidden from the left camera by the bar, and the gap of one pixel that is closed.
                25..35 | 55.. => assert!(d.is_nan(), "{x}: {d}"),
                _ => assert_eq!(*d, 5.0, "{x}"),
            }
        }
        for (x, d) in left.iter().enumerate() {
            let is_hidden = (15..25).contains(&x) || x < 5 || x == 50;
            assert_eq!(d.is_nan(), is_hidden, "{x}: {d}");
        }
        let mut kept: Vec<f32> = vec![5.0; WIDTH];
        kept[30] = 20.0;
        project(&mut kept, None);
        assert!(kept.iter().all(|d| d.is_finite()));
    }

    #[test]
    fn a_slope_leaves_no_gaps() {
        // The right view shows this slope wider than the left one.
        let mut left: Vec<f32> = (0..2 * WIDTH).map(|i| 30.0 - 0.5 * (i % WIDTH) as f32).collect();
        let right = project(&mut left, Some(1.0));
        for row in right.chunks(WIDTH) {
            let known: Vec<usize> = (0..WIDTH).filter(|x| row[*x].is_finite()).collect();
            let (first, last) = (known[0], known[known.len() - 1]);
            assert_eq!(known.len(), last - first + 1, "{row:?}");
        }
        assert!(left.iter().skip(20).take(30).all(|d| d.is_finite()));
    }
}
