//! Filters on shrunk maps: a quarter of the pixels at half the size, and a quarter of the work.
//!
//! A disparity map of shrunk views ([`crate::shrunk`]) repeats each value over a block of pixels. A filter at the size of the blocks
//! loses little, and the smooth map is enlarged without steps.

use panoscope_imaging::features::{GrayBuffer, shrink_gray};
use panoscope_imaging::stereo::FilterInput;
use panoscope_imaging::{Parallel, SharedMut, View, ViewMut};

use crate::shrinking::Shrinking;

/// Rows of a map per chunk.
const ROWS: usize = 32;

/// Neighbours with a larger difference are two surfaces, in px of the shrunk map: nothing lies between them.
pub const MAX_STEP_PX: f32 = 1.0;

/// Inputs and outputs of a filter, shrunk.
#[derive(Default)]
pub struct Coarse {
    guide: GrayBuffer,
    disparity: Vec<f32>,
    disparity_right: Vec<f32>,
    confidence: Vec<f32>,
    /// What the filter makes.
    smooth: Vec<f32>,
    support: Vec<f32>,
    /// Lines that each chunk of rows works in.
    lines: Vec<f32>,
}

/// What a filter works on: its inputs, and where the map and its confidence go.
pub struct Job<'f, 'o> {
    pub given: FilterInput<'f>,
    pub disparity: ViewMut<'o, f32>,
    pub confidence: Option<ViewMut<'o, f32>>,
}

