//! What a calibration states of its own error, and how that is found from the views of a board that it was solved from.
//!
//! The points of one view are wrong together: the board is not flat, the view is blurred, a lens is not what its model says. So the residuals are not
//! independent, and the inverse of the normal equations alone states a tenth of the true error. Each view is left out once instead (jackknife of
//! Quenouille and Tukey), by one Gauss-Newton step, and the spread of these solutions is moved through the cameras to points all over the working volume.
//!
//! There an error of the calibration is nearly a move of the whole space, which changes no length, an offset of all disparities, and a scale. The last two
//! depend on each other: views determine lengths where the boards were, and the disparity offset tilts the scale about that depth, the neutral one.

use super::camera::{CameraModel, StereoCameras};
use super::lens::Lens;
use super::rectify::Rectification;
use super::rotation::{Matrix3, Vector3, apply, cross, dot, rotation_of, transposed, vector_of};
use crate::geometry::solve_symmetric;

/// Standard deviations of what a calibration says about lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationError {
    /// Offset of all disparities, px of the rectified views.
    pub offset_px: f64,
    /// Scale of all lengths at the neutral depth, percent.
    pub scale_percent: f64,
    /// Each disparity, beside offset and scale, px of the rectified views.
    pub point_px: f64,
    /// Depth at which the offset changes no length, mm.
    pub neutral_mm: f64,
}

/// Smallest number of a packet, in its unit.
const MIN_CODED: f64 = 1e-3;
/// Steps of a coded number to its double.
const STEPS: f64 = 18.0;

fn code(value: f64) -> u32 {
    // NaN becomes the largest.
    let byte = 1.0 + STEPS * (value / MIN_CODED).log2();
    if byte.is_nan() { 255 } else { byte.round().clamp(1.0, 255.0) as u32 }
}

fn decoded(byte: u32) -> f64 {
    MIN_CODED * ((f64::from(byte) - 1.0) / STEPS).exp2()
}

impl CalibrationError {
    /// As a packet `calibration` has it: four bytes, of which a step is 4 percent. Numbers outside 0.001 to 17 become the nearest of these.
    pub fn bits(&self) -> u32 {
        [self.offset_px, self.scale_percent, self.point_px, self.neutral_mm / 1000.0]
            .into_iter()
            .rev()
            .fold(0, |bits, value| bits << 8 | code(value))
    }

    /// From the packet; `None` where it states nothing.
    pub fn of_bits(bits: u32) -> Option<Self> {
        let bytes: [u32; 4] = std::array::from_fn(|index| bits >> (8 * index) & 0xff);
        if bytes.contains(&0) {
            return None;
        }
        let [offset_px, scale_percent, point_px, neutral_m] = bytes.map(decoded);
        Some(Self { offset_px, scale_percent, point_px, neutral_mm: 1000.0 * neutral_m })
    }

    /// Of views whose pixels are `factor` times as large.
    pub fn shrunk(self, factor: f64) -> Self {
        Self { offset_px: self.offset_px / factor, point_px: self.point_px / factor, ..self }
    }
}

/// Points of a board, and where both cameras have seen them.
#[derive(Clone, Debug)]
pub struct BoardView<'a> {
    /// On the board, mm.
    pub board_mm: &'a [[f64; 2]],
    /// In the raw left and right view.
    pub px: [&'a [[f32; 2]]; 2],
    /// Pose of the board in the left camera: rotation vector and mm. About right; it is refined.
    pub left_from_board: [f64; POSE],
}

/// Numbers of a pose.
const POSE: usize = 6;
/// Fewest views: with fewer the spread of the solutions says nothing.
const MIN_VIEWS: usize = 5;
/// Gauss-Newton steps of a board's pose.
const POSE_ROUNDS: usize = 8;
/// Points across, down, and in depth at which the error is looked at.
const GRID: [usize; 3] = [5, 4, 3];
/// Share of the picture beside the outermost of them.
const MARGIN: f64 = 0.15;
/// Quantiles of the boards' depths between which they lie.
const DEPTHS: [f64; 2] = [0.05, 0.95];
/// What a point's error is fitted by: scale, offset, rotation, translation.
const MOVES: usize = 8;

