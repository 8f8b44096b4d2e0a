//! StereoMIS: da Vinci recordings of porcine and human operations (Hayoz et al., "Learning how to robustly estimate
//! camera pose in endoscopic videos", 2023; zenodo.org/records/7727691).
//!
//! ```text
//! P1/StereoCalibration.ini   raw cameras, mm
//!    NAME.mp4                left view above the right one
//!    groundtruth.txt         poses of the camera
//!    masks/000000l.png       instruments
//! ```

use crate::data_sets::folder::Folder;
use crate::data_sets::sequence::{CalibrationFiles, Sequence, Stacked};

const DATA_SET: &str = "StereoMIS";

/// Adds the sequences of a folder; see [`super::Known`].
pub(super) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    let Some(calibration) = folder.first(&["StereoCalibration.ini"]) else { return false };
    let videos: Vec<&str> = folder.files().filter(|name| name.to_ascii_lowercase().ends_with(".mp4")).collect();
    for video in &videos {
        let name = match videos.len() {
            1 => folder.sequence_name(),
            _ => format!("{}/{video}", folder.sequence_name()),
        };
        let mut sequence = Sequence::of_video(DATA_SET, name, &folder.path, folder.at(video), Stacked::TopBottom);
        sequence.calibration = Some(CalibrationFiles::one(vec![calibration.clone()]));
        if folder.has("groundtruth.txt") {
            sequence.remarks.push("the camera's poses in groundtruth.txt are not read".to_owned());
        }
        if folder.has_folder("masks") {
            sequence.remarks.push(
                "the pictures in masks are not read: which of their values is an instrument is not documented"
                    .to_owned(),
            );
        }
        sequences.push(sequence);
    }
    !videos.is_empty()
}
