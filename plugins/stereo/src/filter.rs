//! `disparity_wls` and `disparity_fbs`: smooth, edge-true disparity maps (thesis, fig. 3.7).

use std::ops::Range;

use panoscope_imaging::Rect;
use panoscope_imaging::stereo::{
    BilateralSolver, BilateralSolverParams, ConfidenceParams, FilterInput, WlsFilter, WlsParams,
};
use panoscope_node::device::{Device, OnDevice};
use panoscope_node::{
    AnyImage, Confidence, Context, Disparity, Image, Mask, Node, NodeInfo, Open, Params, Ports, Result, Slot,
    Validation, View, ViewMut, error,
};

use crate::coarse::{Coarse, Job};
use crate::colours::Colours;
use crate::gpu::wls_filter::{GpuWlsFilter, WlsImages};
use crate::matcher::check_kernel;
use crate::shrinking::factor;

/// Inputs of both filters.
#[derive(Ports)]
pub struct In<'f> {
    /// Rectified left view, gray8 or bgr8. Its edges are kept in the map.
    image: AnyImage<'f>,
    /// Disparity of the left view, px.
    disparity: Image<'f, Disparity>,
    /// Disparity of the right view, px. Confidence is 0 where both views disagree.
    disparity_right: Option<Image<'f, Disparity>>,
    /// Confidence to use; without it the filter computes its own.
    confidence: Option<Image<'f, Confidence>>,
    /// What of the left view is lit, not 0. The map is unknown elsewhere; without it all is lit.
    mask: Option<Image<'f, Mask>>,
}

/// Outputs of both filters.
#[derive(Ports)]
pub struct Out<'f> {
    /// The smoothed map, px; NaN where too few trusted pixels are near.
    disparity: Slot<'f, Disparity>,
    /// Confidence of each pixel, 0 to 1.
    confidence: Slot<'f, Confidence>,
}

/// Sides of the filtered rectangle are multiples of this, so that it rarely changes.
const GRAIN_PX: usize = 32;

/// Whether a value of `part` is known. Visits all, so that the compiler can vectorise the loop.
fn any_known(part: &[f32]) -> bool {
    part.iter().fold(false, |any, value| any | value.is_finite())
}

/// The rectangle around all known disparities, widened to whole grains. No filter reaches beyond it.
fn known(disparity: View<'_, f32>) -> Rect {
    let (mut x0, mut x1, mut y0, mut y1) = (disparity.width, 0, disparity.height, 0);
    for y in 0..disparity.height {
        let row = disparity.row(y);
        let grains = || row.chunks(GRAIN_PX);
        let (Some(first), Some(last)) = (grains().position(any_known), grains().rposition(any_known)) else { continue };
        (x0, x1) = (x0.min(first * GRAIN_PX), x1.max((last + 1) * GRAIN_PX));
        (y0, y1) = (y0.min(y), y + 1);
    }
    if x0 >= x1 {
        return Rect::default();
    }
    let y = y0 / GRAIN_PX * GRAIN_PX;
    Rect { x: x0, y, width: x1 - x0, height: y1.next_multiple_of(GRAIN_PX) - y }
        .clamped(disparity.width, disparity.height)
}

/// The picture; sizes of all inputs are checked.
fn guide<'f>(input: &In<'f>) -> Result<Colours<'f>> {
    let size = (input.disparity.width(), input.disparity.height());
    let others = [
        ("image", Some((input.image.width(), input.image.height()))),
        ("disparity_right", input.disparity_right.as_ref().map(|map| (map.width(), map.height()))),
        ("confidence", input.confidence.as_ref().map(|map| (map.width(), map.height()))),
        ("mask", input.mask.as_ref().map(|map| (map.width(), map.height()))),
    ];
    for (name, other) in others {
        if let Some(other) = other.filter(|other| *other != size) {
            return Err(error!("`disparity` is {}x{}, `{name}` is {}x{}", size.0, size.1, other.0, other.1));
        }
    }
    Colours::of(&input.image)
}

/// The inputs as the kernels take them, sizes checked.
fn filter_input<'f>(input: &In<'f>) -> Result<FilterInput<'f>> {
    let (guide, disparity) = (guide(input)?.view(), input.disparity.view());
    Ok(FilterInput {
        guide,
        disparity,
        disparity_right: input.disparity_right.as_ref().map(Image::view),
        confidence: input.confidence.as_ref().map(Image::view),
        roi: known(disparity),
    })
}

