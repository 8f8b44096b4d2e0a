//! Buffers of the ground truth.

use super::camera_buffers::CameraBuffers;
use super::canvas::Canvas;
use super::params::{CameraModel, PhantomError};

/// Buffers that the computation of ground truth reuses from frame to frame.
#[derive(Default)]
pub(super) struct TruthScratch {
    pub(super) camera_buffers: Vec<CameraBuffers>,
    pub(super) depth_mm: Vec<f32>,
    pub(super) pairs: Vec<[f64; 4]>,
    pub(super) wide: Option<(Canvas, CameraBuffers)>,
    pub(super) wide_depth_mm: Vec<f32>,
}

impl TruthScratch {
    pub(super) fn new(cameras: &[CameraModel]) -> Result<Self, PhantomError> {
        let ideal = |(i, model): (usize, &CameraModel)| {
            CameraBuffers::new(CameraModel { distortion: [0.0; 5], equidistant: None, ..*model }, i, 1)
        };
        let camera_buffers = cameras.iter().take(2).enumerate().map(ideal).collect::<Result<_, _>>()?;
        Ok(Self { camera_buffers, ..Self::default() })
    }
}
