//! Tests of colour conversion, integral image, SURF and matching.

use super::color::{gray_from_with, shrink_gray_with};
use super::testing::{blobs, corner_error, render, similarity};
use super::*;
use crate::Rect;
use crate::geometry::{Homography, Ransac, RansacParams, RegistrationState};
use crate::{Parallel, Serial, Simd, View};
use panoscope_base::Threads;
use panoscope_base::random::lattice;

fn bytes(len: usize, seed: u64) -> Vec<u8> {
    (0..len).map(|i| (lattice(i as i64, 3, seed) * 256.0) as u8).collect()
}

fn detect(image: View<'_, u8>, params: SurfParams) -> Features {
    let mut out = Features::default();
    Surf::new(params).detect_and_describe(image, None, 1, &Serial, &mut out);
    out
}

#[test]
fn integral_image_equals_plain_sums() {
    for (width, height, stride) in [(1, 1, 1), (7, 3, 9), (8, 33, 8), (37, 70, 41), (64, 31, 64)] {
        let data = bytes(stride * height, 1);
        let image = View::with_stride(&data, width, height, 1, stride);
        for simd in [Simd::portable(), Simd::detect()] {
            let mut integral = Integral::new();
            // A larger image first: leftovers must not show.
            integral.compute_with(simd, View::new(&bytes(90 * 90, 2), 90, 90, 1), &Serial);
            integral.compute_with(simd, image, &Threads::new(2));
            for y in 0..=height {
                for x in 0..=width {
                    let plain: u32 =
                        (0..y).flat_map(|row| image.row(row)[..x].iter()).map(|&value| u32::from(value)).sum();
                    assert_eq!(integral.row(y)[x], plain, "{width}x{height} at {x},{y}");
                }
            }
        }
    }
}

#[test]
fn gray_and_shrinking_equal_their_definitions() {
    for (width, height) in [(1, 1), (5, 4), (33, 7), (100, 37), (131, 5)] {
        let stride = width * 3 + 5;
        let data = bytes(stride * height, 4);
        let image = View::with_stride(&data, width, height, 3, stride);
        let mut gray = GrayBuffer::new();
        for simd in [Simd::portable(), Simd::detect()] {
            gray_from_with(simd, image, &mut gray, &Threads::new(2));
            for y in 0..height {
                for (x, bgr) in image.row(y).chunks_exact(3).enumerate() {
                    let exact = 0.114 * f64::from(bgr[0]) + 0.587 * f64::from(bgr[1]) + 0.299 * f64::from(bgr[2]);
                    let value = f64::from(gray.view().row(y)[x]);
                    assert!((value - exact).abs() <= 0.51, "{value} for {exact}");
                }
            }
            let full: Vec<u8> = (0..height).flat_map(|y| gray.view().row(y).to_vec()).collect();
            for factor in [2, 3, 5] {
                let mut small = GrayBuffer::new();
                shrink_gray_with(simd, image, factor, &mut small, &Threads::new(2));
                let view = small.view();
                assert_eq!((view.width, view.height), (width / factor, height / factor));
                for y in 0..view.height {
                    for x in 0..view.width {
                        let block = (0..factor * factor)
                            .map(|i| u32::from(full[(y * factor + i / factor) * width + x * factor + i % factor]));
                        let area = (factor * factor) as u32;
                        assert_eq!(u32::from(view.row(y)[x]), (block.sum::<u32>() + area / 2) / area);
                    }
                }
            }
        }
    }
}

#[test]
fn blobs_are_found_where_they_are() {
    let truth =
        [(60.3, 50.7, 3.0, 90.0), (140.55, 61.25, 4.0, -80.0), (90.1, 130.9, 6.0, 100.0), (170.0, 150.5, 2.2, -100.0)];
    let data = blobs(240, 210, &truth);
    for second_look in [false, true] {
        let found =
            detect(View::new(&data, 240, 210, 1), SurfParams { max_points: 4, second_look, ..SurfParams::default() });
        let keypoints = &found.keypoints;
        for (x, y, sigma, height) in truth {
            let near = (0..found.len()).find(|&i| {
                (f64::from(keypoints.x_px[i]) - x).hypot(f64::from(keypoints.y_px[i]) - y)
                    < if second_look { 0.1 } else { 0.2 }
            });
            let near = near.unwrap_or_else(|| panic!("no keypoint at {x},{y}: {keypoints:?}"));
            assert_eq!(keypoints.laplacian[near], if height < 0.0 { 1 } else { -1 });
            // A blob has its largest response at the filter whose Gaussian matches it.
            let ratio = f64::from(keypoints.size_px[near]) / (sigma * 9.0 / 1.2);
            assert!((0.6..1.4).contains(&ratio), "size {} for sigma {sigma}", keypoints.size_px[near]);
        }
    }
}

