//! Calibration files of data sets, with the numbers and names that these publish.

use std::path::Path;

use panoscope_abi::Calibration;
use panoscope_data::calibration::{KittiCameras, packet, parse, read_kitti, text_of};

fn one(text: &str) -> Result<Calibration, String> {
    parse(&[(Path::new("calib.txt"), text)]).map_err(|error| error.to_string())
}

fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-6 * expected.abs().max(1.0), "{found}, not {expected}");
}

/// Depth in mm that the packet gives a disparity.
fn depth_mm(calibration: &Calibration, disparity_px: f64) -> f64 {
    packet::rectification(calibration).expect("a rectification").depth_mm(disparity_px)
}

const KITTI: &str = "P0: 7.215377e+02 0.000000e+00 6.095593e+02 0.000000e+00 0.000000e+00 7.215377e+02 1.728540e+02 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00
P1: 7.215377e+02 0.000000e+00 6.095593e+02 -3.875744e+02 0.000000e+00 7.215377e+02 1.728540e+02 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00
P2: 7.215377e+02 0.000000e+00 6.095593e+02 4.485728e+01 0.000000e+00 7.215377e+02 1.728540e+02 2.163791e-01 0.000000e+00 0.000000e+00 1.000000e+00 2.745884e-03
P3: 7.215377e+02 0.000000e+00 6.095593e+02 -3.395242e+02 0.000000e+00 7.215377e+02 1.728540e+02 2.199936e+00 0.000000e+00 0.000000e+00 1.000000e+00 2.729905e-03
Tr: 1 0 0 0 0 1 0 0 0 0 1 0
";

#[test]
fn kitti_projections_are_read_in_metres() {
    let colour = one(KITTI).unwrap();
    near(colour.baseline_mm, (44.85728 + 339.5242) / 721.5377 * 1000.0);
    assert_eq!((colour.left.width, colour.left.cx, colour.is_rectified), (0, 609.5593, 1));
    let folder = panoscope_testing::Folder::new("calibration-kitti", &[("calib.txt", KITTI)]);
    let gray = read_kitti(&folder.at("calib.txt"), KittiCameras::Gray).unwrap();
    near(gray.baseline_mm, 387.5744 / 721.5377 * 1000.0);
    assert_eq!(read_kitti(&folder.at("calib.txt"), KittiCameras::Colour).unwrap().baseline_mm, colour.baseline_mm);
    // Raw recordings name size and projections otherwise.
    let raw = KITTI.replace("P2:", "S_rect_02: 1.242000e+03 3.750000e+02\nP_rect_02:").replace("P3:", "P_rect_03:");
    let raw = one(&format!("calib_time: 09-Jan-2012 13:57:47\n{raw}")).unwrap();
    assert_eq!((raw.left.width, raw.right.height, raw.baseline_mm), (1242, 375, colour.baseline_mm));
    near(depth_mm(&raw, 72.0), 721.5377 * raw.baseline_mm / 72.0);
    let without = KITTI.lines().take(1).collect::<Vec<_>>().join("\n");
    assert!(one(&without).unwrap_err().contains("neither `P1` nor `P_rect_01`"));
    let damaged = one(&KITTI.replace("-3.395242e+02", "-3.39x")).unwrap_err();
    assert!(damaged.contains("calib.txt:4:5: `P3` holds `-3.39x`, which is not a number"), "{damaged}");
    let swapped = one(&KITTI.replace("P3:", "P9:").replace("P2:", "P3:").replace("P9:", "P2:")).unwrap_err();
    assert!(swapped.contains("left and right are swapped"), "{swapped}");
}

const MIDDLEBURY: &str = "cam0=[3997.684 0 1176.728; 0 3997.684 1011.728; 0 0 1]
cam1=[3997.684 0 1307.839; 0 3997.684 1011.728; 0 0 1]
doffs=131.111
baseline=193.001
width=2964
height=1988
ndisp=280
isint=0
vmin=31
vmax=257
dyavg=0.918
dymax=1.516
";

#[test]
fn middleburys_doffs_shift_the_disparities() {
    let read = one(MIDDLEBURY).unwrap();
    assert_eq!((read.left.width, read.left.height, read.is_rectified), (2964, 1988, 1));
    // The data set's own formula.
    near(depth_mm(&read, 100.0), 193.001 * 3997.684 / (100.0 + 131.111));
    assert_eq!(
        packet::rectification(&read).unwrap().rotation_left,
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    );
    let other = one(&MIDDLEBURY.replace("doffs=131.111", "doffs=13.1")).unwrap_err();
    assert!(other.contains("calib.txt:3:7: `doffs` is 13.1 px"), "{other}");
    let cut = one(&MIDDLEBURY[..MIDDLEBURY.find("baseline").unwrap()]).unwrap_err();
    assert!(cut.contains("`width` is missing: the file is cut off"), "{cut}");
    let size = one(&MIDDLEBURY.replace("width=2964", "width=-3")).unwrap_err();
    assert!(size.contains("calib.txt:5:7: `width` is -3"), "{size}");
}

