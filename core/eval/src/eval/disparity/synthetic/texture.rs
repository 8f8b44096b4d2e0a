//! Textures as functions of the surface point.

use panoscope_base::random::lattice;

use super::camera::{BASELINE_MM, Point};

/// Families of textures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Texture {
    /// Noise with detail at all scales.
    Fractal,
    /// Thin dark curves on a nearly even ground.
    Vessels,
    /// Hardly any texture.
    Faint,
    /// Long parallel fibres.
    Fibres,
    /// Curves on noise of middle contrast.
    Tissue,
    /// Brushed metal.
    Metal,
    /// Gray grains.
    Asphalt,
    /// Smooth dark paint with a faint reflection.
    DarkPaint,
    /// The same, so bright that parts of it burn out.
    BrightPaint,
    /// Nearly black glass.
    Glass,
}

/// How a layer looks.
#[derive(Clone, Copy, Debug)]
pub struct Material {
    /// Its texture.
    pub texture: Texture,
    /// Of its texture.
    pub seed: u64,
    /// Covered by stains of blood that hide the texture.
    pub blood: bool,
    /// Wet: mirrors the light.
    pub wet: bool,
}

/// Shortest wavelength, in pixels, that a texture shows: shorter ones would alias.
const MIN_WAVE_PX: f64 = 2.0;

/// Smooth noise of about unit wavelength, -1 to 1.
fn noise(x: f64, y: f64, seed: u64) -> f64 {
    let (cell_x, cell_y) = (x.floor(), y.floor());
    let fade = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let (u, v) = (fade(x - cell_x), fade(y - cell_y));
    let (i, j) = (cell_x as i64, cell_y as i64);
    let at = |i, j| lattice(i, j, seed);
    let above = at(i, j) * (1.0 - u) + at(i + 1, j) * u;
    let below = at(i, j + 1) * (1.0 - u) + at(i + 1, j + 1) * u;
    2.0 * (above * (1.0 - v) + below * v) - 1.0
}

/// Part of a wave's contrast that pixels of this size keep.
fn kept(wave_mm: f64, pixel_mm: f64) -> f64 {
    (wave_mm / (MIN_WAVE_PX * pixel_mm) - 1.0).clamp(0.0, 1.0)
}

/// Sum of noises of wavelengths `wave_mm`, half of it, and so on.
fn octaves((x, y): (f64, f64), wave_mm: f64, count: u32, gain: f64, pixel_mm: f64, seed: u64) -> f64 {
    let (mut sum, mut weight, mut wave) = (0.0, 1.0, wave_mm);
    for octave in 0..count {
        let kept = kept(wave, pixel_mm);
        if kept <= 0.0 {
            break;
        }
        sum += weight * kept * noise(x / wave, y / wave, seed.wrapping_add(u64::from(octave) << 32));
        weight *= gain;
        wave *= 0.5;
    }
    sum
}

/// 1 on curves, 0 between them.
fn curves((x, y): (f64, f64), wave_mm: f64, half_width_mm: f64, seed: u64) -> f64 {
    let bent = 0.35 * noise(2.7 * x / wave_mm, 2.7 * y / wave_mm, seed ^ 0x51);
    let value = (noise(x / wave_mm + bent, y / wave_mm - bent, seed) * wave_mm / 2.5).abs();
    (1.0 - value / half_width_mm).clamp(0.0, 1.0)
}

