//! SURF on a synthetic 640x480 texture: detection and description at 500, 1000 and 2000 points.
//!
//! `cargo bench -p panoscope-imaging --bench surf` prints minimum and median milliseconds.
//! `SURF_IMAGE=file.gray,WIDTH,HEIGHT` replaces the texture by a raw 8-bit image. A word as argument picks the cases
//! whose name holds it.

use std::time::Instant;

use panoscope_base::Threads;
use panoscope_base::random::SplitMix64;
use panoscope_imaging::Rect;
use panoscope_imaging::features::{Features, Surf, SurfParams};
use panoscope_imaging::{Parallel, Serial, View};

fn texture(width: usize, height: usize) -> Vec<u8> {
    // Sums of random bumps of many sizes: keypoints at every scale.
    let mut state = SplitMix64(1);
    let mut random = move || (state.bits() >> 40) as f32 / (1u64 << 24) as f32;
    let mut image = vec![128.0f32; width * height];
    for _ in 0..9000 {
        let (x, y) = (random() * width as f32, random() * height as f32);
        let sigma = 1.2 * (random() * 1.6).exp();
        let height_of = (random() - 0.5) * 120.0;
        let reach = (sigma * 3.0).ceil() as isize;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let (px, py) = (x as isize + dx, y as isize + dy);
                if px >= 0 && py >= 0 && (px as usize) < width && (py as usize) < height {
                    let (ex, ey) = (px as f32 - x, py as f32 - y);
                    let value = height_of * (-(ex * ex + ey * ey) / (2.0 * sigma * sigma)).exp();
                    image[py as usize * width + px as usize] += value;
                }
            }
        }
    }
    image.iter().map(|&value| value.clamp(0.0, 255.0) as u8).collect()
}

fn measure(label: &str, mut work: impl FnMut() -> usize) {
    if std::env::args().skip(1).any(|word| !word.starts_with("--") && !label.contains(&word)) {
        return;
    }
    let mut times = Vec::new();
    let mut points = 0;
    for _ in 0..40 {
        let start = Instant::now();
        points = work();
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    println!("{label:<44} {points:>5} points  min {:>7.3} ms  median {:>7.3} ms", times[0], times[times.len() / 2]);
}

fn main() {
    let (data, width, height) = match std::env::var("SURF_IMAGE") {
        Ok(text) => {
            let parts: Vec<&str> = text.split(',').collect();
            let size = |index: usize| parts.get(index).and_then(|part| part.parse().ok()).unwrap_or(0);
            (std::fs::read(parts[0]).unwrap_or_default(), size(1), size(2))
        }
        Err(_) => (texture(640, 480), 640, 480),
    };
    let image = View::new(&data, width, height, 1);
    let mut out = Features::default();
    for threads in ["1 thread", "2 threads"] {
        // The helper spins, so it lives only while it is measured.
        let pair = (threads == "2 threads").then(|| Threads::new(2));
        let pool: &dyn Parallel = pair.as_ref().map_or(&Serial, |pair| pair);
        for upright in [true, false] {
            let kind = if upright { "upright" } else { "oriented" };
            for second_look in [true, false] {
                let look = if second_look { "second look" } else { "plain" };
                for max_points in [500, 1000, 2000] {
                    let params = SurfParams { hessian_threshold: 2.0, second_look, ..SurfParams::default() };
                    let mut surf = Surf::new(SurfParams { max_points, upright, ..params });
                    measure(&format!("surf {width}x{height} {max_points} {kind} {look} {threads}"), || {
                        surf.detect_and_describe(image, None, 1, pool, &mut out);
                        out.len()
                    });
                }
            }
            // As `register_surf` looks at an overlap.
            let params =
                SurfParams { hessian_threshold: 50.0, second_look: false, spread: (6, 4), ..SurfParams::default() };
            let mut surf = Surf::new(SurfParams { max_points: 400, upright, ..params });
            let roi = Rect::new(0, 0, width, height);
            measure(&format!("surf {width}x{height} shrunk by 2 {kind} {threads}"), || {
                surf.detect_and_describe(image, Some(roi), 2, pool, &mut out);
                out.len()
            });
        }
    }
}
