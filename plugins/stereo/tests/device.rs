//! Nodes on the GPU: the same bytes as on the processor, which also does the work where there is none.

use std::ffi::c_void;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::common::{SIZE, bgr, pair, rectified};
use crate::gpu::support::table;
use crate::lit::round_pair;
use panoscope_node::abi::{self, Calibration, CloudPoint, Device, DeviceStep, Status, Tip};
use panoscope_node::harness::{Harness, HarnessError, Level, Setup, lend_device};
use panoscope_node::{Bgr8, Confidence, Depth, Disparity, Gray8, Mask, View};
use panoscope_stereo::{DisparityWls, Measure, Rectify, Reproject, StereoBm};

type TestResult = Result<(), HarnessError>;

/// The device that a node computes on: a GPU if this process has one, otherwise the processor, with a warning.
fn check_device<N>(node: &Harness<N>, has_gpu: bool) {
    let lines: Vec<_> = node.logs().iter().map(|line| (line.level, line.message.as_str())).collect();
    let others = lines.iter().skip(1).all(|(level, _)| *level == Level::Info);
    let on_gpu = matches!(lines.first(), Some((Level::Info, message)) if message.starts_with("computes on ")) && others;
    let without = matches!(lines.first(), Some((Level::Warn, message)) if message.contains("the processor computes the images: "))
        && others;
    assert!(if has_gpu { on_gpu } else { without }, "{lines:?}");
}

/// The GPU is that of the process: one test at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A GPU for the nodes of this process, and none.
fn devices() -> Vec<Option<&'static Device>> {
    vec![table(), None]
}

/// Submissions that a device of [`failing`] still takes.
static TAKEN: AtomicUsize = AtomicUsize::new(0);

unsafe extern "C" fn submit_some(ctx: *mut c_void, steps: *const DeviceStep, len: usize) -> Status {
    let is_taken = TAKEN.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_ok();
    match table().and_then(|table| table.submit).filter(|_| is_taken) {
        // SAFETY: the arguments are those of the device that this one stands for.
        Some(submit) => unsafe { submit(ctx, steps, len) },
        None => abi::STATUS_ERROR,
    }
}

/// The device of this process, until it fails after some submissions; `None` without one.
fn failing(after: usize) -> Option<&'static Device> {
    let table = table()?;
    TAKEN.store(after, Ordering::Relaxed);
    Some(Box::leak(Box::new(Device { submit: Some(submit_some), ..*table })))
}

#[test]
fn the_processor_matches_what_a_device_fails_to_match() -> TestResult {
    let _alone = alone();
    let (left, right) = pair(|x, _| 30.0 + x / 40.0, 0.0);
    for scale in [1, 2] {
        let mut expected = Vec::new();
        for after in [usize::MAX, 0, 1, 2, 4, 7, 9, 40] {
            let Some(device) = failing(after) else { return Ok(()) };
            lend_device(Some(device));
            let name = if after == usize::MAX { "cpu" } else { "gpu" };
            let params = format!("params = {{ search_px = 64, scale = {scale}, device = \"{name}\" }}");
            let mut node = Harness::<StereoBm>::from_toml(&params)?;
            for call in 0..2 {
                node.input_image::<Gray8>("left", SIZE.0, SIZE.1, &left);
                let out = node.input_image::<Gray8>("right", SIZE.0, SIZE.1, &right).process()?;
                let map = out.plane::<Disparity>("disparity")?.data.to_vec();
                if after == usize::MAX {
                    expected.push(map);
                    continue;
                }
                for (found, expected) in map.iter().zip(&expected[call]) {
                    let is_same = (found.is_nan() && expected.is_nan()) || (found - expected).abs() < 1e-3;
                    assert!(is_same, "scale {scale}, after {after}: {found} and not {expected}");
                }
            }
            let warnings = node.logs().iter().filter(|line| line.level == Level::Warn).count();
            assert_eq!(warnings, usize::from(after < 30), "scale {scale}, after {after}: {:?}", node.logs());
        }
    }
    Ok(())
}

