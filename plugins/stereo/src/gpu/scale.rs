//! Shrinks images and enlarges maps on the GPU, as the processor does for matches and filters on shrunk views.

use panoscope_node::Result;
use panoscope_node::device::{DeviceImage, Gpu, Kernel, MARGIN_BYTES, Steps, Store, bytes_of_words};

/// Size of what a shader reads about a call, bytes.
const SIZE_BYTES: usize = 48;

/// What is done with an image.
#[derive(Clone, Copy, Debug)]
pub enum Scaling {
    /// Means of whole blocks in gray, of an image of 1 (gray) or 3 (BGR) bytes per pixel: the bytes of `shrink_gray`.
    Shrink {
        /// Bytes per pixel.
        pixel_bytes: usize,
    },
    /// The middle of each whole block of a map, times a factor.
    Sample {
        /// The factor.
        times: f32,
    },
    /// Each value of a map over its block, times a factor; NaN where there is no whole block.
    Repeat {
        /// The factor.
        times: f32,
    },
    /// A map enlarged linearly, its values times a factor. What no block covers continues the last one.
    Enlarge {
        /// The factor.
        times: f32,
        /// Neighbours with a larger difference are two surfaces, with nothing between them.
        max_step: f32,
    },
}

/// An image and what is made of it: one of both is the other one shrunk.
pub type ScaleJob = (Scaling, DeviceImage, DeviceImage);

/// Shrinks and enlarges images. Keeps its memory.
#[derive(Debug)]
pub struct Scaler {
    gpu: Gpu,
    shrink: Kernel,
    sample: Kernel,
    enlarge: Kernel,
    sizes: Store,
}

impl Scaler {
    /// Prepares the GPU.
    ///
    /// # Errors
    /// It rejects a shader.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let head = include_str!("scale_sizes.wgsl");
        Ok(Self {
            gpu,
            shrink: gpu.kernel("scale shrink", &[head, include_str!("scale_shrink.wgsl")])?,
            sample: gpu.kernel("scale sample", &[head, include_str!("scale_sample.wgsl")])?,
            enlarge: gpu.kernel("scale enlarge", &[head, include_str!("scale_enlarge.wgsl")])?,
            sizes: Store::default(),
        })
    }

    /// Makes images by a whole `factor` smaller or larger. Does not wait for them.
    ///
    /// # Errors
    /// Errors of the GPU.
    pub fn run(&mut self, factor: usize, jobs: &[ScaleJob]) -> Result<()> {
        let sizes = self.sizes.reserve(self.gpu, SIZE_BYTES)?;
        let words: Vec<Vec<u8>> = jobs.iter().map(|job| words(factor, job)).collect();
        let mut steps = Steps::default();
        for ((scaling, from, to), words) in jobs.iter().zip(&words) {
            steps.write(sizes, 0, words);
            let (kernel, columns) = match scaling {
                // A thread makes a word.
                Scaling::Shrink { .. } => (&self.shrink, to.width.div_ceil(4)),
                Scaling::Sample { .. } => (&self.sample, to.width),
                Scaling::Repeat { .. } | Scaling::Enlarge { .. } => (&self.enlarge, to.width),
            };
            steps.run(kernel, &[sizes, from.buffer, to.buffer], [columns, to.height]);
        }
        self.gpu.submit(&steps)
    }
}

/// What a shader reads about a job.
fn words(factor: usize, (scaling, from, to): &ScaleJob) -> Vec<u8> {
    let (pixel_bytes, times, max_step, continues) = match *scaling {
        Scaling::Shrink { pixel_bytes } => (pixel_bytes, 1.0, 0.0, 0),
        Scaling::Sample { times } => (4, times, 0.0, 0),
        // No difference is that small: the nearest value is taken.
        Scaling::Repeat { times } => (4, times, -1.0, 0),
        Scaling::Enlarge { times, max_step } => (4, times, max_step, 1),
    };
    let sizes = [to.width, to.height, to.stride_bytes, from.width, from.height, from.stride_bytes, factor, pixel_bytes];
    let sizes = sizes.map(|n| n as u32);
    bytes_of_words(&[&sizes[..], &[times.to_bits(), max_step.to_bits(), continues, 0]].concat())
}

/// Room for an image of `pixel_bytes` bytes per pixel; its content is undefined.
///
/// # Errors
/// It does not fit into the device.
pub fn image_in(
    gpu: Gpu,
    store: &mut Store,
    (width, height): (usize, usize),
    pixel_bytes: usize,
) -> Result<DeviceImage> {
    let stride_bytes = DeviceImage::stride_bytes(width, pixel_bytes);
    Ok(DeviceImage { buffer: store.reserve(gpu, stride_bytes * height + MARGIN_BYTES)?, width, height, stride_bytes })
}
