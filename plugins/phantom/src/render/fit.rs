//! Least-squares homography of exact correspondences.

/// The plane homography that best fits the true correspondences of the shared field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneFit {
    /// `left_from_right`, row by row; the last number is 1.
    pub left_from_right: [f64; 9],
    /// Root mean square of the distance between mapped and true position, px.
    pub rms_px: f64,
    /// Correspondences used.
    pub points: usize,
}

/// Fits `left_from_right` to rows `[u_right, v_right, u_left, v_left]`: a linear solution with normalised
/// coordinates (Hartley and Zisserman, section 4.4), then Gauss-Newton steps on the distance in the left view.
pub(super) fn homography(pairs: &[[f64; 4]]) -> Option<PlaneFit> {
    if pairs.len() < 16 {
        return None;
    }
    let count = pairs.len() as f64;
    let mean: [f64; 4] = std::array::from_fn(|k| pairs.iter().map(|p| p[k]).sum::<f64>() / count);
    let spread = |a: usize| {
        let square =
            |p: &[f64; 4]| (p[a] - mean[a]) * (p[a] - mean[a]) + (p[a + 1] - mean[a + 1]) * (p[a + 1] - mean[a + 1]);
        (pairs.iter().map(square).sum::<f64>() / (2.0 * count)).sqrt().max(1e-9)
    };
    let (from, to) = (spread(0), spread(2));
    let normal =
        |p: &[f64; 4]| [(p[0] - mean[0]) / from, (p[1] - mean[1]) / from, (p[2] - mean[2]) / to, (p[3] - mean[3]) / to];
    let mut h = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
    for round in 0..12 {
        let mut system = [[0.0; 9]; 8];
        for pair in pairs {
            let [x, y, u, v] = normal(pair);
            let w = h[6] * x + h[7] * y + 1.0;
            let (mu, mv) = ((h[0] * x + h[1] * y + h[2]) / w, (h[3] * x + h[4] * y + h[5]) / w);
            let (ju, jv, eu, ev) = if round == 0 {
                // Linear in h: u * w = first row.
                let ju = [x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y];
                (ju, [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y], u, v)
            } else {
                let ju = [x / w, y / w, 1.0 / w, 0.0, 0.0, 0.0, -mu * x / w, -mu * y / w];
                (ju, [0.0, 0.0, 0.0, x / w, y / w, 1.0 / w, -mv * x / w, -mv * y / w], u - mu, v - mv)
            };
            for i in 0..8 {
                for j in 0..8 {
                    system[i][j] += ju[i] * ju[j] + jv[i] * jv[j];
                }
                system[i][8] += ju[i] * eu + jv[i] * ev;
            }
        }
        let step = solve(system)?;
        let mut moved: f64 = 0.0;
        for (h, step) in h.iter_mut().zip(step) {
            *h = if round == 0 { step } else { *h + step };
            moved = moved.max(step.abs());
        }
        if round > 0 && moved < 1e-13 {
            break;
        }
    }
    // Back to pixels: left = T_left^-1 * h * T_right.
    let n = [h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0];
    let column = |r: usize| {
        let (a, b) = (n[3 * r] / from, n[3 * r + 1] / from);
        [a, b, n[3 * r + 2] - a * mean[0] - b * mean[1]]
    };
    let (a, b, c) = (column(0), column(1), column(2));
    let mut matrix = [0.0; 9];
    for k in 0..3 {
        matrix[k] = to * a[k] + mean[2] * c[k];
        matrix[3 + k] = to * b[k] + mean[3] * c[k];
        matrix[6 + k] = c[k];
    }
    let scale = matrix[8];
    if scale.abs() < 1e-12 {
        return None;
    }
    matrix.iter_mut().for_each(|m| *m /= scale);
    let square = |p: &[f64; 4]| {
        let w = matrix[6] * p[0] + matrix[7] * p[1] + matrix[8];
        let du = (matrix[0] * p[0] + matrix[1] * p[1] + matrix[2]) / w - p[2];
        let dv = (matrix[3] * p[0] + matrix[4] * p[1] + matrix[5]) / w - p[3];
        du * du + dv * dv
    };
    let rms_px = (pairs.iter().map(square).sum::<f64>() / count).sqrt();
    Some(PlaneFit { left_from_right: matrix, rms_px, points: pairs.len() })
}

/// Gauss elimination with pivots.
fn solve(mut m: [[f64; 9]; 8]) -> Option<[f64; 8]> {
    for k in 0..8 {
        let pivot = (k..8).max_by(|&a, &b| m[a][k].abs().total_cmp(&m[b][k].abs()))?;
        if m[pivot][k].abs() < 1e-12 {
            return None;
        }
        m.swap(k, pivot);
        for row in 0..8 {
            if row != k {
                let factor = m[row][k] / m[k][k];
                for column in k..9 {
                    m[row][column] -= factor * m[k][column];
                }
            }
        }
    }
    Some(std::array::from_fn(|i| m[i][8] / m[i][i]))
}
