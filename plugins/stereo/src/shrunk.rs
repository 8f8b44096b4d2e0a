//! Matching on shrunk views: a quarter of the pixels and half of the disparities at half the size.
//!
//! What needs a coarse map only, such as a homography, has it in a fraction of the time. The map still has the views' size and
//! counts their pixels; each value stands for a block of pixels.

use panoscope_imaging::features::{GrayBuffer, shrink_gray};
use panoscope_imaging::stereo::{PairMatcher, PairParams, StereoError, StereoKernel, Tile};
use panoscope_imaging::{Parallel, Rect, SharedMut, View, ViewMut};
use panoscope_node::Context;

use crate::matcher::{In, Out, PairKernel};
use crate::on_device::DeviceMatcher;

/// Rows of a map per chunk.
const ROWS: usize = 32;

/// A block matcher on views shrunk by a whole factor.
pub struct Shrunk {
    /// Its parameters are in shrunk pixels; its range is set by each call.
    pub kernel: DeviceMatcher,
    /// Pixels of a view per shrunk pixel, each way.
    pub factor: usize,
    views: [GrayBuffer; 2],
    maps: [Vec<f32>; 2],
    tiles: Vec<Tile>,
}

impl Shrunk {
    /// A matcher on views of full size.
    pub fn new(kernel: DeviceMatcher) -> Self {
        Self { kernel, factor: 1, views: Default::default(), maps: Default::default(), tiles: Vec::new() }
    }

    /// Shrinks both views, and makes room for their maps.
    fn shrink(&mut self, views: [View<'_, u8>; 2], pool: &dyn Parallel) {
        let size = (views[0].width / self.factor) * (views[0].height / self.factor);
        for (view, small) in views.into_iter().zip(&mut self.views) {
            shrink_gray(view, self.factor, small, pool);
        }
        self.maps.iter_mut().for_each(|map| map.resize(size, f32::NAN));
    }
}

/// Disparities that the kernel searches at once.
const SEARCH_STEP_PX: usize = 32;

/// A range of full-size disparities in those of views shrunk by `factor`.
fn shrunk_range(first_px: i32, search_px: usize, factor: usize) -> (i32, usize) {
    let scale = factor as i32;
    // Rounded down: a range that exceeds the end by less than a shrunk pixel costs a whole block of disparities.
    let first = first_px.div_euclid(scale);
    let end = (first_px + search_px as i32).div_euclid(scale) + 1;
    let search = (end - first).max(2) as usize - 1;
    (first, search.next_multiple_of(SEARCH_STEP_PX))
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
        (first_px, search_px): (i32, usize),
        views: [View<'_, u8>; 2],
        roi: Rect,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        disparity_right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        let factor = self.factor.max(1);
        let (width, height) = (views[0].width / factor, views[0].height / factor);
        if factor == 1 || width == 0 || height == 0 {
            return self.kernel.match_roi((first_px, search_px), views, roi, pool, disparity, disparity_right);
        }
        self.shrink(views, pool);
        let (left, right) = (self.views[0].view(), self.views[1].view());
        let (x, y) = (roi.x / factor, roi.y / factor);
        let end = |start: usize, size: usize, limit: usize| ((start + size).div_ceil(factor)).min(limit);
        let roi = Rect {
            x,
            y,
            width: end(roi.x, roi.width, width).saturating_sub(x),
            height: end(roi.y, roi.height, height).saturating_sub(y),
        };
        let [map, map_right] = &mut self.maps;
        let wanted = disparity_right.is_some();
        let target = wanted.then(|| ViewMut::new(map_right, width, height, 1));
        let range = shrunk_range(first_px, search_px, factor);
        let to = ViewMut::new(map, width, height, 1);
        self.kernel.match_roi(range, [left, right], roi, pool, to, target)?;
        enlarge(map, (width, height), factor, pool, disparity);
        if let Some(target) = disparity_right {
            enlarge(map_right, (width, height), factor, pool, target);
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
        let factor = self.factor.max(1);
        let (width, height) = (views[0].width / factor, views[0].height / factor);
        if factor == 1 || width == 0 || height == 0 {
            return self.kernel.match_tiles(tiles, views, left_right_px, pool, disparity, disparity_right);
        }
        self.shrink(views, pool);
        let (left, right) = (self.views[0].view(), self.views[1].view());
        self.tiles.clear();
        self.tiles.extend(tiles.iter().map(|tile| {
            // Both ends are rounded alike, so that neighbours still touch.
            let cut = |start: usize, size: usize| (start / factor, (start + size) / factor - start / factor);
            let ((x, width), (y, height)) = (cut(tile.area.x, tile.area.width), cut(tile.area.y, tile.area.height));
            let (first_px, search_px) = shrunk_range(tile.first_px, tile.search_px, factor);
            Tile { area: Rect { x, y, width, height }, first_px, search_px }
        }));
        let [map, map_right] = &mut self.maps;
        let maps = [&mut *map, &mut *map_right].map(|map| ViewMut::new(map, width, height, 1));
        let [to, to_right] = maps;
        let left_right_px = left_right_px.map(|px| px / factor as f32);
        self.kernel.match_tiles(&self.tiles, [left, right], left_right_px, pool, to, to_right)?;
        enlarge(map, (width, height), factor, pool, disparity);
        enlarge(map_right, (width, height), factor, pool, disparity_right);
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
        // Views are shrunk in the host's memory.
        if self.factor > 1 { Ok(false) } else { self.kernel.match_there(pair, cx, input, out, roi, params) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_imaging::Serial;
    use panoscope_imaging::stereo::BlockMatchingParams;

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
        let mut shrunk = Shrunk::new(DeviceMatcher::new(params).expect("good parameters"));
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
