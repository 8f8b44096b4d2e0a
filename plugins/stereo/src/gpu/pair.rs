//! Views and maps of a pair that stay on the GPU while they are matched.
//!
//! The processor decides, as for frames in its own memory, from small parts that it reads: shrunk views at each survey,
//! columns at the borders of the maps, patches around matched points where it measures their rows. It reads the left map
//! when speckles are removed.

use std::ops::Range;

use panoscope_imaging::stereo::{
    BlockMatchingParams, MapSamples, PairMaps, PairMatcher, PairParams, PairViews, RowEdit, StereoError, Tile,
};
use panoscope_imaging::{Parallel, Rect, Report, View, ViewMut};
use panoscope_node::device::{DeviceImage, Gpu, Kernel, Steps, Store, bytes_of_words};
use panoscope_node::{NodeError, Result};

use super::block_matching::GpuBlockMatcher;
use super::scale::{ScaleJob, Scaler, Scaling, image_in};
use crate::shrinking::Shrinking;

/// Size of what a shader reads about a call, bytes.
const SIZE_BYTES: usize = 32;
/// Words of a row's edit.
const ROW_WORDS: usize = 7;
/// Rows per workgroup, and threads of it, of the shader that projects a map, as the dispatch counts threads.
const PROJECT_THREADS: [usize; 2] = [32, 4];
/// Distance of the pixels by which the known share of a map is estimated.
const SHARE_STEP_PX: usize = 8;

fn failed(error: NodeError) -> StereoError {
    StereoError::Device { reason: error.to_string() }
}

/// Reads small parts of images. Keeps its memory.
#[derive(Debug)]
struct Sampler {
    gpu: Gpu,
    kernel: Kernel,
    patches: Kernel,
    sizes: Store,
    result: Store,
    found: Vec<u32>,
}

impl Sampler {
    fn new(gpu: Gpu) -> Result<Self> {
        let kernel = gpu.kernel("pair sample", &[include_str!("pair_sample.wgsl")])?;
        let patches = gpu.kernel("pair patches", &[include_str!("pair_patches.wgsl")])?;
        Ok(Self { gpu, kernel, patches, sizes: Store::default(), result: Store::default(), found: Vec::new() })
    }

    /// Each `step`-th pixel of `area`, or, for pixels of one byte, the mean of each whole block: one word each, row after
    /// row.
    fn read(&mut self, image: &DeviceImage, pixel_bytes: usize, area: Rect, step: usize) -> Result<&[u32]> {
        let (width, height) = match pixel_bytes {
            1 => (area.width / step, area.height / step),
            _ => (area.width.div_ceil(step), area.height.div_ceil(step)),
        };
        self.found.resize(width * height, 0);
        if width * height > 0 {
            let words = [width, height, area.x, area.y, step, image.stride_bytes, pixel_bytes, 0].map(|n| n as u32);
            let (sizes, result) =
                (self.sizes.reserve(self.gpu, SIZE_BYTES)?, self.result.reserve(self.gpu, 4 * width * height)?);
            let words = bytes_of_words(&words);
            let mut steps = Steps::default();
            steps.write(sizes, 0, &words);
            steps.run(&self.kernel, &[sizes, image.buffer, result], [width, height]);
            self.gpu.submit(&steps)?;
            self.gpu.read_plain(result, &mut self.found)?;
        }
        Ok(&self.found)
    }

    /// See [`PairViews::patches`].
    fn patches(
        &mut self,
        image: &DeviceImage,
        corners: &[[usize; 2]],
        (width, height): (usize, usize),
        out: &mut Vec<u8>,
    ) -> Result<()> {
        let bytes = width * height;
        // Patches begin at whole words.
        let words = bytes.div_ceil(4);
        let firsts = corners.iter().map(|[x, y]| (y * image.stride_bytes + x) as u32);
        let head = [image.stride_bytes, width, bytes, corners.len()].map(|n| n as u32);
        let call_words: Vec<u32> = head.into_iter().chain(firsts).collect();
        let call = self.sizes.reserve(self.gpu, 4 * call_words.len())?;
        let result = self.result.reserve(self.gpu, 4 * words * corners.len())?;
        let mut steps = Steps::default();
        steps.write_plain(call, 0, &call_words);
        steps.run(&self.patches, &[call, image.buffer, result], [words, corners.len()]);
        self.gpu.submit(&steps)?;
        out.resize(4 * words * corners.len(), 0);
        self.gpu.read(result, out)?;
        (1..corners.len())
            .for_each(|patch| out.copy_within(4 * words * patch..4 * words * patch + bytes, bytes * patch));
        out.truncate(bytes * corners.len());
        Ok(())
    }

