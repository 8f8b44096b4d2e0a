//! Images brought to the size of their places on the GPU: the pixels of `Fit::place`.

use panoscope_imaging::View;
use panoscope_node::device::{DeviceImage, Gpu, Kernel, PIXELS, Steps, Store, bytes_of_words};
use panoscope_node::{Bgr8, Image, Result};

/// Size of what the shader reads about a job, bytes.
const SIZES_BYTES: usize = 32;

/// An image and the place of its pixels; both BGR.
#[derive(Clone, Copy, Debug)]
pub struct FitJob {
    /// The image.
    pub from: DeviceImage,
    /// The place, not larger than the image, in rows of [`DeviceImage::stride_bytes`].
    pub to: DeviceImage,
    /// Byte of its buffer at which the place begins, a multiple of 4.
    pub start: usize,
    /// Byte of its buffer at which the image begins.
    pub from_start: usize,
}

/// Brings images to smaller sizes, or copies them.
///
/// The bytes are those of `Fit::place`, but for one level where more than 257 pixels lie under one.
#[derive(Debug)]
pub struct DeviceFit {
    pub(super) gpu: Gpu,
    kernel: Kernel,
    sizes: Store,
}

impl DeviceFit {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// The GPU rejects it.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let kernel = gpu.kernel("fit", &[include_str!("fit.wgsl"), PIXELS])?;
        Ok(Self { gpu, kernel, sizes: Store::default() })
    }

    /// Runs the steps `before`, then the jobs. Does not wait for the GPU.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn run(&mut self, before: Steps<'_>, jobs: &[FitJob]) -> Result<()> {
        let sizes = self.sizes.reserve(self.gpu, SIZES_BYTES)?;
        let words = jobs.iter().map(|FitJob { from, to, start, from_start }| {
            let row = [from.stride_bytes, to.stride_bytes / 4, start / 4, *from_start];
            let all = [to.width, to.height, from.width, from.height].into_iter().chain(row);
            bytes_of_words(&all.map(|n| n as u32).collect::<Vec<_>>())
        });
        let words: Vec<_> = words.collect();
        let mut steps = before;
        for (job, words) in jobs.iter().zip(&words) {
            // Steps run in their order: each job reads its own sizes.
            steps.write(sizes, 0, words);
            let threads = [job.to.width.div_ceil(4), job.to.height];
            steps.run(&self.kernel, &[sizes, job.from.buffer, job.to.buffer], threads);
        }
        self.gpu.submit(&steps)
    }
}

/// Images of one tick in the size of their places: made on the GPU together, and read together.
#[derive(Debug)]
pub struct SmallImages {
    fit: DeviceFit,
    target: Store,
    /// The caller's numbers of the images.
    numbers: Vec<usize>,
    jobs: Vec<FitJob>,
    pixels: Vec<u8>,
}

impl SmallImages {
    /// See [`DeviceFit::new`].
    ///
    /// # Errors
    /// The GPU rejects the kernel.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let (target, numbers, jobs, pixels) = Default::default();
        Ok(Self { fit: DeviceFit::new(gpu)?, target, numbers, jobs, pixels })
    }

    /// Makes images anew: numbers to find them by, images, and their wanted columns and rows.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn make<'f>(&mut self, images: impl Iterator<Item = (usize, Image<'f, Bgr8>, (usize, usize))>) -> Result<()> {
        self.numbers.clear();
        self.jobs.clear();
        let mut bytes = 0;
        for (number, image, (width, height)) in images {
            let stride_bytes = DeviceImage::stride_bytes(width, 3);
            let to = DeviceImage { buffer: 0, width, height, stride_bytes };
            self.numbers.push(number);
            self.jobs.push(FitJob { from: image.on_device()?, to, start: bytes, from_start: 0 });
            bytes += stride_bytes * height;
        }
        if bytes == 0 {
            return Ok(());
        }
        let target = self.target.reserve(self.fit.gpu, bytes)?;
        self.jobs.iter_mut().for_each(|job| job.to.buffer = target);
        self.fit.run(Steps::default(), &self.jobs)?;
        self.pixels.resize(bytes, 0);
        self.fit.gpu.read(target, &mut self.pixels)
    }

    /// The image of this number; `None` if the last call of [`Self::make`] got none.
    pub fn get(&self, number: usize) -> Option<View<'_, u8>> {
        let FitJob { to, start, .. } = &self.jobs[self.numbers.iter().position(|own| *own == number)?];
        Some(View::with_stride(&self.pixels[*start..], to.width, to.height, 3, to.stride_bytes))
    }
}
