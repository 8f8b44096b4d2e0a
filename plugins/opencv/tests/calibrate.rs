//! `calibrate_stereo` on drawn chessboards whose cameras are known.

use panoscope_data::calibration::{ViewState, equidistant_of, packet};
use panoscope_imaging::stereo::Equidistant;
use panoscope_node::abi::Calibration;
use panoscope_node::harness::{Harness, Outputs, Setup};
use panoscope_node::{Bgr8, Gray8};
use panoscope_opencv::CalibrateStereo;

const SIZE: (usize, usize) = (400, 300);
const FOCAL_PX: f64 = 420.0;
const BASELINE_MM: f64 = 20.0;
const SQUARE_MM: f64 = 10.0;

/// A board's pose: rotation about x, y, z in radians, and its centre in the left camera's frame, mm.
type Pose = ([f64; 3], [f64; 3]);

const POSES: [Pose; 8] = [
    ([0.0, 0.0, 0.0], [8.0, 0.0, 230.0]),
    ([0.5, 0.1, 0.1], [0.0, 10.0, 240.0]),
    ([-0.5, 0.1, -0.2], [25.0, -8.0, 250.0]),
    ([0.1, 0.5, 0.2], [-5.0, -12.0, 230.0]),
    ([0.0, -0.5, 0.3], [20.0, 12.0, 245.0]),
    ([0.35, 0.35, -0.3], [10.0, 0.0, 260.0]),
    ([-0.4, -0.3, 0.15], [0.0, 5.0, 220.0]),
    ([0.3, -0.4, 0.0], [15.0, -10.0, 250.0]),
];

fn rotation([a, b, c]: [f64; 3]) -> [[f64; 3]; 3] {
    let ((sa, ca), (sb, cb), (sc, cc)) = (a.sin_cos(), b.sin_cos(), c.sin_cos());
    [
        [cb * cc, sa * sb * cc - ca * sc, ca * sb * cc + sa * sc],
        [cb * sc, sa * sb * sc + ca * cc, ca * sb * sc - sa * cc],
        [-sb, sa * cb, ca * cb],
    ]
}

/// The board of 7 x 5 squares (6 x 4 corners) as a camera at `x_mm` sees it, each pixel the mean of 16 rays.
fn draw(pose: Pose, x_mm: f64) -> Vec<u8> {
    draw_through(&|u, v| [(u - 199.5) / FOCAL_PX, (v - 149.5) / FOCAL_PX], pose, x_mm)
}

