//! The rig: two pinhole cameras with parallel axes.

/// Focal length of both cameras.
pub const FOCAL_PX: f64 = 800.0;
/// Distance between the cameras.
pub const BASELINE_MM: f64 = 5.0;

/// The point where the axes meet views of a size (columns, rows).
pub fn centre(size: (usize, usize)) -> (f64, f64) {
    ((size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0)
}

/// A surface point in the left camera's frame, mm, and what it depends on.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// x right, y down, z forward.
    pub xyz_mm: [f64; 3],
    /// Unit normal that points to the camera.
    pub normal: [f64; 3],
    /// Width of a pixel on the surface, without its slant.
    pub pixel_mm: f64,
}

impl Point {
    /// The point that the left view shows `(u, v)` beside its centre with disparity `d`; `slope` is the disparity's change per column and per row.
    pub fn new((u, v): (f64, f64), d: f64, slope: (f64, f64)) -> Self {
        let z = FOCAL_PX * BASELINE_MM / d;
        // d = c + gx u + gy v times z is the plane  f b = c Z + gx f X + gy f Y.
        let n = [slope.0 * FOCAL_PX, slope.1 * FOCAL_PX, d - slope.0 * u - slope.1 * v];
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(1e-9);
        Self {
            xyz_mm: [u / FOCAL_PX * z, v / FOCAL_PX * z, z],
            normal: n.map(|part| -part / length),
            pixel_mm: z / FOCAL_PX,
        }
    }
}
