//! Linear algebra of the bilateral solver: preconditioned conjugate gradients over grid vertices.
//!
//! Loops run over fixed chunks whose partial sums are added in order, so the number of threads never
//! shows in the result. Neighbours are gathered from planes that are already scaled, so that one pass
//! over the vertices multiplies, and sums the product, at once.

use crate::stereo::bilateral_grid::BilateralGrid;
use crate::{Parallel, SharedMut};

/// Vertices of one chunk.
const CHUNK: usize = 8192;
/// Rounds that make the blur bistochastic. What is left over goes into the diagonal, so that constants
/// stay smooth exactly and few rounds suffice.
const BALANCE_ROUNDS: usize = 4;
/// Rounds of blur over which support is looked for.
const SUPPORT_ROUNDS: usize = 2;
/// Weight of a vertex in its own blur: two for each of three axes.
const SELF_WEIGHT: f32 = 6.0;

/// Planes over vertices; entry 0 stands for "no vertex" and stays 0.
#[derive(Debug, Default)]
pub(crate) struct GridSolver {
    /// Scale that balances the blur.
    scale: Vec<f32>,
    /// Plane whose neighbours are gathered.
    gathered: Vec<f32>,
    diagonal: Vec<f32>,
    inverse: Vec<f32>,
    /// Solution per vertex.
    pub x: Vec<f32>,
    residual: Vec<f32>,
    direction: Vec<f32>,
    image: Vec<f32>,
    /// Mean confidence around each vertex.
    pub support: Vec<f32>,
    partial: Vec<f64>,
}

/// Runs `body` over chunks of the vertices `1..len`; it returns a partial sum, and all are added in order.
fn over(
    len: usize,
    partial: &mut Vec<f64>,
    pool: &dyn Parallel,
    body: &(dyn Fn(std::ops::Range<usize>) -> f64 + Sync),
) -> f64 {
    let chunks = len.div_ceil(CHUNK);
    partial.clear();
    partial.resize(chunks, 0.0);
    let shared = SharedMut::new(partial);
    pool.run(chunks, &|chunk| {
        let sum = body((chunk * CHUNK).max(1)..((chunk + 1) * CHUNK).min(len));
        // SAFETY: one entry per chunk.
        unsafe { shared.part(chunk, 1)[0] = sum };
    });
    partial.iter().sum()
}

/// Four running sums: their additions overlap, and their order is fixed.
#[derive(Default)]
struct Sums([f64; 4]);

impl Sums {
    #[inline(always)]
    fn add(&mut self, index: usize, value: f32) {
        self.0[index & 3] += f64::from(value);
    }

    fn total(&self) -> f64 {
        (self.0[0] + self.0[1]) + (self.0[2] + self.0[3])
    }
}

impl GridSolver {
    /// Makes room for `len` vertices.
    pub fn resize(&mut self, len: usize) {
        let planes = [
            &mut self.scale,
            &mut self.gathered,
            &mut self.diagonal,
            &mut self.inverse,
            &mut self.x,
            &mut self.residual,
            &mut self.direction,
            &mut self.image,
            &mut self.support,
        ];
        for plane in planes {
            plane.resize(len, 0.0);
            plane[0] = 0.0;
        }
    }

    /// Finds the scale such that the blur between scaled vertices has the masses as its row sums.
    pub fn balance(&mut self, grid: &BilateralGrid, pool: &dyn Parallel) {
        let len = grid.len();
        self.scale[1..].fill(1.0);
        for _ in 0..BALANCE_ROUNDS {
            let (scale, mass) = (&self.scale, &grid.mass);
            let next = SharedMut::new(&mut self.gathered);
            over(len, &mut self.partial, pool, &|range| {
                // SAFETY: chunks do not overlap; planes are as long as the grid.
                let part = unsafe { next.part(range.start, range.len()) };
                for (out, v) in part.iter_mut().zip(range) {
                    // SAFETY: `v < len`, and `scale` is as long as the grid.
                    let blurred = SELF_WEIGHT * scale[v] + unsafe { grid.around(scale, v) };
                    *out = (scale[v] * mass[v] / blurred).sqrt();
                }
                0.0
            });
            std::mem::swap(&mut self.scale, &mut self.gathered);
        }
    }

