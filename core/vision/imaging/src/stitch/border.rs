//! The outer border of a panorama, which is ragged where views end: faded to black, or cropped.
//!
//! Black areas around the round image of an endoscope, or left by rectification, count as outside of a view.

use super::crop::LargestRectangle;
use super::params::{BorderMethod, CompositeParams};
use super::warp::Span;
use crate::{Parallel, Rect, SharedMut, ViewMut};

/// Side of a cell of the coarse grid that distances and rectangles are found on, px.
const CELL_PX: usize = 4;
/// Maximum level of the black around a view; noise and compression raise it above 0.
const BLACK_LEVELS: u8 = 16;
/// Rows of a chunk of parallel work.
const CHUNK_ROWS: usize = 64;
/// Share of the largest rectangle, in percent, that the previous one must have to be kept.
const KEPT_PERCENT: usize = 95;

/// Draws the border. Reuses its memory, and keeps its rectangle while it fits.
#[derive(Debug, Default)]
pub(super) struct Border {
    /// Distance of each cell to the uncovered area, px, up to the width of the fade.
    distance_px: Vec<f32>,
    largest: LargestRectangle,
    /// Black cells whose neighbours must be visited.
    black: Vec<usize>,
    kept: Option<Rect>,
}

impl Border {
    /// Forgets the rectangle.
    pub fn forget(&mut self) {
        self.kept = None;
    }

    /// Changes the border of `out`, whose views cover `spans[view][row]`.
    pub fn draw(&mut self, params: &CompositeParams, spans: &[Vec<Span>], out: &mut ViewMut<u8>, pool: &dyn Parallel) {
        match params.border {
            BorderMethod::AsIs => {}
            BorderMethod::Fade => self.fade(params.border_px.clamp(1, 1024), spans, out, pool),
            BorderMethod::Crop => self.crop(spans, out),
        }
    }

    /// The cells that are fully covered by views, without the black between them and the border.
    fn cells(&mut self, spans: &[Vec<Span>], out: &ViewMut<u8>) -> (usize, usize) {
        let (width, height) = (out.width, out.height);
        let (columns, rows) = (width / CELL_PX, height / CELL_PX);
        self.distance_px.clear();
        self.distance_px.resize(columns * rows, 0.0);
        for row in 0..rows {
            let (mut first, mut end) = (0, width as i64);
            for y in row * CELL_PX..(row + 1) * CELL_PX {
                let (from, to) = covered(spans, y);
                first = first.max(from);
                end = end.min(to);
            }
            let first = (first.max(0) as usize).div_ceil(CELL_PX).min(columns);
            let end = (end.max(0) as usize / CELL_PX).clamp(first, columns);
            self.distance_px[row * columns + first..row * columns + end].fill(f32::INFINITY);
        }
        self.leave_black_out(out, (columns, rows));
        (columns, rows)
    }

    /// Removes the black cells that are connected to the uncovered area.
    fn leave_black_out(&mut self, out: &ViewMut<u8>, (columns, rows): (usize, usize)) {
        let is_black = |cell: usize| {
            let (x, y) = (cell % columns * CELL_PX, cell / columns * CELL_PX);
            (y..y + CELL_PX).all(|y| {
                let from = y * out.stride + x * 3;
                out.data[from..from + CELL_PX * 3].iter().all(|level| *level <= BLACK_LEVELS)
            })
        };
        let near = |cell: usize| {
            let (x, y) = (cell % columns, cell / columns);
            [
                (x > 0).then(|| cell - 1),
                (x + 1 < columns).then(|| cell + 1),
                (y > 0).then(|| cell - columns),
                (y + 1 < rows).then(|| cell + columns),
            ]
        };
        let distance = &mut self.distance_px;
        self.black.clear();
        for cell in 0..columns * rows {
            let at_border = |d: &[f32]| near(cell).iter().any(|next| next.is_none_or(|next| d[next] == 0.0));
            if distance[cell] > 0.0 && at_border(distance) && is_black(cell) {
                distance[cell] = 0.0;
                self.black.push(cell);
            }
        }
        while let Some(cell) = self.black.pop() {
            for next in near(cell).into_iter().flatten() {
                if distance[next] > 0.0 && is_black(next) {
                    distance[next] = 0.0;
                    self.black.push(next);
                }
            }
        }
    }

