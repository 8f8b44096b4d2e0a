//! Where the measured surface comes from: a cloud, or depths with the camera that saw them.

use panoscope_imaging::stereo::{Rectification, Sample, SurfacePoint};
use panoscope_node::{Cloud, View};

/// Where depths come from.
pub enum Surface<'f> {
    /// Points with their own rays.
    Cloud(Cloud<'f>),
    /// Depths and the camera that saw them.
    Depth(View<'f, f32>, &'f Rectification),
}

impl Surface<'_> {
    /// Columns and rows.
    pub fn size(&self) -> (usize, usize) {
        match self {
            Self::Cloud(cloud) => (cloud.width(), cloud.height()),
            Self::Depth(depth, _) => (depth.width, depth.height),
        }
    }

    /// The surface at column `u`, row `v`, from the pixels up to `radius` px away; `None` where too few were measured. `trust` is the confidence of each
    /// pixel, where known, of the surface's size. `work` is reused.
    pub fn at(
        &self,
        [u, v]: [f64; 2],
        radius: usize,
        trust: Option<View<'_, f32>>,
        work: &mut Vec<Sample>,
    ) -> Option<SurfacePoint> {
        let trust = |x: usize, y: usize| trust.as_ref().map_or(f32::NAN, |map| map.row(y)[x]);
        let (size, at) = (self.size(), [u, v]);
        match self {
            Self::Cloud(cloud) => {
                let (points, width) = (cloud.points(), cloud.width());
                let sample = |x: usize, y: usize| {
                    let point = points.get(y * width + x)?;
                    let z = f64::from(point.z_mm);
                    (z > 0.0 && point.is_measured())
                        .then(|| [f64::from(point.x_mm) / z, f64::from(point.y_mm) / z, 1.0 / z])
                };
                SurfacePoint::at(size, at, radius, work, sample, trust)
            }
            Self::Depth(depth, views) => {
                let sample = |x: usize, y: usize| {
                    let z = f64::from(depth.row(y)[x]);
                    let (u, v) = (x as f64 - views.left.cx, y as f64 - views.left.cy);
                    let focal = views.left.focal_px;
                    (z > 0.0 && z.is_finite()).then(|| [u / focal, v / focal, 1.0 / z])
                };
                SurfacePoint::at(size, at, radius, work, sample, trust)
            }
        }
    }
}
