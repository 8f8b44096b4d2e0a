//! From points of many views to both cameras: OpenCV's `calibrateCamera` on each, `stereoCalibrate` on both (Zhang,
//! "A flexible new technique for camera calibration", 2000).

use opencv::calib3d::{
    self, CALIB_FIX_ASPECT_RATIO, CALIB_FIX_K3, CALIB_FIX_K4, CALIB_FIX_K5, CALIB_RATIONAL_MODEL,
    CALIB_SAME_FOCAL_LENGTH, CALIB_USE_INTRINSIC_GUESS, CALIB_ZERO_TANGENT_DIST,
};
use opencv::core::{Mat, Point2f, Point3f, Size, TermCriteria, TermCriteria_COUNT, TermCriteria_EPS, Vector};
use opencv::prelude::*;
use panoscope_data::calibration::packet;
use panoscope_imaging::stereo::{CameraModel, Rectification};
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
        reserved: 0,
    };
    let impossible = |error: panoscope_imaging::stereo::StereoError| Unsolved::Impossible(error.to_string());
    let views = packet::rectification(&bare).map_err(impossible)?;
    let cameras = [packet::camera(&bare.left).map_err(impossible)?, packet::camera(&bare.right).map_err(impossible)?];
    let epipolar_px = pairs.iter().map(|pair| epipolar_px(pair, &cameras, &views)).collect();
    let calibration = packet::with_rectification(&bare, &views);
    Ok(Solution { calibration, errors_px: found.errors_px, epipolar_px })
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
