//! SCARED: "Stereo Correspondence and Reconstruction of Endoscopic Data" (Allan et al., 2021; EndoVis sub-challenge of
//! 2019).
//!
//! ```text
//! dataset_1/keyframe_1/endoscope_calibration.yaml   OpenCV's FileStorage: M1, D1, M2, D2, R, T (mm)
//!                      Left_Image.png, Right_Image.png
//!                      left_depth_map.tiff          x, y, z in mm of the raw left camera, by structured light; NaN unknown
//!                      data/rgb.mp4                 left view above the right one
//!                      data/scene_points.tar.gz     scene_points000000.tiff ...: points of both views, left above right; 0 unknown
//! ```

use std::path::Path;

use crate::data_sets::folder::{Folder, files_in, stem};
use crate::data_sets::sequence::{CalibrationFiles, Holds, Sequence, Stacked, Truth};

const DATA_SET: &str = "SCARED";
/// Maximum number of frames of a video; larger numbers are ignored.
const MAX_FRAMES: usize = 1_000_000;

/// Points of the frames by the numbers in their names.
fn scene_points(data: &Folder) -> Option<Truth> {
    let is_points = |path: &Path| {
        let is_tiff = path.extension().is_some_and(|ending| ending == "tiff" || ending == "tif");
        is_tiff && stem(path).starts_with("scene_points")
    };
    let mut files = files_in(&data.at("scene_points"), is_points);
    if files.is_empty() {
        files = files_in(&data.path, is_points);
    }
    let mut numbered = Vec::new();
    for file in files {
        let number =
            stem(&file).trim_start_matches(|c: char| !c.is_ascii_digit()).parse().ok().filter(|n| *n < MAX_FRAMES);
        let Some(number) = number else { continue };
        if numbered.len() <= number {
            numbered.resize(number + 1, None);
        }
        numbered[number] = Some(file);
    }
    Truth::of(numbered, Holds::StackedPoints, 1.0)
}

/// Adds the sequences of a folder; see [`super::Known`].
pub(super) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    let Some(calibration) = folder.first(&["endoscope_calibration.yaml"]) else { return false };
    let calibration = CalibrationFiles::one(vec![calibration]);
    let before = sequences.len();
    if folder.has("Left_Image.png") && folder.has("Right_Image.png") {
        let views = ["Left_Image.png", "Right_Image.png"].map(|name| vec![folder.at(name)]);
        let [left, right] = views;
        let mut keyframe = Sequence::of_files(DATA_SET, folder.sequence_name(), &folder.path, left, right);
        keyframe.calibration = Some(calibration.clone());
        let map = folder.first(&["left_depth_map.tiff", "left_depth_map.tif"]);
        keyframe.truth = Truth::of(vec![map], Holds::Points, 1.0);
        if keyframe.truth.is_none() {
            keyframe.remarks.push("there is no left_depth_map.tiff: the test sets come without truth".to_owned());
        }
        sequences.push(keyframe);
    }
    if let Some(data) = folder.inner("data").filter(|data| data.has("rgb.mp4")) {
        let name = if folder.name.is_empty() { format!("{}/data", folder.own_name()) } else { data.name.clone() };
        let mut video = Sequence::of_video(DATA_SET, name, &data.path, data.at("rgb.mp4"), Stacked::TopBottom);
        video.calibration = Some(calibration);
        video.truth = scene_points(&data);
        if video.truth.is_some() {
            let note = "the points of a frame are those of the keyframe, moved by the robot's kinematics: they are off by its errors";
            video.remarks.push(note.to_owned());
        } else if data.has("scene_points.tar.gz") {
            let note = "scene_points.tar.gz is packed: unpack it to data/scene_points to have its truth";
            video.remarks.push(note.to_owned());
        }
        sequences.push(video);
    }
    sequences.len() > before
}
