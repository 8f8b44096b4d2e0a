//! `rectify`, `reproject` and `measure` through the harness.

use crate::common::{SIZE, bgr, pair, rectified};
use panoscope_imaging::stereo::CalibrationError;
use panoscope_node::abi::{Calibration, Scalar};
use panoscope_node::harness::{Harness, HarnessError, Level, Setup};
use panoscope_node::{Bgr8, Confidence, Depth, Disparity, Gray8};
use panoscope_stereo::{Measure, Rectify, Reproject};

type TestResult = Result<(), HarnessError>;

const FOCAL: f64 = 400.0;
const BASELINE: f64 = 15.0;

fn words<T>(result: Result<T, HarnessError>) -> String {
    result.err().map(|error| error.to_string()).unwrap_or_default()
}

/// Gives a node both views of [`pair`].
fn give<'h>(node: &'h mut Harness<Rectify>, left: &[u8], right: &[u8]) -> &'h mut Harness<Rectify> {
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &bgr(left)).input_image::<Bgr8>(
        "right",
        SIZE.0,
        SIZE.1,
        &bgr(right),
    )
}

fn rectify(
    calibration: Option<Calibration>,
    size: (usize, usize),
) -> Result<panoscope_node::harness::Outputs, HarnessError> {
    let mut node = Harness::<Rectify>::from_toml("")?;
    let pixels = vec![9; 3 * size.0 * size.1];
    node.input_image::<Bgr8>("left", size.0, size.1, &pixels).input_image::<Bgr8>("right", size.0, size.1, &pixels);
    if let Some(calibration) = calibration {
        node.input_value("calibration", calibration);
    }
    node.process()
}

#[test]
fn rectified_views_are_handed_on() -> TestResult {
    let (left, right) = pair(|_, _| 40.0, 0.0);
    // A file does not say that views are rectified; level cameras without distortion say it too.
    for is_rectified in [1, 0] {
        let mut node = Harness::<Rectify>::from_toml("")?;
        let cameras = Calibration { is_rectified, ..rectified(FOCAL, BASELINE) };
        for _ in 0..2 {
            let out = give(&mut node, &left, &right).input_value("calibration", cameras).process()?;
            assert_eq!(out.plane::<Bgr8>("left")?.data, bgr(&left));
            assert_eq!(out.plane::<Bgr8>("right")?.data, bgr(&right));
            assert_eq!(out.value::<Calibration>("calibration")?.is_rectified, 1);
        }
        assert_eq!((node.copies(), node.allocated_bytes()), (0, 2 * size_of::<Calibration>() as u64));
    }
    Ok(())
}

#[test]
fn views_without_a_calibration_pass_until_one_arrives() -> TestResult {
    let (left, right) = pair(|_, _| 40.0, 0.0);
    let mut node = Harness::<Rectify>::from_toml("params = { uncalibrated = \"pass\" }")?;
    for is_given in [false, false, true, false] {
        give(&mut node, &left, &right);
        if is_given {
            node.input_value("calibration", rectified(FOCAL, BASELINE));
        }
        let is_known = is_given || node.logs().iter().any(|line| line.message.contains("has arrived: the views are"));
        let out = node.process()?;
        assert_eq!(out.plane::<Bgr8>("left")?.data, bgr(&left));
        assert_eq!(out.plane::<Bgr8>("right")?.data, bgr(&right));
        assert_eq!(out.is_empty("calibration")?, !is_known);
    }
    let warned: Vec<_> = node.logs().iter().filter(|line| line.level == Level::Warn).collect();
    assert!(warned.len() == 1 && warned[0].message.contains("no calibration has arrived"), "{warned:?}");
    // The graph is told too, and by default it is refused.
    let connected = ["left", "right"];
    let told = |toml: &str| format!("{:?}", Harness::<Rectify>::problems(&Setup::new(toml), &connected));
    assert!(told("params = { uncalibrated = \"pass\" }").contains("the views stay as they are"));
    assert!(told("").contains("there is no calibration to rectify by"));
    Ok(())
}

