//! `skill`, `proximity` and `evaluate_proximity` on tips and depths with known distances and measures.

use panoscope_node::abi::{Calibration, Camera, CloudPoint, Detection, Pose, Tip};
use panoscope_node::harness::{Harness, HarnessError, Level, Outputs};
use panoscope_node::{Depth, Mask, detections, name16};
use panoscope_tools::evaluate_proximity::EvaluateProximity;
use panoscope_tools::proximity::{self, Proximity};
use panoscope_tools::skill::{self, Skill};

const SIZE: (usize, usize) = (160, 120);
const FOCAL: f64 = 187.5;
const CENTRE: (f64, f64) = (79.5, 59.5);
const TICK_NS: i64 = 33_333_333;

fn calibration() -> Calibration {
    let (width, height) = (SIZE.0 as u32, SIZE.1 as u32);
    let camera = Camera { width, height, fx: FOCAL, fy: FOCAL, cx: CENTRE.0, cy: CENTRE.1, distortion: [0.0; 14] };
    let eye = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = |tx: f64| [FOCAL, 0.0, CENTRE.0, tx, 0.0, FOCAL, CENTRE.1, 0.0, 0.0, 0.0, 1.0, 0.0];
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

fn tip(xyz_mm: [f64; 3], track_id: i64) -> Tip {
    Tip {
        u_px: FOCAL * xyz_mm[0] / xyz_mm[2] + CENTRE.0,
        v_px: FOCAL * xyz_mm[1] / xyz_mm[2] + CENTRE.1,
        xyz_mm,
        score: 1.0,
        class_index: 0,
        xyz_valid: 1,
        track_id,
    }
}

/// Tissue 60 mm away and, from each tip to the right, a tool of 5 mm at the tip's depth: depth and mask.
fn scene(tips: &[Tip]) -> (Vec<f32>, Vec<u8>) {
    let (mut depth, mut mask) = (vec![60.0; SIZE.0 * SIZE.1], vec![0; SIZE.0 * SIZE.1]);
    for at in 0..depth.len() {
        let (x, y) = ((at % SIZE.0) as f64, (at / SIZE.0) as f64);
        for tip in tips {
            let half = 2.5 * FOCAL / tip.xyz_mm[2];
            if x >= tip.u_px && (y - tip.v_px).abs() <= half {
                (depth[at], mask[at]) = (tip.xyz_mm[2] as f32, 255);
            }
        }
    }
    (depth, mask)
}

fn column(out: &Outputs, row: usize, name: &str) -> Result<f64, HarnessError> {
    let table = out.table("table")?;
    let at = table.names().position(|n| n == name).unwrap_or_else(|| panic!("no column {name}"));
    Ok(table.rows().nth(row).unwrap_or_else(|| panic!("no row {row}"))[at])
}

fn show(node: &mut Harness<Proximity>, tips: &[Tip], of: &str) -> Result<Outputs, HarnessError> {
    let (depth, mask) = scene(tips);
    for tip in tips {
        node.input_value("tip", *tip);
    }
    node.input_value("calibration", calibration());
    match of {
        "cloud" => {
            let point = |z: f32| CloudPoint { x_mm: 0.0, y_mm: 0.0, z_mm: z, bgr: [0; 3], filled: 0 };
            let mut points: Vec<CloudPoint> = depth.iter().map(|z| point(*z)).collect();
            // What was filled in is no tissue: 1 mm before the camera, far from the tools.
            for x in 0..4 {
                points[x] = CloudPoint { filled: 1, ..point(1.0) };
            }
            node.input_cloud("cloud", SIZE.0, SIZE.1, &points);
        }
        _ => _ = node.input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth),
    }
    let boxes: Vec<Detection> = tips
        .iter()
        .map(|tip| {
            let half = (2.5 * FOCAL / tip.xyz_mm[2]) as f32;
            let (x_px, y_px) = (tip.u_px as f32, tip.v_px as f32 - half);
            let (width_px, height_px) = (SIZE.0 as f32 - x_px, 2.0 * half + 1.0);
            Detection { x_px, y_px, width_px, height_px, score: 1.0, class_index: 0, track_id: tip.track_id }
        })
        .collect();
    match of {
        "boxes" => _ = node.input_detections("detections", &boxes, "hook", SIZE),
        "instances" => {
            let len = detections::mask_len(SIZE.0, SIZE.1);
            let mut bits = vec![0_u8; tips.len() * len];
            for (one, tip) in bits.chunks_exact_mut(len).zip(tips) {
                let (_, own) = scene(std::slice::from_ref(tip));
                for at in (0..own.len()).filter(|at| own[*at] != 0) {
                    one[at / SIZE.0 * SIZE.0.div_ceil(8) + at % SIZE.0 / 8] |= 0x80 >> (at % SIZE.0 % 8);
                }
            }
            node.input_instances("instances", &boxes, "hook", SIZE, &bits);
        }
        _ => _ = node.input_image::<Mask>("mask", SIZE.0, SIZE.1, &mask),
    }
    node.process()
}

