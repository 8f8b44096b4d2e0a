//! Plain 3x3 arithmetic and the plausibility test of a homography.

use super::params::GeometryFault;

/// The homography that moves nothing.
pub const IDENTITY: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// `a * b`, row-major.
pub fn multiply(a: &[f64; 9], b: &[f64; 9]) -> [f64; 9] {
    std::array::from_fn(|i| (0..3).map(|k| a[i / 3 * 3 + k] * b[k * 3 + i % 3]).sum())
}

/// Image of the point `(x, y)`; not finite where the point lies on the horizon.
pub fn apply(h: &[f64; 9], x: f64, y: f64) -> (f64, f64) {
    let w = h[6] * x + h[7] * y + h[8];
    ((h[0] * x + h[1] * y + h[2]) / w, (h[3] * x + h[4] * y + h[5]) / w)
}

/// Inverse with the largest element scaled to one, or `None` when there is none.
pub fn invert(h: &[f64; 9]) -> Option<[f64; 9]> {
    let scale = h.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if !scale.is_finite() || scale == 0.0 {
        return None;
    }
    let m: [f64; 9] = std::array::from_fn(|i| h[i] / scale);
    let adjugate = [
        m[4] * m[8] - m[5] * m[7],
        m[2] * m[7] - m[1] * m[8],
        m[1] * m[5] - m[2] * m[4],
        m[5] * m[6] - m[3] * m[8],
        m[0] * m[8] - m[2] * m[6],
        m[2] * m[3] - m[0] * m[5],
        m[3] * m[7] - m[4] * m[6],
        m[1] * m[6] - m[0] * m[7],
        m[0] * m[4] - m[1] * m[3],
    ];
    let det = m[0] * adjugate[0] + m[1] * adjugate[3] + m[2] * adjugate[6];
    let size = adjugate.iter().fold(0.0f64, |a, v| a.max(v.abs()));
    // A translation of 1e4 px scales the determinant by 1e-8 and more; below 1e-15 only rounding is left.
    if !det.is_finite() || det.abs() < 1e-15 || size == 0.0 {
        return None;
    }
    Some(std::array::from_fn(|i| adjugate[i] / size * det.signum()))
}

/// The four corners of a `width` x `height` view after `h`: top left, top right, bottom right, bottom left.
///
/// # Errors
/// When the warped view is no convex quadrilateral of plausible size (thesis 2.4.3): a side longer
/// than four times the view's longer side, an area outside 1/8 to 8 times the view's, or a corner
/// further away than eight of its longer sides.
pub fn warped_corners(
    h: &[f64; 9],
    width: usize,
    height: usize,
    view: usize,
) -> Result<[(f64, f64); 4], GeometryFault> {
    if h.iter().any(|v| !v.is_finite()) {
        return Err(GeometryFault::NotFinite { view });
    }
    if invert(h).is_none() {
        return Err(GeometryFault::Singular { view });
    }
    let (x, y) = ((width - 1) as f64, (height - 1) as f64);
    let corners = [(0.0, 0.0), (x, 0.0), (x, y), (0.0, y)];
    let depth = corners.map(|(x, y)| h[6] * x + h[7] * y + h[8]);
    let (near, far) = depth.iter().fold((f64::MAX, f64::MIN), |(a, b), d| (a.min(*d), b.max(*d)));
    if near * far <= 0.0 || near.abs().min(far.abs()) < 1e-3 * near.abs().max(far.abs()) {
        return Err(GeometryFault::Singular { view });
    }
    let quad = corners.map(|(x, y)| apply(h, x, y));
    let longest = x.max(y).max(1.0);
    let mut area = 0.0;
    for i in 0..4 {
        let (a, b, c) = (quad[i], quad[(i + 1) % 4], quad[(i + 2) % 4]);
        if !(a.0.abs() < 8.0 * longest && a.1.abs() < 8.0 * longest) {
            return Err(GeometryFault::Size { view });
        }
        // Pictures have y downwards: a view that is not mirrored keeps a positive turn at each corner.
        let turn = (b.0 - a.0) * (c.1 - b.1) - (b.1 - a.1) * (c.0 - b.0);
        if turn.is_nan() || turn <= 0.0 {
            return Err(GeometryFault::NotConvex { view });
        }
        if (b.0 - a.0).hypot(b.1 - a.1) > 4.0 * longest {
            return Err(GeometryFault::Size { view });
        }
        area += 0.5 * (a.0 * b.1 - b.0 * a.1);
    }
    let ratio = area / (x * y).max(1.0);
    if !(0.125..=8.0).contains(&ratio) {
        return Err(GeometryFault::Size { view });
    }
    Ok(quad)
}
