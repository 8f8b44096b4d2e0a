//! Kernels against the limits of the machine, on one thread: bytes that they read and write, operations, and the share
//! of what memory and vector units can do. Prints a table for `core/vision/imaging/README.md`.

use panoscope_base::gray::bgr_to_gray;
use panoscope_imaging::fit::Fit;
use panoscope_imaging::shrink::shrink;
use panoscope_imaging::stereo::{
    BlockMatcher, BlockMatchingParams, CameraModel, FilterInput, Rectification, RectifyParams, RemapTable,
    ReprojectInput, ReprojectParams, StereoCameras, WlsFilter, WlsParams, reproject,
};
use panoscope_imaging::{Rect, Serial, View, ViewMut};
use std::hint::black_box;
use std::time::{Duration, Instant};

/// How long each kernel is repeated.
const LENGTH: Duration = Duration::from_millis(400);
const DISPARITIES: usize = 64;

/// Shortest time of a call, s.
fn shortest(mut body: impl FnMut()) -> f64 {
    body();
    let begun = Instant::now();
    let mut least = f64::INFINITY;
    while begun.elapsed() < LENGTH {
        let start = Instant::now();
        body();
        least = least.min(start.elapsed().as_secs_f64());
    }
    least
}

/// Bytes per second of a copy of `len` bytes, read and written.
fn copying(len: usize) -> f64 {
    let (from, mut to) = (vec![1u8; len], vec![0u8; len]);
    2.0 * len as f64 / shortest(|| black_box(&mut to).copy_from_slice(black_box(&from)))
}

/// Saturating 16-bit additions per second.
fn additions() -> f64 {
    const ROUNDS: usize = 100_000;
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        #[target_feature(enable = "avx2")]
        fn run(step: i16) {
            use std::arch::x86_64::*;
            let step = _mm256_set1_epi16(step);
            // As many chains as hide the latency.
            let mut sums = [step; 8];
            for _ in 0..ROUNDS {
                for sum in &mut sums {
                    *sum = _mm256_adds_epi16(*sum, step);
                }
            }
            black_box(sums);
        }
        // SAFETY: the processor has AVX2.
        return (ROUNDS * 8 * 16) as f64 / shortest(|| unsafe { run(black_box(1)) });
    }
    let mut sums = [0i16; 64];
    (ROUNDS * 64) as f64
        / shortest(|| {
            for _ in 0..ROUNDS {
                black_box(&mut sums).iter_mut().for_each(|sum| *sum = sum.saturating_add(1));
            }
        })
}

struct Limits {
    memory: f64,
    cache: f64,
    additions: f64,
}

struct Row<'a> {
    name: &'a str,
    seconds: f64,
    /// Bytes of the pictures and maps that are read and written, each once.
    bytes: usize,
    /// Operations on 16-bit numbers, where they can be counted.
    operations: Option<usize>,
}

fn print(row: &Row<'_>, limits: &Limits) {
    let rate = row.bytes as f64 / row.seconds;
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let (operations, share) = row.operations.map_or((String::new(), String::new()), |count| {
        let rate = count as f64 / row.seconds;
        (format!("{:.1}", rate / 1e9), percent(rate / limits.additions))
    });
    println!(
        "| {} | {:.3} | {:.2} | {:.1} | {} | {} | {operations} | {share} |",
        row.name,
        1e3 * row.seconds,
        row.bytes as f64 / 1e6,
        rate / 1e9,
        percent(rate / limits.memory),
        percent(rate / limits.cache),
    );
}

fn texture(x: f64, y: f64) -> u8 {
    let waves = [(0.11, 0.07, 40.0), (0.31, -0.23, 30.0), (0.05, 0.41, 25.0), (0.83, 0.57, 18.0), (1.9, 1.3, 10.0)];
    let sum: f64 = waves.iter().map(|(u, v, size)| size * (u * x + v * y + (0.03 * x * v).sin() * 3.0).sin()).sum();
    (128.0 + sum).clamp(0.0, 255.0) as u8
}

