//! A composite on the GPU: equal to the processor's except for rounding; without a GPU the processor draws.

use panoscope_node::Bgr8;
use panoscope_node::abi::{self, Homography};
use panoscope_node::harness::{Harness, Level, lend_device};

use crate::support::table;
use panoscope_stitch::Composite;

const SIZE: (usize, usize) = (200, 120);

fn view(shift: f64) -> Vec<u8> {
    let at = |i: usize| ((i % SIZE.0) as f64 + shift, (i / SIZE.0) as f64);
    let wave = |(x, y): (f64, f64)| 50.0 * (0.11 * x).sin() + 30.0 * (0.09 * y + 0.02 * x).cos();
    (0..SIZE.0 * SIZE.1).flat_map(|i| [100.0, 120.0, 140.0].map(|base| (base + wave(at(i))) as u8)).collect()
}

#[test]
fn a_panorama_hardly_depends_on_the_device() {
    let map = [1.01, 0.02, 90.0, -0.01, 0.99, 3.0, 1e-5, -2e-5, 1.0];
    let homography = Homography { left_from_right: map, rms_px: 0.5, inliers: 100, state: abi::STATE_FRESH };
    let gpu = table();
    lend_device(gpu);
    let mut made = Vec::new();
    for device in ["cpu", "gpu"] {
        let mut node = Harness::<Composite>::from_toml(&format!("params = {{ device = \"{device}\" }}")).unwrap();
        node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &view(0.0));
        node.input_image::<Bgr8>("right", SIZE.0, SIZE.1, &view(90.0));
        let out = node.input_value("homography", homography).process().unwrap();
        made.push(out.plane::<Bgr8>("panorama").unwrap().data.to_vec());
        let lines: Vec<_> = node.logs().iter().map(|line| (line.level, line.message.as_str())).collect();
        match (device, &lines[..]) {
            ("cpu", []) => {}
            ("gpu", [(Level::Info, message)]) if gpu.is_some() => {
                assert!(message.starts_with("computes on "), "{message}")
            }
            ("gpu", [(Level::Warn, message)]) if gpu.is_none() => {
                assert!(message.contains("the processor computes the images: "), "{message}");
                assert!(made[0] == made[1]);
            }
            _ => panic!("{device}: {lines:?}"),
        }
    }
    assert_eq!(made[0].len(), made[1].len());
    assert!(made[0].iter().zip(&made[1]).all(|(a, b)| a.abs_diff(*b) <= 3));
}