#[test]
fn turned_cameras_are_turned_back() -> TestResult {
    // The right camera stands 2 rows too low; the calibration says so by its principal row.
    let (left, right) = pair(|_, _| 40.0, 2.0);
    let mut cameras = rectified(FOCAL, BASELINE);
    cameras.is_rectified = 0;
    cameras.right.cy += 2.0;
    let mut node = Harness::<Rectify>::from_toml("")?;
    let out = give(&mut node, &left, &right).input_value("calibration", cameras).process()?;
    let (left, right) = (out.plane::<Bgr8>("left")?, out.plane::<Bgr8>("right")?);
    let mut worst = 0;
    for y in 10..SIZE.1 - 10 {
        for x in 10..SIZE.0 - 60 {
            worst = worst.max(left.row(y)[3 * (x + 40)].abs_diff(right.row(y)[3 * x]));
        }
    }
    assert!(worst <= 2, "rows differ by {worst} levels");
    assert_eq!(out.value::<Calibration>("calibration")?.is_rectified, 1);

    // Without a stated rectification it is computed; the last calibration stays in use.
    cameras.left_projection = [0.0; 12];
    cameras.right_projection = [0.0; 12];
    let pixels = bgr(&pair(|_, _| 40.0, 2.0).0);
    let mut again = |given: bool| {
        node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &pixels).input_image::<Bgr8>("right", SIZE.0, SIZE.1, &pixels);
        if given {
            node.input_value("calibration", cameras);
        }
        node.process()
    };
    let first = again(true)?.value::<Calibration>("calibration")?;
    let held = again(false)?.value::<Calibration>("calibration")?;
    assert_eq!(first.left_projection, held.left_projection);
    assert!((first.baseline_mm - BASELINE).abs() < 1e-9, "{}", first.baseline_mm);
    Ok(())
}

#[test]
fn views_are_shrunk_with_their_calibration() -> TestResult {
    let (left, right) = pair(|_, _| 40.0, 2.0);
    // Level cameras, cameras that are turned on the way, and views that another program has rectified.
    let mut turned = rectified(FOCAL, BASELINE);
    turned.is_rectified = 0;
    turned.right.cy += 2.0;
    let level = rectified(FOCAL, BASELINE);
    for (cameras, more, low_px) in [(level, "", 2.0), (turned, "", 0.0), (level, ", bypass = true", 2.0)] {
        let mut node = Harness::<Rectify>::from_toml(&format!("params = {{ scale = 2{more} }}"))?;
        let out = give(&mut node, &left, &right).input_value("calibration", cameras).process()?;
        let small = out.value::<Calibration>("calibration")?;
        assert_eq!((small.left.width as usize, small.right.height as usize), (SIZE.0 / 2, SIZE.1 / 2));
        assert_eq!((small.left_projection[0], small.baseline_mm), (FOCAL / 2.0, BASELINE));
        let ray = |camera: &[f64; 12], px: f64| (px - camera[2]) / camera[0];
        assert!((ray(&small.left_projection, 10.0) - ray(&cameras.left_projection, 20.5)).abs() < 1e-12);
        let (left, right) = (out.plane::<Bgr8>("left")?, out.plane::<Bgr8>("right")?);
        assert_eq!((left.width, left.height), (SIZE.0 / 2, SIZE.1 / 2));
        let mut worst = 0;
        for y in 5..SIZE.1 / 2 - 5 {
            for x in 5..SIZE.0 / 2 - 30 {
                worst = worst.max(left.row(y)[3 * (x + 20)].abs_diff(right.row(y + low_px as usize / 2)[3 * x]));
            }
        }
        assert!(worst <= 2, "{cameras:?}: rows differ by {worst} levels");
    }
    // 0 follows the width.
    let mut node = Harness::<Rectify>::from_toml("params = { scale = 0, uncalibrated = \"pass\" }")?;
    for (width, shown) in [(1280, 1280), (1920, 960), (3840, 1280)] {
        let pixels = vec![9; 3 * width * 8];
        node.input_image::<Bgr8>("left", width, 8, &pixels).input_image::<Bgr8>("right", width, 8, &pixels);
        let out = node.process()?;
        assert_eq!((out.plane::<Bgr8>("left")?.width, out.plane::<Bgr8>("right")?.width), (shown, shown));
    }
    let mut node = Harness::<Rectify>::from_toml("params = { scale = 8, uncalibrated = \"pass\" }")?;
    node.input_image::<Bgr8>("left", 7, 7, &[0; 147]).input_image::<Bgr8>("right", 7, 7, &[0; 147]);
    assert!(words(node.process()).contains("cannot be shrunk by 8"));
    Ok(())
}

