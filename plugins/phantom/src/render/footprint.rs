//! The area that all cameras together see, in the image plane of the first one with a larger sensor.

use panoscope_imaging::{Parallel, ViewMut};

use super::camera_buffers::{CameraBuffers, check_size};
use super::canvas::Canvas;
use super::math::Pose;
use super::params::PhantomError;
use super::phantom::Phantom;

impl Phantom {
    /// Marks with 255 each pixel of the wide view whose tissue is inside the image of at least one camera; others are 0.
    ///
    /// The marked area divided by that of one view is the field of view that a panorama of all cameras can have, in pixels of the first camera.
    /// Tissue that another fold hides from a camera counts as inside its image: the measure is the extent of the images, not their holes. Distortion
    /// is ignored. Allocates only when the canvas changes.
    ///
    /// # Errors
    /// A canvas of more than 8192 px a side, a plane of another size, a pose that is not finite.
    pub fn footprint(
        &mut self,
        frame: u64,
        pose: Option<Pose>,
        canvas: Canvas,
        pool: &dyn Parallel,
        plane: &mut ViewMut<u8>,
    ) -> Result<(), PhantomError> {
        canvas.check()?;
        check_size(0, plane, canvas.width, canvas.height, 1)?;
        let buffers = self.wide_eye(frame, pose, canvas, pool)?;
        let mut depth_mm = std::mem::take(&mut self.truth.wide_depth_mm);
        self.depth_of(&buffers, pool, &mut depth_mm);
        for (v, depth) in depth_mm.chunks_exact(canvas.width).enumerate() {
            let y = buffers.lens.y[v];
            for ((out, x), depth) in plane.row_mut(v).iter_mut().zip(&buffers.lens.x).zip(depth) {
                let point = [x * depth, y * depth, *depth].map(f64::from);
                *out = if self.camera_buffers.iter().any(|camera| is_inside(camera, point)) { 255 } else { 0 };
            }
        }
        self.truth.wide_depth_mm = depth_mm;
        self.truth.wide = Some((canvas, buffers));
        Ok(())
    }
}

/// Whether a point of the first camera's frame is inside the image of `camera`; `false` for NaN.
fn is_inside(camera: &CameraBuffers, point_mm: [f64; 3]) -> bool {
    let model = &camera.model;
    let [x, y, z]: [f64; 3] = std::array::from_fn(|i| point_mm[i] - model.offset_mm[i]);
    let (u, v) = (x / z * model.fx + model.cx, y / z * model.fy + model.cy);
    // The picture ends half a pixel beyond the last centre.
    z > 0.0 && u > -0.5 && v > -0.5 && u < model.width as f64 - 0.5 && v < model.height as f64 - 0.5
}