const STEREOMIS: &str = "[StereoLeft]
res_x=1280
res_y=1024
fc_x=1035.3
fc_y=1035.1
cc_x=596.9
cc_y=520.4
kc_0=-0.0013
kc_1=0.0019
kc_2=0.0002
kc_3=-0.0001
kc_4=0
kc_5=0
kc_6=0
kc_7=0
R_0=1
R_1=0
R_2=0
R_3=0
R_4=1
R_5=0
R_6=0
R_7=0
R_8=1
T_0=0
T_1=0
T_2=0
[StereoRight]
res_x=1280
res_y=1024
fc_x=1034.8
fc_y=1034.5
cc_x=688.4
cc_y=517.2
kc_0=-0.0021
kc_1=0.0052
kc_2=0.0002
kc_3=0.0001
kc_4=0
R_0=0.99998
R_1=-0.0006
R_2=-0.006296
R_3=0.0006
R_4=1.0
R_5=0.0
R_6=0.006296
R_7=0.0
R_8=0.99998
T_0=-4.15
T_1=-0.024
T_2=-0.035
";

#[test]
fn stereomis_sections_are_raw_cameras() {
    let read = one(STEREOMIS).unwrap();
    assert_eq!((read.left.width, read.right.fx, read.left.distortion[3]), (1280, 1034.8, -0.0001));
    assert_eq!((read.right_from_left_mm, read.is_rectified), ([-4.15, -0.024, -0.035], 0));
    assert_eq!(read.right_from_left_rotation[2], -0.006296);
    near(
        packet::rectification(&read).unwrap().baseline_mm,
        (4.15f64.powi(2) + 0.024f64.powi(2) + 0.035f64.powi(2)).sqrt(),
    );
    let half = one(&STEREOMIS[..STEREOMIS.find("[StereoRight]").unwrap()]).unwrap_err();
    assert!(half.contains("[StereoRight] is missing"), "{half}");
    let cut = one(&STEREOMIS[..STEREOMIS.find("T_1=-0.024").unwrap()]).unwrap_err();
    assert!(cut.contains("[StereoRight]: `T_1` is missing"), "{cut}");
    let wrong = one(&STEREOMIS.replacen("fc_x=1034.8", "fc_x=wide", 1)).unwrap_err();
    assert!(wrong.contains("calib.txt:31:6: `fc_x` holds `wide`"), "{wrong}");
}

const ENDOVIS: &str = "Width: 1280   // image width in pixels
Height: 1024                                              // image height in pixels
Camera-0-F: 1084.21 1084.05                               // left camera x,y focal dist in pixels
Camera-0-C: 580.02 506.79                                 // left camera x,y center in pixels
Camera-0-Alpha: 0.0                                       // left camera angle
Camera-0-K: -0.00069 0.00195 0.00018 0.00000 0.00000      // left camera radial distortion
Camera-1-F: 1083.43 1083.22                               // right camera x,y focal dist in pixels
Camera-1-C: 680.91 505.81                                 // right camera x,y center in pixels
Camera-1-Alpha: 0.0
Camera-1-K: -0.00085 0.00245 0.00004 0.00000 0.00000      // right camera radial distortion
Extrinsic-Omega: -0.0002 -0.0011 -0.0000                  // left to right camera rotation
Extrinsic-T: -4.3499 0.0333 -0.0369                       // left to right camera position
";

#[test]
fn endovis_turns_by_a_rotation_vector() {
    let read = one(ENDOVIS).unwrap();
    assert_eq!((read.left.width, read.right.cy, read.left.distortion[1]), (1280, 505.81, 0.00195));
    // Small angles: R is 1 + [omega]x.
    let r = &read.right_from_left_rotation;
    for (index, expected) in [(1, 0.0), (2, -0.0011), (5, 0.0002), (6, 0.0011), (7, -0.0002), (8, 1.0)] {
        assert!((r[index] - expected).abs() < 2e-6, "{index}: {r:?}");
    }
    near(
        packet::rectification(&read).unwrap().baseline_mm,
        (4.3499f64.powi(2) + 0.0333f64.powi(2) + 0.0369f64.powi(2)).sqrt(),
    );
    let without_size: String = ENDOVIS.lines().skip(2).map(|line| format!("{line}\n")).collect();
    assert_eq!(one(&without_size).unwrap().left.width, 0, "the views say it");
    let skewed = one(&ENDOVIS.replacen("Alpha: 0.0", "Alpha: 0.2", 1)).unwrap_err();
    assert!(skewed.contains("`Camera-0-Alpha` is not 0"), "{skewed}");
    let short = one(&ENDOVIS.replace("-4.3499 0.0333 -0.0369", "-4.3499 0.0333")).unwrap_err();
    assert!(short.contains("calib.txt:12:14: `Extrinsic-T` holds 2 numbers, 3 are needed"), "{short}");
}