#[test]
fn calibrations_that_cannot_be_are_refused() {
    let good = rectified(FOCAL, BASELINE);
    let refused = |calibration: Calibration| words(rectify(Some(calibration), SIZE));
    assert!(words(rectify(None, SIZE)).contains("no calibration has arrived"));
    assert!(words(rectify(Some(good), (64, 48))).contains("left view is 64x48, the calibration was made for 320x128"));
    let mut bad = good;
    bad.right_projection[3] = -bad.right_projection[3];
    assert!(refused(bad).contains("disparities would be negative"), "{}", refused(bad));
    bad.right_projection[3] = 0.0;
    assert!(refused(bad).contains("baseline"));
    let mut bad = good;
    bad.right_projection[6] += 3.0;
    assert!(refused(bad).contains("principal rows"));
    let mut bad = good;
    bad.left_projection[0] = f64::NAN;
    assert!(refused(bad).contains("not finite"));
    let mut bad = good;
    (bad.is_rectified, bad.left.fx) = (0, -4.0);
    assert!(refused(bad).contains("focal lengths"));
    let mut bad = good;
    (bad.is_rectified, bad.left.distortion[12]) = (0, 0.1);
    assert!(refused(bad).contains("tilted sensor"));
}

/// Disparity of a plane of which depth grows to the right.
fn slope(x: usize, y: usize) -> f32 {
    120.0 - 0.1 * x as f32 + 0.02 * y as f32
}

fn slope_map() -> Vec<f32> {
    (0..SIZE.0 * SIZE.1).map(|index| slope(index % SIZE.0, index / SIZE.0)).collect()
}

/// Where pixel (u, v) of the slope lies, mm.
fn truth(u: f64, v: f64) -> [f64; 3] {
    let z = FOCAL * BASELINE / (120.0 - 0.1 * u + 0.02 * v);
    [(u - SIZE.0 as f64 / 2.0) / FOCAL * z, (v - SIZE.1 as f64 / 2.0) / FOCAL * z, z]
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn disparities_become_millimetres() -> TestResult {
    let gray = vec![50; SIZE.0 * SIZE.1];
    let mut map = slope_map();
    map[30 * SIZE.0 + 200] = f32::NAN;
    map[70 * SIZE.0 + 100] = 300.0;
    for setup in [Setup::new(""), Setup::new("").read_only(&["cloud"]), Setup::new("").threads(3)] {
        let mut node = Harness::<Reproject>::open(setup)?;
        let out = node
            .input_image::<Gray8>("image", SIZE.0, SIZE.1, &gray)
            .input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &map)
            .input_value("calibration", rectified(FOCAL, BASELINE))
            .process()?;
        let cloud = out.cloud("cloud")?;
        for (u, v) in [(10, 5), (160, 64), (310, 120)] {
            let point = cloud[v * SIZE.0 + u];
            let found = [f64::from(point.x_mm), f64::from(point.y_mm), f64::from(point.z_mm)];
            assert!(apart(found, truth(u as f64, v as f64)) < 1e-3, "{found:?}");
            assert_eq!(point.bgr, [50; 3]);
        }
        // An unknown pixel and a flying one are filled in with the slope around them.
        for (u, v) in [(200, 30), (100, 70)] {
            let point = cloud[v * SIZE.0 + u];
            let found = [point.x_mm, point.y_mm, point.z_mm].map(f64::from);
            assert!(point.filled == 1 && apart(found, truth(u as f64, v as f64)) < 1e-2, "{point:?}");
        }
        assert_eq!(cloud.iter().filter(|point| point.filled != 0).count(), 2);
        if !out.is_empty("depth")? {
            let depth = out.plane::<Depth>("depth")?;
            assert!(depth.row(30)[200].is_nan() && depth.row(70)[100].is_nan(), "depths are measured");
            assert!((f64::from(depth.row(64)[160]) - truth(160.0, 64.0)[2]).abs() < 1e-3);
        }
    }
    Ok(())
}