/// Blue, green and red levels of a point as the camera at `eye_x_mm` sees it.
pub fn colour(material: &Material, point: &Point, eye_x_mm: f64) -> [f64; 3] {
    let [x, y, z] = point.xyz_mm;
    let (at, px, seed) = ((x, y), point.pixel_mm, material.seed);
    let red_tissue = |level: f64, vessel: f64| {
        [level * 0.62 - 22.0 * vessel, level * 0.66 - 40.0 * vessel, level * 1.15 - 34.0 * vessel]
    };
    let gray = |level: f64| [level, level * 0.99, level * 0.98];
    let mut bgr = match material.texture {
        Texture::Fractal => red_tissue(118.0 + 46.0 * octaves(at, 6.0, 7, 0.72, px, seed), 0.0),
        Texture::Vessels => {
            let vessel = curves(at, 9.0, 0.32, seed).max(0.8 * curves(at, 3.6, 0.13, seed ^ 7));
            red_tissue(128.0 + 5.0 * octaves(at, 5.0, 5, 0.7, px, seed), vessel)
        }
        Texture::Faint => red_tissue(130.0 + 4.5 * octaves(at, 4.0, 5, 0.75, px, seed), 0.0),
        Texture::Fibres => {
            let turn = 0.6 * noise(x / 30.0, y / 30.0, seed ^ 3);
            let (sine, cosine) = (turn + (seed % 7) as f64).sin_cos();
            let (s, t) = (x * cosine + y * sine, y * cosine - x * sine);
            let fine =
                kept(0.5, px) * noise(s / 0.5, t / 7.0, seed) + kept(1.3, px) * noise(s / 1.3, t / 12.0, seed ^ 9);
            red_tissue(122.0 + 26.0 * fine, 0.0)
        }
        Texture::Tissue => {
            let vessel = curves(at, 8.0, 0.3, seed).max(0.7 * curves(at, 3.0, 0.12, seed ^ 7));
            red_tissue(122.0 + 17.0 * octaves(at, 5.0, 6, 0.7, px, seed), vessel)
        }
        Texture::Metal => {
            let level = 105.0 + 12.0 * octaves((x, y * 0.3), 2.0, 5, 0.75, px, seed);
            [level, level * 0.98, level * 0.95]
        }
        Texture::Asphalt => gray(120.0 + 34.0 * octaves(at, 4.0, 6, 0.85, px, seed)),
        Texture::DarkPaint => gray(34.0 + 2.0 * octaves(at, 5.0, 6, 0.5, px, seed)),
        Texture::BrightPaint => gray(235.0 + 18.0 * octaves(at, 5.0, 6, 0.5, px, seed)),
        Texture::Glass => gray(9.0 + 5.0 * octaves(at, 4.0, 5, 0.5, px, seed)),
    };
    if material.blood {
        let cover = (4.0 * (noise(x / 9.0, y / 9.0, seed ^ 0xb1) + 0.35 * noise(x / 2.5, y / 2.5, seed ^ 0xb2) + 0.12))
            .clamp(0.0, 1.0);
        let blood = [16.0, 12.0, 62.0];
        for (value, blood) in bgr.iter_mut().zip(blood) {
            // A film of blood lets a little of the texture below through.
            *value = *value * (1.0 - 0.93 * cover) + blood * cover;
        }
    }
    // The lamp stands beside the cameras: light falls off with distance and slant, alike for both.
    let lamp = [0.5 * BASELINE_MM, -4.0, 0.0];
    let unit = |v: [f64; 3]| {
        let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt().max(1e-9);
        v.map(|part| part / length)
    };
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let to_lamp = unit([lamp[0] - x, lamp[1] - y, -z]);
    let slant = dot(to_lamp, point.normal).max(0.0);
    let light = (0.45 + 0.65 * slant) * (60.0 / z).powf(0.3).clamp(0.6, 1.35);
    let mut shine = 0.0;
    if material.wet {
        // Small bumps turn the normal; what is mirrored moves with the eye.
        let bump = |salt| 0.16 * octaves(at, 3.0, 3, 0.5, px, seed ^ salt);
        let normal = unit([point.normal[0] + bump(0xc1), point.normal[1] + bump(0xc2), point.normal[2]]);
        let to_eye = unit([eye_x_mm - x, -y, -z]);
        let half = unit([to_lamp[0] + to_eye[0], to_lamp[1] + to_eye[1], to_lamp[2] + to_eye[2]]);
        shine = 320.0 * dot(normal, half).max(0.0).powi(90);
    }
    bgr.map(|value| (value.max(0.0) * light + shine).min(400.0))
}
