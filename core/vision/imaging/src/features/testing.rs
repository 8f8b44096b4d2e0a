//! Scenes for the tests of this folder.

use crate::geometry::Homography;
use panoscope_base::random::lattice;

/// Smooth noise of several periods, 0..=255: a scene without borders.
pub(crate) fn noise(x: f64, y: f64) -> f64 {
    let mut sum = 128.0;
    for (seed, (period, height)) in [(7.0, 70.0), (15.0, 60.0), (40.0, 60.0)].into_iter().enumerate() {
        let (u, v) = (x / period, y / period);
        let (column, row) = (u.floor(), v.floor());
        let ease = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let (fx, fy) = (ease(u - column), ease(v - row));
        let at = |dx: i64, dy: i64| lattice(column as i64 + dx, row as i64 + dy, seed as u64) - 0.5;
        let top = at(0, 0) + (at(1, 0) - at(0, 0)) * fx;
        let bottom = at(0, 1) + (at(1, 1) - at(0, 1)) * fx;
        sum += height * 1.5 * (top + (bottom - top) * fy);
    }
    sum.clamp(0.0, 255.0)
}

/// The image of a camera whose pixels `scene_from_image` maps into the scene.
pub(crate) fn render(width: usize, height: usize, scene_from_image: &Homography) -> Vec<u8> {
    let mut image = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let [sx, sy] = scene_from_image.map([x as f64, y as f64]);
            image.push(noise(sx, sy).round() as u8);
        }
    }
    image
}

/// Gaussian blobs `(x, y, sigma, height)` on mid gray.
pub(crate) fn blobs(width: usize, height: usize, blobs: &[(f64, f64, f64, f64)]) -> Vec<u8> {
    let mut image = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let value: f64 = blobs
                .iter()
                .map(|&(bx, by, sigma, tall)| {
                    let squared = (x as f64 - bx).powi(2) + (y as f64 - by).powi(2);
                    tall * (-squared / (2.0 * sigma * sigma)).exp()
                })
                .sum();
            image.push((128.0 + value).round().clamp(0.0, 255.0) as u8);
        }
    }
    image
}

/// Turn by `angle` and enlarge by `scale` around `(cx, cy)`, then move.
pub(crate) fn similarity(angle: f64, scale: f64, cx: f64, cy: f64, dx: f64, dy: f64) -> Homography {
    let (sin, cos) = angle.sin_cos();
    let turn = Homography([scale * cos, -scale * sin, 0.0, scale * sin, scale * cos, 0.0, 0.0, 0.0, 1.0]);
    Homography::translation(cx + dx, cy + dy).compose(&turn).compose(&Homography::translation(-cx, -cy))
}

/// Largest distance between the corners of a frame under two maps, in pixels.
pub(crate) fn corner_error(a: &Homography, b: &Homography, width: usize, height: usize) -> f64 {
    match (a.map_corners(width, height), b.map_corners(width, height)) {
        (Some(a), Some(b)) => a.iter().zip(&b).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).fold(0.0, f64::max),
        _ => f64::INFINITY,
    }
}
