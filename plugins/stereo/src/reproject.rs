//! `reproject`: disparity to depth and coloured points in mm (thesis, fig. 3.9).

use panoscope_imaging::stereo::{self, Rectification, ReprojectInput, ReprojectParams, SmallHoles};
use panoscope_imaging::{Rect, SharedMut};
use panoscope_node::abi::{Calibration, CloudPoint};
use panoscope_node::device::{Device, OnDevice};
use panoscope_node::{
    AnyImage, Confidence, Context, Depth, Disparity, Image, Node, NodeInfo, Open, Parallel, Params, PointCloud, Ports,
    Result, Slot, Validation, Value, View, ViewMut, error,
};

use panoscope_data::calibration::packet as calibration;

use crate::colours::Colours;
use crate::gpu::reproject::GpuReprojector;

/// Inputs.
#[derive(Ports)]
pub struct In<'f> {
    /// Rectified left view, gray8 or bgr8, for the colours of the points.
    image: AnyImage<'f>,
    /// Disparity of the left view.
    disparity: Image<'f, Disparity>,
    /// Calibration of the rectified views.
    calibration: Value<'f, Calibration>,
    /// Confidence of the disparity; pixels below `min_confidence` are dropped.
    confidence: Option<Image<'f, Confidence>>,
}

/// Outputs.
#[derive(Ports)]
pub struct Out<'f> {
    /// One point per pixel in the left rectified camera's frame; NaN where unknown. Points of small holes are filled in and marked so.
    cloud: Slot<'f, PointCloud>,
    /// Depth along the left rectified camera's axis; NaN where unknown.
    depth: Slot<'f, Depth>,
}

/// Parameters.
#[derive(Params)]
pub struct ReprojectNodeParams {
    /// Smallest depth that is kept.
    #[param(default = 5.0, range = 0.1..=10000.0, step = 1.0, unit = "mm")]
    near_mm: f32,
    /// Largest depth that is kept.
    #[param(default = 500.0, range = 1.0..=100000.0, step = 1.0, unit = "mm")]
    far_mm: f32,
    /// Confidence below which a pixel is dropped, where a confidence map is connected.
    #[param(default = 0.05, range = 0.0..=1.0, step = 0.01, unit = "ratio")]
    min_confidence: f32,
    /// Largest step of disparity between neighbours of one surface.
    #[param(default = 1.0, range = 0.01..=64.0, step = 0.05, unit = "px")]
    surface_step_px: f32,
    /// Smallest number of the eight neighbours on the same surface: removes flying pixels; 0 keeps all.
    #[param(default = 5, range = 0..=8)]
    min_neighbours: usize,
    /// Largest hole of a surface that is filled in the cloud, as a share of all pixels; 0 fills none. `depth` has what was measured only.
    #[param(default = 0.0015, range = 0.0..=0.05, step = 0.0005, unit = "ratio")]
    max_hole: f32,
    /// What computes depth and points, with the same values to the last bits. A GPU pays when its maps and its cloud stay there; the processor, which
    /// looks for small holes of the cloud, reads which depths are unknown, and those around holes. Without a GPU it does it all, with a warning.
    #[param(default = "cpu")]
    device: Device,
}

impl ReprojectNodeParams {
    fn kernel(&self) -> ReprojectParams {
        ReprojectParams {
            near_mm: self.near_mm,
            far_mm: self.far_mm,
            min_confidence: self.min_confidence,
            surface_step_px: self.surface_step_px,
            min_neighbours: self.min_neighbours,
        }
    }
}

/// See the module.
pub struct Reproject {
    views: Option<(Calibration, Rectification)>,
    depth: Vec<f32>,
    holes: SmallHoles,
    on_device: OnDevice<GpuReprojector>,
}

impl Reproject {
    /// Makes what is read on the GPU, where it stays. Whether it did; a GPU that fails is given up.
    fn make_there(
        &mut self,
        cx: &Context<'_>,
        (input, colours): (&In<'_>, &Colours<'_>),
        out: &mut Out<'_>,
        params: &ReprojectNodeParams,
    ) -> Result<bool> {
        let Some((_, views)) = &self.views else { return Ok(false) };
        let (width, height) = (views.width, views.height);
        let share = |count: usize| count as f64 / (width * height) as f64;
        self.on_device.attempt(cx, |gpu| {
            let disparity = input.disparity.on_device()?;
            let confidence = input.confidence.as_ref().map(Image::on_device).transpose()?;
            let depth = out.depth.alloc_on_device(width, height)?;
            cx.metric("known_share", share(gpu.depth(disparity, confidence, views, &params.kernel(), depth)?));
            if !out.cloud.is_read() {
                return Ok(());
            }
            let optics = (views.left.focal_px as f32, views.baseline_mm as f32);
            let filled = if params.max_hole > 0.0 {
                let unknown = gpu.unknown(depth)?;
                let read = |places: &[usize], depths: &mut Vec<f32>| gpu.pick(depth, places, depths);
                self.holes.find_elsewhere((width, height), &unknown, optics, params.max_hole, read)?
            } else {
                &[]
            };
            cx.metric("filled_share", share(filled.len()));
            let cloud = out.cloud.alloc_cloud_on_device(width, height)?;
            gpu.cloud(depth, colours.on_device()?, filled, views, cloud)
        })
    }
}

