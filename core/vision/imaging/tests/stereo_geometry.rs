//! Rectification, remapping and reprojection.

use crate::stereo_common::*;
use panoscope_base::Threads;
use panoscope_imaging::stereo::{
    CameraModel, Lens, Rectification, RectifiedCamera, RectifyParams, RemapTable, ReprojectInput, ReprojectParams,
    StereoCameras, StereoError, reproject,
};
use panoscope_imaging::{Rect, Serial, View, ViewMut};

/// A pair of cameras with everything a real one has: distortion, a turn, an uneven baseline.
fn cameras() -> StereoCameras {
    let left = [-0.271, 0.083, 0.0012, -0.0007, 0.021, 0.01, -0.003, 0.002];
    let right = [-0.283, 0.095, -0.0004, 0.0011, 0.004];
    StereoCameras {
        left: CameraModel::new((640, 480), (535.2, 534.9), (331.4, 241.7), &left).unwrap(),
        right: CameraModel::new((640, 480), (539.8, 540.3), (317.9, 250.2), &right).unwrap(),
        rotation: [
            [0.9997110174655, -0.0071256759318, -0.0229588155463],
            [0.0068726930, 0.9999149995, -0.0110792132],
            [0.0230358234, 0.0109182201, 0.9996750183],
        ],
        translation_mm: [-15.1, 0.21, -0.34],
    }
}

fn close(found: f64, wanted: f64, within: f64, what: &str) {
    assert!((found - wanted).abs() <= within, "{what}: {found}, {wanted} expected");
}

/// Figures of OpenCV 4.6's `stereoRectify` and `initUndistortRectifyMap` for the same cameras.
#[test]
fn rectification_is_that_of_opencv() {
    let cases = [
        (None, true, 537.6, 317.8257, 317.8257),
        (None, false, 537.6, 335.1806, 300.4708),
        (Some(0.0), true, 510.1231, 317.8257, 317.8257),
        (Some(1.0), true, 426.9709, 317.8257, 317.8257),
        (Some(1.0), false, 436.3165, 335.1806, 300.4708),
    ];
    for (alpha, zero_disparity, focal, cx_left, cx_right) in cases {
        let found = Rectification::new(&cameras(), RectifyParams { zero_disparity, alpha }).unwrap();
        // With alpha 1 the corners count; OpenCV undistorts them with five rounds, here they have converged.
        close(found.left.focal_px, focal, if alpha == Some(1.0) { 0.5 } else { 0.02 }, "focal length");
        close(found.left.cx, cx_left, 0.02, "left centre");
        close(found.right.cx, cx_right, 0.02, "right centre");
        close(found.left.cy, 248.4637, 0.02, "row of the centre");
        close(found.baseline_mm, 15.1052872, 1e-4, "baseline");
    }
    let found = Rectification::new(&cameras(), RectifyParams::default()).unwrap();
    let wanted = [
        [9.99784057e-01, -2.07786636e-02, -2.95398786e-04],
        [2.07766758e-02, 9.99768335e-01, -5.62197278e-03],
        [4.12147433e-04, 5.61462135e-03, 9.99984153e-01],
    ];
    for i in 0..9 {
        close(found.rotation_left[i / 3][i % 3], wanted[i / 3][i % 3], 1e-6, "left rotation");
    }
    close(found.q()[3][2], 6.62019854e-02, 1e-6, "Q");
    close(found.depth_mm(50.0), 510.1231 * 15.1052872 / 50.0, 0.01, "depth");
}

/// The map must send rectified pixels where OpenCV sends them: seen through a ramp image.
#[test]
fn the_map_goes_where_opencv_goes() {
    let cameras = cameras();
    let rectification = Rectification::new(&cameras, RectifyParams::default()).unwrap();
    let map = RemapTable::left(&cameras.left, &rectification, Rect::whole(640, 480), &Serial).unwrap();
    let remapped = |image: &[u8]| {
        let mut out = vec![0; 640 * 480];
        map.remap(gray(image, 640, 480), ViewMut::new(&mut out, 640, 480, 1), &Serial).unwrap();
        out
    };
    // Column and row, each as a coarse and a fine ramp, give a position to about a pixel.
    let column = remapped(&(0..640 * 480).map(|i| (i % 640 / 3) as u8).collect::<Vec<_>>());
    let row = remapped(&(0..640 * 480).map(|i| (i / 640 / 2) as u8).collect::<Vec<_>>());
    for ((x, y), (u, v)) in [
        ((0, 0), (39.326912, 26.132696)),
        ((320, 240), (333.71637, 235.78415)),
        ((639, 479), (628.2384, 448.46466)),
        ((600, 17), (587.1704, 25.94304)),
    ] {
        let at = y * 640 + x;
        close(f64::from(column[at]) * 3.0 + 1.0, u, 3.0, "column");
        close(f64::from(row[at]) * 2.0 + 0.5, v, 2.0, "row");
    }
}

