//! Weighted least squares on the GPU: the result of the processor to 0.01 px.
//!
//! A thread solves a whole row or column, as on the processor; rows and columns are solved side by side.

use panoscope_imaging::Rect;
use panoscope_imaging::stereo::WlsParams;
use panoscope_node::Result;
use panoscope_node::device::{DeviceImage, Gpu, Kernel, Steps, Store, bytes_of_words};

/// Size of what a shader reads about a call, bytes.
const SIZE_BYTES: usize = 32;

/// Solves the planes of a map. Keeps its memory on the GPU.
#[derive(Debug)]
pub struct GpuWlsSolver {
    gpu: Gpu,
    weigh: Kernel,
    /// Along columns, and along rows.
    lines: [Kernel; 2],
    /// Weights to the lower and to the right neighbour.
    weights: [Store; 2],
    planes: [Store; 2],
    factors: Store,
    rounds: Vec<Store>,
}

impl GpuWlsSolver {
    /// Prepares the GPU.
    ///
    /// # Errors
    /// It rejects a shader.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let sizes = include_str!("wls_sizes.wgsl");
        let weigh = gpu.kernel("wls weights", &[sizes, include_str!("wls_weights.wgsl")])?;
        let lines = |constant: &str| gpu.kernel("wls lines", &[constant, sizes, include_str!("wls_lines.wgsl")]);
        let lines = [lines("const IS_ROWS = false;\n")?, lines("const IS_ROWS = true;\n")?];
        let (weights, planes, factors, rounds) = Default::default();
        Ok(Self { gpu, weigh, lines, weights, planes, factors, rounds })
    }

    /// Room for two planes of `count` values.
    ///
    /// # Errors
    /// It does not fit into the device.
    pub fn planes(&mut self, count: usize) -> Result<[u64; 2]> {
        let [first, second] = self.planes.each_mut().map(|store| store.reserve(self.gpu, 4 * count));
        Ok([first?, second?])
    }

    /// Smooths disparity times confidence and confidence, the `planes`, in place: the values of `roi`, row after row. The
    /// guide has 1 (gray) or 3 (BGR) bytes per pixel. Does not wait.
    ///
    /// # Errors
    /// Errors of the GPU.
    pub fn solve(
        &mut self,
        (guide, pixel_bytes): (DeviceImage, usize),
        roi: Rect,
        params: &WlsParams,
        [product, support]: [u64; 2],
    ) -> Result<()> {
        let (gpu, count) = (self.gpu, roi.area());
        let [down, right] = self.weights.each_mut().map(|store| store.reserve(gpu, 4 * count));
        let (down, right) = (down?, right?);
        let factors = self.factors.reserve(gpu, 4 * count)?;
        let mut steps = Steps::default();
        self.rounds.resize_with(params.iterations, Store::default);
        let words: Vec<Vec<u8>> = (0..params.iterations)
            .map(|round| {
                let strength = params.lambda * 0.25_f32.powi(round as i32);
                let factor = -std::f32::consts::LOG2_E / params.sigma_color;
                let sizes = [roi.width, roi.height, roi.x, roi.y, guide.stride_bytes, pixel_bytes].map(|n| n as u32);
                bytes_of_words(&[&sizes[..], &[factor.to_bits(), strength.to_bits()]].concat())
            })
            .collect();
        for (round, (store, words)) in self.rounds.iter_mut().zip(&words).enumerate() {
            let sizes = store.reserve(gpu, SIZE_BYTES)?;
            steps.write(sizes, 0, words);
            if round == 0 {
                steps.run(&self.weigh, &[sizes, guide.buffer, right, down], [roi.width, roi.height]);
            }
            steps.run(&self.lines[1], &[sizes, right, product, support, factors], [roi.height, 1]);
            steps.run(&self.lines[0], &[sizes, down, product, support, factors], [roi.width, 1]);
        }
        gpu.submit(&steps)
    }
}
