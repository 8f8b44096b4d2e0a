//! `tool_tip` among several instruments, and `tip_track` with detections that come late.

use panoscope_node::abi::{Calibration, Camera, Detection, Tip};
use panoscope_node::harness::{Harness, HarnessError};
use panoscope_node::{Bgr8, Depth, Disparity, detections};
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
        stated_error: 0,
    }
}

/// A scene of bars, the first one followed: x from, x to, y from, y to, depth. Returns the tip that is found.
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

/// Red tissue on a slope with darker vessels and a few white reflections, and in front of it a gray instrument with a black shaft from the right
/// border to a tip. Returns the image, bgr8, and the depth.
fn instrument(tip: [f64; 2]) -> (Vec<u8>, Vec<f32>) {
    let mut picture = vec![0; WIDTH * HEIGHT * 3];
    let mut depth = vec![0.0; WIDTH * HEIGHT];
    let from = [170.0, 20.0];
    let long = f64::hypot(from[0] - tip[0], from[1] - tip[1]);
    let axis = [(from[0] - tip[0]) / long, (from[1] - tip[1]) / long];
    for place in 0..WIDTH * HEIGHT {
        let (x, y) = ((place % WIDTH) as f64, (place / WIDTH) as f64);
        let (dx, dy) = (x - tip[0], y - tip[1]);
        let (along, aside) = (dx * axis[0] + dy * axis[1], dy * axis[0] - dx * axis[1]);
        let grain = ((place * 7919) % 17) as f64;
        let is_tool = along >= 0.0 && aside.abs() <= 5.0;
        let [b, g, r] = match () {
            () if is_tool && along < 30.0 => [120.0 + grain, 122.0 + grain, 126.0 + grain],
            () if is_tool => [22.0 + grain, 20.0 + grain, 24.0 + grain],
            () if (x - 90.0).hypot(y - 95.0) < 3.0 => [250.0; 3],
            () if ((x + 2.0 * y) % 40.0) < 4.0 => [40.0, 38.0, 110.0 + grain],
            () => [60.0 + grain, 72.0 + grain, 165.0 + grain],
        };
        picture[3 * place..3 * place + 3].copy_from_slice(&[b as u8, g as u8, r as u8]);
        depth[place] = if is_tool { 60.0 } else { 74.0 + 0.05 * x as f32 + 0.3 * (y as f32 * 0.2).sin() };
    }
    (picture, depth)
}

#[test]
fn a_tool_is_cut_out_of_its_box_by_picture_or_depth() -> Result<(), HarnessError> {
    for (tip, corners) in [([70.0, 60.0], [58.0, 34.0, 132.0, 72.0]), ([52.0, 84.0], [46.0, 30.0, 139.0, 99.0])] {
        let (picture, depth) = instrument(tip);
        let [x0, y0, x1, y1] = corners;
        let (class_index, track_id) = (0, -1);
        let item =
            Detection { x_px: x0, y_px: y0, width_px: x1 - x0, height_px: y1 - y0, score: 0.9, class_index, track_id };
        let disparity: Vec<f32> = depth.iter().map(|z| 187.5 * 15.0 / z).collect();
        let find = |with_picture: bool, plane: &str| -> Result<Tip, HarnessError> {
            let mut node = Harness::<ToolTip>::from_toml("")?;
            node.input_detections("detections", &[item], "hook", (WIDTH, HEIGHT));
            node.input_value("calibration", calibration());
            if with_picture {
                node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &picture);
            }
            match plane {
                "depth" => _ = node.input_image::<Depth>("depth", WIDTH, HEIGHT, &depth),
                "disparity" => _ = node.input_image::<Disparity>("disparity", WIDTH, HEIGHT, &disparity),
                _ => {}
            }
            node.process()?.value("tip")
        };
        let off = |found: &Tip| (found.u_px - tip[0]).hypot(found.v_px - tip[1]);
        for (with_picture, plane) in [(true, "depth"), (false, "depth"), (true, "disparity"), (true, "")] {
            let found = find(with_picture, plane)?;
            assert!(off(&found) < 4.0, "picture {with_picture}, {plane}: {} px off: {found:?}", off(&found));
            assert_eq!(found.xyz_valid, u32::from(!plane.is_empty()));
            assert!(plane.is_empty() || (found.xyz_mm[2] - 60.0).abs() < 0.5, "{found:?}");
        }
        // The box alone is less exact.
        assert!(off(&find(false, "")?) > 6.0);
    }
    Ok(())
}

