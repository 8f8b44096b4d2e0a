//! Effects between tissue and sensor: drifting smoke, drying blood on the lens.

use panoscope_imaging::{Parallel, SharedMut};

use super::lens::Lens;
use super::math::{Pose, Stream, smoothstep};
use super::noise::Layers;

/// Distance of the smoke from the first camera, mm: near enough to move relative to the tissue.
const SMOKE_MM: f64 = 25.0;
/// Drift of the smoke, mm per second along x and y.
const DRIFT_MM_S: [f64; 2] = [4.0, -6.5];

/// A cloud of smoke.
#[derive(Clone, Debug)]
pub struct Smoke {
    cloud: Layers,
    density: f32,
}

impl Smoke {
    /// Smoke of a mean density from 0 (none) to 1 (nearly opaque).
    pub fn new(seed: u64, density: f32) -> Self {
        Self { cloud: Layers::new(seed, 30, &[(4, 0.7), (8, 0.4), (16, 0.25)]), density }
    }

    /// Density at the corners of a lens's coarse grid, for a camera at `offset_mm` from the first one.
    pub fn fill(
        &self,
        lens: &Lens,
        pose: &Pose,
        offset_mm: [f64; 3],
        seconds: f64,
        pool: &dyn Parallel,
        out: &mut [f32],
    ) {
        const PERIOD_MM: f64 = 64.0;
        let place = |k: usize| pose.translation_mm[k] + offset_mm[k] + DRIFT_MM_S[k] * seconds;
        let start = [place(0) / PERIOD_MM, place(1) / PERIOD_MM].map(|v| (v - v.floor()) as f32);
        let scale = (SMOKE_MM / PERIOD_MM) as f32;
        let out = SharedMut::new(out);
        pool.run(lens.grid_height, &|row| {
            let at = row * lens.grid_padded;
            // SAFETY: each chunk takes its own row.
            let out = unsafe { out.part(at, lens.grid_padded) };
            for (i, out) in out.iter_mut().enumerate() {
                let (x, y) = (lens.corner_x[at + i], lens.corner_y[at + i]);
                let wisp = self.cloud.at(start[0] + x * scale, start[1] + y * scale);
                *out = (self.density * (0.75 + 0.6 * wisp)).clamp(0.0, 0.96);
            }
        });
    }
}

/// Transparency of every pixel (rows of `lens.padded`), 255 = clean, with `count` drops on the lens of a camera.
pub fn drops(lens: &Lens, seed: u64, camera: usize, count: u32) -> Vec<u8> {
    if count == 0 {
        return Vec::new();
    }
    let mut stream = Stream::new(seed, 300 + camera as u32);
    let (width, height) = (lens.padded as f32, lens.height as f32);
    let drops: Vec<[f32; 5]> = (0..count)
        .map(|_| {
            let radius = width * stream.range(0.03, 0.10);
            let (x, y) = (stream.range(0.0, width), stream.range(0.0, height));
            // Drops hang: longer downwards, and a little askew.
            [x, y, radius, stream.range(1.0, 1.7), stream.range(-0.3, 0.3)]
        })
        .collect();
    let clear = |i: usize| {
        let (u, v) = ((i % lens.padded) as f32, (i / lens.padded) as f32);
        let mut clear = 1.0;
        for [x, y, radius, long, lean] in &drops {
            let dy = (v - y) / (radius * long);
            let dx = (u - x) / radius - lean * dy;
            let distance = (dx * dx + dy * dy).sqrt();
            // Out of focus, so the edge is soft; thickest in the middle.
            clear *= 1.0 - 0.9 * smoothstep(1.15, 0.55, distance);
        }
        (clear * 255.0 + 0.5) as u8
    };
    (0..lens.padded * lens.height).map(clear).collect()
}
