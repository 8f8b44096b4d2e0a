//! Depth and coloured points on the GPU: those of the processor to the last bits.

use panoscope_imaging::stereo::{Rectification, ReprojectParams};
use panoscope_node::Result;
use panoscope_node::device::{DeviceImage, Gpu, Kernel, Steps, Store, bytes_of_words};
use panoscope_node::pick::{Grid, Picker};

/// Points of a row of threads of the shader that fills.
const FILL_ROW: usize = 4096;
/// Depths that are picked at once.
const PICKED_AT_ONCE: usize = 1 << 20;

/// Reprojects maps. Keeps its memory on the GPU.
#[derive(Debug)]
pub struct GpuReprojector {
    gpu: Gpu,
    depth: Kernel,
    cloud: Kernel,
    fill: Kernel,
    unknown: Kernel,
    picker: Picker,
    calls: [Store; 3],
    total: Store,
    filled: Store,
    bits: Store,
}

impl GpuReprojector {
    /// Prepares the GPU.
    ///
    /// # Errors
    /// It rejects a shader.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let point = include_str!("reproject_point.wgsl");
        let depth = gpu.kernel("depth", &[include_str!("reproject_depth.wgsl")])?;
        let cloud = gpu.kernel("cloud", &[point, include_str!("reproject_cloud.wgsl")])?;
        let fill = gpu.kernel("cloud fill", &[point, include_str!("reproject_fill.wgsl")])?;
        let unknown = gpu.kernel("unknown depths", &[include_str!("reproject_unknown.wgsl")])?;
        let picker = Picker::new(gpu)?;
        let (calls, total, filled, bits) = Default::default();
        Ok(Self { gpu, depth, cloud, fill, unknown, picker, calls, total, filled, bits })
    }

    /// Writes the depths of a disparity map, mm, NaN where unknown, see [`panoscope_imaging::stereo::reproject()`]. All
    /// images have one size. Returns how many are known.
    ///
    /// # Errors
    /// Errors of the GPU.
    pub fn depth(
        &mut self,
        disparity: DeviceImage,
        confidence: Option<DeviceImage>,
        views: &Rectification,
        params: &ReprojectParams,
        depth: DeviceImage,
    ) -> Result<usize> {
        let gpu = self.gpu;
        let words = |image: DeviceImage| image.stride_bytes / 4;
        let strides = [words(disparity), confidence.map_or(0, words), words(depth)];
        let sizes = [disparity.width, disparity.height, strides[0], strides[1], strides[2], params.min_neighbours];
        let (scale, shift) =
            ((views.left.focal_px * views.baseline_mm) as f32, (views.right.cx - views.left.cx) as f32);
        let limits = [scale, shift, params.near_mm, params.far_mm, params.min_confidence, params.surface_step_px];
        let call_words = bytes_of_words(&[sizes.map(|n| n as u32), limits.map(f32::to_bits)].concat());
        let call = self.calls[0].reserve(gpu, call_words.len())?;
        let total = self.total.reserve(gpu, 4)?;
        let mut steps = Steps::default();
        steps.write(call, 0, &call_words);
        steps.write(total, 0, &[0; 4]);
        let confidence = confidence.unwrap_or(disparity).buffer;
        let buffers = [call, disparity.buffer, confidence, depth.buffer, total];
        steps.run(&self.depth, &buffers, [depth.width, depth.height]);
        gpu.submit(&steps)?;
        let mut known = [0_u32];
        gpu.read_plain(total, &mut known)?;
        Ok(known[0] as usize)
    }

    /// Which depths are unknown: a bit for each, from the lowest one on, in whole words for each row.
    ///
    /// # Errors
    /// Errors of the GPU.
    pub fn unknown(&mut self, depth: DeviceImage) -> Result<Vec<u32>> {
        let gpu = self.gpu;
        let words = depth.width.div_ceil(32);
        let call_words = bytes_of_words(&[depth.width, depth.height, depth.stride_bytes / 4].map(|n| n as u32));
        let call = self.calls[2].reserve(gpu, call_words.len())?;
        let bits = self.bits.reserve(gpu, 4 * words * depth.height)?;
        let mut steps = Steps::default();
        steps.write(call, 0, &call_words);
        steps.run(&self.unknown, &[call, depth.buffer, bits], [words, depth.height]);
        gpu.submit(&steps)?;
        let mut unknown = vec![0; words * depth.height];
        gpu.read_plain(bits, &mut unknown)?;
        Ok(unknown)
    }

    /// Appends the depths of pixels, by their indices (row x width + column).
    ///
    /// # Errors
    /// Errors of the GPU.
    pub fn pick(&mut self, depth: DeviceImage, places: &[usize], depths: &mut Vec<f32>) -> Result<()> {
        // The whole map as one row.
        let (width, stride) = (depth.width, depth.stride_bytes / 4);
        let numbers = |places: &[usize]| places.iter().map(|at| (at / width * stride + at % width) as u32).collect();
        let grids: Vec<Grid> =
            places.chunks(PICKED_AT_ONCE).map(|places| Grid { columns: numbers(places), rows: vec![0] }).collect();
        let words = self.picker.pick(depth, size_of::<f32>(), &grids)?;
        depths.extend(words.iter().map(|word| f32::from_bits(*word)));
        Ok(())
    }

    /// Writes the points of a depth map and the colours of an image of `channels` bytes per pixel, 1 or 3; rows of the
    /// cloud have no padding. `filled` has index and depth of the points that are filled in. Does not wait.
    ///
    /// # Errors
    /// Errors of the GPU.
    pub fn cloud(
        &mut self,
        depth: DeviceImage,
        (image, channels): (DeviceImage, usize),
        filled: &[(usize, f32)],
        views: &Rectification,
        cloud: DeviceImage,
    ) -> Result<()> {
        let gpu = self.gpu;
        let DeviceImage { width, height, .. } = depth;
        let sizes = [width, height, depth.stride_bytes / 4, image.stride_bytes, channels, filled.len()];
        let camera = [views.left.cx as f32, views.left.cy as f32, (1.0 / views.left.focal_px) as f32];
        let call_words = bytes_of_words(&[&sizes.map(|n| n as u32)[..], &camera.map(f32::to_bits)].concat());
        let list: Vec<u32> = filled.iter().flat_map(|(at, z_mm)| [*at as u32, z_mm.to_bits()]).collect();
        let call = self.calls[1].reserve(gpu, call_words.len())?;
        let mut steps = Steps::default();
        steps.write(call, 0, &call_words);
        steps.run(&self.cloud, &[call, cloud.buffer, depth.buffer, image.buffer], [width, height]);
        if !filled.is_empty() {
            let points = self.filled.reserve(gpu, 4 * list.len())?;
            steps.write_plain(points, 0, &list);
            let threads = [filled.len().min(FILL_ROW), filled.len().div_ceil(FILL_ROW)];
            steps.run(&self.fill, &[call, cloud.buffer, points], threads);
        }
        gpu.submit(&steps)
    }
}
