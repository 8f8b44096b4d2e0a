//! Parameters of `capture`, and the checks that do not open a source.

use std::path::{Path, PathBuf};

use panoscope_imaging::stereo::OrderEvidence;
use panoscope_node::abi::Calibration;
use panoscope_node::{Choice, NodeError, Params, Rect, Result, Validation};

use crate::crop::{self, Halves};
use crate::exchanged::{FileView, exchanged};
use crate::playing::Playing;
use crate::source::{CaptureError, SourceName, unknown_element};
use crate::views::pair_by_numbers;

/// Default time of silence after which a live source is lost, s.
const TIMEOUT_S: f64 = 1.0;
/// Default time limit for opening, s.
const OPEN_LIMIT_S: f64 = 10.0;
/// Maximum number of views of one node.
pub const MAX_VIEWS: usize = 4;

/// How one source holds two views.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Every source is one view.
    None,
    /// The left view is the left half.
    SideBySide,
    /// The left view is the upper half.
    TopBottom,
}

/// When the node holds frames back to their rate.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// In live mode only. In batch mode frames come as fast as they are read.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// Whether the node rotates frames as their metadata says.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// As the metadata says.
    Upright,
    /// Never.
    AsStored,
}

/// What happens when a frame is damaged.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnDamage {
    /// The node fails and names the file. In batch mode the run ends there; in live mode it continues with the next frame.
    Fail,
    /// The tick is empty, with a warning; the next frame follows.
    Skip,
}

/// Parameters of `capture`.
#[derive(Params)]
pub struct Settings {
    /// Left view: camera number or /dev/videoN, video file, image, folder of images, pattern (dir/*.png or img_%04d.png), stream address (rtsp://...,
    /// or rtspt://... for TCP; a password as ${PANOSCOPE_SECRET_NAME}, an environment variable), or GStreamer pipeline (any text with !). Images of
    /// folders and patterns are paired by the numbers in their names, videos by time, live views by arrival.
    #[param(default = "", reopen, file)]
    pub left: String,
    /// Right view, as `left`.
    #[param(default = "", reopen, file)]
    pub right: String,
    /// Up to four views instead of `left` and `right`, separated by semicolons.
    #[param(default = "", reopen, file)]
    pub views: String,
    /// Splits one frame into both views; give `left` only.
    #[param(default = "none", reopen)]
    pub split: Split,
    /// Crop in px: x, y, width, height, once for all views or once for each. A width or height of 0 extends to the edge. Frames are split first.
    #[param(default = [], range = 0..=16, rectangles)]
    pub crop: Vec<f64>,
    /// Repeats files from the start. Without it a single image is one tick in batch mode.
    #[param(default = false, reopen)]
    pub r#loop: bool,
    /// Frames per second of media time, for all views. 0: the times in the videos, and 30 per second for images.
    #[param(default = 0.0, range = 0.0..=1000.0, unit = "Hz", reopen)]
    pub rate_hz: f64,
    /// When to hold frames back to their rate. Cameras keep their own pace.
    #[param(default = "auto")]
    pub pace: Pace,
    /// Number of ticks after which the source ends; 0 never ends it.
    #[param(default = 0, range = 0..=1000000000, unit = "frames")]
    pub frames: u64,
    /// Width requested from cameras; 0 keeps their mode.
    #[param(default = 0, range = 0..=16384, unit = "px", reopen)]
    pub width: u32,
    /// Height requested from cameras; 0 keeps their mode.
    #[param(default = 0, range = 0..=16384, unit = "px", reopen)]
    pub height: u32,
    /// Frame rate requested from cameras; 0 keeps their mode.
    #[param(default = 0.0, range = 0.0..=1000.0, unit = "Hz", reopen)]
    pub fps: f64,
    /// Locks exposure and gain of all cameras at the values of view 0 after `lock_after` frames.
    #[param(default = false, reopen)]
    pub lock_exposure: bool,
    /// Locks the white balance of all cameras at the value of view 0 after `lock_after` frames.
    #[param(default = false, reopen)]
    pub lock_white_balance: bool,
    /// Number of frames after which exposure and white balance are locked.
    #[param(default = 30, range = 0..=10000, unit = "frames", reopen)]
    pub lock_after: u64,
    /// What happens when a frame of a file is damaged. Damaged frames of live sources are counted and leave their tick empty.
    #[param(default = "fail")]
    pub on_damage: OnDamage,
    /// Whether frames are rotated as their metadata says (EXIF of images, the display matrix of videos).
    #[param(default = "upright", reopen)]
    pub orientation: Shown,
    /// Bit depth of frames with more than eight bits: 12 makes 4095 white. 0 finds it from the values and logs it.
    #[param(default = 0, range = 0..=16)]
    pub bit_depth: u32,
    /// Maximum time between frames that belong together. 0: half a period of the fastest view.
    #[param(default = 0.0, range = 0.0..=10000.0, unit = "ms", reopen)]
    pub tolerance_ms: f64,
    /// A camera, stream or live pipeline without data for this long is lost; it is reopened until it is back.
    #[param(default = TIMEOUT_S, range = 0.1..=60.0, unit = "s", reopen)]
    pub timeout_s: f64,
    /// Time limit for opening a camera, stream or pipeline.
    #[param(default = OPEN_LIMIT_S, range = 0.1..=600.0, unit = "s", reopen)]
    pub open_limit_s: f64,
    /// Calibration file of the first two views: OpenCV's FileStorage YAML, a Kalibr camera chain, or the file of KITTI, Middlebury, StereoMIS or
    /// EndoVis; the two files of ROS (left; right), of OpenCV's sample or of Hamlyn (intrinsics; extrinsics) are separated by a semicolon.
    #[param(default = "", reopen, file)]
    pub calibration: String,
    /// How files are played.
    #[param(flatten)]
    pub playing: Playing,
}