#[test]
fn a_point_lands_on_one_row_and_its_depth_comes_back() {
    let cameras = cameras();
    let found = Rectification::new(&cameras, RectifyParams::default()).unwrap();
    for point in [[3.0, -4.0, 60.0], [-10.0, 6.0, 45.0], [12.0, 9.0, 80.0]] {
        let turn = |m: &[[f64; 3]; 3], v: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| (0..3).map(|j| m[i][j] * v[j]).sum())
        };
        let mut right = turn(&cameras.rotation, point);
        for (value, shift) in right.iter_mut().zip(cameras.translation_mm) {
            *value += shift;
        }
        let project = |camera: RectifiedCamera, v: [f64; 3]| {
            (camera.focal_px * v[0] / v[2] + camera.cx, camera.focal_px * v[1] / v[2] + camera.cy)
        };
        let in_left = turn(&found.rotation_left, point);
        let (u, v) = project(found.left, in_left);
        let (u_right, v_right) = project(found.right, turn(&found.rotation_right, right));
        close(v, v_right, 1e-3, "row");
        close(found.depth_mm(u - u_right), in_left[2], 1e-3, "depth");
    }
}

#[test]
fn unprojecting_inverts_projecting() {
    let camera = cameras().left;
    for (x, y) in [(0.0, 0.0), (0.3, -0.2), (-0.45, 0.35)] {
        let (u, v) = camera.project(x, y);
        let (found_x, found_y) = camera.unproject(u, v);
        close(found_x, x, 1e-7, "x");
        close(found_y, y, 1e-7, "y");
    }
}

#[test]
fn unusable_calibrations_are_refused_with_the_reason() {
    let reason = |change: &dyn Fn(&mut StereoCameras)| {
        let mut cameras = cameras();
        change(&mut cameras);
        match Rectification::new(&cameras, RectifyParams::default()) {
            Err(StereoError::Calibration { reason }) => reason,
            other => panic!("{other:?}"),
        }
    };
    assert!(reason(&|c| c.translation_mm[0] = 15.1).contains("disparities would be negative"));
    assert!(reason(&|c| c.translation_mm = [0.0; 3]).contains("baseline"));
    assert!(reason(&|c| c.translation_mm = [0.1, -9.0, 0.0]).contains("above one another"));
    assert!(reason(&|c| c.rotation[0][0] = 1.5).contains("rotation"));
    assert!(reason(&|c| c.rotation[1][1] = f64::NAN).contains("rotation"));
    assert!(reason(&|c| c.left.fx = f64::NAN).contains("finite"));
    assert!(reason(&|c| c.right.width = 320).contains("320x480"));
    assert!(CameraModel::new((640, 480), (500.0, 500.0), (320.0, 240.0), &[0.0; 6]).is_err());
}

#[test]
fn an_identity_map_copies_and_simd_agrees_with_portable() {
    let size = (83, 41);
    let plain = CameraModel::new(size, (90.0, 90.0), (41.0, 20.0), &[]).unwrap();
    let same = RectifiedCamera { focal_px: 90.0, cx: 41.0, cy: 20.0 };
    let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let bgr: Vec<u8> = (0..size.0 * size.1 * 3).map(|i| hash(i as i64, 8) as u8).collect();
    let map = RemapTable::new(&plain, &identity, same, size, Rect::whole(size.0, size.1), &Serial).unwrap();
    let mut out = vec![0; bgr.len()];
    map.remap(View::new(&bgr, size.0, size.1, 3), ViewMut::new(&mut out, size.0, size.1, 3), &Threads::new(2)).unwrap();
    assert_eq!(out, bgr);

    let bent = CameraModel::new(size, (70.0, 75.0), (40.3, 19.2), &[-0.3, 0.1, 0.001, 0.002]).unwrap();
    let roi = Rect { x: 2, y: 3, width: 75, height: 33 };
    let target = RectifiedCamera { focal_px: 55.0, cx: 41.0, cy: 20.0 };
    let fast = RemapTable::new(&bent, &identity, target, size, roi, &Serial).unwrap();
    let mut slow = fast.clone();
    slow.force_portable();
    for channels in [1, 3] {
        let source = View::new(&bgr[..size.0 * size.1 * channels], size.0, size.1, channels);
        let mut a = vec![1; size.0 * size.1 * channels];
        let mut b = vec![2; size.0 * size.1 * channels];
        fast.remap(source, ViewMut::new(&mut a, size.0, size.1, channels), &Threads::new(8)).unwrap();
        slow.remap(source, ViewMut::new(&mut b, size.0, size.1, channels), &Serial).unwrap();
        assert_eq!(a, b);
        assert!(a.iter().any(|value| *value > 0));
    }
}