    /// As [`Self::read`], of gray values.
    fn bytes(&mut self, image: &DeviceImage, area: Rect, step: usize, out: &mut Vec<u8>) -> Result<(), StereoError> {
        let found = self.read(image, 1, area, step).map_err(failed)?;
        out.clear();
        out.extend(found.iter().map(|value| *value as u8));
        Ok(())
    }

    /// As [`Self::read`], of disparities.
    fn floats(&mut self, image: &DeviceImage, area: Rect, step: usize, out: &mut Vec<f32>) -> Result<(), StereoError> {
        let found = self.read(image, 4, area, step).map_err(failed)?;
        out.clear();
        out.extend(found.iter().map(|bits| f32::from_bits(*bits)));
        Ok(())
    }
}

/// A gray pair on the GPU, and what reads it.
struct DeviceViews<'a> {
    images: [DeviceImage; 2],
    sampler: &'a mut Sampler,
    strips: &'a mut [Vec<u8>; 2],
}

impl PairViews for DeviceViews<'_> {
    fn size(&self) -> (usize, usize) {
        (self.images[0].width, self.images[0].height)
    }

    fn shrink(&mut self, side: usize, factor: usize, plane: &mut Vec<u8>) -> Result<(), StereoError> {
        let (width, height) = self.size();
        self.sampler.bytes(&self.images[side], Rect::whole(width, height), factor, plane)
    }

    fn border(&mut self, columns: usize) -> Result<[View<'_, u8>; 2], StereoError> {
        let (width, height) = self.size();
        for (side, strip) in self.strips.iter_mut().enumerate() {
            let area = Rect::new(if side == 0 { width - columns } else { 0 }, 0, columns, height);
            self.sampler.bytes(&self.images[side], area, 1, strip)?;
        }
        Ok(self.strips.each_ref().map(|strip| View::new(&strip[..], columns, height, 1)))
    }

    fn patches(
        &mut self,
        side: usize,
        corners: &[[usize; 2]],
        size: (usize, usize),
        out: &mut Vec<u8>,
    ) -> Result<(), StereoError> {
        self.sampler.patches(&self.images[side], corners, size, out).map_err(failed)
    }
}

/// Kernels that change maps, and memory.
#[derive(Debug)]
struct MapWork {
    gpu: Gpu,
    edit: Kernel,
    project: Kernel,
    sampler: Sampler,
    scaler: Scaler,
    sizes: Store,
    edits: [Store; 2],
    /// The right map when nobody reads it.
    spare: Store,
    /// Views and maps that are shrunk.
    small: [Store; 4],
    floats: Vec<f32>,
    words: Vec<u32>,
}

/// Views that are matched, and their maps.
#[derive(Clone, Copy)]
struct Pair {
    views: [DeviceImage; 2],
    maps: [DeviceImage; 2],
}

/// Maps on the GPU: rows of [`DeviceImage::stride_bytes`].
struct DeviceMaps<'a> {
    matcher: &'a mut GpuBlockMatcher,
    work: &'a mut MapWork,
    params: &'a BlockMatchingParams,
    /// In full size.
    whole: Pair,
    /// What is matched in place of the views.
    shrunk: Option<(Shrinking, Pair)>,
    right_is_read: bool,
}

