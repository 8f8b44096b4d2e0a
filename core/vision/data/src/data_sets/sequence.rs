//! A sequence of a data set: its files and their meaning.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::calibration::{FileError, KittiCameras};
use crate::truth::masks::Code;
use panoscope_abi::Calibration;

use crate::data_sets::picture_size;

/// Images that belong together, with calibration, ground truth and labels.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// The data set.
    pub data_set: &'static str,
    /// Its path below the folder that was searched.
    pub name: String,
    /// Its folder.
    pub folder: PathBuf,
    /// The images.
    pub pictures: Pictures,
    /// Columns and rows of the first stored image; `None` for videos.
    pub size: Option<(u32, u32)>,
    /// Part of each stored view without its black border: x, y, width, height in px. Masks are cropped in the same way.
    pub crop: Option<[u32; 4]>,
    /// Calibration of both views.
    pub calibration: Option<CalibrationFiles>,
    /// True disparity, depth or points.
    pub truth: Option<Truth>,
    /// True objects.
    pub labels: Option<Labels>,
    /// Warnings for users of the sequence.
    pub remarks: Vec<String>,
}

/// The files of the views.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pictures {
    /// One file for each image; `right` has as many as `left`, or none if there is only one view.
    Files {
        /// Left view.
        left: Vec<PathBuf>,
        /// Right view.
        right: Vec<PathBuf>,
    },
    /// One video of both views.
    Video {
        /// The file.
        file: PathBuf,
        /// Positions of the views in its images.
        stacked: Stacked,
    },
}

/// Position of the views of a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stacked {
    /// The left view above the right one.
    TopBottom,
    /// The left view on the left.
    SideBySide,
}

/// Files that state the cameras.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CalibrationFiles {
    /// One list of files for the whole sequence, or one for each image. A list is empty if an image has none.
    pub sets: Vec<Vec<PathBuf>>,
    /// The cameras of a KITTI file that belong to the views.
    pub kitti: Option<KittiCameras>,
}

impl CalibrationFiles {
    /// One set for all images.
    pub fn one(files: Vec<PathBuf>) -> Self {
        Self { sets: vec![files], kitti: None }
    }

    /// Whether every image has separate files.
    pub fn is_per_picture(&self) -> bool {
        self.sets.len() > 1
    }

    /// Index of the set of an image.
    pub fn set_of(&self, picture: usize) -> usize {
        if self.is_per_picture() { picture } else { 0 }
    }

    /// Reads the calibration of an image; `None` if it has none.
    ///
    /// # Errors A file is missing or damaged; the error names it.
    pub fn read(&self, picture: usize) -> Result<Option<Calibration>, FileError> {
        match self.sets.get(self.set_of(picture)).map(Vec::as_slice) {
            None | Some([]) => Ok(None),
            Some([file]) => match self.kitti {
                Some(cameras) => crate::calibration::read_kitti(file, cameras).map(Some),
                None => crate::calibration::read(std::slice::from_ref(file)).map(Some),
            },
            Some(files) => crate::calibration::read(files).map(Some),
        }
    }
}

/// Content of the ground truth's files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holds {
    /// Disparity of the left rectified view.
    Disparity,
    /// Depth of the left rectified view.
    Depth,
    /// Points of the raw left camera, one for each pixel of the raw left view.
    Points,
    /// As [`Self::Points`], with those of the right view in the rows below.
    StackedPoints,
}

impl Holds {
    /// Description for messages.
    pub fn words(self) -> &'static str {
        match self {
            Self::Disparity => "disparity",
            Self::Depth => "depth",
            Self::Points | Self::StackedPoints => "points",
        }
    }
}

/// True maps.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// For each image its file, if it has one. May be shorter than the images; the rest has none.
    pub files: Vec<Option<PathBuf>>,
    /// Content of the files.
    pub holds: Holds,
    /// Divisor that converts their numbers to px or mm.
    pub divisor: f32,
}

impl Truth {
    /// Ground truth for the images that have a file; `None` when none has.
    pub(crate) fn of(files: Vec<Option<PathBuf>>, holds: Holds, divisor: f32) -> Option<Self> {
        files.iter().any(Option::is_some).then_some(Self { files, holds, divisor })
    }

    /// Number of images with ground truth.
    pub fn count(&self) -> usize {
        self.files.iter().flatten().count()
    }
}

/// True objects.
#[derive(Clone, Debug)]
pub enum Labels {
    /// VOC or YOLO files: for each image its file, if it has one.
    Boxes {
        /// The files.
        files: Vec<Option<PathBuf>>,
        /// Names of the classes, in the order of the data set, if it states one.
        classes: Vec<String>,
    },
    /// Images of classes.
    Masks(Masks),
}

impl Labels {
    /// Number of images with labels.
    pub fn count(&self) -> usize {
        match self {
            Self::Boxes { files, .. } => files.iter().flatten().count(),
            Self::Masks(masks) => masks.files.iter().filter(|files| !files.is_empty()).count(),
        }
    }

    /// Names of the classes.
    pub fn classes(&self) -> &[String] {
        match self {
            Self::Boxes { classes, .. } => classes,
            Self::Masks(masks) => &masks.classes,
        }
    }

    /// Description for messages.
    pub fn words(&self) -> &'static str {
        match self {
            Self::Boxes { .. } => "boxes",
            Self::Masks(_) => "masks",
        }
    }
}

/// Images of classes.
#[derive(Clone, Debug)]
pub struct Masks {
    /// Names of the classes in the data set.
    pub classes: Vec<String>,
    /// For each image its masks; empty if it has no labels.
    pub files: Vec<Vec<MaskFile>>,
}

/// One mask.
#[derive(Clone, Debug)]
pub struct MaskFile {
    /// The file.
    pub path: PathBuf,
    /// Meaning of its pixels.
    pub layers: Arc<[MaskLayer]>,
}

/// The pixels of one class.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MaskLayer {
    /// Code of its pixels.
    pub code: Code,
    /// Index of the class.
    pub class: u32,
}

impl Sequence {
    /// A sequence of image files without anything else. `right` may be empty.
    pub(crate) fn of_files(
        data_set: &'static str,
        name: String,
        folder: &Path,
        left: Vec<PathBuf>,
        right: Vec<PathBuf>,
    ) -> Self {
        let size = left.first().and_then(|file| picture_size::of(file));
        let folder = folder.to_owned();
        let pictures = Pictures::Files { left, right };
        Self {
            data_set,
            name,
            folder,
            pictures,
            size,
            crop: None,
            calibration: None,
            truth: None,
            labels: None,
            remarks: vec![],
        }
    }

    /// A video of both views without anything else.
    pub(crate) fn of_video(
        data_set: &'static str,
        name: String,
        folder: &Path,
        file: PathBuf,
        stacked: Stacked,
    ) -> Self {
        let whole = Self::of_files(data_set, name, folder, vec![], vec![]);
        Self { pictures: Pictures::Video { file, stacked }, ..whole }
    }

    /// Number of images; `None` for videos, which must be opened to know.
    pub fn count(&self) -> Option<usize> {
        match &self.pictures {
            Pictures::Files { left, .. } => Some(left.len()),
            Pictures::Video { .. } => None,
        }
    }

    /// Number of views.
    pub fn views(&self) -> usize {
        match &self.pictures {
            Pictures::Files { right, .. } if right.is_empty() => 1,
            _ => 2,
        }
    }
}