#[test]
fn a_plane_comes_out_at_its_depth_and_flying_pixels_go() {
    let size = (60, 40);
    let camera = RectifiedCamera { focal_px: 500.0, cx: 30.0, cy: 20.0 };
    let found = Rectification {
        width: size.0,
        height: size.1,
        rotation_left: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        rotation_right: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        left: camera,
        right: camera,
        baseline_mm: 10.0,
        valid_left: Rect::whole(size.0, size.1),
        valid_right: Rect::whole(size.0, size.1),
    };
    let mut disparity = vec![100.0; size.0 * size.1];
    disparity[10 * size.0 + 10] = 150.0;
    disparity[20 * size.0 + 20] = f32::NAN;
    disparity[30 * size.0 + 30] = -3.0;
    disparity[31 * size.0 + 40] = 0.0;
    let mut depth = vec![0.0; size.0 * size.1];
    let mut points = vec![0.0; 3 * size.0 * size.1];
    let input = ReprojectInput {
        disparity: plane(&disparity, size.0, size.1),
        confidence: None,
        roi: Rect::whole(size.0, size.1),
    };
    let known = reproject(
        input,
        &found,
        &ReprojectParams::default(),
        &Threads::new(2),
        plane_mut(&mut depth, size.0, size.1),
        Some(ViewMut::new(&mut points, size.0, size.1, 3)),
    )
    .unwrap();
    assert_eq!(known, size.0 * size.1 - 4);
    for (x, y) in [(10, 10), (20, 20), (30, 30), (40, 31)] {
        assert!(depth[y * size.0 + x].is_nan() && points[3 * (y * size.0 + x)].is_nan());
    }
    let at = 5 * size.0 + 50;
    assert!((depth[at] - 50.0).abs() < 1e-3);
    let wanted = [20.0 / 500.0 * 50.0, -15.0 / 500.0 * 50.0, 50.0];
    for (found, wanted) in points[3 * at..3 * at + 3].iter().zip(wanted) {
        assert!((found - wanted).abs() < 1e-3, "{found}, {wanted} expected");
    }
}

/// A laparoscope's camera whose distortion was fitted near the centre alone: it turns back 177 px from there.
fn folding() -> CameraModel {
    CameraModel::new((720, 576), (448.0, 448.0), (360.0, 288.0), &[0.0, 0.0, 0.0, 0.0, -14.8]).unwrap()
}

#[test]
fn a_distortion_that_turns_back_is_found() {
    let camera = folding();
    close(camera.fold_px().unwrap(), 177.0, 2.0, "fold");
    let radius = camera.lens.fold_radius().unwrap();
    let at = |r: f64| camera.project(r, 0.0).0;
    assert!(at(radius) > at(radius - 0.01) && at(radius) > at(radius + 0.01));
    // Rational and usual ones do not turn back within a view.
    for distortion in
        [&[-0.3, 0.1, 0.0, 0.0, 0.0][..], &[0.2, 0.05, 0.0, 0.0], &[1.5, 0.9, 0.0, 0.0, 0.1, 1.9, 1.2, 0.2], &[]]
    {
        let fold = Lens::of_coefficients(distortion).unwrap().fold_radius();
        assert!(fold.is_none_or(|radius| radius > 1.0), "{distortion:?}: {fold:?}");
    }
}

#[test]
fn what_lies_beyond_the_fold_is_black_and_not_valid() {
    let (camera, eye) = (folding(), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let target = RectifiedCamera { focal_px: 448.0, cx: 360.0, cy: 288.0 };
    let map = RemapTable::new(&camera, &eye, target, (720, 576), Rect::whole(720, 576), &Serial).unwrap();
    assert!(map.is_folded());
    // Brightness grows with the distance from the centre, so that a mirrored pixel would be darker than its neighbour within.
    let distance = |i: usize| ((i % 720) as f64 - 360.0).hypot((i / 720) as f64 - 288.0);
    let ramp: Vec<u8> = (0..720 * 576).map(|i| (20.0 + distance(i) / 2.0) as u8).collect();
    let mut out = vec![0; 720 * 576];
    map.remap(gray(&ramp, 720, 576), ViewMut::new(&mut out, 720, 576, 1), &Serial).unwrap();
    let (valid, radius) = (map.valid(), camera.lens.fold_radius().unwrap() * 448.0);
    for (i, value) in out.iter().enumerate() {
        let is_inside = distance(i) <= radius;
        assert_eq!(*value > 0, is_inside, "{i}");
        assert_eq!(valid.contains(i % 720, i / 720), is_inside, "{i}");
    }
    let row = &out[288 * 720 + 360..][..radius as usize];
    assert!(row.windows(2).all(|pair| pair[0] <= pair[1]));
    // All is valid where nothing folds.
    let camera = CameraModel::new((720, 576), (448.0, 448.0), (360.0, 288.0), &[]).unwrap();
    let map = RemapTable::new(&camera, &eye, target, (720, 576), Rect::whole(720, 576), &Serial).unwrap();
    assert!(!map.is_folded() && map.valid().is_whole());
}
