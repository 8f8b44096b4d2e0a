//! EndoVis: the robotic instrument segmentation challenge of 2017 (Allan et al., 2019, arXiv:1902.06426) and the scene
//! segmentation challenge of 2018 (Allan et al., 2020, arXiv:2001.11190).
//!
//! ```text
//! 2017  instrument_dataset_1/camera_calibration.txt    made for 1280x1024; mm
//!                            left_frames, right_frames  frame000.png: 1920x1080 with a black border, the image in its middle
//!                            ground_truth/Left_Prograsp_Forceps_labels/frame000.png   one instrument a folder; its parts have different values
//! 2018  seq_1/camera_calibration.txt
//!             left_frames, right_frames                 frame000.png: 1280x1024
//!             labels/frame000.png                       a colour for each class
//!       labels.json                                     names and colours
//! ```
//!
//! Who rectified the set of 2017 found that its frames are interlaced, its views not quite of one instant, and the
//! calibrations of sets 3 and 6 off by 20 rows. Some copies call the folders `left_frame` and `right_frame`. The masks
//! of the test set of 2017 (`TypeSegmentation` and others) are not read.

use std::path::PathBuf;
use std::sync::Arc;

use crate::truth::masks::Code;

use crate::data_sets::folder::{Folder, by_stem, paired, stem};
use crate::data_sets::sequence::{CalibrationFiles, Labels, MaskFile, MaskLayer, Masks, Sequence};

const OF_2017: &str = "EndoVis 2017";
const OF_2018: &str = "EndoVis 2018";
/// Sizes of the stored frames of 2017, and of the image in their middle.
const STORED: (u32, u32) = (1920, 1080);
const PICTURE: [u32; 4] = [320, 28, 1280, 1024];
/// Types of instruments of 2017; folders are called by them, often with a side.
const TYPES: [&str; 7] = [
    "Bipolar Forceps",
    "Prograsp Forceps",
    "Large Needle Driver",
    "Vessel Sealer",
    "Grasping Retractor",
    "Monopolar Curved Scissors",
    "Other",
];
/// Objects in the images of 2018 that are not tissue, with colours for copies without labels.json.
const THINGS: [(&str, [u8; 3]); 7] = [
    ("instrument-shaft", [0, 255, 0]),
    ("instrument-clasper", [0, 255, 255]),
    ("instrument-wrist", [125, 255, 12]),
    ("clamps", [0, 255, 125]),
    ("suturing-needle", [255, 255, 125]),
    ("suction-instrument", [123, 15, 175]),
    ("ultrasound-probe", [12, 255, 141]),
];
/// Number of folders above a sequence in which labels.json may be.
const LEVELS_UP: usize = 3;

/// Masks of 2017: one folder for each instrument.
fn instruments(folder: &Folder, left: &[PathBuf]) -> Option<Masks> {
    let truth = folder.inner("ground_truth")?;
    let mut files = vec![Vec::new(); left.len()];
    for name in truth.folders() {
        let plain = name.replace('_', " ").to_ascii_lowercase();
        let Some(class) = TYPES.iter().position(|known| plain.contains(&known.to_ascii_lowercase())) else { continue };
        let layers: Arc<[MaskLayer]> = Arc::new([MaskLayer { code: Code::Set, class: class as u32 }]);
        let masks = truth.pictures(name);
        let masks = by_stem(&masks);
        for (files, frame) in files.iter_mut().zip(left) {
            if let Some(path) = masks.get(&stem(frame)) {
                files.push(MaskFile { path: (*path).clone(), layers: Arc::clone(&layers) });
            }
        }
    }
    let classes = TYPES.iter().map(|name| (*name).to_owned()).collect();
    files.iter().any(|files| !files.is_empty()).then_some(Masks { classes, files })
}

