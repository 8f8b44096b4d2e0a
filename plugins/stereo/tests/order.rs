//! Exchanged views of a right calibration: they are withheld and named, whatever the geometry of the cameras.

use crate::common::{bgr, texture};
use panoscope_node::Bgr8;
use panoscope_node::abi::{Calibration, Camera};
use panoscope_node::harness::{Harness, HarnessError, Level, Outputs};
use panoscope_stereo::Rectify;

type TestResult = Result<(), HarnessError>;

const SIZE: (usize, usize) = (320, 240);
const FOCAL: f64 = 300.0;
const BASELINE: f64 = 15.0;

/// A rig in front of a slanted textured plane.
#[derive(Clone, Copy)]
struct Rig {
    /// By which each camera is turned towards the other, rad.
    toe_in: f64,
    /// Columns and rows by which the principal points are apart: those of the left camera less those of the right one, px.
    principal: [f64; 2],
    /// Distance of the plane, mm.
    depth_mm: f64,
    /// Where the rig stands above its plane's texture, mm.
    height_mm: f64,
}

impl Rig {
    fn camera(&self, side: f64) -> Camera {
        let (width, height) = (SIZE.0 as u32, SIZE.1 as u32);
        let [cx, cy] = self.principal.map(|px| 0.5 * side * px);
        let (cx, cy) = (0.5 * SIZE.0 as f64 + cx, 0.5 * SIZE.1 as f64 + cy);
        Camera { width, height, fx: FOCAL, fy: FOCAL, cx, cy, distortion: [0.0; 14] }
    }

    /// What the camera at column `x_mm` sees, whose axis is turned to the right by `angle`.
    fn view(&self, camera: &Camera, x_mm: f64, angle: f64) -> Vec<u8> {
        let (sin, cos) = angle.sin_cos();
        let pixel = |index: usize| {
            let (u, v) = ((index % SIZE.0) as f64, (index / SIZE.0) as f64);
            let (x, y) = ((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
            let ray = [cos * x + sin, y, cos - sin * x];
            // The plane z = depth + x / 5.
            let along = (self.depth_mm + 0.2 * x_mm) / (ray[2] - 0.2 * ray[0]);
            let per_mm = FOCAL / self.depth_mm;
            texture((x_mm + along * ray[0]) * per_mm + 1000.0, (self.height_mm + along * ray[1]) * per_mm + 1000.0)
                as u8
        };
        (0..SIZE.0 * SIZE.1).map(pixel).collect()
    }

    fn left_view(&self) -> Vec<u8> {
        self.view(&self.camera(1.0), 0.0, self.toe_in)
    }

    fn right_view(&self) -> Vec<u8> {
        self.view(&self.camera(-1.0), BASELINE, -self.toe_in)
    }

    fn views(&self) -> [Vec<u8>; 2] {
        [self.left_view(), self.right_view()]
    }

    fn calibration(&self) -> Calibration {
        let (sin, cos) = (2.0 * self.toe_in).sin_cos();
        Calibration {
            left: self.camera(1.0),
            right: self.camera(-1.0),
            right_from_left_rotation: [cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos],
            right_from_left_mm: [-BASELINE * self.toe_in.cos(), 0.0, BASELINE * self.toe_in.sin()],
            rectified_from_left: [0.0; 9],
            rectified_from_right: [0.0; 9],
            left_projection: [0.0; 12],
            right_projection: [0.0; 12],
            baseline_mm: BASELINE,
            rms_px: 0.1,
            is_rectified: 0,
            stated_error: 0,
        }
    }
}

/// Level cameras; cameras turned towards each other; one principal point beside the other, as in a robot's scope.
const RIGS: [Rig; 3] = [
    Rig { toe_in: 0.0, principal: [0.0, 0.0], depth_mm: 100.0, height_mm: 0.0 },
    Rig { toe_in: 0.06, principal: [0.0, 0.0], depth_mm: 110.0, height_mm: 0.0 },
    Rig { toe_in: 0.0, principal: [-25.0, 9.0], depth_mm: 120.0, height_mm: 0.0 },
];

fn run(
    node: &mut Harness<Rectify>,
    [left, right]: [&Vec<u8>; 2],
    cameras: Calibration,
) -> Result<Outputs, HarnessError> {
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &bgr(left))
        .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &bgr(right))
        .input_value("calibration", cameras)
        .process()
}

#[test]
fn exchanged_views_are_withheld_and_named_at_once() -> TestResult {
    for (index, rig) in RIGS.iter().enumerate() {
        let [left, right] = rig.views();
        let mut node = Harness::<Rectify>::from_toml("")?;
        for tick in 0..8 {
            let out = run(&mut node, [&right, &left], rig.calibration())?;
            assert!(node.metric("views_swapped") != Some(0.0), "rig {index}, tick {tick}: called in order");
            for port in ["left", "right", "calibration", "mask_left"] {
                assert!(out.is_empty(port)?, "rig {index}, tick {tick}: `{port}` of exchanged views is handed on");
            }
        }
        let named = |line: &&panoscope_node::harness::LogLine| {
            line.level == Level::Warn && line.message.contains("left and right are swapped")
        };
        assert_eq!(node.logs().iter().filter(named).count(), 1, "{:?}", node.logs());
        assert_eq!(node.metric("views_swapped"), Some(1.0));
        // Dark views decide nothing, those in order do.
        let dark = vec![3; SIZE.0 * SIZE.1];
        for _ in 0..70 {
            assert!(run(&mut node, [&dark, &dark], rig.calibration())?.is_empty("left")?);
        }
        let mut ticks = 0;
        while run(&mut node, [&left, &right], rig.calibration())?.is_empty("calibration")? {
            ticks += 1;
            assert!(ticks < 70, "rig {index}: {:?}", node.logs());
        }
        assert_eq!(node.metric("views_swapped"), Some(0.0));
    }
    Ok(())
}

