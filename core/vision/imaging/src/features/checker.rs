//! Corners of a chessboard that is covered in places or only seen in part: saddle points of the brightness, joined to a grid.
//!
//! At a corner of four squares the brightness is a saddle, and two bright squares lie opposite each other; neighbouring corners have them the other way
//! round. So a grid grows from a corner to neighbours of the other polarity where the corners before let them be expected. Lines, tiles with joints and
//! keys of a keyboard have no such alternation.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use crate::shrink::{enlarged_px, shrink};
use crate::{Serial, View, ViewMut};

/// A corner: column and row on the grid, and the position in px.
pub type GridCorner = ([i32; 2], [f64; 2]);

/// A grid of corners.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CheckerGrid {
    /// Columns run to the right of the image or down, rows clockwise of them. The smallest column and row are 0.
    pub corners: Vec<GridCorner>,
    /// Columns and rows from the first to the last with a corner.
    pub size: [usize; 2],
}

/// Standard deviation of the smoothing, px.
const SMOOTHING_PX: f64 = 1.5;
/// Distance from a corner at which its squares are compared, px.
const RING_PX: f64 = 4.5;
/// Points on the ring.
const RING: usize = 24;
/// Least share of the ring's variation that alternates twice, as four squares do.
const MIN_ALTERNATION: f64 = 0.6;
/// Largest share by which opposite points of the ring differ.
const MAX_UNEVEN: f64 = 0.15;
/// Contrast of a corner, at least, relative to that of a neighbour on the grid.
const MIN_CONTRAST: f64 = 0.5;
/// Least saddle, gray levels per px^2.
const MIN_SADDLE: f64 = 0.35;
/// Most candidates.
const MAX_CANDIDATES: usize = 3000;
/// Most corners that a grid is grown from.
const MAX_SEEDS: usize = 60;
/// Distance from where a corner is expected, shares of a square.
const NEAR: f64 = 0.28;
/// Largest angle between the border of two squares and the way to the next corner, rad.
const ALONG_RAD: f64 = 0.5;
/// How far beside the border of two squares they are compared, shares of a square, and by how much they must differ, shares of a corner's contrast.
const BESIDE: f64 = 0.25;
const MIN_BORDER: f64 = 0.5;
/// Rows that may be covered between a corner and the row that its step is taken from.
const MAX_COVERED: i32 = 4;
/// Fewest corners of a grid.
pub const MIN_CORNERS: usize = 12;
/// Quantiles of how far corners are off the middle between those on both sides, and the most that they may be, shares of a square: on boards seen by
/// endoscopes, in blur and noise, they are 0.05 and 0.13 at most, in textures 0.07 and 0.1 at least, mostly the double.
const MAX_BENDS: [(f64, f64); 2] = [(0.5, 0.06), (0.9, 0.15)];
/// Smallest side of an image, px.
const MIN_SIDE_PX: usize = 16;

/// A saddle point between four squares.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    at: [f64; 2],
    saddle: f64,
    ring: Ring,
}

/// What is seen around it.
#[derive(Clone, Copy, Debug)]
struct Ring {
    /// Twice the angle of the bright squares, rad.
    bright: f64,
    /// Amplitude of what alternates twice, gray levels.
    contrast: f64,
}

/// The largest grid of corners in a gray image, at its size or at half of it, where blur is smaller; none of fewer than [`MIN_CORNERS`]. Corners are right
/// to about a pixel.
pub fn find(gray: &View<'_, u8>) -> Option<CheckerGrid> {
    if gray.width < MIN_SIDE_PX || gray.height < MIN_SIDE_PX {
        return None;
    }
    let whole = at_size(gray);
    let (width, height) = (gray.width / 2, gray.height / 2);
    let mut small = vec![0; width * height];
    shrink(*gray, 2, ViewMut::new(&mut small, width, height, 1), &Serial);
    let half = at_size(&View::new(&small, width, height, 1));
    let is_larger = |half: &CheckerGrid| whole.as_ref().is_none_or(|whole| half.corners.len() > whole.corners.len());
    match half.filter(is_larger) {
        Some(mut half) => {
            half.corners.iter_mut().for_each(|(_, at)| *at = at.map(|v| enlarged_px(v, 2)));
            Some(half)
        }
        None => whole,
    }
}

