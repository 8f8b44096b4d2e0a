//! Calibration files: what is read, what is written, what is refused and how it is said.

use std::path::Path;

use panoscope_abi::Calibration;
use panoscope_data::calibration::ros::messages;
use panoscope_data::calibration::{equidistant_of, packet, parse, read, text_of};
use panoscope_imaging::stereo::CalibrationError;

const OPENCV: &str = "%YAML:1.0
---
image_width: 640
image_height: 480
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 750.5, 0., 319.5, 0., 751.25, 239.5, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -1.0e-01, 2.0000000000000001e-02, 0., 0., 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 749., 0., 320., 0., 749.5, 240.,
       0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.1, 0.02, 0., 0., 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -15., 0., 0. ]
";

fn one(text: &str) -> Result<Calibration, String> {
    parse(&[(Path::new("scope.yml"), text)]).map_err(|error| error.to_string())
}

#[test]
fn opencv_is_read_and_comes_back_bit_by_bit() {
    let mut read = one(OPENCV).unwrap();
    assert_eq!((read.left.width, read.left.height, read.baseline_mm), (640, 480, 15.0));
    assert_eq!((read.left.fx, read.left.fy, read.left.distortion[1]), (750.5, 751.25, 0.02));
    // Numbers that no short decimal can hold.
    read.left.fx = 750.0 + 1.0 / 3.0;
    read.right.distortion[2] = -f64::MIN_POSITIVE;
    read.right_from_left_mm = [-15.0 - 1e-13, 1e-300, 2.0_f64.powi(-30)];
    read.rms_px = 0.1 + 0.2;
    read.baseline_mm = read.right_from_left_mm.iter().map(|t| t * t).sum::<f64>().sqrt();
    assert_eq!(one(&text_of(&read)).unwrap(), read);
    // The rectification travels too.
    let views = packet::rectification(&read).unwrap();
    let whole = packet::with_rectification(&read, &views);
    assert_eq!(one(&text_of(&whole)).unwrap(), whole);
}

const STATED: &str = "offset_error_px: 0.2\nscale_error_percent: 0.05\npoint_error_px: 0.1\nneutral_depth_mm: 320\n";

#[test]
fn what_a_file_states_of_its_error_travels_with_the_packet() {
    let read = Calibration { rms_px: 0.3, ..one(&format!("{OPENCV}{STATED}")).unwrap() };
    let stated = CalibrationError::of_bits(read.stated_error).expect("it is stated");
    assert!(
        (stated.offset_px / 0.2 - 1.0).abs() < 0.02 && (stated.neutral_mm / 320.0 - 1.0).abs() < 0.02,
        "{stated:?}"
    );
    assert_eq!(one(&text_of(&read)).unwrap(), read);
    // Rectified and shrunk views state it in their own pixels.
    let views = packet::rectification(&read).unwrap();
    assert_eq!(packet::rectified(&read, &views).stated_error, read.stated_error);
    let half = CalibrationError::of_bits(packet::shrunk(&read, 2).stated_error).expect("it is stated");
    assert!((half.offset_px / 0.1 - 1.0).abs() < 0.02 && half.scale_percent == stated.scale_percent, "{half:?}");
    // Other files state nothing.
    assert_eq!(one(OPENCV).unwrap().stated_error, 0);
    assert!(!text_of(&one(OPENCV).unwrap()).contains("error"));
}

#[test]
fn half_a_statement_of_its_error_is_refused() {
    for (from, to, words) in [
        ("scale_error_percent: 0.05\n", "", "`scale_error_percent` is missing"),
        ("0.05", "-0.05", "`scale_error_percent` is -0.05"),
        ("0.05", ".Nan", "`scale_error_percent` holds .Nan"),
        ("320", "0", "`neutral_depth_mm` is 0"),
        ("0.1", "wide", "`point_error_px`"),
    ] {
        let error = one(&format!("{OPENCV}{}", STATED.replace(from, to))).unwrap_err();
        assert!(error.contains("scope.yml") && error.contains(words), "{error}");
    }
}

#[test]
fn halves_of_opencvs_sample_belong_together() {
    let (inner, outer) = OPENCV.split_at(OPENCV.find("R: ").unwrap());
    let inner = inner.replace("image_width: 640\nimage_height: 480\n", "");
    let outer = format!("%YAML:1.0\n---\n{outer}");
    let (a, b) = (Path::new("intrinsics.yml"), Path::new("extrinsics.yml"));
    let read = parse(&[(a, &inner), (b, &outer)]).unwrap();
    assert_eq!((read.left.width, read.left.fx, read.baseline_mm), (0, 750.5, 15.0));
    let message = parse(&[(a, &inner)]).unwrap_err().to_string();
    assert!(message.contains("intrinsics.yml") && message.contains("its other half was not given"), "{message}");
    let doc = Path::new("/usr/share/doc/opencv-doc/examples/data/intrinsics.yml");
    if doc.exists() {
        let message = read_one(doc).unwrap_err();
        assert!(message.contains("(`R`) is missing"), "{message}");
    } else {
        panoscope_testing::skipped!("Debian's opencv-doc is not installed");
    }
}

