//! CholecSeg8k: frames of 17 operations of Cholec80, each pixel with its class (Hong et al., 2020, arXiv:2012.12453).
//!
//! ```text
//! video01/video01_00080/frame_80_endo.png
//!                       frame_80_endo_watershed_mask.png   gray: a number for each class
//!                       frame_80_endo_mask.png, frame_80_endo_color_mask.png   not read
//! ```
//!
//! Numbers of the watershed masks: 50 background, 11 abdominal wall, 21 liver, 13 gastrointestinal tract, 12 fat, 31
//! grasper, 23 connective tissue, 24 blood, 25 cystic duct, 32 L-hook electrocautery, 22 gallbladder, 33 hepatic vein,
//! 5 liver ligament. The data set does not publish them; public loaders agree on them. Only instruments become boxes.

use std::path::PathBuf;
use std::sync::Arc;

use crate::truth::masks::Code;

use crate::data_sets::folder::{Folder, files_in};
use crate::data_sets::sequence::{Labels, MaskFile, MaskLayer, Masks, Sequence};

const DATA_SET: &str = "CholecSeg8k";
const FRAME: &str = "_endo.png";
const MASK: &str = "_endo_watershed_mask.png";
/// Instruments and their numbers.
const INSTRUMENTS: [(&str, u8); 2] = [("Grasper", 31), ("L-hook Electrocautery", 32)];

fn name_of(path: &std::path::Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).unwrap_or("")
}

/// Adds the sequences of a folder; see [`super::Known`].
pub(super) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    if !folder.files().any(|name| name.starts_with("frame_") && name.ends_with(FRAME)) {
        return false;
    }
    let left: Vec<PathBuf> = files_in(&folder.path, |path| name_of(path).ends_with(FRAME));
    let layers: Arc<[MaskLayer]> = INSTRUMENTS
        .iter()
        .enumerate()
        .map(|(class, (_, number))| MaskLayer { code: Code::Colour([*number; 3]), class: class as u32 })
        .collect();
    let mask_of = |frame: &PathBuf| {
        let mask = name_of(frame).replace(FRAME, MASK);
        let files = folder.has(&mask).then(|| MaskFile { path: folder.at(&mask), layers: Arc::clone(&layers) });
        files.into_iter().collect::<Vec<_>>()
    };
    let files: Vec<Vec<MaskFile>> = left.iter().map(mask_of).collect();
    let missing = files.iter().filter(|files| files.is_empty()).count();
    let mut sequence = Sequence::of_files(DATA_SET, folder.sequence_name(), &folder.path, left, Vec::new());
    if missing > 0 {
        sequence.remarks.push(format!("{missing} frames without labels (*{MASK})"));
    }
    if missing < files.len() {
        let classes = INSTRUMENTS.iter().map(|(name, _)| (*name).to_owned()).collect();
        sequence.labels = Some(Labels::Masks(Masks { classes, files }));
    }
    sequences.push(sequence);
    true
}
