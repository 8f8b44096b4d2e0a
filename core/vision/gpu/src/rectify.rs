//! Views shrunk and rectified on the device.

use std::sync::Arc;

use panoscope_imaging::stereo::RemapTable;
use panoscope_imaging::{Parallel, Rect, View, ViewMut};

use crate::device::{Gpu, GpuError};
use crate::kernel::Kernel;
use crate::memory::{Store, Transfer, Upload, row_bytes, unpack};

/// Bytes of a call's sizes as the shader reads them.
const SIZE_BYTES: u64 = 32;

/// A view and its rectified image.
#[derive(Debug)]
pub struct RectifyJob<'v, 'o> {
    /// The camera's image, BGR.
    pub view: View<'v, u8>,
    /// The rectified image.
    pub out: ViewMut<'o, u8>,
}

/// Device memory of one view.
#[derive(Debug, Default)]
struct Side {
    corners: Store,
    fractions: Store,
    view: Store,
    small: Store,
    shrinking: Store,
    turning: Store,
}

/// Rectifies the views of one calibration. Keeps maps and memory on the device.
#[derive(Debug)]
pub struct Rectifier {
    gpu: Arc<Gpu>,
    kernel: Kernel,
    factor: usize,
    /// Size of the images that the maps read, and of those that they make; `None` when views are only shrunk.
    sizes: Option<[(usize, usize); 2]>,
    sides: [Side; 2],
    target: Store,
    transfer: Transfer,
}

impl Rectifier {
    /// A rectifier that shrinks views by `factor` and rectifies them with `maps`, left and right; without maps it only
    /// shrinks.
    ///
    /// # Errors
    /// [`GpuError::Input`] for maps of different sizes or of a part of a view, and if there is nothing to do; errors of
    /// the device.
    pub fn new(gpu: Arc<Gpu>, factor: usize, maps: Option<[&RemapTable; 2]>) -> Result<Self, GpuError> {
        let refuse = |what: &str| Err(GpuError::Input { what: what.into() });
        if factor == 0 || (factor == 1 && maps.is_none()) {
            return refuse("views that are neither shrunk nor turned");
        }
        let parts = [include_str!("shaders/rectify.wgsl"), include_str!("shaders/bytes.wgsl")];
        let kernel = Kernel::new(&gpu, "rectify", &parts)?;
        let mut sides: [Side; 2] = Default::default();
        let mut sizes = None;
        if let Some(maps) = maps {
            let of = |map: &RemapTable| [map.source_size(), map.size()];
            if of(maps[0]) != of(maps[1]) || maps.iter().any(|map| map.roi() != Rect::whole(map.size().0, map.size().1))
            {
                return refuse("maps of different sizes, or of a part of a view");
            }
            sizes = Some(of(maps[0]));
            for (side, map) in sides.iter_mut().zip(maps) {
                let corners: Vec<u8> = map.corners().iter().flat_map(|corner| corner.to_le_bytes()).collect();
                let mut fractions: Vec<u8> = map.fractions().iter().flat_map(|f| f.to_le_bytes()).collect();
                fractions.resize(fractions.len().next_multiple_of(4), 0);
                gpu.queue.write_buffer(side.corners.reserve(&gpu, corners.len() as u64)?, 0, &corners);
                gpu.queue.write_buffer(side.fractions.reserve(&gpu, fractions.len() as u64)?, 0, &fractions);
            }
            gpu.check()?;
        } else {
            // Bindings that the shader does not read then.
            for side in &mut sides {
                side.corners.reserve(&gpu, 16)?;
                side.fractions.reserve(&gpu, 16)?;
            }
        }
        let (target, transfer) = (Store::default(), Transfer::default());
        Ok(Self { gpu, kernel, factor, sizes, sides, target, transfer })
    }