/// Parameters of both filters: which disparities they trust.
#[derive(Params)]
struct TrustParams {
    /// Largest difference to the right view's disparity that is trusted.
    #[param(default = 1.5, range = 0.0..=16.0, step = 0.1, unit = "px")]
    left_right_px: f32,
    /// Radius of the neighbourhood whose scatter lowers confidence: 5 after `stereo_bm`, 3 after `stereo_sgbm`, 0 for none.
    #[param(default = 5, range = 0..=15, unit = "px")]
    scatter_radius_px: usize,
    /// Gray level from which a pixel is a highlight and not trusted; 256 trusts all.
    #[param(default = 250, range = 1..=256)]
    highlight_level: u32,
    /// Gray level up to which a pixel lies outside the scope's picture and is not trusted; -1 trusts all.
    #[param(default = 4, range = -1..=255)]
    dark_level: i32,
    /// Fills the map so far beyond the mask, where the picture is not black, at a width of 640 px. `rectify` ends its masks 5 px inside
    /// of the rim, and the surface goes on there.
    #[param(default = 0, range = 0..=16, unit = "px")]
    beyond_mask_px: usize,
}

impl TrustParams {
    /// Width of the strip beyond the mask in maps of a width, px.
    fn beyond_px(&self, width: usize) -> usize {
        (self.beyond_mask_px * width).div_ceil(640)
    }

    /// Levels of 256 and -1 become none.
    fn kernel(&self) -> ConfidenceParams {
        ConfidenceParams {
            left_right_px: self.left_right_px,
            scatter_radius_px: self.scatter_radius_px,
            highlight_level: u8::try_from(self.highlight_level).ok(),
            dark_level: u8::try_from(self.dark_level).ok(),
            ..ConfidenceParams::default()
        }
    }
}

/// Runs a filter on one tick's inputs into the outputs that are read.
fn filter<'f>(
    input: &In<'f>,
    out: &mut Out<'_>,
    trust: &TrustParams,
    lit: &mut Vec<Range<usize>>,
    run: impl FnOnce(Job<'f, '_>) -> Result<()>,
) -> Result<()> {
    let given = filter_input(input)?;
    let (width, height) = (given.disparity.width, given.disparity.height);
    let confidence_is_read = out.confidence.is_read();
    let mut disparity = out.disparity.alloc(width, height)?;
    let mut confidence = if confidence_is_read { Some(out.confidence.alloc(width, height)?) } else { None };
    run(Job { given, disparity: again(&mut disparity), confidence: confidence.as_mut().map(again) })?;
    if let Some(mask) = &input.mask {
        let px = trust.beyond_px(width);
        let beyond = Beyond { guide: given.guide, mask: mask.view(), dark_level: trust.dark_level, px };
        beyond.clear(lit, &mut disparity, f32::NAN);
        if let Some(confidence) = &mut confidence {
            beyond.clear(lit, confidence, 0.0);
        }
    }
    Ok(())
}

/// The same map, for one call.
fn again<'a>(map: &'a mut ViewMut<'_, f32>) -> ViewMut<'a, f32> {
    ViewMut { data: &mut *map.data, ..*map }
}

/// What a filter may fill: the mask, and a strip around it where the picture is not black.
struct Beyond<'f> {
    guide: View<'f, u8>,
    mask: View<'f, u8>,
    dark_level: i32,
    /// Width of the strip.
    px: usize,
}

/// The columns of a mask in each row, from the first to the last.
fn find_lit(mask: View<'_, u8>, lit: &mut Vec<Range<usize>>) {
    lit.clear();
    lit.extend((0..mask.height).map(|y| {
        let row = mask.row(y);
        let first = row.iter().position(|mask| *mask != 0).unwrap_or(row.len());
        first..row.iter().rposition(|mask| *mask != 0).map_or(first, |last| last + 1)
    }));
}

/// Columns of a row, of a map of a width, that are near a mask with these columns.
fn strip(lit: &[Range<usize>], y: usize, px: usize, width: usize) -> Range<usize> {
    let near = &lit[y.saturating_sub(px)..(y + px + 1).min(lit.len())];
    let near = near.iter().filter(|row| !row.is_empty());
    let (start, end) = near.fold((width, 0), |(start, end), row| (start.min(row.start), end.max(row.end)));
    start.saturating_sub(px)..(end + px).min(width)
}

impl Beyond<'_> {
    /// Sets the rest of `map` to `value`. `lit` is reused.
    fn clear(&self, lit: &mut Vec<Range<usize>>, map: &mut ViewMut<'_, f32>, value: f32) {
        find_lit(self.mask, lit);
        let channels = self.guide.channels;
        for y in 0..map.height {
            let strip = strip(lit, y, self.px, map.width);
            let (mask, guide) = (self.mask.row(y), self.guide.row(y));
            let is_filled = |x: usize| {
                let is_near = self.px > 0 && strip.contains(&x) && !lit[y].contains(&x);
                is_near && guide[x * channels..(x + 1) * channels].iter().any(|v| i32::from(*v) > self.dark_level)
            };
            for (x, (out, mask)) in map.row_mut(y).iter_mut().zip(mask).enumerate() {
                if *mask == 0 && !is_filled(x) {
                    *out = value;
                }
            }
        }
    }
}

