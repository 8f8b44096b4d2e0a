//! The node's ground truth ports, its instruments, and ticks that are dropped.

use panoscope_node::abi::Tip;
use panoscope_node::harness::{Harness, HarnessError};
use panoscope_node::{Bgr8, Depth};
use panoscope_phantom::PhantomNode;

const SIZE: (usize, usize) = (320, 240);

fn open(params: &str) -> Result<Harness<PhantomNode>, HarnessError> {
    let size = if params.contains("tools") { SIZE } else { (64, 48) };
    Harness::from_toml(&format!("params = {{ width = {}, height = {}, {params} }}", size.0, size.1))
}

#[test]
fn every_truth_of_the_design_has_its_port() -> Result<(), HarnessError> {
    let node = open("")?;
    let names: Vec<&str> = node.node_type().outputs.iter().map(|port| port.name.as_str()).collect();
    for port in [
        "left",
        "right",
        "calibration",
        "disparity",
        "depth",
        "pose",
        "homography",
        "wide",
        "footprint",
        "detections",
        "instances",
        "tip",
    ] {
        assert!(names.contains(&port), "there is no port {port} among {names:?}");
    }
    Ok(())
}

#[test]
fn instruments_have_boxes_masks_and_tips_that_agree() -> Result<(), HarnessError> {
    let mut node = open("scene = \"liver\", tools = 2, tool_kinds = \"hook, grasper\"")?;
    let (mut seen, mut tips) = ([0usize; 2], 0);
    for _ in 0..4 {
        let out = node.process()?;
        let boxes = out.detections("detections")?;
        let instances = out.instances("instances")?;
        assert_eq!(boxes.image_size(), SIZE);
        assert_eq!(boxes.items(), instances.detections().items());
        for (index, item) in boxes.items().iter().enumerate() {
            // Kinds in turn: the first instrument is the hook.
            let kind = ["hook", "grasper"][item.track_id as usize - 1];
            assert_eq!(boxes.label(item.class_index), kind);
            seen[item.track_id as usize - 1] += 1;
            let mask = instances.mask(index);
            let (mut count, mut bounds) = (0, [usize::MAX, usize::MAX, 0, 0]);
            for y in 0..SIZE.1 {
                for x in 0..SIZE.0 {
                    if mask[y * SIZE.0.div_ceil(8) + x / 8] >> (7 - x % 8) & 1 == 1 {
                        count += 1;
                        bounds = [bounds[0].min(x), bounds[1].min(y), bounds[2].max(x + 1), bounds[3].max(y + 1)];
                    }
                }
            }
            assert!(count > 50, "{kind}: {count} pixels");
            let [left, top, right, bottom] = bounds.map(|v| v as f32);
            assert_eq!(
                [item.x_px, item.y_px, item.width_px, item.height_px],
                [left, top, right - left, bottom - top],
                "{kind}"
            );
        }
        if out.is_empty("tip")? {
            continue;
        }
        tips += 1;
        let tip: Tip = out.value("tip")?;
        let [x, y, z] = tip.xyz_mm;
        // fx = 750 px at 640 columns.
        let (u, v) = (375.0 * x / z + 159.5, 375.0 * y / z + 119.5);
        assert!((u - tip.u_px).hypot(v - tip.v_px) < 1e-6, "{tip:?}");
        let depth = out.plane::<Depth>("depth")?.row(tip.v_px.round() as usize)[tip.u_px.round() as usize];
        // Between open jaws the tissue behind is seen; nothing stands before the tip but its own jaws.
        assert!(f64::from(depth) > z - 2.0, "the tip lies at {z} mm, the picture there at {depth} mm");
    }
    assert!(seen == [4, 4] && tips > 0, "{seen:?} {tips}");
    let refused = open("tools = 1, tool_kinds = \"hammer\"").err().map(|error| error.to_string()).unwrap_or_default();
    assert!(refused.contains("hammer") && refused.contains("specimen_bag"), "{refused}");
    Ok(())
}

#[test]
fn dropped_ticks_leave_out_what_they_should_and_are_the_same_in_every_run() -> Result<(), HarnessError> {
    let run = |params: &str, port: &str| -> Result<Vec<bool>, HarnessError> {
        let mut node = open(&format!("drop_share = 0.3, {params}"))?;
        (0..30).map(|_| node.process()?.is_empty(port)).collect()
    };
    let all = run("drop_views = \"all\"", "left")?;
    let count = all.iter().filter(|dropped| **dropped).count();
    assert!((3..=16).contains(&count), "{count} of 30 ticks");
    assert_eq!(all, run("", "right")?);
    assert_eq!(all, run("drop_views = \"right\"", "view1")?);
    assert!(run("drop_views = \"right\"", "left")?.iter().all(|dropped| !dropped));
    assert_ne!(all, run("seed = 8", "left")?);
    // A dropped tick keeps its time, and the pictures around it do not change.
    let mut whole = open("")?;
    let mut holed = open("drop_share = 0.3")?;
    for dropped in &all[..8] {
        let (a, b) = (whole.process()?, holed.process()?);
        assert_eq!(a.tick().capture_ns, b.tick().capture_ns);
        if !dropped {
            assert!(a.plane::<Bgr8>("left")?.data == b.plane::<Bgr8>("left")?.data);
        }
    }
    Ok(())
}

#[test]
fn clearances_agree_with_depth_where_the_tissue_is_flat_and_with_tips() -> Result<(), HarnessError> {
    // The board is flat, still and square to the resting camera: the clearance is the difference of depths.
    let mut node = open("scene = \"board\", speed_mm_s = 0.0, distance_mm = 60.0, tools = 2")?;
    for _ in 0..3 {
        let out = node.process()?;
        let table = out.table("clearance")?;
        assert_eq!(table.names().nth(6), Some("tissue_mm"));
        let rows: Vec<&[f64]> = table.rows().collect();
        assert_eq!(rows.len(), 2);
        let lead: Tip = out.value("lead")?;
        let second: Tip = out.value("second")?;
        assert_eq!((&rows[0][3..6], &rows[1][3..6]), (lead.xyz_mm.as_slice(), second.xyz_mm.as_slice()));
        for row in &rows {
            assert!((row[6] - (60.0 - row[5])).abs() < 1e-3, "{row:?}");
            let apart = (0..3).map(|k| (rows[0][3 + k] - rows[1][3 + k]).powi(2)).sum::<f64>().sqrt();
            assert!((row[7] - apart).abs() < 1e-9, "{row:?}");
        }
    }
    let mut alone = open("tools = 1")?;
    let out = alone.process()?;
    assert!(out.table("clearance")?.rows().next().is_some_and(|row| row[7].is_nan()), "there is no other tip");
    Ok(())
}
