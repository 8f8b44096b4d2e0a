//! `composite_opencv`: OpenCV's stitching classes in the order of its own stitcher: gains and seam on reduced views, blend at full resolution.

use opencv::core::{
    BORDER_CONSTANT, BORDER_REFLECT, CV_8U, CV_8UC1, CV_16S, CV_32F, Mat, Point, Rect, Scalar, Size, UMat, Vector,
    bitwise_and_def,
};
use opencv::imgproc::{self, INTER_LINEAR, INTER_LINEAR_EXACT, INTER_NEAREST};
use opencv::prelude::*;
use opencv::stitching::{
    Detail_DpSeamFinder, Detail_DpSeamFinder_CostFunction as DpCost, Detail_GainCompensator, Detail_GraphCutSeamFinder,
    Detail_GraphCutSeamFinderBase_CostType as CutCost, Detail_MultiBandBlender,
};
use panoscope_imaging::geometry::Homography as Map;
use panoscope_imaging::stitch::{self, Canvas, CompositeParams, Compositor, GeometryState};
use panoscope_node::abi::{self, Homography, Roi};
use panoscope_node::{
    Bgr8, Choice, Context, Gray8, Image, Mask, Node, NodeInfo, Open, Params, Ports, Result, Slot, Value, View,
};

use crate::mats::{self, Threads, borrowed, failed, umat};
use crate::register::shrink;

/// OpenCV's seam finders.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeamFinder {
    /// Minimum cut: `GraphCutSeamFinder`, as OpenCV's stitcher takes it.
    GraphCut,
    /// Shortest path by dynamic programming: `DpSeamFinder`.
    DynamicProgramming,
    /// No seam: the blender mixes the whole overlap.
    None,
}

/// Cost that the seam minimises.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeamCost {
    /// Differences of colour, as in OpenCV's stitcher and its sample `stitching_detailed`.
    Color,
    /// Differences of colour over gradients: the cut takes two to three times as long.
    ColorGrad,
}

/// Parameters of the composite.
#[derive(Params, Clone, PartialEq)]
pub struct CompositeOpencvParams {
    /// Size to which each view is reduced for gains and seam, in megapixels; 0 uses full resolution. OpenCV's stitcher uses 0.1.
    #[param(default = 0.0, range = 0.0..=10.0, step = 0.05)]
    seam_megapixels: f64,
    /// Method that finds the seam between the views.
    #[param(default = "graph_cut")]
    seam: SeamFinder,
    /// Cost that the seam minimises.
    #[param(default = "color")]
    seam_cost: SeamCost,
    /// Equalises the exposure with one gain per view.
    #[param(default = true)]
    gain: bool,
    /// Width of the blend, as a percentage of the panorama's side, as in OpenCV's sample.
    #[param(default = 5.0, range = 0.0..=100.0, step = 1.0, unit = "%")]
    blend_strength: f64,
    /// Margin around the first good registration, so that the canvas need not move.
    #[param(default = 16, range = 0..=512, unit = "px")]
    canvas_margin: u32,
    /// Number of OpenCV's threads. Applies to the whole process while this node is open.
    #[param(default = 1, range = 1..=64)]
    threads: u32,
}

/// Inputs of the composite.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view; the panorama is in its plane.
    left: Image<'f, Bgr8>,
    /// Right view of the same instant.
    right: Image<'f, Bgr8>,
    /// Maps right-view pixels to left-view pixels.
    homography: Value<'f, Homography>,
}

/// Outputs of the composite; empty while the registration is lost.
#[derive(Ports)]
pub struct Out<'f> {
    /// The panorama; black outside all views.
    panorama: Slot<'f, Bgr8>,
    /// 255 inside the views, 0 elsewhere.
    mask: Slot<'f, Mask>,
    /// Rectangle of the left view in the panorama, px.
    canvas: Slot<'f, Roi>,
    /// View that each pixel shows: 0 none, 1 left, 2 right.
    shown: Slot<'f, Gray8>,
}

/// The `composite_opencv` node.
pub struct CompositeOpencv {
    canvas: Compositor,
    threads: Threads,
}

/// A view warped onto the canvas.
struct CanvasView {
    corner: Point,
    image: Mat,
    mask: Mat,
}

fn upright(view: View<'_, u8>, canvas: &Canvas) -> opencv::Result<CanvasView> {
    let white = Scalar::all(255.0);
    let mask = Mat::new_rows_cols_with_default(view.height as i32, view.width as i32, CV_8UC1, white)?;
    let image = borrowed(view)?.try_clone()?;
    Ok(CanvasView { corner: Point::new(canvas.left, canvas.top), image, mask })
}

