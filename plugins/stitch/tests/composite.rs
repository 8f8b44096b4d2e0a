//! The composite as a node: what it counts.

use panoscope_node::abi::{self, Homography};
use panoscope_node::harness::Harness;
use panoscope_node::{Bgr8, Mask};
use panoscope_stitch::Composite;

const SIZE: (usize, usize) = (160, 120);

fn view() -> Vec<u8> {
    (0..SIZE.0 * SIZE.1 * 3).map(|i| (i * 7 % 251) as u8).collect()
}

/// Seams that the node has counted after so many equal frames.
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
    assert!(told.contains("`mask_left` is 8x8, `left` is 160x120"), "{told}");
}
