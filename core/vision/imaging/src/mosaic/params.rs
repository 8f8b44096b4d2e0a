//! Parameters, states, errors and reports of the mosaic.

use std::fmt;

use crate::features::{MatchParams, SurfParams};
use crate::geometry::{Homography, Plausibility, RansacParams};

/// Smallest side of a frame, in pixels: smaller ones hold too few features.
pub const MIN_SIDE_PX: usize = 64;

/// Model of the maps between keyframes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MosaicModel {
    /// Eight parameters: exact for a plane, however the camera moves.
    #[default]
    Homography,
    /// Six parameters: no perspective, which on curved tissue would grow from keyframe to keyframe.
    Affine,
    /// Four parameters: shift, turn and scale.
    Similarity,
}

impl MosaicModel {
    /// Number of parameters.
    pub fn degrees(self) -> usize {
        match self {
            Self::Homography => 8,
            Self::Affine => 6,
            Self::Similarity => 4,
        }
    }
}

/// Which part of the mosaic is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MosaicView {
    /// All of it, scaled down in steps as it grows.
    #[default]
    Fit,
    /// The part around the newest frame, at a fixed scale.
    Follow,
}

/// Parameters of a [`Mosaic`](super::Mosaic).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MosaicParams {
    /// Features of each frame.
    pub surf: SurfParams,
    /// Shrink factor before features are found.
    pub shrink: usize,
    /// Matching of descriptors.
    pub matching: MatchParams,
    /// Radius around the predicted position in which matches are searched first, in pixels; 0 searches everywhere.
    pub gate_px: f32,
    /// Robust estimation; the threshold is in pixels of the keyframe.
    pub ransac: RansacParams,
    /// Inliers below which a registration is rejected.
    pub min_inliers: usize,
    /// Share of the matches that must be inliers, 0..=1.
    pub min_inlier_share: f64,
    /// Plausibility limits of a frame in the plane of its keyframe.
    pub plausibility: Plausibility,
    /// Model of the maps between keyframes.
    pub model: MosaicModel,
    /// Overlap, 0..=1, below which with every keyframe a frame becomes a keyframe.
    pub keyframe_overlap: f64,
    /// Maximum number of keyframes; the oldest is dropped for a new one.
    pub max_keyframes: usize,
    /// Whether frames are registered against earlier keyframes and errors of closed loops are spread; otherwise only
    /// against the newest ones.
    pub loop_closure: bool,
    /// Movement of a keyframe in the image above which it is redrawn, in pixels.
    pub redraw_px: f64,
    /// Width of the image.
    pub width: usize,
    /// Height of the image.
    pub height: usize,
    /// Which part is shown.
    pub view: MosaicView,
    /// Image pixels per pixel of the first frame: the maximum in [`MosaicView::Fit`], fixed in
    /// [`MosaicView::Follow`].
    pub zoom: f64,
    /// Whether the exposure of keyframes is equalised.
    pub exposure: bool,
    /// Whether the newest frame is drawn on top, with its border.
    pub live: bool,
    /// Whether the image is marked while the camera is lost.
    pub mark_lost: bool,
}

impl Default for MosaicParams {
    fn default() -> Self {
        Self {
            surf: SurfParams {
                max_points: 500,
                hessian_threshold: 50.0,
                second_look: false,
                spread: (6, 4),
                ..SurfParams::default()
            },
            shrink: 2,
            matching: MatchParams { ratio: 0.8, ..MatchParams::default() },
            gate_px: 80.0,
            ransac: RansacParams { threshold_px: 3.0, ..RansacParams::default() },
            min_inliers: 15,
            min_inlier_share: 0.25,
            plausibility: Plausibility::default(),
            model: MosaicModel::default(),
            keyframe_overlap: 0.7,
            max_keyframes: 60,
            loop_closure: true,
            redraw_px: 1.0,
            width: 1280,
            height: 960,
            view: MosaicView::default(),
            zoom: 1.0,
            exposure: true,
            live: true,
            mark_lost: true,
        }
    }
}

/// Whether the newest frame was registered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MosaicState {
    /// The frame was registered to a keyframe.
    Fresh,
    /// Not registered: the mosaic is unchanged.
    #[default]
    Lost,
}

/// Result of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MosaicReport {
    /// Whether the newest frame was registered.
    pub state: MosaicState,
    /// Maps pixels of the newest frame to those of the first keyframe; the last good one when lost.
    pub mosaic_from_frame: Homography,
    /// Maps pixels of the first keyframe to those of the image.
    pub picture_from_mosaic: Homography,
    /// Matches that agree; 0 when lost.
    pub inliers: usize,
    /// Root mean square error of the inliers in the keyframe, in pixels; 0 when lost.
    pub rms_px: f64,
    /// Keyframes in the mosaic.
    pub keyframes: usize,
    /// Keyframes dropped because of `max_keyframes`.
    pub dropped: u64,
    /// Loops that were closed so far.
    pub closures: u64,
    /// Times that the camera was lost and found again.
    pub relocalised: u64,
    /// Frames that were not registered.
    pub lost_frames: u64,
    /// Times that the whole image was redrawn.
    pub redraws: u64,
    /// Area of the keyframes together, in percent of one frame.
    pub coverage_pct: f64,
    /// Length of the path of the frame's centre since the start, in pixels of the mosaic.
    pub path_px: f64,
    /// Error of the last closed loop before it was spread, in pixels; NaN before the first.
    pub drift_px: f64,
    /// The same in percent of the length of that loop.
    pub drift_pct: f64,
    /// Root mean square distance of the keyframes' shared points after the last adjustment, in pixels.
    pub spread_px: f64,
}

/// A frame that cannot be added, or a mosaic that cannot be drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MosaicError {
    /// Not three channels.
    Channels {
        /// Channels of the frame.
        channels: usize,
    },
    /// Too small for features.
    TooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Another size than the keyframes.
    SizeChanged {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Columns of the keyframes.
        want_width: usize,
        /// Rows of the keyframes.
        want_height: usize,
    },
    /// An image of another size than required.
    WrongPicture {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Channels.
        channels: usize,
        /// Columns expected.
        want_width: usize,
        /// Rows expected.
        want_height: usize,
    },
}

impl fmt::Display for MosaicError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Channels { channels } => {
                write!(f, "the frame has {channels} channels; a mosaic takes BGR frames with 3")
            }
            Self::TooSmall { width, height } => {
                write!(f, "the frame is {width}x{height} px; a mosaic needs at least {MIN_SIDE_PX}x{MIN_SIDE_PX}")
            }
            Self::SizeChanged { width, height, want_width, want_height } => write!(
                f,
                "the frame is {width}x{height} px but the mosaic was begun with {want_width}x{want_height}; \
                 begin a new mosaic for the new size"
            ),
            Self::WrongPicture { width, height, channels, want_width, want_height } => write!(
                f,
                "the picture to draw on is {width}x{height} with {channels} channels, \
                 expected {want_width}x{want_height} with 3"
            ),
        }
    }
}

impl std::error::Error for MosaicError {}