fn read_one(path: &Path) -> Result<Calibration, String> {
    read(&[path.to_owned()]).map_err(|error| error.to_string())
}

#[test]
fn mistakes_are_named_with_their_place() {
    let change = |from: &str, to: &str| one(&OPENCV.replacen(from, to, 1)).unwrap_err();
    for (message, words) in [
        (change("750.5, 0.", "750.5x, 0."), "scope.yml:9:12: `M1` holds `750.5x`, which is not a number"),
        (change("319.5, 0., ", ""), "scope.yml:9:10: `M1` is said to be 3x3 and holds 7 numbers"),
        (change("750.5", ".Nan"), "scope.yml:9:12: `M1` holds .Nan"),
        (change("image_width: 640", "image_width: 640.5"), "scope.yml:3:14: `image_width` is 640.5"),
        (change("[ -15., 0., 0. ]", "[ 15., 0., 0. ]"), "disparities would be negative"),
        (change("[ -15., 0., 0. ]", "[ 0., -15., 0. ]"), "above one another"),
        (change("[ -15., 0., 0. ]", "[ 0., 0., 0. ]"), "the baseline is 0 mm"),
        (change("[ 1., 0., 0., 0., 1.", "[ 2., 0., 0., 0., 1."), "not a rotation"),
        (change("750.5", "-750.5"), "must be positive"),
        (
            change("D1:", "D1: !!opencv-matrix\n   rows: 1\n   cols: 3\n   dt: d\n   data: [ 1., 2., 3. ]\nD3:"),
            "holds 3 coefficients",
        ),
        (one("").unwrap_err(), "the file is empty"),
        (one("hello: world\n").unwrap_err(), "no calibration of a stereo pair"),
        (one("a: [1, 2").unwrap_err(), "cut off"),
        (read_one(Path::new("nowhere.yml")).unwrap_err(), "nowhere.yml: No such file"),
    ] {
        assert!(message.contains(words), "{message}\n  lacks\n{words}");
    }
}

#[test]
fn wherever_a_file_is_cut_off_it_is_refused_and_said() {
    let mut whole = one(OPENCV).unwrap();
    let views = packet::rectification(&whole).unwrap();
    whole = packet::with_rectification(&whole, &views);
    let text = text_of(&whole);
    let end = text.find("Q: ").unwrap();
    for at in 0..end - 1 {
        // Without the rectification the file says all that is needed, if it ends where a matrix ends.
        match one(&text[..at]) {
            Err(message) => assert!(
                ["cut off", "empty", "no calibration", "is said to be", "not a number", "has no `data`", "holds"]
                    .iter()
                    .any(|words| message.contains(words)),
                "{at}: {message}"
            ),
            Ok(read) => {
                assert_eq!(read.left_projection, [0.0; 12], "cut off at {at} of {end}");
                assert_eq!(read.right_from_left_mm, whole.right_from_left_mm);
            }
        }
    }
}

