//! `stereo_opencv`, `disparity_wls_opencv`, `disparity_fbs_opencv`: OpenCV's four steps behind the ports of our nodes, so that a graph can swap one
//! for the other (thesis, fig. 3.7 and table 3.2).

use opencv::calib3d::{StereoBM, StereoMatcher, StereoSGBM};
use opencv::core::{CV_16SC1, CV_32FC1, Mat, Ptr, Rect};
use opencv::prelude::*;
use opencv::ximgproc;
use panoscope_imaging::stereo::{self, SearchParams};
use panoscope_node::{
    Bgr8, Choice, Confidence, Context, Disparity, Gray8, Image, Node, NodeInfo, Open, Params, Ports, Result, Slot,
    Validation, View, ViewMut, error,
};

use crate::mats::{Threads, borrowed, failed};

/// Units of OpenCV's fixed-point disparities per px.
const STEPS_PER_PX: f32 = 16.0;

/// Matching algorithm.
#[derive(Choice, Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Block matching.
    Bm,
    /// Semi-global matching.
    Sgbm,
}

/// The disparities that are searched; the filter must know them too.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Search {
    method: Method,
    min_disparity_px: i32,
    search_px: i32,
    block_px: i32,
    own_checks: bool,
}

impl Search {
    fn matcher(&self) -> opencv::Result<Ptr<StereoMatcher>> {
        let side = self.block_px;
        Ok(match self.method {
            Method::Bm => {
                let mut matcher = StereoBM::create(self.search_px, side)?;
                matcher.set_min_disparity(self.min_disparity_px)?;
                if !self.own_checks {
                    matcher.set_texture_threshold(0)?;
                    matcher.set_uniqueness_ratio(0)?;
                }
                matcher.into()
            }
            Method::Sgbm => {
                // Penalties and mode of OpenCV's own sample `disparity_filtering`.
                let (p1, p2, cap) = (24 * side * side, 96 * side * side, 63);
                StereoSGBM::create(
                    self.min_disparity_px,
                    self.search_px,
                    side,
                    p1,
                    p2,
                    0,
                    cap,
                    0,
                    0,
                    0,
                    opencv::calib3d::StereoSGBM_MODE_SGBM_3WAY,
                )?
                .into()
            }
        })
    }

    fn unknown(&self) -> i16 {
        ((self.min_disparity_px - 1) * STEPS_PER_PX as i32) as i16
    }
}

/// Minimum window that OpenCV's block matching accepts, px.
const MIN_BM_BLOCK_PX: i32 = 5;

/// Reports a window that the matcher refuses.
fn check_window(check: &mut Validation<'_>, method: Method, block_px: i32) {
    if method == Method::Bm && block_px < MIN_BM_BLOCK_PX {
        let message = format!("`block_px` is {block_px}, but OpenCV's block matching needs at least {MIN_BM_BLOCK_PX}");
        check.error("block_px", message, "set a larger window, or method = \"sgbm\"");
    }
}

/// Converts OpenCV's disparities to px; values below `min_px` are unknown (NaN).
fn write(mat: &Mat, sign: f32, min_px: f32, out: &mut ViewMut<'_, f32>) -> Result<()> {
    let values = mat.data_typed::<i16>().map_err(failed)?;
    for (y, row) in values.chunks_exact(out.width.max(1)).enumerate() {
        for (out, value) in out.row_mut(y).iter_mut().zip(row) {
            let px = sign * f32::from(*value) / STEPS_PER_PX;
            *out = if px >= min_px { px } else { f32::NAN };
        }
    }
    Ok(())
}

/// Converts a map in px to OpenCV's disparities, with `unknown` where it is NaN.
fn sixteenths(view: View<'_, f32>, sign: f32, unknown: i16) -> opencv::Result<Mat> {
    // Added to a number below 2^22 it leaves the nearest integer in the low bits: one addition instead of a call per pixel.
    const ROUND: f32 = 12_582_912.0;
    let (least, most) = (f32::from(i16::MIN), f32::from(i16::MAX));
    let mut out = Mat::new_rows_cols_with_default(view.height as i32, view.width as i32, CV_16SC1, 0.0.into())?;
    for (y, row) in out.data_typed_mut::<i16>()?.chunks_exact_mut(view.width.max(1)).enumerate() {
        for (out, value) in row.iter_mut().zip(view.row(y)) {
            let steps = (sign * value * STEPS_PER_PX).clamp(least, most);
            let nearest = (steps + ROUND).to_bits().wrapping_sub(ROUND.to_bits()) as i16;
            *out = if value.is_nan() { unknown } else { nearest };
        }
    }
    Ok(out)
}

