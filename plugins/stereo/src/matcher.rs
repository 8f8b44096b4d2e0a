//! What `stereo_bm` and `stereo_sgbm` share: ports, the offset of the search, the warnings.

use panoscope_imaging::Rect;
use panoscope_imaging::stereo::{self, SearchParams, SharedField, SpeckleFilter, StereoError};
use panoscope_node::abi;
use panoscope_node::{
    Context, Disparity, Gray8, Image, Parallel, Params, Ports, Result, Slot, Validation, Value, View, ViewMut, error,
};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Rectified left view.
    left: Image<'f, Gray8>,
    /// Rectified right view of the same instant, same size.
    right: Image<'f, Gray8>,
    /// Part of the left view that is matched; the whole view when unconnected.
    roi: Option<Value<'f, abi::Roi>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// Disparity of the left rectified view, px, positive; NaN where unmatched.
    disparity: Slot<'f, Disparity>,
    /// Disparity of the right rectified view, px: `x_left = x_right + disparity`; NaN where unmatched.
    disparity_right: Slot<'f, Disparity>,
}

/// A matching kernel with its parameters, offset included, set.
pub trait Engine {
    /// Matches `roi`; see the kernels.
    fn compute(
        &mut self,
        views: [View<'_, u8>; 2],
        roi: Rect,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        disparity_right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError>;
}

/// Parameters of the search, and of what is dropped after it.
#[derive(Params, Clone, Copy, Debug)]
pub struct SearchWindow {
    /// Finds the offset of the search from the region that both views show.
    #[param(default = true)]
    auto_offset: bool,
    /// Smallest disparity that is searched when the offset is not found from the pictures.
    #[param(default = 0, range = -1024..=2048, unit = "px")]
    pub min_disparity_px: i32,
    /// Number of disparities that are searched.
    #[param(default = 128, range = 32..=512, step = 32, unit = "px")]
    pub search_px: usize,
    /// Warns that the calibration does not fit when the median distance of matched points from their rows exceeds this; 0 never warns.
    #[param(default = 1.0, range = 0.0..=20.0, step = 0.1, unit = "px")]
    drift_px: f32,
    /// Removes patches of the left map with at most this many pixels as wrong matches; 0 keeps all.
    #[param(default = 0, range = 0..=10000, unit = "px")]
    speckle_area_px: usize,
}

impl SearchWindow {
    /// For the search of the offset.
    fn offset(&self) -> SearchParams {
        SearchParams {
            auto_offset: self.auto_offset,
            min_disparity_px: self.min_disparity_px,
            keeps_asked: false,
            search_px: self.search_px,
            drift_px: self.drift_px,
        }
    }
}

/// Largest step of disparity within a speckle.
const SPECKLE_STEP_PX: f32 = 1.0;

/// The part of a matcher that is not its kernel.
pub struct Matcher {
    search: stereo::Search,
    speckles: SpeckleFilter,
    field: SharedField,
    /// The right view's map when nobody reads it: the shared field is found by it.
    right: Vec<f32>,
}

/// Reports what a kernel refuses about its parameters; kernels name them as the nodes do.
pub fn check_kernel(check: &mut Validation<'_>, checked: Result<(), StereoError>) {
    match checked {
        Ok(()) => {}
        Err(StereoError::Parameter { name, value, accepted }) if check.has_param(name) => {
            check.error(name, format!("`{name}` is {value}, accepted is {accepted}"), "");
        }
        Err(other) => check.node_error(other.to_string(), ""),
    }
}

/// A rectangle of the packet inside a view.
pub fn inside(roi: &abi::Roi, width: usize, height: usize) -> Rect {
    let span = |from: i32, size: i32, limit: usize| {
        let end = (i64::from(from) + i64::from(size)).clamp(0, limit as i64) as usize;
        let from = i64::from(from).clamp(0, limit as i64) as usize;
        (from, end.saturating_sub(from))
    };
    let ((x, width), (y, height)) = (span(roi.x, roi.width, width), span(roi.y, roi.height, height));
    Rect { x, y, width, height }
}

impl Matcher {
    /// Nothing seen yet.
    ///
    /// # Errors
    /// As [`stereo::Search::new`].
    pub fn new() -> Result<Self> {
        Ok(Self {
            search: stereo::Search::new()?,
            speckles: SpeckleFilter::default(),
            field: SharedField::default(),
            right: Vec::new(),
        })
    }

    /// One tick. `prepare` gives the kernel its parameters for an offset.
    pub fn process<'f, E: Engine>(
        &mut self,
        cx: &Context<'f>,
        input: &In<'f>,
        out: &mut Out<'f>,
        window: SearchWindow,
        engine: &mut E,
        prepare: impl FnOnce(&mut E, i32) -> Result<(), StereoError>,
    ) -> Result<()> {
        let (left, right) = (input.left.view(), input.right.view());
        let (width, height) = (left.width, left.height);
        if (right.width, right.height) != (width, height) {
            return Err(error!(
                "the left view is {width}x{height}, the right one {}x{}: a rectified pair has one size",
                right.width, right.height
            ));
        }
        let roi = input.roi.as_ref().map_or(Rect::whole(width, height), |roi| inside(roi, width, height));
        let search = window.offset();
        let offset_px = self.search.begin(cx, [left, right], &search, cx.pool())?;
        prepare(engine, offset_px)?;
        let disparity = out.disparity.alloc(width, height)?;
        // A region was chosen by who knows what the views share; the whole frame is cut down to that by the maps of both views.
        let chosen = (roi.width, roi.height) != (width, height);
        let other = if out.disparity_right.is_read() {
            Some(out.disparity_right.alloc(width, height)?)
        } else if chosen {
            None
        } else {
            self.right.resize(width * height, f32::NAN);
            Some(ViewMut::new(&mut self.right, width, height, 1))
        };
        let map = ViewMut { data: &mut *disparity.data, ..disparity };
        let mut map = match other {
            Some(other) => {
                let map_right = ViewMut { data: &mut *other.data, ..other };
                engine.compute([left, right], roi, cx.pool(), map, Some(map_right))?;
                let mut map = ViewMut { data: &mut *disparity.data, ..disparity };
                self.field.clear_outside(&mut map, &mut ViewMut { data: &mut *other.data, ..other }, roi);
                map
            }
            None => {
                engine.compute([left, right], roi, cx.pool(), map, None)?;
                ViewMut { data: &mut *disparity.data, ..disparity }
            }
        };
        self.speckles.remove(&mut map, roi, window.speckle_area_px, SPECKLE_STEP_PX);
        self.search.end(cx, [left, right], disparity.as_view(), !chosen, &search);
        Ok(())
    }
}