#[test]
fn rectified_views_do_not_depend_on_the_device() -> TestResult {
    let _alone = alone();
    let (left, right) = round_pair();
    let mut cameras = Calibration { is_rectified: 0, ..rectified(300.0, 15.0) };
    cameras.left.distortion[0] = -0.1;
    cameras.right.distortion[1] = 0.05;
    for (scale, gpu) in [1, 2].into_iter().flat_map(|scale| devices().into_iter().map(move |gpu| (scale, gpu))) {
        lend_device(gpu);
        let mut made = Vec::new();
        for device in ["cpu", "gpu"] {
            let mut node =
                Harness::<Rectify>::from_toml(&format!("params = {{ scale = {scale}, device = \"{device}\" }}"))?;
            for _ in 0..2 {
                node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &bgr(&left));
                node.input_image::<Bgr8>("right", SIZE.0, SIZE.1, &bgr(&right));
                let out = node.input_value("calibration", cameras).process()?;
                let mut planes = Vec::new();
                for side in ["left", "right"] {
                    planes.push(out.plane::<Bgr8>(side)?.data.to_vec());
                    let mask = format!("mask_{side}");
                    let is_lit = out.is_empty(&mask)?;
                    planes.push(if is_lit { Vec::new() } else { out.plane::<Mask>(&mask)?.data.to_vec() });
                }
                made.push(planes);
            }
            if device == "gpu" {
                check_device(&node, gpu.is_some());
            }
        }
        assert!(made[0][0].iter().any(|value| *value > 0));
        assert!([1, 3].iter().all(|mask| made[0][*mask].contains(&0)), "there is a rim");
        assert!(made[..2] == made[2..], "scale {scale}");
    }
    Ok(())
}

/// A size whose columns are no whole groups of four, and no whole blocks of 2, 3 or 4.
const ODD: (usize, usize) = (317, 125);

/// That part of a gray view.
fn odd_part(view: &[u8]) -> Vec<u8> {
    view.chunks_exact(SIZE.0).take(ODD.1).flat_map(|row| row[..ODD.0].iter().copied()).collect()
}

/// A gray view of that size.
fn odd_view() -> Vec<u8> {
    odd_part(&pair(|_, _| 40.0, 0.0).0)
}

/// A mask of a disc there.
fn odd_mask(centre_x: f32) -> Vec<u8> {
    let inside = |i: usize| ((i % ODD.0) as f32 - centre_x).hypot((i / ODD.0) as f32 - 64.0) < 70.0;
    (0..ODD.0 * ODD.1).map(|i| u8::from(inside(i))).collect()
}

/// A map without the padding of its rows.
fn values(map: View<'_, f32>) -> Vec<f32> {
    (0..map.height).flat_map(|y| map.row(y).iter().copied()).collect()
}

/// Both maps of a pair that is cut to an odd size, twice; with masks where asked for.
fn matched(node: &mut Harness<StereoBm>, views: [&[u8]; 2], has_masks: bool) -> Result<[Vec<f32>; 2], HarnessError> {
    let mut made = Default::default();
    for _ in 0..2 {
        for (side, view) in ["left", "right"].into_iter().zip(views) {
            node.input_image::<Gray8>(side, ODD.0, ODD.1, &odd_part(view));
            if has_masks {
                let centre_x = if side == "left" { 160.0 } else { 150.0 };
                node.input_image::<Mask>(&format!("mask_{side}"), ODD.0, ODD.1, &odd_mask(centre_x));
            }
        }
        let out = node.process()?;
        made = [values(out.plane::<Disparity>("disparity")?), values(out.plane::<Disparity>("disparity_right")?)];
    }
    Ok(made)
}

#[test]
fn disparities_do_not_depend_on_the_device() -> TestResult {
    let _alone = alone();
    let slope = pair(|x, _| 30.0 + x / 40.0, 0.0);
    // More disparities than one search holds.
    let step = pair(|x, _| if x < 110.0 { 15.0 } else { 95.0 }, 0.0);
    for (scale, gpu) in (1..=4).flat_map(|scale| devices().into_iter().map(move |gpu| (scale, gpu))) {
        lend_device(gpu);
        for ((left, right), has_masks, params) in [
            (&slope, false, "search_px = 64"),
            (&slope, true, "search_px = 64, speckle_area_px = 40"),
            (&step, false, "search_px = 32"),
            (&step, true, "search_px = 32, left_right_px = -1"),
        ] {
            let [cpu, there] = ["cpu", "gpu"].map(|device| {
                let params = format!("params = {{ {params}, scale = {scale}, device = \"{device}\" }}");
                let mut node = Harness::<StereoBm>::open(Setup::new(&params))?;
                let made = matched(&mut node, [left, right], has_masks)?;
                let tiles = node.metric("tiles");
                assert_eq!(tiles.is_some_and(|tiles| tiles > 0.0), params.contains("search_px = 32"), "{tiles:?}");
                if device == "gpu" {
                    check_device(&node, gpu.is_some());
                }
                Ok::<_, HarnessError>(made)
            });
            let cpu = cpu?;
            let what = format!("scale {scale}, {params}");
            for (cpu, there) in cpu.iter().flatten().zip(there?.iter().flatten()) {
                let is_same = (cpu.is_nan() && there.is_nan()) || (cpu - there).abs() < 1e-3;
                assert!(is_same, "{what}: {cpu} and {there}");
            }
            let known = cpu[0].iter().filter(|value| value.is_finite()).count();
            assert!(known * 50 > cpu[0].len(), "{what}: {known} are known");
        }
    }
    Ok(())
}

