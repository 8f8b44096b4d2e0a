//! `tool_tip` while another instrument hides a jaw of the leading one.

use panoscope_node::abi::{Calibration, Camera, Detection, Tip};
use panoscope_node::harness::{Harness, HarnessError};
use panoscope_node::{Depth, detections};
use panoscope_tools::tool_tip::ToolTip;

const WIDTH: usize = 320;
const HEIGHT: usize = 240;
const FOCAL: f64 = 375.0;
const CENTRE: [f64; 2] = [159.5, 119.5];
const TISSUE_MM: f64 = 85.0;
const DEPTH_MM: f64 = 66.0;
const JOINT: [f64; 2] = [225.0, 125.0];
/// The tip: between the ends of the jaws.
const TIP: [f64; 2] = [130.0, 115.0];

fn calibration() -> Calibration {
    let [cx, cy] = CENTRE;
    let camera =
        Camera { width: WIDTH as u32, height: HEIGHT as u32, fx: FOCAL, fy: FOCAL, cx, cy, distortion: [0.0; 14] };
    let eye = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = |tx: f64| [FOCAL, 0.0, cx, tx, 0.0, FOCAL, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    Calibration {
        left: camera,
        right: camera,
        right_from_left_rotation: eye,
        right_from_left_mm: [-15.0, 0.0, 0.0],
        rectified_from_left: eye,
        rectified_from_right: eye,
        left_projection: projection(0.0),
        right_projection: projection(-FOCAL * 15.0),
        baseline_mm: 15.0,
        rms_px: 0.0,
        is_rectified: 1,
        stated_error: 0,
    }
}

/// Position of a point on a bar, as a share of its length; `None` beside it.
fn on_bar([x, y]: [f64; 2], [ax, ay]: [f64; 2], [bx, by]: [f64; 2], width: f64) -> Option<f64> {
    let long = (bx - ax).hypot(by - ay);
    let t = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / long;
    let s = ((y - ay) * (bx - ax) - (x - ax) * (by - ay)) / long;
    ((0.0..=long).contains(&t) && s.abs() <= width / 2.0).then_some(t / long)
}

/// Ends of both jaws when they are open by `half_px` to each side of the shaft's axis.
fn ends(half_px: f64) -> [[f64; 2]; 2] {
    let axis = [TIP[0] - JOINT[0], TIP[1] - JOINT[1]];
    let long = axis[0].hypot(axis[1]);
    [-1.0, 1.0].map(|side| [TIP[0] - side * half_px * axis[1] / long, TIP[1] + side * half_px * axis[0] / long])
}

/// Shows a grasper, with a clipper 8 mm in front of it that covers `covered` (left, right, top, bottom, px).
fn show(node: &mut Harness<ToolTip>, tick: u64, half_px: f64, covered: [f64; 4]) -> Result<Option<Tip>, HarnessError> {
    let (row, len) = (WIDTH.div_ceil(8), detections::mask_len(WIDTH, HEIGHT));
    let (mut masks, mut depth) = (vec![0_u8; 2 * len], vec![TISSUE_MM as f32; WIDTH * HEIGHT]);
    let [one, two] = ends(half_px);
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let at = [x as f64, y as f64];
        let back = [2.0 * JOINT[0] - TIP[0], 2.0 * JOINT[1] - TIP[1]];
        let is_clipper = (covered[0]..covered[1]).contains(&at[0]) && (covered[2]..covered[3]).contains(&at[1]);
        // The shaft comes from nearer to the camera.
        let shaft = on_bar(at, JOINT, back, 26.0).map(|t| DEPTH_MM - 12.0 * t);
        let jaw = [one, two].into_iter().any(|end| on_bar(at, JOINT, end, 11.0).is_some());
        let (tool, z) = match () {
            () if is_clipper => (1, DEPTH_MM - 8.0),
            () if shaft.is_some() => (0, shaft.unwrap_or(DEPTH_MM)),
            () if jaw => (0, DEPTH_MM),
            () => continue,
        };
        depth[y * WIDTH + x] = z as f32;
        masks[tool * len + y * row + x / 8] |= 0x80 >> (x % 8);
    }
    let item = |class_index: u32| Detection {
        x_px: 0.0,
        y_px: 0.0,
        width_px: WIDTH as f32,
        height_px: HEIGHT as f32,
        score: 1.0,
        class_index,
        track_id: i64::from(class_index) + 1,
    };
    node.at_tick(tick, tick as i64 * 33_333_333);
    node.input_instances("instances", &[item(0), item(1)], "grasper\nclipper", (WIDTH, HEIGHT), &masks);
    node.input_image::<Depth>("depth", WIDTH, HEIGHT, &depth);
    node.input_value("calibration", calibration());
    let out = node.process()?;
    Ok(if out.is_empty("tip")? { None } else { Some(out.value("tip")?) })
}