    /// Solves; `limits` are the smoothness weight, the most steps and the relative residual to stop at.
    /// `start` holds the last frame's solution by dense cell. Returns the steps taken.
    pub fn solve(
        &mut self,
        grid: &BilateralGrid,
        limits: (f32, usize, f32),
        start: Option<&[f32]>,
        pool: &dyn Parallel,
    ) -> usize {
        let (lambda, max_steps, tolerance) = limits;
        let right = self.set_up(grid, lambda, start, pool);
        let mut energy = self.first_residual(grid, lambda, pool);
        let enough = f64::from(tolerance).powi(2) * right;
        let mut steps = 0;
        // Written so that NaN stops too.
        while steps < max_steps && energy > enough {
            let curvature = self.multiply(grid, lambda, pool);
            if !(curvature > 0.0 && curvature.is_finite()) {
                break;
            }
            let next = self.advance((energy / curvature) as f32, pool);
            self.turn((next / energy) as f32, pool);
            energy = next;
            steps += 1;
        }
        steps
    }

    /// Diagonal, preconditioner and start; returns the size of the right-hand side.
    fn set_up(&mut self, grid: &BilateralGrid, lambda: f32, start: Option<&[f32]>, pool: &dyn Parallel) -> f64 {
        let len = grid.len();
        let (mut confidence, mut weighted) = (Sums::default(), Sums::default());
        for v in 1..len {
            confidence.add(v, grid.confidence[v]);
            weighted.add(v, grid.weighted[v]);
        }
        let mean = if confidence.total() > 0.0 { (weighted.total() / confidence.total()) as f32 } else { 0.0 };
        let scale = &self.scale;
        let (diagonal, inverse) = (SharedMut::new(&mut self.diagonal), SharedMut::new(&mut self.inverse));
        let (x, gathered) = (SharedMut::new(&mut self.x), SharedMut::new(&mut self.gathered));
        over(len, &mut self.partial, pool, &|range| {
            let (from, n) = (range.start, range.len());
            // SAFETY: chunks do not overlap.
            let (diagonal, inverse, x, gathered) =
                unsafe { (diagonal.part(from, n), inverse.part(from, n), x.part(from, n), gathered.part(from, n)) };
            let mut right = Sums::default();
            for (i, v) in range.enumerate() {
                let (scale_v, confidence) = (scale[v], grid.confidence[v]);
                // SAFETY: `v < len`; planes are as long as the grid.
                let row = scale_v * (SELF_WEIGHT * scale_v + unsafe { grid.around(scale, v) });
                diagonal[i] = lambda * row + confidence;
                inverse[i] = 1.0 / (diagonal[i] - lambda * SELF_WEIGHT * scale_v * scale_v).max(1e-5);
                let before = start.map_or(f32::NAN, |last| last[grid.cell_of_vertex[v] as usize]);
                x[i] = if before.is_finite() {
                    before
                } else if confidence > 1e-3 {
                    grid.weighted[v] / confidence
                } else {
                    mean
                };
                gathered[i] = scale_v * x[i];
                right.add(i, grid.weighted[v] * grid.weighted[v] * inverse[i]);
            }
            right.total()
        })
    }

    /// Residual and first direction; returns the preconditioned energy.
    fn first_residual(&mut self, grid: &BilateralGrid, lambda: f32, pool: &dyn Parallel) -> f64 {
        let len = grid.len();
        let (scale, gathered, diagonal, inverse, x) =
            (&self.scale, &self.gathered, &self.diagonal, &self.inverse, &self.x);
        let (residual, direction) = (SharedMut::new(&mut self.residual), SharedMut::new(&mut self.direction));
        let energy = over(len, &mut self.partial, pool, &|range| {
            let (from, n) = (range.start, range.len());
            // SAFETY: chunks do not overlap.
            let (residual, direction) = unsafe { (residual.part(from, n), direction.part(from, n)) };
            let mut energy = Sums::default();
            for (i, v) in range.enumerate() {
                // SAFETY: `v < len`; planes are as long as the grid.
                let blurred = SELF_WEIGHT * gathered[v] + unsafe { grid.around(gathered, v) };
                residual[i] = grid.weighted[v] - (diagonal[v] * x[v] - lambda * scale[v] * blurred);
                direction[i] = residual[i] * inverse[v];
                energy.add(i, residual[i] * direction[i]);
            }
            energy.total()
        });
        for ((gathered, scale), direction) in self.gathered.iter_mut().zip(&self.scale).zip(&self.direction) {
            *gathered = scale * direction;
        }
        energy
    }

