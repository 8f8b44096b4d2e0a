//! Statistics of measured values.

/// The finite values.
pub fn finite(values: &[f64]) -> impl Iterator<Item = f64> + '_ {
    values.iter().copied().filter(|v| v.is_finite())
}

/// Mean of the finite values; NaN if there are none.
pub fn mean(values: &[f64]) -> f64 {
    let count = finite(values).count();
    if count == 0 { f64::NAN } else { finite(values).sum::<f64>() / count as f64 }
}

/// Root mean square of the finite values; NaN if there are none.
pub fn rms(values: &[f64]) -> f64 {
    mean(&values.iter().map(|v| v * v).collect::<Vec<_>>()).sqrt()
}

/// The finite value with this share of the others below it, 0.5 for the median; NaN if there are none. The median of an
/// even number of values is the larger of the middle two.
pub fn percentile(values: &[f64], share: f64) -> f64 {
    let mut sorted: Vec<f64> = finite(values).collect();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    sorted.get((last as f64 * share).round() as usize).copied().unwrap_or(f64::NAN)
}

/// Slope and offset of the least-squares line through `(x, y)` points; zeros for fewer than two different `x`.
pub fn line(points: &[(f64, f64)]) -> (f64, f64) {
    let n = points.len() as f64;
    let (sx, sy) = points.iter().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x, sy + y));
    let (mx, my) = (sx / n, sy / n);
    let spread: f64 = points.iter().map(|(x, _)| (x - mx).powi(2)).sum();
    if spread == 0.0 || !spread.is_finite() {
        return (0.0, 0.0);
    }
    let slope = points.iter().map(|(x, y)| (x - mx) * (y - my)).sum::<f64>() / spread;
    (slope, my - slope * mx)
}

/// Share of the variance of `y` that the line explains, 0 to 1.
pub fn r_squared(points: &[(f64, f64)]) -> f64 {
    let (slope, offset) = line(points);
    let mean = points.iter().map(|(_, y)| y).sum::<f64>() / points.len() as f64;
    let total: f64 = points.iter().map(|(_, y)| (y - mean).powi(2)).sum();
    let rest: f64 = points.iter().map(|(x, y)| (y - slope * x - offset).powi(2)).sum();
    if total > 0.0 { 1.0 - rest / total } else { 1.0 }
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_line_is_found() {
        let points: Vec<(f64, f64)> = [1.0, 2.0, 4.0, 8.0].iter().map(|&x| (x, 3.0 * x + 5.0)).collect();
        let (slope, offset) = super::line(&points);
        assert!((slope - 3.0).abs() < 1e-12 && (offset - 5.0).abs() < 1e-12);
        assert!(super::r_squared(&points) > 0.999_999);
        assert_eq!(super::line(&[(1.0, 7.0)]), (0.0, 0.0));
    }

    #[test]
    fn a_percentile_is_one_of_the_finite_values() {
        let values = [4.0, f64::NAN, 1.0, 3.0, 2.0];
        assert_eq!([0.0, 0.5, 0.99].map(|share| super::percentile(&values, share)), [1.0, 3.0, 4.0]);
        assert!(super::percentile(&[], 0.5).is_nan());
    }
}