/// Both cameras as numbers that can be changed.
struct Numbers {
    /// Which coefficients of the lenses were solved for.
    free: Vec<usize>,
    cameras: [CameraModel; 2],
}

impl Numbers {
    fn new(cameras: &StereoCameras) -> (Self, Vec<f64>) {
        let both = [cameras.left.clone(), cameras.right.clone()];
        let coefficients = both.each_ref().map(|camera| camera.lens.coefficients());
        let last = if matches!(both[0].lens, Lens::Equidistant(_)) { 4 } else { 12 };
        let free: Vec<usize> = (0..last).filter(|k| coefficients.iter().any(|all| all[*k] != 0.0)).collect();
        let mut values = Vec::new();
        for (camera, all) in both.iter().zip(&coefficients) {
            values.extend([camera.fx, camera.fy, camera.cx, camera.cy]);
            values.extend(free.iter().map(|k| all[*k]));
        }
        values.extend(vector_of(&cameras.rotation));
        values.extend(cameras.translation_mm);
        (Self { free, cameras: both }, values)
    }

    /// The cameras with these numbers; `None` where no lens has them.
    fn rig(&self, values: &[f64]) -> Option<Rig> {
        let own = 4 + self.free.len();
        let camera = |side: usize| {
            let [fx, fy, cx, cy] = *values[side * own..].first_chunk()?;
            let mut all = self.cameras[side].lens.coefficients();
            self.free.iter().zip(&values[side * own + 4..]).for_each(|(k, value)| all[*k] = *value);
            let lens = Lens::of_coefficients(&all).ok()?;
            Some(CameraModel { fx, fy, cx, cy, lens, ..self.cameras[side].clone() })
        };
        let pose = values[2 * own..].first_chunk::<POSE>()?;
        let (rotation, shift) = placed(pose);
        Some(Rig { cameras: [camera(0)?, camera(1)?], rotation, shift })
    }
}

fn placed(pose: &[f64; POSE]) -> (Matrix3, Vector3) {
    let [a, b, c, x, y, z] = *pose;
    (rotation_of([a, b, c]), [x, y, z])
}

fn sum(a: Vector3, b: Vector3) -> Vector3 {
    std::array::from_fn(|i| a[i] + b[i])
}

struct Rig {
    cameras: [CameraModel; 2],
    /// Right camera from left one.
    rotation: Matrix3,
    shift: Vector3,
}

impl Rig {
    /// A point of the left camera's frame in one view; not a number behind the camera.
    fn project(&self, side: usize, point: Vector3) -> [f64; 2] {
        let [x, y, z] = if side == 0 { point } else { sum(apply(&self.rotation, point), self.shift) };
        if z <= 0.0 {
            return [f64::NAN; 2];
        }
        self.cameras[side].project(x / z, y / z).into()
    }

    /// Residuals of a view, px: x and y of each point, left then right.
    fn residuals(&self, view: &BoardView<'_>, pose: &[f64; POSE]) -> Vec<f64> {
        let (turn, shift) = placed(pose);
        let mut out = Vec::with_capacity(4 * view.board_mm.len());
        for side in 0..2 {
            for (at, seen) in view.board_mm.iter().zip(view.px[side]) {
                let point = sum(apply(&turn, [at[0], at[1], 0.0]), shift);
                let [u, v] = self.project(side, point);
                out.extend([u - f64::from(seen[0]), v - f64::from(seen[1])]);
            }
        }
        out
    }

