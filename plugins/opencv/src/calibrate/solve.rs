//! From points of many views to both cameras: OpenCV's `calibrateCamera` on each, `stereoCalibrate` on both (Zhang,
//! "A flexible new technique for camera calibration", 2000).

use opencv::calib3d::{
    self, CALIB_FIX_ASPECT_RATIO, CALIB_FIX_K3, CALIB_FIX_K4, CALIB_FIX_K5, CALIB_RATIONAL_MODEL,
    CALIB_SAME_FOCAL_LENGTH, CALIB_USE_INTRINSIC_GUESS, CALIB_ZERO_TANGENT_DIST,
};
use opencv::core::{CV_64F, Mat, Point2f, Point3f, Size, TermCriteria, TermCriteria_COUNT, TermCriteria_EPS, Vector};
use opencv::prelude::*;
use panoscope_data::calibration::packet;
use panoscope_imaging::stereo::{BoardView, CameraModel, Rectification, StereoCameras, calibration_error};
use panoscope_node::Choice;
use panoscope_node::abi::{Calibration, Camera};

use super::fisheye;
use super::solution::{Found, Pair, Solution, Unsolved};

/// Model of the distortion.
#[derive(Choice, Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// `standard`, `full` or `rational`: the one with the fewest coefficients that no other one betters on views left out.
    Auto,
    /// k1, k2.
    Radial,
    /// k1, k2, p1, p2.
    Standard,
    /// k1, k2, p1, p2, k3.
    Full,
    /// k1 to k6, p1, p2.
    Rational,
    /// k1 to k4 of a fisheye (Kannala and Brandt; OpenCV's `fisheye`).
    Equidistant,
}

impl Model {
    fn flags(self) -> i32 {
        match self {
            Self::Radial => CALIB_FIX_K3 | CALIB_ZERO_TANGENT_DIST,
            // `Auto` as long as nothing speaks for more.
            Self::Standard | Self::Auto => CALIB_FIX_K3,
            Self::Full => 0,
            Self::Rational => CALIB_RATIONAL_MODEL,
            // Not OpenCV's to solve for.
            Self::Equidistant => 0,
        }
    }
}

/// Procedure of solving.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Procedure {
    /// Each camera, then both together.
    Own(Model),
    /// The steps and flags of OpenCV's sample `stereo_calib`.
    Sample,
}

fn cells<const N: usize>(mat: &Mat) -> opencv::Result<[f64; N]> {
    let all = mat.data_typed::<f64>()?;
    let mut out = [0.0; N];
    let count = all.len().min(N);
    out[..count].copy_from_slice(&all[..count]);
    Ok(out)
}

/// Where OpenCV's solvers stop.
pub fn criteria(count: i32, eps: f64) -> opencv::Result<TermCriteria> {
    TermCriteria::new(TermCriteria_COUNT | TermCriteria_EPS, count, eps)
}

/// Matrix and distortion of the camera of one side.
///
/// # Errors
/// OpenCV cannot solve for it.
pub fn camera_of(
    pairs: &[&Pair],
    side: usize,
    size: (usize, usize),
    model: Model,
    end: TermCriteria,
) -> opencv::Result<(Mat, Mat)> {
    let (object, seen) = (objects(pairs), points_of(pairs, side));
    let (mut k, mut d) = (Mat::default(), Mat::default());
    let (mut turns, mut moves) = (Vector::<Mat>::new(), Vector::<Mat>::new());
    let size = Size::new(size.0 as i32, size.1 as i32);
    calib3d::calibrate_camera(&object, &seen, size, &mut k, &mut d, &mut turns, &mut moves, model.flags(), end)?;
    Ok((k, d))
}

/// Points of a board in its own frame, mm.
pub fn object_of(pair: &Pair) -> Vector<Point3f> {
    pair.board_mm.iter().map(|p| Point3f::new(p[0] as f32, p[1] as f32, 0.0)).collect()
}

fn objects(pairs: &[&Pair]) -> Vector<Vector<Point3f>> {
    pairs.iter().map(|pair| object_of(pair)).collect()
}

fn points_of(pairs: &[&Pair], side: usize) -> Vector<Vector<Point2f>> {
    pairs.iter().map(|pair| pair.px[side].iter().map(|p| Point2f::new(p[0], p[1])).collect()).collect()
}

fn camera(size: Size, k: &Mat, d: &Mat) -> opencv::Result<Camera> {
    let (k, distortion) = (cells::<9>(k)?, cells(d)?);
    let (width, height) = (size.width as u32, size.height as u32);
    Ok(Camera { width, height, fx: k[0], fy: k[4], cx: k[2], cy: k[5], distortion })
}

