//! Small dense solvers, and a robust mean.

/// Solves `a x = b` for a symmetric positive definite `a` by Cholesky; `None` when it is not.
pub(crate) fn solve_symmetric<const N: usize>(a: &[[f64; N]; N], b: &[f64; N]) -> Option<[f64; N]> {
    solve_regular(a, b, 0.0)
}

/// As [`solve_symmetric`]; also `None` where a pivot is at most `min_pivot` of its element of the diagonal.
pub(crate) fn solve_regular<const N: usize>(a: &[[f64; N]; N], b: &[f64; N], min_pivot: f64) -> Option<[f64; N]> {
    let mut lower = [[0.0f64; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let mut sum = a[i][j];
            for k in 0..j {
                sum -= lower[i][k] * lower[j][k];
            }
            if i == j {
                let positive = sum > min_pivot * a[i][i] && sum.is_finite();
                if !positive {
                    return None;
                }
                lower[i][i] = sum.sqrt();
            } else {
                lower[i][j] = sum / lower[j][j];
            }
        }
    }
    let mut x = *b;
    for i in 0..N {
        for k in 0..i {
            x[i] -= lower[i][k] * x[k];
        }
        x[i] /= lower[i][i];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            x[i] -= lower[k][i] * x[k];
        }
        x[i] /= lower[i][i];
    }
    x.iter().all(|value| value.is_finite()).then_some(x)
}

/// The upper median of the values, which are reordered; 0 without any.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Eigenvector of the smallest eigenvalue of a symmetric matrix (cyclic Jacobi rotations).
///
/// `None` when the matrix is not finite or its second smallest eigenvalue is as good as zero too, which
/// leaves the direction open.
pub(crate) fn jacobi_smallest<const N: usize>(a: &mut [[f64; N]; N]) -> Option<[f64; N]> {
    let mut vectors = [[0.0f64; N]; N];
    for (i, row) in vectors.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    let total: f64 = a.iter().flatten().map(|value| value * value).sum();
    if !total.is_finite() {
        return None;
    }
    for _ in 0..30 {
        let off: f64 = (0..N).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i][j] * a[i][j]).sum();
        if off <= total * 1e-30 {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let t = if theta == 0.0 { 1.0 } else { t };
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for k in 0..N {
                    let (kp, kq) = (a[k][p], a[k][q]);
                    a[k][p] = c * kp - s * kq;
                    a[k][q] = s * kp + c * kq;
                }
                for k in 0..N {
                    let (pk, qk) = (a[p][k], a[q][k]);
                    a[p][k] = c * pk - s * qk;
                    a[q][k] = s * pk + c * qk;
                }
                for row in &mut vectors {
                    let (kp, kq) = (row[p], row[q]);
                    row[p] = c * kp - s * kq;
                    row[q] = s * kp + c * kq;
                }
            }
        }
    }
    let mut smallest = 0;
    for i in 1..N {
        if a[i][i] < a[smallest][smallest] {
            smallest = i;
        }
    }
    let second = (0..N).filter(|&i| i != smallest).map(|i| a[i][i]).fold(f64::INFINITY, f64::min);
    let unique = second > total.sqrt() * 1e-10;
    if !unique {
        return None;
    }
    Some(std::array::from_fn(|i| vectors[i][smallest]))
}