/// Parameters of the matcher.
#[derive(Params, Clone, PartialEq)]
pub struct StereoParams {
    /// Matching algorithm.
    #[param(default = "bm")]
    method: Method,
    /// Finds the offset of the search from the region that both views share.
    #[param(default = true)]
    auto_offset: bool,
    /// Minimum disparity searched when the offset is not found from the images.
    #[param(default = 0, range = -1024..=1500, unit = "px")]
    min_disparity_px: i32,
    /// Width of the disparity search.
    #[param(default = 64, range = 16..=512, step = 16, unit = "px")]
    search_px: i32,
    /// Side of the window: at least 5 for block matching.
    #[param(default = 15, range = 3..=31, step = 2, unit = "px")]
    block_px: i32,
    /// Checks of texture and uniqueness by block matching. OpenCV's sample `disparity_filtering` disables them in front of `disparity_wls_opencv`,
    /// which evaluates the matches itself.
    #[param(default = true)]
    own_checks: bool,
    /// Number of OpenCV's threads. Applies to the whole process while this node is open.
    #[param(default = 1, range = 1..=64)]
    threads: u32,
}

/// Inputs of the matcher.
#[derive(Ports)]
pub struct StereoIn<'f> {
    /// Rectified left view.
    left: Image<'f, Gray8>,
    /// Right view of the same instant, same size.
    right: Image<'f, Gray8>,
}

/// Outputs of the matcher.
#[derive(Ports)]
pub struct StereoOut<'f> {
    /// Pixels of the left rectified view; NaN where unmatched.
    disparity: Slot<'f, Disparity>,
    /// The same for the right view's pixels, positive.
    disparity_right: Slot<'f, Disparity>,
}

/// Both matchers; their memory is reused from frame to frame.
pub struct StereoOpencv {
    search: stereo::Search,
    kept: Option<(Search, Ptr<StereoMatcher>, Ptr<StereoMatcher>)>,
    threads: Threads,
}

// SAFETY: OpenCV's objects hold no thread's state; one thread at a time uses a node.
unsafe impl Send for StereoOpencv {}

impl Node for StereoOpencv {
    const INFO: NodeInfo =
        NodeInfo::compute("stereo_opencv", "stereo", "OpenCV's block or semi-global matching, left and right.");
    type In<'f> = StereoIn<'f>;
    type Out<'f> = StereoOut<'f>;
    type Params = StereoParams;

    fn validate(params: &StereoParams, check: &mut Validation<'_>) {
        check_window(check, params.method, params.block_px);
    }

    fn open(_: &Open<'_>, _: &StereoParams) -> Result<Self> {
        Ok(Self { search: stereo::Search::new()?, kept: None, threads: Threads::hold()? })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: StereoIn<'f>,
        mut out: StereoOut<'f>,
        params: &StereoParams,
    ) -> Result<()> {
        let (left, right) = (input.left.view(), input.right.view());
        let (width, height) = (left.width, left.height);
        if (right.width, right.height) != (width, height) {
            return Err(error!(
                "the left view is {width}x{height}, but the right one is {}x{}: connect views of one size",
                right.width, right.height
            ));
        }
        let place = SearchParams {
            auto_offset: params.auto_offset,
            // Its matchers take one range.
            auto_range: false,
            min_disparity_px: params.min_disparity_px,
            keeps_asked: true,
            search_px: params.search_px.max(0) as usize,
            drift_px: 0.0,
        };
        let offset_px = self.search.begin(cx, &mut [left, right], &place, cx.pool())?;
        let search = Search {
            method: params.method,
            min_disparity_px: offset_px,
            search_px: params.search_px,
            block_px: params.block_px,
            own_checks: params.own_checks,
        };
        self.threads.set(params.threads)?;
        let right_is_read = out.disparity_right.is_read();
        let mut matched = || -> opencv::Result<(Mat, Option<Mat>)> {
            if self.kept.as_ref().is_none_or(|(kept, ..)| *kept != search) {
                let matcher = search.matcher()?;
                let other = ximgproc::create_right_matcher(search.matcher()?)?;
                self.kept = Some((search, matcher, other));
            }
            let (left, right) = (borrowed(left)?, borrowed(right)?);
            // New ones in every call: nothing of the map before is left in them.
            let (mut map, mut map_right) = (Mat::default(), Mat::default());
            if let Some((_, matcher, other)) = &mut self.kept {
                matcher.compute(&left, &right, &mut map)?;
                if right_is_read {
                    other.compute(&right, &left, &mut map_right)?;
                }
            }
            Ok((map, right_is_read.then_some(map_right)))
        };
        let (map, map_right) = matched().map_err(failed)?;
        let least = offset_px as f32;
        let mut disparity = out.disparity.alloc(width, height)?;
        write(&map, 1.0, least, &mut disparity)?;
        if self.search.is_swapped() {
            disparity.data.fill(f32::NAN);
        }
        self.search.end(cx, &mut [left, right], &mut disparity.as_view(), true, &place)?;
        if let Some(map) = map_right {
            let mut disparity_right = out.disparity_right.alloc(width, height)?;
            write(&map, -1.0, least, &mut disparity_right)?;
            if self.search.is_swapped() {
                disparity_right.data.fill(f32::NAN);
            }
        }
        Ok(())
    }
}