fn at_size(gray: &View<'_, u8>) -> Option<CheckerGrid> {
    if gray.width < MIN_SIDE_PX || gray.height < MIN_SIDE_PX {
        return None;
    }
    let image = Smooth::new(gray);
    let candidates = candidates(&image);
    let mut used = vec![false; candidates.len()];
    let mut best = Vec::new();
    for seed in 0..candidates.len().min(MAX_SEEDS) {
        if used[seed] {
            continue;
        }
        let grid = grown(&image, &candidates, seed);
        grid.values().for_each(|index| used[*index] = true);
        let grid: Vec<GridCorner> =
            in_squares(grid).iter().map(|(cell, index)| (*cell, candidates[*index].at)).collect();
        if grid.len() > best.len() && is_straight(&grid) {
            best = grid;
        }
    }
    (best.len() >= MIN_CORNERS).then(|| oriented(best))
}

/// The smoothed image.
struct Smooth {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Smooth {
    fn new(gray: &View<'_, u8>) -> Self {
        let (width, height) = (gray.width, gray.height);
        let reach = (3.0 * SMOOTHING_PX).ceil() as isize;
        let mut weights: Vec<f64> =
            (-reach..=reach).map(|d| (-(d as f64 / SMOOTHING_PX).powi(2) / 2.0).exp()).collect();
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= sum);
        let inside = |at: isize, size: usize| at.clamp(0, size as isize - 1) as usize;
        let mut rows = vec![0.0f32; width * height];
        for y in 0..height {
            let row = gray.row(y);
            for x in 0..width {
                let near = weights.iter().zip(x as isize - reach..);
                rows[y * width + x] = near.map(|(w, x)| w * f64::from(row[inside(x, width)])).sum::<f64>() as f32;
            }
        }
        let mut values = vec![0.0f32; width * height];
        for y in 0..height {
            for (weight, from) in weights.iter().zip(y as isize - reach..) {
                let from = &rows[inside(from, height) * width..][..width];
                values[y * width..][..width].iter_mut().zip(from).for_each(|(to, value)| *to += *weight as f32 * value);
            }
        }
        Self { width, height, values }
    }

    fn at(&self, x: usize, y: usize) -> f64 {
        self.values[y * self.width + x].into()
    }

    /// Between four pixels; beyond the image as on its border.
    fn between(&self, x: f64, y: f64) -> f64 {
        let inside = |at: f64, size: usize| at.clamp(0.0, size as f64 - 1.001);
        let (x, y) = (inside(x, self.width), inside(y, self.height));
        let (x0, y0) = (x.floor() as usize, y.floor() as usize);
        let (fx, fy) = (x - x0 as f64, y - y0 as f64);
        let row = |y: usize| self.at(x0, y) * (1.0 - fx) + self.at(x0 + 1, y) * fx;
        row(y0) * (1.0 - fy) + row(y0 + 1) * fy
    }

    /// Square root of minus the determinant of the second derivatives; 0 where it is no saddle.
    fn saddle(&self, x: usize, y: usize) -> f64 {
        let (i, at) =
            (self.at(x, y), |dx: isize, dy: isize| self.at(x.wrapping_add_signed(dx), y.wrapping_add_signed(dy)));
        let (xx, yy) = (at(1, 0) - 2.0 * i + at(-1, 0), at(0, 1) - 2.0 * i + at(0, -1));
        let xy = (at(1, 1) - at(-1, 1) - at(1, -1) + at(-1, -1)) / 4.0;
        (xy * xy - xx * yy).max(0.0).sqrt()
    }
}