#[test]
fn regions_and_shrinking_give_full_frame_pixels() {
    let truth = [(130.3, 150.7, 8.0, 90.0), (191.5, 111.2, 9.0, -90.0)];
    let data = blobs(320, 260, &truth);
    let mut surf = Surf::new(SurfParams { max_points: 2, ..SurfParams::default() });
    let mut found = Features::default();
    for (roi, shrink, tolerance) in [
        (None, 1, 0.12),
        (Some(Rect::new(71, 63, 200, 170)), 1, 0.12),
        (None, 2, 0.2),
        (Some(Rect::new(51, 53, 221, 191)), 2, 0.2),
        (Some(Rect::new(31, 33, 900, 900)), 3, 0.3),
    ] {
        surf.detect_and_describe(View::new(&data, 320, 260, 1), roi, shrink, &Serial, &mut found);
        assert_eq!(found.len(), 2, "{roi:?} {shrink}");
        for (x, y, ..) in truth {
            let nearest = (0..2)
                .map(|i| found.keypoints.position(i))
                .map(|[px, py]| (px - x).hypot(py - y))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest < tolerance, "{roi:?} shrunk {shrink}: off by {nearest}");
        }
    }
}

#[test]
fn instruction_sets_and_threads_agree_bit_for_bit() {
    let data = render(233, 187, &Homography::identity());
    let image = View::new(&data, 233, 187, 1);
    for (upright, extended) in [(false, false), (true, false), (false, true), (true, true)] {
        for (roi, shrink) in [(None, 1), (Some(Rect::new(10, 7, 200, 171)), 1), (None, 2)] {
            let params = SurfParams {
                hessian_threshold: 10.0,
                max_points: 200,
                spread: (4, 3),
                upright,
                extended,
                ..SurfParams::default()
            };
            let run = |simd: Simd, pool: &dyn Parallel| {
                let mut out = Features::default();
                Surf::with_simd(params, simd).detect_and_describe(image, roi, shrink, pool, &mut out);
                out
            };
            let reference = run(Simd::portable(), &Serial);
            assert!(reference.len() > 30, "{} points", reference.len());
            assert_eq!(reference.extension.len(), if extended { reference.len() } else { 0 });
            assert_eq!(run(Simd::detect(), &Serial), reference);
            assert_eq!(run(Simd::detect(), &Threads::new(2)), reference);
            assert_eq!(run(Simd::detect(), &Threads::new(8)), reference);
        }
    }
}