impl DeviceMaps<'_> {
    fn size(&self) -> (usize, usize) {
        (self.whole.maps[0].width, self.whole.maps[0].height)
    }

    /// Shrinks the views if they are matched so, and clears the maps that are matched. Returns what is matched.
    fn begin(&mut self, has_right: bool) -> Result<Pair> {
        let whole = self.whole;
        let pair = match self.shrunk {
            Some((shrinking, pair)) => {
                let of = Scaling::Shrink { pixel_bytes: 1 };
                let jobs = [0, 1].map(|side| (of, whole.views[side], pair.views[side]));
                self.work.scaler.run(shrinking.factor, &jobs)?;
                pair
            }
            None => whole,
        };
        for side in 0..=usize::from(has_right) {
            self.edit_map(side, pair.maps[side], &[RowEdit::CLEAR])?;
        }
        Ok(pair)
    }

    /// Makes the maps in full size.
    fn end(&mut self, has_right: bool) -> Result<()> {
        let Some((Shrinking { factor, .. }, pair)) = self.shrunk else { return Ok(()) };
        let of = Scaling::Repeat { times: factor as f32 };
        let jobs: [ScaleJob; 2] = [0, 1].map(|side| (of, pair.maps[side], self.whole.maps[side]));
        self.work.scaler.run(factor, &jobs[..1 + usize::from(has_right)])
    }

    fn match_range(&mut self, mut range: (i32, usize), mut roi: Rect, has_right: bool) -> Result<()> {
        let Pair { views, maps } = self.begin(has_right)?;
        if let Some((shrinking, _)) = &self.shrunk {
            (range, roi) = (shrinking.range(range), shrinking.roi(roi));
        }
        let params = BlockMatchingParams { min_disparity_px: range.0, search_px: range.1, ..self.params.clone() };
        self.matcher.compute(&params, views, roi, (maps[0], has_right.then_some(maps[1])))?;
        self.end(has_right)
    }

    fn match_each(&mut self, tiles: &[Tile], mut left_right_px: Option<f32>) -> Result<()> {
        // The right map is not matched.
        let Pair { views, maps } = self.begin(false)?;
        let tiles: Vec<Tile> = match &self.shrunk {
            Some((shrinking, _)) => {
                left_right_px = shrinking.px(left_right_px);
                shrinking.tiles(tiles).collect()
            }
            None => tiles.to_vec(),
        };
        self.matcher.compute_tiles(self.params, views, &tiles, maps[0])?;
        self.project(maps, left_right_px)?;
        self.end(true)
    }

    fn edit_map(&mut self, side: usize, map: DeviceImage, rows: &[RowEdit]) -> Result<()> {
        let gpu = self.work.gpu;
        let step = usize::from(rows.len() > 1);
        let head = [map.width, map.height, map.stride_bytes / 4, side, step, 0, 0, 0].map(|n| n as u32);
        let words = &mut self.work.words;
        words.clear();
        words.extend(head);
        for edit in rows {
            let [first, last] = edit.there.map(f32::to_bits);
            let row = [edit.keep[0], edit.keep[1], first, last, edit.from, edit.value.to_bits()];
            words.extend(row.into_iter().chain([u32::from(edit.overwrites)]));
        }
        let call = self.work.edits[side].reserve(gpu, 4 * (head.len() + ROW_WORDS * rows.len()))?;
        let mut steps = Steps::default();
        steps.write_plain(call, 0, words);
        steps.run(&self.work.edit, &[call, map.buffer], [map.width, map.height]);
        gpu.submit(&steps)
    }

    fn project(&mut self, [left, right]: [DeviceImage; 2], left_right_px: Option<f32>) -> Result<()> {
        let gpu = self.work.gpu;
        let sizes = [left.width, left.height, left.stride_bytes / 4, right.stride_bytes / 4].map(|n| n as u32);
        let words = bytes_of_words(&[&sizes[..], &[left_right_px.unwrap_or(-1.0).to_bits()]].concat());
        let call = self.work.sizes.reserve(gpu, SIZE_BYTES)?;
        let mut steps = Steps::default();
        steps.write(call, 0, &words);
        let threads = [PROJECT_THREADS[0], PROJECT_THREADS[1] * left.height];
        steps.run(&self.work.project, &[call, left.buffer, right.buffer], threads);
        gpu.submit(&steps)
    }
}

impl MapSamples for DeviceMaps<'_> {
    fn samples(&mut self, area: Rect, step: usize, out: &mut Vec<f32>) -> Result<(), StereoError> {
        self.work.sampler.floats(&self.whole.maps[0], area, step, out)
    }

    fn known_share(&mut self) -> Result<f64, StereoError> {
        let (width, height) = self.size();
        let MapWork { sampler, floats, .. } = &mut *self.work;
        sampler.floats(&self.whole.maps[0], Rect::whole(width, height), SHARE_STEP_PX, floats)?;
        let known = floats.iter().filter(|value| value.is_finite()).count();
        Ok(known as f64 / floats.len().max(1) as f64)
    }
}

