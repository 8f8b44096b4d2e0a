//! Intervals by the bootstrap (Efron and Tibshirani 1993, chapter 13), drawn from blocks of frames.
//!
//! Frames that follow each other within seconds show the same instruments in nearly the same position and light, so
//! that drawing single frames would give intervals several times too narrow (Künsch 1989). Frames of one operation are
//! therefore drawn in blocks, whole runs of frames without a longer gap, each operation as many blocks as it has.
//! Operations are not drawn, because three are too few. The intervals show the effect of the random choice of frames,
//! not the difference of another operation.

use panoscope_base::random::SplitMix64;

use super::super::truth::Picture;
use super::file::Folds;
use crate::error::{Context, Result};
use crate::statistics::percentile;
use panoscope_imaging::detect::Ranking;

/// Redrawn samples per figure.
pub const RESAMPLES: usize = 1000;

/// Blocks of images (indices), operation by operation.
pub struct Blocks(Vec<Vec<Vec<usize>>>);

impl Blocks {
    /// Cuts the frames of each operation where the gap is longer than the folds allow.
    ///
    /// # Errors
    /// The name of an image does not end with `_` and a number.
    pub fn of(pictures: &[Picture], folds: &Folds) -> Result<Self> {
        let gap = folds.frame_rate_hz * folds.block_s;
        let mut frames = pictures
            .iter()
            .enumerate()
            .map(|(index, picture)| {
                let stem = picture.stem();
                let number = stem.rsplit_once('_').and_then(|(_, number)| number.parse::<u64>().ok());
                let number =
                    number.with_context(|| format!("frame {stem}: its name does not end with `_` and a number"))?;
                Ok((picture.operation(), number, index))
            })
            .collect::<Result<Vec<_>>>()?;
        frames.sort();
        let mut operations: Vec<Vec<Vec<usize>>> = Vec::new();
        let mut before: Option<(&str, u64)> = None;
        for (operation, number, index) in &frames {
            match before {
                Some((last, at)) if last == operation && (number - at) as f64 <= gap => {
                    operations.last_mut().and_then(|o| o.last_mut()).into_iter().for_each(|b| b.push(*index));
                }
                Some((last, _)) if last == operation => {
                    operations.last_mut().into_iter().for_each(|o| o.push(vec![*index]));
                }
                _ => operations.push(vec![vec![*index]]),
            }
            before = Some((operation, *number));
        }
        Ok(Self(operations))
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.0.iter().map(Vec::len).sum()
    }

    /// Number of times that each of `pictures` images is drawn.
    fn draw(&self, random: &mut SplitMix64, pictures: usize) -> Vec<u32> {
        let mut times = vec![0; pictures];
        for blocks in &self.0 {
            for _ in blocks {
                for &picture in &blocks[random.below(blocks.len())] {
                    times[picture] += 1;
                }
            }
        }
        times
    }
}

/// AP at 0.5 of each class in [`RESAMPLES`] redrawn samples, for several rankings of the same images: all get the same
/// draws.
pub fn resampled(rankings: &[Ranking], blocks: &Blocks, pictures: usize, seed: u64) -> Vec<Vec<Vec<f64>>> {
    let mut random = SplitMix64(seed);
    let draws: Vec<Vec<u32>> = (0..RESAMPLES).map(|_| blocks.draw(&mut random, pictures)).collect();
    let of = |ranking: &Ranking| draws.iter().map(|times| ranking.ap50(times)).collect();
    rankings.iter().map(of).collect()
}

/// 95 % interval of `values`; NaN without a finite value.
pub fn interval(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let values: Vec<f64> = values.collect();
    [percentile(&values, 0.025), percentile(&values, 0.975)]
}
