//! What a camera and an operation do to a picture: blur, smoke, exposure, noise, bytes.

use panoscope_base::Parallel;
use panoscope_base::random::{lattice, nth};

use super::SyntheticView;
use super::disturbance::Disturbance;
use super::render::Rendered;
use super::rows::fill_rows;

/// Light of smoke, levels.
const SMOKE_LEVEL: f32 = 185.0;
/// Disparity of the smoke, px.
const SMOKE_PX: f64 = 130.0;

/// Turns light into pictures.
pub fn develop(views: [Rendered; 2], disturbance: Disturbance, seed: u64, pool: &dyn Parallel) -> [SyntheticView; 2] {
    let mut sides = [false, true].into_iter();
    views.map(|Rendered { size, bgr: mut light, disparity, visible }| {
        let is_right = sides.next().unwrap_or_default();
        // Highlights burn out before the lens blurs them, as the sensor's wells do not overflow.
        blur(&mut light, size, disturbance.blur_px(is_right), pool);
        let (gain, black) = disturbance.exposure(is_right);
        let noise = disturbance.noise();
        let salt = seed.wrapping_mul(2).wrapping_add(u64::from(is_right)) ^ 0x5e7;
        let mut bgr = vec![0; light.len()];
        for (index, (out, light)) in bgr.iter_mut().zip(&light).enumerate() {
            let smoke =
                if disturbance == Disturbance::Smoke { thickness(index / 3, size.0, is_right, seed) } else { 0.0 };
            let light = light * (1.0 - smoke) + SMOKE_LEVEL * smoke;
            *out = (gain * light + black + noise * gaussian(salt, index as u64)).round().clamp(0.0, 255.0) as u8;
        }
        SyntheticView { size, bgr, disparity, visible }
    })
}

/// Nearly normal noise of standard deviation 1: the sum of four even numbers.
fn gaussian(seed: u64, index: u64) -> f32 {
    let bits = nth(seed, index);
    let sum: u32 = (0..4).map(|part| (bits >> (16 * part)) as u32 & 0xffff).sum();
    (sum as f32 / 65_535.0 - 2.0) * 1.732
}

/// Part of the light that smoke takes, 0.1 to 0.75.
fn thickness(pixel: usize, width: usize, is_right: bool, seed: u64) -> f32 {
    const CELL_PX: f64 = 90.0;
    let shift = if is_right { SMOKE_PX } else { 0.0 };
    let (x, y) = (((pixel % width) as f64 + shift) / CELL_PX, (pixel / width) as f64 / CELL_PX);
    let (i, j) = (x.floor(), y.floor());
    let fade = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (fade(x - i), fade(y - j));
    let at = |di: i64, dj: i64| lattice(i as i64 + di, j as i64 + dj, seed ^ 0x5304e);
    let above = at(0, 0) * (1.0 - u) + at(1, 0) * u;
    let below = at(0, 1) * (1.0 - u) + at(1, 1) * u;
    (0.1 + 0.65 * (above * (1.0 - v) + below * v)) as f32
}

/// Blurs interleaved BGR light with a Gaussian.
fn blur(light: &mut [f32], (width, height): (usize, usize), sigma_px: f32, pool: &dyn Parallel) {
    let radius = (3.0 * sigma_px).ceil() as usize;
    let weights: Vec<f32> = (0..=radius).map(|step| (-0.5 * (step as f32 / sigma_px).powi(2)).exp()).collect();
    let total: f32 = weights[0] + 2.0 * weights[1..].iter().sum::<f32>();
    let mut rows = vec![0.0f32; light.len()];
    let line = 3 * width;
    let source: &[f32] = light;
    fill_rows(&mut rows, line, pool, |y, out| {
        let row = &source[y * line..(y + 1) * line];
        for (at, out) in out.iter_mut().enumerate() {
            let (x, channel) = (at / 3, at % 3);
            let pixel = |x: usize| row[3 * x + channel];
            let sides = (1..=radius).map(|r| weights[r] * (pixel(x.saturating_sub(r)) + pixel((x + r).min(width - 1))));
            *out = (weights[0] * pixel(x) + sides.sum::<f32>()) / total;
        }
    });
    fill_rows(light, line, pool, |y, out| {
        for (at, out) in out.iter_mut().enumerate() {
            let pixel = |y: usize| rows[y * line + at];
            let sides =
                (1..=radius).map(|r| weights[r] * (pixel(y.saturating_sub(r)) + pixel((y + r).min(height - 1))));
            *out = (weights[0] * pixel(y) + sides.sum::<f32>()) / total;
        }
    });
}
