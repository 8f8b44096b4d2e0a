//! Where the measured surface comes from: a cloud, or depths with the camera that saw them.

use panoscope_imaging::stereo::{Rectification, Sample, SurfacePoint};
use panoscope_node::View;
use panoscope_node::abi::CloudPoint;
use panoscope_node::pick::Grid;

/// Where depths come from.
pub enum Surface<'f> {
    /// Points with their own rays.
    Cloud(View<'f, CloudPoint>),
    /// Depths and the camera that saw them.
    Depth(View<'f, f32>, &'f Rectification),
}

/// The pixels of a surface of `size` that [`Surface::at`] reads for a point.
pub fn pixels(size: (usize, usize), at: [f64; 2], radius: usize) -> Vec<Grid> {
    let Some((area, further)) = SurfacePoint::pixels(size, at, radius) else { return Vec::new() };
    let [columns, rows] = further.map(|places| places.into_iter().map(|place| place as u32).collect());
    vec![Grid::of_area(area), Grid { columns, rows }]
}

impl Surface<'_> {
    /// The surface at column `u`, row `v`, from the pixels up to `radius` px away; `None` where too few were measured. `trust` is the confidence of each
    /// pixel, where known, of the surface's size. `work` is reused.
    pub fn at(
        &self,
        at: [f64; 2],
        radius: usize,
        trust: Option<View<'_, f32>>,
        work: &mut Vec<Sample>,
    ) -> Option<SurfacePoint> {
        let trust = |x: usize, y: usize| trust.as_ref().map_or(f32::NAN, |map| map.row(y)[x]);
        match self {
            Self::Cloud(points) => {
                let sample = |x: usize, y: usize| {
                    let point = points.row(y)[x];
                    let z = f64::from(point.z_mm);
                    (z > 0.0 && point.is_measured())
                        .then(|| [f64::from(point.x_mm) / z, f64::from(point.y_mm) / z, 1.0 / z])
                };
                SurfacePoint::at((points.width, points.height), at, radius, work, sample, trust)
            }
            Self::Depth(depth, views) => {
                let sample = |x: usize, y: usize| {
                    let z = f64::from(depth.row(y)[x]);
                    let (u, v) = (x as f64 - views.left.cx, y as f64 - views.left.cy);
                    let focal = views.left.focal_px;
                    (z > 0.0 && z.is_finite()).then(|| [u / focal, v / focal, 1.0 / z])
                };
                SurfacePoint::at((depth.width, depth.height), at, radius, work, sample, trust)
            }
        }
    }
}