/// Parameters of the weighted-least-squares filter.
#[derive(Params)]
pub struct DisparityWlsParams {
    /// Strength of the smoothing: strong smoothing flattens slopes. 1000 suits `stereo_bm`, 200 `stereo_sgbm`.
    #[param(default = 1000.0, range = 0.0..=1000000.0)]
    lambda: f32,
    /// Colour distance over which the coupling of two pixels falls to 1/e.
    #[param(default = 1.5, range = 0.1..=100.0, step = 0.1)]
    sigma_color: f32,
    /// Number of iterations over rows and columns.
    #[param(default = 3, range = 1..=8)]
    iterations: usize,
    /// Support below which a pixel stays unknown; 0 fills all pixels that the filter reaches.
    #[param(default = 0.1, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_support: f32,
    #[param(flatten)]
    trust: TrustParams,
    /// Factor by which maps and picture are shrunk before they are filtered, for maps that were matched so: as good at a fraction of the
    /// time. 0 finds it from the width: 1 below 640 px, 2 from 640, 3 from 1440, 4 from 2560.
    #[param(default = 1, range = 0..=8)]
    scale: usize,
    /// What filters, with the same map to 0.01 px. A GPU pays for large maps that are matched there. Without one the processor does it, with a warning.
    #[param(default = "cpu")]
    device: Device,
}

/// What a distance of colours becomes when the picture is gray.
const GRAY_SHARE: f32 = 0.577_35;

impl DisparityWlsParams {
    /// In pixels of maps that are shrunk by `factor`.
    fn kernel(&self, factor: usize) -> WlsParams {
        let mut confidence = self.trust.kernel();
        let mut sigma_color = self.sigma_color;
        if factor > 1 {
            confidence.left_right_px /= factor as f32;
            confidence.loss_per_px2 *= (factor * factor) as f32;
            confidence.scatter_radius_px = confidence.scatter_radius_px.div_ceil(factor);
            sigma_color = (sigma_color * GRAY_SHARE).max(0.1);
        }
        WlsParams {
            lambda: self.lambda / (factor * factor) as f32,
            sigma_color,
            iterations: self.iterations,
            min_support: self.min_support,
            confidence,
        }
    }
}

/// Weighted-least-squares filter.
pub struct DisparityWls {
    kernel: WlsFilter,
    /// Filters maps that stay on the GPU.
    gpu: OnDevice<GpuWlsFilter>,
    coarse: Coarse,
    /// Columns of the mask in each row.
    lit: Vec<Range<usize>>,
    /// Columns that may be filled, and those of the mask, in each row.
    rows: Vec<[u32; 4]>,
}

impl DisparityWls {
    /// Filters a map on the GPU, shrunk by `factor`, where it stays. Whether it did; a GPU that fails is given up.
    fn filter_there(
        &mut self,
        cx: &Context<'_>,
        (input, guide): (&In<'_>, &Colours<'_>),
        out: &mut Out<'_>,
        trust: &TrustParams,
        factor: usize,
    ) -> Result<bool> {
        if self.gpu.get().is_none() {
            return Ok(false);
        }
        let (width, height) = (input.disparity.width(), input.disparity.height());
        let beyond_px = trust.beyond_px(width);
        if let Some(mask) = &input.mask {
            find_lit(mask.view(), &mut self.lit);
            self.rows.clear();
            self.rows.extend(self.lit.iter().enumerate().map(|(y, lit)| {
                let strip = strip(&self.lit, y, beyond_px, width);
                [strip.start, strip.end, lit.start, lit.end].map(|x| x as u32)
            }));
        }
        self.gpu.attempt(cx, |gpu| {
            let mask = input.mask.as_ref().map(Image::on_device).transpose()?;
            let images = WlsImages {
                guide: guide.on_device()?,
                disparity: input.disparity.on_device()?,
                right: input.disparity_right.as_ref().map(Image::on_device).transpose()?,
                given: input.confidence.as_ref().map(Image::on_device).transpose()?,
                mask: mask.map(|mask| (mask, &self.rows[..])),
                beyond_px,
                smooth: out.disparity.alloc_on_device(width, height)?,
                confidence: match out.confidence.is_read() {
                    true => out.confidence.alloc_on_device(width, height)?,
                    false => gpu.spare(width, height)?,
                },
            };
            gpu.compute(&images, self.kernel.params(), factor)
        })
    }
}

