//! Calibration files of OpenCV, ROS and Kalibr; names of boards.

use std::path::Path;

use panoscope_data::calibration::{Board, parse, text_of};

/// One file, or two divided by a line `#---`.
pub fn file(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let texts: Vec<(&Path, &str)> =
        ["left.yaml", "right.yaml"].iter().map(Path::new).zip(text.splitn(2, "#---\n")).collect();
    match parse(&texts) {
        Ok(calibration) => {
            let first = text_of(&calibration);
            let again = parse(&[(Path::new("again.yaml"), &first)]).unwrap_or_else(|e| panic!("{e}\n{first}"));
            assert_eq!(text_of(&again), first, "written, read and written");
        }
        Err(error) => {
            let file = texts.iter().find(|(path, _)| *path == error.file);
            let (_, text) = file.unwrap_or_else(|| panic!("{error} names no file that was given"));
            // The parser counts a lone carriage return as the end of a line, too.
            let lines = text.matches(['\n', '\r', '\u{85}', '\u{2028}', '\u{2029}']).count() + 2;
            assert!(error.line <= lines, "{error}: {lines} lines");
            assert!(!error.what.is_empty());
        }
    }
}

pub fn file_seeds() -> Vec<Vec<u8>> {
    let opencv = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n\
        M1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 750., 0., 319.5, 0., 750., 239.5, 0., 0., 1. ]\n\
        D1: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0.1, 0., 0., 0., 0. ]\n\
        M2: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 750., 0., 319.5, 0., 750., 239.5, 0., 0., 1. ]\n\
        D2: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0., 0., 0., 0., 0. ]\n\
        R: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n\
        T: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ -15., 0., 0. ]\n";
    let ros = |name: &str, shift: f64| {
        format!(
            "image_width: 640\nimage_height: 480\ncamera_name: {name}\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [750, 0, 319.5, 0, 750, 239.5, 0, 0, 1]\n\
             distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0, 0, 0, 0, 0]\n\
             rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n\
             projection_matrix:\n  rows: 3\n  cols: 4\n  data: [750, 0, 319.5, {shift}, 0, 750, 239.5, 0, 0, 0, 1, 0]\n"
        )
    };
    let kalibr = "cam0:\n  camera_model: pinhole\n  intrinsics: [750, 750, 319.5, 239.5]\n  distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [640, 480]\n\
        cam1:\n  T_cn_cnm1:\n  - [1, 0, 0, -0.015]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n  camera_model: pinhole\n  intrinsics: [750, 750, 319.5, 239.5]\n\
        \x20 distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [640, 480]\n";
    let kitti = "P0: 7e2 0 6e2 0 0 7e2 1.7e2 0 0 0 1 0\nP1: 7e2 0 6e2 -3.8e2 0 7e2 1.7e2 0 0 0 1 0\n";
    let raw = "S_rect_02: 1242 375\nP_rect_02: 7e2 0 6e2 44 0 7e2 1.7e2 0.2 0 0 1 0.003\nP_rect_03: 7e2 0 6e2 -340 0 7e2 1.7e2 2.2 0 0 1 0.003\n";
    let middlebury = "cam0=[4e3 0 1177; 0 4e3 1012; 0 0 1]\ncam1=[4e3 0 1308; 0 4e3 1012; 0 0 1]\ndoffs=131\nbaseline=193\nwidth=2964\nheight=1988\n";
    let side = |name: &str, shift: f64| {
        let numbers = |key: &str, values: &[f64]| -> String {
            values.iter().enumerate().map(|(index, value)| format!("{key}_{index}={value}\n")).collect()
        };
        let size = "res_x=1280\nres_y=1024\nfc_x=1035\nfc_y=1035\ncc_x=640\ncc_y=512\n";
        let pose = numbers("R", &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]) + &numbers("T", &[shift, 0.0, 0.0]);
        format!("[{name}]\n{size}{}{pose}", numbers("kc", &[0.1, 0.0, 0.0, 0.0, 0.0]))
    };
    let stereomis = side("StereoLeft", 0.0) + &side("StereoRight", -4.1);
    let view = |n: u8| {
        format!(
            "Camera-{n}-F: 1084 1084 // focal\nCamera-{n}-C: 640 512\nCamera-{n}-Alpha: 0\nCamera-{n}-K: 0 0 0 0 0\n"
        )
    };
    let endovis =
        format!("Width: 1280\nHeight: 1024\n{}{}Extrinsic-Omega: 0 0.01 0\nExtrinsic-T: -4.3 0 0\n", view(0), view(1));
    let hamlyn = "383 0 156 0\n0 383 124 0\n0 0 1 0\n#---\n1 0 0 -5.4\n0 1 0 0\n0 0 1 0\n";
    let texts = [
        kitti.to_owned(),
        raw.to_owned(),
        raw.replace("S_rect_02: 1242 375\n", "S_rect_03: 1242 1e9\n"),
        middlebury.to_owned(),
        middlebury.replace("doffs=131", "doffs=nan"),
        stereomis.clone(),
        stereomis.replace("[StereoRight]", "[Stereo"),
        endovis.clone(),
        endovis.replace("0 0.01 0", "1e300 1e300 -1e300"),
        hamlyn.to_owned(),
        hamlyn.replace("-5.4", "1e308"),
        opencv.to_owned(),
        format!(
            "{opencv}offset_error_px: 0.2\nscale_error_percent: 0.05\npoint_error_px: 0.1\nneutral_depth_mm: 320\n"
        ),
        format!("{opencv}offset_error_px: 1e999\nneutral_depth_mm: -0\n"),
        format!("{}#---\n{}", ros("left", 0.0), ros("right", -11.25)),
        kalibr.to_owned(),
        ros("left", 0.0),
        opencv.replace("image_width: 640\nimage_height: 480\n", ""),
        opencv.replace("750.", ".Nan"),
        opencv.replace("rows: 3", "rows: 4"),
        "a: &x [1, 2]\nb: *x\n".to_owned(),
        "[".repeat(40),
        "{a: ".repeat(40),
        "? ".repeat(60),
    ];
    texts.into_iter().map(String::into_bytes).collect()
}

pub fn board(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match text.parse::<Board>() {
        Ok(board) => {
            assert_eq!(board.to_string().parse(), Ok(board), "{board}");
            let points = board.points_mm();
            assert!(!points.is_empty() && points.len() <= 10_000);
            assert!(points.iter().flatten().all(|mm| mm.is_finite()));
        }
        Err(error) => assert!(!error.reason.is_empty()),
    }
}

pub fn board_seeds() -> Vec<Vec<u8>> {
    let names = [
        "chessboard:9x6:25mm",
        "circles:4x11:20mm",
        "circle_grid:7x6:10mm",
        "charuco:19x26:5mm:4mm:4x4_250",
        "charuco:100x100:5mm:6mm:4x4_1000",
        "chessboard:0x6:1e-320mm",
        "board",
    ];
    names.iter().map(|name| name.as_bytes().to_vec()).collect()
}
