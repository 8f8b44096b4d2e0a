//! Both cameras of a pair with equidistant lenses: one Levenberg-Marquardt adjustment of both lenses, the pose between the cameras and the pose of
//! the board in each view, which minimizes the reprojection error. The views of the board enter through their own six numbers only, so these are
//! eliminated first (Triggs et al., "Bundle adjustment - a modern synthesis", 2000, section 6.1).

use opencv::calib3d;
use opencv::core::{Mat, Point2f, Point3f, Vector};
use opencv::prelude::*;
use panoscope_imaging::stereo::rotation::{Matrix3, Vector3, apply, product, rotation_of, transposed, vector_of};
use panoscope_imaging::stereo::{Equidistant, Lens};
use panoscope_node::abi::Camera;

use super::solution::{Found, Pair, Unsolved};

/// Numbers of one lens: fx, fy, cx, cy, k1 to k4.
const LENS: usize = 8;
/// Numbers of a pose: rotation vector, translation in mm.
const POSE: usize = 6;
/// Numbers that all views share: both lenses, then the right camera's pose from the left one's.
const SHARED: usize = 2 * LENS + POSE;
/// Angles of the picture's corners that are tried first, rad.
const CORNERS_RAD: [f64; 6] = [0.35, 0.5, 0.7, 0.9, 1.1, 1.3];
/// Rounds of the adjustment from each of them, and from the best of them.
const ROUNDS: [usize; 2] = [12, 200];
/// Standard deviation of a coefficient that no point determines, relative to that of a point in px.
const COEFFICIENT: f64 = 1.0;

#[derive(Clone, Debug)]
struct State {
    shared: [f64; SHARED],
    poses: Vec<[f64; POSE]>,
}

fn pose(numbers: &[f64]) -> (Matrix3, Vector3) {
    let at = |from: usize| std::array::from_fn(|i| numbers[from + i]);
    (rotation_of(at(0)), at(3))
}

/// Where a point in the camera's frame appears, px; not a number behind the camera.
fn project(lens: &[f64], [x, y, z]: Vector3) -> [f64; 2] {
    if z <= 0.0 {
        return [f64::NAN; 2];
    }
    let r = x.hypot(y);
    let k = [lens[4], lens[5], lens[6], lens[7]];
    let scale = if r > 1e-12 * z { Equidistant::height_of(k, r.atan2(z)) / r } else { 1.0 / z };
    [lens[0] * x * scale + lens[2], lens[1] * y * scale + lens[3]]
}

/// Errors of one view in px: x and y of each point, first of the left camera, then of the right one.
fn errors(pair: &Pair, shared: &[f64; SHARED], board: &[f64; POSE], out: &mut Vec<f64>) {
    let ((turn, shift), (turn_right, shift_right)) = (pose(board), pose(&shared[2 * LENS..]));
    let add = |a: Vector3, b: Vector3| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
    out.clear();
    for side in 0..2 {
        for (at, seen) in pair.board_mm.iter().zip(&pair.px[side]) {
            let left = add(apply(&turn, [at[0], at[1], 0.0]), shift);
            let point = if side == 0 { left } else { add(apply(&turn_right, left), shift_right) };
            let [u, v] = project(&shared[side * LENS..][..LENS], point);
            out.extend([u - f64::from(seen[0]), v - f64::from(seen[1])]);
        }
    }
}

/// Sum of the squared errors, with that of the coefficients, px^2.
fn cost(pairs: &[&Pair], state: &State) -> f64 {
    let mut all = Vec::new();
    let views = pairs.iter().zip(&state.poses).map(|(pair, board)| {
        errors(pair, &state.shared, board, &mut all);
        all.iter().map(|error| error * error).sum::<f64>()
    });
    views.sum::<f64>() + coefficients().map(|at| (state.shared[at] / COEFFICIENT).powi(2)).sum::<f64>()
}

/// Where the coefficients of both lenses are among the shared numbers.
fn coefficients() -> impl Iterator<Item = usize> {
    (4..LENS).chain(LENS + 4..2 * LENS)
}

/// Solves `matrix x = side` for each column of `side` in place by Cholesky's decomposition; `None` unless the matrix is positive definite.
fn solve_in_place<const N: usize, const M: usize>(matrix: &[[f64; N]; N], side: &mut [[f64; M]; N]) -> Option<()> {
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let sum = matrix[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = match i == j {
                true if sum > 0.0 && sum.is_finite() => sum.sqrt(),
                true => return None,
                false => sum / l[j][j],
            };
        }
    }
    for column in 0..M {
        for i in 0..N {
            let sum = (0..i).map(|k| l[i][k] * side[k][column]).sum::<f64>();
            side[i][column] = (side[i][column] - sum) / l[i][i];
        }
        for i in (0..N).rev() {
            let sum = (i + 1..N).map(|k| l[k][i] * side[k][column]).sum::<f64>();
            side[i][column] = (side[i][column] - sum) / l[i][i];
        }
    }
    Some(())
}

