//! Parts of a chessboard that both views show, without its edges.
//!
//! Which part it is does not matter, as long as it is known which corners of both views are the same. A calibration from other views says that: it
//! shows where the left view's corners, and those that would go on beside them, must be in the right view.

use panoscope_imaging::stereo::StereoCameras;
use panoscope_imaging::stereo::rotation::{apply, rotation_of};

use super::grid::{Points, agreed};
use super::solution::Pair;
use super::solve::board_pose;

/// Corners of one view with their cells, in px.
pub type Part = Vec<([i32; 2], [f32; 2])>;

/// How far the right view's part may reach beyond the left one's, squares.
const REACH: i32 = 6;
/// Largest median distance of the right view's corners from where they must be, shares of a square. The tilt of a small part is seen badly, so what lies
/// beyond it is expected a little off; a corner that is taken for its neighbour is a whole square off.
const MAX_OFF: f64 = 0.3;

/// Points that are numbered by rows of so many columns as a part.
pub fn of_points(points: &Points, columns: usize) -> Part {
    points.iter().map(|(index, at)| ([(index % columns) as i32, (index / columns) as i32], *at)).collect()
}

/// The corners that both parts show; `None` where the cameras do not say which they are.
///
/// # Errors
/// OpenCV finds no pose.
pub fn pair_of([left, right]: [&Part; 2], square_mm: f64, cameras: &StereoCameras) -> opencv::Result<Option<Pair>> {
    let place = |cell: [i32; 2]| cell.map(|v| f64::from(v) * square_mm);
    let seen = Pair {
        board_mm: left.iter().map(|(cell, _)| place(*cell)).collect(),
        px: [left.iter().map(|(_, at)| *at).collect(), Vec::new()],
    };
    let [a, b, c, x, y, z] = board_pose(&seen, &cameras.left)?;
    let turn = rotation_of([a, b, c]);
    let expected = |cell: [i32; 2]| {
        let [u, v] = place(cell);
        let [a, b, c] = apply(&turn, [u, v, 0.0]);
        in_right(cameras, [a + x, b + y, c + z])
    };
    let range = |axis: usize| {
        let all = || left.iter().map(|(cell, _)| cell[axis]);
        all().min().unwrap_or(0) - REACH..=all().max().unwrap_or(0) + REACH
    };
    let cells: Vec<([i32; 2], [f64; 2])> = range(1)
        .flat_map(|row| range(0).map(move |column| [column, row]))
        .filter_map(|cell| Some((cell, expected(cell)?)))
        .collect();
    let apart = |a: [f64; 2], b: [f32; 2]| (a[0] - f64::from(b[0])).hypot(a[1] - f64::from(b[1]));
    let (mut shared, mut offs) = (Vec::new(), Vec::new());
    for (cell, at) in right {
        let nearest = cells.iter().min_by(|a, b| apart(a.1, *at).total_cmp(&apart(b.1, *at)));
        let Some((same, there)) = nearest else { return Ok(None) };
        let Some(next) = expected([same[0] + 1, same[1]]) else { continue };
        shared.push((*cell, *same));
        offs.push(apart(*there, *at) / (next[0] - there[0]).hypot(next[1] - there[1]).max(f64::MIN_POSITIVE));
    }
    offs.sort_by(f64::total_cmp);
    let is_near = offs.get(offs.len() / 2).is_some_and(|off| *off < MAX_OFF);
    let Some(onto) = agreed(&shared).filter(|_| is_near) else { return Ok(None) };
    let mut pair = Pair { board_mm: Vec::new(), px: [Vec::new(), Vec::new()] };
    for (cell, at) in right {
        let cell = onto.place(*cell);
        if let Some((_, other)) = left.iter().find(|(left, _)| *left == cell) {
            pair.board_mm.push(place(cell));
            pair.px[0].push(*other);
            pair.px[1].push(*at);
        }
    }
    Ok(Some(pair))
}

/// Where a point of the left camera's frame is in the right raw view, px; `None` behind the camera.
fn in_right(cameras: &StereoCameras, point: [f64; 3]) -> Option<[f64; 2]> {
    let turned = apply(&cameras.rotation, point);
    let [x, y, z] = [0, 1, 2].map(|axis: usize| turned[axis] + cameras.translation_mm[axis]);
    (z > 0.0).then(|| cameras.right.project(x / z, y / z).into())
}
