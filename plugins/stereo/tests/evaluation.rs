//! `evaluate_disparity`, `evaluate_depth` and `evaluate_cloud` through the harness, with numbers that are known.

use crate::common::{SIZE, rectified};
use panoscope_node::abi::{CloudPoint, Scalar};
use panoscope_node::harness::{Harness, HarnessError, Outputs};
use panoscope_node::{Depth, Disparity, Mask};
use panoscope_stereo::{EvaluateCloud, EvaluateDepth, EvaluateDisparity};

type TestResult = Result<(), HarnessError>;

fn number(out: &Outputs, port: &str) -> Result<f64, HarnessError> {
    Ok(out.value::<Scalar>(port)?.value)
}

fn row(out: &Outputs) -> Result<Vec<f64>, HarnessError> {
    Ok(out.table("table")?.rows().next().unwrap_or_default().to_vec())
}

#[test]
fn disparities_are_counted_pixel_by_pixel() -> TestResult {
    let truth = [10.0, 10.0, 10.0, 10.0, f32::NAN, 10.0];
    let found = [10.5, 11.5, 12.5, f32::NAN, 1.0, 20.0];
    let mut node = Harness::<EvaluateDisparity>::from_toml("")?;
    let out = node
        .input_image::<Disparity>("disparity", 3, 2, &found)
        .input_image::<Disparity>("truth", 3, 2, &truth)
        .process()?;
    // Errors are 0.5, 1.5, 2.5 and 10; one of five pixels has no disparity.
    let expected = [("bad1_pct", 80.0), ("bad2_pct", 60.0), ("bad3_pct", 40.0), ("coverage_pct", 80.0)];
    for (port, value) in expected.into_iter().chain([("mean_px", 3.625), ("p95_px", 10.0)]) {
        assert!((number(&out, port)? - value).abs() < 1e-9, "{port}: {}", number(&out, port)?);
    }
    assert_eq!(out.value::<Scalar>("bad2_pct")?.unit[..2], *b"%\0");
    let names: Vec<&str> = out.table("table")?.names().collect();
    assert_eq!((names[1], names[7], row(&out)?[7]), ("bad2_pct", "pixels", 5.0));
    // The mask leaves the first pixel.
    let out = node
        .input_image::<Disparity>("disparity", 3, 2, &found)
        .input_image::<Disparity>("truth", 3, 2, &truth)
        .input_image::<Mask>("mask", 3, 2, &[255, 0, 0, 0, 255, 0])
        .process()?;
    assert_eq!((number(&out, "bad1_pct")?, number(&out, "mean_px")?, row(&out)?[7]), (0.0, 0.5, 1.0));
    // A matcher that gave nothing is wrong everywhere.
    node.input_image::<Disparity>("truth", 3, 2, &truth);
    let out = node.process_empty(&["disparity", "mask"])?;
    assert_eq!((number(&out, "bad3_pct")?, number(&out, "coverage_pct")?), (100.0, 0.0));
    assert!(number(&out, "mean_px")?.is_nan());
    // Without truth nothing is known.
    node.input_image::<Disparity>("disparity", 3, 2, &found);
    let out = node.input_image::<Disparity>("truth", 3, 2, &[f32::NAN; 6]).process()?;
    assert!(number(&out, "bad2_pct")?.is_nan() && number(&out, "coverage_pct")?.is_nan());
    let wrong = node
        .input_image::<Disparity>("disparity", 2, 3, &found)
        .input_image::<Disparity>("truth", 3, 2, &truth)
        .process();
    assert!(wrong.is_err_and(|error| error.to_string().contains("2x3")));
    Ok(())
}

#[test]
fn depth_is_counted_in_mm() -> TestResult {
    let mut node = Harness::<EvaluateDepth>::from_toml("")?;
    let out = node
        .input_image::<Depth>("depth", 3, 2, &[50.5, 49.0, 52.0, f32::NAN, 1.0, 60.0])
        .input_image::<Depth>("truth", 3, 2, &[50.0, 50.0, 50.0, 50.0, f32::NAN, 50.0])
        .process()?;
    assert_eq!(row(&out)?, [2.0, 3.375, 10.0, 80.0, 5.0]);
    assert_eq!((number(&out, "median_mm")?, number(&out, "p95_mm")?), (2.0, 10.0));
    Ok(())
}

#[test]
fn points_are_compared_with_the_nearest_surface() -> TestResult {
    let (width, height) = SIZE;
    let truth = vec![50.0f32; width * height];
    let cameras = rectified(400.0, 15.0);
    // A plane 0.5 mm behind the true one; the right half is missing.
    let point = |index: usize| {
        let (x, y) = ((index % width) as f64, (index / width) as f64);
        let z = if x < width as f64 / 2.0 { 50.5 } else { f64::NAN };
        let (x_mm, y_mm) = ((x - cameras.left.cx) / 400.0 * z, (y - cameras.left.cy) / 400.0 * z);
        CloudPoint { x_mm: x_mm as f32, y_mm: y_mm as f32, z_mm: z as f32, bgr: [0; 3], filled: 0 }
    };
    let cloud: Vec<CloudPoint> = (0..width * height).map(point).collect();
    let mut node = Harness::<EvaluateCloud>::from_toml("params = { reach_mm = 1.0 }")?;
    let out = node
        .input_cloud("cloud", width, height, &cloud)
        .input_image::<Depth>("truth", width, height, &truth)
        .input_value("calibration", cameras)
        .process()?;
    let (median, p95) = (number(&out, "median_mm")?, number(&out, "p95_mm")?);
    assert!((0.5..0.51).contains(&median) && (0.5..0.6).contains(&p95), "{median}, {p95}");
    // 1 mm is 8 pixels: as much of the right half has a point near it.
    let coverage = number(&out, "coverage_pct")?;
    assert!((50.0..55.0).contains(&coverage), "{coverage}");
    // What was filled in is not evaluated: 10 mm before the surface in all of the right half.
    let guess = |point: &CloudPoint| match point.z_mm.is_nan() {
        true => CloudPoint { x_mm: 0.0, y_mm: 0.0, z_mm: 40.0, bgr: [0; 3], filled: 1 },
        false => *point,
    };
    let guessed: Vec<CloudPoint> = cloud.iter().map(guess).collect();
    node.input_cloud("cloud", width, height, &guessed).input_image::<Depth>("truth", width, height, &truth);
    let out = node.input_value("calibration", cameras).process()?;
    assert_eq!((number(&out, "p95_mm")?, number(&out, "coverage_pct")?), (p95, coverage));
    node.input_image::<Depth>("truth", width, height, &truth).input_value("calibration", cameras);
    let out = node.process_empty(&["cloud"])?;
    assert!(number(&out, "median_mm")?.is_nan() && number(&out, "coverage_pct")? == 0.0);
    Ok(())
}
