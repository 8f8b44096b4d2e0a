//! The lit part of a pair: the masks of `rectify`, and what matchers and filters make of them.

use crate::common::{SIZE, bgr, pair, rectified};
use panoscope_node::abi::Calibration;
use panoscope_node::harness::{Harness, HarnessError, Level, Outputs};
use panoscope_node::{Bgr8, Disparity, Gray8, Mask, Node};
use panoscope_stereo::{DisparityWls, Rectify, StereoBm, StereoSgbm};

type TestResult = Result<(), HarnessError>;

/// Disparity of the surface, px.
const SURFACE_PX: f32 = 12.0;

/// What a round scope shows: the rims of both views lie at one column, as if at another disparity.
fn is_lit(x: usize, y: usize) -> bool {
    (x as f64 - 160.0).hypot(y as f64 - 64.0) < 105.0
}

/// A pair seen through a round scope: rims of 6 levels with noise, brighter just outside the edge, as light that leaks in is.
pub fn round_pair() -> (Vec<u8>, Vec<u8>) {
    let (mut left, mut right) = pair(|_, _| f64::from(SURFACE_PX), 0.0);
    for view in [&mut left, &mut right] {
        for (i, value) in view.iter_mut().enumerate() {
            if !is_lit(i % SIZE.0, i / SIZE.0) {
                *value = 5 + (i * 7919 % 5) as u8;
            }
        }
    }
    (left, right)
}

fn rectify(
    node: &mut Harness<Rectify>,
    left: &[u8],
    right: &[u8],
    cameras: Calibration,
) -> Result<Outputs, HarnessError> {
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &bgr(left))
        .input_image::<Bgr8>("right", SIZE.0, SIZE.1, &bgr(right))
        .input_value("calibration", cameras)
        .process()
}

#[test]
fn masks_of_round_scopes_are_found_and_whole_views_have_none() -> TestResult {
    let cameras = rectified(400.0, 15.0);
    let (left, right) = round_pair();
    let mut node = Harness::<Rectify>::from_toml("")?;
    let mut allocated = 0;
    for frame in 0..3 {
        let out = rectify(&mut node, &left, &right, cameras)?;
        for port in ["mask_left", "mask_right"] {
            let mask = out.plane::<Mask>(port)?;
            for (i, value) in mask.data.iter().enumerate() {
                let (x, y) = (i % SIZE.0, i / SIZE.0);
                assert!(*value == 0 || is_lit(x, y), "{port}: {x}, {y} is rim");
                assert!(*value == 255 || (x as f64 - 160.0).hypot(y as f64 - 64.0) > 99.0, "{port}: {x}, {y} is lit");
            }
        }
        // The mask is made once.
        if frame > 0 {
            assert_eq!(node.allocated_bytes() - allocated, size_of::<Calibration>() as u64);
        }
        allocated = node.allocated_bytes();
    }
    // Where nobody asks for it, and where there is no rim, there is no mask.
    let out = rectify(&mut Harness::<Rectify>::from_toml("params = { find_rim = false }")?, &left, &right, cameras)?;
    assert!(out.is_empty("mask_left")? && out.is_empty("mask_right")?);
    let (left, right) = pair(|_, _| 12.0, 0.0);
    let out = rectify(&mut Harness::<Rectify>::from_toml("")?, &left, &right, cameras)?;
    assert!(out.is_empty("mask_left")? && out.is_empty("mask_right")?);
    Ok(())
}

#[test]
fn what_a_camera_does_not_cover_and_what_its_distortion_folds_is_masked() -> TestResult {
    let (left, right) = pair(|_, _| 12.0, 0.0);
    // The right camera's distortion turns back 101 px from its centre.
    let mut cameras = Calibration { is_rectified: 0, ..rectified(400.0, 15.0) };
    cameras.right.distortion[4] = -130.0;
    let mut node = Harness::<Rectify>::from_toml("params = { find_rim = false }")?;
    for _ in 0..3 {
        let out = rectify(&mut node, &left, &right, cameras)?;
        assert!(out.is_empty("mask_left")?);
        let (mask, view) = (out.plane::<Mask>("mask_right")?, out.plane::<Bgr8>("right")?);
        for (i, value) in mask.data.iter().enumerate() {
            let distance = (i as f64 % 320.0 - 160.0).hypot((i / 320) as f64 - 64.0);
            let radius = 400.0 * (1.0f64 / (7.0 * 130.0)).powf(1.0 / 6.0);
            assert_eq!(*value == 255, distance <= radius, "{distance} px from the centre");
            assert_eq!(view.data[3 * i] > 0, distance <= radius);
        }
    }
    let warned: Vec<_> = node.logs().iter().filter(|line| line.level == Level::Warn).collect();
    assert!(warned.len() == 1 && warned[0].message.contains("the right camera turns back"), "{warned:?}");
    Ok(())
}

