//! `tool_tip` among several instruments, and `tip_track` with words that come late.

use panoscope_node::abi::{Calibration, Camera, Detection, Tip};
use panoscope_node::harness::{Harness, HarnessError};
use panoscope_node::{Depth, detections};
use panoscope_tools::tip_track::TipTrack;
use panoscope_tools::tool_tip::ToolTip;

const WIDTH: usize = 160;
const HEIGHT: usize = 120;

fn calibration() -> Calibration {
    let camera = Camera {
        width: WIDTH as u32,
        height: HEIGHT as u32,
        fx: 187.5,
        fy: 187.5,
        cx: 79.5,
        cy: 59.5,
        distortion: [0.0; 14],
    };
    let eye = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = |tx: f64| [187.5, 0.0, 79.5, tx, 0.0, 187.5, 59.5, 0.0, 0.0, 0.0, 1.0, 0.0];
    Calibration {
        left: camera,
        right: camera,
        right_from_left_rotation: eye,
        right_from_left_mm: [-15.0, 0.0, 0.0],
        rectified_from_left: eye,
        rectified_from_right: eye,
        left_projection: projection(0.0),
        right_projection: projection(-187.5 * 15.0),
        baseline_mm: 15.0,
        rms_px: 0.0,
        is_rectified: 1,
        reserved: 0,
    }
}

/// A scene of bars, the first one followed: x from, x to, y from, y to, depth. Answers the tip that is found.
fn tip_among(bars: &[([usize; 4], f32)]) -> Result<Option<Tip>, HarnessError> {
    let (row, len) = (WIDTH.div_ceil(8), detections::mask_len(WIDTH, HEIGHT));
    let mut depth = vec![80.0_f32; WIDTH * HEIGHT];
    let mut owner = vec![usize::MAX; WIDTH * HEIGHT];
    for (index, ([x0, x1, y0, y1], z)) in bars.iter().enumerate() {
        for place in (*y0..*y1).flat_map(|y| (*x0..*x1).map(move |x| y * WIDTH + x)) {
            if *z < depth[place] {
                (depth[place], owner[place]) = (*z, index);
            }
        }
    }
    let mut masks = vec![0_u8; bars.len() * len];
    for (place, owner) in owner.iter().enumerate().filter(|(_, owner)| **owner < bars.len()) {
        let (x, y) = (place % WIDTH, place / WIDTH);
        masks[owner * len + y * row + x / 8] |= 0x80 >> (x % 8);
    }
    let items: Vec<Detection> = (0..bars.len())
        .map(|index| {
            let [x0, x1, y0, y1] = bars[index].0.map(|v| v as f32);
            let (class_index, track_id) = (index as u32, index as i64);
            Detection { x_px: x0, y_px: y0, width_px: x1 - x0, height_px: y1 - y0, score: 1.0, class_index, track_id }
        })
        .collect();
    let mut node = Harness::<ToolTip>::from_toml("params = { class = \"hook\" }")?;
    node.input_instances("instances", &items, "hook\ngrasper", (WIDTH, HEIGHT), &masks);
    node.input_image::<Depth>("depth", WIDTH, HEIGHT, &depth);
    node.input_value("calibration", calibration());
    let out = node.process()?;
    Ok(if out.is_empty("tip")? { None } else { Some(out.value("tip")?) })
}

#[test]
fn a_tip_behind_another_instrument_is_none_and_one_before_it_is_its_own() -> Result<(), HarnessError> {
    let hook = ([60, 160, 56, 64], 60.0);
    let alone = tip_among(&[hook])?.expect("in plain view");
    assert!((alone.u_px - 60.0).abs() < 2.5 && (alone.xyz_mm[2] - 60.0).abs() < 0.1, "{alone:?}");
    // The grasper, 8 mm nearer, crosses its end: what is left of the hook seems to end at x = 76.
    assert!(tip_among(&[hook, ([50, 76, 0, 120], 52.0)])?.is_none());
    // Farther away it hides nothing, and lends the tip no depth.
    let behind = tip_among(&[hook, ([50, 76, 0, 120], 70.0)])?.expect("before the other");
    assert!((behind.u_px - alone.u_px).abs() < 0.1 && (behind.xyz_mm[2] - 60.0).abs() < 0.1, "{behind:?}");
    // It passes close by, nearer: the tip is in view and keeps its own depth.
    let beside = tip_among(&[hook, ([0, 55, 0, 120], 52.0)])?.expect("beside the other");
    assert!((beside.xyz_mm[2] - 60.0).abs() < 0.1, "{beside:?}");
    // It crosses the shaft only.
    let across = tip_among(&[hook, ([100, 120, 0, 120], 52.0)])?.expect("the end is in view");
    assert!((across.u_px - alone.u_px).abs() < 2.0, "{across:?}");
    Ok(())
}

#[test]
fn a_tip_counts_once_and_loses_score_with_its_age() -> Result<(), HarnessError> {
    let mut node = Harness::<TipTrack>::from_toml("")?;
    let tip = |x_mm: f64| Tip {
        u_px: 80.0,
        v_px: 60.0,
        xyz_mm: [x_mm, 0.0, 65.0],
        score: 0.9,
        class_index: 0,
        xyz_valid: 1,
        track_id: -1,
    };
    let mut last = 0.0;
    for tick in 0..40_u64 {
        node.at_tick(tick, tick as i64 * 33_333_333);
        let x_mm = 0.5 * tick as f64;
        if tick < 30 {
            node.input_value("tip", tip(x_mm));
        } else {
            node.input_empty("tip");
        }
        node.input_value("calibration", calibration());
        let out = node.process()?;
        if tick < 30 {
            let seen: Tip = out.value("tip")?;
            assert!((seen.score - 0.9).abs() < 1e-9);
            assert!(tick < 10 || (seen.xyz_mm[0] - x_mm).abs() < 0.2, "tick {tick}: {seen:?}");
            last = seen.score;
        } else if tick < 38 {
            let seen: Tip = out.value("tip")?;
            assert!(seen.score < last, "tick {tick}: {} after {last}", seen.score);
            assert!((seen.xyz_mm[0] - x_mm).abs() < 0.6, "tick {tick}: {seen:?}");
            last = seen.score;
        } else if tick > 38 {
            assert!(out.is_empty("tip")?, "tick {tick}");
        }
    }
    Ok(())
}