    /// The point of the left camera's frame that a pixel of each view shows: the middle between both rays where they are nearest.
    fn point(&self, px: [[f64; 2]; 2]) -> Vector3 {
        let [a, b] = [0, 1].map(|side: usize| {
            let (x, y) = self.cameras[side].unproject(px[side][0], px[side][1]);
            [x, y, 1.0]
        });
        let back = transposed(&self.rotation);
        let (b, centre) = (apply(&back, b), apply(&back, self.shift).map(|v| -v));
        // s a and centre + t b, perpendicular to a and b between them.
        let (aa, bb, ab, ac, bc) = (dot(a, a), dot(b, b), dot(a, b), dot(a, centre), dot(b, centre));
        let determinant = aa * bb - ab * ab;
        let (s, t) = ((ac * bb - bc * ab) / determinant, (ac * ab - bc * aa) / determinant);
        std::array::from_fn(|i| (a[i] * s + centre[i] + b[i] * t) / 2.0)
    }
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Central difference of a vector function of `values` along one of them.
fn difference(values: &[f64], index: usize, of: &dyn Fn(&[f64]) -> Option<Vec<f64>>) -> Option<Vec<f64>> {
    let step = 1e-6 * values[index].abs().max(1.0);
    let at = |delta: f64| {
        let mut moved = values.to_vec();
        moved[index] += delta;
        of(&moved)
    };
    let (mut up, down) = (at(step)?, at(-step)?);
    up.iter_mut().zip(&down).for_each(|(a, b)| *a = (*a - b) / (2.0 * step));
    Some(up)
}

/// Jacobian of a view's residuals by its pose, by columns.
fn by_pose(rig: &Rig, view: &BoardView<'_>, pose: &[f64; POSE]) -> Option<Vec<Vec<f64>>> {
    let of = |moved: &[f64]| Some(rig.residuals(view, moved.first_chunk()?));
    (0..POSE).map(|index| difference(pose, index, &of)).collect()
}

/// Steps of a pose that lower the residuals `of`, from the Jacobian's columns; `None` where the points do not determine it.
fn pose_part(columns: &[Vec<f64>], of: &[f64]) -> Option<[f64; POSE]> {
    let normal: [[f64; POSE]; POSE] =
        std::array::from_fn(|i| std::array::from_fn(|j| product(&columns[i], &columns[j])));
    solve_symmetric(&normal, &std::array::from_fn(|i| product(&columns[i], of)))
}

/// Normal equations of one view without its pose: matrix by rows, and right side.
type Normal = (Vec<Vec<f64>>, Vec<f64>);

fn normal(numbers: &Numbers, values: &[f64], view: &BoardView<'_>) -> Option<Normal> {
    let rig = numbers.rig(values)?;
    let mut pose = view.left_from_board;
    for _ in 0..POSE_ROUNDS {
        let step = pose_part(&by_pose(&rig, view, &pose)?, &rig.residuals(view, &pose))?;
        pose.iter_mut().zip(step).for_each(|(number, step)| *number -= step);
    }
    let poses = by_pose(&rig, view, &pose)?;
    let without_pose = |mut column: Vec<f64>| {
        let part = pose_part(&poses, &column)?;
        for (pose, part) in poses.iter().zip(part) {
            column.iter_mut().zip(pose).for_each(|(value, pose)| *value -= part * pose);
        }
        Some(column)
    };
    let of = |moved: &[f64]| Some(numbers.rig(moved)?.residuals(view, &pose));
    let columns =
        (0..values.len()).map(|index| without_pose(difference(values, index, &of)?)).collect::<Option<Vec<_>>>()?;
    let rest = without_pose(rig.residuals(view, &pose))?;
    let matrix = columns.iter().map(|a| columns.iter().map(|b| product(a, b)).collect()).collect();
    Some((matrix, columns.iter().map(|column| product(column, &rest)).collect()))
}

/// Solves by Cholesky's decomposition with the diagonal scaled to 1; `None` where the matrix is not positive definite.
fn solve(matrix: &[Vec<f64>], side: &[f64]) -> Option<Vec<f64>> {
    let count = side.len();
    let scale: Vec<f64> = (0..count).map(|i| matrix[i][i].max(f64::MIN_POSITIVE).sqrt().recip()).collect();
    let mut lower = vec![vec![0.0; count]; count];
    for i in 0..count {
        for j in 0..=i {
            let rest = matrix[i][j] * scale[i] * scale[j] - (0..j).map(|k| lower[i][k] * lower[j][k]).sum::<f64>();
            lower[i][j] = match i == j {
                true if rest > 1e-13 => rest.sqrt(),
                true => return None,
                false => rest / lower[j][j],
            };
        }
    }
    let mut x: Vec<f64> = side.iter().zip(&scale).map(|(side, scale)| side * scale).collect();
    for i in 0..count {
        x[i] = (x[i] - (0..i).map(|k| lower[i][k] * x[k]).sum::<f64>()) / lower[i][i];
    }
    for i in (0..count).rev() {
        x[i] = (x[i] - (i + 1..count).map(|k| lower[k][i] * x[k]).sum::<f64>()) / lower[i][i];
    }
    x.iter_mut().zip(&scale).for_each(|(x, scale)| *x *= scale);
    x.iter().all(|x| x.is_finite()).then_some(x)
}

/// Changes of all numbers whose squares add up to their covariance.
fn changes(numbers: &Numbers, values: &[f64], views: &[BoardView<'_>]) -> Option<Vec<Vec<f64>>> {
    let normals = views.iter().map(|view| normal(numbers, values, view)).collect::<Option<Vec<Normal>>>()?;
    let count = values.len();
    let whole = |i: usize, j: usize| normals.iter().map(|(matrix, _)| matrix[i][j]).sum::<f64>();
    let whole: Vec<Vec<f64>> = (0..count).map(|i| (0..count).map(|j| whole(i, j)).collect()).collect();
    // The variance of Student's distribution stands for the few views that the spread itself is known from.
    let n = normals.len() as f64;
    let share = ((n - 1.0) / n * (n - 1.0) / (n - 3.0)).sqrt();
    let left_out = |(matrix, side): &Normal| {
        let rest: Vec<Vec<f64>> =
            whole.iter().zip(matrix).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect()).collect();
        Some(solve(&rest, side)?.into_iter().map(|change| share * change).collect())
    };
    normals.iter().map(left_out).collect()
}

/// Depths of the boards, mm, sorted.
fn depths(views: &[BoardView<'_>]) -> Vec<f64> {
    let mut all: Vec<f64> = Vec::new();
    for view in views {
        let (turn, shift) = placed(&view.left_from_board);
        all.extend(view.board_mm.iter().map(|at| sum(apply(&turn, [at[0], at[1], 0.0]), shift)[2]));
    }
    all.retain(|depth| *depth > 0.0);
    all.sort_by(f64::total_cmp);
    all
}

/// Positions in both raw views of points all over the working volume.
fn grid(rig: &Rig, range: [f64; 2]) -> Vec<[[f64; 2]; 2]> {
    let [left, right] = &rig.cameras;
    let part = |index: usize, count: usize| index as f64 / (count - 1) as f64;
    let mut out = Vec::new();
    for k in 0..GRID[2] {
        let z = range[0] + (range[1] - range[0]) * part(k, GRID[2]);
        for (i, j) in (0..GRID[0]).flat_map(|i| (0..GRID[1]).map(move |j| (i, j))) {
            let at = |share: f64, size: usize| (MARGIN + (1.0 - 2.0 * MARGIN) * share) * size as f64;
            let a = [at(part(i, GRID[0]), left.width), at(part(j, GRID[1]), left.height)];
            let (x, y) = left.unproject(a[0], a[1]);
            let b = rig.project(1, [x * z, y * z, z]);
            let is_inside = |at: f64, size: usize| (0.0..size as f64).contains(&at);
            if is_inside(b[0], right.width) && is_inside(b[1], right.height) {
                out.push([a, b]);
            }
        }
    }
    out
}

/// What the calibration from these views states of its error; `None` where there are too few views, or they do not determine the cameras.
///
/// `cameras` are the solution of all `views`, `rectified` its rectification.
pub fn estimate(
    cameras: &StereoCameras,
    rectified: &Rectification,
    views: &[BoardView<'_>],
) -> Option<CalibrationError> {
    if views.len() < MIN_VIEWS {
        return None;
    }
    let (numbers, values) = Numbers::new(cameras);
    let rig = numbers.rig(&values)?;
    let boards = depths(views);
    let at = |share: f64| boards.get((share * (boards.len().saturating_sub(1)) as f64).round() as usize).copied();
    let range = [at(DEPTHS[0])?, at(DEPTHS[1])?];
    let places = grid(&rig, range);
    let points: Vec<Vector3> = places.iter().map(|px| rig.point(*px)).collect();
    let per_px = 1.0 / (rectified.left.focal_px * rectified.baseline_mm);
    // Relative to the depth, so that near and far points weigh alike.
    let mut moves = Vec::new();
    for point in &points {
        let z = point[2];
        let along = |axis: usize| std::array::from_fn::<f64, 3, _>(|i| if i == axis { 1.0 } else { 0.0 });
        let turned = [0, 1, 2].map(|axis| cross(along(axis), *point));
        let [x, y, w] = [0, 1, 2].map(along);
        let all: [Vector3; MOVES] = [*point, point.map(|v| -v * z * per_px), turned[0], turned[1], turned[2], x, y, w];
        moves.extend((0..3).map(|row| all.map(|one| one[row] / z)));
    }
    let normal: [[f64; MOVES]; MOVES] =
        std::array::from_fn(|i| std::array::from_fn(|j| moves.iter().map(|row| row[i] * row[j]).sum()));
    let (mut scale, mut mixed, mut offset, mut rest) = (0.0, 0.0, 0.0, 0.0);
    for change in changes(&numbers, &values, views)? {
        let moved: Vec<f64> = values.iter().zip(&change).map(|(value, change)| value + change).collect();
        let moved = numbers.rig(&moved)?;
        let mut errors = Vec::with_capacity(moves.len());
        for (px, point) in places.iter().zip(&points) {
            let other = moved.point(*px);
            errors.extend((0..3).map(|row| (other[row] - point[row]) / point[2]));
        }
        let side = std::array::from_fn(|i| moves.iter().zip(&errors).map(|(row, error)| row[i] * error).sum());
        let found = solve_symmetric(&normal, &side)?;
        scale += found[0] * found[0];
        mixed += found[0] * found[1];
        offset += found[1] * found[1];
        for (index, (row, error)) in moves.iter().zip(&errors).enumerate() {
            let disparity_px = 1.0 / (per_px * points[index / 3][2]);
            rest += ((error - product(row, &found)) * disparity_px).powi(2);
        }
    }
    // The boards lie on both sides of the neutral depth, or the views do not say where it is.
    let slope = (mixed / offset).clamp(range[0] * per_px, range[1] * per_px);
    let scale = scale - 2.0 * slope * mixed + slope * slope * offset;
    let error = CalibrationError {
        offset_px: offset.sqrt(),
        scale_percent: 100.0 * scale.max(0.0).sqrt(),
        point_px: (rest / points.len() as f64).sqrt(),
        neutral_mm: slope / per_px,
    };
    let all = [error.offset_px, error.scale_percent, error.point_px, error.neutral_mm];
    all.iter().all(|number| number.is_finite()).then_some(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packet_keeps_each_number_to_two_percent() {
        let given = CalibrationError { offset_px: 0.213, scale_percent: 0.064, point_px: 0.11, neutral_mm: 313.0 };
        let back = CalibrationError::of_bits(given.bits()).expect("it states something");
        for (given, back) in [
            (given.offset_px, back.offset_px),
            (given.scale_percent, back.scale_percent),
            (given.point_px, back.point_px),
            (given.neutral_mm, back.neutral_mm),
        ] {
            assert!((back / given - 1.0).abs() < 0.02, "{given} {back}");
        }
        assert_eq!(back.bits(), given.bits());
        assert_eq!(CalibrationError::of_bits(0), None);
        // Half a statement is none.
        assert_eq!(CalibrationError::of_bits(given.bits() & 0xffff), None);
        // Out of the range, and not a number, which is as wrong as can be.
        let extreme = CalibrationError { offset_px: 1e9, scale_percent: 0.0, point_px: f64::NAN, neutral_mm: -1.0 };
        assert_eq!(extreme.bits(), u32::from_le_bytes([255, 1, 255, 255]));
    }
}