/// Inputs of a filter besides the picture and the map.
#[derive(Clone, Copy, Default)]
struct Given {
    right: bool,
    confidence: bool,
    mask: bool,
}

/// Map and confidence of a slope with noise, a bar that is as narrow as its edges, and unknown pixels all around.
fn smoothed(node: &mut Harness<DisparityWls>, given: Given) -> Result<[Vec<f32>; 2], HarnessError> {
    let left = odd_view();
    let surface = |x: usize, y: usize| {
        if (200..211).contains(&x) && (30..100).contains(&y) { 60.0 } else { 30.0 + x as f32 / 40.0 }
    };
    let disparity = |i: usize| {
        let (x, y) = (i % ODD.0, i / ODD.0);
        match (x * 7 + y * 13) % 61 {
            0 => f32::NAN,
            _ if x < 40 || !(10..120).contains(&y) => f32::NAN,
            _ => surface(x, y) + (i % 5) as f32 / 40.0,
        }
    };
    let map: Vec<f32> = (0..ODD.0 * ODD.1).map(disparity).collect();
    // The right view has the nearest of the left view's disparities that land on a pixel.
    let mut right = vec![f32::NAN; ODD.0 * ODD.1];
    for (i, d) in map.iter().enumerate().filter(|(_, d)| d.is_finite()) {
        let to = (i % ODD.0) as f32 - d + 0.5;
        if to >= 0.0 {
            let to = &mut right[i / ODD.0 * ODD.0 + to as usize];
            *to = to.max(*d);
        }
    }
    node.input_image::<Bgr8>("image", ODD.0, ODD.1, &bgr(&left));
    node.input_image::<Disparity>("disparity", ODD.0, ODD.1, &map);
    if given.right {
        node.input_image::<Disparity>("disparity_right", ODD.0, ODD.1, &right);
    }
    if given.confidence {
        let trust: Vec<f32> = (0..ODD.0 * ODD.1).map(|i| (i % 9) as f32 / 6.0).collect();
        node.input_image::<Confidence>("confidence", ODD.0, ODD.1, &trust);
    }
    if given.mask {
        node.input_image::<Mask>("mask", ODD.0, ODD.1, &odd_mask(170.0));
    }
    let out = node.process()?;
    Ok([values(out.plane::<Disparity>("disparity")?), values(out.plane::<Confidence>("confidence")?)])
}

/// Whether maps agree to 0.01 px, and confidences to 0.001; support right at its limit may fall on either side.
fn is_close([map, trust]: &[Vec<f32>; 2], [other, other_trust]: &[Vec<f32>; 2]) -> bool {
    let known_once = map.iter().zip(other).filter(|(a, b)| a.is_nan() != b.is_nan()).count();
    let off = map.iter().zip(other).map(|(a, b)| (a - b).abs()).filter(|off| off.is_finite()).fold(0.0, f32::max);
    let trust_off = trust.iter().zip(other_trust).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("{known_once} pixels are known on one side, {off} px, confidence {trust_off}");
    known_once <= 3 && off <= 0.01 && trust_off < 1e-3
}

