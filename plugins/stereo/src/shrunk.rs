//! Matching on shrunk views: a quarter of the pixels and half of the disparities at half the size.
//!
//! What needs a coarse map only, such as a homography, has it in a fraction of the time. The map still has the views' size and
//! counts their pixels; each value stands for a block of pixels.

use panoscope_imaging::features::{GrayBuffer, shrink_gray};
use panoscope_imaging::stereo::{
    BlockMatcher, BlockMatchingParams, PairMatcher, PairParams, StereoError, StereoKernel, Tile,
};
use panoscope_imaging::{Parallel, Rect, Report, SharedMut, View, ViewMut};
use panoscope_node::Context;
use panoscope_node::device::{Device, OnDevice};

use crate::gpu::pair::GpuPairMatcher;
use crate::matcher::{In, Out, PairKernel};
use crate::shrinking::Shrinking;

/// Rows of a map per chunk.
const ROWS: usize = 32;

/// A block matcher on views shrunk by a whole factor: on the processor, or on the GPU where the views are there.
pub struct Shrunk {
    /// Its parameters are in shrunk pixels; its range is set by each call.
    pub kernel: BlockMatcher,
    /// Pixels of a view per shrunk pixel, each way.
    pub factor: usize,
    gpu: OnDevice<GpuPairMatcher>,
    views: [GrayBuffer; 2],
    maps: [Vec<f32>; 2],
    tiles: Vec<Tile>,
}

impl Shrunk {
    /// A matcher on views of full size, on the processor.
    ///
    /// # Errors
    /// A parameter is out of range.
    pub fn new(params: BlockMatchingParams) -> Result<Self, StereoError> {
        let (gpu, views, maps, tiles) = Default::default();
        Ok(Self { kernel: BlockMatcher::new(params)?, factor: 1, gpu, views, maps, tiles })
    }

    /// Chooses the device.
    pub fn choose(&mut self, device: Device, report: &dyn Report) {
        self.gpu.choose(device, report, GpuPairMatcher::new);
    }