/// As [`draw`]; `ray` gives x and y, at depth 1, of the ray of a pixel.
fn draw_through(ray: &dyn Fn(f64, f64) -> [f64; 2], (turn, middle): Pose, x_mm: f64) -> Vec<u8> {
    let r = rotation(turn);
    let normal = [r[0][2], r[1][2], r[2][2]];
    let place = [middle[0] - x_mm, middle[1], middle[2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let shade = |u: f64, v: f64| -> f64 {
        let [x, y] = ray(u, v);
        let ray = [x, y, 1.0];
        let t = dot(normal, place) / dot(normal, ray);
        let hit: [f64; 3] = std::array::from_fn(|i| ray[i] * t - place[i]);
        let column = |k: usize| dot([r[0][k], r[1][k], r[2][k]], hit) / SQUARE_MM;
        let (x, y) = (column(0) + 3.5, column(1) + 2.5);
        if !(-0.8..=7.8).contains(&x) || !(-0.8..=5.8).contains(&y) {
            return 90.0;
        }
        let inside = (0.0..7.0).contains(&x) && (0.0..5.0).contains(&y);
        if inside && (x.floor() + y.floor()) as i64 % 2 == 0 { 25.0 } else { 225.0 }
    };
    let mut picture = Vec::with_capacity(SIZE.0 * SIZE.1);
    for v in 0..SIZE.1 {
        for u in 0..SIZE.0 {
            let sum: f64 = (0..16)
                .map(|k| {
                    let offset = |k: usize| (k as f64 - 1.5) / 4.0;
                    shade(u as f64 + offset(k % 4), v as f64 + offset(k / 4))
                })
                .sum();
            picture.push((sum / 16.0).round() as u8);
        }
    }
    picture
}

fn pair(pose: Pose) -> [Vec<u8>; 2] {
    [draw(pose, 0.0), draw(pose, BASELINE_MM)]
}

fn open(params: &str) -> Harness<CalibrateStereo> {
    Harness::open(Setup::new(&format!("params = {{ board = \"chessboard:6x4:10mm\", {params} }}"))).unwrap()
}

fn show(node: &mut Harness<CalibrateStereo>, views: [&[u8]; 2]) -> Outputs {
    let (width, height) = SIZE;
    node.input_image::<Gray8>("left", width, height, views[0]).input_image::<Gray8>("right", width, height, views[1]);
    node.process().unwrap()
}

fn states(out: &Outputs) -> Vec<ViewState> {
    out.table("table").unwrap().rows().map(|row| ViewState::of_code(row[1]).unwrap()).collect()
}

#[test]
fn exchanged_views_are_named() {
    let mut node = open("model = \"radial\", solve_at = 8");
    for [left, right] in POSES.map(pair) {
        assert!(show(&mut node, [&right, &left]).is_empty("calibration").unwrap());
    }
    let logs = node.logs();
    let is_named =
        |text: &str| text.contains("8 views give no calibration") && text.contains("left and right look exchanged");
    assert!(logs.iter().any(|line| is_named(&line.message)), "{logs:?}");
}

#[test]
fn known_cameras_are_found() {
    let mut node = open("model = \"radial\", solve_at = 8");
    let views = POSES.map(pair);
    for (index, [left, right]) in views.iter().enumerate() {
        let out = show(&mut node, [left, right]);
        assert_eq!(out.is_empty("calibration").unwrap(), index < 7);
        if index < 7 {
            continue;
        }
        let found: Calibration = out.value("calibration").unwrap();
        assert!((found.left.fx / FOCAL_PX - 1.0).abs() < 5e-3, "{found:?}");
        assert!((found.right.fy / FOCAL_PX - 1.0).abs() < 5e-3, "{found:?}");
        assert!((found.baseline_mm - BASELINE_MM).abs() < 0.1, "{}", found.baseline_mm);
        assert!(found.right_from_left_mm[0] < 0.0 && found.rms_px < 0.1, "{}", found.rms_px);
        assert!(states(&out).iter().all(|state| *state == ViewState::Used));
        for row in out.table("table").unwrap().rows() {
            // Points, errors left, right and of rows.
            assert!(row[2] == 24.0 && row[3..6].iter().all(|error| *error < 0.15), "{row:?}");
        }
        for port in ["image", "coverage", "epipolar"] {
            let picture = out.plane::<Bgr8>(port).unwrap();
            assert_eq!((picture.width, picture.height), (2 * SIZE.0, SIZE.1), "{port}");
        }
        // Cells without points are red, those with points green.
        let coverage = out.plane::<Bgr8>("coverage").unwrap();
        let (corner, middle) = (&coverage.row(295)[3 * 395..3 * 395 + 3], &coverage.row(158)[3 * 210..3 * 210 + 3]);
        assert!(corner[2] > corner[1] && middle[1] > middle[2], "{corner:?} {middle:?}");
    }
    assert!(node.metric("covered_left").is_some_and(|share| (0.05..1.0).contains(&share)));
}

#[test]
fn boards_in_the_dark_are_found_where_the_samples_detector_finds_none() {
    // As noisy as a camera at its highest gain.
    let noisy = |picture: Vec<u8>, seed: u64| -> Vec<u8> {
        let noise = |i: usize| 300.0 * (panoscope_node::random::lattice(i as i64, 1, seed) - 0.5);
        picture.iter().enumerate().map(|(i, value)| (f64::from(*value) + noise(i)).clamp(0.0, 255.0) as u8).collect()
    };
    let mut seed = 0;
    let mut views = POSES[..5].iter().map(|pose| {
        pair(*pose).map(|view| {
            seed += 1;
            noisy(view, seed)
        })
    });
    let mut node = open("model = \"radial\", min_views = 4, solve_at = 5");
    let first = views.next().expect("a view");
    let mut out = show(&mut node, [&first[0], &first[1]]);
    for [left, right] in views {
        out = show(&mut node, [&left, &right]);
    }
    let used = states(&out).iter().filter(|state| **state == ViewState::Used).count();
    assert!(used >= 4, "{:?}", states(&out));
    let found: Calibration = out.value("calibration").unwrap();
    assert!((found.baseline_mm - BASELINE_MM).abs() < 2.0 && found.rms_px < 1.0, "{found:?}");
    // The detector of the sample takes its time: one view is enough.
    let out = show(&mut open("model = \"radial\", method = \"sample\""), [&first[0], &first[1]]);
    assert_ne!(states(&out), [ViewState::Used]);
}

/// The view with a reflection of light on it, which covers a few corners.
fn glare(mut picture: Vec<u8>, [x, y]: [f64; 2]) -> Vec<u8> {
    for (index, value) in picture.iter_mut().enumerate() {
        let off = ((index % SIZE.0) as f64 - x).hypot((index / SIZE.0) as f64 - y);
        *value = (f64::from(*value) + 500.0 * (-(off / 14.0).powi(2)).exp()).min(255.0) as u8;
    }
    picture
}

#[test]
fn boards_with_covered_corners_are_used() {
    const COVERED: [usize; 5] = [0, 1, 3, 6, 7];
    let mut node = open("model = \"radial\", solve_at = 13");
    for [left, right] in POSES.map(pair) {
        show(&mut node, [&left, &right]);
    }
    let mut out = None;
    for pose in COVERED.map(|index| POSES[index]) {
        let [left, right] = pair(pose);
        let at =
            |x_mm: f64| [199.5 + FOCAL_PX * (pose.1[0] - x_mm) / pose.1[2], 149.5 + FOCAL_PX * pose.1[1] / pose.1[2]];
        out = Some(show(&mut node, [&glare(left, at(0.0)), &glare(right, at(BASELINE_MM))]));
    }
    let out = out.expect("views");
    assert!(states(&out).iter().all(|state| *state == ViewState::Used), "{:?}", states(&out));
    let found: Calibration = out.value("calibration").unwrap();
    assert!((found.left.fx / FOCAL_PX - 1.0).abs() < 0.01 && found.rms_px < 0.2, "{found:?}");
    assert!((found.baseline_mm - BASELINE_MM).abs() < 0.2, "{}", found.baseline_mm);
    let rows: Vec<Vec<f64>> = out.table("table").unwrap().rows().map(<[f64]>::to_vec).collect();
    assert!(rows[8..].iter().all(|row| row[2] >= 8.0), "{rows:?}");
    assert!(rows[8..].iter().filter(|row| row[2] < 24.0).count() >= 3, "{rows:?}");
}

#[test]
fn a_part_of_the_board_is_used_where_other_views_place_it() {
    // The board reaches out of the left picture.
    let cut = pair(([0.2, 0.15, 0.05], [97.0, 5.0, 232.0]));
    let mut node = open("model = \"radial\", solve_at = 9");
    let mut out = show(&mut node, [&cut[0], &cut[1]]);
    assert_eq!(states(&out), [ViewState::PartlySeen]);
    for [left, right] in POSES.map(pair) {
        out = show(&mut node, [&left, &right]);
    }
    assert!(states(&out).iter().all(|state| *state == ViewState::Used), "{:?} {:?}", states(&out), node.logs());
    let rows: Vec<Vec<f64>> = out.table("table").unwrap().rows().map(<[f64]>::to_vec).collect();
    assert!((12.0..24.0).contains(&rows[0][2]) && rows[0][3..6].iter().all(|error| *error < 0.3), "{:?}", rows[0]);
    let found: Calibration = out.value("calibration").unwrap();
    assert!((found.baseline_mm - BASELINE_MM).abs() < 0.1, "{}", found.baseline_mm);
    // Alone it is nobody's.
    let mut node = open("model = \"radial\", solve_at = 5");
    for _ in 0..5 {
        out = show(&mut node, [&cut[0], &cut[1]]);
    }
    assert!(out.is_empty("calibration").unwrap() && states(&out).iter().all(|state| *state == ViewState::PartlySeen));
}

#[test]
fn patterns_that_are_no_board_are_not_used() {
    let picture = |shade: &dyn Fn(usize, usize) -> f64| -> Vec<u8> {
        (0..SIZE.0 * SIZE.1).map(|index| shade(index % SIZE.0, index / SIZE.0) as u8).collect()
    };
    let random = |x: usize, y: usize| panoscope_node::random::lattice(x as i64, y as i64, 4);
    let patterns: [(&str, Vec<u8>); 5] = [
        ("noise", picture(&|x, y| 255.0 * random(x / 3, y / 3))),
        ("tiles", picture(&|x, y| if x % 22 < 2 || y % 22 < 2 { 60.0 } else { 190.0 })),
        ("shades", picture(&|x, y| 250.0 * random(x / 20, y / 20))),
        ("keys", picture(&|x, y| if (x + 9 * (y / 24)) % 24 < 18 && y % 24 < 18 { 50.0 } else { 150.0 })),
        // A larger chessboard, of which this one could be anything.
        ("floor", picture(&|x, y| if (x / 18 + y / 18) % 2 == 0 { 50.0 } else { 200.0 })),
    ];
    for (name, picture) in patterns {
        let mut node = open("model = \"radial\"");
        assert_eq!(states(&show(&mut node, [&picture, &picture])), [ViewState::NoBoard], "{name}");
    }
}

#[test]
fn a_known_pair_of_fisheyes_is_found() {
    // A view of 105 degrees across.
    const FISHEYE_PX: f64 = 220.0;
    let k = [-0.05, 0.01, -0.002, 0.0];
    let lens = Equidistant::new(k);
    let ray = |u: f64, v: f64| -> [f64; 2] {
        lens.undistort((u - 199.5) / FISHEYE_PX, (v - 149.5) / FISHEYE_PX).expect("a ray").into()
    };
    let places = [[10.0, 0.0, 60.0], [-25.0, 0.0, 85.0], [45.0, 0.0, 85.0], [10.0, -18.0, 80.0], [10.0, 18.0, 80.0]];
    let more = [[-22.0, -16.0, 90.0], [42.0, -16.0, 90.0], [-22.0, 16.0, 90.0], [42.0, 16.0, 90.0], [10.0, 5.0, 75.0]];
    let turns = POSES.map(|(turn, _)| turn);
    let poses: Vec<Pose> =
        places.into_iter().chain(more).enumerate().map(|(i, place)| (turns[i % turns.len()], place)).collect();
    let mut node = open("model = \"equidistant\", solve_at = 10");
    for (index, pose) in poses.iter().enumerate() {
        let views = [0.0, BASELINE_MM].map(|x_mm| draw_through(&ray, *pose, x_mm));
        let out = show(&mut node, [&views[0], &views[1]]);
        if index + 1 < poses.len() {
            continue;
        }
        assert!(!out.is_empty("calibration").unwrap(), "{:?} {:?}", states(&out), node.logs());
        let found: Calibration = out.value("calibration").unwrap();
        assert!(found.rms_px < 0.15 && (found.baseline_mm - BASELINE_MM).abs() < 0.1, "{found:?}");
        for camera in [&found.left, &found.right] {
            assert!(equidistant_of(camera).is_some());
            assert!(
                (camera.fx / FISHEYE_PX - 1.0).abs() < 0.01 && (camera.fy / FISHEYE_PX - 1.0).abs() < 0.01,
                "{found:?}"
            );
            // Where the rays go, which is what counts: within half a px up to 45 degrees from the axis.
            let model = packet::camera(camera).unwrap();
            for (u, v) in [(200.0, 150.0), (60.0, 150.0), (330.0, 70.0), (200.0, 250.0), (90.0, 60.0)] {
                let [x, y] = ray(u, v);
                let (a, b) = model.project(x, y);
                assert!((a - u).hypot(b - v) < 0.5, "{u} {v}: {a} {b}");
            }
        }
    }
}

#[test]
fn bad_views_are_left_out_and_named() {
    let mut node = open("model = \"radial\", solve_at = 13, min_move = 0.005");
    let views = POSES.map(pair);
    let gray = vec![120; SIZE.0 * SIZE.1];
    for [left, right] in &views {
        show(&mut node, [left, right]);
    }
    show(&mut node, [&gray, &views[0][1]]);
    show(&mut node, [&views[0][0], &gray]);
    show(&mut node, [&gray, &gray]);
    show(&mut node, [&views[2][0], &views[2][1]]);
    // The right view is of another instant: the board had moved. Both pictures are good ones.
    let late = draw(([0.2, 0.2, -0.05], [6.0, -2.0, 235.0]), BASELINE_MM);
    let left = draw(([0.2, 0.2, 0.0], [0.0, 2.0, 235.0]), 0.0);
    let out = show(&mut node, [&left, &late]);
    let states = states(&out);
    assert!(states[..8].iter().all(|state| *state == ViewState::Used), "{states:?}");
    use ViewState::*;
    assert_eq!(states[8..], [NoBoardLeft, NoBoardRight, NoBoard, Alike, LargeError]);
    let found: Calibration = out.value("calibration").unwrap();
    assert!((found.left.fx / FOCAL_PX - 1.0).abs() < 5e-3, "{}", found.left.fx);
    let said = |words: &str| node.logs().iter().any(|line| line.message.contains(words));
    assert!(said("view 8 is left out: no board was found in the left view"));
    assert!(said("view 12 is left out: its error of"), "{:?}", node.logs());
}

#[test]
fn what_cannot_be_is_said() {
    // Left and right in each other's place.
    let mut node = open("solve_at = 8");
    let views = POSES.map(pair);
    let mut out = None;
    for [left, right] in &views {
        out = Some(show(&mut node, [right, left]));
    }
    assert!(out.unwrap().is_empty("calibration").unwrap());
    assert!(node.logs().iter().any(|line| line.message.contains("left and right look exchanged")), "{:?}", node.logs());
    // Too few views: three of the five show no board.
    let mut node = open("solve_at = 5");
    let gray = vec![120; SIZE.0 * SIZE.1];
    for index in 0..5 {
        let [left, right] = if index < 2 { [&views[index][0], &views[index][1]] } else { [&gray, &gray] };
        assert!(show(&mut node, [left, right]).is_empty("calibration").unwrap());
    }
    assert!(node.logs().iter().any(|line| line.message.contains("2 of 5 views are in use, 5 are needed")));
    // A view of another size.
    let small = vec![0; 64 * 48];
    node.input_image::<Gray8>("left", 64, 48, &small).input_image::<Gray8>("right", 64, 48, &small);
    let out = node.process().unwrap();
    assert_eq!(states(&out)[5], ViewState::OtherSize);
    let early = Harness::<CalibrateStereo>::from_toml("params = { solve_at = 2 }").err().unwrap().to_string();
    assert!(early.contains("before 5 views"), "{early}");
    let refused = Harness::<CalibrateStereo>::from_toml("params = { board = \"chess\" }").err().unwrap().to_string();
    assert!(refused.contains("names no board"), "{refused}");
}
