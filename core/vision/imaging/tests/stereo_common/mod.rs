//! Shared by the stereo tests: textures, and data that may be absent.
#![allow(dead_code)]

use panoscope_imaging::{View, ViewMut};
use std::path::PathBuf;

/// A well-mixed number for each (x, y): the same at every call.
pub fn hash(x: i64, y: i64) -> u64 {
    let mut z = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (y as u64).wrapping_mul(0xd1b5_4a32_d192_ed03);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Smooth texture, 0..=255, at a position that need not be whole.
pub fn texture(x: f64, y: f64) -> f64 {
    let (x0, y0) = (x.floor(), y.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (fx, fy) = (smooth(x - x0), smooth(y - y0));
    let at = |i: i64, j: i64| (hash(x0 as i64 + i, y0 as i64 + j) % 256) as f64;
    let upper = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
    let lower = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
    upper * (1.0 - fy) + lower * fy
}

/// A left and a right view of a surface whose disparity at the left pixel (x, y) is `plane[0] + plane[1] x + plane[2]
/// y`.
pub fn plane_pair(width: usize, height: usize, plane: [f64; 3]) -> (Vec<u8>, Vec<u8>) {
    let mut left = Vec::with_capacity(width * height);
    let mut right = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let (x, y) = (x as f64, y as f64);
            left.push(texture(x / 3.0, y / 3.0).round() as u8);
            // The left pixel that lands on this right one.
            let source = (x + plane[0] + plane[2] * y) / (1.0 - plane[1]);
            right.push(texture(source / 3.0, y / 3.0).round() as u8);
        }
    }
    (left, right)
}

/// BGR from gray.
pub fn to_bgr(gray: &[u8]) -> Vec<u8> {
    gray.iter().flat_map(|value| [*value; 3]).collect()
}

pub fn gray(data: &[u8], width: usize, height: usize) -> View<'_, u8> {
    View::new(data, width, height, 1)
}

pub fn plane(data: &[f32], width: usize, height: usize) -> View<'_, f32> {
    View::new(data, width, height, 1)
}

pub fn plane_mut(data: &mut [f32], width: usize, height: usize) -> ViewMut<'_, f32> {
    ViewMut::new(data, width, height, 1)
}

/// Equal to the last bit, NaN equal to NaN.
pub fn same_bits(a: &[f32], b: &[f32]) -> bool {
    let key = |value: &f32| if value.is_nan() { u32::MAX } else { value.to_bits() };
    a.len() == b.len() && a.iter().map(key).eq(b.iter().map(key))
}

/// A file of the `shared` folder beside the repository, or a notice and `None`.
pub fn shared(path: &str) -> Option<PathBuf> {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../../shared").join(path);
    if file.exists() {
        return Some(file);
    }
    panoscope_testing::skipped!("shared/{path} is not there");
    None
}
