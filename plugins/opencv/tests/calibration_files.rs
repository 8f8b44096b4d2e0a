//! Calibration files and OpenCV's `FileStorage`: each reads what the other writes, bit by bit.

use std::path::{Path, PathBuf};

use opencv::core::{FileStorage, FileStorage_READ, FileStorage_WRITE, Mat};
use opencv::prelude::*;
use panoscope_data::calibration::{packet, parse, read, write};
use panoscope_node::abi::{Calibration, Camera};

struct File(PathBuf);

impl File {
    fn new(name: &str) -> Self {
        Self(std::env::temp_dir().join(format!("panoscope_{}_{name}", std::process::id())))
    }

    fn text(&self) -> &str {
        self.0.to_str().unwrap()
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Numbers with no short decimal form, very large and very small ones.
fn odd() -> Calibration {
    let third = 1.0 / 3.0;
    let mut distortion = [0.0; 14];
    for (index, value) in
        [-0.1 - third * 1e-3, 0.02, 1e-300, -f64::MIN_POSITIVE, 0.25, third, -third, 1e-17].iter().enumerate()
    {
        distortion[index] = *value;
    }
    let camera = |shift: f64| Camera {
        width: 640,
        height: 480,
        fx: 750.0 + third,
        fy: 751.0 - third * 1e-9,
        cx: 319.5 + shift,
        cy: 239.5,
        distortion,
    };
    let (sin, cos) = 0.01_f64.sin_cos();
    let bare = Calibration {
        left: camera(0.0),
        right: camera(third),
        right_from_left_rotation: [cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0],
        right_from_left_mm: [-15.0 - third * 1e-12, third * 1e-4, 2.0_f64.powi(-40)],
        rectified_from_left: [0.0; 9],
        rectified_from_right: [0.0; 9],
        left_projection: [0.0; 12],
        right_projection: [0.0; 12],
        baseline_mm: 15.0,
        rms_px: 0.1 + 0.2,
        is_rectified: 0,
        stated_error: 0x8877_6655,
    };
    packet::with_rectification(&bare, &packet::rectification(&bare).unwrap())
}

fn mat(storage: &FileStorage, name: &str) -> Vec<f64> {
    let mat = storage.get(name).unwrap().mat().unwrap();
    mat.data_typed::<f64>().unwrap().to_vec()
}

#[test]
fn opencv_reads_what_is_written_bit_by_bit() {
    let file = File::new("ours.yml");
    let given = odd();
    write(&file.0, &given).unwrap();
    let storage = FileStorage::new(file.text(), FileStorage_READ, "").unwrap();
    assert!(storage.is_opened().unwrap());
    for (name, expected) in [
        ("D1", &given.left.distortion[..8]),
        ("D2", &given.right.distortion[..8]),
        ("R", &given.right_from_left_rotation),
        ("T", &given.right_from_left_mm),
        ("R1", &given.rectified_from_left),
        ("R2", &given.rectified_from_right),
        ("P1", &given.left_projection),
        ("P2", &given.right_projection),
        ("M1", &[given.left.fx, 0.0, given.left.cx, 0.0, given.left.fy, given.left.cy, 0.0, 0.0, 1.0]),
    ] {
        let found = mat(&storage, name);
        assert_eq!(found.len(), expected.len(), "{name}");
        let same = found.iter().zip(expected).all(|(a, b)| a.to_bits() == b.to_bits());
        assert!(same, "{name}: {found:?} {expected:?}");
    }
    assert_eq!(storage.get("baseline_mm").unwrap().real().unwrap().to_bits(), given.baseline_mm.to_bits());
    assert_eq!(storage.get("image_width").unwrap().to_i32().unwrap(), 640);
    // `Q` is what OpenCV makes of the same rectification: a point one baseline away has the depth that it should.
    let q = mat(&storage, "Q");
    let w = q[14] * 100.0 + q[15];
    let expected = given.left_projection[0] * given.baseline_mm / 100.0;
    assert!((q[11] / w - expected).abs() < 1e-9 * expected, "{} {expected}", q[11] / w);
}

#[test]
fn what_opencv_writes_is_read_bit_by_bit() {
    let (ours, theirs) = (File::new("from_ours.yml"), File::new("from_theirs.yml"));
    let given = odd();
    write(&ours.0, &given).unwrap();
    // Through OpenCV and back: OpenCV reads ours and writes its own.
    let from = FileStorage::new(ours.text(), FileStorage_READ, "").unwrap();
    let mut to = FileStorage::new(theirs.text(), FileStorage_WRITE, "").unwrap();
    for name in ["image_width", "image_height"] {
        to.write_i32(name, from.get(name).unwrap().to_i32().unwrap()).unwrap();
    }
    for name in ["M1", "D1", "M2", "D2", "R", "T", "R1", "R2", "P1", "P2"] {
        let mat: Mat = from.get(name).unwrap().mat().unwrap();
        to.write_mat(name, &mat).unwrap();
    }
    for name in ["rms_px", "offset_error_px", "scale_error_percent", "point_error_px", "neutral_depth_mm"] {
        to.write_f64(name, from.get(name).unwrap().real().unwrap()).unwrap();
    }
    to.release().unwrap();
    let back = read(std::slice::from_ref(&theirs.0)).unwrap();
    // The baseline is the translation's length here, the projection's there.
    assert!((back.baseline_mm - given.baseline_mm).abs() < 1e-9);
    assert_eq!(Calibration { baseline_mm: given.baseline_mm, ..back }, given);
}

#[test]
fn both_read_the_same_sample() {
    let path = Path::new("/usr/share/doc/opencv-doc/examples/data/intrinsics.yml");
    if !path.exists() {
        panoscope_testing::skipped!("Debian's opencv-doc is not installed");
        return;
    }
    let storage = FileStorage::new(path.to_str().unwrap(), FileStorage_READ, "").unwrap();
    let text = std::fs::read_to_string(path).unwrap();
    let outer = "%YAML:1.0\n---\nR: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nT: [-20, 0, 0]\n";
    let read = parse(&[(path, &text), (Path::new("extrinsics.yml"), outer)]).unwrap();
    let k = mat(&storage, "M2");
    assert_eq!([read.right.fx, read.right.cx, read.right.fy, read.right.cy], [k[0], k[2], k[4], k[5]]);
    assert_eq!(read.left.distortion[..5], mat(&storage, "D1")[..]);
}