fn kernels((width, height): (usize, usize), limits: &Limits) -> Option<()> {
    let n = width * height;
    let depth = |x: f64, y: f64| 30.0 + 12.0 * (x / 90.0).sin() + 8.0 * (y / 70.0).cos();
    let picture = |shift: &dyn Fn(f64, f64) -> f64| -> Vec<u8> {
        let at = |i: usize| ((i % width) as f64, (i / width) as f64);
        (0..n).map(at).map(|(x, y)| texture(x - shift(x, y), y)).collect()
    };
    let (left, right) = (picture(&depth), picture(&|_, _| 0.0));
    let bgr: Vec<u8> = left.iter().flat_map(|value| [value / 2, *value, value.saturating_add(20)]).collect();
    let color = View::new(&bgr, width, height, 3);
    let roi = Rect::whole(width, height);
    let mut target = vec![0u8; 3 * n];
    let mut gray = vec![0u8; n];
    let row = |name: &str, seconds: f64, bytes: usize, operations: Option<usize>| {
        print(&Row { name: &format!("{name}, {width}x{height}"), seconds, bytes, operations }, limits);
    };

    let seconds = shortest(|| bgr_to_gray(&color, &mut ViewMut::new(&mut gray, width, height, 1)));
    // Three products and three sums of each pixel.
    row("gray of a view", seconds, 4 * n, Some(6 * n));
    let (half_width, half_height) = (width / 2, height / 2);
    let half = half_width * half_height;
    let seconds = shortest(|| {
        shrink(color, 2, ViewMut::new(&mut target[..3 * half], half_width, half_height, 3), &Serial);
    });
    row("shrinking by 2", seconds, 3 * n + 3 * half, Some(3 * n));

    let camera = CameraModel::new(
        (width, height),
        (750.0, 750.0),
        (width as f64 / 2.0, height as f64 / 2.0),
        &[-0.2, 0.05, 0.0, 0.0],
    )
    .ok()?;
    let turn = [[0.9998, -0.02, 0.0], [0.02, 0.9998, 0.0], [0.0, 0.0, 1.0]];
    let cameras = StereoCameras {
        left: camera.clone(),
        right: camera.clone(),
        rotation: turn,
        translation_mm: [-15.0, 0.1, 0.1],
    };
    let rectification = Rectification::new(&cameras, RectifyParams::default()).ok()?;
    let map = RemapTable::left(&camera, &rectification, roi, &Serial).ok()?;
    let seconds = shortest(|| {
        let _ = map.remap(color, ViewMut::new(&mut target, width, height, 3), &Serial);
    });
    // A map of six bytes per pixel; four products and their sums in each channel.
    row("rectifying a view", seconds, (3 + 3 + 6) * n, Some(3 * 8 * n));

    let mut maps = vec![vec![0.0f32; n]; 4];
    let [raw, raw_right, smooth, confidence] = &mut maps[..] else { return None };
    fn out(data: &mut [f32], (width, height): (usize, usize)) -> ViewMut<'_, f32> {
        ViewMut::new(data, width, height, 1)
    }
    let size = (width, height);
    let mut matcher = BlockMatcher::new(BlockMatchingParams::default()).ok()?;
    let seconds = shortest(|| {
        let gray = |data| View::<u8>::new(data, width, height, 1);
        let (left_map, right_map) =
            (ViewMut::new(&mut *raw, width, height, 1), ViewMut::new(&mut *raw_right, width, height, 1));
        let _ = matcher.compute(gray(&left), gray(&right), roi, &Serial, left_map, Some(right_map));
    });
    // Difference, sums of columns and rows, least cost of both views.
    row("block matching, 64 disparities", seconds, (2 + 8) * n, Some(12 * DISPARITIES * n));
    let mut wls = WlsFilter::new(WlsParams::default()).ok()?;
    let seconds = shortest(|| {
        let map = |data| View::<f32>::new(data, width, height, 1);
        let input = FilterInput {
            guide: color,
            disparity: map(raw),
            disparity_right: Some(map(raw_right)),
            confidence: None,
            roi,
        };
        let _ = wls.compute(input, &Serial, out(smooth, size), Some(out(confidence, size)));
    });
    row("weighted least squares", seconds, (3 + 8 + 8) * n, None);
    let seconds = shortest(|| {
        let input = ReprojectInput { disparity: View::new(raw, width, height, 1), confidence: None, roi };
        let _ = reproject(input, &rectification, &ReprojectParams::default(), &Serial, out(smooth, size), None);
    });
    row("depth of a disparity", seconds, 8 * n, None);

    for (name, percent) in [("scaling to 133 %", 133), ("scaling to 48 %", 48)] {
        let (to_width, to_height) = (width * percent / 100, height * percent / 100);
        let mut screen = vec![0u8; 3 * to_width * to_height];
        let mut fit = Fit::default();
        let seconds = shortest(|| {
            fit.place(&mut ViewMut::new(&mut screen, to_width, to_height, 3), &color, (0, 0), (to_width, to_height));
        });
        row(name, seconds, 3 * n + 3 * to_width * to_height, None);
    }
    Some(())
}

fn main() {
    let limits = Limits { memory: copying(64 << 20), cache: copying(256 << 10), additions: additions() };
    println!(
        "one thread: copies {:.1} GB/s in memory, {:.1} GB/s in the cache; {:.1} G additions of 16-bit numbers per second",
        limits.memory / 1e9,
        limits.cache / 1e9,
        limits.additions / 1e9
    );
    println!("| kernel | ms | MB | GB/s | of memory | of the cache | G op/s | of the additions |");
    println!("|---|---|---|---|---|---|---|---|");
    for size in [(640, 480), (1920, 1080)] {
        if kernels(size, &limits).is_none() {
            println!("a kernel refuses {size:?}");
        }
    }
}