impl PairMaps for DeviceMaps<'_> {
    fn right_is_read(&self) -> bool {
        self.right_is_read
    }

    fn match_roi(
        &mut self,
        range: (i32, usize),
        roi: Rect,
        right_is_needed: bool,
        _: &dyn Parallel,
    ) -> Result<(), StereoError> {
        self.match_range(range, roi, right_is_needed || self.right_is_read).map_err(failed)
    }

    fn match_tiles(&mut self, tiles: &[Tile], left_right_px: Option<f32>, _: &dyn Parallel) -> Result<(), StereoError> {
        self.match_each(tiles, left_right_px).map_err(failed)
    }

    fn edit(&mut self, side: usize, rows: &[RowEdit], _: &dyn Parallel) -> Result<(), StereoError> {
        self.edit_map(side, self.whole.maps[side], rows).map_err(failed)
    }

    fn columns(&mut self, side: usize, columns: Range<usize>) -> Result<View<'_, f32>, StereoError> {
        let (_, height) = self.size();
        let MapWork { sampler, floats, .. } = &mut *self.work;
        sampler.floats(&self.whole.maps[side], Rect::new(columns.start, 0, columns.len(), height), 1, floats)?;
        Ok(View::new(floats, columns.len(), height, 1))
    }

    fn change_left(&mut self, change: &mut dyn FnMut(ViewMut<'_, f32>)) -> Result<(), StereoError> {
        let DeviceImage { buffer, width, height, stride_bytes } = self.whole.maps[0];
        let MapWork { gpu, floats, .. } = &mut *self.work;
        let stride = stride_bytes / 4;
        floats.resize(stride * height, f32::NAN);
        gpu.read_plain(buffer, floats).map_err(failed)?;
        change(ViewMut::with_stride(floats, width, height, 1, stride));
        let mut steps = Steps::default();
        steps.write_plain(buffer, 0, floats);
        gpu.submit(&steps).map_err(failed)
    }
}

impl MapWork {
    /// Room for a pair and its maps.
    fn shrunk(&mut self, size: (usize, usize)) -> Result<Pair> {
        let [left, right, map, map_right] = &mut self.small;
        let image = |store, pixel_bytes| image_in(self.gpu, store, size, pixel_bytes);
        Ok(Pair { views: [image(left, 1)?, image(right, 1)?], maps: [image(map, 4)?, image(map_right, 4)?] })
    }
}

/// Matches pairs that stay on the GPU.
#[derive(Debug)]
pub struct GpuPairMatcher {
    blocks: GpuBlockMatcher,
    views: Sampler,
    strips: [Vec<u8>; 2],
    work: MapWork,
}

impl GpuPairMatcher {
    /// Prepares the GPU.
    ///
    /// # Errors
    /// It rejects a shader.
    pub fn new(gpu: Gpu) -> Result<Self> {
        let edit = gpu.kernel("pair edit", &[include_str!("pair_edit.wgsl")])?;
        let project = gpu.kernel("pair project", &[include_str!("pair_project.wgsl")])?;
        let (sizes, edits, spare, small, floats, words) = Default::default();
        let (sampler, scaler) = (Sampler::new(gpu)?, Scaler::new(gpu)?);
        let work = MapWork { gpu, edit, project, sampler, scaler, sizes, edits, spare, small, floats, words };
        let strips = Default::default();
        Ok(Self { blocks: GpuBlockMatcher::new(gpu)?, views: Sampler::new(gpu)?, strips, work })
    }

    /// As [`PairMatcher::compute`], with `pair`, block matching by these parameters on views shrunk by `factor`, and views
    /// and maps on the GPU, all of one size. Does not wait for the maps.
    ///
    /// # Errors
    /// [`StereoError::Device`] when the GPU failed; a parameter out of range.
    pub fn compute(
        &mut self,
        pair: &mut PairMatcher,
        report: &dyn Report,
        images: [DeviceImage; 2],
        roi: Rect,
        (params, pair_params, factor): (&BlockMatchingParams, &PairParams, usize),
        pool: &dyn Parallel,
        left: DeviceImage,
        right: Option<DeviceImage>,
    ) -> Result<(), StereoError> {
        let size = (images[0].width, images[0].height);
        let right_is_read = right.is_some();
        let work = &mut self.work;
        let right = match right {
            Some(right) => right,
            None => image_in(work.gpu, &mut work.spare, size, 4).map_err(failed)?,
        };
        let shrunk = Shrinking::new(factor, size)
            .map(|shrinking| Ok((shrinking, work.shrunk(shrinking.size)?)))
            .transpose()
            .map_err(failed)?;
        let mut views = DeviceViews { images, sampler: &mut self.views, strips: &mut self.strips };
        let whole = Pair { views: images, maps: [left, right] };
        let mut maps = DeviceMaps { matcher: &mut self.blocks, work, params, whole, shrunk, right_is_read };
        pair.compute_in(report, &mut views, &mut maps, roi, pair_params, pool)
    }
}
