//! The weighted-least-squares filter on maps that stay on the GPU: the result of the processor to 0.01 px.
//!
//! The processor reads where disparities are known, and the pixels that the filter has moved: it finds the objects that
//! keep their disparities.

use panoscope_imaging::Rect;
use panoscope_imaging::stereo::WlsParams;
use panoscope_imaging::stereo::confidence::{FULL_SHARE, STEPS_PER_PX};
use panoscope_imaging::stereo::kept_regions::{EDGE_PX, MovedPixel, MovedRegions};
use panoscope_node::Result;
use panoscope_node::device::{DeviceImage, Gpu, Kernel, Steps, Store, bytes_of_words};

use super::scale::{Scaler, Scaling, image_in};
use super::wls::GpuWlsSolver;
use crate::coarse::MAX_STEP_PX;
use crate::shrinking::Shrinking;

/// Sides of the filtered rectangle are multiples of this, as on the processor.
const GRAIN_PX: usize = 32;
/// Pixels of a row of threads of the shader that restores.
const RESTORE_ROW: usize = 4096;

/// Inputs and outputs of a call, of one size.
#[derive(Clone, Copy, Debug)]
pub struct WlsImages<'a> {
    /// Rectified left view, and bytes of its pixels: 1 or 3.
    pub guide: (DeviceImage, usize),
    /// Left disparity.
    pub disparity: DeviceImage,
    /// Right disparity.
    pub right: Option<DeviceImage>,
    /// Confidence that is given.
    pub given: Option<DeviceImage>,
    /// What of the view is lit, and for each row the columns that may be filled beyond it, and those that are lit.
    pub mask: Option<(DeviceImage, &'a [[u32; 4]])>,
    /// Width of the strip beyond the mask, px.
    pub beyond_px: usize,
    /// Smoothed map.
    pub smooth: DeviceImage,
    /// Its confidence.
    pub confidence: DeviceImage,
}

/// Filters maps. Keeps its memory on the GPU.
#[derive(Debug)]
pub struct GpuWlsFilter {
    gpu: Gpu,
    solver: GpuWlsSolver,
    scaler: Scaler,
    known: Kernel,
    trust: Kernel,
    finish: Kernel,
    moved: Kernel,
    restore: Kernel,
    mask: Kernel,
    call: Store,
    bounds: Store,
    list: Store,
    kept: Store,
    rows: Store,
    spare: Store,
    /// Inputs and outputs that are shrunk.
    small: [Store; 6],
    regions: MovedRegions,
    pixels: Vec<[u32; 2]>,
    words: Vec<u32>,
}