#[test]
fn the_tip_of_a_box_is_not_the_end_where_the_shaft_goes_on() -> Result<(), HarnessError> {
    // The tip is near the left border, and the box covers only what is near the tip: the shaft goes on to the right.
    for (tip, corners) in [([28.0, 62.0], [20.0, 34.0, 84.0, 72.0]), ([24.0, 96.0], [18.0, 60.0, 76.0, 104.0])] {
        let (picture, _) = instrument(tip);
        let [x0, y0, x1, y1] = corners;
        let item = Detection {
            x_px: x0,
            y_px: y0,
            width_px: x1 - x0,
            height_px: y1 - y0,
            score: 0.9,
            class_index: 0,
            track_id: -1,
        };
        let mut node = Harness::<ToolTip>::from_toml("")?;
        node.input_detections("detections", &[item], "hook", (WIDTH, HEIGHT));
        node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &picture);
        let found: Tip = node.process()?.value("tip")?;
        let off = (found.u_px - tip[0]).hypot(found.v_px - tip[1]);
        assert!(off < 5.0, "{off} px off {tip:?}: {found:?}");
    }
    Ok(())
}

#[test]
fn a_keypoint_is_the_tip_where_the_segmented_end_is_far_from_it() -> Result<(), HarnessError> {
    let tip = [70.0, 60.0];
    let (picture, _) = instrument(tip);
    let (x_px, y_px, width_px, height_px) = (58.0, 34.0, 74.0, 38.0);
    let item = Detection { x_px, y_px, width_px, height_px, score: 0.9, class_index: 0, track_id: -1 };
    let columns = ["box", "keypoint", "x_px", "y_px", "score"];
    let find = |params: &str, columns: &[&str], rows: &[f64]| -> Result<[f64; 2], HarnessError> {
        let mut node = Harness::<ToolTip>::from_toml(&format!("params = {{ {params} }}"))?;
        node.input_detections("detections", &[item], "hook", (WIDTH, HEIGHT));
        node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &picture);
        node.input_table("keypoints", columns, rows);
        let found: Tip = node.process()?.value("tip")?;
        Ok([found.u_px, found.v_px])
    };
    let plain = find("", &columns, &[])?;
    assert!((plain[0] - tip[0]).hypot(plain[1] - tip[1]) < 4.0, "{plain:?}");
    // The diagonal of the box is 83 px, of which 35 % are 29 px.
    let far = [0.0, 0.0, 120.0, 45.0, 0.6];
    assert_eq!(find("", &columns, &far)?, [120.0, 45.0]);
    assert_eq!(find("keypoint_score = 0.7", &columns, &far)?, plain);
    assert_eq!(find("keypoint_score = 1.0", &columns, &[0.0, 0.0, 120.0, 45.0, 1.0])?, plain);
    // Near the end, of another box, no tip but another keypoint, not a number, another table.
    let near = [0.0, 0.0, 84.0, 56.0, 0.6];
    assert_eq!(find("", &columns, &near)?, plain);
    assert_eq!(find("keypoint_distance = 0.0", &columns, &near)?, [84.0, 56.0]);
    assert_eq!(find("", &columns, &[1.0, 0.0, 120.0, 45.0, 0.6])?, plain);
    assert_eq!(find("", &columns, &[0.0, 1.0, 120.0, 45.0, 0.6])?, plain);
    assert_eq!(find("", &columns, &[0.0, 0.0, f64::NAN, 45.0, 0.6])?, plain);
    assert_eq!(find("", &["a", "b", "c", "d", "e"], &far)?, plain);
    Ok(())
}

