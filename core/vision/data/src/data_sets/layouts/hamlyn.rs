//! Rectified Hamlyn sequences, as published with Endo-Depth-and-Motion (Recasens et al., 2021;
//! davidrecasens/EndoDepthAndMotion). The sequences are those of the Hamlyn Centre Laparoscopic / Endoscopic Video
//! Datasets.
//!
//! ```text
//! rectified01/[rectified01/]image01/0000000000.jpg   left view
//!                           image02/0000000000.jpg   right view
//!                           depth01/0000000000.png   16 bits, mm, 0 unknown; matched from the pair by a program
//! calibration/01/intrinsics.txt, extrinsics.txt      camera matrix of both views; their distance in mm
//! test1/color, depth, intrinsics.txt                 the sequences for tracking: one view
//! ```

use std::path::{Path, PathBuf};

use crate::data_sets::folder::{Folder, matching, paired, pictures_in};
use crate::data_sets::sequence::{CalibrationFiles, Holds, Sequence, Truth};

const DATA_SET: &str = "Hamlyn (rectified)";
/// Number of folders above a sequence in which the folder `calibration` may be.
const LEVELS_UP: usize = 3;

/// Intrinsics and extrinsics in one folder.
fn both_in(folder: &Path) -> Option<Vec<PathBuf>> {
    let files = ["intrinsics.txt", "extrinsics.txt"].map(|name| folder.join(name));
    files.iter().all(|file| file.is_file()).then(|| files.to_vec())
}

/// The calibration in the folder itself, or in `calibration/NN` for `rectifiedNN`.
fn calibration(folder: &Folder) -> Option<Vec<PathBuf>> {
    let own = folder.own_name();
    let number = own.trim_start_matches(|c: char| !c.is_ascii_digit());
    let path = std::path::absolute(&folder.path).ok()?;
    both_in(&path).or_else(|| {
        let above = path.ancestors().skip(1).take(LEVELS_UP);
        above.map(|folder| folder.join("calibration").join(number)).find_map(|folder| both_in(&folder))
    })
}

fn depth(left: &[PathBuf], folder: &Path) -> Option<Truth> {
    Truth::of(matching(left, &pictures_in(folder)), Holds::Depth, 1.0)
}

/// Adds the sequences of a folder; see [`super::Known`].
pub(super) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    let is_pair = folder.has_folder("image01") && folder.has_folder("image02");
    let is_single = folder.has_folder("color") && folder.has_folder("depth") && folder.has("intrinsics.txt");
    if !is_pair && !is_single {
        return false;
    }
    let (left, right, lonely) = if is_pair {
        paired(&folder.pictures("image01"), &folder.pictures("image02"))
    } else {
        (folder.pictures("color"), Vec::new(), None)
    };
    if left.is_empty() {
        return false;
    }
    let truth = depth(&left, &folder.at(if is_pair { "depth01" } else { "depth" }));
    let mut sequence = Sequence::of_files(DATA_SET, folder.sequence_name(), &folder.path, left, right);
    sequence.remarks.extend(lonely);
    if truth.is_some() {
        sequence.remarks.push("its depth was computed by a program, not measured".to_owned());
    }
    sequence.truth = truth;
    if is_pair {
        sequence.calibration = calibration(folder).map(CalibrationFiles::one);
        if sequence.calibration.is_none() {
            let note = "there is no calibration: put intrinsics.txt and extrinsics.txt of the data set's folder `calibration` here";
            sequence.remarks.push(note.to_owned());
        }
    }
    sequences.push(sequence);
    true
}
