//! Weighted least squares on the GPU: the result of the processor to 0.01 px.
//!
//! A thread solves a whole row or column, as on the processor; rows and columns are solved side by side.

use std::sync::Arc;

use panoscope_imaging::stereo::{SolveError, WlsParams, WlsSolver};
use panoscope_imaging::{Rect, View};
use panoscope_node::device::{Gpu, Kernel, MARGIN_BYTES, Steps, Store, bytes_of_words};
use panoscope_node::{Result, error};

/// Size of what a shader reads about a call, bytes.
const SIZE_BYTES: usize = 32;

#[derive(Debug)]
struct Kernels {
    weigh: Kernel,
    /// Along columns, and along rows.
    lines: [Kernel; 2],
}

/// Solves the planes of a map. Keeps its memory on the GPU.
#[derive(Debug)]
pub struct GpuWlsSolver {
    gpu: Gpu,
    kernels: Arc<Kernels>,
    guide: Store,
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
        Ok(Self::with(gpu, Arc::new(Kernels { weigh, lines })))
    }

    fn with(gpu: Gpu, kernels: Arc<Kernels>) -> Self {
        let (guide, weights, planes, factors, rounds) = Default::default();
        Self { gpu, kernels, guide, weights, planes, factors, rounds }
    }

    /// A solver with the same kernels and separate memory.
    pub fn another(&self) -> Self {
        Self::with(self.gpu, Arc::clone(&self.kernels))
    }

    fn run(
        &mut self,
        guide: View<'_, u8>,
        roi: Rect,
        params: &WlsParams,
        [first, second]: [&mut [f32]; 2],
    ) -> Result<()> {
        let count = roi.width * roi.height;
        if [first.len(), second.len()] != [count; 2] || ![1, 3].contains(&guide.channels) {
            return Err(error!("planes of {} and {} values for {count} pixels", first.len(), second.len()));
        }
        let gpu = self.gpu;
        let source = self.guide.reserve(gpu, guide.data.len() + MARGIN_BYTES)?;
        let [held, held_second] = self.planes(count)?;
        let mut steps = Steps::default();
        steps.write(source, 0, guide.data);
        steps.write_plain(held, 0, first);
        steps.write_plain(held_second, 0, second);
        gpu.submit(&steps)?;
        self.solve_there((source, guide.stride, guide.channels), roi, params, [held, held_second])?;
        gpu.read_plain(held, first)?;
        gpu.read_plain(held_second, second)
    }

    /// Room for two planes of `count` values.
    pub(super) fn planes(&mut self, count: usize) -> Result<[u64; 2]> {
        let [first, second] = self.planes.each_mut().map(|store| store.reserve(self.gpu, 4 * count));
        Ok([first?, second?])
    }

    /// Solves planes on the GPU in place. The guide has `stride` bytes per row and `channels` per pixel. Does not wait.
    pub(super) fn solve_there(
        &mut self,
        (source, stride, channels): (u64, usize, usize),
        roi: Rect,
        params: &WlsParams,
        [held, held_second]: [u64; 2],
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
                let sizes = [roi.width, roi.height, roi.x, roi.y, stride, channels].map(|n| n as u32);
                bytes_of_words(&[&sizes[..], &[factor.to_bits(), strength.to_bits()]].concat())
            })
            .collect();
        for (round, (store, words)) in self.rounds.iter_mut().zip(&words).enumerate() {
            let sizes = store.reserve(gpu, SIZE_BYTES)?;
            steps.write(sizes, 0, words);
            if round == 0 {
                steps.run(&self.kernels.weigh, &[sizes, source, right, down], [roi.width, roi.height]);
            }
            steps.run(&self.kernels.lines[1], &[sizes, right, held, held_second, factors], [roi.height, 1]);
            steps.run(&self.kernels.lines[0], &[sizes, down, held, held_second, factors], [roi.width, 1]);
        }
        gpu.submit(&steps)
    }
}

impl WlsSolver for GpuWlsSolver {
    fn solve(
        &mut self,
        guide: View<'_, u8>,
        roi: Rect,
        params: &WlsParams,
        planes: [&mut [f32]; 2],
    ) -> std::result::Result<(), SolveError> {
        self.run(guide, roi, params, planes).map_err(|error| error.to_string().into())
    }
}