/// Why the parameters do not name a valid set of sources.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum SourcesError {
    /// No source is given.
    #[error(
        "no source is given: set `left` and `right` (camera, video, images or pipeline), `left` with `split`, or `views`"
    )]
    None,
    /// Both forms are given.
    #[error("give either `views` or `left` and `right`, not both")]
    Both,
    /// `right` is given without `left`.
    #[error("`right` is given without `left`")]
    RightAlone,
    /// More views than the node supports.
    #[error("{count} views exceed the limit of {MAX_VIEWS}")]
    TooMany { count: usize },
    /// `split` with more than one source.
    #[error("`split` divides one frame into both views: give only `left`")]
    SplitOfMany,
}

impl SourcesError {
    /// Name of the parameter that is wrong.
    pub fn param(self) -> &'static str {
        match self {
            Self::None => "left",
            Self::Both | Self::TooMany { .. } => "views",
            Self::RightAlone => "right",
            Self::SplitOfMany => "split",
        }
    }
}

impl Settings {
    /// Settings for files that another node names: no camera modes, no crop, no split.
    pub(crate) fn of_files() -> Self {
        let none = String::new;
        Self {
            left: none(),
            right: none(),
            views: none(),
            split: Split::None,
            crop: Vec::new(),
            r#loop: false,
            rate_hz: 0.0,
            pace: Pace::Auto,
            frames: 0,
            width: 0,
            height: 0,
            fps: 0.0,
            lock_exposure: false,
            lock_white_balance: false,
            lock_after: 0,
            on_damage: OnDamage::Fail,
            orientation: Shown::Upright,
            bit_depth: 0,
            tolerance_ms: 0.0,
            timeout_s: TIMEOUT_S,
            open_limit_s: OPEN_LIMIT_S,
            calibration: none(),
            playing: Playing::default(),
        }
    }

    /// Whether frames are rotated as their files say.
    pub fn is_upright(&self) -> bool {
        self.orientation == Shown::Upright
    }

    /// The texts that name sources, each with its parameter.
    ///
    /// # Errors
    /// No source, too many, or both forms at once.
    pub fn source_texts(&self) -> std::result::Result<Vec<(&'static str, &str)>, SourcesError> {
        let pair = [self.left.trim(), self.right.trim()];
        let list: Vec<&str> = self.views.split([';', '\n']).map(str::trim).filter(|t| !t.is_empty()).collect();
        let texts: Vec<(&'static str, &str)> = match (pair, list.is_empty()) {
            (["", ""], true) => return Err(SourcesError::None),
            (["", ""], false) => list.into_iter().map(|text| ("views", text)).collect(),
            (_, false) => return Err(SourcesError::Both),
            (["", _], true) => return Err(SourcesError::RightAlone),
            ([left, ""], true) => vec![("left", left)],
            ([left, right], true) => vec![("left", left), ("right", right)],
        };
        if texts.len() > MAX_VIEWS {
            return Err(SourcesError::TooMany { count: texts.len() });
        }
        if self.split != Split::None && texts.len() != 1 {
            return Err(SourcesError::SplitOfMany);
        }
        Ok(texts)
    }

    /// Reads the calibration, if a file is given.
    ///
    /// # Errors
    /// The file is not a calibration.
    pub fn read_calibration(&self, folder: &Path) -> Result<Option<Calibration>> {
        let names = self.calibration.split(';').map(str::trim).filter(|name| !name.is_empty());
        let files: Vec<PathBuf> = names.map(|name| folder.join(name)).collect();
        if files.is_empty() {
            return Ok(None);
        }
        panoscope_data::calibration::read(&files)
            .map(Some)
            .map_err(|error| NodeError::new(format!("calibration: {error}")))
    }

