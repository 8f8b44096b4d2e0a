//! Middlebury stereo (Scharstein et al., 2001 to 2021; vision.middlebury.edu/stereo/data). All views are rectified; a
//! scene is one pair.
//!
//! ```text
//! 2014, 2021  Adirondack-perfect/im0.png, im1.png, calib.txt, disp0.pfm
//! MiddEval3   trainingH/Adirondack/im0.png, im1.png, calib.txt, disp0GT.pfm (of the archive with the truth)
//! 2005, 2006  Aloe/view1.png, view5.png, disp1.png
//! 2001, 2003  cones/im2.png, im6.png, disp2.png
//! ```
//!
//! PFM files hold px, infinite where unknown. The older images hold disparity times a factor that depends on their
//! size, 0 unknown: 1, 2, 3 at full, half and third size (2005, 2006), 1, 2, 4 at full, half and quarter size (2003), 8
//! (2001). Those sets come without calibration.

use crate::data_sets::folder::Folder;
use crate::data_sets::sequence::{CalibrationFiles, Holds, Sequence, Truth};

const DATA_SET: &str = "Middlebury";

/// A layout of an older set: left and right image, true maps, and the factor of the maps for a width of the views.
struct Old {
    left: &'static [&'static str],
    right: &'static [&'static str],
    map: &'static str,
    factor: fn(u32) -> Option<f32>,
}

const OLD: [Old; 2] = [
    Old { left: &["view1.png"], right: &["view5.png"], map: "disp1.png", factor: of_2006 },
    Old { left: &["im2.png", "im2.ppm"], right: &["im6.png", "im6.ppm"], map: "disp2.png", factor: of_2003 },
];

/// Factor of a map of 2005 or 2006, where full images have 1240 to 1400 columns.
fn of_2006(width: u32) -> Option<f32> {
    match width {
        1200..=1450 => Some(1.0),
        600..=725 => Some(2.0),
        400..=483 => Some(3.0),
        _ => None,
    }
}

/// Factor of a map of 2003 or 2001, where full images have 1800 and about 430 columns.
fn of_2003(width: u32) -> Option<f32> {
    match width {
        1800 => Some(1.0),
        900 => Some(2.0),
        450 => Some(4.0),
        425..=440 => Some(8.0),
        _ => None,
    }
}

/// Adds the sequences of a folder; see [`super::Known`].
pub(super) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    if folder.has("im0.png") && folder.has("im1.png") && folder.has("calib.txt") {
        let [left, right] = ["im0.png", "im1.png"].map(|name| vec![folder.at(name)]);
        let mut scene = Sequence::of_files(DATA_SET, folder.sequence_name(), &folder.path, left, right);
        scene.calibration = Some(CalibrationFiles::one(vec![folder.at("calib.txt")]));
        scene.truth = Truth::of(vec![folder.first(&["disp0GT.pfm", "disp0.pfm"])], Holds::Disparity, 1.0);
        if scene.truth.is_none() {
            scene.remarks.push("there is no disp0GT.pfm or disp0.pfm: the test sets come without truth".to_owned());
        }
        sequences.push(scene);
        return true;
    }
    let found = OLD.iter().find_map(|old| Some((old, folder.first(old.left)?, folder.first(old.right)?)));
    let Some((old, left, right)) = found else { return false };
    let mut scene = Sequence::of_files(DATA_SET, folder.sequence_name(), &folder.path, vec![left], vec![right]);
    scene.remarks.push("this set has no calibration: there is disparity but no depth".to_owned());
    let map = folder.first(&[old.map]);
    match (map, scene.size.and_then(|(width, _)| (old.factor)(width))) {
        (Some(map), Some(factor)) => scene.truth = Truth::of(vec![Some(map)], Holds::Disparity, factor),
        (Some(_), None) => {
            let width = scene.size.map_or(0, |(width, _)| width);
            let note =
                format!("{} is not read: the factor of its numbers is not known for views of {width} px", old.map);
            scene.remarks.push(note);
        }
        (None, _) => scene.remarks.push(format!("there is no {}: convert a .pgm to .png", old.map)),
    }
    sequences.push(scene);
    true
}
