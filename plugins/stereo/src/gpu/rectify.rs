//! Views shrunk and rectified on the GPU: the same bytes as on the processor.

use panoscope_imaging::Rect;
use panoscope_imaging::stereo::RemapTable;
use panoscope_node::device::{DeviceImage, Gpu, Kernel, MARGIN_BYTES, PIXELS, Steps, Store, bytes_of_words};
use panoscope_node::{Result, error};

/// Size of what a shader reads about a call, bytes.
const SIZE_BYTES: usize = 32;

/// A view and its rectified image, BGR.
#[derive(Clone, Copy, Debug)]
pub struct RectifyJob {
    /// The camera's image.
    pub view: DeviceImage,
    /// The rectified image, with rows of [`DeviceImage::stride_bytes`].
    pub out: DeviceImage,
}

/// Memory of one view on the GPU.
#[derive(Debug, Default)]
struct Side {
    corners: Store,
    fractions: Store,
    small: Store,
    shrinking: Store,
    turning: Store,
}

/// Rectifies the views of one calibration. Keeps maps and memory on the GPU.
#[derive(Debug)]
pub struct Rectifier {
    gpu: Gpu,
    kernel: Kernel,
    factor: usize,
    /// Size of the images that the maps read, and of those that they make; `None` when views are only shrunk.
    sizes: Option<[(usize, usize); 2]>,
    sides: [Side; 2],
}

impl Rectifier {
    /// A rectifier that shrinks views by `factor` and rectifies them with `maps`, left and right; without maps it only
    /// shrinks.
    ///
    /// # Errors
    /// Maps of different sizes or of a part of a view; nothing to do; errors of the GPU.
    pub fn new(gpu: Gpu, factor: usize, maps: Option<[&RemapTable; 2]>) -> Result<Self> {
        if factor == 0 || (factor == 1 && maps.is_none()) {
            return Err(error!("views that are neither shrunk nor turned"));
        }
        let kernel = gpu.kernel("rectify", &[include_str!("rectify.wgsl"), PIXELS])?;
        let mut sides: [Side; 2] = Default::default();
        let Some(maps) = maps else { return Ok(Self { gpu, kernel, factor, sizes: None, sides }) };
        let of = |map: &RemapTable| [map.source_size(), map.size()];
        let is_part = |map: &&RemapTable| map.roi() != Rect::whole(map.size().0, map.size().1);
        if of(maps[0]) != of(maps[1]) || maps.iter().any(is_part) {
            return Err(error!("maps of different sizes, or of a part of a view"));
        }
        for (side, map) in sides.iter_mut().zip(maps) {
            let corners: Vec<u8> = map.corners().iter().flat_map(|corner| corner.to_le_bytes()).collect();
            let fractions: Vec<u8> = map.fractions().iter().flat_map(|f| f.to_le_bytes()).collect();
            let mut steps = Steps::default();
            steps.write(side.corners.reserve(gpu, corners.len())?, 0, &corners);
            steps.write(side.fractions.reserve(gpu, fractions.len())?, 0, &fractions);
            gpu.submit(&steps)?;
        }
        Ok(Self { gpu, kernel, factor, sizes: Some(of(maps[0])), sides })
    }

    /// Rectifies the left view, the right view, or both; `None` leaves a side out. Does not wait for the GPU.
    ///
    /// # Errors
    /// An image whose size is not that of the maps; errors of the GPU.
    pub fn run(&mut self, jobs: [Option<RectifyJob>; 2]) -> Result<()> {
        let (gpu, factor, is_turned) = (self.gpu, self.factor, self.sizes.is_some());
        for job in jobs.iter().flatten() {
            self.check(job)?;
        }
        let words: Vec<[Vec<u8>; 2]> = jobs
            .iter()
            .flatten()
            .map(|RectifyJob { view, out }| {
                let small = self.small(view);
                let word = |n: usize| n as u32;
                let (row, small_row) = (out.stride_bytes / 4, DeviceImage::stride_bytes(small.0, 3));
                let shrunk_row = if is_turned { small_row / 4 } else { row };
                let shrinking = [small.0, small.1, shrunk_row, view.stride_bytes, 0, 0, factor, 0].map(word);
                let source_stride = if factor > 1 { small_row } else { view.stride_bytes };
                let turning = [out.width, out.height, row, source_stride, 0, 0, 1, 0].map(word);
                [bytes_of_words(&shrinking), bytes_of_words(&turning)]
            })
            .collect();
        let mut steps = Steps::default();
        let sides = self.sides.iter_mut().zip(jobs).filter_map(|(side, job)| Some((side, job?)));
        for ((side, RectifyJob { view, out }), [shrinking_words, turning_words]) in sides.zip(&words) {
            let small = (view.width / factor, view.height / factor);
            let threads = |size: (usize, usize)| [size.0.div_ceil(4), size.1];
            let (corners, fractions) = (side.corners.reserve(gpu, 16)?, side.fractions.reserve(gpu, 16)?);
            let mut source = view.buffer;
            if factor > 1 {
                let small_bytes = DeviceImage::stride_bytes(small.0, 3) * small.1 + MARGIN_BYTES;
                let target = if is_turned { side.small.reserve(gpu, small_bytes)? } else { out.buffer };
                let shrinking = side.shrinking.reserve(gpu, SIZE_BYTES)?;
                steps.write(shrinking, 0, shrinking_words);
                steps.run(&self.kernel, &[shrinking, source, corners, fractions, target], threads(small));
                source = target;
            }
            if is_turned {
                let turning = side.turning.reserve(gpu, SIZE_BYTES)?;
                steps.write(turning, 0, turning_words);
                let buffers = [turning, source, corners, fractions, out.buffer];
                steps.run(&self.kernel, &buffers, threads((out.width, out.height)));
            }
        }
        gpu.submit(&steps)
    }

    fn small(&self, view: &DeviceImage) -> (usize, usize) {
        (view.width / self.factor, view.height / self.factor)
    }

    /// Checks the sizes of a job's images.
    fn check(&self, RectifyJob { view, out }: &RectifyJob) -> Result<()> {
        let small = self.small(view);
        let [wanted, made] = self.sizes.unwrap_or([small, small]);
        if small == wanted && (out.width, out.height) == made && small.0 >= 2 && small.1 >= 2 {
            return Ok(());
        }
        Err(error!(
            "a view of {}x{}, shrunk by {}, for a map of {}x{} to {}x{}",
            view.width, view.height, self.factor, wanted.0, wanted.1, out.width, out.height
        ))
    }
}
