//! Sizes of a tick, and views and maps as the network takes them.

use panoscope_imaging::SharedMut;
use panoscope_node::{Parallel, View, ViewMut};

/// What the network reads as unknown.
pub const UNKNOWN: f32 = -10000.0;
/// Sides of its inputs are multiples of this.
const GRAIN_PX: usize = 32;
/// Disparities that the network reaches, with some room to the 216 of its design, px.
const REACH_PX: f32 = 200.0;
/// The right view is moved by multiples of this, so that its place rarely changes, px.
const OFFSET_STEP_PX: usize = 16;
/// Shares of the matched disparities that are taken for the smallest and the largest.
const ENDS: [f32; 2] = [0.02, 0.98];
/// Pixels of the map that are looked at for its range, at most.
const LOOKED_AT: usize = 1 << 14;
/// Rows per task.
const ROWS: usize = 16;

/// Sizes of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Of the views and maps, px.
    pub size: (usize, usize),
    /// Factor by which they are shrunk.
    pub factor: usize,
    /// Of the shrunk ones.
    pub small: (usize, usize),
    /// Of the network's inputs, whose sides are multiples of [`GRAIN_PX`].
    pub padded: (usize, usize),
    /// By how much the right view is moved, so that the network reaches the disparities, px of the shrunk views.
    pub offset: usize,
}

