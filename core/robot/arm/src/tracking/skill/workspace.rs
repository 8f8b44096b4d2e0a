//! The workspace of a tip.

/// Bounding box and spread of positions that are added one at a time.
///
/// The ellipsoid holds 95 % of a normal distribution with the same mean and covariance (7.815 is that quantile of
/// chi-squared with three degrees): a single outlier affects it little but extends the box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Workspace {
    count: f64,
    mean: [f64; 3],
    /// Sums of products of deviations: xx, yy, zz, xy, xz, yz.
    spread: [f64; 6],
    low: [f64; 3],
    high: [f64; 3],
}

impl Default for Workspace {
    fn default() -> Self {
        Self { count: 0.0, mean: [0.0; 3], spread: [0.0; 6], low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] }
    }
}

/// 95 % quantile of chi-squared with three degrees of freedom.
const CHI2_95: f64 = 7.814_727_903_251_179;
/// Index pairs of the entries of `spread`.
const PARTS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

impl Workspace {
    /// Adds a position, mm.
    pub fn add(&mut self, place: [f64; 3]) {
        self.count += 1.0;
        let before: [f64; 3] = std::array::from_fn(|k| place[k] - self.mean[k]);
        (0..3).for_each(|k| self.mean[k] += before[k] / self.count);
        let after: [f64; 3] = std::array::from_fn(|k| place[k] - self.mean[k]);
        for (sum, (i, j)) in self.spread.iter_mut().zip(PARTS) {
            *sum += before[i] * after[j];
        }
        (0..3).for_each(|k| self.low[k] = self.low[k].min(place[k]));
        (0..3).for_each(|k| self.high[k] = self.high[k].max(place[k]));
    }

    /// Sides of the box, mm; NaN without positions.
    pub fn box_mm(&self) -> [f64; 3] {
        if self.count == 0.0 { [f64::NAN; 3] } else { std::array::from_fn(|k| self.high[k] - self.low[k]) }
    }

    /// Volume of the box, cm^3.
    pub fn box_cm3(&self) -> f64 {
        self.box_mm().iter().product::<f64>() * 1e-3
    }

    /// Volume of the ellipsoid, cm^3; 0 for positions in one plane.
    pub fn ellipsoid_cm3(&self) -> f64 {
        if self.count < 2.0 {
            return f64::NAN;
        }
        let [xx, yy, zz, xy, xz, yz] = self.spread.map(|v| v / self.count);
        let det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
        4.0 / 3.0 * std::f64::consts::PI * CHI2_95.powf(1.5) * det.max(0.0).sqrt() * 1e-3
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filled_box_has_its_known_volumes() {
        let (mut space, side) = (Workspace::default(), [20.0, 10.0, 4.0]);
        let n = 40;
        for i in 0..n * n * n {
            let cell = [i % n, i / n % n, i / n / n];
            space.add(std::array::from_fn(|k| 100.0 + side[k] * (cell[k] as f64 / (n - 1) as f64 - 0.5)));
        }
        assert!((space.box_cm3() - 0.8).abs() < 1e-9);
        // Evenly spread values have the deviation side * sqrt((n + 1) / (12 (n - 1))).
        let scale = ((n + 1) as f64 / (12.0 * (n - 1) as f64)).powf(1.5);
        let want = 4.0 / 3.0 * std::f64::consts::PI * 7.814_727_9f64.powf(1.5) * 0.8 * scale;
        assert!((space.ellipsoid_cm3() / want - 1.0).abs() < 1e-6, "{} {want}", space.ellipsoid_cm3());
        assert!(Workspace::default().box_cm3().is_nan());
    }
}