#[test]
fn maps_are_filtered_on_the_device_with_all_inputs() -> TestResult {
    let _alone = alone();
    let given = |right, confidence, mask| Given { right, confidence, mask };
    for (given, params) in [
        (given(true, false, false), "scatter_radius_px = 3"),
        (given(true, false, true), "beyond_mask_px = 16, dark_level = 90, highlight_level = 180"),
        (given(false, true, true), "min_support = 0.0"),
        (given(true, true, false), "lambda = 100.0"),
        (given(false, false, false), "scatter_radius_px = 0, left_right_px = 0.5"),
    ] {
        for scale in 1..=4 {
            lend_device(table());
            let [cpu, gpu] = ["cpu", "gpu"].map(|device| {
                let params = format!("params = {{ {params}, scale = {scale}, device = \"{device}\" }}");
                let mut node = Harness::<DisparityWls>::from_toml(&params)?;
                smoothed(&mut node, given)?;
                let made = smoothed(&mut node, given)?;
                if device == "gpu" {
                    check_device(&node, table().is_some());
                }
                Ok::<_, HarnessError>(made)
            });
            let (cpu, gpu) = (cpu?, gpu?);
            assert!(is_close(&gpu, &cpu), "scale {scale}, {params}");
            assert!(cpu[0].iter().filter(|d| d.is_finite()).count() > 2000);
            if params.starts_with("scatter_radius_px = 3") {
                assert!(cpu[0][64 * ODD.0 + 205] > 55.0, "the bar keeps its disparity: {}", cpu[0][64 * ODD.0 + 205]);
            }
        }
    }
    Ok(())
}

#[test]
fn the_processor_filters_what_a_device_fails_to() -> TestResult {
    let _alone = alone();
    let given = Given { right: true, confidence: false, mask: true };
    for scale in [1, 3] {
        let mut expected = Default::default();
        for after in [usize::MAX, 0, 3, 5, 6, 7, 8, 9, 10] {
            let Some(device) = failing(after) else { return Ok(()) };
            lend_device(Some(device));
            let name = if after == usize::MAX { "cpu" } else { "gpu" };
            let params = format!("params = {{ scale = {scale}, device = \"{name}\" }}");
            let mut node = Harness::<DisparityWls>::from_toml(&params)?;
            let made = smoothed(&mut node, given)?;
            if after == usize::MAX {
                expected = made;
                continue;
            }
            let same = made.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| a.to_bits() == b.to_bits());
            assert!(same, "scale {scale}, after {after}");
            assert_eq!(node.logs().iter().filter(|line| line.level == Level::Warn).count(), 1, "{:?}", node.logs());
        }
    }
    Ok(())
}

/// Depths and words of the points of a slope with holes and steps, of all calls; `None` for the map that is not read.
fn reprojected(node: &mut Harness<Reproject>, gray: bool) -> Result<Vec<Vec<f32>>, HarnessError> {
    let left = odd_view();
    let mut cameras = rectified(300.0, 15.0);
    for camera in [&mut cameras.left, &mut cameras.right] {
        (camera.width, camera.height) = (ODD.0 as u32, ODD.1 as u32);
    }
    let mut made = Vec::new();
    for call in 0..2 {
        let disparity = |i: usize| match (i % ODD.0 / 3 + i / ODD.0 * 5 + call) % 37 {
            0 => f32::NAN,
            1 => 3.0,
            _ => 30.0 + (i % ODD.0) as f32 / 20.0 + if i % ODD.0 > 150 { 12.0 } else { 0.0 },
        };
        let map: Vec<f32> = (0..ODD.0 * ODD.1).map(disparity).collect();
        let trust: Vec<f32> = (0..ODD.0 * ODD.1).map(|i| (i % 41) as f32 / 40.0).collect();
        match gray {
            true => node.input_image::<Gray8>("image", ODD.0, ODD.1, &left),
            false => node.input_image::<Bgr8>("image", ODD.0, ODD.1, &bgr(&left)),
        };
        node.input_image::<Disparity>("disparity", ODD.0, ODD.1, &map);
        if call == 1 {
            node.input_image::<Confidence>("confidence", ODD.0, ODD.1, &trust);
        }
        let out = node.input_value("calibration", cameras).process()?;
        let point =
            |p: &CloudPoint| [p.x_mm, p.y_mm, p.z_mm, f32::from(p.filled), f32::from(p.bgr[0]) + f32::from(p.bgr[2])];
        made.push(out.cloud("cloud")?.iter().flat_map(point).collect());
        made.push(values(out.plane::<Depth>("depth")?));
    }
    Ok(made)
}

