//! Distances, depths and angles of surface points, each with the error that is to be expected (thesis, figs 3.14 and 3.15).

use super::SurfacePoint;

/// What is not known exactly about a rig and its matching; standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Of a filtered disparity, beside the scatter around the point, px.
    pub disparity_px: f64,
    /// Of the calibration's disparity offset, px; its reprojection error is used when larger.
    pub offset_px: f64,
    /// Of the calibration's baseline, mm.
    pub baseline_mm: f64,
    /// Of the calibration's focal length, percent.
    pub focal_percent: f64,
}

impl Noise {
    /// A carefully calibrated rig.
    pub const USUAL: Self = Self { disparity_px: 0.15, offset_px: 0.05, baseline_mm: 0.05, focal_percent: 0.1 };
}

/// Errors that every measurement inherits; standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Of one point's inverse depth, beside the scatter around it, in 1/mm.
    pub inverse_depth: f64,
    /// Of the inverse depth of a point that nothing speaks for, in 1/mm: it falls with the confidence, to nothing for full confidence.
    pub doubtful_inverse_depth: f64,
    /// Of all inverse depths alike (the calibration's disparity offset), in 1/mm.
    pub common_inverse_depth: f64,
    /// Of all lengths alike (baseline), relative.
    pub scale: f64,
    /// Of all depths against widths (focal length), relative.
    pub depth_scale: f64,
}

impl Errors {
    /// Of rectified views with this focal length and baseline. `rms_px` is the calibration's reprojection error, NaN when unknown.
    pub fn of(focal_px: f64, baseline_mm: f64, rms_px: f64, noise: &Noise) -> Self {
        let inverse_depth_per_px = 1.0 / (focal_px * baseline_mm);
        Self {
            inverse_depth: noise.disparity_px * inverse_depth_per_px,
            doubtful_inverse_depth: DOUBTFUL_PX * inverse_depth_per_px,
            // `max` drops NaN.
            common_inverse_depth: noise.offset_px.max(rms_px) * inverse_depth_per_px,
            scale: noise.baseline_mm / baseline_mm,
            depth_scale: noise.focal_percent / 100.0,
        }
    }
}

/// Standard deviation of a disparity without confidence, px: under smoke and blood whole patches are matched wrongly, and a filter smooths them.
const DOUBTFUL_PX: f64 = 12.0;
/// It falls with the third power of what is missing to full confidence, times this. On the synthetic pairs for tuning 95 % of the depths with a confidence
/// under 0.4 lie within 23 px, at 0.5 within 12, at 0.7 within 1.7 px.
const DOUBT_SLOPE: f64 = 4.0;

/// How many standard deviations are stated: 95 % of true errors lie within.
const STATED_DEVIATIONS: f64 = 2.0;

/// Maximum number of points of one measured item.
pub const MAX_POINTS: usize = 3;

fn between(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [b[0] - a[0], b[1] - a[1], b[2] - a[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Depth of the first of one or more points, mm.
pub fn depth(points: &[[f64; 3]]) -> f64 {
    points[0][2]
}

/// Distance of the first two of two or more points, mm.
pub fn distance(points: &[[f64; 3]]) -> f64 {
    let line = between(points[0], points[1]);
    dot(line, line).sqrt()
}

/// Angle at the second of three points, degrees; NaN when two coincide.
pub fn angle(points: &[[f64; 3]]) -> f64 {
    let (a, b) = (between(points[1], points[0]), between(points[1], points[2]));
    let cosine = dot(a, b) / (dot(a, a) * dot(b, b)).sqrt();
    cosine.clamp(-1.0, 1.0).acos().to_degrees()
}

/// `measure` of the points and its stated error: every cause is tried alone, the changes add up as squares.
/// The error is NaN when `errors` is `None`.
pub fn with_error(points: &[SurfacePoint], errors: Option<&Errors>, measure: fn(&[[f64; 3]]) -> f64) -> (f64, f64) {
    let count = points.len().min(MAX_POINTS);
    let mut places = [[0.0; 3]; MAX_POINTS];
    for (place, point) in places.iter_mut().zip(points) {
        *place = point.xyz_mm(0.0);
    }
    let value = measure(&places[..count]);
    let Some(errors) = errors else { return (value, f64::NAN) };
    let mut squares = 0.0;
    let mut add = |changed: &[[f64; 3]; MAX_POINTS]| squares += (measure(&changed[..count]) - value).powi(2);
    for (index, point) in points[..count].iter().enumerate() {
        let mut changed = places;
        let doubt = errors.doubtful_inverse_depth * (DOUBT_SLOPE * (1.0 - point.confidence).powi(3)).min(1.0);
        changed[index] = point.xyz_mm(point.scatter.hypot(errors.inverse_depth).hypot(doubt));
        add(&changed);
    }
    let mut changed = places;
    for (place, point) in changed.iter_mut().zip(points) {
        *place = point.xyz_mm(errors.common_inverse_depth);
    }
    add(&changed);
    add(&places.map(|place| place.map(|part| part * (1.0 + errors.scale))));
    add(&places.map(|[x, y, z]| [x, y, z * (1.0 + errors.depth_scale)]));
    (value, STATED_DEVIATIONS * squares.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_grows_as_the_confidence_falls() {
        let errors = Errors::of(750.0, 15.0, f64::NAN, &Noise::USUAL);
        let stated = |confidence: f32| {
            let point = |x: f64, z_mm: f64| SurfacePoint {
                ray: [x, 0.0],
                inverse_depth: 1.0 / z_mm,
                scatter: 1e-5,
                confidence: 1.0,
            };
            let ends = [point(-0.1, 50.0).trusted(confidence), point(0.1, 65.0)];
            with_error(&ends, Some(&errors), distance).1
        };
        let [full, half, none, unknown] = [1.0, 0.5, 0.0, f32::NAN].map(stated);
        assert!(full == unknown && full < 1.0, "{full} mm, {unknown} mm");
        assert!(half > 2.0 * full && none > 1.5 * half, "{full}, {half}, {none} mm");
        assert!(stated(0.95) < 1.05 * full, "a good match is as good as before");
    }
}