impl Node for DisparityWls {
    const INFO: NodeInfo = NodeInfo::compute(
        "disparity_wls",
        "stereo",
        "Weighted least squares: fills and smooths a disparity map along the picture's edges, trusted pixels first.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = DisparityWlsParams;

    fn validate(params: &DisparityWlsParams, check: &mut Validation<'_>) {
        check_kernel(check, params.kernel(1).validate());
    }

    fn open(open: &Open<'_>, params: &DisparityWlsParams) -> Result<Self> {
        let mut node = Self {
            kernel: WlsFilter::new(params.kernel(1))?,
            gpu: OnDevice::default(),
            coarse: Coarse::default(),
            lit: Vec::new(),
            rows: Vec::new(),
        };
        node.gpu.choose(params.device, open, GpuWlsFilter::new);
        Ok(node)
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &DisparityWlsParams,
    ) -> Result<()> {
        let factor = factor(params.scale, input.disparity.width());
        let wanted = params.kernel(factor);
        if *self.kernel.params() != wanted {
            self.kernel.set_params(wanted)?;
        }
        self.gpu.choose(params.device, cx, GpuWlsFilter::new);
        if self.filter_there(cx, (&input, &guide(&input)?), &mut out, &params.trust, factor)? {
            return Ok(());
        }
        let (kernel, coarse) = (&mut self.kernel, &mut self.coarse);
        filter(&input, &mut out, &params.trust, &mut self.lit, |job| {
            coarse.run(factor, job, cx.pool(), |job| {
                Ok(kernel.compute(job.given, cx.pool(), job.disparity, job.confidence)?)
            })
        })
    }
}

/// Parameters of the fast bilateral solver.
#[derive(Params)]
pub struct DisparityFbsParams {
    /// Side of a grid cell.
    #[param(default = 8, range = 2..=128, unit = "px")]
    sigma_xy_px: usize,
    /// Height of a grid cell in gray levels.
    #[param(default = 16, range = 2..=128)]
    sigma_luma: usize,
    /// Weight of smoothness against closeness to the given map.
    #[param(default = 0.5, range = 0.0..=10000.0, step = 0.05)]
    lambda: f32,
    /// Largest number of conjugate gradient steps.
    #[param(default = 25, range = 1..=200)]
    iterations: usize,
    /// Residual at which the solver stops.
    #[param(default = 0.001, range = 0.0..=1.0, step = 0.0001, unit = "ratio")]
    tolerance: f32,
    /// Support below which a pixel stays unknown.
    #[param(default = 0.1, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_support: f32,
    /// Starts from the solution of the previous frame.
    #[param(default = true)]
    warm_start: bool,
    #[param(flatten)]
    trust: TrustParams,
}

impl DisparityFbsParams {
    fn kernel(&self) -> BilateralSolverParams {
        BilateralSolverParams {
            sigma_xy_px: self.sigma_xy_px,
            sigma_luma: self.sigma_luma,
            lambda: self.lambda,
            iterations: self.iterations,
            tolerance: self.tolerance,
            min_support: self.min_support,
            warm_start: self.warm_start,
            confidence: self.trust.kernel(),
        }
    }
}

/// Fast bilateral solver.
pub struct DisparityFbs {
    kernel: BilateralSolver,
    /// Columns of the mask in each row.
    lit: Vec<Range<usize>>,
}

impl Node for DisparityFbs {
    const INFO: NodeInfo = NodeInfo::compute(
        "disparity_fbs",
        "stereo",
        "Fast bilateral solver (Barron and Poole): the map close to trusted disparities and smooth wherever the picture is.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = DisparityFbsParams;

    fn validate(params: &DisparityFbsParams, check: &mut Validation<'_>) {
        check_kernel(check, params.kernel().validate());
    }

    fn open(_: &Open<'_>, params: &DisparityFbsParams) -> Result<Self> {
        Ok(Self { kernel: BilateralSolver::new(params.kernel())?, lit: Vec::new() })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &DisparityFbsParams,
    ) -> Result<()> {
        let wanted = params.kernel();
        if *self.kernel.params() != wanted {
            self.kernel.set_params(wanted)?;
        }
        let kernel = &mut self.kernel;
        filter(&input, &mut out, &params.trust, &mut self.lit, |job| {
            Ok(kernel.compute(job.given, cx.pool(), job.disparity, job.confidence)?)
        })?;
        cx.metric("solver_steps", self.kernel.steps() as f64);
        cx.metric("grid_vertices", self.kernel.vertices() as f64);
        Ok(())
    }
}