/// What one view adds to the normal equations.
struct Normal {
    shared: [[f64; SHARED]; SHARED],
    mixed: [[f64; SHARED]; POSE],
    own: [[f64; POSE]; POSE],
    side: [f64; SHARED + POSE],
}

fn normal(pair: &Pair, shared: &[f64; SHARED], board: &[f64; POSE]) -> Normal {
    const ALL: usize = SHARED + POSE;
    let (mut now, mut moved) = (Vec::new(), Vec::new());
    errors(pair, shared, board, &mut now);
    // Columns of the Jacobian by central differences.
    let mut columns: Vec<Vec<f64>> = Vec::with_capacity(ALL);
    for index in 0..ALL {
        let value = if index < SHARED { shared[index] } else { board[index - SHARED] };
        let step = 1e-6 * value.abs().max(1.0);
        let at = |delta: f64, out: &mut Vec<f64>| {
            let (mut shared, mut board) = (*shared, *board);
            *(if index < SHARED { &mut shared[index] } else { &mut board[index - SHARED] }) += delta;
            errors(pair, &shared, &board, out);
        };
        let mut column = Vec::new();
        at(step, &mut column);
        at(-step, &mut moved);
        column.iter_mut().zip(&moved).for_each(|(a, b)| *a = (*a - b) / (2.0 * step));
        columns.push(column);
    }
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let entry = |i: usize, j: usize| dot(&columns[i], &columns[j]);
    Normal {
        shared: std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j))),
        mixed: std::array::from_fn(|i| std::array::from_fn(|j| entry(SHARED + i, j))),
        own: std::array::from_fn(|i| std::array::from_fn(|j| entry(SHARED + i, SHARED + j))),
        side: std::array::from_fn(|i| dot(&columns[i], &now)),
    }
}

/// The state one step further, the diagonal of the equations enlarged by the share `damping`; `None` where they have no solution.
fn step(views: &[Normal], state: &State, damping: f64) -> Option<State> {
    let mut whole = [[0.0; SHARED]; SHARED];
    let mut side = [[0.0]; SHARED];
    for at in coefficients() {
        whole[at][at] += COEFFICIENT.powi(-2);
        side[at][0] += state.shared[at] * COEFFICIENT.powi(-2);
    }
    for view in views {
        for i in 0..SHARED {
            (0..SHARED).for_each(|j| whole[i][j] += view.shared[i][j]);
            side[i][0] += view.side[i];
        }
    }
    (0..SHARED).for_each(|i| whole[i][i] *= 1.0 + damping);
    // Of each view: what its pose would be by the shared numbers, and without them.
    let mut eliminated = Vec::with_capacity(views.len());
    for view in views {
        let mut own = view.own;
        (0..POSE).for_each(|i| own[i][i] *= 1.0 + damping);
        let mut solved: [[f64; SHARED + 1]; POSE] = std::array::from_fn(|i| {
            std::array::from_fn(|j| if j < SHARED { view.mixed[i][j] } else { view.side[SHARED + i] })
        });
        solve_in_place(&own, &mut solved)?;
        for i in 0..SHARED {
            let product = |column: usize| (0..POSE).map(|k| view.mixed[k][i] * solved[k][column]).sum::<f64>();
            (0..SHARED).for_each(|j| whole[i][j] -= product(j));
            side[i][0] -= product(SHARED);
        }
        eliminated.push(solved);
    }
    solve_in_place(&whole, &mut side)?;
    let mut next = state.clone();
    (0..SHARED).for_each(|i| next.shared[i] -= side[i][0]);
    for (board, solved) in next.poses.iter_mut().zip(&eliminated) {
        for (i, number) in board.iter_mut().enumerate() {
            *number -= solved[i][SHARED] - (0..SHARED).map(|j| solved[i][j] * side[j][0]).sum::<f64>();
        }
    }
    Some(next)
}

/// Adjusts until the cost does not fall any more; returns the cost.
fn adjust(pairs: &[&Pair], state: &mut State, rounds: usize) -> f64 {
    let mut best = cost(pairs, state);
    let mut damping = 1e-3;
    for _ in 0..rounds {
        let views: Vec<Normal> =
            pairs.iter().zip(&state.poses).map(|(pair, board)| normal(pair, &state.shared, board)).collect();
        let before = best;
        while damping < 1e10 {
            let next = step(&views, state, damping).map(|next| (cost(pairs, &next), next));
            if let Some((cost, next)) = next.filter(|(cost, _)| *cost < best) {
                (best, *state) = (cost, next);
                damping = (damping / 10.0).max(1e-12);
                break;
            }
            damping *= 10.0;
        }
        let is_better = before - best > 1e-12 * best;
        if !is_better {
            break;
        }
    }
    best
}

