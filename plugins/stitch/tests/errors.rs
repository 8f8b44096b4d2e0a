//! A homography that does not fit is not reported as fresh.

use panoscope_node::abi::{self, Calibration, Homography};
use panoscope_node::harness::{Harness, Level, Setup};
use panoscope_node::{Disparity, Gray8};
use panoscope_stitch::{RegisterGridNode, RegisterSurf};

const SIZE: (usize, usize) = (320, 240);

fn calibration() -> Calibration {
    // SAFETY: plain numbers; all zeros are a value of every field.
    let mut found: Calibration = unsafe { std::mem::zeroed() };
    for camera in [&mut found.left, &mut found.right] {
        (camera.width, camera.height) = (SIZE.0 as u32, SIZE.1 as u32);
        (camera.fx, camera.fy, camera.cx, camera.cy) = (300.0, 300.0, 159.5, 119.5);
    }
    let projection = [300.0, 0.0, 159.5, 0.0, 0.0, 300.0, 119.5, 0.0, 0.0, 0.0, 1.0, 0.0];
    (found.left_projection, found.right_projection) = (projection, projection);
    found.is_rectified = 1;
    found
}

/// A plane at 60 px of disparity, with stripes offset by `step_px` that no plane fits.
fn steps(step_px: f32) -> Vec<f32> {
    (0..SIZE.0 * SIZE.1).map(|i| if (i / SIZE.0 / 30).is_multiple_of(2) { 60.0 } else { 60.0 + step_px }).collect()
}

#[test]
fn the_grid_holds_and_then_loses_what_does_not_fit() {
    let toml = "params = { ransac_px = 40.0, max_rms_px = 8.0, hold_frames = 2, rows = 8, columns = 10 }";
    let mut node = Harness::<RegisterGridNode>::open(Setup::new(toml)).unwrap();
    let look = |node: &mut Harness<RegisterGridNode>, step_px: f32| -> Homography {
        node.input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &steps(step_px))
            .input_value("calibration", calibration());
        node.process().unwrap().value("homography").unwrap()
    };
    let good = look(&mut node, 0.0);
    assert_eq!(good.state, abi::STATE_FRESH);
    assert!(good.rms_px < 1.0 && node.metric("refused") == Some(0.0));
    for state in [abi::STATE_HELD, abi::STATE_HELD, abi::STATE_LOST, abi::STATE_LOST] {
        let found = look(&mut node, 36.0);
        assert_eq!((found.state, found.left_from_right), (state, good.left_from_right));
        assert!(node.metric("rms_px").is_some_and(|rms| rms > 8.0), "{:?}", node.metric("rms_px"));
    }
    assert_eq!(node.metric("refused"), Some(4.0));
    let warnings = |node: &Harness<RegisterGridNode>| -> Vec<String> {
        node.logs().iter().filter(|line| line.level == Level::Warn).map(|line| line.message.clone()).collect()
    };
    // Once, with the number, the limit and the remedy.
    let said = warnings(&node);
    assert!(said.len() == 1 && said[0].contains("`max_rms_px` allows 8") && said[0].contains("px (rms"), "{said:?}");
    for _ in 0..40 {
        assert_eq!(look(&mut node, 0.0).state, abi::STATE_FRESH);
    }
    assert!(node.logs().iter().any(|line| line.message.contains("fits again")));
    look(&mut node, 36.0);
    assert_eq!(warnings(&node).len(), 2, "a new time is said anew");
    // Whoever wants it all the same gets it.
    node.set_params("params = { ransac_px = 40.0, max_rms_px = 0.0, hold_frames = 2, rows = 8, columns = 10 }")
        .unwrap();
    let found = look(&mut node, 36.0);
    assert!(found.state == abi::STATE_FRESH && found.rms_px > 8.0, "{}", found.rms_px);
}

/// Spots whose left position is the right one moved by 100 px and, in every other row of spots, by 16 px more.
fn spots(side: usize) -> Vec<u8> {
    let mut view = vec![60_u8; SIZE.0 * SIZE.1];
    for spot in 0..60_usize {
        let (row, column) = (spot / 10, spot % 10);
        let shift = if side == 0 { 100 + 16 * (row % 2) } else { 0 };
        let (x0, y0) = (20 + column * 18 + shift, 30 + row * 32);
        let mut h = (spot as u32 + 1).wrapping_mul(0x9E37_79B1);
        for y in 0..14 {
            for x in 0..14 {
                if (x / 3 + y / 3) % 5 == 0 {
                    h = h.wrapping_mul(0x2C1B_3C6D).wrapping_add(7);
                }
                let value = 60 + ((h >> 24) % 190) as u8;
                if x0 + x < SIZE.0 {
                    view[(y0 + y) * SIZE.0 + x0 + x] = value;
                }
            }
        }
    }
    view
}

