//! A frame's pixels at full, half and quarter size, so that a mosaic can be drawn small without aliasing.

use crate::geometry::Homography;
use crate::{Parallel, SharedMut, View};

/// Sizes kept: full, half, quarter.
const LEVELS: usize = 3;
/// Rows per chunk.
const ROWS: usize = 32;

/// A frame at one of the sizes.
#[derive(Clone, Debug, Default)]
struct Level {
    bgr: Vec<u8>,
    width: usize,
    height: usize,
}

/// A BGR frame in three sizes; its memory is reused for frames of the same size.
#[derive(Clone, Debug, Default)]
pub(super) struct Picture {
    levels: [Level; LEVELS],
}

impl Picture {
    /// Copies a BGR view and halves it twice.
    pub fn fill(&mut self, view: View<'_, u8>, pool: &dyn Parallel) {
        let [full, half, quarter] = &mut self.levels;
        (full.width, full.height) = (view.width, view.height);
        full.bgr.resize(view.width * view.height * 3, 0);
        for (y, row) in full.bgr.chunks_exact_mut(view.width * 3).enumerate() {
            row.copy_from_slice(view.row(y));
        }
        halve(full, half, pool);
        halve(half, quarter, pool);
    }

    /// Copies another's pixels without freeing memory.
    pub fn copy_from(&mut self, other: &Self) {
        for (own, other) in self.levels.iter_mut().zip(&other.levels) {
            own.bgr.clone_from(&other.bgr);
            (own.width, own.height) = (other.width, other.height);
        }
    }

    /// The size to sample for a frame that is drawn with scale `scale`, and its map from full size.
    pub fn level(&self, scale: f64) -> (View<'_, u8>, Homography) {
        let index = if scale < 0.35 { 2 } else { usize::from(scale < 0.7) };
        let level = &self.levels[index];
        let factor = 0.5f64.powi(index as i32);
        // Pixel centres are whole numbers: pixel 0 of the half size lies at 0.5 of the full one.
        let shift = (factor - 1.0) * 0.5;
        let map = Homography::translation(shift, shift).compose(&Homography::scaling(factor));
        (View::new(&level.bgr, level.width, level.height, 3), map)
    }
}

fn halve(from: &Level, to: &mut Level, pool: &dyn Parallel) {
    (to.width, to.height) = (from.width / 2, from.height / 2);
    let (width, height) = (to.width, to.height);
    to.bgr.resize(width * height * 3, 0);
    let target = SharedMut::new(&mut to.bgr);
    pool.run(height.div_ceil(ROWS), &|chunk| {
        for y in chunk * ROWS..(chunk * ROWS + ROWS).min(height) {
            // SAFETY: each row belongs to one chunk.
            let row = unsafe { target.part(y * width * 3, width * 3) };
            let top = &from.bgr[2 * y * from.width * 3..][..width * 6];
            let bottom = &from.bgr[(2 * y + 1) * from.width * 3..][..width * 6];
            for ((out, a), b) in
                row.as_chunks_mut::<3>().0.iter_mut().zip(top.as_chunks::<6>().0).zip(bottom.as_chunks::<6>().0)
            {
                for c in 0..3 {
                    let sum = u16::from(a[c]) + u16::from(a[c + 3]) + u16::from(b[c]) + u16::from(b[c + 3]);
                    out[c] = ((sum + 2) / 4) as u8;
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Serial;

    #[test]
    fn smaller_sizes_show_the_same_places() {
        // A ramp: the value gives the column of the full frame.
        let ramp: Vec<u8> = (0..16 * 8 * 3).map(|i| (i / 3 % 16 * 8) as u8).collect();
        let mut picture = Picture::default();
        picture.fill(View::new(&ramp, 16, 8, 3), &Serial);
        for scale in [1.0, 0.5, 0.25] {
            let (view, map) = picture.level(scale);
            let column = 1usize;
            let full = map.inverse().unwrap().map([column as f64, 0.0])[0];
            assert!((f64::from(view.row(0)[3 * column]) - full * 8.0).abs() <= 1.0, "{scale}: {full}");
        }
    }
}
