//! The order of real views, right and exchanged.

use crate::stereo_common::{gray, shared};
use panoscope_base::Threads;
use panoscope_imaging::stereo::{CameraModel, Order, Rectification, RectifyParams, StereoCameras, ViewOrder};
use std::path::{Path, PathBuf};

const EYE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// What the order of a pair of files seems to be, as it is and exchanged. `rig` makes the cameras of views of a size.
fn orders(files: [PathBuf; 2], rig: impl Fn((usize, usize)) -> StereoCameras) -> [Order; 2] {
    let [left, right] = files.map(|file| image::open(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display())));
    let (width, height) = (left.width() as usize, left.height() as usize);
    let (left, right) = (left.to_luma8().into_raw(), right.to_luma8().into_raw());
    let cameras = rig((width, height));
    let rectification = Rectification::new(&cameras, RectifyParams::default()).unwrap();
    [[&left, &right], [&right, &left]].map(|views| {
        let (mut order, pool) = (ViewOrder::default(), Threads::new(2));
        order.take(views.map(|view| gray(view, width, height)), &pool);
        order.find(0, &pool);
        order.find(1, &pool);
        let found = order.compare([&cameras.left, &cameras.right], &rectification, &pool);
        println!("{found:?}");
        found.order
    })
}

/// Rectified views: the focal length does not matter for their order.
fn level(size: (usize, usize)) -> StereoCameras {
    let centre = (0.5 * size.0 as f64, 0.5 * size.1 as f64);
    let camera = CameraModel::new(size, (size.0 as f64, size.0 as f64), centre, &[]).unwrap();
    StereoCameras { left: camera.clone(), right: camera, rotation: EYE, translation_mm: [-5.0, 0.0, 0.0] }
}

const RIGHT: [Order; 2] = [Order::AsCalibrated, Order::Exchanged];

#[test]
fn all_pairs_of_a_robots_scope_are_told_from_exchanged_ones() {
    let Some(folder) = shared("data/stereo/hamlyn_640x480") else { return };
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder.join("left")).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    assert!(files.len() >= 25, "{}", files.len());
    for left in files {
        let right = folder.join("right").join(left.file_name().unwrap());
        assert_eq!(orders([left.clone(), right], level), RIGHT, "{}", left.display());
    }
}

#[test]
fn exchanged_views_whose_disparities_stay_positive_are_found() {
    let Some(left) = shared("data/stereo/silicone_heart/f7_dynamic_deint_L_0100.png") else { return };
    let right = left.with_file_name("f7_dynamic_deint_R_0100.png");
    // The calibration beside the images: a robot's scope, whose principal points are 25 columns and 9 rows apart.
    let rig = |size| StereoCameras {
        left: CameraModel::new(size, (391.656525, 426.835144), (165.964371, 154.498138), &[]).unwrap(),
        right: CameraModel::new(size, (390.376862, 426.228882), (190.896454, 145.071411), &[]).unwrap(),
        rotation: [[0.999999, -0.001045, 0.0], [0.001045, 0.999999, 0.0], [0.0, 0.0, 1.0]],
        translation_mm: [-5.520739, -0.031516, -0.051285],
    };
    assert_eq!(orders([left, right], rig), RIGHT);
}

#[test]
fn pairs_of_other_scenes_are_told_from_exchanged_ones() {
    if let Some(left) = shared("data/stereo/synthetic_liver/synthetic-left.png") {
        let right = left.with_file_name("synthetic-right.png");
        let rig = |size| {
            let camera = CameraModel::new(size, (2012.186314, 2017.966019), (944.71737, 617.109398), &[]).unwrap();
            let (sin, cos) = (-8.726535498e-3, 9.999619230e-1);
            let rotation = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]];
            StereoCameras { left: camera.clone(), right: camera, rotation, translation_mm: [-10.0, 0.0, 0.0] }
        };
        assert_eq!(orders([left, right], rig), RIGHT);
    }
    let folder = Path::new("/usr/share/doc/opencv-doc/examples/data");
    let files = ["aloeL.jpg", "aloeR.jpg"].map(|name| folder.join(name));
    if files.iter().all(|file| file.exists()) {
        assert_eq!(orders(files, level), RIGHT);
    } else {
        panoscope_testing::skipped!("the aloe pair is not installed");
    }
}
