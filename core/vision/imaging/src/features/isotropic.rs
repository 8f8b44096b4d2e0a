//! Refines a keypoint with Gaussian derivatives, which makes position, strength and shape independent of the image's
//! rotation.
//!
//! Box filters respond differently to a rotated pattern, which shifts keypoints and reorders them. Candidates are few,
//! so the determinant of the Gaussian Hessian (Lindeberg 1998) is affordable: it is evaluated at 3 x 3 positions half a
//! scale apart; its maximum gives the position, its value the strength.

use super::patch::{Grid, ROW};
use super::pyramid::{Pyramid, VALUE_SCALE};
use super::sampling::sample;
use crate::Simd;
use crate::simd::dispatch;

/// Sigma of the Gaussian that responds to the same blobs as the box filter of SURF scale 1 (measured).
const SIGMA_PER_SCALE: f32 = 1.25;
/// Samples per sigma.
const PER_SIGMA: f32 = 2.0;
/// A position refined by more than this, in samples, is refined again from there.
const RECENTRE: f32 = 0.2;
/// Samples of a derivative kernel.
const TAPS: usize = 13;
/// Samples along each side: the kernel and one step to each side, rounded up to vectors.
const SIDE: usize = 16;

/// Gaussian derivative kernels of order 0, 1 and 2.
#[derive(Clone, Debug)]
pub(crate) struct Kernels {
    taps: [[f32; TAPS]; 3],
    /// The same, shifted by 0, 1 and 2 samples in a full row.
    rows: [[[f32; SIDE]; 3]; 3],
}

/// Position and strength of a candidate by the Gaussian Hessian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Refined {
    pub x: f32,
    pub y: f32,
    /// Determinant, normalised by scale, in squared gray levels.
    pub response: f32,
}

impl Kernels {
    pub(crate) fn new() -> Self {
        let sigma = f64::from(PER_SIGMA);
        let mut taps = [[0.0f64; TAPS]; 3];
        for i in 0..TAPS {
            let x = i as f64 - (TAPS / 2) as f64;
            let g = (-x * x / (2.0 * sigma * sigma)).exp();
            taps[0][i] = g;
            taps[1][i] = x * g;
            taps[2][i] = (x * x / (sigma * sigma) - 1.0) * g;
        }
        let place = |i: usize| i as f64 - (TAPS / 2) as f64;
        let total: f64 = taps[0].iter().sum();
        let mean: f64 = taps[2].iter().sum::<f64>() / total;
        for i in 0..TAPS {
            taps[2][i] -= mean * taps[0][i];
        }
        // Exact on constants, ramps and parabolas; derivatives per sigma instead of per sample.
        let slope: f64 = (0..TAPS).map(|i| taps[1][i] * place(i)).sum();
        let bend: f64 = (0..TAPS).map(|i| taps[2][i] * place(i) * place(i) * 0.5).sum();
        for i in 0..TAPS {
            taps[0][i] /= total;
            taps[1][i] *= sigma / slope;
            taps[2][i] *= sigma * sigma / bend;
        }
        let taps = taps.map(|kernel| kernel.map(|value| value as f32));
        let mut rows = [[[0.0; SIDE]; 3]; 3];
        for (kernel, shifted) in taps.iter().zip(&mut rows) {
            for (shift, row) in shifted.iter_mut().enumerate() {
                row[shift..shift + TAPS].copy_from_slice(kernel);
            }
        }
        Self { taps, rows }
    }
}

/// Refines the candidate at `(x, y)` of scale `s`, in pixels of the pyramid's finest level.
pub(crate) fn refine(simd: Simd, kernels: &Kernels, pyramid: &Pyramid, x: f32, y: f32, scale: f32) -> Refined {
    let sigma = scale * SIGMA_PER_SCALE;
    let step = sigma / PER_SIGMA;
    let (dx, dy, response) = place(simd, kernels, pyramid, x, y, sigma);
    let first = Refined { x: x + dx * step, y: y + dy * step, response };
    if dx.abs().max(dy.abs()) <= RECENTRE {
        return first;
    }
    let (dx, dy, response) = place(simd, kernels, pyramid, first.x, first.y, sigma);
    Refined { x: first.x + dx * step, y: first.y + dy * step, response }
}

/// Offset of the maximum, in samples, and its value.
fn place(simd: Simd, kernels: &Kernels, pyramid: &Pyramid, x: f32, y: f32, sigma: f32) -> (f32, f32, f32) {
    let (level, grid) = Grid::on(pyramid, x, y, sigma, sigma / PER_SIGMA, 0.0);
    let mut patch = [[0.0f32; ROW]; SIDE];
    // 15 samples are needed; sample 7 is the centre.
    sample(simd, level, grid, (TAPS / 2 + 1) as f32, SIDE - 1, SIDE / 8, &mut patch);
    let mut derivatives = [[[0.0f32; 3]; 3]; 3];
    let (patch, target) = (&patch, &mut derivatives);
    dispatch!(simd, differentiate(kernels: &Kernels, patch: &[[f32; ROW]; SIDE], target: &mut [[[f32; 3]; 3]; 3]));
    let det = |row: usize, column: usize| {
        let [xx, xy, yy] = derivatives[row][column];
        (xx * yy - xy * xy) * (1.0 / (VALUE_SCALE * VALUE_SCALE))
    };
    let centre = det(1, 1);
    let (gx, gy) = ((det(1, 2) - det(1, 0)) * 0.5, (det(2, 1) - det(0, 1)) * 0.5);
    let (hxx, hyy) = (det(1, 2) + det(1, 0) - 2.0 * centre, det(2, 1) + det(0, 1) - 2.0 * centre);
    let hxy = (det(2, 2) - det(2, 0) - det(0, 2) + det(0, 0)) * 0.25;
    let curvature = hxx * hyy - hxy * hxy;
    if !(hxx < 0.0 && curvature > 0.0) {
        return (0.0, 0.0, centre);
    }
    let dx = ((hxy * gy - hyy * gx) / curvature).clamp(-1.5, 1.5);
    let dy = ((hxy * gx - hxx * gy) / curvature).clamp(-1.5, 1.5);
    (dx, dy, centre + 0.5 * (gx * dx + gy * dy))
}

/// Second derivatives (xx, xy, yy) at 3 x 3 positions.
#[inline(always)]
fn differentiate(kernels: &Kernels, patch: &[[f32; ROW]; SIDE], out: &mut [[[f32; 3]; 3]; 3]) {
    for (shift, line) in out.iter_mut().enumerate() {
        let mut columns = [[0.0f32; SIDE]; 3];
        for tap in 0..TAPS {
            let row = &patch[shift + tap];
            for order in 0..3 {
                let weight = kernels.taps[order][tap];
                for i in 0..SIDE {
                    columns[order][i] += row[i] * weight;
                }
            }
        }
        for (place, derivatives) in line.iter_mut().enumerate() {
            for (k, value) in derivatives.iter_mut().enumerate() {
                let (weights, column) = (&kernels.rows[2 - k][place], &columns[k]);
                let mut lanes = [0.0f32; 8];
                for i in 0..8 {
                    lanes[i] = weights[i] * column[i] + weights[8 + i] * column[8 + i];
                }
                *value =
                    ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]));
            }
        }
    }
}
