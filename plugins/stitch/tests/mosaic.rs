//! The node `mosaic` while a camera moves, is lost, and restarts; and `evaluate_mosaic`.

use panoscope_node::Bgr8;
use panoscope_node::abi::{Homography, STATE_FRESH, STATE_LOST};
use panoscope_node::harness::{Harness, Setup};
use panoscope_node::random::lattice;
use panoscope_stitch::Mosaic;
use panoscope_stitch::mosaic::COLUMNS;

const SIZE: (usize, usize) = (320, 240);

/// Smooth noise of two sizes.
fn scene(x: f64, y: f64) -> u8 {
    let layer = |period: f64, seed: i64| {
        let (u, v) = (x / period, y / period);
        let (column, row) = (u.floor(), v.floor());
        let ease = |t: f64| t * t * (3.0 - 2.0 * t);
        let (fx, fy) = (ease(u - column), ease(v - row));
        let at = |dx: i64, dy: i64| lattice(column as i64 + dx + seed, row as i64 + dy - seed, 0);
        let (top, bottom) = (at(0, 0) + (at(1, 0) - at(0, 0)) * fx, at(0, 1) + (at(1, 1) - at(0, 1)) * fx);
        top + (bottom - top) * fy
    };
    (40.0 + 110.0 * layer(9.0, 0) + 100.0 * layer(31.0, 77)) as u8
}

fn view(x: i32, y: i32) -> Vec<u8> {
    let pixels = (0..SIZE.0 * SIZE.1).map(|i| (i % SIZE.0, i / SIZE.0));
    pixels.flat_map(|(u, v)| [scene(u as f64 + f64::from(x), v as f64 + f64::from(y)); 3]).collect()
}

fn node(params: &str) -> Harness<Mosaic> {
    Harness::open(Setup::new(&format!("params = {{ scale = 1, width = 640, height = 480, {params} }}"))).unwrap()
}

/// Outputs of a tick: the frame's position and a row of the table by name.
struct Tick {
    homography: Homography,
    row: Vec<f64>,
    mosaic: Vec<u8>,
}

impl Tick {
    fn of(&self, name: &str) -> f64 {
        self.row[COLUMNS.iter().position(|c| *c == name).unwrap()]
    }
}

fn tick(node: &mut Harness<Mosaic>, bgr: &[u8]) -> Tick {
    node.input_image::<Bgr8>("image", SIZE.0, SIZE.1, bgr);
    let out = node.process().unwrap();
    Tick {
        homography: out.value::<Homography>("homography").unwrap(),
        row: out.table("table").unwrap().rows().next().unwrap().to_vec(),
        mosaic: out.plane::<Bgr8>("mosaic").unwrap().data.to_vec(),
    }
}

#[test]
fn a_moving_camera_grows_the_mosaic_and_a_lost_one_does_not() {
    let mut node = node("");
    let first = tick(&mut node, &view(0, 0));
    assert_eq!(
        (first.homography.state, first.of("keyframes"), first.of("coverage_pct").round()),
        (STATE_FRESH, 1.0, 100.0)
    );
    let mut last = first;
    for step in 1..=20 {
        last = tick(&mut node, &view(step * 12, step * 5));
        assert_eq!(last.homography.state, STATE_FRESH, "{step}");
        let map = last.homography.left_from_right;
        let off = (map[2] - f64::from(step * 12)).hypot(map[5] - f64::from(step * 5));
        assert!(off < 1.0, "{step}: {map:?}");
    }
    assert!(last.of("coverage_pct") > 160.0 && last.of("keyframes") >= 3.0, "{:?}", last.row);
    let black = tick(&mut node, &vec![0; SIZE.0 * SIZE.1 * 3]);
    assert_eq!((black.homography.state, black.of("state"), black.of("lost_frames")), (STATE_LOST, 2.0, 1.0));
    assert_eq!(black.of("coverage_pct"), last.of("coverage_pct"));
    assert!(node.logs().iter().any(|line| line.message.contains("camera is lost")), "{:?}", node.logs());
    assert_eq!(node.metric("lost_frames"), Some(1.0));
    let found = tick(&mut node, &view(150, 60));
    assert_eq!((found.homography.state, found.of("relocalised")), (STATE_FRESH, 1.0));
    assert!(found.mosaic != black.mosaic);
}

#[test]
fn restart_begins_a_new_mosaic_and_a_smaller_window_says_what_it_drops() {
    let mut node = node("max_keyframes = 3, ");
    let mut last = tick(&mut node, &view(0, 0));
    for step in 1..=45 {
        last = tick(&mut node, &view(step * 14, 0));
    }
    assert!(last.of("keyframes") == 3.0 && last.of("dropped") >= 2.0, "{:?}", last.row);
    node.set_params("params = { scale = 1, width = 640, height = 480, max_keyframes = 3, restart = 1 }").unwrap();
    let anew = tick(&mut node, &view(900, 900));
    assert_eq!((anew.of("keyframes"), anew.of("dropped"), anew.of("coverage_pct").round()), (1.0, 0.0, 100.0));
    assert!(
        (anew.homography.left_from_right[2]).abs() < 1e-9,
        "the new mosaic lies in the plane of its own first frame"
    );
}

#[test]
fn frames_of_another_size_are_a_fault_that_keeps_the_mosaic() {
    let mut node = node("");
    tick(&mut node, &view(0, 0));
    node.input_image::<Bgr8>("image", 160, 120, &vec![9; 160 * 120 * 3]);
    let out = node.process().unwrap();
    let fault = out.fault().expect("another size");
    assert!(fault.contains("160x120") && fault.contains("320x240"), "{fault}");
    assert!(out.is_empty("mosaic").unwrap() && out.is_empty("homography").unwrap());
    let next = tick(&mut node, &view(6, 0));
    assert_eq!((next.homography.state, next.of("keyframes")), (STATE_FRESH, 1.0));
    assert!((next.homography.left_from_right[2] - 6.0).abs() < 0.5, "still in the plane of the first frame");
}

#[test]
fn contradictions_of_parameters_are_named() {
    let problems = |params: &str| {
        let setup = Setup::new(&format!("params = {{ {params} }}"));
        Harness::<Mosaic>::problems(&setup, &["image"]).unwrap().iter().map(|p| p.message.clone()).collect::<Vec<_>>()
    };
    let wrong = problems("min_inliers = 60, max_points = 100");
    assert!(wrong.len() == 1 && wrong[0].contains("100 keypoints"), "{wrong:?}");
    assert_eq!(problems("min_inliers = 50, max_points = 100"), Vec::<String>::new());
}