/// An area that covers nothing of the grasper.
const BESIDE: [f64; 4] = [0.0, 60.0, 100.0, 240.0];

/// Distance of a tip from the true one, mm.
fn off_mm(tip: &Tip) -> f64 {
    let at = [(TIP[0] - CENTRE[0]) / FOCAL * DEPTH_MM, (TIP[1] - CENTRE[1]) / FOCAL * DEPTH_MM, DEPTH_MM];
    tip.xyz_mm.iter().zip(at).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

fn grasper() -> Result<Harness<ToolTip>, HarnessError> {
    Harness::from_toml("params = { class = \"grasper\" }")
}

#[test]
fn the_tip_stays_between_the_jaws_while_one_of_them_is_hidden() -> Result<(), HarnessError> {
    // The whole lower jaw, its end, the upper jaw's end, and the lower jaw with the lower side of its joint.
    let covers = [
        [60.0, 205.0, 122.0, 240.0],
        [60.0, 150.0, 125.0, 240.0],
        [60.0, 150.0, 0.0, 105.0],
        [60.0, 215.0, 124.0, 240.0],
    ];
    for covered in covers {
        let mut node = grasper()?;
        for tick in 0..5 {
            let tip = show(&mut node, tick, 34.0, BESIDE)?.expect("in plain view");
            assert!(off_mm(&tip) < 0.6, "{}: {tip:?}", off_mm(&tip));
        }
        // Meanwhile the jaws close to half their opening.
        for tick in 5..40 {
            let half_px = 34.0 - 0.5 * (tick - 5) as f64;
            let tip = show(&mut node, tick, half_px, covered)?.expect("one jaw is in view");
            let off = off_mm(&tip);
            assert!(off < 1.0, "{covered:?}, picture {tick}, {half_px} px open: {off} mm off: {tip:?}");
        }
        let tip = show(&mut node, 40, 20.0, BESIDE)?.expect("in plain view");
        assert!(off_mm(&tip) < 0.6, "{}: {tip:?}", off_mm(&tip));
    }
    Ok(())
}

#[test]
fn no_tip_is_made_up_where_both_ends_are_hidden_or_nothing_is() -> Result<(), HarnessError> {
    let mut node = grasper()?;
    for tick in 0..5 {
        show(&mut node, tick, 34.0, BESIDE)?.expect("in plain view");
    }
    assert!(show(&mut node, 5, 34.0, [60.0, 150.0, 60.0, 200.0])?.is_none(), "both ends are hidden");
    // They have closed beside the other instrument: the end is the tip.
    let closed = show(&mut node, 6, 2.0, [0.0, 110.0, 100.0, 240.0])?.expect("in plain view");
    assert!(off_mm(&closed) < 0.8, "{}: {closed:?}", off_mm(&closed));
    // An instrument of which two jaws were never seen has its tip where it ends.
    let mut node = grasper()?;
    let one = show(&mut node, 0, 34.0, [60.0, 205.0, 122.0, 240.0])?.expect("the upper jaw is in view");
    assert!(off_mm(&one) > 4.0, "{}: {one:?}", off_mm(&one));
    Ok(())
}
