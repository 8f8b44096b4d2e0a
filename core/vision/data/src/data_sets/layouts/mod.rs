//! One file for each data set: recognition of its folders, and the meaning of their files.

mod boxes;
mod cholecseg8k;
mod endovis;
mod hamlyn;
mod kitti;
mod middlebury;
mod pairs;
mod scared;
mod stereomis;

use crate::data_sets::folder::Folder;
use crate::data_sets::sequence::Sequence;

/// A known layout.
#[derive(Clone, Copy, Debug)]
pub struct Known {
    /// Name of the data set.
    pub data_set: &'static str,
    /// Required content of a folder of this layout.
    pub holds: &'static str,
    /// Adds the sequences of the folder; `false` if it does not belong to this data set.
    claim: fn(&Folder, &mut Vec<Sequence>) -> bool,
}

/// All layouts, in the order in which they claim a folder.
pub const KNOWN: &[Known] = &[
    Known {
        data_set: "SCARED",
        holds: "endoscope_calibration.yaml with Left_Image.png or data/rgb.mp4",
        claim: scared::claim,
    },
    Known { data_set: "StereoMIS", holds: "StereoCalibration.ini with an .mp4 of both views", claim: stereomis::claim },
    Known {
        data_set: "Hamlyn (rectified)",
        holds: "image01 with image02, or color with depth and intrinsics.txt",
        claim: hamlyn::claim,
    },
    Known {
        data_set: "EndoVis 2017, 2018",
        holds: "left_frames, with camera_calibration.txt, ground_truth or labels",
        claim: endovis::claim,
    },
    Known {
        data_set: "KITTI",
        holds: "image_2 with image_3, image_0 with image_1, colored_0 with colored_1, or image_02/data with image_03/data",
        claim: kitti::claim,
    },
    Known {
        data_set: "Middlebury",
        holds: "im0.png, im1.png and calib.txt; view1.png and view5.png; or im2 and im6 with disp2",
        claim: middlebury::claim,
    },
    Known {
        data_set: "CholecSeg8k",
        holds: "frame_N_endo.png with frame_N_endo_watershed_mask.png",
        claim: cholecseg8k::claim,
    },
    Known {
        data_set: "m2cai16-tool-locations, VOC, YOLO",
        holds: "JPEGImages with Annotations, or images with labels",
        claim: boxes::claim,
    },
    Known { data_set: "pairs of pictures", holds: "folders left and right", claim: pairs::claim },
];

/// Names of the data sets, for messages.
pub(crate) fn names() -> String {
    KNOWN.iter().map(|known| known.data_set).collect::<Vec<_>>().join("; ")
}

/// Adds the sequences of a folder that one of the layouts recognises.
pub(crate) fn claim(folder: &Folder, sequences: &mut Vec<Sequence>) -> bool {
    KNOWN.iter().any(|known| (known.claim)(folder, sequences))
}