/// Saddle points between four squares, the strongest first.
fn candidates(image: &Smooth) -> Vec<Candidate> {
    let (width, height) = (image.width, image.height);
    let mut saddles = vec![0.0f64; width * height];
    for y in 1..height - 1 {
        (1..width - 1).for_each(|x| saddles[y * width + x] = image.saddle(x, y));
    }
    let mut out = Vec::new();
    let border = RING_PX.ceil() as usize + 1;
    for y in border..height - border {
        for x in border..width - border {
            let saddle = saddles[y * width + x];
            if saddle < MIN_SADDLE {
                continue;
            }
            let around = (y - 3..=y + 3).flat_map(|y| (x - 3..=x + 3).map(move |x| y * width + x));
            let here = y * width + x;
            let is_peak = around.into_iter().all(|at| saddles[at] < saddle || at >= here && saddles[at] == saddle);
            if is_peak && let Some(ring) = alternation(image, x as f64, y as f64) {
                out.push(Candidate { at: [x as f64, y as f64], saddle, ring });
            }
        }
    }
    out.sort_by(|a, b| b.saddle.total_cmp(&a.saddle));
    out.truncate(MAX_CANDIDATES);
    out
}

/// Twice the angle of the bright squares around a point; `None` where no four squares meet.
fn alternation(image: &Smooth, x: f64, y: f64) -> Option<Ring> {
    let angle = |k: usize| 2.0 * PI * k as f64 / RING as f64;
    let ring: [f64; RING] =
        std::array::from_fn(|k| image.between(x + RING_PX * angle(k).cos(), y + RING_PX * angle(k).sin()));
    let mean = ring.iter().sum::<f64>() / RING as f64;
    let all: f64 = ring.iter().map(|value| (value - mean).powi(2)).sum();
    let part = |f: fn(f64) -> f64| ring.iter().enumerate().map(|(k, value)| value * f(2.0 * angle(k))).sum::<f64>();
    let (cos, sin) = (part(f64::cos), part(f64::sin));
    let twice = (cos * cos + sin * sin) * 2.0 / RING as f64;
    let (half, other) = ring.split_at(RING / 2);
    let uneven: f64 = half.iter().zip(other).map(|(a, b)| (a - b).powi(2) / 2.0).sum();
    (twice > MIN_ALTERNATION * all && uneven < MAX_UNEVEN * all)
        .then(|| Ring { bright: sin.atan2(cos), contrast: (2.0 * twice / RING as f64).sqrt() })
}

/// Whether the way from one corner to the next is the border of a bright and a dark square. Between joints of tiles lie saddles that alternate too, but
/// the way from one to the next crosses a tile.
fn is_border(image: &Smooth, a: &Candidate, b: &Candidate) -> bool {
    let step = minus(b.at, a.at);
    let middle = plus(a.at, b.at).map(|v| v / 2.0);
    let beside = |side: f64| image.between(middle[0] - side * step[1], middle[1] + side * step[0]);
    (beside(BESIDE) - beside(-BESIDE)).abs() > MIN_BORDER * a.ring.contrast
}

/// Whether two corners have their bright squares the other way round (-1) or the same way (1).
fn likeness(a: &Candidate, b: &Candidate) -> f64 {
    (a.ring.bright - b.ring.bright).cos()
}

fn minus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn plus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] + b[0], a[1] + b[1]]
}

fn length(a: [f64; 2]) -> f64 {
    a[0].hypot(a[1])
}

/// The candidate nearest to a position, within a distance, that `fits`.
fn nearest(all: &[Candidate], at: [f64; 2], within: f64, fits: impl Fn(usize) -> bool) -> Option<usize> {
    let near = all.iter().enumerate().map(|(index, candidate)| (index, length(minus(candidate.at, at))));
    near.filter(|(index, d)| *d <= within && fits(*index)).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index)
}

/// The next corner along one border of the squares around `seed`, on either side.
fn neighbour(image: &Smooth, all: &[Candidate], seed: usize, border_rad: f64) -> Option<usize> {
    let from = all[seed].at;
    nearest(all, from, f64::INFINITY, |index| {
        let way = minus(all[index].at, from);
        let off = (way[1].atan2(way[0]) - border_rad).rem_euclid(PI);
        index != seed
            && off.min(PI - off) < ALONG_RAD
            && likeness(&all[index], &all[seed]) < -0.5
            && is_border(image, &all[seed], &all[index])
    })
}