/// Inputs of the weighted-least-squares filter.
#[derive(Ports)]
pub struct WlsIn<'f> {
    /// Rectified left view.
    image: Image<'f, Bgr8>,
    /// Disparity of the left view.
    disparity: Image<'f, Disparity>,
    /// Disparity of the right view.
    disparity_right: Image<'f, Disparity>,
}

/// Outputs of both filters.
#[derive(Ports)]
pub struct FilterOut<'f> {
    /// The smoothed map, px.
    disparity: Slot<'f, Disparity>,
    /// Confidence, 0 to 1; empty for `disparity_fbs_opencv`.
    confidence: Slot<'f, Confidence>,
}

/// Parameters of the weighted-least-squares filter and of the matcher in front of it.
#[derive(Params, Clone, PartialEq)]
pub struct WlsParams {
    /// Algorithm of the matcher in front of this filter.
    #[param(default = "bm", reopen)]
    method: Method,
    /// Minimum disparity that the matcher in front searches.
    #[param(default = 0, range = -1024..=1500, unit = "px", reopen)]
    min_disparity_px: i32,
    /// Number of disparities that the matcher in front searches.
    #[param(default = 64, range = 16..=512, step = 16, unit = "px", reopen)]
    search_px: i32,
    /// Side of the window of the matcher in front.
    #[param(default = 15, range = 3..=31, step = 2, unit = "px", reopen)]
    block_px: i32,
    /// Strength of the smoothing.
    #[param(default = 8000.0, range = 0.0..=1000000.0)]
    lambda: f64,
    /// Sensitivity to edges of the image.
    #[param(default = 1.5, range = 0.1..=100.0)]
    sigma_color: f64,
    /// Number of OpenCV's threads. Applies to the whole process while this node is open. The filter divides its rows among this number when it is
    /// created.
    #[param(default = 1, range = 1..=64, reopen)]
    threads: u32,
}

/// OpenCV's weighted-least-squares filter.
pub struct DisparityWlsOpencv {
    filter: Ptr<ximgproc::DisparityWLSFilter>,
    search: Search,
    threads: Threads,
    known: Vec<f32>,
}

/// Step in columns and rows when a map is sampled for its range of disparities.
const LOOK_STEP: usize = 4;
/// Offsets are multiples of this.
const OFFSET_STEP_PX: f32 = 8.0;

