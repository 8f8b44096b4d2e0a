//! Symmetric positive definite systems with a narrow band.

use crate::Simd;
use crate::simd::dispatch;

/// Lower half of a symmetric band matrix, column by column: `a[k * (band + 1) + d]` is the element in row `k + d`,
/// column `k`.
#[derive(Clone, Debug, Default)]
pub struct BandMatrix {
    order: usize,
    band: usize,
    a: Vec<f64>,
}

impl BandMatrix {
    /// Sets the order and the number of diagonals below the main one; all elements become 0.
    pub fn reset(&mut self, order: usize, band: usize) {
        (self.order, self.band) = (order, band);
        self.a.clear();
        self.a.resize(order * (band + 1), 0.0);
    }

    /// Copies order, band and elements of another matrix.
    pub fn copy_from(&mut self, other: &Self) {
        (self.order, self.band) = (other.order, other.band);
        self.a.clear();
        self.a.extend_from_slice(&other.a);
    }

    /// Adds to the element in row `i`, column `j`, and to its mirror image. They must lie within the band.
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        let (row, column) = if i >= j { (i, j) } else { (j, i) };
        self.a[column * (self.band + 1) + row - column] += value;
    }

    /// Replaces the matrix by its Cholesky factor. `false` when it is not positive definite; its elements are then
    /// undefined.
    pub fn factor(&mut self, simd: Simd) -> bool {
        let (a, order, band): (&mut [f64], usize, usize) = (&mut self.a, self.order, self.band);
        dispatch!(simd, factor_body(a: &mut [f64], order: usize, band: usize) -> bool)
    }

    /// Solves for both columns of `x` with the factor from [`factor`](Self::factor).
    pub fn solve(&self, x: &mut [[f64; 2]]) {
        let width = self.band + 1;
        for k in 0..self.order {
            let column = &self.a[k * width..(k + 1) * width];
            let here = x[k].map(|v| v / column[0]);
            x[k] = here;
            for (rest, l) in x[k + 1..].iter_mut().zip(&column[1..]) {
                rest[0] -= l * here[0];
                rest[1] -= l * here[1];
            }
        }
        for k in (0..self.order).rev() {
            let column = &self.a[k * width..(k + 1) * width];
            let mut here = x[k];
            for (rest, l) in x[k + 1..].iter().zip(&column[1..]) {
                here[0] -= l * rest[0];
                here[1] -= l * rest[1];
            }
            x[k] = here.map(|v| v / column[0]);
        }
    }
}

/// Right-looking Cholesky: each column is subtracted from those after it, so that the inner loop runs along memory.
#[inline(always)]
fn factor_body(a: &mut [f64], order: usize, band: usize) -> bool {
    let width = band + 1;
    for k in 0..order {
        let (head, tail) = a.split_at_mut((k + 1) * width);
        let column = &mut head[k * width..];
        // NaN is refused too.
        if !(column[0] > 0.0 && column[0].is_finite()) {
            return false;
        }
        let pivot = column[0].sqrt();
        let scale = 1.0 / pivot;
        column.iter_mut().for_each(|v| *v *= scale);
        column[0] = pivot;
        let reach = band.min(order - k - 1);
        for d in 1..=reach {
            let factor = column[d];
            if factor == 0.0 {
                continue;
            }
            let target = &mut tail[(d - 1) * width..(d - 1) * width + reach + 1 - d];
            for (t, c) in target.iter_mut().zip(&column[d..=reach]) {
                *t -= factor * c;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A positive definite band matrix: the bending of a beam, clamped softly.
    fn beam(order: usize, band: usize) -> BandMatrix {
        let mut m = BandMatrix::default();
        m.reset(order, band);
        for k in 0..order {
            m.add(k, k, 0.01 + 0.001 * (k % 7) as f64);
        }
        for k in 1..order - 1 {
            for (i, a) in [(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)] {
                for (j, b) in [(k - 1, 1.0), (k, -2.0), (k + 1, 1.0)] {
                    if i >= j {
                        m.add(i, j, a * b);
                    }
                }
            }
        }
        m
    }

    fn times(m: &BandMatrix, x: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut out = vec![[0.0; 2]; x.len()];
        for k in 0..m.order {
            for d in 0..=m.band.min(m.order - k - 1) {
                let value = m.a[k * (m.band + 1) + d];
                for c in 0..2 {
                    out[k + d][c] += value * x[k][c];
                    if d > 0 {
                        out[k][c] += value * x[k + d][c];
                    }
                }
            }
        }
        out
    }

    #[test]
    fn a_system_is_solved_on_both_paths() {
        for (order, band) in [(50, 2), (61, 5), (3, 2)] {
            let matrix = beam(order, band);
            let x: Vec<[f64; 2]> = (0..order).map(|i| [(i as f64 * 0.3).sin(), i as f64 * 0.1 - 2.0]).collect();
            let mut solved = Vec::new();
            for simd in [Simd::detect(), Simd::portable()] {
                let mut factor = matrix.clone();
                assert!(factor.factor(simd));
                let mut right = times(&matrix, &x);
                factor.solve(&mut right);
                for (a, b) in right.iter().flatten().zip(x.iter().flatten()) {
                    assert!((a - b).abs() < 1e-6, "{order}, {band}: {a} for {b}");
                }
                solved.push(right);
            }
            assert_eq!(solved[0], solved[1], "both paths give the same bits");
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let mut matrix = beam(20, 2);
        matrix.add(10, 10, -9.0);
        assert!(!matrix.factor(Simd::detect()));
        let mut matrix = beam(20, 2);
        matrix.add(10, 10, f64::NAN);
        assert!(!matrix.factor(Simd::detect()));
    }
}
