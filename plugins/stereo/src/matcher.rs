//! What `stereo_bm` and `stereo_sgbm` share: ports, the offset of the search, the warnings.

use panoscope_imaging::Rect;
use panoscope_imaging::lit::HeldMask;
use panoscope_imaging::stereo::{PairMatcher, PairParams, SearchParams, SemiGlobalMatcher, StereoError, StereoKernel};
use panoscope_node::abi;
use panoscope_node::{Context, Disparity, Gray8, Image, Mask, Params, Ports, Result, Slot, Validation, Value, error};

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Rectified left view.
    pub left: Image<'f, Gray8>,
    /// Rectified right view of the same instant, same size.
    pub right: Image<'f, Gray8>,
    /// Part of the left view that is matched; the whole view when unconnected.
    roi: Option<Value<'f, abi::Roi>>,
    /// Calibration of the rectified views; read only with `rectified_only`.
    calibration: Option<Value<'f, abi::Calibration>>,
    /// What of the left view is lit, not 0. Disparities whose blocks reach beyond stay unknown; without it all is lit.
    mask_left: Option<Image<'f, Mask>>,
    /// What of the right view is lit.
    mask_right: Option<Image<'f, Mask>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// Disparity of the left rectified view, px, positive; NaN where unmatched.
    pub disparity: Slot<'f, Disparity>,
    /// Disparity of the right rectified view, px: `x_left = x_right + disparity`; NaN where unmatched.
    pub disparity_right: Slot<'f, Disparity>,
    /// 1 while matched points lie farther off their rows than `drift_px`: the calibration does not fit the views. Else 0.
    drifted: Slot<'f, abi::Scalar>,
}

/// Parameters of the search, and of what is dropped after it.
#[derive(Params, Clone, Copy, Debug)]
pub struct SearchWindow {
    /// Finds the offset of the search from the region that both views show.
    #[param(default = true)]
    auto_offset: bool,
    /// Searches each part of the picture over its own range when one search does not hold what the views show. Needs `auto_offset`.
    #[param(default = true)]
    auto_range: bool,
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
    /// Makes no map in a tick without `calibration`: views that nobody has rectified cannot be matched along rows.
    #[param(default = false)]
    rectified_only: bool,
}

impl SearchWindow {
    /// As the matcher takes them. `left_right_px` is the kernel's.
    fn pair(&self, left_right_px: i32) -> PairParams {
        let search = SearchParams {
            auto_offset: self.auto_offset,
            auto_range: self.auto_range,
            min_disparity_px: self.min_disparity_px,
            keeps_asked: false,
            search_px: self.search_px,
            drift_px: self.drift_px,
        };
        PairParams { search, left_right_px: u32::try_from(left_right_px).ok(), speckle_area_px: self.speckle_area_px }
    }
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

/// Distance from the rim within which a block of this side matches the rim, px: farther away less than a quarter of a block lies on it.
pub fn rim_px(block_px: usize) -> usize {
    block_px / 4 + 1
}

/// The part of a matching node that is not its kernel.
pub struct Matcher {
    pair: PairMatcher,
    masks: [HeldMask; 2],
}

impl Matcher {
    pub fn new() -> Result<Self> {
        Ok(Self { pair: PairMatcher::new()?, masks: Default::default() })
    }

    /// Follows the masks of the views. Pixels within `rim_px` of a rim stay unknown.
    fn take_masks(&mut self, input: &In<'_>, size: (usize, usize), rim_px: usize) -> Result<()> {
        for (held, (side, mask)) in
            self.masks.iter_mut().zip([("left", &input.mask_left), ("right", &input.mask_right)])
        {
            let given = mask.as_ref().map(Image::view);
            if let Some(mask) = given.filter(|mask| (mask.width, mask.height) != size) {
                return Err(error!(
                    "`mask_{side}` is {}x{}, the views are {}x{}: connect the masks of these views",
                    mask.width, mask.height, size.0, size.1
                ));
            }
            held.update(given);
        }
        self.pair.set_lit(self.masks.each_ref().map(HeldMask::part), rim_px);
        Ok(())
    }
}

/// A kernel that can match a pair without its frames in the host's memory.
pub trait PairKernel: StereoKernel {
    /// Matches a pair where its frames are, as [`PairMatcher::compute`]. Returns whether it did.
    ///
    /// # Errors
    /// There is no frame memory for an output.
    fn match_there(
        &mut self,
        _: &mut PairMatcher,
        _: &Context<'_>,
        _: &In<'_>,
        _: &mut Out<'_>,
        _: Rect,
        _: &PairParams,
    ) -> Result<bool> {
        Ok(false)
    }
}

impl PairKernel for SemiGlobalMatcher {}

/// One tick of a node: matches the views in `roi` with the parameters that `kernel` has, its range apart. Pixels within `rim_px` of a rim stay unknown.
pub fn process<'f, K: PairKernel>(
    matcher: &mut Matcher,
    kernel: &mut K,
    cx: &Context<'f>,
    input: &In<'f>,
    out: &mut Out<'f>,
    (window, left_right_px, rim_px): (&SearchWindow, i32, usize),
) -> Result<()> {
    if window.rectified_only && input.calibration.is_none() {
        return Ok(());
    }
    let (width, height) = (input.left.width(), input.left.height());
    let (width_right, height_right) = (input.right.width(), input.right.height());
    if (width_right, height_right) != (width, height) {
        return Err(error!(
            "the left view is {width}x{height}, the right one {width_right}x{height_right}: a rectified pair has one size"
        ));
    }
    matcher.take_masks(input, (width, height), rim_px)?;
    let roi = input.roi.as_ref().map_or(Rect::whole(width, height), |roi| inside(roi, width, height));
    let params = window.pair(left_right_px);
    if !kernel.match_there(&mut matcher.pair, cx, input, out, roi, &params)? {
        let views = [input.left.view(), input.right.view()];
        let disparity = out.disparity.alloc(width, height)?;
        let other = if out.disparity_right.is_read() { Some(out.disparity_right.alloc(width, height)?) } else { None };
        matcher.pair.compute(cx, kernel, views, roi, &params, cx.pool(), disparity, other)?;
    }
    if out.drifted.is_read() {
        out.drifted.set_scalar("drifted", f64::from(u8::from(matcher.pair.is_drifted())), "")?;
    }
    Ok(())
}
