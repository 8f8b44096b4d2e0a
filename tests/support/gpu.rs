//! A GPU for tests and benches of kernels: the device, images there, pictures, comparison. Tests include this file as a module.

#![allow(dead_code, reason = "each test uses a part of it")]

use std::sync::OnceLock;
use std::time::Instant;

use panoscope_gpu::CHOICE;
use panoscope_node::abi;
use panoscope_node::device::{DeviceImage, Gpu, MARGIN_BYTES, Steps, Store};

/// The table of the device that `PANOSCOPE_GPU` names, else of the one that the processor plays; `None`, reported as a
/// skip, without one.
pub fn table() -> Option<&'static abi::Device> {
    static TABLE: OnceLock<Option<&'static abi::Device>> = OnceLock::new();
    *TABLE.get_or_init(|| {
        let choice = std::env::var(CHOICE).ok().filter(|choice| !choice.is_empty());
        match panoscope_gpu::Gpu::open(Some(choice.as_deref().unwrap_or("software"))) {
            Ok(gpu) => Some(gpu.into_table()),
            Err(e) => {
                panoscope_testing::skipped!("{e}; install mesa-vulkan-drivers for a device that the processor plays");
                None
            }
        }
    })
}

/// The device of [`table`].
pub fn device() -> Option<Gpu> {
    table().map(Gpu::of)
}

/// An image on the device.
pub struct Held {
    pub image: DeviceImage,
    _store: Store,
}

impl Held {
    /// An image of `channels` bytes per pixel with unspecified content.
    pub fn new(gpu: Gpu, width: usize, height: usize, channels: usize) -> Self {
        Self::with_stride(gpu, width, height, DeviceImage::stride_bytes(width, channels))
    }

    fn with_stride(gpu: Gpu, width: usize, height: usize, stride_bytes: usize) -> Self {
        let mut store = Store::default();
        let buffer = store.reserve(gpu, stride_bytes * height + MARGIN_BYTES).expect("a buffer");
        Self { image: DeviceImage { buffer, width, height, stride_bytes }, _store: store }
    }

    /// The rows of an image.
    pub fn of(gpu: Gpu, rows: &[u8], width: usize, height: usize, stride_bytes: usize) -> Self {
        let held = Self::with_stride(gpu, width, height, stride_bytes);
        let mut steps = Steps::default();
        steps.write(held.image.buffer, 0, rows);
        gpu.submit(&steps).expect("written");
        held
    }

    /// Its rows, `bytes` bytes of each.
    pub fn rows(&self, gpu: Gpu, bytes: usize) -> Vec<u8> {
        let DeviceImage { buffer, height, stride_bytes, .. } = self.image;
        let mut all = vec![0; stride_bytes * height];
        gpu.read(buffer, &mut all).expect("read");
        all.chunks_exact(stride_bytes).flat_map(|row| &row[..bytes]).copied().collect()
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

/// Rounds of a bench.
const ROUNDS: usize = 30;

/// Waves and blocks: edges at all scales.
pub fn waves((width, height): (usize, usize), shift: usize) -> Vec<u8> {
    let at = |x: usize, y: usize| {
        let (u, v) = ((x + shift) as f64, y as f64);
        let wave = 40.0 * (0.021 * u + 0.3 * (0.013 * v).sin()).sin() + 25.0 * (0.11 * v + 0.017 * u).sin();
        let block = ((u / 23.0).floor() as i64 * 7919 + (v / 19.0).floor() as i64 * 104_729).rem_euclid(41) as f64;
        [100.0, 90.0, 150.0].map(|c| (c + wave + block).clamp(0.0, 255.0) as u8)
    };
    (0..height).flat_map(|y| (0..width).flat_map(move |x| at(x, y))).collect()
}

/// Medians of two ways to do the same, by turns, ms.
pub fn beside(mut first: impl FnMut(), mut second: impl FnMut()) -> [f64; 2] {
    let mut times = [Vec::new(), Vec::new()];
    for round in 0..ROUNDS + 3 {
        for (way, times) in times.iter_mut().enumerate() {
            let start = Instant::now();
            if way == 0 {
                first()
            } else {
                second()
            }
            // The first rounds fill caches and make memory.
            if round >= 3 {
                times.push(start.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
    times.map(|mut times| {
        times.sort_unstable_by(f64::total_cmp);
        times[times.len() / 2]
    })
}

pub fn print(name: &str, size: (usize, usize), [cpu, gpu]: [f64; 2]) {
    println!("{name:<32} {:>4}x{:<4} {cpu:9.2} ms {gpu:9.2} ms {:7.2}", size.0, size.1, cpu / gpu);
}

/// Room for an image on the GPU.
pub fn image(gpu: Gpu, store: &mut Store, (width, height): (usize, usize), channels: usize) -> DeviceImage {
    let stride_bytes = DeviceImage::stride_bytes(width, channels);
    let buffer = store.reserve(gpu, stride_bytes * height + MARGIN_BYTES).expect("a buffer");
    DeviceImage { buffer, width, height, stride_bytes }
}

/// Copies pictures, whose rows have no padding, to the GPU.
pub fn upload(gpu: Gpu, images: &[DeviceImage; 2], pictures: &[Vec<u8>; 2]) {
    let mut steps = Steps::default();
    images.iter().zip(pictures).for_each(|(image, picture)| steps.write(image.buffer, 0, picture));
    gpu.submit(&steps).expect("written");
}

/// Calls `bench` with the device that `PANOSCOPE_GPU` names, for each size that holds a word among the arguments.
pub fn bench_sizes(bench: impl Fn(Gpu, (usize, usize))) {
    let choice = std::env::var(CHOICE).ok();
    let gpu = match panoscope_gpu::Gpu::open(choice.as_deref()) {
        Ok(gpu) => Gpu::of(gpu.into_table()),
        Err(e) => return panoscope_testing::skipped!("{e}"),
    };
    println!("{}\n{:<32} {:>9} {:>12} {:>12} {:>7}", gpu.name(), "", "views", "processor", "GPU", "times");
    for size in [(640, 480), (1920, 1080), (3840, 2160)] {
        let case = format!("{}x{}", size.0, size.1);
        if !std::env::args().skip(1).any(|word| !word.starts_with("--") && !case.contains(&word)) {
            bench(gpu, size);
        }
    }
}
