//! Detections compared with ground truth: masks, overlaps, precision, recall and average precision.

mod mask;
mod names;
mod score;
mod tally;

pub use mask::Mask;
pub use names::normal_name;
pub use score::{ClassScore, Find, Object, Ranking, Scores, Shape, THRESHOLDS, mean, overlap, pairs, score};
pub use tally::{Rates, Tally};