    /// Reports what cannot work, without opening a source.
    pub fn check(&self, check: &mut Validation<'_>) {
        let folder = check.graph_dir();
        let calibration = self.read_calibration(folder);
        if let Err(error) = &calibration {
            check.error("calibration", error.message(), "");
        } else if let Some(doubt) = calibration.iter().flatten().find_map(panoscope_data::calibration::doubt) {
            check.warning("calibration", doubt, "");
        } else if self.calibration.trim().is_empty() && check.is_read("calibration") == Some(true) {
            let message = "output `calibration` is connected but stays empty: no calibration file is given";
            check.warning("calibration", message, "give a file, as in calibration = \"stereo.yaml\"");
        }
        let texts = match self.source_texts() {
            Ok(texts) => texts,
            Err(error) => return check.error(error.param(), error.to_string(), ""),
        };
        let mut names = Vec::with_capacity(texts.len());
        for (param, text) in texts {
            if text.contains('!')
                && let Some(element) = unknown_element(text)
            {
                let message = format!("the pipeline names `{element}`, which is not an installed GStreamer element");
                check.error(
                    param,
                    message,
                    "correct the name, or install its plugin; gst-inspect-1.0 lists all elements",
                );
            }
            names.push(match SourceName::parse(text, folder) {
                Ok(name) => Some(name),
                // A camera may be plugged in before the graph runs.
                Err(error @ CaptureError::NoDevice { .. }) => {
                    check.warning(param, error.to_string(), "connect it before the graph runs");
                    None
                }
                Err(error) => {
                    check.error(param, error.to_string(), "");
                    None
                }
            });
        }
        self.check_crops(&names, check);
        if let Ok(Some(calibration)) = &calibration {
            self.check_order(&names, calibration, check);
        }
        let views = if self.split == Split::None { names.len() } else { 2 };
        let missing = [("right", 1), ("view1", 1), ("view2", 2), ("view3", 3)];
        if let Some((output, _)) =
            missing.iter().find(|(name, view)| *view >= views && check.is_read(name) == Some(true))
        {
            let message = format!(
                "output `{output}` is connected but stays empty: only {views} view{} given",
                if views == 1 { " is" } else { "s are" }
            );
            check.node_warning(message, "name one more source, or set `split`");
        }
    }

    /// How a frame is split; `None` if it is not.
    pub fn halves(&self) -> Option<Halves> {
        match self.split {
            Split::None => None,
            Split::SideBySide => Some(Halves::SideBySide),
            Split::TopBottom => Some(Halves::TopBottom),
        }
    }

    /// Reports image files that are swapped.
    fn check_order(&self, names: &[Option<SourceName>], calibration: &Calibration, check: &mut Validation<'_>) {
        let is_split = self.split != Split::None;
        let mut names: Vec<SourceName> = names.iter().flatten().cloned().collect();
        if names.len() < if is_split { 1 } else { 2 } {
            return;
        }
        if let Ok(texts) = self.source_texts() {
            let texts: Vec<String> = texts.into_iter().map(|(_, text)| text.to_owned()).collect();
            // Of files without a partner the node warns when it opens.
            if texts.len() == names.len() {
                pair_by_numbers(&mut names, &texts);
            }
        }
        let view = |view: usize| {
            let name = &names[if is_split { 0 } else { view }];
            let file = match name {
                SourceName::Image(file) => file,
                SourceName::Images(files) => files.first()?,
                _ => return None,
            };
            let (width, height) = name.picture_size(self.is_upright())?;
            let whole = Rect::whole(width, height);
            let mut rect = self.halves().map_or(whole, |halves| halves.of(whole, view));
            if let Some(crop) = crop::of_view(&self.crop, view, if is_split { 2 } else { names.len() }).ok()? {
                rect = crop::part(rect, crop).ok()?;
            }
            Some(FileView { file: file.clone(), rect, is_upright: self.is_upright() })
        };
        let (Some(left), Some(right)) = (view(0), view(1)) else { return };
        if let Some(OrderEvidence { pairs, fitting, .. }) = exchanged([left, right], calibration) {
            let message = format!(
                "left and right appear to be swapped: of {pairs} features in both views, {} fit the calibration as given and {} with the views swapped",
                fitting[0], fitting[1]
            );
            let help = if is_split {
                "connect output `right` where `left` is meant and `left` where `right` is, or use the calibration of these views"
            } else {
                "swap the sources of `left` and `right`, or use the calibration of these views"
            };
            check.warning("calibration", message, help);
        }
    }

    /// Reports crops that fit no frame, or not the first image of a view.
    fn check_crops(&self, names: &[Option<SourceName>], check: &mut Validation<'_>) {
        let views = if self.split == Split::None { names.len() } else { 2 };
        for view in 0..views {
            let crop = match crop::of_view(&self.crop, view, views) {
                Ok(Some(crop)) => crop,
                Ok(None) => return,
                Err(error) => return check.error("crop", error.to_string(), ""),
            };
            let name = names.get(if self.split == Split::None { view } else { 0 }).and_then(Option::as_ref);
            let checked = match name.and_then(|name| name.picture_size(self.is_upright())) {
                Some((width, height)) => {
                    let whole = Rect::whole(width, height);
                    crop::part(self.halves().map_or(whole, |halves| halves.of(whole, view)), crop).map(drop)
                }
                // The picture is not known yet: only numbers that fit no picture are refused.
                None => crop::whole_numbers(crop).map(drop),
            };
            if let Err(error) = checked {
                return check.error("crop", format!("view {view}: {error}"), "give x, y, width, height in px");
            }
        }
    }
}