/// Red tissue in a round field of view, dark around it, with a gray instrument from the field's left rim to a tip. Returns the image, bgr8, and the
/// instrument's mask.
fn round_field(middle: [f64; 2], radius: f64, tip: [f64; 2]) -> (Vec<u8>, Vec<u8>) {
    let (mut picture, mut mask) = (Vec::new(), vec![0_u8; detections::mask_len(WIDTH, HEIGHT)]);
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let is_lit = (x as f64 - middle[0]).hypot(y as f64 - middle[1]) < radius;
        let is_tool = is_lit && x as f64 <= tip[0] && (y as f64 - tip[1]).abs() <= 6.0;
        let grain = ((x * 31 + y * 17 + x * y) % 19) as u8;
        picture.extend(match (is_lit, is_tool) {
            (false, _) => [2, 2, 2],
            (true, true) => [120 + grain, 122 + grain, 126 + grain],
            (true, false) => [60 + grain, 72 + grain, 165 + grain],
        });
        if is_tool {
            mask[y * WIDTH.div_ceil(8) + x / 8] |= 0x80 >> (x % 8);
        }
    }
    (picture, mask)
}

#[test]
fn a_shaft_enters_at_the_rim_of_a_round_field_not_at_the_nearer_border() -> Result<(), HarnessError> {
    // The field ends 52 px from the left border of the image and close to the right one, towards which the tip points.
    let tip = [122.0, 60.0];
    let (picture, mask) = round_field([106.0, 60.0], 54.0, tip);
    let item =
        Detection { x_px: 54.0, y_px: 40.0, width_px: 74.0, height_px: 40.0, score: 0.9, class_index: 0, track_id: -1 };
    for with_mask in [false, true] {
        let mut node = Harness::<ToolTip>::from_toml("")?;
        if with_mask {
            node.input_instances("instances", &[item], "hook", (WIDTH, HEIGHT), &mask);
        } else {
            node.input_detections("detections", &[item], "hook", (WIDTH, HEIGHT));
        }
        node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &picture);
        let found: Tip = node.process()?.value("tip")?;
        let off = (found.u_px - tip[0]).hypot(found.v_px - tip[1]);
        assert!(off < 4.0, "mask {with_mask}: {off} px off: {found:?}");
    }
    Ok(())
}

/// A bar of pale steel that mirrors the red around it, from the right border to a tip, on tissue of two kinds in patches of 6 px.
fn mirroring_instrument([u, v]: [f64; 2]) -> Vec<u8> {
    let mut picture = Vec::with_capacity(3 * WIDTH * HEIGHT);
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let hash = ((x / 6 * 7919 + y / 6 * 104_729) as u32).wrapping_mul(0x9e37_79b9) >> 24;
        let is_steel = x as f64 >= u && (y as f64 - v - 0.15 * (u - x as f64)).abs() <= 6.0;
        let [blue, green, red] = match (is_steel, hash < 128) {
            (true, _) => [128, 138, 178],
            (false, true) => [60, 80, 190],
            (false, false) => [84, 110, 176],
        };
        let shade = (hash % 12) as u8;
        picture.extend([blue + shade, green + shade, red + shade]);
    }
    picture
}

