//! The plausibility test of a homography.

use super::params::GeometryFault;
use crate::geometry::Homography;

/// The identity homography, row-major.
pub const IDENTITY: [f64; 9] = Homography::identity().0;

/// The four corners of a `width` x `height` view after `h`: top left, top right, bottom right, bottom left.
///
/// # Errors
/// When the warped view is not a convex quadrilateral of plausible size (thesis 2.4.3): a side longer
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
    let map = Homography(*h);
    if map.inverse_bounded().is_none() {
        return Err(GeometryFault::Singular { view });
    }
    let (x, y) = ((width - 1) as f64, (height - 1) as f64);
    let corners = [(0.0, 0.0), (x, 0.0), (x, y), (0.0, y)];
    let depth = corners.map(|(x, y)| map.weight([x, y]));
    let (near, far) = depth.iter().fold((f64::MAX, f64::MIN), |(a, b), d| (a.min(*d), b.max(*d)));
    if near * far <= 0.0 || near.abs().min(far.abs()) < 1e-3 * near.abs().max(far.abs()) {
        return Err(GeometryFault::Singular { view });
    }
    let quad: [(f64, f64); 4] = corners.map(|(x, y)| map.map([x, y]).into());
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