const ROS: &str = "image_width: 640
image_height: 480
camera_name: SIDE
camera_matrix:
  rows: 3
  cols: 3
  data: [750, 0, 320, 0, 750, 240, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.1, 0.01, 0, 0, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [740, 0, 320, SHIFT, 0, 740, 240, 0, 0, 0, 1, 0]
";

#[test]
fn ros_camera_info_is_read_in_metres() {
    let left = ROS.replace("SIDE", "left").replace("SHIFT", "0");
    // 740 px times 15 mm.
    let right = ROS.replace("SIDE", "right").replace("SHIFT", "-11.1");
    let (a, b) = (Path::new("left.yaml"), Path::new("right.yaml"));
    let read = parse(&[(a, &left), (b, &right)]).unwrap();
    assert!((read.baseline_mm - 15.0).abs() < 1e-9 && (read.right_from_left_mm[0] + 15.0).abs() < 1e-9);
    assert!((packet::rectification(&read).unwrap().baseline_mm - 15.0).abs() < 1e-9);
    let message = parse(&[(b, &right), (a, &left)]).unwrap_err().to_string();
    assert!(message.contains("baseline") || message.contains("negative"), "{message}");
    let message = parse(&[(a, &left)]).unwrap_err().to_string();
    assert!(message.contains("give the left and the right file"), "{message}");
    let unknown = right.replace("plumb_bob", "omnidirectional");
    let message = parse(&[(a, &left), (b, &unknown)]).unwrap_err().to_string();
    assert!(message.contains("right.yaml:10:3: the distortion model `omnidirectional`"), "{message}");
}

#[test]
fn an_equidistant_lens_is_read_and_written_in_all_formats_that_have_it() {
    let k = [0.01, -0.02, 0.001, 0.002];
    let fisheye = |text: &str| {
        text.replace("plumb_bob", "equidistant")
            .replace("cols: 5\n  data: [-0.1, 0.01, 0, 0, 0]", "cols: 4\n  data: [0.01, -0.02, 0.001, 0.002]")
    };
    let plain = ROS.replace("SIDE", "left").replace("SHIFT", "0");
    let (left, right) = (fisheye(&plain), fisheye(&ROS.replace("SIDE", "right").replace("SHIFT", "-11.1")));
    let (a, b) = (Path::new("left.yaml"), Path::new("right.yaml"));
    let ros = parse(&[(a, &left), (b, &right)]).unwrap();
    assert_eq!((equidistant_of(&ros.left), equidistant_of(&ros.right), ros.is_rectified), (Some(k), Some(k), 0));
    // As a message, and back from it.
    let [_, message] = messages(&ros);
    assert_eq!((message.model, &message.d[..]), ("equidistant", &k[..]));
    // As OpenCV's file, bit by bit.
    assert!(packet::same(&one(&text_of(&ros)).unwrap(), &ros));
    let kalibr =
        KALIBR.replace("radtan", "equidistant").replace("[-0.28, 0.07, 0.0001, 0.0002]", "[0.01, -0.02, 0.001, 0.002]");
    assert_eq!(equidistant_of(&one(&kalibr).unwrap().right), Some(k));
    let opencv = OPENCV.replace("M1:", "distortion_model: fisheye\nM1:").replace("cols: 5", "cols: 4");
    let opencv = opencv
        .replace("2.0000000000000001e-02, 0., 0., 0. ]", "0.02, 0., 0. ]")
        .replace("0.02, 0., 0., 0. ]", "0.02, 0., 0. ]");
    assert_eq!(equidistant_of(&one(&opencv).unwrap().left), Some([-0.1, 0.02, 0.0, 0.0]));
    // A fisheye without coefficients is no pinhole.
    let zero = |text: &str| text.replace("[0.01, -0.02, 0.001, 0.002]", "[0, 0, 0, 0]");
    let read = parse(&[(a, &zero(&left)), (b, &zero(&right))]).unwrap();
    let camera = packet::camera(&read.left).unwrap();
    assert!((camera.project(1.0, 0.0).0 - (750.0 * std::f64::consts::FRAC_PI_4 + 320.0)).abs() < 1e-9);
    for (message, words) in [
        (parse(&[(a, &plain), (b, &right)]), "one camera has an equidistant lens"),
        (
            parse(&[(a, &left.replace("cols: 4", "cols: 5").replace("0.002]", "0.002, 0]")), (b, &right)]),
            "5 distortion coefficients",
        ),
    ] {
        let message = message.unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
    let message = one(&opencv.replace("fisheye", "omni")).unwrap_err();
    assert!(message.contains("scope.yml:5:19: the distortion model `omni`"), "{message}");
}

#[test]
fn files_of_ros_with_an_equidistant_lens_give_their_rays() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/foreign");
    let files = ["left", "right"].map(|side| folder.join(format!("equidistant_{side}.yaml")));
    if !files[0].exists() {
        return panoscope_testing::skipped!("../shared/foreign is not there");
    }
    let read = read(&files).expect("a calibration");
    assert_eq!(equidistant_of(&read.left), Some([0.01, -0.02, 0.001, 0.002]));
    assert_eq!((read.left, read.is_rectified), (read.right, 0));
    assert!((read.baseline_mm - 15.0).abs() < 1e-9, "{}", read.baseline_mm);
    // By hand: 40 degrees from the axis, to the right; r = 750 (t + k1 t^3 + k2 t^5 + k3 t^7 + k4 t^9).
    let t = 40_f64.to_radians();
    let r = 750.0 * (t + 0.01 * t.powi(3) - 0.02 * t.powi(5) + 0.001 * t.powi(7) + 0.002 * t.powi(9));
    let (u, v) = packet::camera(&read.left).expect("a lens").project(t.tan(), 0.0);
    assert!((u - 320.0 - r).abs() < 1e-9 && (v - 240.0).abs() < 1e-9, "{u} {v}");
}

/// Left and right as MATLAB R2020a's `jsonencode(toStruct(stereoParams))` has them, without the views.
const MATLAB: &str = r#"{"CameraParameters1":{"RadialDistortion":[-0.25,0.1],"TangentialDistortion":[0.001,-0.002],
"ImageSize":[480,640],"WorldUnits":"millimeters","IntrinsicMatrix":[[750,0,0],[0,751,0],[320.5,240.5,1]],"Version":{"isVersion":1}},
"CameraParameters2":{"RadialDistortion":[-0.25,0.1,0.01],"TangentialDistortion":[0,0],
"ImageSize":[480,640],"WorldUnits":"millimeters","IntrinsicMatrix":[[749,0,0],[0,750,0],[321.5,241.5,1]]},
"RotationOfCamera2":[[0.9999,-0.0141,0],[0.0141,0.9999,0],[0,0,1]],"TranslationOfCamera2":[-15,0.1,0.2],"RectificationParams":{}}"#;