    /// `image = A direction`; returns `direction . image`.
    fn multiply(&mut self, grid: &BilateralGrid, lambda: f32, pool: &dyn Parallel) -> f64 {
        let len = grid.len();
        let (scale, gathered, diagonal, direction) =
            (&self.scale[..len], &self.gathered[..len], &self.diagonal[..len], &self.direction[..len]);
        let image = SharedMut::new(&mut self.image);
        over(len, &mut self.partial, pool, &|range| {
            // SAFETY: chunks do not overlap.
            let image = unsafe { image.part(range.start, range.len()) };
            let mut curvature = Sums::default();
            for (i, v) in range.enumerate() {
                // SAFETY: `v < len`; planes are as long as the grid.
                let blurred = SELF_WEIGHT * gathered[v] + unsafe { grid.around(gathered, v) };
                image[i] = diagonal[v] * direction[v] - lambda * scale[v] * blurred;
                curvature.add(i, direction[v] * image[i]);
            }
            curvature.total()
        })
    }

    /// Moves the solution and the residual by `step`; returns the new preconditioned energy.
    fn advance(&mut self, step: f32, pool: &dyn Parallel) -> f64 {
        let len = self.x.len();
        let (direction, image, inverse) = (&self.direction, &self.image, &self.inverse);
        let (x, residual) = (SharedMut::new(&mut self.x), SharedMut::new(&mut self.residual));
        over(len, &mut self.partial, pool, &|range| {
            let n = range.len();
            // SAFETY: chunks do not overlap.
            let (x, residual) = unsafe { (x.part(range.start, n), residual.part(range.start, n)) };
            let (direction, image, inverse) =
                (&direction[range.clone()][..n], &image[range.clone()][..n], &inverse[range][..n]);
            let mut energy = Sums::default();
            for i in 0..n {
                x[i] += step * direction[i];
                residual[i] -= step * image[i];
                energy.add(i, residual[i] * residual[i] * inverse[i]);
            }
            energy.total()
        })
    }

    /// The next direction, and the plane to gather from.
    fn turn(&mut self, keep: f32, pool: &dyn Parallel) {
        let len = self.x.len();
        let (residual, inverse, scale) = (&self.residual, &self.inverse, &self.scale);
        let (direction, gathered) = (SharedMut::new(&mut self.direction), SharedMut::new(&mut self.gathered));
        over(len, &mut self.partial, pool, &|range| {
            let n = range.len();
            // SAFETY: chunks do not overlap.
            let (direction, gathered) = unsafe { (direction.part(range.start, n), gathered.part(range.start, n)) };
            let (residual, inverse, scale) =
                (&residual[range.clone()][..n], &inverse[range.clone()][..n], &scale[range][..n]);
            for i in 0..n {
                direction[i] = residual[i] * inverse[i] + keep * direction[i];
                gathered[i] = scale[i] * direction[i];
            }
            0.0
        });
    }

    /// Mean confidence of the pixels a few cells around each vertex.
    pub fn spread_support(&mut self, grid: &BilateralGrid, pool: &dyn Parallel) {
        let len = grid.len();
        // Planes that the solve no longer needs carry confidence (`image`) and pixels (`residual`).
        self.image.copy_from_slice(&grid.confidence);
        self.residual.copy_from_slice(&grid.mass);
        for _ in 0..SUPPORT_ROUNDS {
            let (image, residual) = (&self.image, &self.residual);
            let (next_image, next_residual) = (SharedMut::new(&mut self.gathered), SharedMut::new(&mut self.direction));
            over(len, &mut self.partial, pool, &|range| {
                let n = range.len();
                // SAFETY: chunks do not overlap.
                let (next_image, next_residual) =
                    unsafe { (next_image.part(range.start, n), next_residual.part(range.start, n)) };
                for (i, v) in range.enumerate() {
                    // SAFETY: `v < len`; planes are as long as the grid.
                    let (a, b) = unsafe { (grid.around(image, v), grid.around(residual, v)) };
                    next_image[i] = SELF_WEIGHT * image[v] + a;
                    next_residual[i] = SELF_WEIGHT * residual[v] + b;
                }
                0.0
            });
            std::mem::swap(&mut self.image, &mut self.gathered);
            std::mem::swap(&mut self.residual, &mut self.direction);
        }
        for ((support, confidence), mass) in self.support.iter_mut().zip(&self.image).zip(&self.residual).skip(1) {
            *support = (confidence / mass.max(1e-6)).min(1.0);
        }
        self.support[0] = 0.0;
    }
}
