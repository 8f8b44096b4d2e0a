//! Value noise smoothed by cubic B-splines: periodic, twice differentiable, cheap to evaluate in rows.

use super::math::{hash, unit};
use super::table::Table;

/// Weights of the four lattice values around a point `u` in `0..1` between the middle two.
#[inline(always)]
pub fn bspline(u: f32) -> [f32; 4] {
    let v = 1.0 - u;
    let sixth = 1.0 / 6.0;
    let (u2, v2) = (u * u, v * v);
    [v2 * v * sixth, (4.0 - 6.0 * u2 + 3.0 * u2 * u) * sixth, (4.0 - 6.0 * v2 + 3.0 * v2 * v) * sixth, u2 * u * sixth]
}

/// One octave of noise, periodic over `cells` lattice steps in both directions; values in about -1..1.
#[derive(Clone, Debug)]
pub struct Octave {
    lattice: Table<f32>,
    cells: usize,
}

impl Octave {
    /// An octave with `cells` (a power of two) steps per period.
    pub fn new(seed: u64, purpose: u32, cells: usize) -> Self {
        assert!(cells.is_power_of_two());
        let words = [seed as u32, (seed >> 32) as u32, purpose];
        let key = hash(&words);
        // The spline averages its lattice: 2.2 brings the spread back to about that of the lattice.
        let value = |i: usize| (unit(hash(&[key, i as u32])) * 2.0 - 1.0) * 2.2;
        Self { lattice: (0..cells * cells).map(value).collect(), cells }
    }

    /// The noise at `(x, y)`, in periods.
    pub fn at(&self, x: f32, y: f32) -> f32 {
        let (gx, gy) = (x * self.cells as f32, y * self.cells as f32);
        let (fx, fy) = (gx.floor(), gy.floor());
        let (wx, wy) = (bspline(gx - fx), bspline(gy - fy));
        let (ix, iy) = (fx as i32 as usize, fy as i32 as usize);
        let mask = self.cells - 1;
        let mut sum = 0.0;
        for (j, &wy) in wy.iter().enumerate() {
            let row = &self.lattice[(iy.wrapping_add(j).wrapping_sub(1) & mask) * self.cells..][..self.cells];
            let mut line = 0.0;
            for (i, &wx) in wx.iter().enumerate() {
                line += wx * row[ix.wrapping_add(i).wrapping_sub(1) & mask];
            }
            sum += wy * line;
        }
        sum
    }

    /// Adds `gain` times the noise to one row `y` of a map of `out.len()` texels per period (a multiple of `cells`).
    #[inline(always)]
    pub fn add_row(&self, y: usize, gain: f32, out: &mut [f32], scratch: &mut Vec<f32>) {
        let step = out.len() / self.cells;
        assert_eq!(step * self.cells, out.len());
        let mask = self.cells - 1;
        let wy = bspline((y % step) as f32 / step as f32).map(|w| w * gain);
        let iy = y / step;
        let line = |j: usize| &self.lattice[(iy.wrapping_add(j).wrapping_sub(1) & mask) * self.cells..][..self.cells];
        let (l0, l1, l2, l3) = (line(0), line(1), line(2), line(3));
        scratch.clear();
        scratch.extend((0..self.cells).map(|i| wy[0] * l0[i] + wy[1] * l1[i] + wy[2] * l2[i] + wy[3] * l3[i]));
        if step == 1 {
            let sixth = 1.0 / 6.0;
            for i in 0..self.cells {
                let (a, b, c) = (scratch[i.wrapping_sub(1) & mask], scratch[i], scratch[(i + 1) & mask]);
                out[i] += (a + 4.0 * b + c) * sixth;
            }
            return;
        }
        for (i, cell) in out.chunks_exact_mut(step).enumerate() {
            let at = |k: usize| scratch[i.wrapping_add(k).wrapping_sub(1) & mask];
            let (a, b, c, d) = (at(0), at(1), at(2), at(3));
            // The spline as a polynomial of the place in the cell.
            let c0 = (a + 4.0 * b + c) * (1.0 / 6.0);
            let c1 = (c - a) * 0.5;
            let c2 = (a - 2.0 * b + c) * 0.5;
            let c3 = (d - 3.0 * c + 3.0 * b - a) * (1.0 / 6.0);
            let inv = 1.0 / step as f32;
            for (k, value) in cell.iter_mut().enumerate() {
                let u = k as f32 * inv;
                *value += c0 + u * (c1 + u * (c2 + u * c3));
            }
        }
    }
}

/// A sum of octaves evaluated at points.
#[derive(Clone, Debug)]
pub struct Layers(Vec<(Octave, f32)>);

impl Layers {
    /// Octaves given as `(cells per period, gain)`.
    pub fn new(seed: u64, purpose: u32, octaves: &[(usize, f32)]) -> Self {
        let layer = |(i, &(cells, gain)): (usize, &(usize, f32))| {
            (Octave::new(seed, purpose.wrapping_mul(64).wrapping_add(i as u32), cells), gain)
        };
        Self(octaves.iter().enumerate().map(layer).collect())
    }

    /// The sum at `(x, y)`, in periods.
    pub fn at(&self, x: f32, y: f32) -> f32 {
        self.0.iter().fold(0.0, |sum, (octave, gain)| sum + gain * octave.at(x, y))
    }

    /// The sums of row `y` of a map of `out.len()` texels per period.
    #[inline(always)]
    pub fn fill_row(&self, y: usize, out: &mut [f32], scratch: &mut Vec<f32>) {
        out.fill(0.0);
        for (octave, gain) in &self.0 {
            octave.add_row(y, *gain, out, scratch);
        }
    }
}