#[test]
fn steel_that_mirrors_tissue_is_cut_out_by_its_colours_alone() -> Result<(), HarnessError> {
    for tip in [[62.0, 60.0], [80.0, 70.0]] {
        let (x0, y0) = (tip[0] as f32 - 6.0, tip[1] as f32 - 22.0);
        let item =
            Detection { x_px: x0, y_px: y0, width_px: 64.0, height_px: 34.0, score: 0.9, class_index: 0, track_id: -1 };
        let mut node = Harness::<ToolTip>::from_toml("")?;
        node.input_detections("detections", &[item], "hook", (WIDTH, HEIGHT));
        node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &mirroring_instrument(tip));
        let found: Tip = node.process()?.value("tip")?;
        let off = (found.u_px - tip[0]).hypot(found.v_px - tip[1]);
        assert!(off < 6.0, "{off} px off {tip:?}: {found:?}");
    }
    Ok(())
}

#[test]
fn a_box_without_an_instrument_gives_the_boxes_end() -> Result<(), HarnessError> {
    // Nothing but tissue: whatever the cues make of it, the tip stays within the box and its depth is the tissue's.
    let (picture, depth) = instrument([400.0, 60.0]);
    let item =
        Detection { x_px: 40.0, y_px: 30.0, width_px: 60.0, height_px: 50.0, score: 0.9, class_index: 0, track_id: -1 };
    let mut node = Harness::<ToolTip>::from_toml("")?;
    node.input_detections("detections", &[item], "hook", (WIDTH, HEIGHT));
    node.input_value("calibration", calibration());
    node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &picture);
    node.input_image::<Depth>("depth", WIDTH, HEIGHT, &depth);
    let found: Tip = node.process()?.value("tip")?;
    assert!((30.0..110.0).contains(&found.u_px) && (20.0..90.0).contains(&found.v_px), "{found:?}");
    assert!((70.0..85.0).contains(&found.xyz_mm[2]), "{found:?}");
    Ok(())
}

#[test]
fn a_tool_whose_class_changes_stays_the_same_tool() -> Result<(), HarnessError> {
    let (picture, depth) = instrument([70.0, 60.0]);
    let mut node = Harness::<ToolTip>::from_toml("")?;
    let mut step = |tick: u64, items: &[Detection]| -> Result<Option<Tip>, HarnessError> {
        node.at_tick(tick, tick as i64 * 33_333_333);
        node.input_detections("detections", items, "grasper\nbipolar\nhook", (WIDTH, HEIGHT));
        node.input_value("calibration", calibration());
        node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &picture);
        node.input_image::<Depth>("depth", WIDTH, HEIGHT, &depth);
        let out = node.process()?;
        Ok(if out.is_empty("tip")? { None } else { Some(out.value("tip")?) })
    };
    let tool = |score: f32, class_index: u32, track_id: i64, shift: f32| Detection {
        x_px: 60.0 + shift,
        y_px: 34.0,
        width_px: 76.0,
        height_px: 38.0,
        score,
        class_index,
        track_id,
    };
    // A strip at the border, which the shaft crosses, is surer than the tool; its end is no tip.
    let strip =
        Detection { x_px: 150.0, y_px: 2.0, width_px: 9.0, height_px: 60.0, score: 0.5, class_index: 2, track_id: 9 };
    let first = step(0, &[strip, tool(0.45, 0, 4, 0.0)])?.expect("the tool is in view");
    assert!((first.u_px - 70.0).abs() < 4.0 && first.track_id == 4, "{first:?}");
    // In two minds: neither class alone is sure enough, together they are.
    let torn = step(1, &[tool(0.2, 1, 5, 1.0), tool(0.15, 0, 4, -1.0)])?.expect("a tool of some class");
    assert!((torn.score - 0.35).abs() < 1e-6 && torn.track_id == 4, "{torn:?}");
    let renamed = step(2, &[tool(0.6, 1, 5, 1.0)])?.expect("the tool is in view");
    assert_eq!((renamed.track_id, renamed.class_index), (4, 1));
    // Another tool that was seen beside it is not taken for it when it is gone.
    let beside = Detection { x_px: 20.0, y_px: 70.0, width_px: 40.0, ..tool(0.9, 2, 7, 0.0) };
    assert_eq!(step(3, &[tool(0.6, 1, 5, 1.0), beside])?.map(|t| t.track_id), Some(4));
    let moved = Detection { x_px: 58.0, y_px: 36.0, width_px: 70.0, ..beside };
    assert_eq!(step(4, &[moved])?.map(|t| t.track_id), Some(7));
    // A weak box is of the tool that was surely there just before, and of none when that is long ago.
    assert_eq!(step(5, &[tool(0.2, 1, 5, 0.0)])?.map(|t| t.track_id), Some(7));
    assert!(step(40, &[tool(0.2, 1, 5, 0.0)])?.is_none());
    Ok(())
}