/// Solves for both cameras.
///
/// # Errors
/// [`Unsolved`] when OpenCV cannot, or the cameras found cannot stand so.
pub fn solve(pairs: &[&Pair], size: (usize, usize), procedure: Procedure) -> Result<Solution, Unsolved> {
    let found = match procedure {
        Procedure::Own(Model::Equidistant) => fisheye::solve(pairs, size)?,
        _ => by_opencv(pairs, size, procedure)?,
    };
    let translation = found.translation_mm;
    if translation[0] > translation[1].abs().max(translation[2].abs()) {
        return Err(Unsolved::Exchanged);
    }
    let [left, right] = found.cameras;
    let bare = Calibration {
        left,
        right,
        right_from_left_rotation: found.rotation,
        right_from_left_mm: translation,
        rectified_from_left: [0.0; 9],
        rectified_from_right: [0.0; 9],
        left_projection: [0.0; 12],
        right_projection: [0.0; 12],
        baseline_mm: translation.iter().map(|v| v * v).sum::<f64>().sqrt(),
        rms_px: found.rms_px,
        is_rectified: 0,
        stated_error: 0,
    };
    let impossible = |error: panoscope_imaging::stereo::StereoError| Unsolved::Impossible(error.to_string());
    let views = packet::rectification(&bare).map_err(impossible)?;
    let both = packet::cameras(&bare).map_err(impossible)?;
    let stated_error = stated_error(pairs, &both, &views).unwrap_or(0);
    let cameras = [both.left, both.right];
    let epipolar_px = pairs.iter().map(|pair| epipolar_px(pair, &cameras, &views)).collect();
    let calibration = packet::with_rectification(&Calibration { stated_error, ..bare }, &views);
    Ok(Solution { calibration, errors_px: found.errors_px, epipolar_px })
}

/// What the calibration states of its own error; 0 where the views do not say.
fn stated_error(pairs: &[&Pair], cameras: &StereoCameras, views: &Rectification) -> opencv::Result<u32> {
    let mut boards = Vec::with_capacity(pairs.len());
    for pair in pairs {
        boards.push(BoardView {
            board_mm: &pair.board_mm,
            px: [&pair.px[0], &pair.px[1]],
            left_from_board: board_pose(pair, &cameras.left)?,
        });
    }
    Ok(calibration_error::estimate(cameras, views, &boards).map_or(0, |stated| stated.bits()))
}

/// Pose of the board in the left camera: rotation vector and mm.
///
/// # Errors
/// OpenCV finds none.
pub fn board_pose(pair: &Pair, camera: &CameraModel) -> opencv::Result<[f64; 6]> {
    let rays: Vector<Point2f> = pair.px[0]
        .iter()
        .map(|px| {
            let (x, y) = camera.unproject(px[0].into(), px[1].into());
            Point2f::new(x as f32, y as f32)
        })
        .collect();
    let (mut turn, mut shift) = (Mat::default(), Mat::default());
    let no_lens = Mat::eye(3, 3, CV_64F)?.to_mat()?;
    calib3d::solve_pnp_def(&object_of(pair), &rays, &no_lens, &Mat::default(), &mut turn, &mut shift)?;
    let ([a, b, c], [x, y, z]) = (cells(&turn)?, cells(&shift)?);
    Ok([a, b, c, x, y, z])
}

fn by_opencv(pairs: &[&Pair], view: (usize, usize), procedure: Procedure) -> opencv::Result<Found> {
    let size = Size::new(view.0 as i32, view.1 as i32);
    let object = objects(pairs);
    let seen = [0, 1].map(|side| points_of(pairs, side));
    let (mut k, mut d) = ([Mat::default(), Mat::default()], [Mat::default(), Mat::default()]);
    let (flags, end) = match procedure {
        Procedure::Sample => {
            for side in 0..2 {
                k[side] = calib3d::init_camera_matrix_2d(&object, &seen[side], size, 0.0)?;
            }
            let flags = CALIB_FIX_ASPECT_RATIO
                | CALIB_ZERO_TANGENT_DIST
                | CALIB_USE_INTRINSIC_GUESS
                | CALIB_SAME_FOCAL_LENGTH
                | CALIB_RATIONAL_MODEL
                | CALIB_FIX_K3
                | CALIB_FIX_K4
                | CALIB_FIX_K5;
            (flags, criteria(100, 1e-5)?)
        }
        Procedure::Own(model) => {
            for side in 0..2 {
                (k[side], d[side]) = camera_of(pairs, side, view, model, criteria(60, 1e-9)?)?;
            }
            // Lenses, the pose between the cameras and those of the boards once more, all together.
            (model.flags() | CALIB_USE_INTRINSIC_GUESS, criteria(100, 1e-9)?)
        }
    };
    let (mut r, mut t, mut e, mut f) = (Mat::default(), Mat::default(), Mat::default(), Mat::default());
    let mut errors = Mat::default();
    let [k_left, k_right] = &mut k;
    let [d_left, d_right] = &mut d;
    let rms_px = calib3d::stereo_calibrate_extended(
        &object,
        &seen[0],
        &seen[1],
        k_left,
        d_left,
        k_right,
        d_right,
        size,
        &mut r,
        &mut t,
        &mut e,
        &mut f,
        &mut errors,
        flags,
        end,
    )?;
    Ok(Found {
        cameras: [camera(size, &k[0], &d[0])?, camera(size, &k[1], &d[1])?],
        rotation: cells(&r)?,
        translation_mm: cells(&t)?,
        rms_px,
        errors_px: errors.data_typed::<f64>()?.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect(),
    })
}