#[test]
fn depths_and_points_do_not_depend_on_the_device() -> TestResult {
    let _alone = alone();
    for (max_hole, min_neighbours, gray) in [(0.01, 5, true), (0.0, 0, false), (0.001, 8, false)] {
        for gpu in devices() {
            lend_device(gpu);
            let [cpu, there] = ["cpu", "gpu"].map(|device| {
                let params = format!(
                    "params = {{ max_hole = {max_hole}, min_neighbours = {min_neighbours}, device = \"{device}\" }}"
                );
                let mut node = Harness::<Reproject>::from_toml(&params)?;
                let made = reprojected(&mut node, gray)?;
                if device == "gpu" {
                    check_device(&node, gpu.is_some());
                }
                Ok::<_, HarnessError>(made)
            });
            let cpu = cpu?;
            let is_filled = cpu[0].as_chunks::<5>().0.iter().any(|point| point[3] == 1.0);
            assert_eq!(is_filled, max_hole > 0.0);
            for (cpu, there) in cpu.iter().flatten().zip(there?.iter().flatten()) {
                let is_same = (cpu.is_nan() && there.is_nan()) || (cpu - there).abs() <= 1e-5 * cpu.abs();
                assert!(is_same, "holes of {max_hole}: {cpu} and {there}");
            }
        }
    }
    Ok(())
}

#[test]
fn the_processor_reprojects_what_a_device_fails_to() -> TestResult {
    let _alone = alone();
    let mut expected = Vec::new();
    // The map, depths, which of them are unknown, those around holes, the view, the cloud.
    for after in [usize::MAX, 0, 1, 2, 3, 4, 5] {
        let Some(device) = failing(after) else { return Ok(()) };
        lend_device(Some(device));
        let name = if after == usize::MAX { "cpu" } else { "gpu" };
        let mut node = Harness::<Reproject>::from_toml(&format!("params = {{ device = \"{name}\" }}"))?;
        let made = reprojected(&mut node, true)?;
        if after == usize::MAX {
            expected = made;
            continue;
        }
        let same = made.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| a.to_bits() == b.to_bits());
        assert!(same, "after {after}");
        assert_eq!(node.logs().iter().filter(|line| line.level == Level::Warn).count(), 1, "{:?}", node.logs());
    }
    Ok(())
}

#[test]
fn lengths_on_parts_of_maps_are_those_on_whole_maps() -> TestResult {
    let _alone = alone();
    let depth =
        |i: usize| if i % 41 == 3 { f32::NAN } else { 60.0 + (i % ODD.0) as f32 / 9.0 + (i / ODD.0) as f32 / 7.0 };
    let depths: Vec<f32> = (0..ODD.0 * ODD.1).map(depth).collect();
    let trust: Vec<f32> = (0..ODD.0 * ODD.1).map(|i| (i % 7) as f32 / 7.0).collect();
    let mut cameras = rectified(300.0, 15.0);
    for camera in [&mut cameras.left, &mut cameras.right] {
        (camera.width, camera.height) = (ODD.0 as u32, ODD.1 as u32);
    }
    let (width, height) = (ODD.0 as f64, ODD.1 as f64);
    // At corners, inside, overlapping, outside.
    let points = [0.0, 0.0, width - 1.0, height - 1.0, 60.5, 40.25, 63.0, 41.0, width, 3.0, -1.0, 9.0];
    let toml = format!("params = {{ kind = \"depth\", radius_px = 5, points = {points:?} }}");
    let mut expected = Vec::new();
    // Without a failure; a GPU that fails at the first copy, at the first pick, between both maps.
    for after in [None, Some(usize::MAX), Some(0), Some(1), Some(2), Some(3)] {
        lend_device(after.and_then(failing));
        if after.is_some() && table().is_none() {
            return Ok(());
        }
        let mut node = Harness::<Measure>::from_toml(&toml)?;
        for call in 0..2 {
            let tip = Tip {
                u_px: 90.0 + f64::from(call),
                v_px: 33.0,
                xyz_mm: [0.0; 3],
                score: 1.0,
                class_index: 0,
                xyz_valid: 0,
                track_id: 0,
            };
            if after.is_some() {
                node.input_image_from_device::<Depth>("depth", ODD.0, ODD.1, &depths);
                node.input_image_from_device::<Confidence>("confidence", ODD.0, ODD.1, &trust);
            } else {
                node.input_image::<Depth>("depth", ODD.0, ODD.1, &depths);
                node.input_image::<Confidence>("confidence", ODD.0, ODD.1, &trust);
            }
            let out = node.input_value("calibration", cameras).input_value("tips", tip).process()?;
            let values: Vec<u64> = out.table("table")?.rows().flatten().map(|value| value.to_bits()).collect();
            if after.is_none() {
                let known = values.iter().filter(|value| f64::from_bits(**value).is_finite()).count();
                assert!(known > 20, "{known} of {}", values.len());
                expected.push(values);
            } else {
                assert_eq!(values, expected[call as usize], "after {after:?}, call {call}");
            }
        }
        assert_eq!(node.copies(), 0);
    }
    Ok(())
}
