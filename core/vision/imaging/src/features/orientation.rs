//! SURF orientation of one keypoint, from samples of the image pyramid.
//!
//! Bay et al. 2008, section 4.1: Haar responses of side 4 s within 6 s vote for the orientation.

use super::patch::{Grid, PATCH, Patch, ROW};
use super::pyramid::Pyramid;
use super::sampling::sample;
use crate::Simd;
use crate::simd::dispatch;

/// Samples of an orientation patch along each side.
const TURN_PATCH: usize = 16;
/// Haar responses of an orientation patch along each side.
const TURN_WINDOW: usize = TURN_PATCH - 3;
/// The same, sixteen to a row.
const VOTES: usize = TURN_WINDOW * 16;
/// Responses to each side of the middle one that lie in the circle, by row.
const REACH: [usize; TURN_WINDOW] = [0, 3, 4, 5, 5, 5, 6, 5, 5, 5, 4, 3, 0];
/// Gaussian over the orientation circle, in samples.
const TURN_SIGMA: f64 = 3.5;
/// Orientation is read at this multiple of the keypoint's scale.
const TURN_SCALE: f32 = 1.4;
const BINS: usize = 72;
/// 60 degrees.
const SECTOR_BINS: usize = 12;

/// Weights of the Haar responses; zero outside the circle.
#[derive(Clone, Debug)]
pub(crate) struct TurnWeights([[f32; 16]; TURN_WINDOW]);

impl TurnWeights {
    pub(crate) fn new() -> Self {
        let mut weights = [[0.0; 16]; TURN_WINDOW];
        for (j, line) in weights.iter_mut().enumerate() {
            for (i, weight) in line.iter_mut().enumerate().take(TURN_WINDOW) {
                let (x, y) = (i as f64 - 6.0, j as f64 - 6.0);
                let squared = x * x + y * y;
                if squared <= 36.0 {
                    *weight = (-squared / (2.0 * TURN_SIGMA * TURN_SIGMA)).exp() as f32;
                }
            }
        }
        Self(weights)
    }
}

/// Work memory of one keypoint after the other; every part is written before it is read.
pub(crate) struct Scratch {
    pub patch: Patch,
    votes: Votes,
    sectors: Sectors,
}

impl Scratch {
    pub(crate) fn new() -> Self {
        let votes = Votes { all: [0.0; VOTES + 3], fall: [0.0; VOTES + 3], pair: [[0.0; 2]; VOTES], bin: [0; VOTES] };
        let sectors = Sectors {
            one: [0.0; 2 * (BINS + 12)],
            two: [0.0; 2 * (BINS + 10)],
            four: [0.0; 2 * (BINS + 8)],
            sum: [[0.0; 2]; BINS],
            length: [0.0; BINS],
        };
        Self { patch: [[0.0; ROW]; PATCH], votes, sectors }
    }
}

/// Haar responses and where they point.
struct Votes {
    /// Sums of four by one samples, and the fall over two rows each; three more, so that the last row can be read like
    /// the others.
    all: [f32; VOTES + 3],
    fall: [f32; VOTES + 3],
    pair: [[f32; 2]; VOTES],
    bin: [i32; VOTES],
}

/// Sums of one, two, four and `SECTOR_BINS` neighbouring bins around the circle, x and y in turn.
struct Sectors {
    one: [f32; 2 * (BINS + 12)],
    two: [f32; 2 * (BINS + 10)],
    four: [f32; 2 * (BINS + 8)],
    sum: [[f32; 2]; BINS],
    length: [f32; BINS],
}

/// Dominant direction around `(x, y)` at scale `s` (pixels), in radians within `-pi..=pi`, y down.
pub(crate) fn orientation(
    simd: Simd,
    weights: &TurnWeights,
    pyramid: &Pyramid,
    x: f32,
    y: f32,
    scale: f32,
    scratch: &mut Scratch,
) -> f32 {
    let scale = scale * TURN_SCALE;
    let (level, grid) = Grid::on(pyramid, x, y, scale, scale, 0.0);
    let Scratch { patch, votes, sectors } = scratch;
    sample(simd, level, grid, (TURN_PATCH as f32 - 1.0) / 2.0, TURN_PATCH, TURN_PATCH / 8, patch);
    let (patch, target) = (&*patch, &mut *votes);
    dispatch!(simd, vote(weights: &TurnWeights, patch: &Patch, target: &mut Votes));
    // Two lists taken in turn: neighbours mostly vote for the same bin, and would wait for each other.
    let mut sums = [[[0.0f32; 2]; BINS]; 2];
    for (j, reach) in REACH.into_iter().enumerate() {
        for i in 6 - reach..7 + reach {
            let [x, y] = votes.pair[j * 16 + i];
            let sum = &mut sums[i % 2][votes.bin[j * 16 + i] as usize];
            *sum = [sum[0] + x, sum[1] + y];
        }
    }
    let sums = &sums;
    let [x, y] = dispatch!(simd, strongest(sums: &[[[f32; 2]; BINS]; 2], sectors: &mut Sectors) -> [f32; 2]);
    y.atan2(x)
}