/// Points and colours of one picture. `filled` has index and depth of what is filled in.
fn fill(
    mut cloud: ViewMut<'_, CloudPoint>,
    image: View<'_, u8>,
    depth: View<'_, f32>,
    filled: &[(usize, f32)],
    views: &Rectification,
    pool: &dyn Parallel,
) {
    let (cx, cy, per_px) = (views.left.cx as f32, views.left.cy as f32, (1.0 / views.left.focal_px) as f32);
    let (stride, width) = (cloud.stride, cloud.width);
    let position = |x: usize, y: usize, z: f32| ((x as f32 - cx) * per_px * z, (y as f32 - cy) * per_px * z);
    let out = SharedMut::new(&mut *cloud.data);
    pool.run(depth.height, &|y| {
        // SAFETY: one row, one chunk.
        let row = unsafe { out.part(y * stride, width) };
        let pixels = image.row(y).chunks_exact(image.channels);
        for (x, ((point, z), pixel)) in row.iter_mut().zip(depth.row(y)).zip(pixels).enumerate() {
            let bgr = if let [b, g, r] = *pixel { [b, g, r] } else { [pixel[0]; 3] };
            let (x_mm, y_mm) = position(x, y, *z);
            *point = CloudPoint { x_mm, y_mm, z_mm: *z, bgr, filled: 0 };
        }
    });
    for &(at, z_mm) in filled {
        let (x, y) = (at % width, at / width);
        let (x_mm, y_mm) = position(x, y, z_mm);
        let point = &mut cloud.row_mut(y)[x];
        *point = CloudPoint { x_mm, y_mm, z_mm, filled: 1, ..*point };
    }
}

impl Node for Reproject {
    const INFO: NodeInfo =
        NodeInfo::compute("reproject", "stereo", "Turns disparities into depth and coloured points in mm.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = ReprojectNodeParams;

    fn validate(params: &ReprojectNodeParams, check: &mut Validation<'_>) {
        if params.near_mm >= params.far_mm {
            let message = format!(
                "`near_mm` is {} and `far_mm` is {}: no depth lies between them",
                params.near_mm, params.far_mm
            );
            check.error("near_mm", message, "give `near_mm` less than `far_mm`");
        }
    }

    fn open(open: &Open<'_>, params: &ReprojectNodeParams) -> Result<Self> {
        let (views, depth, holes) = Default::default();
        let mut on_device = OnDevice::default();
        on_device.choose(params.device, open, GpuReprojector::new);
        Ok(Self { views, depth, holes, on_device })
    }

    fn process<'f>(
        &mut self,
        cx: &Context<'f>,
        input: In<'f>,
        mut out: Out<'f>,
        params: &ReprojectNodeParams,
    ) -> Result<()> {
        if self.views.as_ref().is_none_or(|(seen, _)| !calibration::same(seen, &input.calibration)) {
            self.views = None;
            self.views = Some((*input.calibration, calibration::of_rectified_views(&input.calibration)?));
        }
        self.on_device.choose(params.device, cx, GpuReprojector::new);
        let Some((_, views)) = &self.views else { return Ok(()) };
        let (width, height) = (input.disparity.width(), input.disparity.height());
        if (width, height) != (views.width, views.height) {
            return Err(error!(
                "the disparity map is {width}x{height}, the calibration was made for {}x{}",
                views.width, views.height
            ));
        }
        if (input.image.width(), input.image.height()) != (width, height) {
            let (w, h) = (input.image.width(), input.image.height());
            return Err(error!("`disparity` is {width}x{height}, `image` is {w}x{h}"));
        }
        if let Some(map) = &input.confidence
            && (map.width(), map.height()) != (width, height)
        {
            return Err(error!("`disparity` is {width}x{height}, `confidence` is {}x{}", map.width(), map.height()));
        }
        let colours = Colours::of(&input.image)?;
        if self.make_there(cx, (&input, &colours), &mut out, params)? {
            return Ok(());
        }
        let Some((_, views)) = &self.views else { return Ok(()) };
        let given = ReprojectInput {
            disparity: input.disparity.view(),
            confidence: input.confidence.as_ref().map(Image::view),
            roi: Rect::whole(width, height),
        };
        let (depth_is_read, cloud_is_read) = (out.depth.is_read(), out.cloud.is_read());
        let depth = if depth_is_read {
            out.depth.alloc(width, height)?
        } else {
            self.depth.resize(width * height, f32::NAN);
            ViewMut::new(&mut self.depth, width, height, 1)
        };
        let map = ViewMut { data: &mut *depth.data, ..depth };
        let known = stereo::reproject(given, views, &params.kernel(), cx.pool(), map, None)?;
        cx.metric("known_share", known as f64 / (width * height) as f64);
        if cloud_is_read {
            let (focal_px, baseline_mm) = (views.left.focal_px as f32, views.baseline_mm as f32);
            let filled = self.holes.find(depth.as_view(), focal_px, baseline_mm, params.max_hole);
            cx.metric("filled_share", filled.len() as f64 / (width * height) as f64);
            fill(out.cloud.alloc_cloud(width, height)?, colours.view(), depth.as_view(), filled, views, cx.pool());
        }
        Ok(())
    }
}