#[test]
fn holes_are_filled_up_to_a_size_and_not_at_all_when_it_is_0() -> TestResult {
    let gray = vec![50; SIZE.0 * SIZE.1];
    // 5 x 6 pixels, 0.0007 of the view, and 12 x 12, 0.0035 of it; a reach of one pixel around goes too.
    let mut map = slope_map();
    for at in (20..25).flat_map(|y| (100..106).map(move |x| y * SIZE.0 + x)) {
        map[at] = f32::NAN;
    }
    for at in (60..72).flat_map(|y| (200..212).map(move |x| y * SIZE.0 + x)) {
        map[at] = f32::NAN;
    }
    let filled = |params: &str| -> Result<Vec<(usize, usize)>, HarnessError> {
        let out = Harness::<Reproject>::from_toml(params)?
            .input_image::<Gray8>("image", SIZE.0, SIZE.1, &gray)
            .input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &map)
            .input_value("calibration", rectified(FOCAL, BASELINE))
            .process()?;
        let cloud = out.cloud("cloud")?;
        let marked = cloud.iter().enumerate().filter(|(_, point)| point.filled == 1);
        assert!(marked.clone().all(|(_, point)| point.is_known() && !point.is_measured() && point.bgr == [50; 3]));
        Ok(marked.map(|(at, _)| (at % SIZE.0, at / SIZE.0)).collect())
    };
    let small = filled("")?;
    assert!((30..=60).contains(&small.len()), "{}", small.len());
    assert!(small.iter().all(|(x, y)| (98..108).contains(x) && (18..27).contains(y)), "{small:?}");
    assert!(filled("params = { max_hole = 0.05 }")?.contains(&(205, 65)));
    assert!(filled("params = { max_hole = 0.0 }")?.is_empty());
    Ok(())
}

#[test]
fn reproject_refuses_what_does_not_fit() -> TestResult {
    let gray = vec![50; SIZE.0 * SIZE.1];
    let map = slope_map();
    let mut node = Harness::<Reproject>::from_toml("")?;
    let mut run = |calibration: Calibration, height: usize| {
        node.input_image::<Gray8>("image", SIZE.0, height, &gray)
            .input_image::<Disparity>("disparity", SIZE.0, height, &map)
            .input_value("calibration", calibration)
            .process()
    };
    let good = rectified(FOCAL, BASELINE);
    let raw = words(run(Calibration { is_rectified: 0, ..good }, SIZE.1));
    assert!(raw.contains("not rectified"), "{raw}");
    let small = words(run(good, 100));
    assert!(small.contains("320x100"), "{small}");
    run(good, SIZE.1)?;
    Ok(())
}

/// Depths of the slope, with noise of its disparities that repeats: +, 0, - by a hash of the place.
fn slope_depth(noise_px: f32) -> Vec<f32> {
    let noisy = |index: usize| noise_px * ((index * 2_654_435_761) % 3) as f32 - noise_px;
    let depth = |(index, disparity): (usize, &f32)| (FOCAL * BASELINE) as f32 / (disparity + noisy(index));
    slope_map().iter().enumerate().map(depth).collect()
}

fn measure(toml: &str, noise_px: f32) -> Result<Vec<Vec<f64>>, HarnessError> {
    let depth = slope_depth(noise_px);
    let mut node = Harness::<Measure>::from_toml(toml)?;
    let out = node
        .input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth)
        .input_value("calibration", rectified(FOCAL, BASELINE))
        .process()?;
    Ok(out.table("table")?.rows().map(<[f64]>::to_vec).collect())
}