#[inline(always)]
fn vote(weights: &TurnWeights, patch: &Patch, votes: &mut Votes) {
    for j in 0..TURN_WINDOW {
        let (all, fall) = (&mut votes.all[j * 16..j * 16 + 16], &mut votes.fall[j * 16..j * 16 + 16]);
        for i in 0..16 {
            let (top, bottom) = (patch[j][i] + patch[j + 1][i], patch[j + 2][i] + patch[j + 3][i]);
            all[i] = top + bottom;
            fall[i] = bottom - top;
        }
    }
    for j in 0..TURN_WINDOW {
        let (all, fall) = (&votes.all[j * 16..j * 16 + 19], &votes.fall[j * 16..j * 16 + 19]);
        let (pair, bin) = (&mut votes.pair[j * 16..j * 16 + 16], &mut votes.bin[j * 16..j * 16 + 16]);
        // The last three of a row run into the next one; nobody reads them.
        for i in 0..16 {
            let weight = weights.0[j][i];
            let dx = ((all[i + 2] + all[i + 3]) - (all[i] + all[i + 1])) * weight;
            let dy = ((fall[i] + fall[i + 1]) + (fall[i + 2] + fall[i + 3])) * weight;
            pair[i] = [dx, dy];
            bin[i] = direction_bin(dx, dy);
        }
    }
}

/// The longest sum of `SECTOR_BINS` neighbouring bins around the circle; the first one of equal sums.
#[inline(always)]
fn strongest(sums: &[[[f32; 2]; BINS]; 2], sectors: &mut Sectors) -> [f32; 2] {
    const _: () = assert!(SECTOR_BINS == 12 && BINS.is_multiple_of(8));
    let (even, odd) = (sums[0].as_flattened(), sums[1].as_flattened());
    let Sectors { one, two, four, sum, length } = sectors;
    for i in 0..2 * BINS {
        one[i] = even[i] + odd[i];
    }
    one.copy_within(..24, 2 * BINS);
    for i in 0..two.len() {
        two[i] = one[i] + one[i + 2];
    }
    for i in 0..four.len() {
        four[i] = two[i] + two[i + 4];
    }
    for (i, sum) in sum.as_flattened_mut().iter_mut().enumerate() {
        *sum = (four[i] + four[i + 8]) + four[i + 16];
    }
    for (length, [x, y]) in length.iter_mut().zip(&*sum) {
        *length = x * x + y * y;
    }
    let mut most = [0.0f32; 8];
    for eight in length.as_chunks::<8>().0 {
        for k in 0..8 {
            most[k] = if eight[k] > most[k] { eight[k] } else { most[k] };
        }
    }
    let most = most.iter().fold(0.0f32, |a, b| a.max(*b));
    length.iter().position(|length| *length == most).map_or([0.0; 2], |place| sum[place])
}

/// Which of 72 bins of 5 degrees holds the direction; exact to about 0.3 degrees.
#[inline(always)]
fn direction_bin(dx: f32, dy: f32) -> i32 {
    let (ax, ay) = (dx.abs(), dy.abs());
    let (small, large) = (ax.min(ay), ax.max(ay));
    let ratio = small / large.max(1e-20);
    // atan(r) on 0..1 (error below 0.005 rad), as a share of a full turn.
    let angle = ratio * (std::f32::consts::FRAC_PI_4 + 0.273 * (1.0 - ratio)) * (BINS as f32 / std::f32::consts::TAU);
    let angle = if ay > ax { BINS as f32 / 4.0 - angle } else { angle };
    let angle = if dx < 0.0 { BINS as f32 / 2.0 - angle } else { angle };
    let angle = if dy < 0.0 { BINS as f32 - angle } else { angle };
    let angle = if angle > 0.0 { angle } else { 0.0 };
    let angle = if angle < BINS as f32 - 1.0 { angle } else { BINS as f32 - 1.0 };
    // SAFETY: between 0 and the last bin; a NaN has become 0.
    unsafe { angle.to_int_unchecked() }
}
