//! Paths of wires around nodes: horizontal and vertical lines that pass under nothing.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};

use super::Rectangle;

/// Size of the cells by which obstacles near a line are found, in points at zoom 1.
const CELL: f32 = 256.0;
/// Least distance between a path and what it passes, in points.
const CLEAR: f32 = 4.0;
/// Distance of the innermost path from what it passes, of each further one, and the number of them.
const INNERMOST: f32 = 8.0;
const STEP: f32 = 4.0;
const PATHS: usize = 4;
/// What a turn costs, in points of length.
const TURN: f32 = 48.0;
/// How often a path is searched again with the obstacles that the one before met.
const ROUNDS: usize = 24;
/// Depth by which a line must be inside a rectangle to be under it, in points.
const DEPTH: f32 = 1.0;

/// What wires must not pass under: nodes, and frames of parts.
#[derive(Clone, Debug, Default)]
pub struct Obstacles {
    rects: Vec<[[f32; 2]; 2]>,
    cells: HashMap<(i32, i32), Vec<usize>>,
}

/// The ends of a wire.
#[derive(Clone, Copy, Debug)]
pub struct Ends<'a> {
    /// The pin of the output.
    pub from: [f32; 2],
    /// The pin of the input.
    pub to: [f32; 2],
    /// Obstacles that the wire may pass under: frames around its nodes.
    pub within: &'a [usize],
    /// Which of the paths beside each other it takes; the same for all wires of an output.
    pub net: usize,
}

impl Obstacles {
    /// Obstacles by their index. Those without a finite position are left out.
    pub fn new(rects: impl Iterator<Item = Rectangle>) -> Self {
        let mut all = Self::default();
        for (at, size) in rects {
            let rect = [at, [at[0] + size[0], at[1] + size[1]]];
            if rect.as_flattened().iter().all(|v| v.is_finite()) {
                for cell in cells(rect[0], rect[1]) {
                    all.cells.entry(cell).or_default().push(all.rects.len());
                }
            }
            all.rects.push(rect);
        }
        all
    }

