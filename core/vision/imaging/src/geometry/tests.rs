//! Tests of homographies and their robust estimation.

use super::*;
use crate::Rect;
use crate::features::testing::corner_error;
use panoscope_base::random::lattice;

fn truth() -> Homography {
    Homography([0.93, 0.06, 120.0, -0.04, 1.03, -8.0, 1.2e-4, -5.0e-5, 1.0])
}

fn pairs(count: usize, noise_px: f64, outliers: f64) -> (Vec<Point>, Vec<Point>) {
    let random = |i: usize, k: i64| lattice(i as i64, k, 21);
    let from: Vec<Point> = (0..count).map(|i| [random(i, 0) * 640.0, random(i, 1) * 480.0]).collect();
    let to = from.iter().enumerate().map(|(i, &point)| {
        if random(i, 2) < outliers {
            return [random(i, 3) * 640.0, random(i, 4) * 480.0];
        }
        let [x, y] = truth().map(point);
        let jitter = |k: i64| (random(i, k) + random(i, k + 1) + random(i, k + 2) - 1.5) * 2.0 * noise_px;
        [x + jitter(10), y + jitter(20)]
    });
    let to = to.collect();
    (from, to)
}

#[test]
fn algebra_holds() {
    let map = truth();
    let back = map.inverse().unwrap();
    let point = [321.5, 77.25];
    let [x, y] = back.map(map.map(point));
    assert!((x - point[0]).abs() < 1e-9 && (y - point[1]).abs() < 1e-9);
    let both = map.compose(&back);
    assert!(corner_error(&both, &Homography::identity(), 640, 480) < 1e-9);
    assert!(Homography([0.0; 9]).inverse().is_none());
    assert!(Homography([f64::NAN; 9]).inverse().is_none());
    assert!(Homography([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.01, 0.0, 1.0]).map_corners(640, 480).is_none());
    assert!(map.map_corners(0, 10).is_none());
}

#[test]
fn shrunk_regions_are_carried_back() {
    // The map between the shrunk regions, built forwards from the full one, must come back as the full one.
    let (to, from, shrink) = ([200.0, 10.0], [0.0, 20.0], 2.0);
    let half = 0.5;
    let small_from_full = |origin: Point| {
        Homography::scaling(1.0 / shrink).compose(&Homography::translation(-origin[0] - half, -origin[1] - half))
    };
    let small = small_from_full(to).compose(&truth()).compose(&small_from_full(from).inverse().unwrap());
    assert!(corner_error(&small.unshrink(to, from, shrink), &truth(), 640, 480) < 1e-8);
}

#[test]
fn four_exact_pairs_give_the_map_and_noise_averages_out() {
    let (from, to) = pairs(4, 0.0, 0.0);
    let map = Homography::fit(&from, &to, |_| true).unwrap();
    assert!(corner_error(&map, &truth(), 640, 480) < 1e-6);
    let (from, to) = pairs(400, 0.5, 0.0);
    let algebraic = Homography::fit(&from, &to, |_| true).unwrap();
    let refined = algebraic.refine(&from, &to, |_| true, 10);
    let error = |map: &Homography| from.iter().zip(&to).map(|(&a, &b)| map.squared_error(a, b)).sum::<f64>();
    assert!(error(&refined) <= error(&algebraic));
    assert!(corner_error(&refined, &truth(), 640, 480) < 0.3);
    // From a bad start the refinement comes to the same place.
    let mut bad = truth();
    bad.0[2] += 5.0;
    bad.0[1] += 0.02;
    assert!(corner_error(&bad.refine(&from, &to, |_| true, 30), &refined, 640, 480) < 1e-3);
}

#[test]
fn degenerate_pairs_have_no_map() {
    let line: Vec<Point> = (0..20).map(|i| [f64::from(i) * 10.0, f64::from(i) * 5.0]).collect();
    assert!(Homography::fit(&line, &line, |_| true).is_none());
    assert!(Homography::fit(&line[..3], &line[..3], |_| true).is_none());
    assert!(Homography::fit(&[[1.0, 1.0]; 9], &[[2.0, 2.0]; 9], |_| true).is_none());
    assert!(Homography::fit(&[[f64::NAN, 1.0]; 9], &[[2.0, 2.0]; 9], |_| true).is_none());
    let mut mask = Vec::new();
    let params = RansacParams { max_iterations: 200, ..RansacParams::default() };
    let mut run = |from: &[Point], to: &[Point]| Ransac::new().estimate(from, to, &params, &mut mask);
    assert_eq!(run(&line[..3], &line[..3]), Err(RansacError::TooFewMatches { found: 3 }));
    assert_eq!(run(&[], &[]), Err(RansacError::TooFewMatches { found: 0 }));
    assert_eq!(run(&line, &line), Err(RansacError::Degenerate));
    assert_eq!(run(&[[5.0, 5.0]; 8], &[[6.0, 6.0]; 8]), Err(RansacError::Degenerate));
    assert_eq!(run(&[[f64::NAN; 2]; 8], &[[f64::INFINITY; 2]; 8]), Err(RansacError::Degenerate));
}