impl Coarse {
    /// Runs a filter on inputs shrunk by `factor` and enlarges what it makes. The guide becomes gray.
    ///
    /// # Errors
    /// Those of the filter.
    pub fn run<E>(
        &mut self,
        factor: usize,
        job: Job<'_, '_>,
        pool: &dyn Parallel,
        filter: impl FnOnce(Job<'_, '_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let given = job.given;
        let Some(shrinking) = Shrinking::new(factor, (given.disparity.width, given.disparity.height)) else {
            return filter(job);
        };
        let (width, height) = shrinking.size;
        shrink_gray(given.guide, factor, &mut self.guide, pool);
        let in_px = 1.0 / factor as f32;
        sample(given.disparity, factor, in_px, &mut self.disparity);
        let disparity_right = given.disparity_right.map(|map| {
            sample(map, factor, in_px, &mut self.disparity_right);
            View::new(&self.disparity_right[..], width, height, 1)
        });
        let confidence = given.confidence.map(|map| {
            sample(map, factor, 1.0, &mut self.confidence);
            View::new(&self.confidence[..], width, height, 1)
        });
        self.smooth.resize(width * height, f32::NAN);
        self.support.resize(width * height, 0.0);
        let small = FilterInput {
            guide: self.guide.view(),
            disparity: View::new(&self.disparity[..], width, height, 1),
            disparity_right,
            confidence,
            roi: shrinking.roi(given.roi),
        };
        filter(Job {
            given: small,
            disparity: ViewMut::new(&mut self.smooth, width, height, 1),
            confidence: job.confidence.is_some().then(|| ViewMut::new(&mut self.support, width, height, 1)),
        })?;
        let smooth = View::new(&self.smooth[..], width, height, 1);
        enlarge(smooth, factor, factor as f32, MAX_STEP_PX, pool, job.disparity, &mut self.lines);
        if let Some(confidence) = job.confidence {
            let support = View::new(&self.support[..], width, height, 1);
            enlarge(support, factor, 1.0, f32::INFINITY, pool, confidence, &mut self.lines);
        }
        Ok(())
    }
}

/// The middle of every block of a map, times `times`.
fn sample(map: View<'_, f32>, factor: usize, times: f32, out: &mut Vec<f32>) {
    out.clear();
    for y in 0..map.height / factor {
        let row = map.row(y * factor + factor / 2);
        let blocks = row.chunks_exact(factor);
        out.extend(blocks.map(|block| block[factor / 2] * times));
    }
}

/// Between `a` and `b`, `share` of the way; the nearer of them where they are more than `step` apart or one is unknown.
fn between(a: f32, b: f32, share: f32, step: f32) -> f32 {
    if (b - a).abs() <= step {
        a + (b - a) * share
    } else if share < 0.5 {
        a
    } else {
        b
    }
}

/// Where the middle of pixel `at` lies in a line of `count` blocks: the block before it and the share of the way to the next one.
fn place(at: usize, factor: usize, count: usize) -> (usize, f32) {
    let middle = ((2 * at + 1) as f32 / (2 * factor) as f32 - 0.5).clamp(0.0, (count - 1) as f32);
    (middle as usize, middle.fract())
}

/// Enlarges `small` by `factor`, linear within surfaces, its values times `times`. What no block covers continues the last one.
fn enlarge(
    small: View<'_, f32>,
    factor: usize,
    times: f32,
    step: f32,
    pool: &dyn Parallel,
    map: ViewMut<'_, f32>,
    lines: &mut Vec<f32>,
) {
    let (stride, columns, rows) = (map.stride, map.width, map.height);
    let target = SharedMut::new(map.data);
    let (chunks, work) = (rows.div_ceil(ROWS), 2 * small.width + 2);
    lines.resize(chunks * work, 0.0);
    let lines = SharedMut::new(lines);
    pool.run(chunks, &|chunk| {
        // SAFETY: each chunk takes its own lines.
        let (line, phase) = unsafe { lines.part(chunk * work, work) }.split_at_mut(small.width + 2);
        for y in chunk * ROWS..(chunk * ROWS + ROWS).min(rows) {
            let (above, down) = place(y, factor, small.height);
            let (a, b) = (small.row(above), small.row((above + 1).min(small.height - 1)));
            for (value, (a, b)) in line[1..].iter_mut().zip(a.iter().zip(b)) {
                *value = between(*a, *b, down, step) * times;
            }
            // Both ends stand once more, so that every pixel has two neighbours.
            line[0] = line[1];
            line[small.width + 1] = line[small.width];
            // SAFETY: every row belongs to one chunk.
            let row = unsafe { target.part(y * stride, columns) };
            let (blocks, rest) = row.split_at_mut((small.width * factor).min(columns));
            // All first pixels of the blocks, then all second ones: the same share for many, so that they are computed at once.
            for at in 0..factor {
                // The shares repeat with every block.
                let (first, share) = place(factor + at, factor, 3);
                let near = line[first..].iter().zip(&line[first + 1..]);
                for (value, (a, b)) in phase.iter_mut().zip(near) {
                    *value = between(*a, *b, share, step * times);
                }
                blocks[at..].iter_mut().step_by(factor).zip(&*phase).for_each(|(pixel, value)| *pixel = *value);
            }
            rest.fill(line[small.width]);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_imaging::{Rect, Serial};

    #[test]
    fn slopes_stay_straight_and_steps_stay_steps() {
        // A slope of a quarter px per px, and 40 px more from the middle on.
        let (width, height) = (32, 6);
        let slope = |x: f32| 10.0 + 0.25 * x + if x < 48.0 { 0.0 } else { 40.0 };
        let small: Vec<f32> = (0..width * height).map(|i| slope(3.0 * (i % width) as f32 + 1.0) / 3.0).collect();
        let mut map = vec![f32::NAN; 97 * 19];
        let small = View::new(&small[..], width, height, 1);
        enlarge(small, 3, 3.0, MAX_STEP_PX, &Serial, ViewMut::new(&mut map, 97, 19, 1), &mut Vec::new());
        for y in 0..19 {
            for x in 1..95 {
                let value = map[y * 97 + x];
                // The two pixels next to the step take the value of their block.
                let limit = if (47..=48).contains(&x) { 0.26 } else { 1e-3 };
                assert!((value - slope(x as f32)).abs() < limit, "{x}, {y}: {value}");
            }
        }
        assert!(map.iter().all(|value| value.is_finite()));
    }

    #[test]
    fn unknown_blocks_stay_unknown() {
        let mut small = [8.0; 12];
        small[5] = f32::NAN;
        let mut map = vec![0.0; 16 * 12];
        enlarge(
            View::new(&small[..], 4, 3, 1),
            4,
            4.0,
            1.0,
            &Serial,
            ViewMut::new(&mut map, 16, 12, 1),
            &mut Vec::new(),
        );
        let unknown: Vec<usize> = (0..map.len()).filter(|i| map[*i].is_nan()).collect();
        let wanted: Vec<usize> =
            (0..map.len()).filter(|i| (4..8).contains(&(i % 16)) && (4..8).contains(&(i / 16))).collect();
        assert_eq!(unknown, wanted);
        assert!(map.iter().all(|v| v.is_nan() || *v == 32.0));
    }

    #[test]
    fn a_filter_sees_blocks_and_fills_whole_pixels() {
        let guide = vec![90u8; 64 * 32 * 3];
        let disparity: Vec<f32> = (0..64 * 32).map(|i| 20.0 + (i % 64 / 2) as f32).collect();
        let (mut smooth, mut support) = (vec![0.0; 64 * 32], vec![9.0; 64 * 32]);
        let given = FilterInput {
            guide: View::new(&guide[..], 64, 32, 3),
            disparity: View::new(&disparity[..], 64, 32, 1),
            disparity_right: None,
            confidence: None,
            roi: Rect::whole(64, 32),
        };
        let job = Job {
            given,
            disparity: ViewMut::new(&mut smooth, 64, 32, 1),
            confidence: Some(ViewMut::new(&mut support, 64, 32, 1)),
        };
        let copied: Result<(), ()> = Coarse::default().run(2, job, &Serial, |small| {
            let mut to = small.disparity;
            assert_eq!((to.width, to.height, small.given.guide.channels), (32, 16, 1));
            assert_eq!(small.given.roi, Rect::whole(32, 16));
            (0..16).for_each(|y| to.row_mut(y).copy_from_slice(small.given.disparity.row(y)));
            if let Some(mut confidence) = small.confidence {
                (0..16).for_each(|y| confidence.row_mut(y).fill(0.5));
            }
            Ok(())
        });
        assert_eq!(copied, Ok(()));
        assert!(smooth.iter().zip(&disparity).all(|(a, b)| (a - b).abs() <= 0.5));
        assert!(support.iter().all(|value| *value == 0.5));
    }
}
