//! Sparse symmetric systems: Cholesky within the envelope of each row (A. George, J. Liu, "Computer Solution of Large
//! Sparse Positive Definite Systems", 1981, chapter 4).

/// A symmetric positive definite matrix whose rows store the columns from the first entry to the diagonal.
#[derive(Clone, Debug, Default)]
pub(super) struct Skyline {
    first: Vec<usize>,
    /// Position of row `i`'s column 0 in `values`; entries before `first[i]` belong to other rows.
    base: Vec<isize>,
    values: Vec<f64>,
}

impl Skyline {
    /// Sets the shape, row `i` beginning at column `first(i) <= i`, and all entries to zero. Memory is reused.
    pub fn reset(&mut self, rows: usize, first: impl Fn(usize) -> usize) {
        self.first.clear();
        self.base.clear();
        let mut end = 0usize;
        for row in 0..rows {
            let begin = first(row).min(row);
            self.first.push(begin);
            self.base.push(end as isize - begin as isize);
            end += row - begin + 1;
        }
        self.values.clear();
        self.values.resize(end, 0.0);
    }

    /// Copies another's shape and entries.
    pub fn copy_from(&mut self, other: &Self) {
        self.first.clone_from(&other.first);
        self.base.clone_from(&other.base);
        self.values.clone_from(&other.values);
    }

    /// Adds to an entry on or below the diagonal.
    ///
    /// # Panics
    /// When the entry lies outside the row's envelope.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        assert!(column <= row && column >= self.first[row], "entry {row}, {column} outside the envelope");
        self.values[(self.base[row] + column as isize) as usize] += value;
    }

    /// The entry of the diagonal.
    pub fn diagonal(&self, row: usize) -> f64 {
        self.values[(self.base[row] + row as isize) as usize]
    }

    fn row(&self, row: usize, from: usize, end: usize) -> &[f64] {
        let base = self.base[row];
        &self.values[(base + from as isize) as usize..(base + end as isize) as usize]
    }

    /// Replaces the matrix by its Cholesky factor and `right` by the solution; false when it is not positive definite.
    #[must_use]
    pub fn solve(&mut self, right: &mut [f64]) -> bool {
        let rows = self.first.len();
        for i in 0..rows {
            let begin = self.first[i];
            for j in begin..=i {
                let from = begin.max(self.first[j]);
                let sum = dot(self.row(i, from, j.max(from)), self.row(j, from, j.max(from)));
                let at = (self.base[i] + j as isize) as usize;
                let rest = self.values[at] - sum;
                if i == j {
                    let is_positive = rest > 0.0 && rest.is_finite();
                    if !is_positive {
                        return false;
                    }
                    self.values[at] = rest.sqrt();
                } else {
                    self.values[at] = rest / self.diagonal(j);
                }
            }
        }
        for i in 0..rows {
            let begin = self.first[i];
            let sum = dot(self.row(i, begin, i), &right[begin..i]);
            right[i] = (right[i] - sum) / self.diagonal(i);
        }
        for i in (0..rows).rev() {
            right[i] /= self.diagonal(i);
            let (value, begin) = (right[i], self.first[i]);
            for (x, l) in right[begin..i].iter_mut().zip(self.row(i, begin, i)) {
                *x -= l * value;
            }
        }
        right[..rows].iter().all(|value| value.is_finite())
    }
}

/// Dot product with four partial sums, in an order that does not depend on the machine.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a4, a_rest) = a.as_chunks::<4>();
    let (b4, b_rest) = b.as_chunks::<4>();
    let mut sums = [0.0f64; 4];
    for (a, b) in a4.iter().zip(b4) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_with_a_far_edge_is_solved() {
        // Laplacian of a ring of 40 plus a tenth of the identity.
        const N: usize = 40;
        let entry = |i: usize, j: usize| -> f64 {
            if i == j {
                2.1
            } else if (i + 1) % N == j || (j + 1) % N == i {
                -1.0
            } else {
                0.0
            }
        };
        let mut matrix = Skyline::default();
        matrix.reset(N, |i| if i == N - 1 { 0 } else { i.saturating_sub(1) });
        for i in 0..N {
            for j in 0..=i {
                if entry(i, j) != 0.0 {
                    matrix.add(i, j, entry(i, j));
                }
            }
        }
        let truth: Vec<f64> = (0..N).map(|i| ((i * 37) % 11) as f64 - 5.0).collect();
        let mut right: Vec<f64> = (0..N).map(|i| (0..N).map(|j| entry(i, j) * truth[j]).sum()).collect();
        assert!(matrix.solve(&mut right));
        for (x, y) in right.iter().zip(&truth) {
            assert!((x - y).abs() < 1e-10, "{x} {y}");
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        let mut matrix = Skyline::default();
        matrix.reset(2, |_| 0);
        matrix.add(0, 0, 1.0);
        matrix.add(1, 0, 2.0);
        matrix.add(1, 1, 1.0);
        assert!(!matrix.solve(&mut [1.0, 1.0]));
    }
}