#[test]
fn hamlyns_matrices_belong_together() {
    let intrinsics = "383.1901395 0 155.9659519 0\n0 383.1901395 124.3335933 0\n0 0 1 0\n";
    let extrinsics = "1 0 0 -5.382236\n0 1 0 0\n0 0 1 0\n";
    let (a, b) = (Path::new("intrinsics.txt"), Path::new("extrinsics.txt"));
    let read = parse(&[(a, intrinsics), (b, extrinsics)]).unwrap();
    assert_eq!((read.left.width, read.right.cx, read.baseline_mm), (0, 155.9659519, 5.382236));
    near(
        depth_mm(&Calibration { left: sized(read.left), right: sized(read.right), ..read }, 20.0),
        383.1901395 * 5.382236 / 20.0,
    );
    assert_eq!(parse(&[(b, extrinsics), (a, intrinsics)]).unwrap().left.fx, 383.1901395);
    let alone = parse(&[(a, intrinsics)]).unwrap_err().to_string();
    assert!(alone.contains("give the intrinsics and the extrinsics"), "{alone}");
    let turned = parse(&[(a, intrinsics), (b, "0 -1 0 -5\n1 0 0 0\n0 0 1 0\n")]).unwrap_err().to_string();
    assert!(turned.contains("extrinsics.txt:1:1: the right camera is turned"), "{turned}");
    let short = parse(&[(a, intrinsics), (b, "1 0 0\n0 1 0\n0 0 1\n")]).unwrap_err().to_string();
    assert!(short.contains("extrinsics.txt:1:1: the row holds 3 numbers, 4 are needed"), "{short}");
}

fn sized(camera: panoscope_abi::Camera) -> panoscope_abi::Camera {
    panoscope_abi::Camera { width: 320, height: 240, ..camera }
}

/// `endoscope_calibration.yaml` of SCARED: `FileStorage` with matrices of 32-bit floats and no size.
#[test]
fn scareds_file_is_opencvs() {
    let matrix = |name: &str, rows: usize, columns: usize, data: &str| {
        format!("{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: f\n   data: [ {data} ]\n")
    };
    let text = [
        "%YAML:1.0\n---\n".to_owned(),
        matrix(
            "M1",
            3,
            3,
            "1.03530811e+03, 0., 5.96955017e+02, 0., 1.03508765e+03,\n       5.20410034e+02, 0., 0., 1.",
        ),
        matrix("D1", 1, 5, "-5.95157442e-04, -5.46629308e-04, 0., 0.,\n       1.82959007e-03"),
        matrix(
            "M2",
            3,
            3,
            "1.03517419e+03, 0., 6.88361877e+02, 0., 1.03497900e+03,\n       5.21070801e+02, 0., 0., 1.",
        ),
        matrix("D2", 1, 5, "-2.34280655e-04, -7.68933969e-04, 0., 0.,\n       1.76395383e-03"),
        matrix("R", 3, 3, "1., 1.84e-05, -6.17e-05, -1.84e-05, 1., 1.95e-04, 6.17e-05,\n       -1.95e-04, 1."),
        matrix("T", 3, 1, "-4.14339018e+00, -2.38197036e-02, -1.90685632e-03"),
    ]
    .concat();
    let read = one(&text).unwrap();
    assert_eq!((read.left.width, read.left.fx, read.right_from_left_mm[0]), (0, 1035.30811, -4.14339018));
}

#[test]
fn what_is_read_comes_back_from_a_written_file() {
    for text in [KITTI, MIDDLEBURY, STEREOMIS, ENDOVIS] {
        let read = one(text).unwrap();
        let back = one(&text_of(&read)).unwrap();
        assert_eq!(back.left_projection, read.left_projection);
        assert_eq!((back.right, back.right_from_left_mm), (read.right, read.right_from_left_mm));
    }
}

#[test]
fn a_large_file_is_no_calibration() {
    let folder = panoscope_testing::Folder::new("calibration-large", &[]);
    let file = folder.at("video.txt");
    std::fs::File::create(&file).and_then(|f| f.set_len(17 << 20)).unwrap();
    let error = panoscope_data::calibration::read(&[file]).unwrap_err().to_string();
    assert!(error.contains("video.txt: the file is larger than 16 MB"), "{error}");
}
