//! Pairs with known disparity and the cameras that would see them.

use panoscope_node::abi::{Calibration, Camera};

/// Width and height of the test pictures.
pub const SIZE: (usize, usize) = (320, 128);

fn hash(x: i64, y: i64) -> f64 {
    let mut h = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (y as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
    h = (h ^ (h >> 31)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (h >> 40) as f64 / (1u64 << 24) as f64
}

/// Smooth random texture of several sizes, never twice the same.
pub fn texture(x: f64, y: f64) -> f64 {
    let layer = |cell: f64| {
        let (x, y) = (x / cell, y / cell);
        let (i, j) = (x.floor(), y.floor());
        let (a, b) = (x - i, y - j);
        let at = |di: i64, dj: i64| hash(i as i64 + di + (cell * 1000.0) as i64, j as i64 + dj);
        let (top, low) = (at(0, 0) * (1.0 - a) + at(1, 0) * a, at(0, 1) * (1.0 - a) + at(1, 1) * a);
        top * (1.0 - b) + low * b
    };
    30.0 + 80.0 * layer(5.0) + 60.0 * layer(11.0) + 50.0 * layer(30.0)
}

/// Left and right gray views of a surface with disparity `disparity(x_right, y)`; the right one `dy` rows lower.
pub fn pair(disparity: impl Fn(f64, f64) -> f64, dy: f64) -> (Vec<u8>, Vec<u8>) {
    let (width, height) = SIZE;
    let mut left = vec![0; width * height];
    let mut right = vec![0; width * height];
    for y in 0..height {
        for x in 0..width {
            let (u, v) = (x as f64, y as f64);
            // Disparity belongs to the left view's pixel.
            left[y * width + x] = texture(u, v) as u8;
            let mut from = u + disparity(u, v);
            for _ in 0..20 {
                from = u + disparity(from, v);
            }
            right[y * width + x] = texture(from, v - dy) as u8;
        }
    }
    (left, right)
}

/// As BGR, each channel the gray value.
pub fn bgr(gray: &[u8]) -> Vec<u8> {
    gray.iter().flat_map(|value| [*value; 3]).collect()
}

/// Rectified pinhole cameras of the test pictures.
pub fn rectified(focal: f64, baseline_mm: f64) -> Calibration {
    let (width, height) = SIZE;
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    let camera =
        Camera { width: width as u32, height: height as u32, fx: focal, fy: focal, cx, cy, distortion: [0.0; 14] };
    let eye = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = |tx: f64| [focal, 0.0, cx, tx, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    Calibration {
        left: camera,
        right: camera,
        right_from_left_rotation: eye,
        right_from_left_mm: [-baseline_mm, 0.0, 0.0],
        rectified_from_left: eye,
        rectified_from_right: eye,
        left_projection: projection(0.0),
        right_projection: projection(-focal * baseline_mm),
        baseline_mm,
        rms_px: f64::NAN,
        is_rectified: 1,
        stated_error: 0,
    }
}

/// Median of the finite numbers; NaN when there are none.
pub fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.filter(|value| value.is_finite()).collect();
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f32::NAN)
}