#[test]
fn without_a_disparity_the_views_are_registered_by_features() {
    let mut node = Harness::<RegisterGridNode>::open(Setup::new("params = { max_rms_px = 0.0 }")).unwrap();
    let mut look = |has_map: bool| {
        let (left, right) = (spots(0), spots(1));
        node.input_image::<Gray8>("left", SIZE.0, SIZE.1, &left).input_image::<Gray8>("right", SIZE.0, SIZE.1, &right);
        if has_map {
            node.input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &steps(0.0));
        }
        let found: Homography = node.process().unwrap().value("homography").unwrap();
        let said = |word: &str| node.logs().iter().filter(|line| line.message.contains(word)).count();
        (found, said("registered by their features"), said("to register the views from now on"))
    };
    let (found, warnings, _) = look(false);
    let [x, y] = panoscope_imaging::geometry::Homography(found.left_from_right).map([80.0, 100.0]);
    assert!(found.state == abi::STATE_FRESH && (175.0..200.0).contains(&x) && (95.0..105.0).contains(&y), "{x} {y}");
    assert_eq!((warnings, look(false).1), (1, 1), "once");
    // Views without a calibration are taken as rectified where there is a disparity.
    let (found, warnings, back) = look(true);
    assert!(
        found.state == abi::STATE_FRESH && (found.left_from_right[2] - 60.0).abs() < 0.5,
        "{:?}",
        found.left_from_right
    );
    assert_eq!((warnings, back, look(false).1), (1, 1, 2));
    let nothing = Harness::<RegisterGridNode>::problems(&Setup::new(""), &["left", "calibration"]).unwrap();
    assert!(format!("{nothing:?}").contains("neither a disparity nor two views are connected"), "{nothing:?}");
}

#[test]
fn features_that_no_plane_explains_are_not_called_fresh() {
    let open = |limit: f64| {
        let toml = format!(
            "params = {{ roi = false, ransac_px = 20.0, stability_px = 0.0, anchor_fit = 0.0, max_rms_px = {limit:.1} }}"
        );
        Harness::<RegisterSurf>::open(Setup::new(&toml)).unwrap()
    };
    let look = |node: &mut Harness<RegisterSurf>| -> Homography {
        node.input_image::<Gray8>("left", SIZE.0, SIZE.1, &spots(0)).input_image::<Gray8>(
            "right",
            SIZE.0,
            SIZE.1,
            &spots(1),
        );
        node.process().unwrap().value("homography").unwrap()
    };
    let found = look(&mut open(0.0));
    assert!(found.state == abi::STATE_FRESH && found.rms_px > 4.0, "{} {}", found.state, found.rms_px);
    let mut node = open(4.0);
    let found = look(&mut node);
    assert_eq!((found.state, found.inliers), (abi::STATE_LOST, 0));
    assert!(node.logs().iter().any(|line| line.message.contains("`max_rms_px` allows 4")), "{:?}", node.logs());
}

/// Every other pixel of a map, with disparities in its own pixels.
fn half(map: &[f32]) -> Vec<f32> {
    let pixels = |y: usize| map[y * SIZE.0..(y + 1) * SIZE.0].iter().step_by(2);
    (0..SIZE.1).step_by(2).flat_map(pixels).map(|d| d / 2.0).collect()
}

#[test]
fn a_smaller_map_registers_the_pictures_that_it_belongs_to() {
    let mut node = Harness::<RegisterGridNode>::open(Setup::new("")).unwrap();
    let (width, height) = (SIZE.0 / 2, SIZE.1 / 2);
    node.input_image::<Disparity>("disparity", width, height, &half(&steps(0.0)))
        .input_value("calibration", calibration());
    let found: Homography = node.process().unwrap().value("homography").unwrap();
    assert!((found.left_from_right[2] - 60.0).abs() < 0.5, "{:?}", found.left_from_right);
    // Without a calibration the left view tells the size of the pictures.
    let mut node = Harness::<RegisterGridNode>::open(Setup::new("")).unwrap();
    let gray = vec![80_u8; SIZE.0 * SIZE.1];
    node.input_image::<Disparity>("disparity", width, height, &half(&steps(0.0)))
        .input_image::<Gray8>("left", SIZE.0, SIZE.1, &gray)
        .input_image::<Gray8>("right", SIZE.0, SIZE.1, &gray);
    let found: Homography = node.process().unwrap().value("homography").unwrap();
    assert!((found.left_from_right[2] - 60.0).abs() < 0.5, "{:?}", found.left_from_right);
    // A map of other pictures does not.
    node.input_image::<Disparity>("disparity", 200, 120, &vec![60.0; 200 * 120])
        .input_value("calibration", calibration());
    let error = node.process().err().expect("an error").to_string();
    assert!(error.contains("200x120") && error.contains("320x240") && error.contains("integer factor"), "{error}");
}

#[test]
fn a_calibration_without_a_rectification_is_rectified() {
    let mut bare = calibration();
    (bare.left_projection, bare.right_projection, bare.is_rectified) = ([0.0; 12], [0.0; 12], 0);
    bare.right_from_left_rotation = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    bare.right_from_left_mm = [-15.0, 0.0, 0.0];
    let mut node = Harness::<RegisterGridNode>::open(Setup::new("")).unwrap();
    node.input_image::<Disparity>("disparity", SIZE.0, SIZE.1, &steps(0.0)).input_value("calibration", bare);
    let found: Homography = node.process().unwrap().value("homography").unwrap();
    assert_eq!(found.state, abi::STATE_FRESH);
    assert!((found.left_from_right[2] - 60.0).abs() < 0.5, "{:?}", found.left_from_right);
}