fn warped(view: View<'_, u8>, map: &Map, canvas: &Canvas) -> opencv::Result<CanvasView> {
    let moved = Map::translation(f64::from(canvas.left), f64::from(canvas.top)).compose(map);
    let corners = moved.map_corners(view.width, view.height).unwrap_or([[0.0; 2]; 4]);
    let bound = |axis: usize, side: usize| {
        let low = corners.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min).floor().max(0.0);
        let high = corners.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max).ceil().min(side as f64 - 1.0);
        (low as i32, (high - low) as i32 + 1)
    };
    let ((x, width), (y, height)) = (bound(0, canvas.width), bound(1, canvas.height));
    let local = Map::translation(-f64::from(x), -f64::from(y)).compose(&moved);
    let matrix = Mat::from_slice_2d(&[&local.0[..3], &local.0[3..6], &local.0[6..]])?;
    let size = Size::new(width.max(1), height.max(1));
    let black = Scalar::default();
    let (mut image, mut mask) = (Mat::default(), Mat::default());
    // Reflected at the border, as OpenCV's warpers do: the blender would carry black edges inwards.
    imgproc::warp_perspective(&borrowed(view)?, &mut image, &matrix, size, INTER_LINEAR, BORDER_REFLECT, black)?;
    let white = Mat::new_rows_cols_with_default(view.height as i32, view.width as i32, CV_8UC1, Scalar::all(255.0))?;
    imgproc::warp_perspective(&white, &mut mask, &matrix, size, INTER_NEAREST, BORDER_CONSTANT, black)?;
    Ok(CanvasView { corner: Point::new(x, y), image, mask })
}

/// The view reduced for gains and seam.
fn shrunk(view: &CanvasView, scale: f64) -> opencv::Result<CanvasView> {
    let (mut image, mut mask) = (Mat::default(), Mat::default());
    imgproc::resize(&view.image, &mut image, Size::default(), scale, scale, INTER_LINEAR_EXACT)?;
    imgproc::resize(&view.mask, &mut mask, Size::default(), scale, scale, INTER_NEAREST)?;
    let at = |v: i32| (f64::from(v) * scale).round() as i32;
    Ok(CanvasView { corner: Point::new(at(view.corner.x), at(view.corner.y)), image, mask })
}

fn corners(views: &[CanvasView; 2]) -> Vector<Point> {
    views.iter().map(|view| view.corner).collect()
}

/// Estimates one gain per view where they overlap.
fn gains(views: &[CanvasView; 2]) -> opencv::Result<Detail_GainCompensator> {
    let mut compensator = Detail_GainCompensator::default()?;
    let (mut images, mut masks) = (Vector::<UMat>::new(), Vector::<UMat>::new());
    for view in views {
        images.push(umat(&view.image)?);
        masks.push(umat(&view.mask)?);
    }
    Detail_ExposureCompensatorTrait::feed(&mut compensator, &corners(views), &images, &masks)?;
    Ok(compensator)
}

fn apply(compensator: &mut Detail_GainCompensator, views: &mut [CanvasView; 2]) -> opencv::Result<()> {
    for (index, view) in views.iter_mut().enumerate() {
        let (image, mask) = (&mut view.image, &view.mask);
        Detail_ExposureCompensatorTrait::apply(compensator, index as i32, view.corner, image, mask)?;
    }
    Ok(())
}

/// Masks of both views cut along the seam, at the size of the views.
fn seam(views: &[CanvasView; 2], params: &CompositeOpencvParams) -> opencv::Result<[Mat; 2]> {
    const TERMINAL_COST: f32 = 10_000.0;
    const BAD_REGION_PENALTY: f32 = 1_000.0;
    let (mut images, mut masks) = (Vector::<UMat>::new(), Vector::<UMat>::new());
    for view in views {
        // The dynamic programming takes 8-bit pictures too, and is as fast with either.
        let mut float = UMat::new_def();
        view.image.convert_to(&mut float, CV_32F, 1.0, 0.0)?;
        images.push(float);
        masks.push(umat(&view.mask)?);
    }
    let color = params.seam_cost == SeamCost::Color;
    match params.seam {
        SeamFinder::GraphCut => {
            let cost = if color { CutCost::COST_COLOR } else { CutCost::COST_COLOR_GRAD };
            let mut finder = Detail_GraphCutSeamFinder::new(cost as i32, TERMINAL_COST, BAD_REGION_PENALTY)?;
            Detail_SeamFinderTrait::find(&mut finder, &images, &corners(views), &mut masks)?;
        }
        SeamFinder::DynamicProgramming => {
            let mut finder = Detail_DpSeamFinder::new(if color { DpCost::COLOR } else { DpCost::COLOR_GRAD })?;
            Detail_SeamFinderTrait::find(&mut finder, &images, &corners(views), &mut masks)?;
        }
        SeamFinder::None => {}
    }
    Ok([mats::from_umat(&masks.get(0)?)?, mats::from_umat(&masks.get(1)?)?])
}

/// A mask cut on the reduced view, enlarged to the size of the full one.
fn enlarged(small: &Mat, whole: &Mat) -> opencv::Result<Mat> {
    let (mut wide, mut full, mut cut) = (Mat::default(), Mat::default(), Mat::default());
    imgproc::dilate_def(small, &mut wide, &Mat::default())?;
    imgproc::resize(&wide, &mut full, whole.size()?, 0.0, 0.0, INTER_LINEAR_EXACT)?;
    bitwise_and_def(&full, whole, &mut cut)?;
    Ok(cut)
}

