//! Time of a panorama by a mesh per frame: the mesh brought up to the disparity, and the picture drawn by it; moving
//! views, 1 and 2 threads. A word as argument picks the cases whose line holds it: `cargo bench --bench mesh --
//! "640x480 2"`.

use panoscope_base::Threads;
use panoscope_imaging::geometry::Homography;
use panoscope_imaging::stereo::Lens;
use panoscope_imaging::stitch::*;
use panoscope_imaging::{Parallel, View, ViewMut};
use std::time::Instant;

/// Disparity of tissue with folds at a point of a view of 640 columns, px.
fn disparity(x: f64, y: f64, t: f64) -> f64 {
    290.0 + t + 22.0 * (0.012 * x + 0.3 * t).sin() * (0.017 * y).cos() + 9.0 * (0.04 * y + 0.021 * x).sin()
}

/// Disparity of an instrument in front of it, px.
const TOOL_PX: f64 = 350.0;

/// Whether a slanted shaft from the right, which moves up and down, covers a point of the left view.
fn is_tool(x: f64, y: f64, t: f64) -> bool {
    x > 430.0 && (y - 230.0 - 8.0 * t.sin() - 0.2 * (x - 430.0)).abs() < 30.0
}

/// Waves and blocks: edges at all scales.
fn colour(u: f64, v: f64) -> [u8; 3] {
    let wave = 40.0 * (0.021 * u + 0.3 * (0.013 * v).sin()).sin() + 25.0 * (0.11 * v + 0.017 * u).sin();
    let block = ((u / 23.0).floor() as i64 * 7919 + (v / 19.0).floor() as i64 * 104_729).rem_euclid(41) as f64;
    [100.0, 90.0, 150.0].map(|c| (c + wave + block).clamp(0.0, 255.0) as u8)
}

/// The left picture, or the right one, which shows the same points shifted by their disparity.
fn picture((w, h): (usize, usize), t: f64, is_right: bool, has_tool: bool) -> Vec<u8> {
    let k = w as f64 / 640.0;
    let at = |x: usize, y: usize| {
        let (u, v) = (x as f64 / k, y as f64 / k);
        if has_tool && is_tool(if is_right { u + TOOL_PX } else { u }, v, t) {
            return [120; 3];
        }
        let first = if is_right { u + disparity(u + 290.0, v, t) } else { u };
        colour(if is_right { u + disparity(first, v, t) } else { u }, v)
    };
    (0..h).flat_map(|y| (0..w).flat_map(move |x| at(x, y))).collect()
}

/// What a block matcher finds: nothing in the columns that only the left view sees, and holes.
fn map((w, h): (usize, usize), t: f64, has_tool: bool) -> Vec<f32> {
    let k = w as f64 / 640.0;
    let at = |x: usize, y: usize| {
        let (u, v) = (x as f64 / k, y as f64 / k);
        let is_tool = has_tool && is_tool(u, v, t);
        let d = if is_tool { TOOL_PX * k } else { disparity(u, v, t) * k };
        let noise = ((x * 31 + y * 17) % 9) as f64 / 9.0 - 0.5;
        // Metal is matched in patches only.
        let is_unmatched_metal = is_tool && !(x / 12 + y / 12).is_multiple_of(2);
        let is_hole = is_unmatched_metal || (x / 16 * 5 + y / 16 * 3).is_multiple_of(11);
        if is_hole || d > x as f64 { f32::NAN } else { (d + 0.6 * noise) as f32 }
    };
    (0..h).flat_map(|y| (0..w).map(move |x| at(x, y))).collect()
}

fn time(size: (usize, usize), crop: CropMethod, has_tool: bool, pool: &dyn Parallel) -> Option<()> {
    let (w, h) = size;
    let cropped = if crop == CropMethod::None { "" } else { " cropped" };
    let with_tool = if has_tool { " instrument" } else { "" };
    let case = format!("{w}x{h} {} threads{cropped}{with_tool}", pool.threads());
    if std::env::args().skip(1).any(|word| !word.starts_with("--") && !case.contains(&word)) {
        return Some(());
    }
    let k = w as f64 / 640.0;
    let frames: Vec<_> = (0..7)
        .map(|n| f64::from(n) * 0.7)
        .map(|t| (t, picture(size, t, false, has_tool), picture(size, t, true, has_tool), map(size, t, has_tool)))
        .collect();
    let straight = RectifiedView {
        size,
        focal_px: [600.0 * k; 2],
        centre_px: [w as f64 / 2.0, h as f64 / 2.0],
        lens: Lens::NONE,
        rectified_from_camera: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        rectified_focal_px: [600.0 * k; 2],
        rectified_centre_px: [w as f64 / 2.0, h as f64 / 2.0],
    };
    let (left, right) = (straight, straight);
    let mut follower = MeshFollower::new(MeshParams::default());
    let params = CompositeParams {
        seam: SeamMethod::DynamicProgramming,
        blend: BlendMethod::Feather,
        crop,
        ..CompositeParams::default()
    };
    let mut compositor = Compositor::new(params);
    let (mut out, mut update_ms, mut draw_ms) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..if w > 1000 { 60 } else { 200 } {
        let (t, left_picture, right_picture, known) = &frames[i % frames.len()];
        let plane = [1.0, 0.0, (290.0 + t) * k, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let views = [View::new(left_picture, w, h, 3), View::new(right_picture, w, h, 3)];
        let start = Instant::now();
        let report = follower.update(View::new(known, w, h, 1), &left, &right, &Homography(plane), pool);
        let updated = Instant::now();
        assert!(!report.is_held, "the mesh follows: {report:?}");
        compositor.set_mesh(1, follower.mesh());
        compositor.set_mesh(0, follower.reference_mesh());
        let given = [IDENTITY, plane];
        let canvas = compositor.canvas(&views, &given, GeometryState::Fresh).ok()?;
        out.resize(canvas.width * canvas.height * 3, 0);
        let mut view = ViewMut::new(&mut out, canvas.width, canvas.height, 3);
        compositor.compose(&views, &given, GeometryState::Fresh, pool, &mut view, None).ok()?;
        if i >= 5 {
            update_ms.push((updated - start).as_secs_f64() * 1e3);
            draw_ms.push(updated.elapsed().as_secs_f64() * 1e3);
        }
    }
    let [update, draw] = [update_ms, draw_ms].map(|mut ms| {
        ms.sort_unstable_by(f64::total_cmp);
        let mean = ms.iter().sum::<f64>() / ms.len() as f64;
        (ms[0], ms[ms.len() / 2], mean)
    });
    println!(
        "{case}  mesh min {:6.3} median {:6.3} ms  picture min {:6.3} median {:6.3} mean {:6.3} ms",
        update.0, update.1, draw.0, draw.1, draw.2
    );
    Some(())
}

fn main() {
    let pair = Threads::new(2);
    for pool in [&panoscope_imaging::Serial as &dyn Parallel, &pair] {
        let sizes = [(640, 480), (1920, 1080)];
        let cases = [(CropMethod::None, false), (CropMethod::Filled, false), (CropMethod::Filled, true)];
        for (size, (crop, has_tool)) in sizes.into_iter().flat_map(|size| cases.map(|case| (size, case))) {
            if time(size, crop, has_tool, pool).is_none() {
                println!("the compositor refuses the views");
            }
        }
    }
}