#[test]
fn lengths_depths_and_angles_are_right() -> TestResult {
    let (a, b, c) = (truth(40.0, 30.0), truth(280.5, 90.25), truth(150.0, 110.0));
    let rows = measure("params = { points = [40, 30, 280.5, 90.25] }", 0.0)?;
    assert_eq!(rows.len(), 1);
    assert!((rows[0][4] - apart(a, b)).abs() < 1e-3, "{rows:?} {}", apart(a, b));
    assert!(rows[0][5] > 0.0 && rows[0][5] < 2.0, "{rows:?}");

    let rows = measure("params = { kind = \"polyline\", points = [40, 30, 280.5, 90.25, 150, 110] }", 0.0)?;
    assert_eq!(rows.len(), 2);
    assert!((rows[1][6] - apart(a, b) - apart(b, c)).abs() < 1e-3, "{rows:?}");
    assert!(rows[1][7] > rows[0][7]);

    let rows = measure("params = { kind = \"depth\", points = [40, 30, 150, 110] }", 0.0)?;
    assert!((rows[0][2] - a[2]).abs() < 1e-4 && (rows[1][2] - c[2]).abs() < 1e-4, "{rows:?}");

    let rows = measure("params = { kind = \"angle\", points = [40, 30, 280.5, 90.25, 150, 110] }", 0.0)?;
    let (ab, cb, ac) = (apart(a, b), apart(c, b), apart(a, c));
    let angle = ((ab * ab + cb * cb - ac * ac) / (2.0 * ab * cb)).acos().to_degrees();
    assert!((rows[0][6] - angle).abs() < 1e-2, "{rows:?} {angle}");
    Ok(())
}

#[test]
fn the_stated_error_follows_the_noise() -> TestResult {
    let toml = "params = { points = [40, 30, 280, 90] }";
    let (quiet, loud) = (measure(toml, 0.0)?, measure(toml, 0.8)?);
    assert!(loud[0][5] > 1.5 * quiet[0][5], "{quiet:?} {loud:?}");
    let length = apart(truth(40.0, 30.0), truth(280.0, 90.0));
    assert!((loud[0][4] - length).abs() < loud[0][5], "{loud:?} {length}");
    Ok(())
}

#[test]
fn a_calibration_that_states_its_error_is_taken_at_its_word() -> TestResult {
    let depth = slope_depth(0.0);
    let mut node = Harness::<Measure>::from_toml("params = { points = [40, 30, 280, 90] }")?;
    let mut bound = |scale_percent: f64, stated: bool| -> Result<f64, HarnessError> {
        let error = CalibrationError { offset_px: 0.01, scale_percent, point_px: 0.01, neutral_mm: 50.0 };
        let calibration = Calibration {
            rms_px: 2.0,
            stated_error: if stated { error.bits() } else { 0 },
            ..rectified(FOCAL, BASELINE)
        };
        let out = node
            .input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth)
            .input_image::<Confidence>("confidence", SIZE.0, SIZE.1, &vec![1.0; SIZE.0 * SIZE.1])
            .input_value("calibration", calibration)
            .process()?;
        Ok(out.table("table")?.rows().map(|row| row[5]).sum())
    };
    let (unstated, small, large) = (bound(0.01, false)?, bound(0.01, true)?, bound(5.0, true)?);
    assert!(unstated > 2.0 * small, "{unstated} and {small} mm");
    let length = apart(truth(40.0, 30.0), truth(280.0, 90.0));
    assert!((large / length - 0.1).abs() < 0.01, "{large} of {length} mm");
    Ok(())
}

