//! Which corners of a printed board a grid of corners shows.

use std::collections::BTreeMap;

use opencv::core::Size;
use panoscope_imaging::features::checker::CheckerGrid;

/// Points found: index on the board, place in px.
pub type Points = Vec<(usize, [f32; 2])>;

/// Least share of a chessboard's corners that must be seen.
const MIN_SEEN: f64 = 0.4;
/// Fewest corners seen on each edge of the board: the edges say where the board is.
const MIN_ON_EDGE: usize = 2;
/// Fewest corners that agree on where one grid is on another one, and their least share.
const MIN_AGREEING: (usize, f64) = (4, 0.75);

/// The numbers of the corners on a chessboard whose whole extent the grid has; `None` for a grid of another extent: a part of the board could be
/// anywhere on it.
pub fn on_chessboard(grid: &CheckerGrid, corners: Size) -> Option<Points> {
    let (columns, rows) = (corners.width, corners.height);
    let size = grid.size.map(|side| side as i32);
    // The grid's columns run to the right; on a board that stands on its end they are the board's rows.
    let is_upright = size == [columns, rows];
    if !is_upright && size != [rows, columns] {
        return None;
    }
    let place = |[x, y]: [i32; 2]| if is_upright { [x, y] } else { [y, rows - 1 - x] };
    let edges = [(0, 0), (0, size[0] - 1), (1, 0), (1, size[1] - 1)];
    let seen_on = |(axis, at): (usize, i32)| grid.corners.iter().filter(|(cell, _)| cell[axis] == at).count();
    let is_enough = grid.corners.len() as f64 >= MIN_SEEN * f64::from(corners.area());
    if !is_enough || edges.into_iter().any(|edge| seen_on(edge) < MIN_ON_EDGE) {
        return None;
    }
    let number = |cell: [i32; 2]| {
        let [column, row] = place(cell);
        (row * columns + column) as usize
    };
    let mut points: Points = grid.corners.iter().map(|(cell, at)| (number(*cell), at.map(|v| v as f32))).collect();
    points.sort_by_key(|(index, _)| *index);
    Some(points)
}

/// Whether a grid can be a part of a chessboard that does not show its whole extent.
pub fn is_part(grid: &CheckerGrid, corners: Size) -> bool {
    let [a, b] = grid.size.map(|side| side as i32);
    let is_inside = |columns: i32, rows: i32| a <= columns && b <= rows;
    is_inside(corners.width, corners.height) || is_inside(corners.height, corners.width)
}

/// A turn and a shift from cells of one grid to those of another one.
#[derive(Clone, Copy, Debug, Default)]
pub struct Onto {
    quarters: usize,
    shift: [i32; 2],
}

impl Onto {
    fn turned(quarters: usize, [x, y]: [i32; 2]) -> [i32; 2] {
        match quarters {
            0 => [x, y],
            1 => [-y, x],
            2 => [-x, -y],
            _ => [y, -x],
        }
    }

    /// The other grid's cell.
    pub fn place(&self, cell: [i32; 2]) -> [i32; 2] {
        let [x, y] = Self::turned(self.quarters, cell);
        [x + self.shift[0], y + self.shift[1]]
    }
}

/// What most pairs of cells of the same corner have in common; `None` where they do not agree.
pub fn agreed(shared: &[([i32; 2], [i32; 2])]) -> Option<Onto> {
    let mut best = (0, Onto::default());
    for quarters in 0..4 {
        let mut votes = BTreeMap::<[i32; 2], usize>::new();
        for (cell, place) in shared {
            let [x, y] = Onto::turned(quarters, *cell);
            *votes.entry([place[0] - x, place[1] - y]).or_default() += 1;
        }
        for (shift, votes) in votes {
            if votes > best.0 {
                best = (votes, Onto { quarters, shift });
            }
        }
    }
    let is_clear = best.0 >= MIN_AGREEING.0 && best.0 as f64 >= MIN_AGREEING.1 * shared.len() as f64;
    is_clear.then_some(best.1)
}