#[test]
fn a_picture_of_another_size_is_refused() -> Result<(), HarnessError> {
    let mut node = Harness::<ToolTip>::from_toml("")?;
    let item =
        Detection { x_px: 4.0, y_px: 3.0, width_px: 60.0, height_px: 50.0, score: 0.9, class_index: 0, track_id: -1 };
    node.input_detections("detections", &[item], "hook", (WIDTH, HEIGHT));
    node.input_image::<Bgr8>("image", 80, 60, &[0; 80 * 60 * 3]);
    let error = node.process().err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("80x60") && error.contains("160x120"), "{error}");
    Ok(())
}

#[test]
fn open_jaws_have_their_tip_between_them_in_space() -> Result<(), HarnessError> {
    // Two jaws from a joint, one of them 4 mm nearer than the other at its end; between them there is only tissue.
    let on_bar = |x: f64, y: f64, a: [f64; 2], b: [f64; 2], width: f64| {
        let long = f64::hypot(b[0] - a[0], b[1] - a[1]);
        let t = ((x - a[0]) * (b[0] - a[0]) + (y - a[1]) * (b[1] - a[1])) / long;
        let s = ((y - a[1]) * (b[0] - a[0]) - (x - a[0]) * (b[1] - a[1])) / long;
        ((0.0..=long).contains(&t) && s.abs() <= width / 2.0).then_some(t / long)
    };
    let (joint, one, two) = ([110.0, 60.0], [40.0, 20.0], [50.0, 92.0]);
    let row = WIDTH.div_ceil(8);
    let (mut mask, mut depth) = (vec![0_u8; row * HEIGHT], vec![80.0_f32; WIDTH * HEIGHT]);
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let (u, v) = (x as f64, y as f64);
        let shaft = on_bar(u, v, [170.0, 58.0], joint, 10.0).map(|_| 60.0);
        let first = on_bar(u, v, joint, one, 6.0).map(|t| 60.0 - 2.0 * t);
        let z = shaft.or(first).or_else(|| on_bar(u, v, joint, two, 6.0).map(|t| 60.0 + 2.0 * t));
        if let Some(z) = z {
            depth[y * WIDTH + x] = z as f32;
            mask[y * row + x / 8] |= 0x80 >> (x % 8);
        }
    }
    let item = Detection {
        x_px: 36.0,
        y_px: 16.0,
        width_px: 124.0,
        height_px: 80.0,
        score: 1.0,
        class_index: 0,
        track_id: -1,
    };
    let mut node = Harness::<ToolTip>::from_toml("")?;
    node.input_instances("instances", &[item], "grasper", (WIDTH, HEIGHT), &mask);
    node.input_image::<Depth>("depth", WIDTH, HEIGHT, &depth);
    node.input_value("calibration", calibration());
    let found: Tip = node.process()?.value("tip")?;
    let off = (found.u_px - 45.0).hypot(found.v_px - 56.0);
    assert!(off < 4.0 && (found.xyz_mm[2] - 60.0).abs() < 0.7 && found.xyz_valid == 1, "{off}: {found:?}");
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

