//! Pairs of images in two folders, as written by many programs: `left` and `right`, paired by the numbers in their
//! names.
//!
//! A calibration next to the folders is read from `calibration`, `scope` or `stereo` with the extension .yml or .yaml.

use crate::calibration::views::matched;

use crate::data_sets::folder::{Folder, is_picture};
use crate::data_sets::sequence::{CalibrationFiles, Sequence};

const DATA_SET: &str = "pairs of pictures";
const CALIBRATIONS: [&str; 6] =
    ["calibration.yml", "calibration.yaml", "scope.yml", "scope.yaml", "stereo.yml", "stereo.yaml"];

/// Adds the sequences of a folder; see [`super::Known`].
pub(super) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    if !folder.has_folder("left") || !folder.has_folder("right") {
        return false;
    }
    let views = ["left", "right"].map(|name| folder.pictures(name));
    if views.iter().any(Vec::is_empty) {
        return false;
    }
    let found = matched(&views);
    let lonely: usize = found.lonely.iter().map(Vec::len).sum();
    let Ok([left, right]) = <[_; 2]>::try_from(found.views) else { return false };
    let mut sequence = Sequence::of_files(DATA_SET, folder.sequence_name(), &folder.path, left, right);
    if lonely > 0 {
        sequence.remarks.push(format!("{lonely} pictures without a partner are skipped"));
    }
    let calibration = folder.first(&CALIBRATIONS);
    if calibration.is_none() {
        let note = "there is no calibration: put one beside the folders as calibration.yml, or set `bypass` of `rectify` for rectified views";
        sequence.remarks.push(note.to_owned());
    }
    sequence.calibration = calibration.map(|file| CalibrationFiles::one(vec![file]));
    if folder.files().any(is_picture) {
        sequence.remarks.push("pictures beside the folders left and right belong to neither view".to_owned());
    }
    sequences.push(sequence);
    true
}