impl DisparityWlsOpencv {
    /// Follows the offset of the matcher in front, which may have found it from the images. If the requested search range contains less than half of
    /// the map's disparities, a range of the same width around them is used.
    fn follow(&mut self, map: View<'_, f32>) -> opencv::Result<()> {
        self.known.clear();
        for y in (0..map.height).step_by(LOOK_STEP) {
            self.known.extend(map.row(y).iter().step_by(LOOK_STEP).filter(|value| value.is_finite()));
        }
        let (first, end) = (self.search.min_disparity_px, self.search.min_disparity_px + self.search.search_px);
        let holds = |value: &&f32| (first as f32..end as f32).contains(*value);
        if 2 * self.known.iter().filter(holds).count() >= self.known.len() {
            return Ok(());
        }
        let middle = self.known.len() / 2;
        let (_, median, _) = self.known.select_nth_unstable_by(middle, f32::total_cmp);
        let offset = (*median - self.search.search_px as f32 / 2.0) / OFFSET_STEP_PX;
        self.search.min_disparity_px = (offset.floor() * OFFSET_STEP_PX).clamp(-1024.0, 1500.0) as i32;
        self.filter = ximgproc::create_disparity_wls_filter(self.search.matcher()?)?;
        Ok(())
    }
}

// SAFETY: OpenCV's filter holds no thread's state; one thread at a time uses a node.
unsafe impl Send for DisparityWlsOpencv {}

fn one_size(sizes: &[(usize, usize)]) -> Result<()> {
    match sizes.iter().find(|size| **size != sizes[0]) {
        Some(other) => Err(error!(
            "the inputs are {}x{} and {}x{}: connect inputs of one size",
            sizes[0].0, sizes[0].1, other.0, other.1
        )),
        None => Ok(()),
    }
}

impl Node for DisparityWlsOpencv {
    const INFO: NodeInfo = NodeInfo::compute(
        "disparity_wls_opencv",
        "stereo",
        "OpenCV's weighted-least-squares filter with its left-right confidence.",
    );
    type In<'f> = WlsIn<'f>;
    type Out<'f> = FilterOut<'f>;
    type Params = WlsParams;

    fn validate(params: &WlsParams, check: &mut Validation<'_>) {
        check_window(check, params.method, params.block_px);
    }

    fn open(_: &Open<'_>, params: &WlsParams) -> Result<Self> {
        let search = Search {
            method: params.method,
            min_disparity_px: params.min_disparity_px,
            search_px: params.search_px,
            block_px: params.block_px,
            own_checks: false,
        };
        let threads = Threads::hold()?;
        threads.set(params.threads)?;
        let filter = search.matcher().and_then(ximgproc::create_disparity_wls_filter).map_err(failed)?;
        Ok(Self { filter, search, known: Vec::new(), threads })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: WlsIn<'f>,
        mut out: FilterOut<'f>,
        params: &WlsParams,
    ) -> Result<()> {
        let (guide, left, right) = (input.image.view(), input.disparity.view(), input.disparity_right.view());
        let (width, height) = (left.width, left.height);
        one_size(&[(width, height), (guide.width, guide.height), (right.width, right.height)])?;
        self.threads.set(params.threads)?;
        self.follow(left).map_err(failed)?;
        cx.metric("offset_px", f64::from(self.search.min_disparity_px));
        let unknown = self.search.unknown();
        let mut filtered = || -> opencv::Result<(Mat, Mat)> {
            // A pixel of the right view that is unknown lies beyond every disparity searched.
            let beyond = -((self.search.min_disparity_px + self.search.search_px) * STEPS_PER_PX as i32) as i16;
            let (left, right) = (sixteenths(left, 1.0, unknown)?, sixteenths(right, -1.0, beyond)?);
            let mut map = Mat::default();
            self.filter.set_lambda(params.lambda)?;
            self.filter.set_sigma_color(params.sigma_color)?;
            let none = Mat::default();
            self.filter.filter(&left, &borrowed(guide)?, &mut map, &right, Rect::default(), &none)?;
            Ok((map, self.filter.get_confidence_map()?))
        };
        let (map, confidence) = filtered().map_err(failed)?;
        write(&map, 1.0, self.search.min_disparity_px as f32, &mut out.disparity.alloc(width, height)?)?;
        if out.confidence.is_read() {
            let mut target = out.confidence.alloc(width, height)?;
            let values = confidence.data_typed::<f32>().map_err(failed)?;
            for (y, row) in values.chunks_exact(width.max(1)).enumerate() {
                target.row_mut(y).iter_mut().zip(row).for_each(|(out, value)| *out = (value / 255.0).clamp(0.0, 1.0));
            }
        }
        Ok(())
    }
}

/// Inputs of the fast bilateral solver.
#[derive(Ports)]
pub struct FbsIn<'f> {
    /// Rectified left view.
    image: Image<'f, Bgr8>,
    /// Disparity of the left view.
    disparity: Image<'f, Disparity>,
    /// Confidence of the disparity.
    confidence: Image<'f, Confidence>,
}