#[test]
fn a_camera_slower_than_it_says_neither_stretches_predictions_nor_speeds() -> Result<(), HarnessError> {
    // It says 30 pictures a second and gives 10; the tip moves at 15 mm/s.
    let mut node = Harness::<TipTrack>::from_toml("params = { max_gap_ms = 300.0 }")?;
    let (mut speed_mm_s, mut predicted) = (0.0, Vec::new());
    for tick in 0..48_u64 {
        node.at_tick(tick, tick as i64 * 33_333_333).at_clock(tick as i64 * 100_000_000);
        let x_mm = 1.5 * tick as f64 - 40.0;
        let tip = Tip {
            u_px: 80.0,
            v_px: 60.0,
            xyz_mm: [x_mm, 0.0, 65.0],
            score: 0.9,
            class_index: 0,
            xyz_valid: 1,
            track_id: -1,
        };
        if tick < 40 {
            node.input_value("tip", tip)
        } else {
            node.input_empty("tip")
        };
        let out = node.input_value("calibration", calibration()).process()?;
        if tick == 39 {
            speed_mm_s = out.table("table")?.rows().next().map_or(0.0, |row| row[6]);
            assert_eq!(out.lag_ns(), None, "a seen tip is as old as its tick");
        } else if tick >= 40 && !out.is_empty("tip")? {
            predicted.push(out.lag_ns().unwrap_or(0) / 1_000_000);
        }
    }
    assert!((speed_mm_s - 15.0).abs() < 1.0, "{speed_mm_s} mm/s");
    assert!(predicted.len() == 3 || predicted.len() == 2, "300 ms are three ticks: {predicted:?}");
    assert!(predicted.iter().enumerate().all(|(n, ms)| (ms - 100 * (n as i64 + 1)).abs() <= 2), "{predicted:?}");
    Ok(())
}

/// The right view of [`instrument`]: each pixel shows what the left one shows farther right by its disparity.
fn right_of(tip: [f64; 2], left: &[u8], depth: &[f32]) -> Vec<u8> {
    let mut picture = vec![0; left.len()];
    let (near, far) = (187.5 * 15.0 / 60.0, 187.5 * 15.0 / 77.0);
    let (own, _) = instrument(tip);
    for place in 0..WIDTH * HEIGHT {
        let (x, y) = (place % WIDTH, place / WIDTH);
        let at = |disparity: f64| (x as f64 + disparity).round() as usize;
        let tool = Some(at(near)).filter(|x| *x < WIDTH && depth[y * WIDTH + x] < 61.0);
        // What the tool hides from the left camera looks as the tissue beside it.
        let tissue = || {
            let mut x = at(far).min(WIDTH - 1);
            while x > 0 && depth[y * WIDTH + x] < 61.0 {
                x -= 1;
            }
            x
        };
        let from = 3 * (y * WIDTH + tool.unwrap_or_else(tissue));
        picture[3 * place..3 * place + 3].copy_from_slice(&own[from..from + 3]);
    }
    picture
}

fn box_around([x, y]: [f64; 2]) -> Detection {
    let (x_px, y_px) = (x as f32 - 12.0, y as f32 - 26.0);
    Detection { x_px, y_px, width_px: 74.0, height_px: 38.0, score: 0.9, class_index: 0, track_id: 4 }
}