const EAGER: &str = "params = { min_ms = 0.0, rim_px = 4 }";

#[test]
fn distances_hold_whatever_says_where_tools_and_tissue_are() -> Result<(), HarnessError> {
    for of in ["mask", "cloud", "instances", "boxes"] {
        let mut node = Harness::<Proximity>::from_toml(EAGER)?;
        for (z, state) in [(48.0, 0.0), (56.5, 1.0), (59.6, 2.0), (61.0, 2.0), (54.5, 1.0), (50.0, 0.0)] {
            let out = show(&mut node, &[tip([-2.0, 3.0, z], 4)], of)?;
            let measured = column(&out, 0, "tissue_mm")?;
            assert!((measured - (60.0 - z)).abs() < 0.05, "{of}: {measured} instead of {}", 60.0 - z);
            assert_eq!(column(&out, 0, "tissue_state")?, state, "{of} at {z}");
            assert_eq!(column(&out, 0, "tissue_seen")?, 0.0, "the tool hides what is nearest");
            assert!((column(&out, 0, "tissue_u_px")? - (CENTRE.0 - 2.0 * FOCAL / 60.0)).abs() < 0.2);
            assert!(column(&out, 0, "tip_mm")?.is_nan(), "there is no other tip");
            let words = if state == 0.0 { "" } else { out.text("text")? };
            let name = if of == "boxes" || of == "instances" { "hook" } else { "tip" };
            match state {
                1.0 => assert_eq!(words, format!("{name} 4 is {measured:.1} mm from tissue")),
                2.0 => assert_eq!(words, format!("{name} 4 touches tissue")),
                _ => assert!(out.is_empty("text")?),
            }
        }
    }
    Ok(())
}