/// The grid around one corner.
fn grown(image: &Smooth, all: &[Candidate], seed: usize) -> BTreeMap<[i32; 2], usize> {
    let mut grid = BTreeMap::new();
    // The borders run between the bright squares and the dark ones.
    let border = all[seed].ring.bright / 2.0 + PI / 4.0;
    let (Some(a), Some(b)) = (neighbour(image, all, seed, border), neighbour(image, all, seed, border + PI / 2.0))
    else {
        return grid;
    };
    let across = plus(all[a].at, minus(all[b].at, all[seed].at));
    let size = length(minus(all[a].at, all[seed].at)).min(length(minus(all[b].at, all[seed].at)));
    let Some(opposite) = nearest(all, across, NEAR * size, |index| likeness(&all[index], &all[seed]) > 0.5) else {
        return grid;
    };
    grid.extend([([0, 0], seed), ([1, 0], a), ([0, 1], b), ([1, 1], opposite)]);
    let mut used = vec![false; all.len()];
    grid.values().for_each(|index| used[*index] = true);
    // Round by round, so that a corner is expected from as many as can be.
    loop {
        let mut next: Vec<([i32; 2], usize)> = Vec::new();
        for cell in grid.keys() {
            for step in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
                let to = [cell[0] + step[0], cell[1] + step[1]];
                if grid.contains_key(&to) || next.iter().any(|(known, _)| *known == to) {
                    continue;
                }
                let Some((at, square)) = expected(&grid, all, to) else { continue };
                let from = &all[grid[cell]];
                let same = if (to[0] + to[1]) % 2 == 0 { 1.0 } else { -1.0 };
                let fits = |index: usize| {
                    !used[index]
                        && all[index].ring.contrast > MIN_CONTRAST * from.ring.contrast
                        && is_border(image, from, &all[index])
                        && same * likeness(&all[index], &all[seed]) > 0.2
                        && !next.iter().any(|(_, at)| *at == index)
                };
                if let Some(found) = nearest(all, at, NEAR * square, fits) {
                    next.push((to, found));
                }
            }
        }
        if next.is_empty() {
            return grid;
        }
        for (cell, index) in next {
            used[index] = true;
            grid.insert(cell, index);
        }
    }
}

/// The corners that are one of four around a square: what lies beyond the board joins it by single steps.
fn in_squares(mut grid: BTreeMap<[i32; 2], usize>) -> BTreeMap<[i32; 2], usize> {
    loop {
        let count = grid.len();
        let known = grid.clone();
        grid.retain(|[x, y], _| {
            let around = |dx: i32, dy: i32| {
                [[dx, 0], [0, dy], [dx, dy]].iter().all(|[a, b]| known.contains_key(&[x + a, y + b]))
            };
            around(1, 1) || around(1, -1) || around(-1, 1) || around(-1, -1)
        });
        if grid.len() == count {
            return grid;
        }
    }
}

/// Where a corner is to be expected from those beside it, and the length of a square there.
fn expected(grid: &BTreeMap<[i32; 2], usize>, all: &[Candidate], to: [i32; 2]) -> Option<([f64; 2], f64)> {
    let at = |dx: i32, dy: i32| grid.get(&[to[0] + dx, to[1] + dy]).map(|index| all[*index].at);
    let (mut sum, mut square, mut count) = ([0.0; 2], 0.0, 0.0);
    let mut add = |place: [f64; 2], step: [f64; 2], weight: f64| {
        sum = plus(sum, place.map(|v| v * weight));
        square += weight * length(step);
        count += weight;
    };
    for [dx, dy] in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
        let Some(beside) = at(dx, dy) else { continue };
        // On along a row; with a third corner the step's own change goes on too.
        if let Some(before) = at(2 * dx, 2 * dy) {
            let step = minus(beside, before);
            let more = at(3 * dx, 3 * dy).map_or([0.0; 2], |first| minus(step, minus(before, first)));
            add(plus(plus(beside, step), more), step, 2.0);
        }
        // As in the nearest row beside it: corners between may be covered.
        for side in [1, -1] {
            let step_beside = |row: i32| {
                let (x, y) = (dy * side * row, dx * side * row);
                Some(minus(at(x, y)?, at(dx + x, dy + y)?))
            };
            if let Some(step) = (1..=MAX_COVERED + 1).find_map(step_beside) {
                add(plus(beside, step), step, 1.0);
            }
        }
    }
    (count > 0.0).then(|| (sum.map(|v| v / count), square / count))
}

