//! Calibration files: what is read, what is written, what is refused and how it is said.

use std::path::Path;

use panoscope_abi::Calibration;
use panoscope_data::calibration::{packet, parse, read, text_of};

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
        (change("750.5, 0.", "750.5x, 0."), "scope.yml:9:12: `M1` holds `750.5x`, which is no number"),
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
                ["cut off", "empty", "no calibration", "is said to be", "no number", "has no `data`", "holds"]
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
    let fisheye = right.replace("plumb_bob", "equidistant");
    let message = parse(&[(a, &left), (b, &fisheye)]).unwrap_err().to_string();
    assert!(message.contains("right.yaml:10:3: the distortion model `equidistant`"), "{message}");
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
    let message = one(&KALIBR.replacen("radtan", "equidistant", 1)).unwrap_err();
    assert!(message.contains("scope.yml:2:3: `cam0` has the distortion model `equidistant`"), "{message}");
    let message = one(&KALIBR[..KALIBR.find("cam1").unwrap()]).unwrap_err();
    assert!(message.contains("`cam1` is missing"), "{message}");
}