#[test]
fn points_are_limited_sorted_and_spread() {
    let data = render(320, 240, &Homography::identity());
    let image = View::new(&data, 320, 240, 1);
    let all = detect(image, SurfParams { hessian_threshold: 5.0, ..SurfParams::default() });
    let some = detect(image, SurfParams { hessian_threshold: 5.0, max_points: 50, ..SurfParams::default() });
    assert!(all.len() > 100 && some.len() == 50);
    let rank = |features: &Features, i: usize| features.keypoints.response[i] / features.keypoints.size_px[i];
    assert!((1..50).all(|i| rank(&some, i - 1) >= rank(&some, i) * 0.999));
    let spread =
        detect(image, SurfParams { hessian_threshold: 5.0, max_points: 50, spread: (5, 4), ..SurfParams::default() });
    assert_eq!(spread.len(), 50);
    let cells = |features: &Features| {
        let cell = |i: usize| {
            let [x, y] = features.keypoints.position(i);
            (x / 64.0) as usize + 5 * (y / 60.0) as usize
        };
        (0..features.len()).map(cell).collect::<std::collections::BTreeSet<_>>().len()
    };
    assert!(cells(&spread) >= cells(&some));
    assert!(some.descriptors.iter().all(|d| (d.0.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-4));
}

#[test]
fn small_flat_and_odd_images_give_nothing_and_do_not_panic() {
    let mut surf = Surf::new(SurfParams::default());
    let mut out = Features::default();
    for (width, height) in [(0, 0), (0, 9), (1, 1), (3, 5), (22, 500), (23, 23), (640, 5)] {
        let data = bytes(width * height, 5);
        for shrink in [0, 1, 2, 1000] {
            surf.detect_and_describe(View::new(&data, width, height, 1), None, shrink, &Serial, &mut out);
            assert_eq!(out.descriptors.len(), out.len());
            let outside = Some(Rect::new(1000, 2, 10, 10));
            surf.detect_and_describe(View::new(&data, width, height, 1), outside, shrink, &Serial, &mut out);
            assert!(out.is_empty());
        }
    }
    surf.detect_and_describe(View::new(&[77; 200 * 150], 200, 150, 1), None, 1, &Serial, &mut out);
    assert!(out.is_empty());
    for params in [
        SurfParams { octaves: 0, ..SurfParams::default() },
        SurfParams { octaves: 99, layers: 0, ..SurfParams::default() },
        SurfParams { hessian_threshold: f32::NAN, max_points: 1, ..SurfParams::default() },
        SurfParams { fine_bias: f32::NAN, max_points: 3, spread: (7, 7), ..SurfParams::default() },
    ] {
        detect(View::new(&bytes(200 * 150, 6), 200, 150, 1), params);
    }
}

fn register(map: &Homography, upright: bool) -> (f64, usize, usize) {
    let (width, height) = (400, 320);
    let left = render(width, height, &Homography::identity());
    let right = render(width, height, map);
    let params = SurfParams { max_points: 500, upright, ..SurfParams::default() };
    let (left, right) =
        (detect(View::new(&left, width, height, 1), params), detect(View::new(&right, width, height, 1), params));
    let mut matches = Vec::new();
    Matcher::new().match_features(&left, &right, &MatchParams::default(), None, &Serial, &mut matches);
    let to: Vec<_> = matches.iter().map(|m| left.keypoints.position(m.left as usize)).collect();
    let from: Vec<_> = matches.iter().map(|m| right.keypoints.position(m.right as usize)).collect();
    let fit = Ransac::new().estimate(&from, &to, &RansacParams::default(), &mut Vec::new());
    fit.map_or((f64::INFINITY, 0, matches.len()), |fit| {
        (corner_error(&fit.homography, map, width, height), fit.inliers, matches.len())
    })
}

#[test]
fn known_homographies_are_recovered() {
    let perspective = Homography([0.95, 0.04, 12.0, -0.03, 1.02, 9.0, 1.0e-4, -6.0e-5, 1.0]);
    for (name, map, upright) in [
        ("translation", Homography::translation(31.4, -17.3), true),
        ("small turn", similarity(0.08, 1.05, 200.0, 160.0, 5.2, 3.7), true),
        ("quarter turn", similarity(1.45, 1.0, 200.0, 160.0, 3.0, -4.0), false),
        ("turn and zoom", similarity(0.6, 1.3, 200.0, 160.0, 0.0, 7.0), false),
        ("half turn", similarity(3.0, 0.8, 200.0, 160.0, 0.0, 0.0), false),
        ("perspective", perspective, false),
    ] {
        let (error, inliers, matches) = register(&map, upright);
        println!("{name}: corners off by {error:.3} px, {inliers} inliers of {matches} matches");
        assert!(error < 0.3, "{name}: corners off by {error} px");
        assert!(inliers * 10 > matches * 7, "{name}: {inliers} of {matches}");
    }
}

fn random_features(count: usize, extended: bool, seed: u64) -> Features {
    let mut features = Features::default();
    for i in 0..count {
        let mut halves = [Descriptor::default(); 2];
        let used = &mut halves[..if extended { 2 } else { 1 }];
        let mut squares = 0.0;
        for (k, value) in used.iter_mut().flat_map(|half| &mut half.0).enumerate() {
            *value = lattice(i as i64, k as i64, seed) as f32 - 0.4;
            squares += *value * *value;
        }
        used.iter_mut().flat_map(|half| &mut half.0).for_each(|value| *value /= squares.sqrt());
        features.descriptors.push(halves[0]);
        if extended {
            features.extension.push(halves[1]);
        }
        let keypoints = &mut features.keypoints;
        keypoints.x_px.push(lattice(i as i64, 100, seed) as f32 * 600.0);
        keypoints.y_px.push(lattice(i as i64, 101, seed) as f32 * 400.0);
        keypoints.size_px.push(9.0);
        keypoints.angle_rad.push(0.0);
        keypoints.response.push(1.0);
        keypoints.laplacian.push(if lattice(i as i64, 102, seed) < 0.5 { 1 } else { -1 });
    }
    features
}

#[test]
fn matching_equals_a_plain_search() {
    for extended in [false, true] {
        for (n, m) in [(0, 5), (5, 0), (1, 1), (37, 90), (120, 61)] {
            plain_search(&random_features(n, extended, 8), &random_features(m, extended, 9));
        }
    }
}

fn plain_search(left: &Features, right: &Features) {
    let map = Homography::translation(20.0, -10.0);
    let (n, m) = (left.len(), right.len());
    for same_sign in [false, true] {
        for gate in [None, Some(Gate::circle(map, 80.0)), Some(Gate { weights: [0.0, 1.0], ..Gate::circle(map, 9.0) })]
        {
            for mutual in [false, true] {
                let params = MatchParams { ratio: 0.97, mutual, same_sign };
                let run = |simd: Simd, pool: &dyn Parallel| {
                    let mut out = Vec::new();
                    Matcher::with_simd(simd).match_features(left, right, &params, gate.as_ref(), pool, &mut out);
                    out
                };
                let found = run(Simd::portable(), &Serial);
                assert_eq!(run(Simd::detect(), &Serial), found);
                assert_eq!(run(Simd::detect(), &Threads::new(8)), found);
                let allowed = |i: usize, j: usize| {
                    let [x, y] = left.keypoints.position(i);
                    let [u, v] = map.map(right.keypoints.position(j));
                    (!same_sign || left.keypoints.laplacian[i] == right.keypoints.laplacian[j])
                        && gate.is_none_or(|Gate { radius_px, weights: [wx, wy], .. }| {
                            (wx * (x - u)).hypot(wy * (y - v)) < f64::from(radius_px)
                        })
                };
                let distance = |i: usize, j: usize| {
                    let halves = [(&left.descriptors, &right.descriptors), (&left.extension, &right.extension)];
                    let halves = halves.iter().filter_map(|(left, right)| Some((left.get(i)?, right.get(j)?)));
                    let pairs = halves.flat_map(|(left, right)| left.0.iter().zip(&right.0));
                    pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
                };
                let best = |count: usize, distance: &dyn Fn(usize) -> Option<f64>| {
                    let mut list: Vec<_> = (0..count).filter_map(|j| distance(j).map(|d| (d, j))).collect();
                    list.sort_by(|a, b| a.0.total_cmp(&b.0));
                    list
                };
                let mut expected = Vec::new();
                for i in 0..n {
                    let list = best(m, &|j| allowed(i, j).then(|| distance(i, j)));
                    let Some(&(first, j)) = list.first() else { continue };
                    let passes = list.get(1).map_or(gate.is_some(), |second| first < 0.97 * second.0);
                    let back = best(n, &|k| allowed(k, j).then(|| distance(k, j)));
                    if passes && (!mutual || back.first().is_some_and(|back| back.1 == i)) {
                        expected.push((i as u32, j as u32));
                    }
                }
                let pairs: Vec<_> = found.iter().map(|found| (found.left, found.right)).collect();
                assert_eq!(pairs, expected, "{n} {m} {same_sign} {mutual} {gate:?}");
                for found in &found {
                    let exact = distance(found.left as usize, found.right as usize);
                    assert!((f64::from(found.distance) - exact).abs() < 2e-3);
                }
            }
        }
    }
}

#[test]
fn descriptors_of_different_lengths_do_not_match() {
    let (short, long) = (random_features(40, false, 8), random_features(40, true, 8));
    let mut matcher = Matcher::new();
    let mut out = Vec::new();
    // One matcher for both lengths: what is left of one must not show in the other.
    for (left, right, expected) in [(&long, &long, 40), (&short, &long, 0), (&short, &short, 40), (&long, &short, 0)] {
        matcher.match_features(left, right, &MatchParams::default(), None, &Serial, &mut out);
        assert_eq!(out.len(), expected);
        assert!(out.iter().all(|m| m.left == m.right && m.distance < 1e-3));
    }
}

/// Each descriptor of the scene compared with that of the same position seen through `map`: distances of equal and of
/// other positions.
fn extended_distances(map: &Homography, scale: f32, upright: bool) -> Vec<(f32, f32)> {
    let (width, height) = (400, 320);
    let params = SurfParams { max_points: 150, extended: true, upright, ..SurfParams::default() };
    let (left, right) = (render(width, height, &Homography::identity()), render(width, height, map));
    let (left, right) =
        (detect(View::new(&left, width, height, 1), params), detect(View::new(&right, width, height, 1), params));
    let distance = |i: usize, j: usize| {
        let halves = [(&left.descriptors[i], &right.descriptors[j]), (&left.extension[i], &right.extension[j])];
        let pairs = halves.iter().flat_map(|(left, right)| left.0.iter().zip(&right.0));
        pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
    };
    let far = |i: usize, j: usize| {
        let (a, b) = (left.keypoints.position(i), map.map(right.keypoints.position(j)));
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    let mut result = Vec::new();
    for j in 0..right.len() {
        let ratio = |i: usize| left.keypoints.size_px[i] / (right.keypoints.size_px[j] * scale);
        let same = (0..left.len()).find(|&i| far(i, j) < 1.0 && (0.8..1.25).contains(&ratio(i)));
        if let Some(same) = same {
            let other = (0..left.len()).filter(|&i| far(i, j) > 8.0).map(|i| distance(i, j));
            result.push((distance(same, j), other.fold(f32::INFINITY, f32::min)));
        }
    }
    result
}

#[test]
fn extended_descriptors_bear_turns_and_scales() {
    let turned = |angle: f64, scale: f32| similarity(angle, f64::from(scale), 200.0, 160.0, 3.0, -4.0);
    for (name, map, scale, upright) in [
        ("shift", Homography::translation(31.0, -17.0), 1.0, true),
        ("quarter turn", turned(1.45, 1.0), 1.0, false),
        ("half turn", turned(3.0, 1.0), 1.0, false),
        ("zoom in", turned(0.0, 0.7), 0.7, false),
        ("turn and zoom out", turned(0.6, 1.3), 1.3, false),
    ] {
        let distances = extended_distances(&map, scale, upright);
        let nearer = distances.iter().filter(|(same, other)| same < other).count();
        let mut same: Vec<f32> = distances.iter().map(|distance| distance.0).collect();
        same.sort_by(f32::total_cmp);
        println!("{name}: {nearer} of {} nearest, median distance {:.3}", same.len(), same[same.len() / 2]);
        assert!(same.len() > 30, "{name}: {} places seen twice", same.len());
        assert!(nearer * 10 > same.len() * 9, "{name}: {nearer} of {}", same.len());
        assert!(same[same.len() / 2] < 0.25, "{name}: {}", same[same.len() / 2]);
    }
}

#[test]
fn extended_descriptors_have_unit_length_and_two_windows() {
    let data = render(320, 240, &Homography::identity());
    let image = View::new(&data, 320, 240, 1);
    let params = |extended| SurfParams { hessian_threshold: 5.0, max_points: 60, extended, ..SurfParams::default() };
    let (plain, both) = (detect(image, params(false)), detect(image, params(true)));
    assert_eq!(plain.keypoints, both.keypoints);
    assert_eq!((plain.extension.len(), both.extension.len()), (0, 60));
    for (narrow, wide) in both.descriptors.iter().zip(&both.extension) {
        let squares = |half: &Descriptor| half.0.iter().map(|value| value * value).sum::<f32>();
        assert!((squares(narrow) - 0.5).abs() < 1e-4 && (squares(wide) - 0.5).abs() < 1e-4);
        assert!(narrow.0.iter().zip(&wide.0).any(|(a, b)| (a - b).abs() > 0.01));
    }
}

#[test]
fn memory_of_extended_features_is_kept() {
    let data = render(320, 240, &Homography::identity());
    let params = SurfParams { hessian_threshold: 5.0, max_points: 80, extended: true, ..SurfParams::default() };
    let (mut surf, mut features) = (Surf::new(params), Features::default());
    let mut pointer = None;
    // A flat picture between: the list empties and fills again where it was.
    for image in [&data, &vec![7; 320 * 240], &data] {
        surf.detect_and_describe(View::new(image, 320, 240, 1), None, 1, &Serial, &mut features);
        if !features.is_empty() {
            assert_eq!(*pointer.get_or_insert(features.extension.as_ptr()), features.extension.as_ptr());
        }
    }
    surf.set_params(SurfParams { extended: false, ..params });
    surf.detect_and_describe(View::new(&data, 320, 240, 1), None, 1, &Serial, &mut features);
    assert!(features.extension.is_empty() && !features.is_empty());
}

#[test]
fn evaluation_counts_what_it_says() {
    let map = Homography::translation(10.0, 0.0);
    let first = [[5.0, 5.0], [20.0, 20.0], [95.0, 50.0], [40.0, 40.0]];
    let second = [[15.5, 5.0], [30.0, 21.0], [50.0, 44.0], [2.0, 2.0], [30.2, 20.0]];
    // The third leaves the second image; the fourth of the second image is not seen in the first.
    let result = repeatability(&first, &second, &map, (100, 100), (100, 100), 2.0);
    assert_eq!((result.repeated, result.possible), (2, 3));
    let result = precision(&first, &second, &[(0, 0), (1, 4), (3, 2), (9, 9)], &map, 2.0);
    assert_eq!((result.correct, result.total, result.share), (2, 4, 0.5));
    assert_eq!(repeatability(&[], &second, &map, (100, 100), (100, 100), 2.0).share, 0.0);
    assert_eq!(precision(&first, &second, &[], &map, 2.0).share, 0.0);
}

#[test]
fn registration_follows_fails_and_resumes() {
    let (width, height) = (480, 360);
    let truth = |shift: f64| Homography([1.0, 0.02, 180.0 + shift, -0.015, 1.01, 6.0, 2.0e-5, 0.0, 1.0]);
    let left = render(width, height, &Homography::identity());
    let view = |data: &'static [u8]| View::new(data, width, height, 1);
    let leak = |data: Vec<u8>| -> &'static [u8] { Vec::leak(data) };
    let left = view(leak(left));
    let black = view(leak(vec![0; width * height]));
    for roi in [false, true] {
        let params = RegisterParams { roi, hold_frames: 1, ..RegisterParams::default() };
        let mut registration = RegisterSurf::new(params);
        assert_eq!(registration.register(black, black, &Serial).state, RegistrationState::Lost);
        for shift in [0.0, 4.0, 9.0] {
            let right = view(leak(render(width, height, &truth(shift))));
            let found = registration.register(left, right, &Threads::new(2));
            assert_eq!(found.state, RegistrationState::Fresh, "{found:?}");
            let error = corner_error(&found.left_from_right, &truth(shift), width, height);
            println!("roi {roi}, shift {shift}: corners off by {error:.3} px, {found:?}");
            assert!(error < if roi { 0.3 } else { 0.15 }, "off by {error}");
            assert!(found.roi_left.x >= 170 && found.roi_right.width <= 320, "{found:?}");
        }
        let last = registration.register(left, view(leak(render(width, height, &truth(9.0)))), &Serial);
        let held = registration.register(black, left, &Serial);
        assert_eq!((held.state, held.left_from_right), (RegistrationState::Held, last.left_from_right));
        assert_eq!(held.roi_left, Rect::new(0, 0, width, height));
        let lost = registration.register(left, black, &Serial);
        assert_eq!((lost.state, lost.left_from_right), (RegistrationState::Lost, last.left_from_right));
        let jump = view(leak(render(width, height, &truth(-60.0))));
        assert_eq!(registration.register(left, jump, &Serial).state, RegistrationState::Fresh);
    }
}

#[test]
fn a_still_scene_keeps_its_homography() {
    let map = Homography::translation(90.0, 5.0);
    let left = render(400, 300, &Homography::identity());
    let params = RegisterParams { stability_px: 1.0, ..RegisterParams::default() };
    let mut registration = RegisterSurf::new(params);
    let mut first = None;
    for frame in 0..4 {
        let mut right = render(400, 300, &map);
        for (i, value) in right.iter_mut().enumerate() {
            *value = value.saturating_add((lattice(i as i64, frame, 11) * 6.0) as u8);
        }
        let found = registration.register(View::new(&left, 400, 300, 1), View::new(&right, 400, 300, 1), &Serial);
        assert_eq!(found.state, RegistrationState::Fresh);
        assert_eq!(found.kept, frame > 0);
        assert_eq!(*first.get_or_insert(found.left_from_right), found.left_from_right);
    }
}

#[test]
fn a_strip_of_a_tenth_is_registered_followed_and_found_again() {
    let (width, height) = (640, 480);
    let left = render(width, height, &Homography::identity());
    let seen = |x: f64, y: f64| render(width, height, &Homography([1.0, 0.004, x, -0.003, 1.0, y, 0.0, 0.0, 1.0]));
    let view = |data: &'_ [u8]| View::new(Vec::leak(data.to_vec()), width, height, 1);
    let black = vec![0; width * height];
    let (left, black) = (view(&left), view(&black));
    for [x, y] in [[580.0, 6.0], [5.0, 430.0], [-570.0, -4.0], [380.0, 400.0]] {
        let params = RegisterParams { hold_frames: 1, ..RegisterParams::default() };
        let mut registration = RegisterSurf::new(RegisterParams { strips: true, ..params });
        // One pair of sides is tried per frame.
        let mut state = |right: View<'_, u8>| registration.register(left, right, &Threads::new(2));
        let first = (0..SIDES_TRIED).find(|_| state(view(&seen(x, y))).state == RegistrationState::Fresh);
        assert!(first.is_some(), "{x} {y} is not found in {SIDES_TRIED} frames");
        for step in 1..4 {
            let shift = f64::from(step) * 3.0;
            let found = state(view(&seen(x - shift, y)));
            assert!(found.state == RegistrationState::Fresh && found.is_narrow, "{x} {y} {step}: {found:?}");
            let truth = Homography([1.0, 0.004, x - shift, -0.003, 1.0, y, 0.0, 0.0, 1.0]);
            let error = corner_error(&found.left_from_right, &truth, width, height);
            assert!(error < 8.0, "{x} {y} {step}: corners off by {error}");
        }
        let states = [(); 3].map(|()| state(black).state);
        assert_eq!(states, [RegistrationState::Held, RegistrationState::Lost, RegistrationState::Lost]);
        let again = [(); 2].map(|()| state(view(&seen(x - 9.0, y))).state);
        assert!(
            again.contains(&RegistrationState::Fresh),
            "{x} {y}: the overlap seen last is searched first: {again:?}"
        );
    }
}

#[test]
fn views_that_share_nothing_stay_lost() {
    let (width, height) = (640, 480);
    let left = render(width, height, &Homography::identity());
    let mut registration =
        RegisterSurf::new(RegisterParams { strips: true, min_inliers: 4, ..RegisterParams::default() });
    for frame in 0..2 * SIDES_TRIED {
        let right = render(width, height, &Homography::translation(5000.0 + 90.0 * frame as f64, 3000.0));
        let found = registration.register(
            View::new(&left, width, height, 1),
            View::new(&right, width, height, 1),
            &Threads::new(2),
        );
        assert_eq!(found.state, RegistrationState::Lost, "frame {frame}: {found:?}");
    }
}

/// Frames after which each pair of sides has been searched.
const SIDES_TRIED: usize = 12;

#[test]
fn wide_overlaps_are_registered_alike_with_strips_and_without() {
    let map = Homography([1.0, 0.02, 180.0, -0.015, 1.01, 6.0, 2.0e-5, 0.0, 1.0]);
    let (left, right) = (render(480, 360, &Homography::identity()), render(480, 360, &map));
    let run = |strips: bool| {
        let mut registration = RegisterSurf::new(RegisterParams { strips, ..RegisterParams::default() });
        [(); 3].map(|()| registration.register(View::new(&left, 480, 360, 1), View::new(&right, 480, 360, 1), &Serial))
    };
    assert_eq!(run(true), run(false));
    assert!(run(true).iter().all(|found| found.state == RegistrationState::Fresh && !found.is_narrow));
}
