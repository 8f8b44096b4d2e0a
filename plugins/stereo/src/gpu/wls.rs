//! Weighted least squares on the GPU: the result of the processor to 0.01 px.
//!
//! A thread solves a whole row or column, as on the processor; rows and columns are solved side by side.

use panoscope_imaging::stereo::{SolveError, WlsParams, WlsSolver};
use panoscope_imaging::{Rect, View};
use panoscope_node::device::{DeviceImage, Gpu, Kernel, MARGIN_BYTES, Steps, Store, bytes_of_words};
use panoscope_node::{Result, error};
use std::sync::{Arc, Mutex, PoisonError};

/// Size of what a shader reads about a call, bytes.
const SIZE_BYTES: usize = 32;

/// The guide of the next map, where it is on the GPU already.
pub type Guide = Arc<Mutex<Option<DeviceImage>>>;

/// Solves the planes of a map. Keeps its memory on the GPU.
#[derive(Debug)]
pub struct GpuWlsSolver {
    gpu: Gpu,
    weigh: Kernel,
    /// Along columns, and along rows.
    lines: [Kernel; 2],
    there: Guide,
    guide: Store,
    /// Weights to the lower and to the right neighbour.
    weights: [Store; 2],
    planes: [Store; 2],
    factors: Store,
    rounds: Vec<Store>,
}

impl GpuWlsSolver {
    /// Prepares the GPU. The caller may put the guide of the next map into `there` first.
    ///
    /// # Errors
    /// It rejects a shader.
    pub fn new(gpu: Gpu, there: Guide) -> Result<Self> {
        let sizes = include_str!("wls_sizes.wgsl");
        let weigh = gpu.kernel("wls weights", &[sizes, include_str!("wls_weights.wgsl")])?;
        let lines = |constant: &str| gpu.kernel("wls lines", &[constant, sizes, include_str!("wls_lines.wgsl")]);
        let lines = [lines("const IS_ROWS = false;\n")?, lines("const IS_ROWS = true;\n")?];
        let (guide, weights, planes, factors, rounds) = Default::default();
        Ok(Self { gpu, weigh, lines, there, guide, weights, planes, factors, rounds })
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
        let mut steps = Steps::default();
        let there = *self.there.lock().unwrap_or_else(PoisonError::into_inner);
        let size = (guide.width, guide.height);
        let (source, stride) = match there.filter(|there| (there.width, there.height) == size) {
            Some(there) => (there.buffer, there.stride_bytes),
            None => {
                let source = self.guide.reserve(gpu, guide.data.len() + MARGIN_BYTES)?;
                steps.write(source, 0, guide.data);
                (source, guide.stride)
            }
        };
        let [down, right] = self.weights.each_mut().map(|store| store.reserve(gpu, 4 * count));
        let [held, held_second] = self.planes.each_mut().map(|store| store.reserve(gpu, 4 * count));
        let (down, right, held, held_second) = (down?, right?, held?, held_second?);
        let factors = self.factors.reserve(gpu, 4 * count)?;
        steps.write_plain(held, 0, first);
        steps.write_plain(held_second, 0, second);

        self.rounds.resize_with(params.iterations, Store::default);
        let words: Vec<Vec<u8>> = (0..params.iterations)
            .map(|round| {
                let strength = params.lambda * 0.25_f32.powi(round as i32);
                let factor = -std::f32::consts::LOG2_E / params.sigma_color;
                let sizes = [roi.width, roi.height, roi.x, roi.y, stride, guide.channels].map(|n| n as u32);
                bytes_of_words(&[&sizes[..], &[factor.to_bits(), strength.to_bits()]].concat())
            })
            .collect();
        for (round, (store, words)) in self.rounds.iter_mut().zip(&words).enumerate() {
            let sizes = store.reserve(gpu, SIZE_BYTES)?;
            steps.write(sizes, 0, words);
            if round == 0 {
                steps.run(&self.weigh, &[sizes, source, right, down], [roi.width, roi.height]);
            }
            steps.run(&self.lines[1], &[sizes, right, held, held_second, factors], [roi.height, 1]);
            steps.run(&self.lines[0], &[sizes, down, held, held_second, factors], [roi.width, 1]);
        }
        gpu.submit(&steps)?;
        gpu.read_plain(held, first)?;
        gpu.read_plain(held_second, second)
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