#[test]
fn an_end_whose_disparity_is_the_tissues_has_the_depth_that_both_views_show() -> Result<(), HarnessError> {
    let tip = [70.0, 60.0];
    let (picture, depth) = instrument(tip);
    let right = right_of(tip, &picture, &depth);
    // As a matcher with a large window has it: for the last 40 px of the instrument the tissue's.
    let disparity: Vec<f32> = (0..WIDTH * HEIGHT)
        .map(|place| 187.5 * 15.0 / if place % WIDTH < 110 { depth[place].max(74.0) } else { depth[place] })
        .collect();
    let find = |with_right: bool| -> Result<Tip, HarnessError> {
        let mut node = Harness::<ToolTip>::from_toml("")?;
        node.input_detections("detections", &[box_around(tip)], "hook", (WIDTH, HEIGHT));
        node.input_value("calibration", calibration());
        node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &picture);
        node.input_image::<Disparity>("disparity", WIDTH, HEIGHT, &disparity);
        if with_right {
            node.input_image::<Bgr8>("right", WIDTH, HEIGHT, &right);
        }
        node.process()?.value("tip")
    };
    let found = find(true)?;
    assert!((found.u_px - 70.0).hypot(found.v_px - 60.0) < 4.0, "{found:?}");
    assert!(found.xyz_valid == 1 && (found.xyz_mm[2] - 60.0).abs() < 1.5, "{found:?}");
    let alone = find(false)?;
    assert!((alone.xyz_mm[2] - 60.0).abs() > 5.0, "the map alone has the tissue's depth there: {alone:?}");
    let mut node = Harness::<ToolTip>::from_toml("")?;
    node.input_detections("detections", &[box_around(tip)], "hook", (WIDTH, HEIGHT));
    node.input_image::<Bgr8>("right", 8, 8, &[0; 192]);
    let error = node.process().err().expect("another size").to_string();
    assert!(error.contains("`right` is 8x8"), "{error}");
    Ok(())
}

#[test]
fn a_tool_that_the_detector_misses_is_found_in_the_picture_for_a_while() -> Result<(), HarnessError> {
    let mut node = Harness::<ToolTip>::from_toml("params = { max_age_ms = 200.0 }")?;
    let mut last = 1.0;
    for tick in 0..12_u64 {
        // It moves by 2 px a picture; after the third picture the detector finds nothing.
        let tip = [70.0 - 2.0 * tick as f64, 60.0];
        let (picture, depth) = instrument(tip);
        let items = if tick < 3 { vec![box_around(tip)] } else { Vec::new() };
        node.at_tick(tick, tick as i64 * 33_333_333);
        node.input_detections("detections", &items, "hook", (WIDTH, HEIGHT));
        node.input_value("calibration", calibration());
        node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &picture);
        node.input_image::<Depth>("depth", WIDTH, HEIGHT, &depth);
        let out = node.process()?;
        if tick <= 8 {
            let found: Tip = out.value("tip")?;
            assert!((found.u_px - tip[0]).hypot(found.v_px - tip[1]) < 4.0, "picture {tick}: {found:?}");
            assert_eq!((found.track_id, found.xyz_valid), (4, 1));
            // The longer no box was found, the less sure it is.
            assert!(if tick < 3 { (found.score - 0.9).abs() < 1e-6 } else { found.score < last }, "picture {tick}");
            last = found.score;
        } else {
            assert!(out.is_empty("tip")?, "picture {tick}: the last box is older than 200 ms");
        }
    }
    Ok(())
}

#[test]
fn a_weak_box_is_of_the_tool_that_was_sure_before_and_of_no_other() -> Result<(), HarnessError> {
    let tip = [70.0, 60.0];
    let (picture, depth) = instrument(tip);
    let weak = Detection { score: 0.15, ..box_around(tip) };
    let found = |node: &mut Harness<ToolTip>, item: Detection| {
        node.input_detections("detections", &[item], "hook", (WIDTH, HEIGHT));
        node.input_value("calibration", calibration());
        node.input_image::<Bgr8>("image", WIDTH, HEIGHT, &picture);
        node.input_image::<Depth>("depth", WIDTH, HEIGHT, &depth);
        node.process()
    };
    let mut node = Harness::<ToolTip>::from_toml("")?;
    assert!(found(&mut node, weak)?.is_empty("tip")?, "nothing was sure before");
    found(&mut node, box_around(tip))?;
    // Long after the last sure box.
    for _ in 0..30 {
        let tip: Tip = found(&mut node, weak)?.value("tip")?;
        assert!(tip.score >= 0.15, "{tip:?}");
    }
    Ok(())
}