    /// Shrinks both views, and makes room for their maps.
    fn shrink(&mut self, shrinking: Shrinking, views: [View<'_, u8>; 2], pool: &dyn Parallel) {
        for (view, small) in views.into_iter().zip(&mut self.views) {
            shrink_gray(view, shrinking.factor, small, pool);
        }
        self.maps.iter_mut().for_each(|map| map.resize(shrinking.size.0 * shrinking.size.1, f32::NAN));
    }
}

/// Repeats every value of `line`, times `N`, `N` times.
fn repeat<const N: usize>(line: &[f32], out: &mut [f32]) {
    for (block, value) in out.as_chunks_mut::<N>().0.iter_mut().zip(line) {
        *block = [value * N as f32; N];
    }
}

/// Repeats every value of `small`, times `factor`, over its block; what no block covers is NaN.
fn enlarge(small: &[f32], (width, height): (usize, usize), factor: usize, pool: &dyn Parallel, map: ViewMut<'_, f32>) {
    let (stride, columns, rows) = (map.stride, map.width, map.height);
    let target = SharedMut::new(map.data);
    pool.run(rows.div_ceil(ROWS), &|chunk| {
        for y in chunk * ROWS..(chunk * ROWS + ROWS).min(rows) {
            // SAFETY: every row belongs to one chunk.
            let row = unsafe { target.part(y * stride, columns) };
            if y / factor >= height {
                row.fill(f32::NAN);
                continue;
            }
            if y > chunk * ROWS && !y.is_multiple_of(factor) {
                // SAFETY: the row above belongs to this chunk, too, and does not overlap this one.
                row.copy_from_slice(unsafe { target.part((y - 1) * stride, columns) });
                continue;
            }
            let line = &small[y / factor * width..][..width];
            let (blocks, rest) = row.split_at_mut(width * factor);
            match factor {
                2 => repeat::<2>(line, blocks),
                3 => repeat::<3>(line, blocks),
                4 => repeat::<4>(line, blocks),
                _ => {
                    for (block, &value) in blocks.chunks_exact_mut(factor).zip(line) {
                        block.fill(value * factor as f32);
                    }
                }
            }
            rest.fill(f32::NAN);
        }
    });
}

impl StereoKernel for Shrunk {
    fn match_roi(
        &mut self,
        range: (i32, usize),
        views: [View<'_, u8>; 2],
        roi: Rect,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        disparity_right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        let Some(shrinking) = Shrinking::new(self.factor, (views[0].width, views[0].height)) else {
            return self.kernel.match_roi(range, views, roi, pool, disparity, disparity_right);
        };
        self.shrink(shrinking, views, pool);
        let (Shrinking { factor, size }, views) = (shrinking, self.views.each_ref().map(GrayBuffer::view));
        let [map, map_right] = &mut self.maps;
        let to = ViewMut::new(map, size.0, size.1, 1);
        let to_right = disparity_right.is_some().then(|| ViewMut::new(map_right, size.0, size.1, 1));
        self.kernel.match_roi(shrinking.range(range), views, shrinking.roi(roi), pool, to, to_right)?;
        enlarge(map, size, factor, pool, disparity);
        if let Some(target) = disparity_right {
            enlarge(map_right, size, factor, pool, target);
        }
        Ok(())
    }

    fn match_tiles(
        &mut self,
        tiles: &[Tile],
        views: [View<'_, u8>; 2],
        left_right_px: Option<f32>,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        disparity_right: ViewMut<'_, f32>,
    ) -> Result<(), StereoError> {
        let Some(shrinking) = Shrinking::new(self.factor, (views[0].width, views[0].height)) else {
            return self.kernel.match_tiles(tiles, views, left_right_px, pool, disparity, disparity_right);
        };
        self.shrink(shrinking, views, pool);
        let (Shrinking { factor, size }, views) = (shrinking, self.views.each_ref().map(GrayBuffer::view));
        self.tiles.clear();
        self.tiles.extend(shrinking.tiles(tiles));
        let [map, map_right] = &mut self.maps;
        let [to, to_right] = [&mut *map, &mut *map_right].map(|map| ViewMut::new(map, size.0, size.1, 1));
        self.kernel.match_tiles(&self.tiles, views, shrinking.px(left_right_px), pool, to, to_right)?;
        enlarge(map, size, factor, pool, disparity);
        enlarge(map_right, size, factor, pool, disparity_right);
        Ok(())
    }
}

impl PairKernel for Shrunk {
    fn match_there(
        &mut self,
        pair: &mut PairMatcher,
        cx: &Context<'_>,
        input: &In<'_>,
        out: &mut Out<'_>,
        roi: Rect,
        params: &PairParams,
    ) -> panoscope_node::Result<bool> {
        let (width, height) = (input.left.width(), input.left.height());
        self.gpu.attempt(cx, |gpu| {
            let images = [input.left.on_device()?, input.right.on_device()?];
            let left = out.disparity.alloc_on_device(width, height)?;
            let right = out.disparity_right.is_read().then(|| out.disparity_right.alloc_on_device(width, height));
            let params = (self.kernel.params(), params, self.factor);
            Ok(gpu.compute(pair, cx, images, roi, params, cx.pool(), left, right.transpose()?)?)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_imaging::Serial;

    #[test]
    fn a_shrunk_match_counts_full_pixels() {
        const W: usize = 320;
        const H: usize = 160;
        let texture = |x: usize, y: usize| {
            let noise = ((x / 4) as u64 * 73_856_093) ^ ((y / 4) as u64 * 19_349_663);
            (noise.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8
        };
        let left: Vec<u8> = (0..W * H).map(|i| texture(i % W, i / W)).collect();
        let right: Vec<u8> = (0..W * H).map(|i| texture(i % W + 40, i / W)).collect();
        let params = BlockMatchingParams { block_px: 9, ..BlockMatchingParams::default() };
        let mut shrunk = Shrunk::new(params).expect("good parameters");
        shrunk.factor = 2;
        let mut map = vec![0.0; W * H];
        let views = [View::new(&left[..], W, H, 1), View::new(&right[..], W, H, 1)];
        let out = ViewMut::new(&mut map, W, H, 1);
        shrunk.match_roi((0, 64), views, Rect::whole(W, H), &Serial, out, None).expect("a match");
        let known: Vec<f32> = map.iter().copied().filter(|d| d.is_finite()).collect();
        assert!(known.len() > W * H / 2, "{} of {}", known.len(), W * H);
        let good = known.iter().filter(|d| (**d - 40.0).abs() < 0.5).count();
        assert!(good * 20 > known.len() * 19, "{good} of {}", known.len());
    }
}