    fn fade(&mut self, width_px: usize, spans: &[Vec<Span>], out: &mut ViewMut<u8>, pool: &dyn Parallel) {
        let (columns, rows) = self.cells(spans, out);
        if columns == 0 || rows == 0 {
            return;
        }
        let most = width_px as f32;
        chamfer(&mut self.distance_px, (columns, rows), most);
        let distance = &self.distance_px[..];
        let (width, height, stride) = (out.width, out.height, out.stride);
        let target = SharedMut::new(&mut *out.data);
        pool.run(height.div_ceil(CHUNK_ROWS), &|chunk| {
            for y in chunk * CHUNK_ROWS..((chunk + 1) * CHUNK_ROWS).min(height) {
                let (from, to) = covered(spans, y);
                let (from, to) = (from.clamp(0, width as i64) as usize, to.clamp(0, width as i64) as usize);
                if from >= to {
                    continue;
                }
                // SAFETY: rows are split between chunks.
                let row = unsafe { target.part(y * stride, width * 3) };
                let (above, below, t) = between(y, rows);
                let at = |cell: usize| {
                    let (a, b) = (distance[above * columns + cell], distance[below * columns + cell]);
                    a + (b - a) * t
                };
                for cell in from / CELL_PX..to.div_ceil(CELL_PX) {
                    let x0 = (cell * CELL_PX).max(from);
                    let x1 = ((cell + 1) * CELL_PX).min(to);
                    let near = cell.saturating_sub(1)..(cell + 2).min(columns);
                    if near.clone().all(|cell| at(cell) >= most) && !near.is_empty() {
                        continue;
                    }
                    for x in x0..x1 {
                        let (left, right, s) = between(x, columns);
                        let d = at(left) + (at(right) - at(left)) * s;
                        let share = (d / most).clamp(0.0, 1.0);
                        let weight = share * share * (3.0 - 2.0 * share);
                        for value in &mut row[x * 3..x * 3 + 3] {
                            *value = (f32::from(*value) * weight + 0.5) as u8;
                        }
                    }
                }
            }
        });
    }

    fn crop(&mut self, spans: &[Vec<Span>], out: &mut ViewMut<u8>) {
        let (columns, rows) = self.cells(spans, out);
        let best = self.largest.find(columns, rows, |cell| self.distance_px[cell] > 0.0);
        let is_covered = |r: &Rect| {
            r.x + r.width <= columns
                && r.y + r.height <= rows
                && (r.y..r.y + r.height)
                    .all(|y| self.distance_px[y * columns + r.x..][..r.width].iter().all(|d| *d > 0.0))
        };
        let area = |r: &Rect| r.width * r.height;
        let keeps = self.kept.filter(is_covered).filter(|kept| area(kept) * 100 >= area(&best) * KEPT_PERCENT);
        let cells = keeps.unwrap_or(best);
        self.kept = Some(cells);
        let (x0, x1) = (cells.x * CELL_PX, (cells.x + cells.width) * CELL_PX);
        let within = cells.y * CELL_PX..(cells.y + cells.height) * CELL_PX;
        let width = out.width;
        for y in 0..out.height {
            let row = out.row_mut(y);
            if within.contains(&y) {
                row[..x0 * 3].fill(0);
                row[x1 * 3..width * 3].fill(0);
            } else {
                row[..width * 3].fill(0);
            }
        }
    }
}

/// Columns of a row that views cover, from the first to the last.
fn covered(spans: &[Vec<Span>], y: usize) -> (i64, i64) {
    let rows = spans.iter().filter_map(|view| view.get(y)).filter(|span| !span.is_empty());
    rows.fold((i64::MAX, 0), |(from, to), span| (from.min(i64::from(span.start)), to.max(i64::from(span.end))))
}

/// Pixels of the canvas from the first to the last that views cover in each row.
pub(super) fn covered_px(spans: &[Vec<Span>]) -> usize {
    let rows = spans.first().map_or(0, Vec::len);
    (0..rows).map(|y| covered(spans, y)).map(|(from, to)| (to - from.min(to)) as usize).sum()
}

/// The two cells whose centres are before and behind a pixel, and its place between them.
fn between(pixel: usize, cells: usize) -> (usize, usize, f32) {
    let place = (pixel as f32 + 0.5) / CELL_PX as f32 - 0.5;
    let first = place.floor().max(0.0);
    let before = (first as usize).min(cells - 1);
    let behind = (before + 1).min(cells - 1);
    (before, behind, (place - first).clamp(0.0, 1.0))
}