#[test]
fn the_stated_error_grows_where_the_confidence_is_low() -> TestResult {
    let depth = slope_depth(0.5);
    let mut node = Harness::<Measure>::from_toml("params = { points = [40, 30, 280, 90] }")?;
    let mut stated = |confidence: f32, height: usize| -> Result<f64, HarnessError> {
        let trust = vec![confidence; SIZE.0 * height];
        let out = node
            .input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth)
            .input_image::<Confidence>("confidence", SIZE.0, height, &trust)
            .input_value("calibration", rectified(FOCAL, BASELINE))
            .process()?;
        Ok(out.table("table")?.rows().map(|row| row[5]).sum())
    };
    let (full, low, unknown) = (stated(1.0, SIZE.1)?, stated(0.3, SIZE.1)?, stated(f32::NAN, SIZE.1)?);
    assert!(low > 4.0 * full, "{full} and {low} mm");
    assert!((2.0 * full..low).contains(&unknown), "{full}, {unknown} and {low} mm");
    let wrong = stated(1.0, 60).map_err(|error| error.to_string());
    assert!(wrong.as_ref().is_err_and(|text| text.contains("320x60")), "{wrong:?}");
    Ok(())
}

#[test]
fn nothing_is_measured_while_the_calibration_does_not_fit() -> TestResult {
    let depth: Vec<f32> = slope_map().iter().map(|disparity| (FOCAL * BASELINE) as f32 / disparity).collect();
    let mut node = Harness::<Measure>::from_toml("params = { points = [40, 30, 280, 90] }")?;
    for (drifted, known) in [(0.0, true), (1.0, false), (f64::NAN, true), (0.0, true)] {
        let state = Scalar { value: drifted, name: [0; 32], unit: [0; 16] };
        let out = node
            .input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth)
            .input_value("calibration", rectified(FOCAL, BASELINE))
            .input_value("drifted", state)
            .process()?;
        let rows: Vec<_> = out.table("table")?.rows().map(<[f64]>::to_vec).collect();
        assert_eq!(rows.len(), 1);
        assert!(rows[0][4..].iter().all(|value| value.is_finite() == known), "{drifted}: {rows:?}");
        assert_eq!(out.text("text")?.is_empty(), known, "{drifted}: {}", out.text("text")?);
    }
    Ok(())
}

#[test]
fn unknown_points_and_odd_lists_are_told() -> TestResult {
    let mut depth = vec![60.0; SIZE.0 * SIZE.1];
    (0..40 * SIZE.0).for_each(|index| depth[index] = f32::NAN);
    let toml = "params = { points = [20, 20, 100, 100, 200, 100] }";
    let mut node = Harness::<Measure>::from_toml(toml)?;
    let out = node
        .input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth)
        .input_value("calibration", rectified(FOCAL, BASELINE))
        .process()?;
    let rows: Vec<_> = out.table("table")?.rows().map(<[f64]>::to_vec).collect();
    assert_eq!(rows.len(), 1);
    assert!(rows[0][4].is_nan() && rows[0][5].is_nan());
    assert_eq!(node.metric("unknown_points"), Some(1.0));
    assert_eq!(node.logs().iter().filter(|line| line.level == Level::Warn).count(), 1, "{:?}", node.logs());

    let mut empty = Harness::<Measure>::from_toml("")?;
    let out = empty
        .input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth)
        .input_value("calibration", rectified(FOCAL, BASELINE))
        .process()?;
    assert_eq!(out.table("table")?.rows().count(), 0);
    let alone = words(empty.input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth).process());
    // The calibration seen before stays in use.
    assert_eq!(alone, "");
    let mut fresh = Harness::<Measure>::from_toml("")?;
    let alone = words(fresh.input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth).process());
    assert!(alone.contains("connect `calibration`"), "{alone}");
    Ok(())
}

