//! Folders of pictures and videos, and the node that reads them.

// Every test file uses its part.
#![allow(dead_code)]

use std::fs;
use std::path::{Path, PathBuf};

use opencv::core::{Mat, Scalar, Size, Vec3b, Vector};
use opencv::prelude::*;
use opencv::{imgcodecs, videoio};
use panoscope_capture::capture::Capture;
use panoscope_node::Bgr8;
use panoscope_node::harness::{Harness, HarnessError, Level, Outputs, Setup};

pub const WIDTH: usize = 16;
pub const HEIGHT: usize = 8;

/// A folder of its own, removed at the end.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("panoscope_capture_{name}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn image(&self, name: &str, value: u8, width: usize) {
        let bgr: Vec<u8> = (0..width * HEIGHT).flat_map(|i| [value, (i % width) as u8, (i / width) as u8]).collect();
        let mat = Mat::new_rows_cols_with_bytes::<Vec3b>(HEIGHT as i32, width as i32, &bgr).unwrap();
        imgcodecs::imwrite(self.0.join(name).to_str().unwrap(), &mat, &Vector::new()).unwrap();
    }

    pub fn try_open(&self, params: &str) -> Result<Harness<Capture>, HarnessError> {
        Harness::open(Setup::new(&format!("params = {{ {params} }}")).graph_dir(&self.0).batch())
    }

    pub fn open(&self, params: &str) -> Harness<Capture> {
        self.try_open(params).unwrap()
    }

    pub fn refused(&self, params: &str) -> String {
        self.try_open(params).err().unwrap().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// First byte of an output's picture.
pub fn value(out: &Outputs, port: &str) -> u8 {
    out.plane::<Bgr8>(port).unwrap().data[0]
}

pub fn drain(node: &mut Harness<Capture>) -> Vec<Outputs> {
    let mut all = Vec::new();
    loop {
        let out = node.process().unwrap();
        if out.ended() || all.len() > 1000 {
            return all;
        }
        all.push(out);
    }
}

/// The same, up to and with the first failure.
pub fn drain_to_failure(node: &mut Harness<Capture>) -> (Vec<Outputs>, Option<String>) {
    let mut all = Vec::new();
    loop {
        match node.process() {
            Err(error) => return (all, Some(error.to_string())),
            Ok(out) if out.ended() || all.len() > 1000 => return (all, None),
            Ok(out) => all.push(out),
        }
    }
}

/// Whether a warning holds `words`.
pub fn warned(node: &Harness<Capture>, words: &str) -> bool {
    node.logs().iter().any(|line| line.level == Level::Warn && line.message.contains(words))
}

/// Motion JPEG: frame `i` is gray `20 i`.
pub fn write_video(path: &Path, frames: u8) {
    write_video_at(path, 20.0, (0..frames).map(|index| index.wrapping_mul(20)));
}

/// Motion JPEG with frames of these grays.
pub fn write_video_at(path: &Path, fps: f64, grays: impl Iterator<Item = u8>) {
    let fourcc = i32::from_le_bytes(*b"MJPG");
    let size = Size::new(64, 48);
    let mut writer =
        videoio::VideoWriter::new_with_backend(path, videoio::CAP_FFMPEG, fourcc, fps, size, true).unwrap();
    for gray in grays {
        let mat = Mat::new_rows_cols_with_default(48, 64, opencv::core::CV_8UC3, Scalar::all(f64::from(gray)));
        writer.write(&mat.unwrap()).unwrap();
    }
    writer.release().unwrap();
}