/// Colours of labels.json, in the folder or above it: a list of `name` and `color`. Missing entries are taken from the
/// published list.
fn colours(folder: &Folder, remarks: &mut Vec<String>) -> Vec<(String, [u8; 3])> {
    let path = std::path::absolute(&folder.path).unwrap_or_else(|_| folder.path.clone());
    let file = path.ancestors().take(LEVELS_UP).map(|folder| folder.join("labels.json")).find(|file| file.is_file());
    let published = || THINGS.iter().map(|(name, colour)| ((*name).to_owned(), *colour)).collect();
    let Some(file) = file else { return published() };
    let list = std::fs::read(&file).ok().and_then(|bytes| serde_json::from_slice::<serde_json::Value>(&bytes).ok());
    let Some(list) = list.as_ref().and_then(|list| list.as_array()) else {
        remarks.push(format!("{} is damaged: the published colours are taken", file.display()));
        return published();
    };
    let stated = |name: &str| -> Option<[u8; 3]> {
        let entry = list.iter().find(|entry| entry["name"].as_str() == Some(name))?;
        let values = entry["color"].as_array()?.iter().map(|value| value.as_u64().and_then(|v| u8::try_from(v).ok()));
        values.collect::<Option<Vec<u8>>>()?.try_into().ok()
    };
    THINGS.iter().map(|(name, colour)| ((*name).to_owned(), stated(name).unwrap_or(*colour))).collect()
}

/// Masks of 2018: one image with a colour for each class.
fn scene(folder: &Folder, left: &[PathBuf], remarks: &mut Vec<String>) -> Option<Masks> {
    let masks = folder.pictures("labels");
    let masks = by_stem(&masks);
    let colours = colours(folder, remarks);
    let layers: Arc<[MaskLayer]> = colours
        .iter()
        .enumerate()
        .map(|(class, (_, colour))| MaskLayer { code: Code::Colour(*colour), class: class as u32 })
        .collect();
    let file = |frame: &PathBuf| {
        let path = masks.get(&stem(frame));
        path.map(|path| MaskFile { path: (*path).clone(), layers: Arc::clone(&layers) }).into_iter().collect()
    };
    let files: Vec<Vec<MaskFile>> = left.iter().map(file).collect();
    let classes = colours.into_iter().map(|(name, _)| name).collect();
    files.iter().any(|files| !files.is_empty()).then_some(Masks { classes, files })
}

/// Adds the sequences of a folder; see [`super::Known`].
pub(super) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    let names = [["left_frames", "right_frames"], ["left_frame", "right_frame"]];
    let Some([left, right]) = names.into_iter().find(|[left, _]| folder.has_folder(left)) else { return false };
    let calibration = folder.first(&["camera_calibration.txt"]);
    let (has_truth, has_labels) = (folder.has_folder("ground_truth"), folder.has_folder("labels"));
    if calibration.is_none() && !has_truth && !has_labels {
        return false;
    }
    let (mut left, right) = (folder.pictures(left), folder.pictures(right));
    let (mut rights, mut lonely) = (Vec::new(), None);
    if !right.is_empty() {
        (left, rights, lonely) = paired(&left, &right);
    }
    if left.is_empty() {
        return false;
    }
    let is_2018 = has_labels || (!has_truth && folder.own_name().starts_with("seq"));
    let data_set = if is_2018 { OF_2018 } else { OF_2017 };
    let mut remarks: Vec<String> = lonely.into_iter().collect();
    let masks = if is_2018 { scene(folder, &left, &mut remarks) } else { instruments(folder, &left) };
    let count = left.len();
    let mut sequence = Sequence::of_files(data_set, folder.sequence_name(), &folder.path, left, rights);
    if !is_2018 && sequence.size == Some(STORED) {
        sequence.crop = Some(PICTURE);
        remarks.push(format!("the black border is cut off: views of {}x{}", PICTURE[2], PICTURE[3]));
        remarks.push("its frames are interlaced, and the views of a pair are not quite of one instant".to_owned());
    }
    sequence.labels = masks.map(Labels::Masks);
    let labelled = sequence.labels.as_ref().map_or(0, Labels::count);
    if (has_truth || has_labels) && labelled < count {
        remarks.push(format!("{} frames without labels", count - labelled));
    }
    sequence.remarks = remarks;
    sequence.calibration = calibration.map(|file| CalibrationFiles::one(vec![file]));
    sequences.push(sequence);
    true
}