    /// Rectifies the left view, the right view, or both; `None` leaves a side out.
    ///
    /// # Errors
    /// [`GpuError::Input`] for an image whose size is not that of the maps; errors of the device.
    pub fn run(&mut self, jobs: [Option<RectifyJob<'_, '_>>; 2], pool: &dyn Parallel) -> Result<(), GpuError> {
        // Sizes of both calls of both sides stand in front of the views.
        let mut words = [0_u32; 4 * SIZE_BYTES as usize / 4];
        let mut view_bytes = [0; 2];
        let mut target_bytes = 0;
        for (side, job) in jobs.iter().enumerate().filter_map(|(side, job)| Some((side, job.as_ref()?))) {
            let made = self.made(job)?;
            let small = (job.view.width / self.factor, job.view.height / self.factor);
            let [small_row, row] = [small, made].map(|size| row_bytes(size.0) as u32);
            let upload = Upload::new(job.view, 0);
            let stride = upload.stride() as u32;
            let (start, factor) = (target_bytes / 4, self.factor as u32);
            let is_turned = self.sizes.is_some();
            let shrinking = [
                small.0 as u32,
                small.1 as u32,
                small_row / 4,
                stride,
                0,
                if is_turned { 0 } else { start },
                factor,
                0,
            ];
            let source_stride = if factor > 1 { small_row } else { stride };
            let turning = [made.0 as u32, made.1 as u32, row / 4, source_stride, 0, start, 1, 0];
            words[16 * side..][..8].copy_from_slice(&shrinking);
            words[16 * side + 8..][..8].copy_from_slice(&turning);
            view_bytes[side] = upload.bytes();
            target_bytes += row * made.1 as u32;
        }
        if target_bytes == 0 {
            return Ok(());
        }
        let head = 4 * SIZE_BYTES;
        let gpu = &*self.gpu;
        let up = self.transfer.begin(gpu, head + view_bytes.iter().sum::<u64>())?;
        let words: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        up.write(0, &words)?;
        let mut from = words.len();
        for (job, bytes) in jobs.iter().zip(view_bytes) {
            if let Some(job) = job {
                up.write_rows(from, &Upload::new(job.view, 0), pool)?;
            }
            from += bytes as usize;
        }
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let target = self.target.reserve(gpu, target_bytes.into())?;
        let mut from = head;
        for (index, (side, job)) in self.sides.iter_mut().zip(&jobs).enumerate() {
            let Some(job) = job else { continue };
            let small = (job.view.width / self.factor, job.view.height / self.factor);
            let at = 2 * index as u64 * SIZE_BYTES;
            let bytes = view_bytes[index];
            self.transfer.send(&mut encoder, from, side.view.reserve(gpu, bytes)?, bytes);
            self.transfer.send(&mut encoder, at, side.shrinking.reserve(gpu, SIZE_BYTES)?, SIZE_BYTES);
            self.transfer.send(&mut encoder, at + SIZE_BYTES, side.turning.reserve(gpu, SIZE_BYTES)?, SIZE_BYTES);
            from += bytes;
            let is_turned = self.sizes.is_some();
            let threads = |size: (usize, usize)| [size.0.div_ceil(4), size.1];
            if is_turned && self.factor > 1 {
                side.small.reserve(gpu, (row_bytes(small.0) * small.1) as u64 + 12)?;
            }
            let Side { corners, fractions, view, small: smaller, shrinking, turning } = side;
            let (Some(corners), Some(fractions), Some(view), Some(shrinking), Some(turning)) =
                (corners.buffer(), fractions.buffer(), view.buffer(), shrinking.buffer(), turning.buffer())
            else {
                return Err(gpu.failed("a buffer is missing"));
            };
            let shrunk = smaller.buffer().filter(|_| is_turned && self.factor > 1);
            if self.factor > 1 {
                let buffers = [shrinking, view, corners, fractions, shrunk.unwrap_or(target)];
                self.kernel.encode(gpu, &mut encoder, &buffers, threads(small));
            }
            if is_turned {
                let buffers = [turning, shrunk.unwrap_or(view), corners, fractions, target];
                self.kernel.encode(gpu, &mut encoder, &buffers, threads((job.out.width, job.out.height)));
            }
        }
        self.transfer.finish(
            gpu,
            encoder,
            target,
            target_bytes.into(),
            || {},
            |rows| {
                let mut rest = rows;
                for mut job in jobs.into_iter().flatten() {
                    let (part, behind) = rest.split_at(row_bytes(job.out.width) * job.out.height);
                    unpack(part, 0..job.out.width, &mut job.out, pool);
                    rest = behind;
                }
            },
        )
    }

    /// Size of the image that a job makes.
    fn made(&self, job: &RectifyJob<'_, '_>) -> Result<(usize, usize), GpuError> {
        let small = (job.view.width / self.factor, job.view.height / self.factor);
        let (wanted, made) = self.sizes.map_or((small, small), |[from, to]| (from, to));
        let is_color = (job.view.channels, job.out.channels) == (3, 3);
        if small != wanted || (job.out.width, job.out.height) != made || !is_color || small.0 < 2 || small.1 < 2 {
            let what = format!(
                "a view of {}x{} in {} channels, shrunk by {}, for a map of {}x{} to {}x{}",
                job.view.width,
                job.view.height,
                job.view.channels,
                self.factor,
                wanted.0,
                wanted.1,
                job.out.width,
                job.out.height
            );
            return Err(GpuError::Input { what });
        }
        Ok(made)
    }
}
