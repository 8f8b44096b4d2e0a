//! Time of the compositor per frame: two views, geometry held and moving, 1 and 2 threads. A word as argument picks the
//! cases whose line holds it: `cargo bench --bench composite -- "640x480 held   1"`.

use panoscope_base::Threads;
use panoscope_imaging::geometry::Homography;
use panoscope_imaging::stitch::*;
use panoscope_imaging::{Parallel, View, ViewMut};
use std::time::Instant;

/// Waves and blocks: edges at all scales, nothing that repeats within the overlap.
fn picture(width: usize, height: usize, left_from_view: &[f64; 9], gain: f64) -> Vec<u8> {
    let mut data = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let [u, v] = Homography(*left_from_view).map([x as f64, y as f64]);
            let wave = 40.0 * (0.021 * u + 0.3 * (0.013 * v).sin()).sin() + 25.0 * (0.11 * v + 0.017 * u).sin();
            let block = ((u / 23.0) as i64 * 7919 + (v / 19.0) as i64 * 104_729) % 41;
            for c in [100.0, 90.0, 150.0] {
                data.push(((c + wave + block as f64) * gain).clamp(0.0, 255.0) as u8);
            }
        }
    }
    data
}

fn time(name: &str, params: &CompositeParams, size: (usize, usize), moving: bool, pool: &dyn Parallel) {
    let (w, h) = size;
    let motion = if moving { "moving" } else { "held  " };
    let case = format!("{name:<28} {w}x{h} {motion} {} threads", pool.threads());
    if std::env::args().skip(1).any(|word| !word.starts_with("--") && !case.contains(&word)) {
        return;
    }
    let k = w as f64 / 640.0;
    let geometry = |t: f64| [1.02, 0.01, (290.0 + t) * k, -0.012, 1.01, (4.0 + 0.5 * t) * k, 2e-5 / k, -1e-5 / k, 1.0];
    let (left, right) = (picture(w, h, &IDENTITY, 1.0), picture(w, h, &geometry(0.0), 0.9));
    let views = [View::new(&left, w, h, 3), View::new(&right, w, h, 3)];
    let mut compositor = Compositor::new(params.clone());
    let (mut out, mut canvas_px) = (Vec::new(), 0);
    let mut ms: Vec<f64> = Vec::new();
    for i in 0..if w > 1000 { 60 } else { 200 } {
        let t = if moving { f64::from(i % 7) * 0.2 } else { 0.0 };
        let given = [IDENTITY, geometry(t)];
        let start = Instant::now();
        let Ok(canvas) = compositor.canvas(&views, &given, GeometryState::Fresh) else { return };
        out.resize(canvas.width * canvas.height * 3, 0);
        let mut view = ViewMut::new(&mut out, canvas.width, canvas.height, 3);
        if compositor.compose(&views, &given, GeometryState::Fresh, pool, &mut view, None).is_err() {
            return;
        }
        if i >= 5 {
            ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
        canvas_px = canvas.width * canvas.height;
    }
    ms.sort_unstable_by(f64::total_cmp);
    println!(
        "{case}  min {:6.3} ms  median {:6.3} ms  p95 {:6.3} ms  ({:.2} Mpx canvas)",
        ms[0],
        ms[ms.len() / 2],
        ms[ms.len() * 95 / 100],
        canvas_px as f64 / 1e6
    );
}

fn main() {
    let pair = Threads::new(2);
    let default = CompositeParams::default();
    let every = CompositeParams { seam_interval_frames: 1, ..default.clone() };
    let path = CompositeParams { seam: SeamMethod::DynamicProgramming, seam_interval_frames: 1, ..default.clone() };
    let feather = CompositeParams { blend: BlendMethod::Feather, ..default.clone() };
    let hard = CompositeParams { blend: BlendMethod::None, ..default.clone() };
    let filled = CompositeParams { crop: CropMethod::Filled, ..default.clone() };
    for pool in [&panoscope_imaging::Serial as &dyn Parallel, &pair] {
        for moving in [false, true] {
            time("graph cut, multi-band", &default, (640, 480), moving, pool);
        }
        time("the same, cropped", &filled, (640, 480), false, pool);
        time("the same, cropped", &filled, (640, 480), true, pool);
        time("graph cut every frame", &every, (640, 480), true, pool);
        time("shortest path every frame", &path, (640, 480), true, pool);
        time("feather", &feather, (640, 480), true, pool);
        time("hard seam", &hard, (640, 480), true, pool);
        time("graph cut, multi-band", &default, (1280, 720), true, pool);
        time("graph cut, multi-band", &default, (1920, 1080), true, pool);
    }
}