#[test]
fn a_warning_needs_its_time_and_ends_beyond_its_release() -> Result<(), HarnessError> {
    let mut node = Harness::<Proximity>::from_toml("params = { min_ms = 60.0, release_mm = 1.0 }")?;
    let mut states = Vec::new();
    // 5 mm warns after 60 ms, which are two ticks later; beyond 6 mm it ends so.
    for z in [50.0, 56.0, 56.0, 56.0, 54.5, 54.5, 54.5, 53.5, 53.5, 53.5] {
        let out = show(&mut node, &[tip([0.0, 0.0, z], 1)], "mask")?;
        states.push(column(&out, 0, "tissue_state")?);
    }
    assert_eq!(states, [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
    Ok(())
}

#[test]
fn tips_near_each_other_are_told_once_and_one_tip_told_twice_is_one() -> Result<(), HarnessError> {
    let mut node = Harness::<Proximity>::from_toml(EAGER)?;
    let out = show(&mut node, &[tip([-10.0, 0.0, 45.0], 1), tip([-10.0, 9.0, 45.0], 2)], "mask")?;
    assert!((column(&out, 0, "tip_mm")? - 9.0).abs() < 1e-9);
    assert_eq!((column(&out, 0, "tip_state")?, column(&out, 1, "tip_track_id")?), (0.0, 1.0));
    let out = show(&mut node, &[tip([-10.0, 0.0, 45.0], 1), tip([-10.0, 6.0, 45.0], 2)], "mask")?;
    assert_eq!((column(&out, 0, "tip_state")?, column(&out, 1, "tip_state")?), (1.0, 1.0));
    assert_eq!(out.text("text")?, "tip 1 and tip 2 are 6.0 mm apart");
    assert_eq!(node.metric("warnings"), Some(2.0));
    let out = show(&mut node, &[tip([-10.0, 0.0, 45.0], 1), tip([-10.0, 0.4, 45.0], 1)], "mask")?;
    assert_eq!(out.table("table")?.rows().count(), 1, "one number is one tip");
    Ok(())
}

#[test]
fn a_surface_that_is_old_or_was_never_seen_is_said_to_be_unknown() -> Result<(), HarnessError> {
    let mut node = Harness::<Proximity>::from_toml("params = { max_age_ms = 100.0 }")?;
    let near = tip([0.0, 0.0, 58.0], 1);
    let alone = |node: &mut Harness<Proximity>| {
        node.input_value("tip", near);
        node.input_value("calibration", calibration());
        node.process()
    };
    let out = alone(&mut node)?;
    assert_eq!(column(&out, 0, "tissue_state")?, -1.0);
    assert_eq!(out.text("text")?, "tip 1: distance to tissue unknown");
    // Depth without any word on which pixels are tools is no tissue either.
    node.input_image::<Depth>("depth", SIZE.0, SIZE.1, &scene(&[near]).0);
    assert_eq!(column(&alone(&mut node)?, 0, "tissue_state")?, -1.0);
    show(&mut node, &[near], "mask")?;
    let mut states = Vec::new();
    for _ in 0..5 {
        states.push(column(&alone(&mut node)?, 0, "tissue_state")?);
    }
    assert_eq!(states, [0.0, 1.0, 1.0, -1.0, -1.0], "it warns for 100 ms on the last surface");
    // No tip, no row.
    node.input_empty("tip");
    node.input_value("calibration", calibration());
    assert!(node.process()?.is_empty("table")?);
    Ok(())
}

#[test]
fn pictures_of_different_sizes_and_calibrations_that_are_none_are_refused() -> Result<(), HarnessError> {
    let mut node = Harness::<Proximity>::from_toml("")?;
    let near = tip([0.0, 0.0, 58.0], 1);
    node.input_value("tip", near);
    node.input_value("calibration", calibration());
    node.input_image::<Depth>("depth", SIZE.0, SIZE.1, &scene(&[near]).0);
    node.input_image::<Mask>("mask", 8, 8, &[0; 64]);
    let error = node.process().err().expect("sizes differ").to_string();
    assert!(error.contains("`mask` belongs to an image of 8x8, but depth is 160x120"), "{error}");
    node.input_value("tip", near);
    node.input_value("calibration", Calibration { left_projection: [f64::NAN; 12], ..calibration() });
    assert!(node.process().is_err());
    Ok(())
}

#[test]
fn false_and_missed_warnings_are_counted_per_tip() -> Result<(), HarnessError> {
    let mut judge = Harness::<EvaluateProximity>::from_toml("params = { min_ms = 0.0, delay_ms = 50.0 }")?;
    let names = ["track_id", "seen", "tissue_mm", "tip_mm"];
    // Tip 1 approaches and is warned of; tip 2 approaches while nobody warns, then is warned of for nothing; hidden it is not judged.
    let truth = |k: usize| {
        let one = if (3..6).contains(&k) { 2.0 } else { 20.0 };
        let two = if (8..12).contains(&k) { 2.0 } else { 20.0 };
        [1.0, 1.0, one, f64::NAN, 2.0, f64::from(u8::from(k != 20)), if k == 20 { 0.0 } else { two }, 4.0]
    };
    let mut last = None;
    for k in 0..26 {
        judge.input_table("truth", &names, &truth(k));
        let row = |id: f64, mm: f64, state: bool, tip_state: f64| {
            let mut row = [0.0; proximity::COLUMNS.len()];
            (row[0], row[7], row[11], row[12], row[14]) = (id, mm, f64::from(u8::from(state)), 4.5, tip_state);
            row
        };
        let one = row(1.0, truth(k)[2] + 0.3, (4..7).contains(&k), 0.0);
        let two = row(2.0, truth(k)[6] + 0.3, (15..18).contains(&k), 1.0);
        judge.input_table("table", &proximity::COLUMNS, &[one, two].concat());
        last = Some(judge.process()?);
    }
    let out = last.expect("26 ticks");
    for margin in 0..2 {
        let counts = |names: [&str; 5]| names.map(|name| column(&out, margin, name).expect("a column"));
        let tissue = ["tissue_approaches", "tissue_missed", "tissue_warnings", "tissue_false", "tissue_ticks"];
        assert_eq!(counts(tissue), [2.0, 1.0, 2.0, 1.0, 51.0]);
        // Only the second tip has another one beside it.
        assert_eq!(
            counts(["tips_approaches", "tips_missed", "tips_warnings", "tips_false", "tips_ticks"]),
            [1.0, 0.0, 1.0, 0.0, 25.0]
        );
    }
    assert!((column(&out, 0, "tissue_delay_ms")? - TICK_NS as f64 * 1e-6).abs() < 1e-3);
    assert!((column(&out, 0, "tissue_rms_mm")? - 0.3).abs() < 1e-9);
    judge.input_table("truth", &["track_id"], &[1.0]);
    let error = judge.process().err().expect("columns are missing").to_string();
    assert!(error.contains("the table at `truth` has no column `seen`"), "{error}");
    Ok(())
}

/// Measures of the skill node, by name, of its first row.
fn measure(out: &Outputs, row: usize, name: &str) -> f64 {
    column(out, row, name).expect("a table")
}

#[test]
fn skill_measures_two_hands_by_input_in_the_room_and_by_phase() -> Result<(), HarnessError> {
    let mut node = Harness::<Skill>::from_toml("")?;
    let mut last = None;
    // 6 s: the first hand moves at 20 mm/s along x, by the moving camera's pose; the second one rests before a camera that follows it.
    for k in 0..=180 {
        let t = k as f64 / 30.0;
        node.at_tick(k, (t * 1e9) as i64);
        node.input_value("tip", tip([10.0 * t - 20.0, 0.0, 60.0], 5));
        node.input_value("tip", tip([5.0 - 10.0 * t, 4.0, 50.0], 6));
        let pose = Pose {
            a_from_b_wxyz: [1.0, 0.0, 0.0, 0.0],
            a_from_b_mm: [10.0 * t, 0.0, 0.0],
            a: name16("scene"),
            b: name16("left_camera"),
        };
        node.input_value("camera_pose", pose);
        node.input_text("phase", if t < 3.0 { "exposure" } else { "dissection\nmore words" });
        let names = ["track_id", "tissue_mm"];
        let touch = if (1.0..2.0).contains(&t) { 0.5 } else { 9.0 };
        node.input_table("proximity", &names, &[5.0, touch, 6.0, 20.0]);
        last = Some(node.process()?);
    }
    let out = last.expect("ticks");
    assert_eq!(out.table("table")?.names().collect::<Vec<_>>(), skill::COLUMNS);
    // Rows: first hand in all, in both phases; then the second one.
    let keys: Vec<[f64; 2]> = (0..6).map(|row| [measure(&out, row, "tool"), measure(&out, row, "phase")]).collect();
    assert_eq!(keys, [[0.0, -1.0], [0.0, 0.0], [0.0, 1.0], [1.0, -1.0], [1.0, 0.0], [1.0, 1.0]]);
    let near = |row: usize, name: &str, want: f64| {
        let value = measure(&out, row, name);
        assert!((value - want).abs() <= 0.03 * want.abs().max(0.1), "row {row}: {name} is {value}, not {want}");
    };
    // What lies within the window at the end is not measured yet.
    near(0, "path_mm", 20.0 * 5.9);
    near(1, "path_mm", 60.0);
    near(0, "mean_speed_mm_s", 20.0);
    near(0, "idle_share", 0.0);
    near(0, "contacts", 1.0);
    near(0, "contact_s", 1.0);
    near(3, "path_mm", 0.0);
    near(3, "idle_share", 1.0);
    near(3, "contacts", 0.0);
    let pairs = out.table("pairs")?;
    let row = pairs.rows().next().expect("a pair");
    assert_eq!((&row[..2], row[4]), ([0.0, 1.0].as_slice(), 0.0), "one rests");
    assert!(out.text("text")?.starts_with("tool 0 (class 0): 6 s in view, 118 mm, 0 % idle"), "{}", out.text("text")?);
    Ok(())
}

#[test]
fn skill_leaves_out_what_is_only_predicted_and_says_when_there_are_too_many_tools() -> Result<(), HarnessError> {
    let mut node = Harness::<Skill>::from_toml("params = { tools = \"track\" }")?;
    let mut last = None;
    for k in 0..90 {
        node.at_tick(k, k as i64 * TICK_NS);
        // Seen for a second, predicted at lower and lower scores for another, and never there for the third.
        let score = if k < 30 { 1.0 } else { 0.2 };
        match k {
            0..60 => _ = node.input_value("tip", Tip { score, ..tip([k as f64, 0.0, 60.0], 3) }),
            _ => _ = node.input_empty("tip"),
        }
        last = Some(node.process()?);
    }
    let out = last.expect("ticks");
    assert!((measure(&out, 0, "seen_s") - 0.97).abs() < 0.03 && (measure(&out, 0, "out_of_view_s") - 2.0).abs() < 0.06);
    assert_eq!((measure(&out, 0, "departures"), measure(&out, 0, "movements")), (1.0, 1.0));
    assert!(measure(&out, 0, "contacts").is_nan(), "distances are not known");
    for k in 90..150 {
        node.input_value("tip", tip([0.0, 0.0, 60.0], k));
        node.process()?;
    }
    let said: Vec<&str> =
        node.logs().iter().filter(|line| line.level == Level::Warn).map(|line| line.message.as_str()).collect();
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("more than 16 tools"), "{said:?}");
    Ok(())
}