    /// The obstacles that a straight line passes under, each with its index. `margin` widens them; a negative one narrows them.
    fn met(&self, a: [f32; 2], b: [f32; 2], within: &[usize], margin: f32) -> Vec<usize> {
        let (low, high) = ([a[0].min(b[0]), a[1].min(b[1])], [a[0].max(b[0]), a[1].max(b[1])]);
        let wide = margin.max(0.0);
        let near = cells([low[0] - wide, low[1] - wide], [high[0] + wide, high[1] + wide]);
        let near = near.filter_map(|cell| self.cells.get(&cell)).flatten().copied();
        let mut found: Vec<usize> =
            near.filter(|n| !within.contains(n) && passes(a, b, self.rects[*n], margin)).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Obstacles that a path of straight lines passes under.
    pub fn under(&self, path: &[[f32; 2]], within: &[usize]) -> Vec<usize> {
        let met = path.windows(2).flat_map(|ends| self.met(ends[0], ends[1], within, -DEPTH));
        let met: HashSet<usize> = met.collect();
        met.into_iter().collect()
    }

    /// The corners of a path that leaves `from` to the right, reaches `to` from the left, and passes under nothing; `None` where there is no such path.
    pub fn around(&self, ends: &Ends<'_>) -> Option<Vec<[f32; 2]>> {
        let away = INNERMOST + STEP * (ends.net % PATHS) as f32;
        let (start, end) = ([ends.from[0] + away, ends.from[1]], [ends.to[0] - away, ends.to[1]]);
        let is_covered = |a, b| !self.met(a, b, ends.within, -DEPTH).is_empty();
        if is_covered(ends.from, start) || is_covered(end, ends.to) {
            return None;
        }
        // Only what a path meets becomes an obstacle of the next one: most nodes of a graph are never in the way.
        let mut known: Vec<usize> = self.met(start, end, ends.within, CLEAR);
        let at_ends = [(ends.from, start), (end, ends.to)].into_iter();
        known.extend(at_ends.flat_map(|(a, b)| self.met(a, b, ends.within, CLEAR)));
        known.sort_unstable();
        known.dedup();
        for _ in 0..ROUNDS {
            let rects: Vec<[[f32; 2]; 2]> = known.iter().map(|n| self.rects[*n]).collect();
            let path = search(start, end, &rects, away)?;
            let lines = path.windows(2).flat_map(|line| self.met(line[0], line[1], ends.within, CLEAR - 0.5));
            let mut new: Vec<usize> = lines.filter(|n| !known.contains(n)).collect();
            if new.is_empty() {
                let mut whole = vec![ends.from];
                whole.extend(path);
                whole.push(ends.to);
                return Some(straightened(&whole));
            }
            new.sort_unstable();
            new.dedup();
            known.extend(new);
        }
        None
    }
}

/// The cells that a rectangle touches.
fn cells(low: [f32; 2], high: [f32; 2]) -> impl Iterator<Item = (i32, i32)> {
    let cell = |v: f32| (v / CELL).floor() as i32;
    let (rows, columns) = (cell(low[1])..=cell(high[1]), cell(low[0])..=cell(high[0]));
    rows.flat_map(move |y| columns.clone().map(move |x| (x, y)))
}

/// Whether a straight line has a part inside a rectangle that is widened by `margin`.
fn passes(a: [f32; 2], b: [f32; 2], rect: [[f32; 2]; 2], margin: f32) -> bool {
    let (mut first, mut last) = (0.0f32, 1.0f32);
    for k in 0..2 {
        let (low, high) = (rect[0][k] - margin, rect[1][k] + margin);
        if low >= high {
            return false;
        }
        let along = b[k] - a[k];
        if along.abs() < 1e-6 {
            if a[k] <= low || a[k] >= high {
                return false;
            }
            continue;
        }
        let (enters, leaves) = ((low - a[k]) / along, (high - a[k]) / along);
        first = first.max(enters.min(leaves));
        last = last.min(enters.max(leaves));
    }
    first < last
}

/// The shortest path with few turns along the lines beside some rectangles: Dijkstra's search over their crossings, with the direction of travel.
fn search(start: [f32; 2], end: [f32; 2], rects: &[[[f32; 2]; 2]], away: f32) -> Option<Vec<[f32; 2]>> {
    let lines = |k: usize| -> Vec<f32> {
        let beside = rects.iter().flat_map(|rect| [rect[0][k] - away, rect[1][k] + away]);
        let mut lines: Vec<f32> = [start[k], end[k]].into_iter().chain(beside).collect();
        lines.sort_by(f32::total_cmp);
        lines.dedup_by(|a, b| (*a - *b).abs() < 0.01);
        lines
    };
    let (xs, ys) = (lines(0), lines(1));
    let (columns, rows) = (xs.len(), ys.len());
    let at = |v: f32, lines: &[f32]| lines.iter().position(|line| (line - v).abs() < 0.011);
    let (from, to) = ((at(start[0], &xs)?, at(start[1], &ys)?), (at(end[0], &xs)?, at(end[1], &ys)?));
    // Whether the line from a crossing to the right, and the one down from it, is free.
    let mut free = [vec![true; columns * rows], vec![true; columns * rows]];
    for rect in rects {
        let inside = |v: f32, k: usize| v > rect[0][k] - CLEAR && v < rect[1][k] + CLEAR;
        let between = |a: f32, b: f32, k: usize| a < rect[1][k] + CLEAR && b > rect[0][k] - CLEAR;
        for (y, x) in (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x))) {
            if inside(ys[y], 1) && x + 1 < columns && between(xs[x], xs[x + 1], 0) {
                free[0][y * columns + x] = false;
            }
            if inside(xs[x], 0) && y + 1 < rows && between(ys[y], ys[y + 1], 1) {
                free[1][y * columns + x] = false;
            }
        }
    }
    // A state is a crossing and the direction in which it was reached: 0 across, 1 down or up.
    let state = |x: usize, y: usize, down: usize| (y * columns + x) * 2 + down;
    let mut cost = vec![u32::MAX; columns * rows * 2];
    let mut before = vec![usize::MAX; columns * rows * 2];
    let first = state(from.0, from.1, 0);
    let mut open = BinaryHeap::from([Reverse((0u32, first))]);
    cost[first] = 0;
    let last = state(to.0, to.1, 0);
    while let Some(Reverse((spent, now))) = open.pop() {
        if now == last {
            break;
        }
        if spent > cost[now] {
            continue;
        }
        let (x, y, down) = (now / 2 % columns, now / 2 / columns, now % 2);
        let mut go = |x2: usize, y2: usize, direction: usize| {
            let length = (xs[x] - xs[x2]).abs() + (ys[y] - ys[y2]).abs();
            let turn = if direction == down { 0.0 } else { TURN };
            let (sum, next) = (spent + ((length + turn) * 8.0) as u32, state(x2, y2, direction));
            if sum < cost[next] {
                (cost[next], before[next]) = (sum, now);
                open.push(Reverse((sum, next)));
            }
        };
        if x + 1 < columns && free[0][y * columns + x] {
            go(x + 1, y, 0);
        }
        if x > 0 && free[0][y * columns + x - 1] {
            go(x - 1, y, 0);
        }
        if y + 1 < rows && free[1][y * columns + x] {
            go(x, y + 1, 1);
        }
        if y > 0 && free[1][(y - 1) * columns + x] {
            go(x, y - 1, 1);
        }
        // A turn at the end.
        if (x, y) == to && down == 1 {
            go(x, y, 0);
        }
    }
    if cost[last] == u32::MAX {
        return None;
    }
    let mut path = vec![end];
    let mut now = last;
    while now != first {
        now = before[now];
        path.push([xs[now / 2 % columns], ys[now / 2 / columns]]);
    }
    path.reverse();
    Some(path)
}

