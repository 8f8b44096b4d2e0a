//! Effects of the sensor and the lens on an image.

use super::*;

#[test]
fn a_lens_and_its_inverse_agree() {
    let k = [-0.35, 0.15, 0.002, -0.001, -0.02];
    for place in [[0.0, 0.0], [0.4, -0.3], [-0.42, 0.31]] {
        let ray = super::super::lens::undistort(&k, place).unwrap();
        let (seen, _) = super::super::lens::distort(&k, ray);
        assert!((seen[0] - place[0]).abs() < 1e-12 && (seen[1] - place[1]).abs() < 1e-12);
    }
    let mut rig = even_rig();
    rig.cameras[1].distortion = [-4.0, 0.0, 0.0, 0.0, 0.0];
    let refused = Phantom::new(quiet(SceneKind::Board), rig, &Serial).err();
    assert!(matches!(refused, Some(PhantomError::BadDistortion { camera: 1, .. })), "{refused:?}");
}

#[test]
fn faults_of_the_sensor_show() {
    let plain = |change: fn(&mut SceneParams)| {
        let mut params = SceneParams::default();
        change(&mut params);
        let mut phantom = Phantom::new(params, Rig::stereo(160, 120, 15.0), &Serial).unwrap();
        draw(&mut phantom, 10, None, &Serial)
    };
    let clean = plain(|_| {});
    let difference = |other: &[Vec<u8>], camera: usize| -> f64 {
        let sum: u64 = clean[camera].iter().zip(&other[camera]).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        sum as f64 / clean[camera].len() as f64
    };
    let noiseless = difference(&plain(|p| p.noise = 0.0), 0);
    assert!((0.3..3.0).contains(&noiseless), "noise of {noiseless} grey levels");
    assert!(difference(&plain(|p| p.smoke = 0.6), 0) > 15.0);
    let stained = difference(&plain(|p| p.blood_drops = 8), 1);
    assert!(stained > 1.5 * noiseless, "drops change {stained} grey levels, noise {noiseless}");
    let blurred = difference(&plain(|p| (p.motion_blur, p.camera_speed_mm_s) = (4, 25.0)), 0);
    assert!(blurred > noiseless, "motion blur changes the picture");
    let mean = |pictures: &[Vec<u8>]| pictures[0].iter().map(|b| f64::from(*b)).sum::<f64>() / pictures[0].len() as f64;
    let dark = plain(|p| p.light = 0.25);
    // The sensor's curve is a square root.
    assert!((0.45..0.6).contains(&(mean(&dark) / mean(&clean))), "{} of {}", mean(&dark), mean(&clean));
    let detail = |pictures: &[Vec<u8>]| {
        let steps = pictures[0].windows(4).map(|w| f64::from(w[0].abs_diff(w[3])));
        steps.sum::<f64>() / pictures[0].len() as f64
    };
    let (drawn, smooth) = (detail(&plain(|p| p.noise = 0.0)), detail(&plain(|p| (p.noise, p.texture) = (0.0, 0.0))));
    assert!(smooth < 0.5 * drawn, "steps of {smooth} gray levels without texture, {drawn} with it");
    let black = plain(|p| p.black = Some(BlackOut { camera: 1, first: 10, end: 11 }));
    assert!(black[1].iter().all(|&b| b == 0) && black[0] == clean[0]);
    let later = plain(|p| p.black = Some(BlackOut { camera: 1, first: 11, end: 15 }));
    assert_eq!(later, clean);
    let suffering = |kind: IncidentKind, first: u64, end: u64| {
        let params = SceneParams { incident: Some(Incident { kind, first, end }), ..SceneParams::default() };
        draw(&mut Phantom::new(params, Rig::stereo(160, 120, 15.0), &Serial).unwrap(), 10, None, &Serial)
    };
    for kind in [IncidentKind::Smoke, IncidentKind::Blur, IncidentKind::Covered] {
        let during = suffering(kind, 10, 11);
        assert!(difference(&during, 1) > 4.0, "{kind:?} changes {} gray levels", difference(&during, 1));
        assert_eq!(during[0] == clean[0], kind == IncidentKind::Covered, "{kind:?}");
        for (first, end) in [(5, 10), (11, 15)] {
            assert_eq!(suffering(kind, first, end), clean, "{kind:?} {first}..{end}");
        }
    }
    let jump = |first: u64, end: u64| suffering(IncidentKind::Jump, first, end);
    assert_eq!(jump(11, 12), clean);
    assert!(jump(10, 11) == jump(4, 5) && jump(10, 11)[0] != clean[0], "it stays where it jumped to");
}

#[test]
fn a_distorted_view_is_the_ideal_one_seen_through_the_lens() {
    let k = [-0.25, 0.08, 0.001, -0.0015, 0.0];
    let polynomial = CameraModel { distortion: k, ..even_rig().cameras[0] };
    check_view_through(polynomial, &|x, y| super::super::lens::distort(&k, [x, y]).0);
    let lens = panoscope_imaging::stereo::Equidistant::new([-0.05, 0.02, 0.0, 0.0]);
    let fisheye = CameraModel { equidistant: Some(lens), ..even_rig().cameras[0] };
    check_view_through(fisheye, &|x, y| lens.distort(x, y).into());
}

/// Compares a view with that of the pinhole at its position, whose ray `(x, y)` appears at `distort(x, y)`.
fn check_view_through(camera: CameraModel, distort: &dyn Fn(f64, f64) -> [f64; 2]) {
    let params = SceneParams { specular: 0.0, ..quiet(SceneKind::Board) };
    let mut rig = even_rig();
    rig.cameras[1] = camera;
    let mut phantom = Phantom::new(params, rig, &Serial).unwrap();
    let pictures = draw(&mut phantom, 20, None, &Serial);
    let ideal = View::new(&pictures[0], WIDTH, HEIGHT, 3);
    let (mut sum, mut count) = (0.0, 0);
    for v in (40..HEIGHT - 40).step_by(3) {
        for u in (40..WIDTH - 40).step_by(3) {
            // The ideal pixel (x, y) appears in the distorted picture at `seen`.
            let seen = distort((u as f64 - 319.5) / 750.0, (v as f64 - 239.5) / 750.0);
            let (x, y) = (seen[0] * 750.0 + 319.5, seen[1] * 750.0 + 239.5);
            let at = |i: usize, j: usize| f64::from(pictures[1][3 * ((y as usize + j) * WIDTH + x as usize + i)]);
            let (a, b) = (x.fract(), y.fract());
            let top = at(0, 0) * (1.0 - a) + at(1, 0) * a;
            let bottom = at(0, 1) * (1.0 - a) + at(1, 1) * a;
            sum += (top * (1.0 - b) + bottom * b - f64::from(ideal.row(v)[3 * u])).abs();
            count += 1;
        }
    }
    let mean = sum / f64::from(count);
    assert!(mean < 1.2, "{mean} grey levels between the views");
}