#[test]
fn stereo_parameters_of_matlab_are_read() {
    let read = one(MATLAB).unwrap();
    assert_eq!((read.left.width, read.left.height, read.left.fx, read.left.fy), (640, 480, 750.0, 751.0));
    // Pixels count from 1 there, from 0 here.
    assert_eq!((read.left.cx, read.left.cy, read.right.cx), (319.5, 239.5, 320.5));
    assert_eq!(read.left.distortion[..5], [-0.25, 0.1, 0.001, -0.002, 0.0]);
    assert_eq!(read.right.distortion[..5], [-0.25, 0.1, 0.0, 0.0, 0.01]);
    assert_eq!((read.right_from_left_rotation[1], read.right_from_left_mm), (0.0141, [-15.0, 0.1, 0.2]));
    // As newer versions write it, and in metres.
    let new = MATLAB
        .replace("\"IntrinsicMatrix\":[[750,0,0],[0,751,0],[320.5,240.5,1]]", "\"K\":[[750,0,320.5],[0,751,240.5],[0,0,1]]")
        .replace("\"RotationOfCamera2\":[[0.9999,-0.0141,0],[0.0141,0.9999,0],[0,0,1]],\"TranslationOfCamera2\":[-15,0.1,0.2]",
            "\"PoseCamera2\":{\"Dimensionality\":3,\"Translation\":[-15,0.1,0.2],\"R\":[[0.9999,0.0141,0],[-0.0141,0.9999,0],[0,0,1]]}");
    assert!(packet::same(&one(&new).unwrap(), &read));
    let metres = MATLAB.replace("[-15,0.1,0.2]", "[-0.015,0.0001,0.0002]").replace("millimeters", "meters");
    assert!((one(&metres).unwrap().baseline_mm - read.baseline_mm).abs() < 1e-9);
    assert_eq!(one(&MATLAB.replace("\"ImageSize\":[480,640]", "\"ImageSize\":[]")).unwrap().left.width, 0);
    for (from, to, words) in [
        ("[0,751,0]", "[0.5,751,0]", "has the skew 0.5"),
        ("\"TranslationOfCamera2\"", "\"T\"", "`TranslationOfCamera2` is missing"),
        ("[-15,0.1,0.2]", "[15,0.1,0.2]", "disparities would be negative"),
        ("millimeters", "furlongs", "the unit `furlongs` is not known"),
        ("[-0.25,0.1]", "[-0.25,null]", "which is not a number"),
    ] {
        let message = one(&MATLAB.replacen(from, to, 1)).unwrap_err();
        assert!(message.contains(words), "{message}");
    }
}

const KALIBR: &str = "cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0001, 0.0002]
  distortion_model: radtan
  intrinsics: [461.6, 460.3, 363.0, 248.1]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.9999, 0.0141, 0.0, -0.110]
  - [-0.0141, 0.9999, 0.0, 0.0004]
  - [0.0, 0.0, 1.0, -0.0009]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0001, 0.0002]
  distortion_model: radtan
  intrinsics: [460.6, 459.3, 372.0, 249.1]
  resolution: [752, 480]
";

#[test]
fn kalibr_chains_are_read_in_metres() {
    let read = one(KALIBR).unwrap();
    assert_eq!((read.left.width, read.right.cx, read.left.distortion[2]), (752, 372.0, 0.0001));
    assert!((read.right_from_left_mm[0] + 110.0).abs() < 1e-9 && read.right_from_left_rotation[1] == 0.0141);
    let message = one(&KALIBR.replace("-0.110", "0.110")).unwrap_err();
    assert!(message.contains("disparities would be negative"), "{message}");
    let message = one(&KALIBR.replacen("radtan", "fov", 1)).unwrap_err();
    assert!(message.contains("scope.yml:2:3: `cam0` has the distortion model `fov`"), "{message}");
    let message = one(&KALIBR[..KALIBR.find("cam1").unwrap()]).unwrap_err();
    assert!(message.contains("`cam1` is missing"), "{message}");
}
