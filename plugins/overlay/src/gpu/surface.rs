//! What a drawn surface shows of a cloud on the GPU.

use panoscope_imaging::View;
use panoscope_imaging::draw::middle_steps;
use panoscope_node::abi::CloudPoint;
use panoscope_node::device::{Gpu, Kernel, Steps, Store, bytes_of_words};
use panoscope_node::pick::{Grid, Parts};
use panoscope_node::{Cloud, Result};

/// Size of what the shader reads about a call, bytes.
const CALL_BYTES: usize = 24;

/// Reads the points of clouds that a surface is drawn from.
#[derive(Debug)]
pub struct CloudSampler {
    gpu: Gpu,
    kernel: Kernel,
    call: Store,
    found: Store,
    corners: Vec<CloudPoint>,
    parts: Parts<CloudPoint>,
}

/// The points of a cloud that a surface is drawn from.
pub struct Sampled<'a> {
    /// Each `step`-th point, or a known one near it, as `SurfacePoints::near` finds it at a reach of half a step.
    pub corners: View<'a, CloudPoint>,
    /// Points between corners.
    pub step: usize,
    /// The cloud, with the points that give the surface's middle and width; others are unspecified.
    pub points: View<'a, CloudPoint>,
}

impl CloudSampler {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// The GPU rejects it.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let kernel = gpu.kernel("corners", &[include_str!("corners.wgsl")])?;
        let (call, found, corners, parts) = Default::default();
        Ok(Self { gpu, kernel, call, found, corners, parts })
    }

    /// Reads what is drawn of a cloud that is on the GPU, with a corner each `step` points.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn sample<'a, 'f: 'a>(&'a mut self, cloud: Cloud<'f>, step: usize) -> Result<Sampled<'a>> {
        let size = (cloud.width(), cloud.height());
        let (columns, rows) = (size.0.div_ceil(step), size.1.div_ceil(step));
        let words = bytes_of_words(&[size.0, size.1, columns, rows, step, step / 2].map(|n| n as u32));
        let call = self.call.reserve(self.gpu, CALL_BYTES)?;
        let found = self.found.reserve(self.gpu, columns * rows * size_of::<CloudPoint>())?;
        let mut steps = Steps::default();
        steps.write(call, 0, &words);
        steps.run(&self.kernel, &[call, cloud.on_device()?.buffer, found], [columns, rows]);
        self.gpu.submit(&steps)?;
        let nothing = CloudPoint { x_mm: f32::NAN, y_mm: f32::NAN, z_mm: f32::NAN, bgr: [0; 3], filled: 0 };
        self.corners.resize(columns * rows, nothing);
        self.gpu.read_plain(found, &mut self.corners)?;
        let [middle, width] = middle_steps(size).map(|steps| Grid::of_steps(size, steps));
        let edge = Grid { columns: vec![0], ..Grid::of_steps(size, [1, step]) };
        let points = self.parts.view(cloud, &[middle, width, edge]);
        Ok(Sampled { corners: View::new(&self.corners, columns, rows, 1), step, points })
    }
}
