//! KITTI (Geiger et al., 2012, 2013; Menze and Geiger, 2015; cvlibs.net/datasets/kitti): stereo of 2012 and 2015,
//! odometry, raw recordings. All views are rectified.
//!
//! ```text
//! stereo 2015  training/image_2, image_3                  000000_10.png and _11.png, in colours
//!              training/disp_occ_0/000000_10.png          disparity x 256, 0 unknown
//!              training/calib_cam_to_cam/000000.txt       often in data_scene_flow_calib/training beside the images' folder
//! stereo 2012  training/colored_0, colored_1; image_0, image_1 (gray)
//!              training/disp_occ/000000_10.png; training/calib/000000.txt
//! odometry     sequences/00/image_2, image_3 (or image_0, image_1), calib.txt
//! raw          2011_09_26/calib_cam_to_cam.txt
//!              2011_09_26/DRIVE_sync/image_02/data, image_03/data (or image_00, image_01)
//!              DRIVE_sync/proj_depth/groundtruth/image_02/0000000005.png   of the depth completion set: depth in m x 256
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::calibration::KittiCameras::{self, Colour, Gray};

use crate::data_sets::folder::{Folder, by_stem, files_in, matching, paired, pictures_in, stem};
use crate::data_sets::sequence::{CalibrationFiles, Holds, Sequence, Truth};

/// Factor of stored disparities.
const DISPARITY: f32 = 256.0;
/// Divisor of stored depths, which are in m times 256, to mm.
const DEPTH: f32 = 0.256;
/// Left and right folder, cameras, folders of true disparity of the left view.
const STEREO: [(&str, &str, KittiCameras, &[&str]); 3] = [
    ("image_2", "image_3", Colour, &["disp_occ_0"]),
    ("colored_0", "colored_1", Colour, &["disp_occ"]),
    ("image_0", "image_1", Gray, &["disp_occ", "disp_occ_0"]),
];
const RAW: [(&str, &str, KittiCameras); 2] = [("image_02", "image_03", Colour), ("image_00", "image_01", Gray)];

fn is_text(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "txt")
}

/// Calibration files of single images by their number, as `000000` of `000000_10.png`.
fn texts(folder: &Folder) -> BTreeMap<String, PathBuf> {
    let mut folders = ["calib_cam_to_cam", "calib"].map(|name| folder.at(name)).to_vec();
    // The archive of the calibrations of 2015 unpacks beside that of the pictures.
    let path = std::path::absolute(&folder.path).unwrap_or_else(|_| folder.path.clone());
    if let (Some(own), Some(set)) = (path.file_name(), path.parent()) {
        let mut name = set.as_os_str().to_owned();
        name.push("_calib");
        folders.push(PathBuf::from(name).join(own).join("calib_cam_to_cam"));
    }
    let found = folders.into_iter().map(|folder| files_in(&folder, is_text)).find(|files| !files.is_empty());
    by_stem(&found.unwrap_or_default()).into_iter().map(|(stem, file)| (stem, file.clone())).collect()
}

fn calibration(folder: &Folder, left: &[PathBuf], cameras: KittiCameras) -> Option<CalibrationFiles> {
    if let Some(file) = folder.first(&["calib.txt", "calib_cam_to_cam.txt"]) {
        return Some(CalibrationFiles { sets: vec![vec![file]], kitti: Some(cameras) });
    }
    let texts = texts(folder);
    let number = |picture: &PathBuf| stem(picture).split('_').next().unwrap_or("").to_owned();
    let sets: Vec<Vec<PathBuf>> =
        left.iter().map(|picture| texts.get(&number(picture)).cloned().into_iter().collect()).collect();
    sets.iter().any(|set| !set.is_empty()).then_some(CalibrationFiles { sets, kitti: Some(cameras) })
}

/// One pair of cameras of the stereo and odometry sets.
fn stereo(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    let before = sequences.len();
    for (left_name, right_name, cameras, truths) in STEREO {
        if !folder.has_folder(left_name) || !folder.has_folder(right_name) {
            continue;
        }
        let (left, right, lonely) = paired(&folder.pictures(left_name), &folder.pictures(right_name));
        if left.is_empty() {
            continue;
        }
        let maps = truths.iter().map(|name| folder.pictures(name)).find(|maps| !maps.is_empty()).unwrap_or_default();
        let is_odometry = folder.has("calib.txt");
        let is_2012 = left_name != "image_2" || folder.has_folder("colored_0");
        let data_set = match (is_odometry, is_2012) {
            (true, _) => "KITTI odometry",
            (false, true) => "KITTI stereo 2012",
            (false, false) => "KITTI stereo 2015",
        };
        let truth = Truth::of(matching(&left, &maps), Holds::Disparity, DISPARITY);
        let calibration = calibration(folder, &left, cameras);
        let name = if folder.name.is_empty() { left_name.to_owned() } else { folder.name_of(left_name) };
        let mut sequence = Sequence::of_files(data_set, name, &folder.path, left, right);
        if calibration.is_none() {
            let note = "there is no calibration: unpack the set's calibration files here (calib or calib_cam_to_cam)";
            sequence.remarks.push(note.to_owned());
        }
        (sequence.truth, sequence.calibration) = (truth, calibration);
        sequence.remarks.extend(lonely);
        sequences.push(sequence);
    }
    sequences.len() > before
}

/// One pair of cameras of a raw recording.
fn raw(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    let before = sequences.len();
    for (left_name, right_name, cameras) in RAW {
        let pictures = |name: &str| pictures_in(&folder.at(name).join("data"));
        let (left, right, lonely) = paired(&pictures(left_name), &pictures(right_name));
        if left.is_empty() {
            continue;
        }
        let maps = pictures_in(&folder.at("proj_depth").join("groundtruth").join(left_name));
        let truth = Truth::of(matching(&left, &maps), Holds::Depth, DEPTH);
        let path = std::path::absolute(&folder.path).unwrap_or_else(|_| folder.path.clone());
        let file =
            path.ancestors().take(2).map(|folder| folder.join("calib_cam_to_cam.txt")).find(|file| file.is_file());
        let name = if folder.name.is_empty() { left_name.to_owned() } else { folder.name_of(left_name) };
        let mut sequence = Sequence::of_files("KITTI raw", name, &folder.path, left, right);
        if file.is_none() {
            let note = "there is no calibration: unpack the day's calib_cam_to_cam.txt into the folder above";
            sequence.remarks.push(note.to_owned());
        }
        sequence.calibration = file.map(|file| CalibrationFiles { sets: vec![vec![file]], kitti: Some(cameras) });
        sequence.truth = truth;
        sequence.remarks.extend(lonely);
        sequences.push(sequence);
    }
    sequences.len() > before
}

/// Adds the sequences of a folder; see [`super::Known`].
pub(super) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    stereo(folder, sequences) || raw(folder, sequences)
}
