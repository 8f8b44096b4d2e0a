//! The node `composite`: its metrics and its crop.

use panoscope_node::abi::{self, Homography, Roi};
use panoscope_node::harness::Harness;
use panoscope_node::{Bgr8, Gray8, Mask};
use panoscope_stitch::{Composite, EvaluateStitch};

const SIZE: (usize, usize) = (160, 120);

fn view() -> Vec<u8> {
    (0..SIZE.0 * SIZE.1 * 3).map(|i| (i * 7 % 251) as u8).collect()
}

/// Number of seams after this many equal frames.
fn seams_after(frames: u64, params: &str) -> f64 {
    let mut node = Harness::<Composite>::from_toml(&format!("params = {{ {params} }}")).unwrap();
    let map = [1.0, 0.0, 60.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let map = Homography { left_from_right: map, rms_px: 0.5, inliers: 100, state: abi::STATE_FRESH };
    for seq in 0..frames {
        node.at_tick(seq, seq as i64)
            .input_image::<Bgr8>("left", SIZE.0, SIZE.1, &view())
            .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &view())
            .input_value("homography", map);
        node.process().unwrap();
    }
    node.metric("seams_found").unwrap()
}

#[test]
fn seams_are_counted_as_they_are_found() {
    assert_eq!(seams_after(8, "seam_interval = 1"), 8.0);
    // The first frame, and then at the latest after so many.
    assert_eq!(seams_after(9, "seam_interval = 4"), 3.0);
    assert_eq!(seams_after(8, ""), 1.0);
}

#[test]
fn a_mask_hides_what_is_not_lit() {
    let mut node = Harness::<Composite>::from_toml("params = { canvas_margin = 0, exposure = \"none\" }").unwrap();
    let map = [1.0, 0.0, 60.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let map = Homography { left_from_right: map, rms_px: 0.5, inliers: 100, state: abi::STATE_FRESH };
    let lit = |columns: std::ops::Range<usize>| -> Vec<u8> {
        (0..SIZE.0 * SIZE.1).map(|i| if columns.contains(&(i % SIZE.0)) { 255 } else { 0 }).collect()
    };
    let mut shown = |masks: Option<[Vec<u8>; 2]>| -> (usize, usize) {
        node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &view())
            .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &view())
            .input_value("homography", map);
        if let Some([left, right]) = &masks {
            node.input_image::<Mask>("mask_left", SIZE.0, SIZE.1, left);
            node.input_image::<Mask>("mask_right", SIZE.0, SIZE.1, right);
        }
        let out = node.process().unwrap();
        let mask = out.plane::<Mask>("mask").unwrap();
        let row = mask.row(60);
        (row.iter().position(|v| *v > 0).unwrap(), row.iter().rposition(|v| *v > 0).unwrap() + 1)
    };
    assert_eq!(shown(None), (0, 220));
    assert_eq!(shown(Some([lit(12..160), lit(0..150)])), (12, 210));
    assert_eq!(shown(None), (0, 220));
    // A mask of another view is refused.
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &view())
        .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &view())
        .input_value("homography", map)
        .input_image::<Mask>("mask_left", 8, 8, &[255; 64]);
    let told = node.process().err().map(|error| error.to_string()).unwrap_or_default();
    assert!(told.contains("`mask_left` is 8x8, but `left` is 160x120"), "{told}");
}

#[test]
fn masks_of_a_list_of_views_hide_what_is_not_lit() {
    let mut node = Harness::<Composite>::from_toml("params = { canvas_margin = 0, exposure = \"none\" }").unwrap();
    let lit = |columns: std::ops::Range<usize>| -> Vec<u8> {
        (0..SIZE.0 * SIZE.1).map(|i| if columns.contains(&(i % SIZE.0)) { 255 } else { 0 }).collect()
    };
    let mut shown = |masks: &[Vec<u8>]| -> Result<(usize, usize), String> {
        for dx in [0.0, 60.0, 120.0] {
            node.input_image::<Bgr8>("views", SIZE.0, SIZE.1, &view());
            if dx > 0.0 {
                node.input_value("homographies", shift(dx, 0.0));
            }
        }
        for mask in masks {
            node.input_image::<Mask>("masks", SIZE.0, mask.len() / SIZE.0, mask);
        }
        let out = node.process().map_err(|error| error.to_string())?;
        let mask = out.plane::<Mask>("mask").unwrap();
        let row = mask.row(60);
        Ok((row.iter().position(|v| *v > 0).unwrap(), row.iter().rposition(|v| *v > 0).unwrap() + 1))
    };
    assert_eq!(shown(&[]), Ok((0, 280)));
    assert_eq!(shown(&[lit(12..160), lit(0..160), lit(0..150)]), Ok((12, 270)));
    assert_eq!(shown(&[]), Ok((0, 280)));
    let told = shown(&[lit(0..160), lit(0..160)]).unwrap_err();
    assert!(told.contains("2 masks are connected for 3 views"), "{told}");
    let told = shown(&[lit(0..160), lit(0..160), vec![255; SIZE.0]]).unwrap_err();
    assert!(told.contains("mask 2 of `masks` is 160x1, but view 2 of `views` is 160x120"), "{told}");
}