fn compose(
    views: [View<'_, u8>; 2],
    map: &Map,
    canvas: &Canvas,
    params: &CompositeOpencvParams,
    with_shown: bool,
) -> opencv::Result<Joined> {
    let mut placed = [upright(views[0], canvas)?, warped(views[1], map, canvas)?];
    let scale = shrink(params.seam_megapixels, views[0].width * views[0].height);
    let mut small = if scale < 1.0 { Some([shrunk(&placed[0], scale)?, shrunk(&placed[1], scale)?]) } else { None };
    if params.gain {
        let mut compensator = gains(small.as_ref().unwrap_or(&placed))?;
        apply(&mut compensator, &mut placed)?;
        if let Some(small) = small.as_mut().filter(|_| params.seam != SeamFinder::None) {
            apply(&mut compensator, small)?;
        }
    }
    let cut = match (&small, params.seam) {
        (_, SeamFinder::None) => [placed[0].mask.clone(), placed[1].mask.clone()],
        (None, _) => seam(&placed, params)?,
        (Some(small), _) => {
            let cut = seam(small, params)?;
            [enlarged(&cut[0], &placed[0].mask)?, enlarged(&cut[1], &placed[1].mask)?]
        }
    };

    let width_px = ((canvas.width * canvas.height) as f64).sqrt() * params.blend_strength / 100.0;
    let bands = if width_px < 2.0 { 0 } else { (width_px.log2().ceil() as i32 - 1).max(0) };
    let mut blender = Detail_MultiBandBlender::new(0, bands, CV_32F)?;
    let whole = Rect::new(0, 0, canvas.width as i32, canvas.height as i32);
    Detail_MultiBandBlenderTrait::prepare(&mut blender, whole)?;
    for (view, mask) in placed.iter().zip(&cut) {
        let mut wide = Mat::default();
        view.image.convert_to(&mut wide, CV_16S, 1.0, 0.0)?;
        Detail_MultiBandBlenderTrait::feed(&mut blender, &wide, mask, view.corner)?;
    }
    let (mut result, mut covered) = (Mat::default(), Mat::default());
    Detail_MultiBandBlenderTrait::blend(&mut blender, &mut result, &mut covered)?;
    let mut picture = Mat::default();
    result.convert_to(&mut picture, CV_8U, 1.0, 0.0)?;
    let mut joined = Joined { picture, covered, shown: Mat::default() };
    if with_shown {
        joined.shown = Mat::zeros(canvas.height as i32, canvas.width as i32, CV_8UC1)?.to_mat()?;
        for (index, (view, mask)) in placed.iter().zip(&cut).enumerate() {
            let place = Rect::new(view.corner.x, view.corner.y, mask.cols(), mask.rows());
            let whole = Rect::new(0, 0, canvas.width as i32, canvas.height as i32);
            let inside = place & whole;
            if inside != place {
                continue;
            }
            let value =
                Mat::new_rows_cols_with_default(mask.rows(), mask.cols(), CV_8UC1, Scalar::all(index as f64 + 1.0))?;
            let mut part = Mat::roi_mut(&mut joined.shown, place)?;
            value.copy_to_masked(&mut part, mask)?;
        }
    }
    Ok(joined)
}

/// Result of one frame.
struct Joined {
    picture: Mat,
    covered: Mat,
    shown: Mat,
}

impl Node for CompositeOpencv {
    const INFO: NodeInfo = NodeInfo::compute(
        "composite_opencv",
        "stitch",
        "Joins two views with OpenCV's stitching classes: warp, gain, graph-cut seam, multi-band blend.",
    );
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = CompositeOpencvParams;

    fn open(_: &Open<'_>, params: &CompositeOpencvParams) -> Result<Self> {
        // Only its canvas is used, so that both composites draw on the same one.
        let params = CompositeParams {
            canvas_margin_px: params.canvas_margin as usize,
            canvas_grow_after_frames: 0,
            ..CompositeParams::default()
        };
        Ok(Self { canvas: Compositor::new(params), threads: Threads::hold()? })
    }

    fn process<'f>(
        &mut self,
        _: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &CompositeOpencvParams,
    ) -> Result<()> {
        if input.homography.state == abi::STATE_LOST {
            return Ok(());
        }
        self.threads.set(params.threads)?;
        let views = [input.left.view(), input.right.view()];
        let maps = [stitch::IDENTITY, input.homography.left_from_right];
        let canvas = self.canvas.canvas(&views, &maps, GeometryState::Fresh)?;
        let joined = compose(views, &Map(maps[1]), &canvas, params, out.shown.is_read()).map_err(failed)?;
        mats::write(&joined.picture, &mut out.panorama.alloc(canvas.width, canvas.height)?)?;
        if out.mask.is_read() {
            mats::write(&joined.covered, &mut out.mask.alloc(canvas.width, canvas.height)?)?;
        }
        if out.shown.is_read() {
            mats::write(&joined.shown, &mut out.shown.alloc(canvas.width, canvas.height)?)?;
        }
        let (width, height) = (views[0].width as i32, views[0].height as i32);
        out.canvas.set(Roi { x: canvas.left, y: canvas.top, width, height })
    }
}