/// The smallest and the largest disparity of a map but for few, px.
fn range(map: View<'_, f32>) -> Option<[f32; 2]> {
    let step = (map.width * map.height / LOOKED_AT).max(1);
    let values = (0..map.height).flat_map(|y| map.row(y).iter());
    let mut values: Vec<f32> = values.step_by(step).copied().filter(|value| usable(*value)).collect();
    values.sort_by(f32::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(ENDS.map(|share| values[(share * last as f32) as usize]))
}

/// Whether a matcher knows this: its disparities are shorter than a view; others would only overflow.
fn usable(value: f32) -> bool {
    (0.0..-UNKNOWN / 4.0).contains(&value)
}

impl Frame {
    /// `scale` is the factor asked for; 0 finds it.
    pub fn new(size: (usize, usize), scale: usize, matched: Option<View<'_, f32>>) -> Self {
        let [low, high] = matched.and_then(range).unwrap_or_default();
        let spread = ((high - low) / REACH_PX).ceil() as usize;
        let factor = if scale > 0 { scale } else { (size.0 / 720).max(spread).clamp(1, 4) };
        let factor = factor.min(size.0.min(size.1)).max(1);
        let small = (size.0 / factor, size.1 / factor);
        let up = |side: usize| side.next_multiple_of(GRAIN_PX);
        // What lies behind stays above 0, and the reach is left to what is nearer than all that the matcher knows.
        let steps = (low / factor as f32) as usize / OFFSET_STEP_PX;
        let offset = steps.saturating_sub(1) * OFFSET_STEP_PX;
        Self { size, factor, small, padded: (up(small.0), up(small.1)), offset }
    }

    /// Writes `finish` of the values between those of a small map.
    pub fn enlarge(&self, from: &[f32], to: &mut ViewMut<'_, f32>, finish: impl Fn(f32) -> f32) {
        let factor = self.factor as f32;
        let place = |at: usize, side: usize| {
            let place = ((at as f32 + 0.5) / factor - 0.5).clamp(0.0, (side - 1) as f32);
            let low = place as usize;
            (low, (low + 1).min(side - 1), place - low as f32)
        };
        for y in 0..self.size.1 {
            let (above, below, down) = place(y, self.small.1);
            let line = |y: usize| &from[y * self.padded.0..][..self.small.0];
            let (above, below) = (line(above), line(below));
            let row = to.row_mut(y);
            if self.factor == 1 {
                row.iter_mut().zip(above).for_each(|(out, value)| *out = finish(*value));
                continue;
            }
            for (x, out) in row.iter_mut().enumerate() {
                let (low, high, across) = place(x, self.small.0);
                let mix = |line: &[f32]| line[low] + across * (line[high] - line[low]);
                *out = finish(mix(above) + down * (mix(below) - mix(above)));
            }
        }
    }
}

/// A view as the network takes it: shrunk, moved to the right by `offset` px, as planes of red, green and blue; its last columns and rows are repeated
/// beyond its sides.
pub fn fill_view(frame: &Frame, view: View<'_, u8>, offset: usize, pool: &dyn Parallel, planes: &mut Vec<f32>) {
    let ((columns, rows), factor) = (frame.padded, frame.factor);
    planes.resize(3 * columns * rows, 0.0);
    let shared = SharedMut::new(planes);
    let gain = 1.0 / (255.0 * (factor * factor) as f32);
    let mean = |x: usize, y: usize, channel: usize| {
        let lines = (y * factor..(y + 1) * factor).map(|y| &view.row(y)[x * factor * view.channels..]);
        let sum: u32 = lines
            .flat_map(|line| line[channel..].iter().step_by(view.channels).take(factor))
            .map(|v| u32::from(*v))
            .sum();
        sum as f32 * gain
    };
    pool.run(rows.div_ceil(ROWS), &|chunk| {
        for y in chunk * ROWS..(chunk * ROWS + ROWS).min(rows) {
            let from_y = y.min(frame.small.1 - 1);
            for plane in 0..3 {
                // SAFETY: every row belongs to one chunk.
                let out = unsafe { shared.part((plane * rows + y) * columns, columns) };
                let channel = if view.channels == 3 { 2 - plane } else { 0 };
                for (x, out) in out.iter_mut().enumerate() {
                    *out = mean(x.saturating_sub(offset).min(frame.small.0 - 1), from_y, channel);
                }
            }
        }
    });
}

/// A map as the network takes it: its holes filled, and 1 where it knows something itself. Each value is the middle one of its block. All is unknown
/// without a map.
pub fn fill_map(frame: &Frame, map: Option<View<'_, f32>>, filled: &mut Vec<f32>, known: &mut Vec<f32>) {
    let ((columns, rows), middle) = (frame.padded, frame.factor / 2);
    for (plane, value) in [(&mut *filled, UNKNOWN), (&mut *known, 0.0)] {
        plane.clear();
        plane.resize(columns * rows, value);
    }
    let Some(map) = map else { return };
    let lines = filled.chunks_exact_mut(columns).zip(known.chunks_exact_mut(columns));
    for (y, (line, known)) in lines.enumerate().take(frame.small.1) {
        let values = map.row(y * frame.factor + middle)[middle..].iter().step_by(frame.factor);
        for ((out, known), value) in line[..frame.small.0].iter_mut().zip(&mut *known).zip(values) {
            if usable(*value) {
                *out = (value / frame.factor as f32 - frame.offset as f32).max(0.0);
                *known = 1.0;
            }
        }
        fill_row(line);
    }
    fill_empty_rows(filled, columns);
}

/// Rows that know nothing, as those of a black rim, take the values of the nearest row that does, of the upper one of two as near.
fn fill_empty_rows(plane: &mut [f32], columns: usize) {
    // A filled row has values everywhere or nowhere.
    let is_filled = |plane: &[f32], y: usize| plane[y * columns] > UNKNOWN;
    let rows: Vec<usize> = (0..plane.len() / columns).filter(|&y| is_filled(plane, y)).collect();
    for y in 0..plane.len() / columns {
        if is_filled(plane, y) {
            continue;
        }
        let Some(nearest) = rows.iter().copied().min_by_key(|row| row.abs_diff(y)) else { return };
        plane.copy_within(nearest * columns..(nearest + 1) * columns, y * columns);
    }
}

/// Unknown pixels take the smaller of the nearest known values of their row, because what is hidden lies behind; a row without known values stays unknown.
fn fill_row(line: &mut [f32]) {
    let mut left = f32::INFINITY;
    let mut x = 0;
    while x < line.len() {
        if line[x] > UNKNOWN {
            left = line[x];
            x += 1;
            continue;
        }
        let hole = line[x..].iter().position(|value| *value > UNKNOWN).unwrap_or(line.len() - x);
        let value = left.min(line.get(x + hole).copied().unwrap_or(f32::INFINITY));
        if value.is_finite() {
            line[x..x + hole].fill(value);
        }
        x += hole;
    }
}

#[cfg(test)]
mod tests {
    use panoscope_imaging::Serial;

    use super::*;

    #[test]
    fn the_right_view_is_moved_until_the_network_reaches_the_disparities() {
        let of = |width: usize, low: f32, high: f32| {
            let map: Vec<f32> = (0..width * 40).map(|i| if i % 2 == 0 { low } else { high }).collect();
            let frame = Frame::new((width, 40), 0, Some(View::new(&map, width, 40, 1)));
            let reached = [low, high].map(|d| d / frame.factor as f32 - frame.offset as f32);
            assert!(reached[0] >= 0.0 && reached[1] <= 216.0, "{low} to {high} px: {frame:?}");
            (frame.factor, frame.offset)
        };
        assert_eq!(of(640, 5.0, 150.0), (1, 0));
        assert_eq!(of(1920, 5.0, 150.0), (2, 0));
        assert_eq!(of(640, 5.0, 300.0), (2, 0));
        assert_eq!(of(640, 180.0, 280.0), (1, 160));
        assert_eq!(of(640, 900.0, 1000.0), (1, 880));
        assert_eq!(of(640, 230.0, 420.0), (1, 208));
    }

    #[test]
    fn holes_take_the_farther_side_of_their_row() {
        let u = UNKNOWN;
        for (mut row, expected) in [
            ([u, 9.0, u, u, 4.0, u, 6.0, u], [9.0, 9.0, 4.0, 4.0, 4.0, 4.0, 6.0, 6.0]),
            ([u; 8], [u; 8]),
            ([0.0; 8], [0.0; 8]),
        ] {
            fill_row(&mut row);
            assert_eq!(row, expected);
        }
    }

    #[test]
    fn views_and_maps_are_shrunk_moved_and_padded() {
        let map: Vec<f32> = (0..36).map(|i| if i == 7 { f32::NAN } else { 900.0 + i as f32 }).collect();
        let view: Vec<u8> = (0..36).flat_map(|i| [i, 100 + i, 200 + i]).collect();
        let frame = Frame { size: (6, 6), factor: 3, small: (2, 2), padded: (32, 32), offset: 1 };
        let (mut filled, mut known) = (Vec::new(), Vec::new());
        fill_map(&frame, Some(View::new(&map, 6, 6, 1)), &mut filled, &mut known);
        assert_eq!(filled[..3], [910.0 / 3.0 - 1.0; 3]);
        assert_eq!(known[..3], [0.0, 1.0, 0.0]);
        assert_eq!(filled[32 * 31], 925.0 / 3.0 - 1.0, "padding takes the last row");
        assert_eq!(known.iter().sum::<f32>(), 3.0);
        fill_map(&frame, Some(View::new(&[f32::NAN; 36], 6, 6, 1)), &mut filled, &mut known);
        assert!(filled.iter().all(|value| *value == UNKNOWN), "nothing is known");
        let mut planes = Vec::new();
        fill_view(&frame, View::new(&view, 6, 6, 3), frame.offset, &Serial, &mut planes);
        let near =
            |found: f32, expected: f32| assert!((found * 255.0 - expected).abs() < 1e-3, "{found} for {expected}");
        // Red is the third byte of a pixel; the left half's mean is that of its middle, 7, the right half's 10.
        for (x, expected) in [(0, 207.0), (1, 207.0), (2, 210.0), (31, 210.0)] {
            near(planes[x], expected);
        }
        near(planes[2 * 32 * 32], 7.0);
        near(planes[32 * 32 - 1], 228.0);
    }
}