fn shift(dx: f64, dy: f64) -> Homography {
    let map = [1.0, 0.0, dx, 0.0, 1.0, dy, 0.0, 0.0, 1.0];
    Homography { left_from_right: map, rms_px: 0.5, inliers: 100, state: abi::STATE_FRESH }
}

/// The tissue from column `first` on.
fn tissue(first: usize) -> Vec<u8> {
    let level = |i: usize| {
        (120.0 + 80.0 * (((i % SIZE.0 + first) as f64) * 0.2).sin() * ((i / SIZE.0) as f64 * 0.1).cos()) as u8
    };
    (0..SIZE.0 * SIZE.1).flat_map(|i| [level(i); 3]).collect()
}

/// Shows frame `seq` of a scope at 20 Hz.
fn show(node: &mut Harness<Composite>, seq: u64, map: Homography) {
    node.at_tick(seq, seq as i64 * 50_000_000)
        .input_image::<Bgr8>("left", SIZE.0, SIZE.1, &tissue(0))
        .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &tissue(60))
        .input_value("homography", map);
}

#[test]
fn a_filled_panorama_is_full_and_all_outputs_agree() {
    let mut node = Harness::<Composite>::from_toml("params = { crop = \"filled\" }").unwrap();
    show(&mut node, 0, shift(60.0, 6.0));
    let out = node.process().unwrap();
    let panorama = out.plane::<Bgr8>("panorama").unwrap();
    let (mask, shown) = (out.plane::<Mask>("mask").unwrap(), out.plane::<Gray8>("shown").unwrap());
    let size = (panorama.width, panorama.height);
    assert_eq!([(mask.width, mask.height), (shown.width, shown.height)], [size; 2]);
    assert!(mask.data.iter().all(|value| *value == 255) && shown.data.iter().all(|value| *value > 0));
    let canvas: Roi = out.value("canvas").unwrap();
    assert!(canvas.y < 0 && (canvas.width, canvas.height) == (SIZE.0 as i32, SIZE.1 as i32), "{canvas:?}");
    let left = tissue(0);
    let at = |x: i32, y: i32| ((y * SIZE.0 as i32 + x) * 3) as usize;
    for (x, y) in [(8, 20), (40, 100), (50, 30)] {
        let there = ((y + canvas.y) as usize * size.0 + (x + canvas.x) as usize) * 3;
        assert_eq!(panorama.data[there], left[at(x, y)], "{x}, {y}");
    }
    let gain = out.value::<abi::Scalar>("gain").unwrap().value;
    let area = 100.0 * ((size.0 * size.1) as f64 / (SIZE.0 * SIZE.1) as f64 - 1.0);
    assert!((gain - area).abs() < 1e-6, "{gain} % for an area {area} % larger");
    assert_eq!(out.text("gain_text").unwrap(), format!("{gain:+.0} % over one view"));
    assert_eq!(node.metric("view_gain_pct"), Some(gain));
    // The evaluation finds the views on it.
    let (panorama, shown) = (panorama.data.to_vec(), shown.data.to_vec());
    let mut evaluation = Harness::<EvaluateStitch>::from_toml("params = { every = 1 }").unwrap();
    evaluation
        .input_image::<Bgr8>("left", SIZE.0, SIZE.1, &tissue(0))
        .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &tissue(60))
        .input_value("homography", shift(60.0, 6.0))
        .input_image::<Bgr8>("panorama", size.0, size.1, &panorama)
        .input_image::<Gray8>("shown", size.0, size.1, &shown)
        .input_value("canvas", canvas)
        .input_image::<Bgr8>("wide", SIZE.0, SIZE.1, &tissue(0))
        .input_value("left_in_wide", Roi { x: 0, y: 0, width: SIZE.0 as i32, height: SIZE.1 as i32 });
    let out = evaluation.process().unwrap();
    let table = out.table("table").unwrap();
    let row = table.rows().next().unwrap();
    let column = |name: &str| row[table.names().position(|n| n == name).unwrap()];
    assert!((column("fov_pct") - 100.0 - gain).abs() < 1e-6, "{}", column("fov_pct"));
    assert!(column("psnr_overlap_db") > 20.0, "{} dB", column("psnr_overlap_db"));
}

#[test]
fn time_and_not_frames_holds_a_crop() {
    // At 20 Hz the panorama grows after 2 s at the earliest.
    let mut node = Harness::<Composite>::from_toml("params = { crop = \"filled\", crop_hold = 2.0 }").unwrap();
    let mut widths = Vec::new();
    for seq in 0..80 {
        show(&mut node, seq, shift(if seq == 0 { 40.0 } else { 80.0 }, 0.0));
        widths.push(node.process().unwrap().plane::<Bgr8>("panorama").unwrap().width);
    }
    let changes: Vec<usize> = (1..80).filter(|i| widths[*i] != widths[i - 1]).collect();
    assert!(changes.len() == 1 && (35..60).contains(&changes[0]), "{changes:?} of {widths:?}");
}
