//! `turntable`: shows a point cloud as a surface that turns (thesis, fig. 3.9).

use std::f32::consts::TAU;

use panoscope_imaging::draw::{DrawnPoint, GradientLimit, Orbit, SurfacePainter, SurfacePoints};
use panoscope_node::abi::{Calibration, CloudPoint, Scalar};
use panoscope_node::device::Gpu;
use panoscope_node::{Bgr8, Cloud, Context, Node, NodeInfo, Open, Params, Ports, Result, Slot, Value};

use crate::gpu::surface::{CloudSampler, Sampled};

/// Input ports of `turntable`.
#[derive(Ports)]
pub struct In<'f> {
    /// Points of `reproject`, mm. Those that were filled in are drawn darker.
    pub cloud: Cloud<'f>,
    /// Calibration of the rectified views, for the baseline. Without it 5 mm is assumed, the baseline of a narrow scope.
    pub calibration: Option<Value<'f, Calibration>>,
    /// Above 0 while the calibration does not fit the views, as a matcher reports it. No length is shown then.
    pub drifted: Option<Value<'f, Scalar>>,
}

/// Output ports of `turntable`.
#[derive(Ports)]
pub struct Out<'f> {
    /// The surface seen from the side, with a ruler while lengths are known.
    pub image: Slot<'f, Bgr8>,
}

/// Parameters of `turntable`.
#[derive(Params)]
pub struct Settings {
    /// Width of the image.
    #[param(default = 640, range = 16..=4096, unit = "px")]
    pub width: usize,
    /// Height of the image.
    #[param(default = 480, range = 16..=4096, unit = "px")]
    pub height: usize,
    /// Mean angle of the turn about the vertical axis; 0 is the camera's own direction.
    #[param(default = 0.0, range = -180.0..=180.0, step = 5.0, unit = "deg")]
    pub yaw_deg: f32,
    /// Angle about the horizontal axis; positive angles look from above.
    #[param(default = 20.0, range = -89.0..=89.0, step = 5.0, unit = "deg")]
    pub pitch_deg: f32,
    /// Angle by which it turns to each side; 180 is a full turn.
    #[param(default = 40.0, range = 0.0..=180.0, step = 5.0, unit = "deg")]
    pub swing_deg: f32,
    /// Number of images for one turn to and fro.
    #[param(default = 240, range = 2..=100000, unit = "frames")]
    pub period: u64,
    /// Magnification; 1 fills the image when seen from the front.
    #[param(default = 0.9, range = 0.1..=20.0, step = 0.1, unit = "ratio")]
    pub zoom: f32,
    /// Spacing of the points that form the surface. 0 takes as many as the image can show: one for every third of its columns.
    #[param(default = 2, range = 0..=16, unit = "px")]
    pub step: usize,
    /// Maximum change of disparity per px of distance between neighbours of one surface; others are not connected.
    #[param(default = 1.5, range = 0.1..=100.0, step = 0.1, unit = "ratio")]
    pub max_gradient: f32,
    /// Strength of the shading of surfaces that face away.
    #[param(default = 0.6, range = 0.0..=1.0, step = 0.05, unit = "ratio")]
    pub shading: f32,
}

/// Draws turning surfaces.
#[derive(Default)]
pub struct Turntable {
    painter: SurfacePainter,
    sampler: Option<CloudSampler>,
    /// Whether the GPU failed: clouds are copied whole from then on.
    has_failed: bool,
}

struct Points<'f>(Cloud<'f>);

fn drawn(point: &CloudPoint) -> Option<DrawnPoint> {
    let mm = [point.x_mm, point.y_mm, point.z_mm];
    point.is_known().then_some(DrawnPoint { mm, color: point.bgr, is_filled: point.filled != 0 })
}

impl SurfacePoints for Points<'_> {
    fn size(&self) -> (usize, usize) {
        (self.0.width(), self.0.height())
    }

    fn at(&self, column: usize, row: usize) -> Option<DrawnPoint> {
        drawn(&self.0.points()[row * self.0.width() + column])
    }
}

impl SurfacePoints for Sampled<'_> {
    fn size(&self) -> (usize, usize) {
        (self.points.width, self.points.height)
    }

    fn at(&self, column: usize, row: usize) -> Option<DrawnPoint> {
        drawn(&self.points.row(row)[column])
    }

    fn near(&self, column: usize, row: usize, _: usize) -> Option<DrawnPoint> {
        drawn(&self.corners.row(row / self.step)[column / self.step])
    }
}

/// What is drawn of a cloud that is on the GPU.
fn sample<'a, 'f: 'a>(sampler: &'a mut Option<CloudSampler>, cloud: Cloud<'f>, step: usize) -> Result<Sampled<'a>> {
    let sampler = match sampler {
        Some(sampler) => sampler,
        none => none.insert(CloudSampler::new(Gpu::open()?)?),
    };
    sampler.sample(cloud, step)
}

/// Columns of the image per point of the surface, if the step is not given: smaller triangles show no more detail.
const COLUMNS_PER_POINT: usize = 3;

/// Step at which points of a cloud `columns` wide are drawn in an image `width` px wide.
fn shown_step(columns: usize, width: usize) -> usize {
    (columns * COLUMNS_PER_POINT / width.max(1)).max(1)
}

impl Node for Turntable {
    const INFO: NodeInfo =
        NodeInfo::compute("turntable", "overlay", "Shows a point cloud as a surface that turns, with a ruler in mm.");
    type In<'f> = In<'f>;
    type Out<'f> = Out<'f>;
    type Params = Settings;

    fn open(_: &Open<'_>, _: &Settings) -> Result<Self> {
        Ok(Self::default())
    }

    fn process<'f>(&mut self, cx: &Context<'f>, input: In<'f>, mut out: Out<'f>, params: &Settings) -> Result<()> {
        let place = (cx.tick().seq % params.period) as f32 / params.period as f32;
        let swing = params.swing_deg.to_radians();
        let turn = if params.swing_deg >= 180.0 { TAU * place } else { swing * (TAU * place).sin() };
        let baseline_mm =
            input.calibration.as_ref().map_or(GradientLimit::USUAL_BASELINE_MM, |rig| rig.baseline_mm as f32);
        let orbit = Orbit {
            yaw: params.yaw_deg.to_radians() + turn,
            pitch: params.pitch_deg.to_radians(),
            zoom: params.zoom,
            step: if params.step > 0 { params.step } else { shown_step(input.cloud.width(), params.width) },
            limit: GradientLimit { max_gradient: params.max_gradient, baseline_mm },
            shading: params.shading,
            has_ruler: !input.drifted.as_ref().is_some_and(|drifted| drifted.value > 0.0),
            ..Orbit::default()
        };
        let mut picture = out.image.alloc(params.width, params.height)?;
        let Self { painter, sampler, has_failed } = self;
        let sampled = if *has_failed || !input.cloud.is_from_device() {
            None
        } else {
            let sampled = sample(sampler, input.cloud, orbit.step).ok();
            *has_failed = sampled.is_none();
            sampled
        };
        let points = sampled.as_ref().map(|sampled| sampled as &dyn SurfacePoints);
        if painter.paint(points.unwrap_or(&Points(input.cloud)), &orbit, &mut picture).is_some() {
            // What is known and not shown.
            cx.metric("cut_pct", 100.0 * f64::from(self.painter.cut_share()));
        }
        Ok(())
    }
}