/// Distances to the nearest cell that is 0 or lies outside, px, up to `most`: 1 to the next cell, 1.4 to that at the
/// corner.
fn chamfer(distance_px: &mut [f32], (columns, rows): (usize, usize), most: f32) {
    let (side, corner) = (CELL_PX as f32, CELL_PX as f32 * std::f32::consts::SQRT_2);
    // Half a cell before the border: its centre.
    let outside = side / 2.0;
    for turn in 0..2 {
        for k in 0..rows * columns {
            let index = if turn == 0 { k } else { rows * columns - 1 - k };
            let (x, y) = (index % columns, index / columns);
            if distance_px[index] == 0.0 {
                continue;
            }
            let near = |dx: i64, dy: i64, step: f32| {
                let (x, y) = (x as i64 + dx, y as i64 + dy);
                if x < 0 || y < 0 || x >= columns as i64 || y >= rows as i64 {
                    return outside;
                }
                match distance_px[y as usize * columns + x as usize] {
                    0.0 => step - outside,
                    d => d + step,
                }
            };
            let sign = if turn == 0 { -1 } else { 1 };
            let nearest = near(sign, 0, side)
                .min(near(0, sign, side))
                .min(near(sign, sign, corner))
                .min(near(-sign, sign, corner))
                .min(distance_px[index]);
            distance_px[index] = nearest.min(most);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Serial;

    const SIZE: (usize, usize) = (200, 120);

    /// A disc-like coverage: rows are narrower towards top and bottom.
    fn ragged() -> Vec<Vec<Span>> {
        let rows = (0..SIZE.1).map(|y| {
            let inset = y.abs_diff(60) as u32 / 2 + y as u32 % 7;
            if (4..116).contains(&y) { Span { start: inset, end: 200 - inset / 2 } } else { Span { start: 0, end: 0 } }
        });
        vec![rows.collect()]
    }

    fn painted(spans: &[Vec<Span>]) -> Vec<u8> {
        let mut data = vec![0; SIZE.0 * SIZE.1 * 3];
        for y in 0..SIZE.1 {
            let (from, to) = covered(spans, y);
            if from < to {
                data[(y * SIZE.0 + from as usize) * 3..(y * SIZE.0 + to as usize) * 3].fill(200);
            }
        }
        data
    }

    fn drawn(border: &mut Border, spans: &[Vec<Span>], method: BorderMethod) -> Vec<u8> {
        let params = CompositeParams { border: method, border_px: 24, ..CompositeParams::default() };
        let mut data = painted(spans);
        border.draw(&params, spans, &mut ViewMut::new(&mut data, SIZE.0, SIZE.1, 3), &Serial);
        data
    }

    #[test]
    fn a_fade_is_black_at_the_border_and_leaves_the_middle() {
        let spans = ragged();
        let (before, after) = (painted(&spans), drawn(&mut Border::default(), &spans, BorderMethod::Fade));
        let at = |x: usize, y: usize| after[(y * SIZE.0 + x) * 3];
        for y in 4..116 {
            let (from, to) = covered(&spans, y);
            assert!(at(from as usize, y) < 20 && at(to as usize - 1, y) < 20, "row {y}");
        }
        for x in 60..140 {
            assert_eq!(at(x, 60), 200, "column {x}");
            // Towards the middle it only grows.
            for y in 5..50 {
                assert!(at(x, y) + 2 >= at(x, y - 1), "column {x}, row {y}: {} after {}", at(x, y), at(x, y - 1));
            }
        }
        assert!(before.iter().zip(&after).all(|(b, a)| a <= b));
        let steps = after.chunks_exact(3 * SIZE.0).map(|row| {
            row.chunks_exact(3).collect::<Vec<_>>().windows(2).map(|two| two[0][0].abs_diff(two[1][0])).max()
        });
        assert!(steps.flatten().all(|step| step < 40), "no edge is left");
    }

    #[test]
    fn a_crop_leaves_the_largest_rectangle_and_keeps_it_while_it_fits() {
        let mut border = Border::default();
        let spans = ragged();
        let after = drawn(&mut border, &spans, BorderMethod::Crop);
        let lit = |data: &[u8]| {
            let all: Vec<(usize, usize)> =
                (0..SIZE.0 * SIZE.1).filter(|k| data[k * 3] > 0).map(|k| (k % SIZE.0, k / SIZE.0)).collect();
            let (x0, x1) = (all.iter().map(|p| p.0).min().unwrap(), all.iter().map(|p| p.0).max().unwrap());
            let (y0, y1) = (all.iter().map(|p| p.1).min().unwrap(), all.iter().map(|p| p.1).max().unwrap());
            assert_eq!(all.len(), (x1 + 1 - x0) * (y1 + 1 - y0), "a full rectangle");
            Rect { x: x0, y: y0, width: x1 + 1 - x0, height: y1 + 1 - y0 }
        };
        let first = lit(&after);
        let inside = |r: &Rect| (r.y..r.y + r.height).all(|y| covered(&spans, y).0 <= r.x as i64);
        assert!(inside(&first));
        // The best of all rectangles, tried one by one on a coarse grid.
        let mut best = 0;
        for y0 in (0..120).step_by(4) {
            for y1 in (y0 + 4..=120).step_by(4) {
                let rows = (y0..y1).map(|y| covered(&spans, y));
                let (from, to) = rows.fold((0, 200), |(f, t), (from, to)| (f.max(from.min(200)), t.min(to)));
                let width = (to / 4 * 4 - (from + 3) / 4 * 4).max(0) as usize;
                best = best.max(width * (y1 - y0));
            }
        }
        assert_eq!(first.width * first.height, best);
        // A little more cover does not move it, less does.
        let mut more = spans.clone();
        more[0].iter_mut().filter(|span| !span.is_empty()).for_each(|span| span.start = span.start.saturating_sub(3));
        assert_eq!(lit(&drawn(&mut border, &more, BorderMethod::Crop)), first);
        let mut less = spans.clone();
        less[0].iter_mut().filter(|span| !span.is_empty()).for_each(|span| span.start += 9);
        let smaller = lit(&drawn(&mut border, &less, BorderMethod::Crop));
        assert!(smaller.x > first.x, "{smaller:?} after {first:?}");
    }

    #[test]
    fn the_black_around_a_round_picture_is_outside_and_a_dark_instrument_is_not() {
        // A disc of tissue on black, with the noise of a compressed picture; the view covers all of it.
        let spans = vec![vec![Span { start: 0, end: SIZE.0 as u32 }; SIZE.1]];
        let inside = |x: usize, y: usize| (x as f32 - 100.0).hypot(y as f32 - 60.0) < 56.0;
        let is_tool = |x: usize, y: usize| (90..110).contains(&x) && (50..70).contains(&y);
        let picture = |border: &mut Border, method| {
            let params = CompositeParams { border: method, border_px: 24, ..CompositeParams::default() };
            let level = |x: usize, y: usize| match inside(x, y) {
                true if is_tool(x, y) => 3,
                true => 200,
                false => ((x * 7 + y * 3) % 9) as u8,
            };
            let mut data: Vec<u8> = (0..SIZE.0 * SIZE.1).flat_map(|k| [level(k % SIZE.0, k / SIZE.0); 3]).collect();
            border.draw(&params, &spans, &mut ViewMut::new(&mut data, SIZE.0, SIZE.1, 3), &Serial);
            data
        };
        let faded = picture(&mut Border::default(), BorderMethod::Fade);
        let at = |data: &[u8], x: usize, y: usize| data[(y * SIZE.0 + x) * 3];
        assert!(at(&faded, 47, 60) < 40 && at(&faded, 153, 60) < 40 && at(&faded, 100, 7) < 40, "the rim of the disc");
        assert_eq!((at(&faded, 80, 60), at(&faded, 112, 60)), (200, 200), "beside the instrument");
        let cropped = picture(&mut Border::default(), BorderMethod::Crop);
        for k in (0..SIZE.0 * SIZE.1).filter(|k| cropped[k * 3] > BLACK_LEVELS) {
            let (x, y) = (k % SIZE.0, k / SIZE.0);
            assert!((x as f32 - 100.0).hypot(y as f32 - 60.0) < 62.0, "{x}, {y} is no tissue");
        }
        assert_eq!(at(&cropped, 100, 40), 200);
    }

    #[test]
    fn small_and_empty_covers_are_no_trouble() {
        for method in [BorderMethod::AsIs, BorderMethod::Fade, BorderMethod::Crop] {
            for (width, height) in [(1, 1), (3, 9), (9, 3), (8, 8)] {
                let params = CompositeParams { border: method, border_px: 24, ..CompositeParams::default() };
                for end in [0, width as u32] {
                    let spans = vec![vec![Span { start: 0, end }; height]];
                    let mut data = vec![9; width * height * 3];
                    Border::default().draw(&params, &spans, &mut ViewMut::new(&mut data, width, height, 3), &Serial);
                }
            }
        }
    }
}