/// Outputs of the fast bilateral solver.
#[derive(Ports)]
pub struct FbsOut<'f> {
    /// The smoothed map, px.
    disparity: Slot<'f, Disparity>,
}

/// Parameters of the fast bilateral solver; the defaults are those of OpenCV's sample.
#[derive(Params, Clone, PartialEq)]
pub struct FbsParams {
    /// Side of a grid cell.
    #[param(default = 16.0, range = 1.0..=128.0, unit = "px")]
    sigma_spatial: f64,
    /// Height of a grid cell in luminance.
    #[param(default = 8.0, range = 1.0..=128.0)]
    sigma_luma: f64,
    /// Height of a grid cell in colour.
    #[param(default = 8.0, range = 1.0..=128.0)]
    sigma_chroma: f64,
    /// Weight of smoothness against closeness to the given map.
    #[param(default = 128.0, range = 0.0..=100000.0)]
    lambda: f64,
    /// Number of OpenCV's threads, for the whole process while this node is open.
    #[param(default = 1, range = 1..=64)]
    threads: u32,
}

/// OpenCV's fast bilateral solver.
pub struct DisparityFbsOpencv {
    threads: Threads,
}

impl Node for DisparityFbsOpencv {
    const INFO: NodeInfo = NodeInfo::compute("disparity_fbs_opencv", "stereo", "OpenCV's fast bilateral solver.");
    type In<'f> = FbsIn<'f>;
    type Out<'f> = FbsOut<'f>;
    type Params = FbsParams;

    fn open(_: &Open<'_>, _: &FbsParams) -> Result<Self> {
        Ok(Self { threads: Threads::hold()? })
    }

    fn process<'f>(
        &mut self,
        _: &Context<'f>,
        input: FbsIn<'f>,
        mut out: FbsOut<'f>,
        params: &FbsParams,
    ) -> Result<()> {
        let (guide, map, trust) = (input.image.view(), input.disparity.view(), input.confidence.view());
        let (width, height) = (map.width, map.height);
        one_size(&[(width, height), (guide.width, guide.height), (trust.width, trust.height)])?;
        self.threads.set(params.threads)?;
        let solved = || -> opencv::Result<Mat> {
            let mut confidence = Mat::new_rows_cols_with_default(height as i32, width as i32, CV_32FC1, 0.0.into())?;
            for (y, row) in confidence.data_typed_mut::<f32>()?.chunks_exact_mut(width.max(1)).enumerate() {
                for ((out, value), disparity) in row.iter_mut().zip(trust.row(y)).zip(map.row(y)) {
                    *out = if disparity.is_nan() { 0.0 } else { *value };
                }
            }
            let (mut solved, source) = (Mat::default(), sixteenths(map, 1.0, 0)?);
            ximgproc::fast_bilateral_solver_filter(
                &borrowed(guide)?,
                &source,
                &confidence,
                &mut solved,
                params.sigma_spatial,
                params.sigma_luma,
                params.sigma_chroma,
                params.lambda,
                25,
                1e-5,
            )?;
            Ok(solved)
        };
        let solved = solved().map_err(failed)?;
        write(&solved, 1.0, 1.0 / STEPS_PER_PX, &mut out.disparity.alloc(width, height)?)
    }
}

#[cfg(test)]
mod tests {
    use opencv::prelude::*;
    use panoscope_node::View;

    #[test]
    fn sixteenths_are_the_nearest_and_stay_within_their_type() {
        let mut values: Vec<f32> = (-20_000..20_000).map(|step| step as f32 / 16.0).collect();
        values.extend([0.04, -0.04, 100.03, -1023.97, f32::NAN, 1e9, -1e9, f32::INFINITY]);
        let view = View::new(&values, values.len(), 1, 1);
        for sign in [1.0, -1.0] {
            let out = super::sixteenths(view, sign, -77).unwrap();
            for (out, value) in out.data_typed::<i16>().unwrap().iter().zip(&values) {
                let wanted = if value.is_nan() { -77 } else { (sign * value * 16.0).round() as i16 };
                assert_eq!(*out, wanted, "{sign} x {value}");
            }
        }
    }
}
