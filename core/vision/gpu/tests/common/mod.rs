//! What the tests share: the device, pictures, comparison.

use std::sync::Arc;

use panoscope_gpu::{CHOICE, Gpu};

/// The device that `PANOSCOPE_GPU` names, else the one that the processor plays; `None`, reported as a skip, without
/// one.
pub fn device() -> Option<Arc<Gpu>> {
    let choice = std::env::var(CHOICE).ok().filter(|choice| !choice.is_empty());
    match Gpu::open(Some(choice.as_deref().unwrap_or("software"))) {
        Ok(gpu) => Some(Arc::new(gpu)),
        Err(e) => {
            panoscope_testing::skipped!("{e}; install mesa-vulkan-drivers for a device that the processor plays");
            None
        }
    }
}

/// Smooth colours with fine noise, `stride` bytes per row.
pub fn picture(width: usize, height: usize, stride: usize, seed: u32) -> Vec<u8> {
    let mut data = vec![0; stride * height];
    for (y, row) in data.chunks_exact_mut(stride).enumerate() {
        for x in 0..width {
            for c in 0..3 {
                let wave = ((x as f32 + seed as f32 * 13.0) / (17.0 + c as f32)).sin() * (y as f32 / 23.0).cos();
                let hash = (x as u32).wrapping_mul(73_856_093)
                    ^ (y as u32).wrapping_mul(19_349_663)
                    ^ (c as u32).wrapping_mul(83_492_791)
                    ^ seed;
                let noise = (hash.wrapping_mul(0x9e37_79b9) >> 24) as f32 / 8.0;
                row[3 * x + c] = (110.0 + 70.0 * wave + noise).clamp(0.0, 255.0) as u8;
            }
        }
    }
    data
}

/// Largest difference of two pictures, and the share of bytes that differ.
pub fn difference(a: &[u8], b: &[u8]) -> (u8, f64) {
    assert_eq!(a.len(), b.len());
    let differences = a.iter().zip(b).map(|(a, b)| a.abs_diff(*b));
    let unequal = differences.clone().filter(|d| *d > 0).count();
    (differences.max().unwrap_or(0), unequal as f64 / a.len() as f64)
}
