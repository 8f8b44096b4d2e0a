//! Matching on shrunk views: a quarter of the pixels and half of the disparities at half the size.
//!
//! What needs a coarse map only, such as a homography, has it in a fraction of the time. The map still has the views' size and
//! counts their pixels; each value stands for a block of pixels.

use panoscope_imaging::features::{GrayBuffer, shrink_gray};
use panoscope_imaging::stereo::{BlockMatcher, StereoError};
use panoscope_imaging::{Parallel, Rect, SharedMut, View, ViewMut};

use crate::matcher::Engine;

/// Rows of a map per chunk.
const ROWS: usize = 32;

/// A block matcher on views shrunk by a whole factor.
pub struct Shrunk {
    /// Its parameters are in shrunk pixels.
    pub kernel: BlockMatcher,
    /// Pixels of a view per shrunk pixel, each way.
    pub factor: usize,
    views: [GrayBuffer; 2],
    maps: [Vec<f32>; 2],
}

impl Shrunk {
    /// A matcher on views of full size.
    pub fn new(kernel: BlockMatcher) -> Self {
        Self { kernel, factor: 1, views: Default::default(), maps: Default::default() }
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
            let line = &small[y / factor * width..][..width];
            let (blocks, rest) = row.split_at_mut(width * factor);
            for (block, &value) in blocks.chunks_exact_mut(factor).zip(line) {
                block.fill(value * factor as f32);
            }
            rest.fill(f32::NAN);
        }
    });
}

impl Engine for Shrunk {
    fn compute(
        &mut self,
        views: [View<'_, u8>; 2],
        roi: Rect,
        pool: &dyn Parallel,
        disparity: ViewMut<'_, f32>,
        disparity_right: Option<ViewMut<'_, f32>>,
    ) -> Result<(), StereoError> {
        let factor = self.factor.max(1);
        let (width, height) = (views[0].width / factor, views[0].height / factor);
        if factor == 1 || width == 0 || height == 0 {
            return self.kernel.compute(views[0], views[1], roi, pool, disparity, disparity_right);
        }
        for (view, small) in views.into_iter().zip(&mut self.views) {
            shrink_gray(view, factor, small, pool);
        }
        let (left, right) = (self.views[0].view(), self.views[1].view());
        let (x, y) = (roi.x / factor, roi.y / factor);
        let end = |start: usize, size: usize, limit: usize| ((start + size).div_ceil(factor)).min(limit);
        let roi = Rect {
            x,
            y,
            width: end(roi.x, roi.width, width).saturating_sub(x),
            height: end(roi.y, roi.height, height).saturating_sub(y),
        };
        for map in &mut self.maps {
            map.resize(width * height, f32::NAN);
        }
        let [map, map_right] = &mut self.maps;
        let wanted = disparity_right.is_some();
        let target = wanted.then(|| ViewMut::new(map_right, width, height, 1));
        self.kernel.compute(left, right, roi, pool, ViewMut::new(map, width, height, 1), target)?;
        enlarge(map, (width, height), factor, pool, disparity);
        if let Some(target) = disparity_right {
            enlarge(map_right, (width, height), factor, pool, target);
        }
        Ok(())
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
        let params = BlockMatchingParams { search_px: 32, block_px: 9, ..BlockMatchingParams::default() };
        let mut shrunk = Shrunk::new(BlockMatcher::new(params).expect("good parameters"));
        shrunk.factor = 2;
        let mut map = vec![0.0; W * H];
        let views = [View::new(&left[..], W, H, 1), View::new(&right[..], W, H, 1)];
        shrunk.compute(views, Rect::whole(W, H), &Serial, ViewMut::new(&mut map, W, H, 1), None).expect("a match");
        let known: Vec<f32> = map.iter().copied().filter(|d| d.is_finite()).collect();
        assert!(known.len() > W * H / 2, "{} of {}", known.len(), W * H);
        let good = known.iter().filter(|d| (**d - 40.0).abs() < 0.5).count();
        assert!(good * 20 > known.len() * 19, "{good} of {}", known.len());
    }
}