fn known_outside<N: Node>(is_masked: bool) -> Result<[f64; 2], HarnessError> {
    let (left, right) = round_pair();
    let mask: Vec<u8> = (0..SIZE.0 * SIZE.1)
        .map(|i| if (i as f64 % 320.0 - 160.0).hypot((i / 320) as f64 - 64.0) < 103.0 { 255 } else { 0 })
        .collect();
    let mut node = Harness::<N>::from_toml("params = { texture = 0 }").or_else(|_| Harness::<N>::from_toml(""))?;
    node.input_image::<Gray8>("left", SIZE.0, SIZE.1, &left).input_image::<Gray8>("right", SIZE.0, SIZE.1, &right);
    if is_masked {
        for port in ["mask_left", "mask_right"] {
            node.input_image::<Mask>(port, SIZE.0, SIZE.1, &mask);
        }
    }
    let out = node.process()?;
    let map = out.plane::<Disparity>("disparity")?;
    let right_map = out.plane::<Disparity>("disparity_right")?;
    let known = |map: &[f32], counts: &dyn Fn(usize, f32) -> bool| {
        map.iter().enumerate().filter(|(i, d)| d.is_finite() && counts(*i, **d)).count() as f64 / map.len() as f64
    };
    // Outside of either view's part, and false ones within.
    let wrong = |i: usize, d: f32| mask[i] == 0 || (d - SURFACE_PX).abs() > 2.0;
    let lit = |i: usize, d: f32| mask[i] > 0 && (d - SURFACE_PX).abs() < 1.0;
    Ok([known(map.data, &wrong) + known(right_map.data, &wrong), known(map.data, &lit)])
}

#[test]
fn rims_are_not_matched() -> TestResult {
    for (without, with) in [
        (known_outside::<StereoBm>(false)?, known_outside::<StereoBm>(true)?),
        (known_outside::<StereoSgbm>(false)?, known_outside::<StereoSgbm>(true)?),
    ] {
        assert!(without[0] > 0.01, "the rim is no trap: {without:?}");
        assert!(with[0] < 0.005, "{with:?}");
        // The tissue stays matched.
        assert!(with[1] > without[1] - 0.05, "{without:?} {with:?}");
    }
    Ok(())
}

#[test]
fn masks_of_another_size_are_refused() -> TestResult {
    let (left, right) = round_pair();
    let mut node = Harness::<StereoBm>::from_toml("")?;
    node.input_image::<Gray8>("left", SIZE.0, SIZE.1, &left)
        .input_image::<Gray8>("right", SIZE.0, SIZE.1, &right)
        .input_image::<Mask>("mask_right", 16, 16, &[255; 256]);
    let told = node.process().err().map(|error| error.to_string()).unwrap_or_default();
    assert!(told.contains("`mask_right` is 16x16, the views are 320x128"), "{told}");
    Ok(())
}

#[test]
fn a_filter_does_not_fill_the_rim() -> TestResult {
    // Without texture a filter fills as far as it reaches.
    let (image, mut map) = (vec![120u8; SIZE.0 * SIZE.1], vec![f32::NAN; SIZE.0 * SIZE.1]);
    for y in 0..SIZE.1 {
        map[y * SIZE.0 + 120..y * SIZE.0 + 220].fill(SURFACE_PX);
    }
    let mask: Vec<u8> = (0..SIZE.0 * SIZE.1).map(|i| if i % SIZE.0 >= 110 { 255 } else { 0 }).collect();
    for scale in [1, 2] {
        let mut node = Harness::<DisparityWls>::from_toml(&format!("params = {{ scale = {scale} }}"))?;
        let mut known = |is_masked: bool| -> Result<(usize, usize), HarnessError> {
            node.input_image::<Gray8>("image", SIZE.0, SIZE.1, &image);
            node.input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &map);
            if is_masked {
                node.input_image::<Mask>("mask", SIZE.0, SIZE.1, &mask);
            }
            let out = node.process()?;
            let row = &out.plane::<Disparity>("disparity")?.data[64 * SIZE.0..65 * SIZE.0];
            let confidence = &out.plane::<panoscope_node::Confidence>("confidence")?.data[64 * SIZE.0..65 * SIZE.0];
            let first = row.iter().position(|d| d.is_finite()).unwrap_or(SIZE.0);
            Ok((first, confidence.iter().position(|c| *c > 0.0).unwrap_or(SIZE.0)))
        };
        assert!(known(false)?.0 < 110);
        assert_eq!(known(true)?, (110, 110));
    }
    Ok(())
}

#[test]
fn a_filter_continues_the_surface_up_to_the_black_of_the_rim() -> TestResult {
    // The mask ends 5 px inside of a rim that is black up to column 107.
    let image: Vec<u8> = (0..SIZE.0 * SIZE.1).map(|i| if i % SIZE.0 < 107 { 0 } else { 120 }).collect();
    let mask: Vec<u8> = (0..SIZE.0 * SIZE.1).map(|i| if i % SIZE.0 >= 112 { 255 } else { 0 }).collect();
    let mut map = vec![f32::NAN; SIZE.0 * SIZE.1];
    for y in 0..SIZE.1 {
        map[y * SIZE.0 + 115..y * SIZE.0 + 220].fill(SURFACE_PX);
    }
    // Views of 320 px have half of the strip.
    for (beyond_px, first) in [(0, 112), (5, 109), (16, 107)] {
        let mut node = Harness::<DisparityWls>::from_toml(&format!("params = {{ beyond_mask_px = {beyond_px} }}"))?;
        let out = node
            .input_image::<Gray8>("image", SIZE.0, SIZE.1, &image)
            .input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &map)
            .input_image::<Mask>("mask", SIZE.0, SIZE.1, &mask)
            .process()?;
        for port in [
            out.plane::<Disparity>("disparity")?.row(64),
            out.plane::<panoscope_node::Confidence>("confidence")?.row(64),
        ] {
            assert_eq!(port.iter().position(|v| *v > 0.0), Some(first), "{beyond_px} px beyond the mask");
        }
        let row = out.plane::<Disparity>("disparity")?.row(64);
        assert!(row[first..150].iter().all(|d| (d - SURFACE_PX).abs() < 0.1), "{:?}", &row[first..120]);
    }
    Ok(())
}