#[test]
fn views_in_order_are_handed_on_also_when_the_calibration_has_drifted() -> TestResult {
    for (index, rig) in RIGS.iter().enumerate() {
        for drift_px in [0.0, 3.0, -5.0] {
            let [left, right] = rig.views();
            let mut cameras = rig.calibration();
            cameras.right.cy += drift_px;
            let mut node = Harness::<Rectify>::from_toml("")?;
            for tick in 0..140 {
                let out = run(&mut node, [&left, &right], cameras)?;
                assert!(!out.is_empty("calibration")?, "rig {index}, {drift_px} px, tick {tick}: {:?}", node.logs());
            }
            let swapped = node.metric("views_swapped");
            // Few features fit a calibration that is off by many rows.
            assert!(swapped == Some(0.0) || drift_px != 0.0 && swapped.is_none(), "{drift_px} px: {swapped:?}");
            assert!(node.logs().is_empty(), "{:?}", node.logs());
        }
    }
    Ok(())
}

#[test]
fn the_same_and_unlike_views_are_not_called_swapped() -> TestResult {
    let rig = RIGS[1];
    let [left, right] = rig.views();
    let flat = vec![90; SIZE.0 * SIZE.1];
    // Another part of the texture.
    let other = Rig { depth_mm: 400.0, ..rig }.views();
    for views in [[&left, &left], [&flat, &flat], [&left, &other[1]], [&other[0], &right]] {
        let mut node = Harness::<Rectify>::from_toml("")?;
        for _ in 0..8 {
            run(&mut node, views, rig.calibration())?;
        }
        let swapped = node.metric("views_swapped");
        assert!(swapped != Some(1.0), "{:?}", node.logs());
        let is_named =
            node.logs().iter().any(|line| line.level == Level::Warn && line.message.contains("are the same image"));
        assert_eq!(is_named, views[0] == views[1] && *views[0] != flat, "{:?}", node.logs());
        // Nor in order: who knew them to be swapped before a start still does.
        assert!(swapped.is_none() || !views.contains(&&flat), "{:?}", node.logs());
    }
    Ok(())
}

#[test]
fn exchanged_views_that_another_program_rectified_are_withheld_too() -> TestResult {
    let rig = RIGS[0];
    let [left, right] = rig.views();
    for (toml, is_rectified) in [("params = { bypass = true }", 0), ("", 1)] {
        let mut node = Harness::<Rectify>::from_toml(toml)?;
        let mut cameras = crate::common::rectified(FOCAL, BASELINE);
        for camera in [&mut cameras.left, &mut cameras.right] {
            *camera = rig.camera(0.0);
        }
        cameras.is_rectified = is_rectified;
        (cameras.left_projection[6], cameras.right_projection[6]) = (120.0, 120.0);
        assert!(!run(&mut node, [&left, &right], cameras)?.is_empty("left")?);
        let mut ticks = 0;
        while !run(&mut node, [&right, &left], cameras)?.is_empty("left")? {
            ticks += 1;
            assert!(ticks < 70, "{:?}", node.logs());
        }
        let out = run(&mut node, [&right, &left], cameras)?;
        assert!(out.is_empty("calibration")? && node.metric("views_swapped") == Some(1.0), "{:?}", node.logs());
    }
    Ok(())
}

/// Ticks of views of a rig that moves up and down, the right one `frames` behind, until the first without calibration; and what is said then.
fn ticks_until_withheld(rig: Rig, frames: i32, drift_px: f64) -> Result<(Option<usize>, String), HarnessError> {
    const TICKS: usize = 220;
    let mut cameras = rig.calibration();
    cameras.right.cy += drift_px;
    let at = |tick: i32| Rig {
        height_mm: 5.0 * (f64::from(tick) / 13.0).sin() + 3.0 * (f64::from(tick) / 7.7).sin(),
        ..rig
    };
    let mut node = Harness::<Rectify>::from_toml("")?;
    for tick in 0..TICKS {
        let now = tick as i32;
        let (left, right) = (at(now).left_view(), at(now - frames).right_view());
        let out = run(&mut node, [&left, &right], cameras)?;
        if out.is_empty("calibration")? {
            assert!(!out.is_empty("left")?, "the views themselves are right");
            return Ok((Some(tick), format!("{:?}", node.logs())));
        }
    }
    Ok((None, format!("{:?}", node.logs())))
}

#[test]
fn views_of_two_instants_lose_their_calibration() -> TestResult {
    for (frames, words) in [(1, "the right one is"), (2, "the right one is"), (-1, "the left one is")] {
        let (tick, said) = ticks_until_withheld(RIGS[1], frames, 0.0)?;
        assert!(
            tick.is_some() && said.contains("not of one instant") && said.contains(words),
            "{frames}: {tick:?} {said}"
        );
        println!("{frames} frames: withheld at tick {tick:?}");
    }
    Ok(())
}

#[test]
fn views_of_one_instant_keep_their_calibration_while_the_scope_moves() -> TestResult {
    for (rig, drift_px) in [(RIGS[1], 0.0), (RIGS[2], 3.0)] {
        assert_eq!(ticks_until_withheld(rig, 0, drift_px)?, (None, "[]".to_owned()));
    }
    Ok(())
}
