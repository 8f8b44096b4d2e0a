//! The dark rim of a scope's frames: the mosaic shows nothing of it, and keypoints on it do not count, because a rim
//! stays where it is when the camera moves.

use crate::View;
use crate::features::Features;
use crate::geometry::Point;
use crate::lit::{LitFinder, LitPart};

/// Side of a cell of the table, px of the frame.
const CELL_PX: usize = 4;
/// Distance from the rim up to which keypoints are dropped, px at a width of 640 px: their surroundings reach into it.
const KEYPOINT_PX: usize = 10;
/// Distance of the corners of the drawn border, rows of the frame.
const BORDER_STEP: usize = 8;

/// Change of the lit part, as a share of the frame, up to which the one in use stays: each new one redraws the mosaic.
const HELD: f64 = 0.005;

/// Finds the rim from the frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Rim {
    finder: LitFinder,
    /// What is far enough from the rim for keypoints.
    inner: LitPart,
    lit: Option<Lit>,
}

impl Rim {
    /// Adds a frame. Returns whether the lit part has changed.
    pub fn look(&mut self, frame: View<'_, u8>) -> bool {
        if !self.finder.look(frame, None) {
            return false;
        }
        let part = self.finder.part();
        let is_same = match &self.lit {
            None => part.is_whole(),
            Some(lit) => !part.is_whole() && difference(&lit.part, part) <= HELD,
        };
        if !is_same {
            self.lit = (!part.is_whole()).then(|| Lit::of(part));
            part.inset((KEYPOINT_PX * frame.width).div_ceil(640), &mut self.inner);
        }
        !is_same
    }

    /// Forgets all frames.
    pub fn forget(&mut self) {
        self.finder.forget();
        self.lit = None;
    }

    /// The lit part of all frames; `None` without a rim.
    pub fn lit(&self) -> Option<&Lit> {
        self.lit.as_ref()
    }

    /// Removes the keypoints on the rim and near it.
    pub fn clean(&self, features: &mut Features) {
        if self.lit.is_some() {
            features.retain(|[x, y]| self.inner.contains(x.round() as usize, y.round() as usize));
        }
    }
}

/// Share of the frame that only one of two parts covers, about: ends of rows are compared.
fn difference(a: &LitPart, b: &LitPart) -> f64 {
    let (width, height) = a.size();
    let row = |y: usize| {
        let (a, b) = (a.row(y), b.row(y));
        a.start.abs_diff(b.start) + a.end.abs_diff(b.end)
    };
    if a.size() == b.size() { (0..height).map(row).sum::<usize>() as f64 / (width * height).max(1) as f64 } else { 1.0 }
}

/// The lit part of frames with a rim, and how near its pixels are to its middle.
#[derive(Clone, Debug)]
pub(super) struct Lit {
    part: LitPart,
    columns: usize,
    rows: usize,
    /// Nearness to the middle of the lit pixels of a cell's row and column, 1 in the middle and 0 on the rim.
    cells: Vec<[f32; 2]>,
    /// Corners of the part's outline, px of the frame.
    border: Vec<Point>,
}

/// Nearness of a position to the middle of `from..end`.
fn nearness(at: usize, from: usize, end: usize) -> f32 {
    let place = (2 * (at - from) + 1) as f32 / (end - from) as f32;
    1.0 - (place - 1.0).abs()
}

impl Lit {
    fn of(part: &LitPart) -> Self {
        let (width, height) = part.size();
        let mut tall = vec![[height, 0]; width];
        for y in 0..height {
            for [first, end] in &mut tall[part.row(y)] {
                (*first, *end) = ((*first).min(y), y + 1);
            }
        }
        let (columns, rows) = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
        let middle = |cell: usize, side: usize| (cell * CELL_PX + CELL_PX / 2).min(side - 1);
        let cell = |index: usize| {
            let (x, y) = (middle(index % columns, width), middle(index / columns, height));
            let (row, [first, end]) = (part.row(y), tall[x]);
            if row.contains(&x) { [nearness(x, row.start, row.end), nearness(y, first, end)] } else { [0.0; 2] }
        };
        let lit_rows = || (0..height).step_by(BORDER_STEP).chain([height - 1]).filter(|y| !part.row(*y).is_empty());
        let left = lit_rows().map(|y| [part.row(y).start as f64, y as f64]);
        let right = lit_rows().map(|y| [part.row(y).end as f64 - 1.0, y as f64]);
        let border = left.chain(right.collect::<Vec<_>>().into_iter().rev()).collect();
        Self { part: part.clone(), columns, rows, cells: (0..columns * rows).map(cell).collect(), border }
    }

    /// Corners of the outline of what is lit, px of the frame, in order.
    pub fn border(&self) -> &[Point] {
        &self.border
    }

    /// Whether a position in a frame, px, is lit.
    pub fn contains(&self, [x, y]: Point) -> bool {
        x >= -0.5 && y >= -0.5 && self.part.contains((x + 0.5) as usize, (y + 0.5) as usize)
    }

    /// Nearness to the middle of the lit part, along rows and columns, at a place from 0 to 2 in both directions; `None`
    /// outside.
    pub fn at(&self, u: f32, v: f32) -> Option<(f32, f32)> {
        let (width, height) = self.part.size();
        let (x, y) = (u * 0.5 * (width as f32 - 1.0), v * 0.5 * (height as f32 - 1.0));
        if !self.contains([f64::from(x), f64::from(y)]) {
            return None;
        }
        let place = |at: f32, count: usize| {
            let cell = ((at + 0.5) / CELL_PX as f32 - 0.5).clamp(0.0, (count - 1) as f32);
            let first = (cell as usize).min(count.saturating_sub(2));
            (first, (first + 1).min(count - 1), cell - first as f32)
        };
        let ((left, right, across), (above, below, down)) = (place(x, self.columns), place(y, self.rows));
        let row = |row: usize| {
            let [a, b] = [left, right].map(|column| self.cells[row * self.columns + column]);
            [0, 1].map(|k| a[k] + (b[k] - a[k]) * across)
        };
        let (a, b) = (row(above), row(below));
        Some((a[0] + (b[0] - a[0]) * down, a[1] + (b[1] - a[1]) * down))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearness_is_that_of_the_lit_pixels() {
        let mut part = LitPart::whole(80, 60);
        for y in 0..60 {
            part.set_row(y, if y < 12 { 0..0 } else { 20..80 });
        }
        let lit = Lit::of(&part);
        let at = |x: f32, y: f32| lit.at(2.0 * x / 79.0, 2.0 * y / 59.0);
        assert_eq!((at(19.0, 30.0), at(40.0, 11.0)), (None, None));
        let (across, down) = at(49.5, 35.5).unwrap();
        assert!(across > 0.9 && down > 0.9, "{across} {down}");
        let (across, down) = at(21.0, 13.0).unwrap();
        assert!(across < 0.1 && down < 0.12, "{across} {down}");
        assert!(lit.contains([20.0, 12.0]) && !lit.contains([-1.0, 12.0]) && !lit.contains([79.6, 30.0]));
        assert_eq!(lit.border().first(), Some(&[20.0, 16.0]));
    }
}
