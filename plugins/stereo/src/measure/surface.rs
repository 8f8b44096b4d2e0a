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

    /// The surface at column `u`, row `v`, from the pixels up to `radius` px away; `None` where too few were measured. `work` is reused.
    pub fn at(&self, u: f64, v: f64, radius: usize, work: &mut Vec<Sample>) -> Option<SurfacePoint> {
        match self {
            Self::Cloud(cloud) => {
                let (points, width) = (cloud.points(), cloud.width());
                SurfacePoint::at(self.size(), [u, v], radius, work, |x, y| {
                    let point = points.get(y * width + x)?;
                    let z = f64::from(point.z_mm);
                    (z > 0.0 && point.is_measured())
                        .then(|| [f64::from(point.x_mm) / z, f64::from(point.y_mm) / z, 1.0 / z])
                })
            }
            Self::Depth(depth, views) => SurfacePoint::at(self.size(), [u, v], radius, work, |x, y| {
                let z = f64::from(depth.row(y)[x]);
                let (u, v) = (x as f64 - views.left.cx, y as f64 - views.left.cy);
                let focal = views.left.focal_px;
                (z > 0.0 && z.is_finite()).then(|| [u / focal, v / focal, 1.0 / z])
            }),
        }
    }
}