impl GpuWlsFilter {
    /// Prepares the GPU.
    ///
    /// # Errors
    /// It rejects a shader.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let (head, guide) = (include_str!("wls_call.wgsl"), include_str!("wls_guide.wgsl"));
        let kernel = |label: &str, parts: &[&str]| gpu.kernel(label, &[&[head], parts].concat());
        let (call, bounds, list, kept, rows, spare) = Default::default();
        Ok(Self {
            gpu,
            solver: GpuWlsSolver::new(gpu)?,
            scaler: Scaler::new(gpu)?,
            known: kernel("wls known", &[include_str!("wls_known.wgsl")])?,
            trust: kernel("wls trust", &[guide, include_str!("wls_trust.wgsl")])?,
            finish: kernel("wls finish", &[include_str!("wls_finish.wgsl")])?,
            moved: kernel("wls moved", &[guide, include_str!("wls_moved.wgsl")])?,
            restore: kernel("wls restore", &[include_str!("wls_restore.wgsl")])?,
            mask: kernel("wls mask", &[guide, include_str!("wls_mask.wgsl")])?,
            call,
            bounds,
            list,
            kept,
            rows,
            spare,
            small: Default::default(),
            regions: MovedRegions::default(),
            pixels: Vec::new(),
            words: Vec::new(),
        })
    }

    /// Room for the confidence of a map of this size when nobody reads it.
    ///
    /// # Errors
    /// It does not fit into the device.
    pub fn spare(&mut self, width: usize, height: usize) -> Result<DeviceImage> {
        image_in(self.gpu, &mut self.spare, (width, height), 4)
    }

    /// Filters a map, by these parameters on images shrunk by `factor`. Does not wait for the results.
    ///
    /// # Errors
    /// Errors of the GPU.
    pub fn compute(&mut self, images: &WlsImages<'_>, params: &WlsParams, factor: usize) -> Result<()> {
        self.write_call(images, params, Rect::default())?;
        let roi = self.known(images.disparity)?;
        match Shrinking::new(factor, (images.disparity.width, images.disparity.height)) {
            Some(shrinking) => self.filter_shrunk(images, params, roi, shrinking)?,
            None => self.filter(images, params, roi)?,
        }
        self.clear_beyond(images, params)
    }

    /// Filters the middle of each block of the map, and enlarges what that makes.
    fn filter_shrunk(
        &mut self,
        images: &WlsImages<'_>,
        params: &WlsParams,
        roi: Rect,
        shrinking: Shrinking,
    ) -> Result<()> {
        let (gpu, Shrinking { factor, size }) = (self.gpu, shrinking);
        let [guide, disparity, right, given, smooth, confidence] = &mut self.small;
        let guide = image_in(gpu, guide, size, 1)?;
        let (whole_guide, pixel_bytes) = images.guide;
        let mut jobs = vec![(Scaling::Shrink { pixel_bytes }, whole_guide, guide)];
        let mut sampled = |whole: DeviceImage, store: &mut Store, times: f32| -> Result<DeviceImage> {
            let small = image_in(gpu, store, size, 4)?;
            jobs.push((Scaling::Sample { times }, whole, small));
            Ok(small)
        };
        let in_px = 1.0 / factor as f32;
        let small = WlsImages {
            guide: (guide, 1),
            disparity: sampled(images.disparity, disparity, in_px)?,
            right: images.right.map(|map| sampled(map, right, in_px)).transpose()?,
            given: images.given.map(|map| sampled(map, given, 1.0)).transpose()?,
            mask: None,
            beyond_px: 0,
            smooth: image_in(gpu, smooth, size, 4)?,
            confidence: image_in(gpu, confidence, size, 4)?,
        };
        self.scaler.run(factor, &jobs)?;
        self.filter(&small, params, shrinking.roi(roi))?;
        let of_map = Scaling::Enlarge { times: factor as f32, max_step: MAX_STEP_PX };
        let of_confidence = Scaling::Enlarge { times: 1.0, max_step: f32::MAX };
        let jobs = [(of_map, small.smooth, images.smooth), (of_confidence, small.confidence, images.confidence)];
        self.scaler.run(factor, &jobs)
    }

    /// Filters `roi` of a map.
    fn filter(&mut self, images: &WlsImages<'_>, params: &WlsParams, roi: Rect) -> Result<()> {
        let (gpu, call) = (self.gpu, self.write_call(images, params, roi)?);
        let DeviceImage { width, height, buffer: disparity, .. } = images.disparity;
        let ((guide, _), smooth, confidence) = (images.guide, images.smooth.buffer, images.confidence.buffer);
        let buffer = |first: Option<DeviceImage>, second: Option<DeviceImage>| {
            first.or(second).map_or(disparity, |image| image.buffer)
        };
        let size = [roi.width, roi.height];
        let [product, support] = self.solver.planes(roi.area().max(1))?;
        if !roi.is_empty() {
            let mut steps = Steps::default();
            let others = buffer(images.given, images.right);
            steps.run(&self.trust, &[call, disparity, others, guide.buffer, product, support], size);
            gpu.submit(&steps)?;
            self.solver.solve(images.guide, roi, params, [product, support])?;
        }
        let mut steps = Steps::default();
        steps.run(&self.finish, &[call, product, support, smooth, confidence], [width, height]);
        let list = self.list.reserve(gpu, 8 * (1 + roi.area()))?;
        let can_restore = !roi.is_empty() && (images.right.is_some() || images.given.is_some());
        if can_restore {
            steps.write(list, 0, &[0; 8]);
            let others = buffer(images.right, images.given);
            steps.run(&self.moved, &[call, disparity, others, guide.buffer, smooth, list], size);
        }
        gpu.submit(&steps)?;
        if can_restore {
            self.restore(images, params, roi, (call, list))?;
        }
        Ok(())
    }

    /// Clears what is outside the mask and the strip around it.
    fn clear_beyond(&mut self, images: &WlsImages<'_>, params: &WlsParams) -> Result<()> {
        let Some((mask, rows)) = images.mask else { return Ok(()) };
        let (gpu, call) = (self.gpu, self.write_call(images, params, Rect::default())?);
        let mut steps = Steps::default();
        let store = self.rows.reserve(gpu, 16 * rows.len())?;
        let words = bytes_of_words(rows.as_flattened());
        steps.write(store, 0, &words);
        let buffers = [call, mask.buffer, images.guide.0.buffer, store, images.smooth.buffer, images.confidence.buffer];
        steps.run(&self.mask, &buffers, [mask.width, mask.height]);
        gpu.submit(&steps)
    }

    /// Writes what the shaders read about a call that filters `roi`.
    fn write_call(&mut self, images: &WlsImages<'_>, params: &WlsParams, roi: Rect) -> Result<u64> {
        let DeviceImage { width, height, .. } = images.disparity;
        let words = |image: Option<DeviceImage>| image.map_or(0, |image| image.stride_bytes / 4);
        let strides =
            [Some(images.disparity), images.right, images.given, Some(images.smooth), Some(images.confidence)];
        let (guide, channels) = images.guide;
        let mask_stride = images.mask.map_or(0, |(mask, _)| mask.stride_bytes);
        let trust = &params.confidence;
        let side = (2 * trust.scatter_radius_px + 1) as f32;
        let numbers = [
            &[width, height, roi.x, roi.y, roi.width, roi.height][..],
            &strides.map(words),
            &[guide.stride_bytes, channels, mask_stride, trust.scatter_radius_px],
        ];
        let levels = [trust.highlight_level.map_or(256, i32::from), trust.dark_level.map_or(-1, i32::from)];
        let limits = [
            trust.left_right_px,
            trust.loss_per_px2 / (STEPS_PER_PX * STEPS_PER_PX),
            1.0 / (FULL_SHARE * (side * side)),
            params.min_support.max(1e-6),
        ];
        self.words.clear();
        self.words.extend(numbers.iter().flat_map(|numbers| numbers.iter().map(|n| *n as u32)));
        self.words.extend(levels.map(|level| level as u32));
        self.words.extend(limits.map(f32::to_bits));
        self.words.push(images.beyond_px as u32);
        let call = self.call.reserve(self.gpu, 4 * self.words.len())?;
        let mut steps = Steps::default();
        steps.write_plain(call, 0, &self.words);
        self.gpu.submit(&steps)?;
        Ok(call)
    }

    /// The rectangle around all known disparities, widened to whole grains.
    fn known(&mut self, disparity: DeviceImage) -> Result<Rect> {
        let (width, height) = (disparity.width, disparity.height);
        let (call, bounds) = (self.call.reserve(self.gpu, 16)?, self.bounds.reserve(self.gpu, 16)?);
        let mut steps = Steps::default();
        let none = bytes_of_words(&[u32::MAX, 0, u32::MAX, 0]);
        steps.write(bounds, 0, &none);
        steps.run(&self.known, &[call, disparity.buffer, bounds], [width.div_ceil(GRAIN_PX), height]);
        self.gpu.submit(&steps)?;
        let mut found = [0_u32; 4];
        self.gpu.read_plain(bounds, &mut found)?;
        let [first, last, top, low] = found.map(|n| n as usize);
        if first > last {
            return Ok(Rect::default());
        }
        let y = top / GRAIN_PX * GRAIN_PX;
        let (columns, rows) = ((last + 1 - first) * GRAIN_PX, (low + 1).next_multiple_of(GRAIN_PX) - y);
        Ok(Rect::new(first * GRAIN_PX, y, columns, rows).clamped(width, height))
    }

    /// Gives objects back their disparities.
    fn restore(
        &mut self,
        images: &WlsImages<'_>,
        params: &WlsParams,
        roi: Rect,
        (call, list): (u64, u64),
    ) -> Result<()> {
        let gpu = self.gpu;
        let mut head = [[0_u32; 2]];
        gpu.read_plain(list, head.as_flattened_mut())?;
        let count = (head[0][0] as usize).min(roi.area());
        self.pixels.resize(1 + count, [0; 2]);
        gpu.read_plain(list, self.pixels.as_flattened_mut())?;
        // Threads find them in any order.
        let pixels = &mut self.pixels[1..];
        pixels.sort_unstable();
        self.regions.join(pixels.iter().map(|[at, code]| MovedPixel {
            x: roi.x + *at as usize % roi.width,
            y: roi.y + *at as usize / roi.width,
            is_exposed: code & 1 != 0,
            contacts: code >> 3,
            joins_left: code & 2 != 0,
            joins_above: code & 4 != 0,
        }));
        let (words, width) = (&mut self.words, images.disparity.width);
        words.clear();
        words.push(0);
        self.regions.objects(&params.confidence, params.confidence.scatter_radius_px + EDGE_PX, |y, columns| {
            words.extend(columns.map(|x| (y * width + x) as u32));
        });
        let count = words.len() - 1;
        if count == 0 {
            return Ok(());
        }
        words[0] = count as u32;
        let kept = self.kept.reserve(gpu, 4 * words.len())?;
        let mut steps = Steps::default();
        steps.write_plain(kept, 0, words);
        let buffers = [call, kept, images.disparity.buffer, images.smooth.buffer, images.confidence.buffer];
        steps.run(&self.restore, &buffers, [count.min(RESTORE_ROW), count.div_ceil(RESTORE_ROW)]);
        gpu.submit(&steps)
    }
}