/// Where a pixel of a raw view lies in the rectified one, px.
pub fn rectified_px(camera: &CameraModel, views: &Rectification, is_left: bool, px: [f32; 2]) -> [f64; 2] {
    let (x, y) = camera.unproject(px[0].into(), px[1].into());
    let (rotation, target) =
        if is_left { (&views.rotation_left, &views.left) } else { (&views.rotation_right, &views.right) };
    let [x, y, z] = [0, 1, 2].map(|row| rotation[row][0] * x + rotation[row][1] * y + rotation[row][2]);
    [target.focal_px * x / z + target.cx, target.focal_px * y / z + target.cy]
}

fn epipolar_px(pair: &Pair, cameras: &[CameraModel; 2], views: &Rectification) -> f64 {
    let rows = pair.px[0].iter().zip(&pair.px[1]).map(|(left, right)| {
        let [_, a] = rectified_px(&cameras[0], views, true, *left);
        let [_, b] = rectified_px(&cameras[1], views, false, *right);
        (a - b).abs()
    });
    rows.sum::<f64>() / pair.px[0].len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::super::order::tests::view;
    use super::*;
    use panoscope_imaging::stereo::length::{Errors, Noise, distance, with_error};
    use panoscope_imaging::stereo::{CalibrationError, SurfacePoint};

    const SIZE: (usize, usize) = (800, 600);
    /// Lens of the drawn cameras.
    const LENS: [f64; 3] = [-0.3, 0.1, 0.0];

    /// The point that both raw views show, in the rectified frame of a calibration.
    fn point(calibration: &Calibration, px: [[f32; 2]; 2]) -> SurfacePoint {
        let views = packet::rectification(calibration).expect("a rectification");
        let camera = |of: &Camera| packet::camera(of).expect("a camera");
        let [u, v] = rectified_px(&camera(&calibration.left), &views, true, px[0]);
        let [right, _] = rectified_px(&camera(&calibration.right), &views, false, px[1]);
        let disparity_px = u - right - (views.left.cx - views.right.cx);
        let ray = [(u - views.left.cx) / views.left.focal_px, (v - views.left.cy) / views.left.focal_px];
        let inverse_depth = disparity_px / (views.left.focal_px * views.baseline_mm);
        SurfacePoint { ray, inverse_depth, scatter: 0.0, confidence: Some(1.0) }
    }

    /// Error and stated bound, mm, of lengths on boards without noise, by calibrations of twelve views with noise each.
    fn lengths(noise_px: f64) -> Vec<(f64, f64)> {
        let noise = Noise { disparity_px: 0.0, ..Noise::USUAL };
        let mut out = Vec::new();
        for set in 0..12 {
            let views: Vec<Pair> = (0..12).map(|index| view(100 * set + index, LENS, noise_px)).collect();
            let views: Vec<&Pair> = views.iter().collect();
            let solved = solve(&views, SIZE, Procedure::Own(Model::Radial)).expect("cameras").calibration;
            let stated = CalibrationError::of_bits(solved.stated_error).expect("it states its error");
            let focal_px = solved.left_projection[0];
            let errors = Errors::of(focal_px, solved.baseline_mm, solved.rms_px, Some(stated), &noise);
            for index in 50..60 {
                let board = view(100 * set + index, LENS, 0.0);
                for (a, b) in [(0, 53), (8, 45), (4, 49)] {
                    let ends = [a, b].map(|at| point(&solved, [board.px[0][at], board.px[1][at]]));
                    let [a, b] = [a, b].map(|at| board.board_mm[at]);
                    let (found_mm, bound_mm) = with_error(&ends, Some(&errors), distance);
                    out.push(((found_mm - (a[0] - b[0]).hypot(a[1] - b[1])).abs(), bound_mm));
                }
            }
        }
        out
    }

    #[test]
    fn a_calibration_states_its_own_error() {
        for noise_px in [0.1, 0.4] {
            let all = lengths(noise_px);
            let held = all.iter().filter(|(error, bound)| error <= bound).count() as f64 / all.len() as f64;
            let median = |of: fn(&(f64, f64)) -> f64| {
                let mut values: Vec<f64> = all.iter().map(of).collect();
                values.sort_by(f64::total_cmp);
                values[values.len() / 2]
            };
            let (error, bound) = (median(|l| l.0), median(|l| l.1));
            assert!(held > 0.9 && bound < 5.0 * error, "{noise_px} px: {held} within {bound} mm, error {error} mm");
        }
    }

    #[test]
    fn few_views_state_nothing() {
        let views: Vec<Pair> = (0..4).map(|index| view(index, LENS, 0.1)).collect();
        let views: Vec<&Pair> = views.iter().collect();
        let solved = solve(&views, SIZE, Procedure::Own(Model::Radial)).expect("cameras").calibration;
        assert_eq!(solved.stated_error, 0);
    }
}
