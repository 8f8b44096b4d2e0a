//! `composite_opencv`: OpenCV's stitching classes in the order of its `stitching_detailed` sample.

use opencv::core::{CV_8U, CV_8UC1, CV_16S, CV_32F, Mat, Point, Rect, Scalar, Size, UMat, Vector, bitwise_and_def};
use opencv::imgproc::{self, INTER_LINEAR, INTER_LINEAR_EXACT, INTER_NEAREST};
use opencv::prelude::*;
use opencv::stitching::{Detail_GainCompensator, Detail_GraphCutSeamFinder, Detail_MultiBandBlender};
use panoscope_imaging::geometry::Homography as Map;
use panoscope_imaging::stitch::{self, Canvas, CompositeParams, Compositor, GeometryState};
use panoscope_node::abi::{self, Homography, Roi};
use panoscope_node::{
    Bgr8, Context, Gray8, Image, Mask, Node, NodeInfo, Open, Params, Ports, Result, Slot, Value, View,
};

use crate::mats::{self, Threads, failed, mat, umat};

/// Parameters of the composite.
#[derive(Params, Clone, PartialEq)]
pub struct CompositeOpencvParams {
    /// Size to which each view is shrunk for the seam, in million pixels; 0 finds it at full resolution. OpenCV's stitcher takes 0.1.
    #[param(default = 0.0, range = 0.0..=10.0, step = 0.05)]
    seam_megapixels: f64,
    /// Even out the exposure with one gain per view.
    #[param(default = true)]
    gain: bool,
    /// Width of the blend in percent of the panorama's side, as OpenCV's sample counts it.
    #[param(default = 5.0, range = 0.0..=100.0, step = 1.0, unit = "%")]
    blend_strength: f64,
    /// Room kept free around the first good registration, so that the canvas can hold still.
    #[param(default = 16, range = 0..=512, unit = "px")]
    canvas_margin: u32,
    /// OpenCV's threads while this node works.
    #[param(default = 1, range = 1..=64)]
    threads: u32,
}

/// Inputs of the composite.
#[derive(Ports)]
pub struct In<'f> {
    /// Left view; the panorama lies in its plane.
    left: Image<'f, Bgr8>,
    /// Right view of the same instant.
    right: Image<'f, Bgr8>,
    /// Maps right-view pixels to left-view pixels.
    homography: Value<'f, Homography>,
}

/// Outputs of the composite; empty while the registration is lost.
#[derive(Ports)]
pub struct Out<'f> {
    /// The wide picture; black where no view reaches.
    panorama: Slot<'f, Bgr8>,
    /// 255 where a view reaches.
    mask: Slot<'f, Mask>,
    /// Where the left view lies in the panorama.
    canvas: Slot<'f, Roi>,
    /// Which view each pixel shows: 0 none, 1 the left one, 2 the right one.
    shown: Slot<'f, Gray8>,
}

/// See the module.
pub struct CompositeOpencv {
    canvas: Compositor,
}

/// A view on the canvas.
struct Placed {
    corner: Point,
    image: Mat,
    mask: Mat,
}

fn upright(view: View<'_, u8>, canvas: &Canvas) -> opencv::Result<Placed> {
    let white = Scalar::all(255.0);
    let mask = Mat::new_rows_cols_with_default(view.height as i32, view.width as i32, CV_8UC1, white)?;
    Ok(Placed { corner: Point::new(canvas.left, canvas.top), image: mat(view)?, mask })
}

fn warped(view: View<'_, u8>, map: &Map, canvas: &Canvas) -> opencv::Result<Placed> {
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
    let (border, black) = (opencv::core::BORDER_CONSTANT, Scalar::default());
    let (mut image, mut mask) = (Mat::default(), Mat::default());
    // Reflected at the border, as OpenCV's warpers do: the blender would carry black edges inwards.
    let reflect = opencv::core::BORDER_REFLECT;
    imgproc::warp_perspective(&mat(view)?, &mut image, &matrix, size, INTER_LINEAR, reflect, black)?;
    let white = Mat::new_rows_cols_with_default(view.height as i32, view.width as i32, CV_8UC1, Scalar::all(255.0))?;
    imgproc::warp_perspective(&white, &mut mask, &matrix, size, INTER_NEAREST, border, black)?;
    Ok(Placed { corner: Point::new(x, y), image, mask })
}

/// The masks cut along the seam.
fn seam(placed: &[Placed; 2], scale: f64) -> opencv::Result<[Mat; 2]> {
    let (mut images, mut masks) = (Vector::<UMat>::new(), Vector::<UMat>::new());
    let mut corners = Vector::<Point>::new();
    for view in placed {
        let (mut image, mut mask) = (view.image.clone(), view.mask.clone());
        if scale < 1.0 {
            let none = Size::default();
            imgproc::resize(&view.image, &mut image, none, scale, scale, INTER_LINEAR_EXACT)?;
            imgproc::resize(&view.mask, &mut mask, none, scale, scale, INTER_NEAREST)?;
        }
        let mut float = Mat::default();
        image.convert_to(&mut float, CV_32F, 1.0, 0.0)?;
        images.push(umat(&float)?);
        masks.push(umat(&mask)?);
        let at = |v: i32| (f64::from(v) * scale).round() as i32;
        corners.push(Point::new(at(view.corner.x), at(view.corner.y)));
    }
    let mut finder = Detail_GraphCutSeamFinder::new_def()?;
    Detail_SeamFinderTrait::find(&mut finder, &images, &corners, &mut masks)?;
    let mut cut = [Mat::default(), Mat::default()];
    for (index, view) in placed.iter().enumerate() {
        let mask = mats::from_umat(&masks.get(index)?)?;
        if scale < 1.0 {
            let (mut wide, mut full) = (Mat::default(), Mat::default());
            imgproc::dilate_def(&mask, &mut wide, &Mat::default())?;
            imgproc::resize(&wide, &mut full, view.mask.size()?, 0.0, 0.0, INTER_LINEAR_EXACT)?;
            bitwise_and_def(&full, &view.mask, &mut cut[index])?;
        } else {
            cut[index] = mask;
        }
    }
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
    if params.gain {
        let mut compensator = Detail_GainCompensator::default()?;
        let (mut images, mut masks) = (Vector::<UMat>::new(), Vector::<UMat>::new());
        let corners: Vector<Point> = placed.iter().map(|view| view.corner).collect();
        for view in &placed {
            images.push(umat(&view.image)?);
            masks.push(umat(&view.mask)?);
        }
        Detail_ExposureCompensatorTrait::feed(&mut compensator, &corners, &images, &masks)?;
        for (index, view) in placed.iter_mut().enumerate() {
            let (image, mask) = (&mut view.image, &view.mask);
            Detail_ExposureCompensatorTrait::apply(&mut compensator, index as i32, view.corner, image, mask)?;
        }
    }
    let pixels = (views[0].width * views[0].height) as f64;
    let scale =
        if params.seam_megapixels > 0.0 { (params.seam_megapixels * 1e6 / pixels).sqrt().min(1.0) } else { 1.0 };
    let cut = seam(&placed, scale)?;

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

/// What a frame becomes.
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
        Ok(Self { canvas: Compositor::new(params) })
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
        let _threads = Threads::set(params.threads).map_err(failed)?;
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