#[test]
fn a_cloud_needs_no_calibration_but_states_no_error() -> TestResult {
    use panoscope_node::abi::CloudPoint;
    let point = |index: usize| {
        let [x, y, z] = truth((index % SIZE.0) as f64, (index / SIZE.0) as f64).map(|value| value as f32);
        CloudPoint { x_mm: x, y_mm: y, z_mm: z, bgr: [0; 3], filled: 0 }
    };
    let cloud: Vec<CloudPoint> = (0..SIZE.0 * SIZE.1).map(point).collect();
    let mut node = Harness::<Measure>::from_toml("params = { points = [40, 30, 280.5, 90.25] }")?;
    let out = node.input_cloud("cloud", SIZE.0, SIZE.1, &cloud).process()?;
    let table = out.table("table")?;
    let row = table.rows().next().map(<[f64]>::to_vec).unwrap_or_default();
    assert!((row[4] - apart(truth(40.0, 30.0), truth(280.5, 90.25))).abs() < 1e-3, "{row:?}");
    assert!(row[5].is_nan());
    // No length is taken from points that were filled in, however they lie.
    let near = |at: usize| (at % SIZE.0).abs_diff(40) <= 12 && (at / SIZE.0).abs_diff(30) <= 12;
    let guessed = |(at, point): (usize, &CloudPoint)| CloudPoint { filled: u8::from(near(at)), ..*point };
    let cloud: Vec<CloudPoint> = cloud.iter().enumerate().map(guessed).collect();
    let out = node.input_cloud("cloud", SIZE.0, SIZE.1, &cloud).process()?;
    let length = out.table("table")?.rows().next().map_or(f64::NAN, |row| row[4]);
    assert!(length.is_nan(), "{length}");
    Ok(())
}

#[test]
fn tips_and_boxes_are_points_too() -> TestResult {
    use panoscope_node::abi::{Detection, Tip};
    let depth: Vec<f32> = slope_map().iter().map(|disparity| (FOCAL * BASELINE) as f32 / disparity).collect();
    let tip =
        Tip { u_px: 280.5, v_px: 90.25, xyz_mm: [f64::NAN; 3], score: 1.0, class_index: 0, xyz_valid: 0, track_id: 1 };
    // Held 10 mm before the tissue: its own place counts, not the tissue's.
    let (a, b) = (truth(40.0, 30.0), truth(280.5, 90.25));
    let held = b.map(|part| part * (b[2] - 10.0) / b[2]);
    let above = Tip { xyz_mm: held, xyz_valid: 1, ..tip };
    for (tip, to) in [(tip, b), (above, held)] {
        let mut node = Harness::<Measure>::from_toml("params = { points = [40, 30] }")?;
        let out = node
            .input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth)
            .input_value("calibration", rectified(FOCAL, BASELINE))
            .input_value("tips", tip)
            .process()?;
        let row = out.table("table")?.rows().next().map(<[f64]>::to_vec).unwrap_or_default();
        assert!((row[4] - apart(a, to)).abs() < 1e-3 && row[5] > 0.0, "{row:?} {}", apart(a, to));
    }
    let square = |u: f32, v: f32| Detection {
        x_px: u - 10.0,
        y_px: v - 6.0,
        width_px: 20.0,
        height_px: 12.0,
        score: 0.9,
        class_index: 0,
        track_id: -1,
    };
    let mut node = Harness::<Measure>::from_toml("params = { kind = \"distance\" }")?;
    let boxes = [square(40.0, 30.0), square(280.5, 90.25)];
    let out = node
        .input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth)
        .input_value("calibration", rectified(FOCAL, BASELINE))
        .input_detections("detections", &boxes, "grasper", SIZE)
        .process()?;
    let row = out.table("table")?.rows().next().map(<[f64]>::to_vec).unwrap_or_default();
    assert!((row[4] - apart(a, b)).abs() < 1e-3, "{row:?} {}", apart(a, b));
    // A tip that is not there leaves its pair unknown.
    let mut node = Harness::<Measure>::from_toml("params = { points = [40, 30] }")?;
    let out = node
        .input_image::<Depth>("depth", SIZE.0, SIZE.1, &depth)
        .input_value("calibration", rectified(FOCAL, BASELINE))
        .input_empty("tips")
        .process()?;
    let row = out.table("table")?.rows().next().map(<[f64]>::to_vec).unwrap_or_default();
    assert!(row[4].is_nan() && row[2].is_nan(), "{row:?}");
    Ok(())
}
