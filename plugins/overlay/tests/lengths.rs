//! Lengths are stated in mm only while the calibration fits the views.

use panoscope_node::abi::{CloudPoint, Scalar};
use panoscope_node::harness::Harness;
use panoscope_node::{Bgr8, Depth, Disparity, name16, name32};
use panoscope_overlay::colorize::Colorize;
use panoscope_overlay::turntable::Turntable;

#[test]
fn no_length_is_stated_while_the_calibration_does_not_fit() {
    let state = |value| Scalar { value, name: name32("drifted"), unit: name16("") };
    // Numbers of the scale differ with its range; nothing else does where nothing is known.
    let scale = |port: &str, high: f32, drifted: f64| {
        let params = format!("params = {{ low = 10.0, high = {high:.1}, scale_beside = true }}");
        let mut node = Harness::<Colorize>::from_toml(&params).unwrap();
        let unknown = [f32::NAN; 64 * 48];
        match port {
            "depth" => node.input_image::<Depth>("depth", 64, 48, &unknown),
            _ => node.input_image::<Disparity>("disparity", 64, 48, &unknown),
        };
        let out = node.input_value("drifted", state(drifted)).process().unwrap();
        let view = out.plane::<Bgr8>("image").unwrap();
        (0..view.height).flat_map(|y| view.row(y).to_vec()).collect::<Vec<u8>>()
    };
    assert_eq!(scale("depth", 63.0, 1.0), scale("depth", 98.0, 1.0));
    for drifted in [0.0, f64::NAN] {
        assert_ne!(scale("depth", 63.0, drifted), scale("depth", 98.0, drifted), "{drifted}");
    }
    assert_ne!(scale("disparity", 63.0, 1.0), scale("disparity", 98.0, 1.0), "px need no calibration");
    let ruled = |drifted: f64| {
        let mut node = Harness::<Turntable>::from_toml("params = { width = 160, height = 120, step = 1 }").unwrap();
        let across = |k: usize, middle: f32| (k as f32 - middle) * 0.5;
        let point = |at: usize| CloudPoint {
            x_mm: across(at % 40, 20.0),
            y_mm: across(at / 40, 15.0),
            z_mm: 50.0,
            bgr: [90; 3],
            filled: 0,
        };
        let points: Vec<CloudPoint> = (0..40 * 30).map(point).collect();
        node.input_cloud("cloud", 40, 30, &points).input_value("drifted", state(drifted));
        let out = node.process().unwrap();
        out.plane::<Bgr8>("image").unwrap().data.as_chunks::<3>().0.iter().filter(|p| **p == [230; 3]).count()
    };
    assert!(ruled(0.0) > 20 && ruled(1.0) == 0, "{} and {}", ruled(0.0), ruled(1.0));
}