/// A path without corners on straight lines.
fn straightened(path: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let mut corners: Vec<[f32; 2]> = Vec::with_capacity(path.len());
    for &at in path {
        if corners.last().is_some_and(|last| (last[0] - at[0]).abs() < 0.02 && (last[1] - at[1]).abs() < 0.02) {
            continue;
        }
        if let [.., a, b] = corners[..]
            && (0..2).any(|k| (a[k] - b[k]).abs() < 0.02 && (b[k] - at[k]).abs() < 0.02)
        {
            corners.pop();
        }
        corners.push(at);
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [f32; 2] = [208.0, 160.0];

    fn ends(from: [f32; 2], to: [f32; 2]) -> Ends<'static> {
        Ends { from, to, within: &[], net: 0 }
    }

    /// Pins at the middle of the right edge of one node and of the left edge of another.
    fn between(places: &[[f32; 2]], from: usize, to: usize) -> Ends<'static> {
        let ([a, b], [c, d]) = (places[from], places[to]);
        ends([a + SIZE[0], b + SIZE[1] / 2.0], [c, d + SIZE[1] / 2.0])
    }

    fn clear(obstacles: &Obstacles, ends: &Ends<'_>) -> Vec<[f32; 2]> {
        let path = obstacles.around(ends).expect("there is a path");
        assert_eq!((path[0], path[path.len() - 1]), (ends.from, ends.to));
        assert!(path.windows(2).all(|l| l[0][0] == l[1][0] || l[0][1] == l[1][1]), "{path:?}");
        assert!(path[1][0] > path[0][0] && path[path.len() - 2][0] < ends.to[0], "right out, right in: {path:?}");
        assert!(obstacles.under(&path, ends.within).is_empty(), "{path:?}");
        path
    }

    #[test]
    fn a_wire_goes_around_the_node_between_its_ends() {
        // A node between two others in a row, as `composite` between `phantom` and `preview`.
        let places = [[0.0, 0.0], [280.0, 0.0], [560.0, 0.0]];
        let obstacles = Obstacles::new(places.iter().map(|at| (*at, SIZE)));
        let ends = between(&places, 0, 2);
        assert_eq!(obstacles.under(&[ends.from, ends.to], &[]), [1], "straight it passes under the one between");
        let path = clear(&obstacles, &ends);
        let outside = |at: &[f32; 2]| at[1] <= -CLEAR || at[1] >= SIZE[1] + CLEAR;
        assert!(path.iter().any(outside), "{path:?}");
        // Wires of other outputs pass beside it.
        let other = clear(&obstacles, &Ends { net: 1, ..ends });
        assert_ne!(path, other);
        // Straight where nothing is between.
        assert_eq!(clear(&obstacles, &between(&places, 0, 1)).len(), 2);
    }

    #[test]
    fn backward_wires_and_loops_pass_under_nothing() {
        let places = [[0.0, 0.0], [280.0, 40.0], [560.0, -30.0], [280.0, 232.0]];
        let obstacles = Obstacles::new(places.iter().map(|at| (*at, SIZE)));
        for (from, to) in [(2, 0), (1, 1), (3, 0), (2, 3)] {
            clear(&obstacles, &between(&places, from, to));
        }
    }

    #[test]
    fn paths_between_many_scattered_nodes_pass_under_nothing() {
        // Scattered by hand, with gaps of 24 points and more.
        let place = |n: usize| {
            let (column, row) = (n % 9, n / 9);
            [column as f32 * 240.0 + (n * 29 % 8) as f32, row as f32 * 192.0 + (n * 53 % 8) as f32]
        };
        let places: Vec<[f32; 2]> = (0..81).map(place).collect();
        let obstacles = Obstacles::new(places.iter().map(|at| (*at, SIZE)));
        for k in 0..160 {
            let (from, to) = (k * 37 % 81, k * 61 % 81);
            let ends = Ends { net: k, ..between(&places, from, to) };
            if from != to {
                clear(&obstacles, &ends);
            }
        }
    }

    #[test]
    fn covered_pins_have_no_path_and_frames_around_the_ends_are_no_obstacle() {
        let places = [[0.0, 0.0], [100.0, 10.0], [600.0, 0.0]];
        let obstacles = Obstacles::new(places.iter().map(|at| (*at, SIZE)));
        assert!(obstacles.around(&between(&places, 0, 2)).is_none(), "the second covers the first one's pin");
        let frame = ([-40.0, -40.0], [900.0, 400.0]);
        let framed = Obstacles::new([([0.0, 0.0], SIZE), ([600.0, 0.0], SIZE), frame].into_iter());
        let places = [[0.0, 0.0], [600.0, 0.0]];
        assert!(framed.around(&between(&places, 0, 1)).is_none());
        clear(&framed, &Ends { within: &[2], ..between(&places, 0, 1) });
        let lost = Obstacles::new([([f32::NAN, 0.0], SIZE)].into_iter());
        assert!(lost.under(&[[0.0, 0.0], [100.0, 100.0]], &[]).is_empty());
    }
}
