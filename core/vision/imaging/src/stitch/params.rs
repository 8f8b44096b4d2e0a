//! Parameters, states, errors and reports of the compositor.

use std::fmt;

/// Largest number of views of one compositor.
pub const MAX_VIEWS: usize = 8;

/// Origin of the geometry of this frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GeometryState {
    /// Estimated from this frame.
    #[default]
    Fresh,
    /// The estimate of an earlier frame, kept because it still holds.
    Held,
    /// No estimate: the homographies are not used; the last good ones are used instead.
    Lost,
}

/// Method for the seam between two views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SeamMethod {
    /// Later views cover earlier ones.
    None,
    /// Shortest path through the overlap, one crossing per row (or column) of the seam grid. If more than two views
    /// meet, the overlap is not a strip and the graph cut is used.
    DynamicProgramming,
    /// Exact minimum cut over the seam grid (thesis 2.2 and Alg. 2.3).
    #[default]
    GraphCut,
}

/// Cost of a seam between two cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SeamCost {
    /// Euclidean colour difference of the two views (thesis 2.2).
    Color,
    /// Colour difference divided by the local gradient: seams hide along edges (Kwatra et al. 2003, eq. 2).
    #[default]
    ColorGradient,
    /// Colour difference, and its mean over the width of the transition if that is larger: a highlight in only one view
    /// is also visible next to the seam.
    Transition,
}

/// Method of blending along the seam.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BlendMethod {
    /// A hard seam without transition.
    None,
    /// Linear weights over `blend_px`.
    Feather,
    /// Laplacian pyramid, the binary mask blurred per band (Burt and Adelson 1983; thesis 2.2).
    #[default]
    MultiBand,
}

/// Method of exposure compensation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExposureMethod {
    /// No compensation.
    None,
    /// One gain per view.
    #[default]
    Gain,
    /// One gain per view and colour channel.
    ChannelGain,
}

/// Treatment of the outer border of the panorama, which is ragged where views end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BorderMethod {
    /// Unchanged.
    #[default]
    AsIs,
    /// The image fades to black towards it.
    Fade,
    /// Black outside the largest upright rectangle that the views cover.
    Crop,
}

/// Part of the plane that the panorama shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CropMethod {
    /// The canvas around the first good geometry, with its margin.
    #[default]
    None,
    /// The bounding box of the lit parts of the views.
    Content,
    /// The largest upright rectangle that the views fill with light: no black border.
    Filled,
}

/// Parameters of a [`Compositor`](super::Compositor).
#[derive(Clone, Debug, PartialEq)]
pub struct CompositeParams {
    /// Method for the seam.
    pub seam: SeamMethod,
    /// Cost of the seam between two cells.
    pub seam_cost: SeamCost,
    /// Canvas pixels per seam cell, each way (thesis: 10 at 640x480, 1 in its conventional pipeline). 1..=64; 0 derives
    /// it from the width of the reference view: 10 up to 1280 px, more in proportion beyond.
    pub seam_scale: usize,
    /// Maximum number of frames before the seam is recomputed; 1 = every frame.
    pub seam_interval_frames: u32,
    /// Growth factor of the cost along the seam at which it is recomputed.
    pub seam_cost_growth: f32,
    /// Cost, in colour levels, of a cell that changes its view: keeps the seam from flickering.
    pub seam_hold_levels: f32,
    /// Method of blending.
    pub blend: BlendMethod,
    /// Width of the transition across the seam, canvas pixels. 0 = hard seam; at most 256.
    pub blend_px: usize,
    /// Method of exposure compensation.
    pub exposure: ExposureMethod,
    /// Share of a new gain that enters the running one per frame, 0..=1.
    pub exposure_rate: f32,
    /// Canvas size in pixels, or `None` to take it from the first good geometry.
    pub canvas: Option<(usize, usize)>,
    /// Room kept free around the first geometry, canvas pixels.
    pub canvas_margin_px: usize,
    /// Consecutive frames beyond the canvas before it grows; 0 = it never grows.
    pub canvas_grow_after_frames: u32,
    /// Upper bound of canvas width and height, pixels.
    pub max_canvas_side_px: usize,
    /// Part of the plane that is shown. Without effect if `canvas` is fixed.
    pub crop: CropMethod,
    /// Time for which a larger part must have been covered before the panorama grows, s; 0..=60.
    pub crop_hold_s: f32,
    /// Treatment of the outer border.
    pub border: BorderMethod,
    /// Width of a fading border, canvas pixels; 1..=1024.
    pub border_px: usize,
    /// Direction of "up" in the reference view, degrees clockwise from the image's top; `None` draws no cue.
    pub up_cue_deg: Option<f32>,
    /// Marks frames whose geometry is lost (red frame and text).
    pub mark_lost: bool,
    /// Marks frames whose geometry is held (small amber corner).
    pub mark_held: bool,
}

