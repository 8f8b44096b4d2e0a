//! The composite as a node: what it counts.

use panoscope_node::Bgr8;
use panoscope_node::abi::{self, Homography};
use panoscope_node::harness::Harness;
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