/// Whether most corners lie in the middle between those on both sides, as on a board, however it is tilted; corners of a texture do not.
fn is_straight(corners: &[GridCorner]) -> bool {
    let at: BTreeMap<[i32; 2], [f64; 2]> = corners.iter().copied().collect();
    let mut bends = Vec::new();
    for ([x, y], place) in corners {
        for [dx, dy] in [[1, 0], [0, 1]] {
            if let (Some(a), Some(b)) = (at.get(&[x - dx, y - dy]), at.get(&[x + dx, y + dy])) {
                let middle = plus(*a, *b).map(|v| v / 2.0);
                bends.push(2.0 * length(minus(*place, middle)) / length(minus(*b, *a)));
            }
        }
    }
    bends.sort_by(f64::total_cmp);
    MAX_BENDS.iter().all(|(share, most)| {
        bends.get((share * bends.len().saturating_sub(1) as f64) as usize).is_some_and(|bend| bend < most)
    })
}

/// Turned so that columns run to the right of the image and rows down, with cells from 0.
fn oriented(corners: Vec<GridCorner>) -> CheckerGrid {
    // Directions of columns and rows, by all corners.
    let count = corners.len() as f64;
    let mean = |of: &dyn Fn(&GridCorner) -> f64| corners.iter().map(of).sum::<f64>() / count;
    let middle = [0, 1].map(|axis: usize| mean(&|corner| f64::from(corner.0[axis])));
    let along =
        |axis: usize| [0, 1].map(|k: usize| mean(&|corner| (f64::from(corner.0[axis]) - middle[axis]) * corner.1[k]));
    let (x, y) = (along(0), along(1));
    let is_mirrored = x[0] * y[1] - x[1] * y[0] < 0.0;
    // A mirrored grid has its axes exchanged, then a quarter turn at a time brings the columns to the right.
    let mut turn: [[i32; 2]; 2] = if is_mirrored { [[0, 1], [1, 0]] } else { [[1, 0], [0, 1]] };
    let mut columns = if is_mirrored { y } else { x };
    let mut rows = if is_mirrored { x } else { y };
    for _ in 0..3 {
        if columns[0] >= columns[1].abs() {
            break;
        }
        (columns, rows) = (rows.map(|v| -v), columns);
        turn = [turn[1].map(|v| -v), turn[0]];
    }
    let mut out: Vec<GridCorner> =
        corners.iter().map(|(cell, at)| (turn.map(|row| row[0] * cell[0] + row[1] * cell[1]), *at)).collect();
    let range = |axis: usize| {
        let all = out.iter().map(|(cell, _)| cell[axis]);
        (all.clone().min().unwrap_or(0), all.max().unwrap_or(0))
    };
    let ((left, right), (top, bottom)) = (range(0), range(1));
    out.iter_mut().for_each(|(cell, _)| *cell = [cell[0] - left, cell[1] - top]);
    out.sort_by_key(|(cell, _)| [cell[1], cell[0]]);
    CheckerGrid { corners: out, size: [(right - left + 1) as usize, (bottom - top + 1) as usize] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_base::random::lattice;

    const SIZE: (usize, usize) = (320, 240);

    fn picture(shade: impl Fn(f64, f64) -> f64) -> Vec<u8> {
        let mut out = Vec::with_capacity(SIZE.0 * SIZE.1);
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                // The mean of 16 places of each pixel.
                let at = |v: usize, k: usize| v as f64 + (k as f64 - 1.5) / 4.0;
                let sum: f64 = (0..16).map(|k| shade(at(x, k % 4), at(y, k / 4))).sum();
                let noise = 4.0 * (lattice(x as i64, y as i64, 9) - 0.5);
                out.push((sum / 16.0 + noise) as u8);
            }
        }
        out
    }

    fn found(picture: &[u8]) -> Option<CheckerGrid> {
        find(&View::new(picture, SIZE.0, SIZE.1, 1))
    }

    /// Column and row on the board at a pixel: a board of 8 x 6 squares, turned and in perspective.
    fn on_board(x: f64, y: f64) -> [f64; 2] {
        let w = 1.0 + 0.0006 * x + 0.0004 * y;
        [(x * 0.040 + y * 0.008 - 2.4) * w, (y * 0.040 - x * 0.007 - 0.9) * w]
    }

    fn square(x: f64, y: f64) -> f64 {
        let [c, r] = on_board(x, y);
        let is_inside = (0.0..8.0).contains(&c) && (0.0..6.0).contains(&r);
        if is_inside && (c.floor() + r.floor()) as i64 % 2 == 0 { 40.0 } else { 210.0 }
    }

    #[test]
    fn a_board_is_found_whole() {
        let grid = found(&picture(square)).expect("a grid");
        assert_eq!((grid.size, grid.corners.len()), ([7, 5], 35));
        for (cell, [x, y]) in &grid.corners {
            let [c, r] = on_board(*x, *y);
            let off = (c - f64::from(cell[0]) - 1.0).hypot(r - f64::from(cell[1]) - 1.0);
            assert!(off < 0.08, "{cell:?} at {x} {y}: {off} squares off");
        }
    }

    #[test]
    fn a_board_with_covered_corners_keeps_its_extent() {
        let glare = |x: f64, y: f64| if (x - 150.0).hypot(y - 110.0) < 22.0 { 250.0 } else { square(x, y) };
        let grid = found(&picture(glare)).expect("a grid");
        assert_eq!(grid.size, [7, 5]);
        assert!((20..35).contains(&grid.corners.len()), "{}", grid.corners.len());
        // Cells are those of the board.
        assert!(grid.corners.iter().all(|(cell, [x, y])| (on_board(*x, *y)[0] - f64::from(cell[0]) - 1.0).abs() < 0.1));
    }

    #[test]
    fn what_is_no_chessboard_has_no_grid() {
        let cells = |x: f64, y: f64, side: f64| lattice((x / side) as i64, (y / side) as i64, 3);
        type Shade<'a> = &'a dyn Fn(f64, f64) -> f64;
        let grids: [(&str, Shade<'_>); 5] = [
            ("tiles with joints", &|x, y| if x % 24.0 < 3.0 || y % 24.0 < 3.0 { 60.0 } else { 200.0 }),
            ("tiles of random shades", &|x, y| 40.0 + 180.0 * cells(x, y, 24.0)),
            ("bricks", &|x, y| {
                let shift = if (y / 20.0) as i64 % 2 == 0 { 0.0 } else { 20.0 };
                if (x + shift) % 40.0 < 4.0 || y % 20.0 < 4.0 { 200.0 } else { 120.0 }
            }),
            ("keys", &|x, y| {
                let (x, y) = ((x + 7.0 * (y / 26.0).floor()) % 26.0, y % 26.0);
                if (4.0..22.0).contains(&x) && (4.0..22.0).contains(&y) { 45.0 } else { 150.0 }
            }),
            ("random texture", &|x, y| 255.0 * cells(x, y, 7.0)),
        ];
        for (name, shade) in grids {
            assert_eq!(found(&picture(shade)), None, "{name}");
        }
        assert_eq!(find(&View::new(&[0; 12], 4, 3, 1)), None);
    }
}