#[test]
fn ransac_finds_the_map_among_outliers() {
    for (outliers, seed) in [(0.0, 1), (0.3, 2), (0.6, 3)] {
        let (from, to) = pairs(300, 0.3, outliers);
        let params = RansacParams { seed, threshold_px: 2.0, ..RansacParams::default() };
        let mut mask = Vec::new();
        let fit = Ransac::new().estimate(&from, &to, &params, &mut mask).unwrap();
        let error = corner_error(&fit.homography, &truth(), 640, 480);
        assert!(error < 0.5, "{outliers}: off by {error} px, {fit:?}");
        assert!(fit.rms_px < 1.0 && fit.inliers == mask.iter().filter(|&&flag| flag).count());
        for (flag, (&a, &b)) in mask.iter().zip(from.iter().zip(&to)) {
            assert_eq!(*flag, fit.homography.squared_error(a, b) <= 4.0);
        }
        let again = Ransac::new().estimate(&from, &to, &params, &mut Vec::new()).unwrap();
        assert_eq!(again, fit);
    }
}

#[test]
fn implausible_frames_are_refused() {
    let bounds = Plausibility::default();
    let size = (640, 480);
    assert!(bounds.accepts(&truth(), size));
    assert!(bounds.accepts(&Homography::identity(), size));
    for (name, map) in [
        ("mirrored", [-1.0, 0.0, 640.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        ("tiny", [0.1, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]),
        ("huge", [4.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 1.0]),
        ("squashed", [2.5, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 1.0]),
        ("behind", [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.01, 0.0, 1.0]),
        ("not a number", [f64::NAN, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
    ] {
        assert!(!bounds.accepts(&Homography(map), size), "{name}");
    }
    assert!(!bounds.accepts(&Homography::identity(), (0, 0)));
    let bow = [[0.0, 0.0], [10.0, 10.0], [10.0, 0.0], [0.0, 10.0]];
    assert!(!plausible::is_convex(&bow));
}

#[test]
fn overlap_is_the_bounding_rectangle() {
    let (left, right) = overlap_rois(&Homography::translation(200.0, -30.0), (640, 480), (640, 480));
    assert_eq!((left.x, left.y, left.width, left.height), (200, 0, 440, 450));
    assert_eq!((right.x, right.y, right.width, right.height), (0, 30, 440, 450));
    let (left, right) = overlap_rois(&Homography::translation(900.0, 0.0), (640, 480), (640, 480));
    assert!(left.is_empty() && right.is_empty());
    assert!(overlap_rois(&Homography([f64::NAN; 9]), (640, 480), (640, 480)).0.is_empty());
    let grown = Rect::new(5, 400, 100, 80).grown(10, 640, 480);
    assert_eq!(grown, Rect::new(0, 390, 115, 90));
}

#[test]
fn a_good_previous_map_stays() {
    let (from, to) = pairs(100, 0.3, 0.0);
    let mut work = Vec::new();
    let mut near = truth();
    near.0[2] += 0.4;
    let params =
        StabilityParams { stability_px: 1.0, still_tolerance: 0.1, outlier_px: 3.0, anchor_fit: 0.0, max_rms_px: 0.0 };
    let mask = vec![true; from.len()];
    let fit = RansacFit { homography: truth(), inliers: from.len(), rms_px: 0.0, iterations: 1 };
    let mut stability = Stability::default();
    let mut choose = |previous| stability.choose(&fit, previous, (640, 480), (&from, &to, &mask), &params);
    assert_eq!(choose(Some(near)), Stabilized { homography: near, kept: true });
    let mut far = truth();
    far.0[2] += 3.0;
    assert_eq!(choose(Some(far)), Stabilized { homography: truth(), kept: false });
    assert_eq!(choose(None), Stabilized { homography: truth(), kept: false });
    assert_eq!(median_error(&truth(), &[], &[], |_| true, &mut work), None);
}

#[test]
fn a_jump_lets_go_of_the_frame_before() {
    let (from, to) = pairs(100, 0.3, 0.0);
    let mask = vec![true; from.len()];
    let fit = RansacFit { homography: truth(), inliers: from.len(), rms_px: 0.0, iterations: 1 };
    let params =
        StabilityParams { stability_px: 1.0, still_tolerance: 0.1, outlier_px: 5.0, anchor_fit: 1.0, max_rms_px: 0.0 };
    let choose =
        |previous| Stability::default().choose(&fit, previous, (640, 480), (&from, &to, &mask), &params).homography;
    let moved = |px: f64| {
        let mut map = truth();
        map.0[2] += px;
        map
    };
    let corner = |map: &Homography| map.squared_error([0.0, 0.0], truth().map([0.0, 0.0])).sqrt();
    assert!(corner(&choose(Some(moved(8.0)))) > 0.5, "what moves little is held back");
    assert_eq!(choose(Some(moved(60.0))), choose(None), "what jumps is not");
}

#[test]
fn the_frame_before_stays_while_it_explains_as_much() {
    let from: Vec<Point> = (0..40).map(|i| [f64::from(i % 8) * 50.0, f64::from(i / 8) * 60.0]).collect();
    // Two planes of one scene, each right for half of the pairs.
    let to: Vec<Point> =
        from.iter().enumerate().map(|(i, p)| [p[0] + if i % 2 == 0 { 10.0 } else { 30.0 }, p[1]]).collect();
    let (near, far, off) =
        (Homography::translation(10.0, 0.0), Homography::translation(30.0, 0.0), Homography::translation(20.0, 0.0));
    assert!(super::explains_as_well(&near, &far, &from, &to, 3.0, 0.1), "no reason to change the plane");
    assert!(!super::explains_as_well(&off, &far, &from, &to, 3.0, 0.1), "it explains nothing");
}

#[test]
fn one_noisy_frame_does_not_move_the_picture_and_two_do() {
    let from: Vec<Point> = (0..40).map(|i| [f64::from(i % 8) * 50.0, f64::from(i / 8) * 60.0]).collect();
    let to: Vec<Point> =
        from.iter().enumerate().map(|(i, p)| [p[0] + if i % 2 == 0 { 1.5 } else { -1.5 }, p[1]]).collect();
    let params =
        StabilityParams { stability_px: 0.3, still_tolerance: 0.1, outlier_px: 4.0, anchor_fit: 0.0, max_rms_px: 0.0 };
    let mask = vec![true; from.len()];
    let fit = RansacFit { homography: Homography::identity(), inliers: from.len(), rms_px: 1.5, iterations: 1 };
    let mut stability = Stability::default();
    let mut keeps = |x| {
        let before = Some(Homography::translation(x, 0.0));
        stability.choose(&fit, before, (640, 480), (&from, &to, &mask), &params).kept
    };
    // 1 px off: 1.4 times the cost of the fresh map. 4 px off: the cost of outliers.
    assert!(keeps(1.0), "doubted once");
    assert!(!keeps(1.0), "twice in a row");
    assert!(keeps(1.0) && keeps(0.1) && keeps(1.0), "a good frame ends the doubt");
    assert!(!keeps(4.0), "far off");
}

#[test]
fn a_map_whose_inliers_are_far_off_is_not_kept() {
    // Few pairs of another plane, which the capped costs of the map before do not show: most pairs are outliers of both.
    let from: Vec<Point> = (0..60).map(|i| [f64::from(i % 8) * 50.0, f64::from(i / 8) * 50.0]).collect();
    let to: Vec<Point> = from.iter().enumerate().map(|(i, p)| [p[0] + if i < 28 { 0.0 } else { 15.0 }, p[1]]).collect();
    let mask: Vec<bool> = (0..60).map(|i| i >= 28).collect();
    let fit = RansacFit { homography: Homography::translation(15.0, 0.0), inliers: 32, rms_px: 0.0, iterations: 1 };
    let choose = |max_rms_px: f64| {
        let params =
            StabilityParams { stability_px: 0.8, still_tolerance: 0.2, outlier_px: 5.0, anchor_fit: 0.0, max_rms_px };
        let before = Some(Homography::identity());
        Stability::default().choose(&fit, before, (640, 480), (&from, &to, &mask), &params)
    };
    assert_eq!(choose(0.0), Stabilized { homography: Homography::identity(), kept: true });
    assert_eq!(super::rms_of(&Homography::identity(), &from, &to, &mask), 15.0);
    assert_eq!(choose(10.0), Stabilized { homography: fit.homography, kept: false });
}

#[test]
fn one_rule_says_what_is_singular() {
    // Rows (1, 0, 0), (cos, sin, 0), (0, 0, 1) of length 1: the determinant is the sine.
    let with_determinant =
        |sine: f64| Homography([1.0, 0.0, 0.0, (1.0 - sine * sine).sqrt(), sine, 0.0, 0.0, 0.0, 1.0]);
    let scaled = |map: &Homography, by: f64| Homography(map.0.map(|value| value * by));
    for by in [1e-20, 1e-3, 1.0, 1e3, 1e20] {
        for (share, is_regular) in [(1.001, true), (0.999, false), (-1.001, true), (-0.999, false), (0.0, false)] {
            let map = scaled(&with_determinant(share * SINGULAR_DETERMINANT), by);
            assert_eq!(map.inverse_raw().is_some(), is_regular, "{share} of the threshold, scaled by {by}");
            assert_eq!(map.inverse_bounded().is_some(), is_regular, "{share} of the threshold, scaled by {by}");
        }
    }
    // Far shifts and strong reductions are maps like any other.
    for map in [Homography::translation(1e6, -1e6), Homography::scaling(1e-5), Homography::scaling(1e5)] {
        let back = map.inverse().expect("regular");
        let [x, y] = back.map(map.map([3.0, 4.0]));
        assert!((x - 3.0).abs() < 1e-6 && (y - 4.0).abs() < 1e-6, "{map:?}");
    }
    for broken in [[0.0; 9], [f64::NAN; 9], [f64::INFINITY; 9], [1e200; 9]] {
        assert_eq!(Homography(broken).inverse(), None);
        assert_eq!(Homography(broken).inverse_bounded(), None);
    }
}