/// Pose of the board in one view, by a lens that is known roughly.
fn board_pose(pair: &Pair, side: usize, lens: &[f64]) -> opencv::Result<Option<(Matrix3, Vector3)>> {
    let ideal = Equidistant::new([0.0; 4]);
    let (mut object, mut rays) = (Vector::<Point3f>::new(), Vector::<Point2f>::new());
    for (at, px) in pair.board_mm.iter().zip(&pair.px[side]) {
        let (x, y) = ((f64::from(px[0]) - lens[2]) / lens[0], (f64::from(px[1]) - lens[3]) / lens[1]);
        let Some((x, y)) = ideal.undistort(x, y) else { continue };
        object.push(Point3f::new(at[0] as f32, at[1] as f32, 0.0));
        rays.push(Point2f::new(x as f32, y as f32));
    }
    if object.len() < pair.board_mm.len().min(6) {
        return Ok(None);
    }
    let (mut turn, mut shift) = (Mat::default(), Mat::default());
    let eye = Mat::eye(3, 3, opencv::core::CV_64F)?.to_mat()?;
    if !calib3d::solve_pnp_def(&object, &rays, &eye, &Mat::default(), &mut turn, &mut shift)? {
        return Ok(None);
    }
    let numbers = |mat: &Mat| -> opencv::Result<Vector3> {
        let all = mat.data_typed::<f64>()?;
        Ok(std::array::from_fn(|i| all.get(i).copied().unwrap_or(f64::NAN)))
    };
    Ok(Some((rotation_of(numbers(&turn)?), numbers(&shift)?)))
}

/// A first state with lenses of one focal length; `None` where they cannot have seen the points.
fn start(pairs: &[&Pair], size: (usize, usize), focal_px: f64) -> opencv::Result<Option<State>> {
    let lens = [focal_px, focal_px, (size.0 - 1) as f64 / 2.0, (size.1 - 1) as f64 / 2.0, 0.0, 0.0, 0.0, 0.0];
    let mut poses = Vec::with_capacity(pairs.len());
    let mut between: [Vec<f64>; POSE] = Default::default();
    for pair in pairs {
        let (Some(left), Some(right)) = (board_pose(pair, 0, &lens)?, board_pose(pair, 1, &lens)?) else {
            return Ok(None);
        };
        let numbers = |turn: &Matrix3, shift: Vector3| -> [f64; POSE] {
            let turn = vector_of(turn);
            std::array::from_fn(|i| if i < 3 { turn[i] } else { shift[i - 3] })
        };
        let turn = product(&right.0, &transposed(&left.0));
        let moved = apply(&turn, left.1);
        let shift = std::array::from_fn(|i| right.1[i] - moved[i]);
        between.iter_mut().zip(numbers(&turn, shift)).for_each(|(all, number)| all.push(number));
        poses.push(numbers(&left.0, left.1));
    }
    let median = between.map(|mut all| {
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    });
    let shared = std::array::from_fn(|i| if i < 2 * LENS { lens[i % LENS] } else { median[i - 2 * LENS] });
    Ok(Some(State { shared, poses }))
}

fn camera(size: (usize, usize), lens: &[f64]) -> Camera {
    let distortion = Lens::Equidistant(Equidistant::new([lens[4], lens[5], lens[6], lens[7]])).coefficients();
    let (width, height) = (size.0 as u32, size.1 as u32);
    Camera { width, height, fx: lens[0], fy: lens[1], cx: lens[2], cy: lens[3], distortion }
}

/// Solves for both cameras.
///
/// # Errors
/// [`Unsolved`] when no lens explains the points.
pub(super) fn solve(pairs: &[&Pair], size: (usize, usize)) -> Result<Found, Unsolved> {
    let half_px = (size.0 as f64).hypot(size.1 as f64) / 2.0;
    let mut best: Option<(f64, State)> = None;
    for corner in CORNERS_RAD {
        let Some(mut state) = start(pairs, size, half_px / corner)? else { continue };
        let cost = adjust(pairs, &mut state, ROUNDS[0]);
        if cost.is_finite() && best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, state));
        }
    }
    let none = || Unsolved::Impossible("no equidistant lens explains the points".to_owned());
    let (_, mut state) = best.ok_or_else(none)?;
    adjust(pairs, &mut state, ROUNDS[1]);
    if state.shared[0].min(state.shared[LENS]) <= 0.0 {
        return Err(none());
    }
    let mut errors_px = Vec::with_capacity(pairs.len());
    let (mut sum, mut count, mut all) = (0.0, 0, Vec::new());
    for (pair, board) in pairs.iter().zip(&state.poses) {
        errors(pair, &state.shared, board, &mut all);
        let points = pair.board_mm.len();
        let squares = [&all[..2 * points], &all[2 * points..]].map(|side| side.iter().map(|e| e * e).sum::<f64>());
        errors_px.push(squares.map(|square| (square / points.max(1) as f64).sqrt()));
        (sum, count) = (sum + squares[0] + squares[1], count + 2 * points);
    }
    let (turn, translation_mm) = pose(&state.shared[2 * LENS..]);
    Ok(Found {
        cameras: [camera(size, &state.shared[..LENS]), camera(size, &state.shared[LENS..2 * LENS])],
        rotation: std::array::from_fn(|i| turn[i / 3][i % 3]),
        translation_mm,
        rms_px: (sum / count.max(1) as f64).sqrt(),
        errors_px,
    })
}