impl CompositeParams {
    /// Pixels along a side of a cell of the coarse grid that seams and exposures work on, for a reference view of
    /// `width` columns.
    pub(super) fn cell_px(&self, width: usize) -> usize {
        match self.seam_scale {
            0 => (width / 128).clamp(10, 64),
            cell_px => cell_px.min(64),
        }
    }
}

impl Default for CompositeParams {
    fn default() -> Self {
        Self {
            seam: SeamMethod::default(),
            seam_cost: SeamCost::default(),
            seam_scale: 10,
            seam_interval_frames: 15,
            seam_cost_growth: 1.5,
            seam_hold_levels: 0.5,
            blend: BlendMethod::default(),
            blend_px: 32,
            exposure: ExposureMethod::default(),
            exposure_rate: 0.1,
            canvas: None,
            canvas_margin_px: 16,
            canvas_grow_after_frames: 15,
            max_canvas_side_px: 8192,
            crop: CropMethod::default(),
            crop_hold_s: 4.0,
            border: BorderMethod::default(),
            border_px: 24,
            up_cue_deg: None,
            mark_lost: true,
            mark_held: false,
        }
    }
}

/// Size of the panorama and position of the reference view in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Canvas {
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Canvas column of the reference plane's x = 0.
    pub left: i32,
    /// Canvas row of the reference plane's y = 0.
    pub top: i32,
}

/// A set of homographies that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GeometryFault {
    /// An element is NaN or infinite.
    NotFinite {
        /// Index of the view.
        view: usize,
    },
    /// The matrix has no inverse, or a part of the view lies behind the horizon.
    Singular {
        /// Index of the view.
        view: usize,
    },
    /// The warped corners do not form a convex quadrilateral of the same orientation (thesis 2.4.3).
    NotConvex {
        /// Index of the view.
        view: usize,
    },
    /// The warped view is far too large or too small (thesis 2.4.3).
    Size {
        /// Index of the view.
        view: usize,
    },
    /// The panorama would be larger than `max_canvas_side_px`.
    CanvasTooLarge {
        /// Columns it would need.
        width: usize,
        /// Rows it would need.
        height: usize,
    },
}

impl fmt::Display for GeometryFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite { view } => write!(f, "the homography of view {view} is not finite"),
            Self::Singular { view } => write!(f, "the homography of view {view} is singular or folds the view over"),
            Self::NotConvex { view } => write!(f, "view {view} warps to a shape that is not a convex quadrilateral"),
            Self::Size { view } => write!(f, "view {view} warps to an implausible size"),
            Self::CanvasTooLarge { width, height } => write!(f, "the panorama would need {width}x{height} px"),
        }
    }
}

/// Error of a call. Bad homographies are not an error: see [`GeometryFault`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CompositeError {
    /// No view, or more than [`MAX_VIEWS`].
    ViewCount {
        /// Views given.
        views: usize,
    },
    /// Views and homographies differ in number.
    HomographyCount {
        /// Views given.
        views: usize,
        /// Homographies given.
        homographies: usize,
    },
    /// A view is not BGR, or smaller than 2x2.
    View {
        /// Index of the view.
        view: usize,
        /// Its columns.
        width: usize,
        /// Its rows.
        height: usize,
        /// Its channels.
        channels: usize,
    },
    /// An output does not have the size (and channels) of the canvas.
    Output {
        /// Columns needed.
        width: usize,
        /// Rows needed.
        height: usize,
        /// Channels needed.
        channels: usize,
    },
}

impl fmt::Display for CompositeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ViewCount { views } => write!(f, "{views} views given, 1 to {MAX_VIEWS} can be joined"),
            Self::HomographyCount { views, homographies } => {
                write!(f, "{views} views but {homographies} homographies given")
            }
            Self::View { view, width, height, channels } => {
                write!(f, "view {view} is {width}x{height} with {channels} channels; BGR of at least 2x2 is needed")
            }
            Self::Output { width, height, channels } => {
                write!(f, "the output must be {width}x{height} with {channels} channels")
            }
        }
    }
}

impl std::error::Error for CompositeError {}

/// Result of [`compose`](super::Compositor::compose).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CompositeReport {
    /// State of the geometry that was shown: `Lost` also if the given homographies were rejected.
    pub state: GeometryState,
    /// Reason why the given homographies were rejected.
    pub fault: Option<GeometryFault>,
    /// Canvas drawn on.
    pub canvas: Canvas,
    /// Whether the seam was recomputed in this frame.
    pub seam_found: bool,
    /// Mean colour difference along the seam, levels.
    pub seam_cost: f32,
    /// Time for the seam: sampling the overlap at its scale, comparing the views there and, when due, recomputing the
    /// seam.
    pub seam_time: std::time::Duration,
    /// Additional area of the panorama over the reference view, percent. If it is cropped, only lit areas are counted.
    pub view_gain_percent: f64,
    /// Gains applied per view, B, G, R.
    pub gains: [[f32; 3]; MAX_VIEWS],
}
