//! Tests of the whole renderer: exactness compared with slow and simple references, equality of all code paths.

use panoscope_base::Threads;
use panoscope_imaging::{Parallel, Serial, View, ViewMut};

use super::cast::Field;
use super::relief::NODES;
use super::*;

mod memory;
mod sensor;
mod tools;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

fn quiet(scene: SceneKind) -> SceneParams {
    SceneParams { scene, noise: 0.0, ..SceneParams::default() }
}

fn even_rig() -> Rig {
    let mut rig = Rig::stereo(WIDTH, HEIGHT, 15.0);
    (rig.cameras[1].exposure, rig.cameras[1].white_balance) = (1.0, [1.0; 3]);
    rig
}

fn draw(phantom: &mut Phantom, frame: u64, pose: Option<Pose>, pool: &dyn Parallel) -> Vec<Vec<u8>> {
    let sizes: Vec<_> = phantom.rig().cameras.iter().map(|c| (c.width, c.height)).collect();
    let mut pictures: Vec<_> = sizes.iter().map(|(w, h)| vec![0u8; w * h * 3]).collect();
    let mut views: Vec<_> = pictures.iter_mut().zip(&sizes).map(|(p, &(w, h))| ViewMut::new(p, w, h, 3)).collect();
    phantom.render(frame, pose, pool, &mut views).unwrap();
    pictures
}

fn truth(phantom: &mut Phantom, frame: u64, pose: Option<Pose>) -> (Vec<f32>, Vec<f32>, Vec<u8>) {
    let size = WIDTH * HEIGHT;
    let (mut depth, mut disparity, mut visible) = (vec![0.0; size], vec![0.0; size], vec![0; size]);
    let out = TruthMut {
        depth_mm: Some(ViewMut::new(&mut depth, WIDTH, HEIGHT, 1)),
        disparity_px: Some(ViewMut::new(&mut disparity, WIDTH, HEIGHT, 1)),
        visible: Some(ViewMut::new(&mut visible, WIDTH, HEIGHT, 1)),
    };
    phantom.truth(frame, pose, &Serial, out).unwrap();
    (depth, disparity, visible)
}

fn fnv(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// The surface in `f64`, straight from its definition.
fn surface(field: &Field, x: f64, y: f64) -> f64 {
    let (gx, gy) = (x * f64::from(field.per_mm), y * f64::from(field.per_mm));
    let (fx, fy) = (gx.floor(), gy.floor());
    let (ux, uy) = (gx - fx, gy - fy);
    let node = |i: i64, j: i64| {
        let wrap = |k: f64, d: i64| (k as i64 + d).rem_euclid(NODES as i64) as usize;
        f64::from(field.z_mm[wrap(fy, j) * NODES + wrap(fx, i)])
    };
    let (top, bottom) = (node(0, 0) * (1.0 - ux) + node(1, 0) * ux, node(0, 1) * (1.0 - ux) + node(1, 1) * ux);
    top * (1.0 - uy) + bottom * uy
}

/// First hit by small steps and bisection.
fn slow_depth(field: &Field, pose: &Pose, ray: [f64; 2]) -> f64 {
    let at = |t: f64| pose.apply([ray[0] * t, ray[1] * t, t]);
    let above = |t: f64| {
        let p = at(t);
        surface(field, p[0], p[1]) > p[2]
    };
    let mut t = 1.0;
    while above(t) && t < 500.0 {
        t += 0.01;
    }
    let (mut low, mut high) = (t - 0.01, t);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if above(middle) { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[test]
fn depth_agrees_with_bisection() {
    for (scene, frame) in
        [(SceneKind::Liver, 40), (SceneKind::Bowel, 75), (SceneKind::Cavity, 110), (SceneKind::Box, 20)]
    {
        let mut phantom = Phantom::new(quiet(scene), even_rig(), &Serial).unwrap();
        let (depth, ..) = truth(&mut phantom, frame, None);
        let pose = phantom.pose(frame);
        let field = phantom.field();
        let (mut worst, mut wrong, mut rays) = (0.0f64, 0, 0);
        for i in (0..WIDTH * HEIGHT).step_by(397) {
            let (u, v) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
            let slow = slow_depth(&field, &pose, [(u - 319.5) / 750.0, (v - 239.5) / 750.0]);
            let error = (f64::from(depth[i]) - slow).abs();
            rays += 1;
            // A ray that touches a ridge within rounding may pass it on one path only.
            if error > 0.05 { wrong += 1 } else { worst = worst.max(error) }
        }
        println!("{}: worst {worst:.2e} mm, {wrong} of {rays} on another sheet", scene.name());
        assert!(worst < 1e-4, "{}: {worst} mm", scene.name());
        assert!(wrong * 1000 <= rays, "{}: {wrong} of {rays} rays found another sheet", scene.name());
    }
}

#[test]
fn steep_views_agree_with_bisection_too() {
    let mut phantom = Phantom::new(quiet(SceneKind::Cavity), even_rig(), &Serial).unwrap();
    // 37 degrees about x and 16 about y, from beside.
    let pose = Pose { quaternion: [0.94, 0.31, -0.14, 0.0], translation_mm: [-8.0, 24.0, -4.0] };
    let (depth, ..) = truth(&mut phantom, 9, Some(pose));
    let field = phantom.field();
    let (mut worst, mut wrong, mut rays) = (0.0f64, 0, 0);
    for i in (0..WIDTH * HEIGHT).step_by(503) {
        let (u, v) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        let slow = slow_depth(&field, &pose, [(u - 319.5) / 750.0, (v - 239.5) / 750.0]);
        let error = (f64::from(depth[i]) - slow).abs();
        rays += 1;
        if error <= 0.05 { worst = worst.max(error) } else { wrong += 1 }
    }
    println!("steep: worst {worst:.2e} mm, {wrong} of {rays} on another sheet");
    assert!(worst < 3e-4, "{worst} mm");
    assert!(wrong * 200 <= rays, "{wrong} of {rays} rays found another sheet");
}

#[test]
fn a_camera_that_looks_away_sees_nothing() {
    let mut phantom = Phantom::new(quiet(SceneKind::Liver), even_rig(), &Serial).unwrap();
    let away = Pose { quaternion: [0.0, 0.0, 1.0, 0.0], translation_mm: [0.0; 3] };
    let (depth, disparity, visible) = truth(&mut phantom, 0, Some(away));
    assert!(depth.iter().chain(&disparity).all(|d| d.is_nan()) && visible.iter().all(|&v| v == 0));
    assert!(draw(&mut phantom, 0, Some(away), &Serial).iter().all(|p| p.iter().all(|&b| b == 0)));
    assert_eq!(phantom.homography(0, Some(away), &Serial), Ok(None));
}

#[test]
fn a_plane_has_the_disparity_of_the_formula() {
    let params = SceneParams { distance_mm: 62.5, ..quiet(SceneKind::Board) };
    let mut phantom = Phantom::new(params, even_rig(), &Serial).unwrap();
    let (depth, disparity, visible) = truth(&mut phantom, 0, Some(Pose::IDENTITY));
    for v in 0..HEIGHT {
        for u in 0..WIDTH {
            let i = v * WIDTH + u;
            assert!((depth[i] - 62.5).abs() < 1e-4, "depth {} at {u} {v}", depth[i]);
            assert!((disparity[i] - 180.0).abs() < 1e-3, "disparity {} at {u} {v}", disparity[i]);
            assert_eq!(visible[i] == 255, u as f32 - 180.0 > -0.5, "visibility at {u} {v}");
        }
    }
}

/// Right view at `(u - disparity, v)` by cubic convolution along the row.
fn warped(right: &View<u8>, x: f32, y: usize, channel: usize) -> f32 {
    let base = x.floor();
    let t = x - base;
    let weights = [
        -0.5 * t + t * t - 0.5 * t * t * t,
        1.0 - 2.5 * t * t + 1.5 * t * t * t,
        0.5 * t + 2.0 * t * t - 1.5 * t * t * t,
        -0.5 * t * t + 0.5 * t * t * t,
    ];
    let row = right.row(y);
    let at = |k: i64| f32::from(row[(base as i64 + k - 1).clamp(0, WIDTH as i64 - 1) as usize * 3 + channel]);
    (0..4).map(|k| weights[k] * at(k as i64)).sum()
}

/// Mean absolute difference of the left view and the warped right view where both see, in gray levels, and the share of such pixels above 8.
fn warp_difference(params: SceneParams) -> (f64, f64) {
    let mut phantom = Phantom::new(params, even_rig(), &Serial).unwrap();
    let pictures = draw(&mut phantom, 50, None, &Serial);
    let (_, disparity, visible) = truth(&mut phantom, 50, None);
    let right = View::new(&pictures[1], WIDTH, HEIGHT, 3);
    let (mut sum, mut large, mut count) = (0.0, 0, 0);
    for v in 0..HEIGHT {
        for u in 2..WIDTH - 2 {
            let i = v * WIDTH + u;
            let x = u as f32 - disparity[i];
            // Neighbours too: next to a silhouette the interpolation mixes both sides.
            if x < 2.0 || visible[i - 2..=i + 2].contains(&0) || (disparity[i - 2] - disparity[i + 2]).abs() > 8.0 {
                continue;
            }
            for channel in 0..3 {
                let error = (warped(&right, x, v, channel) - f32::from(pictures[0][3 * i + channel])).abs();
                sum += f64::from(error);
                large += usize::from(error > 8.0);
                count += 1;
            }
        }
    }
    assert!(count > WIDTH * HEIGHT / 2, "only {count} values compared");
    (sum / count as f64, large as f64 / count as f64)
}

#[test]
fn warping_by_the_truth_leaves_only_interpolation() {
    for scene in [SceneKind::Liver, SceneKind::Bowel, SceneKind::Cavity] {
        let (matt, large) = warp_difference(SceneParams { specular: 0.0, ..quiet(scene) });
        let (shiny, large_shiny) = warp_difference(quiet(scene));
        println!(
            "{}: {matt:.3} grey levels ({:.4} % over 8), with highlights {shiny:.3} ({:.3} %)",
            scene.name(),
            large * 100.0,
            large_shiny * 100.0
        );
        assert!(matt < 0.5, "{}: {matt} grey levels remain", scene.name());
        assert!(large < 1e-3, "{}: {large} of the pixels differ", scene.name());
        assert!(shiny > matt, "highlights depend on the view");
    }
}

#[test]
fn lanes_and_threads_give_the_same_bytes() {
    let mut rig = Rig::stereo(320, 237, 15.0);
    rig.cameras[1].distortion = [-0.3, 0.1, 0.001, -0.002, 0.01];
    let params = SceneParams { scene: SceneKind::Cavity, motion_blur: 2, ..SceneParams::default() };
    let mut phantom = Phantom::new(params.clone(), rig.clone(), &Serial).unwrap();
    let first = draw(&mut phantom, 33, None, &Serial);
    let elsewhere = draw(&mut phantom, 34, None, &Serial);
    assert_ne!(first, elsewhere);
    phantom.force_portable(true);
    assert!(!phantom.wide_lanes());
    assert_eq!(first, draw(&mut phantom, 33, None, &Serial), "portable lanes differ");
    for threads in [2, 8] {
        let mut phantom = Phantom::new(params.clone(), rig.clone(), &Threads::new(threads)).unwrap();
        assert_eq!(first, draw(&mut phantom, 33, None, &Threads::new(threads)), "{threads} threads differ");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_every_machine() {
    let mut phantom = Phantom::new(SceneParams::default(), Rig::stereo(WIDTH, HEIGHT, 15.0), &Threads::new(2)).unwrap();
    let bytes: Vec<u8> =
        [0, 31].into_iter().flat_map(|f| draw(&mut phantom, f, None, &Threads::new(2)).concat()).collect();
    assert_eq!(format!("{:016x}", fnv(&bytes)), "f11f8bb13b00c1b3");
}

#[test]
fn the_wide_view_holds_the_left_view() {
    let mut phantom = Phantom::new(quiet(SceneKind::Bowel), even_rig(), &Serial).unwrap();
    let left = draw(&mut phantom, 12, None, &Serial).remove(0);
    let canvas = Canvas { width: 960, height: 560, offset_x: 48.0, offset_y: 40.0 };
    let mut wide = vec![0; canvas.width * canvas.height * 3];
    let mut view = ViewMut::new(&mut wide, canvas.width, canvas.height, 3);
    phantom.wide(12, None, canvas, &Serial, &mut view).unwrap();
    let inner = view.as_view().crop(48, 40, WIDTH, HEIGHT);
    let mut differing = 0;
    for v in 0..HEIGHT {
        let pairs = inner.row(v).iter().zip(&left[v * WIDTH * 3..]);
        differing += pairs.filter(|(a, b)| a.abs_diff(**b) > 1).count();
    }
    assert!(differing < 300, "{differing} bytes differ");
    let outside: u32 = view.as_view().crop(720, 100, 200, 300).row(7).iter().map(|&b| u32::from(b)).sum();
    assert!(outside > 200 * 3 * 10, "the right part is drawn");
}

#[test]
fn the_footprint_of_all_cameras_is_the_union_of_their_pictures() {
    let canvas = Canvas { width: 1280, height: 900, offset_x: 60.0, offset_y: 40.0 };
    let mut plane = vec![7u8; canvas.width * canvas.height];
    let mut area = |rig: Rig, scene: SceneParams, pose: Pose| {
        let mut phantom = Phantom::new(scene, rig, &Serial).unwrap();
        let mut view = ViewMut::new(&mut plane, canvas.width, canvas.height, 1);
        phantom.footprint(0, Some(pose), canvas, &Serial, &mut view).unwrap();
        let row: Vec<usize> = (0..canvas.width).filter(|&u| view.as_view().row(300)[u] == 255).collect();
        (plane.iter().filter(|&&v| v == 255).count(), row[0], row[row.len() - 1])
    };
    // A plane 50 mm away moves by 15 mm * 750 px / 50 mm.
    let board = quiet(SceneKind::Board);
    let near = |got: usize, want: usize| got.abs_diff(want) < want / 500;
    let (pixels, first, last) = area(even_rig(), board.clone(), Pose::IDENTITY);
    assert!(near(pixels, (WIDTH + 225) * HEIGHT), "{pixels}");
    assert!(first == 60 && last.abs_diff(60 + 225 + WIDTH - 1) <= 1, "{first} to {last}");
    let (pixels, ..) = area(Rig::quad(WIDTH, HEIGHT, 15.0), board.clone(), Pose::IDENTITY);
    assert!(near(pixels, (WIDTH + 225) * (HEIGHT + 225)), "{pixels}");
    // 20 mm away the pictures share 78 of 640 columns.
    let closer = Pose { translation_mm: [0.0, 0.0, 30.0], ..Pose::IDENTITY };
    let (pixels, ..) = area(even_rig(), board, closer);
    assert!(near(pixels, (WIDTH + 562) * HEIGHT), "{pixels}");
}

#[test]
fn a_plane_has_an_exact_homography() {
    let mut phantom = Phantom::new(quiet(SceneKind::Board), even_rig(), &Serial).unwrap();
    let tilt = Pose { quaternion: [0.99, 0.05, -0.08, 0.02], translation_mm: [1.0, 2.0, 3.0] };
    let fit = phantom.homography(0, Some(tilt), &Serial).unwrap().unwrap();
    assert!(fit.rms_px < 1e-3 && fit.points > 1000, "{fit:?}");
    let straight = phantom.homography(0, Some(Pose::IDENTITY), &Serial).unwrap().unwrap();
    for (got, want) in straight.left_from_right.iter().zip([1.0, 0.0, 225.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]) {
        assert!((got - want).abs() < 2e-3, "{straight:?}");
    }
    let mut tissue = Phantom::new(quiet(SceneKind::Liver), even_rig(), &Serial).unwrap();
    let fit = tissue.homography(0, None, &Serial).unwrap().unwrap();
    assert!(fit.rms_px > 0.5, "relief is no plane: {fit:?}");
}

#[test]
fn printed_lengths_measure_what_they_say() {
    let params = SceneParams { distance_mm: 60.0, ..quiet(SceneKind::Box) };
    let mut phantom = Phantom::new(params, even_rig(), &Serial).unwrap();
    let pictures = draw(&mut phantom, 0, Some(Pose::IDENTITY), &Serial);
    let (depth, ..) = truth(&mut phantom, 0, Some(Pose::IDENTITY));
    let pixel =
        |x: f32, y: f32| [(x / 60.0 * 750.0 + 319.5).round() as usize, (y / 60.0 * 750.0 + 239.5).round() as usize];
    let inside = |p: &[f32]| p[0].abs() < 24.0 && p[1].abs() < 18.0;
    let mut seen = 0;
    for [x0, y0, x1, y1] in LENGTHS_MM {
        if !inside(&[x0, y0]) || !inside(&[x1, y1]) {
            continue;
        }
        seen += 1;
        let ends = [[x0, y0], [x1, y1]].map(|[x, y]| {
            let [u, v] = pixel(x, y);
            let ink = pictures[0][3 * (v * WIDTH + u)];
            assert!(ink < 110, "no mark at ({x}, {y}): {ink}");
            let t = depth[v * WIDTH + u];
            [(u as f32 - 319.5) / 750.0 * t, (v as f32 - 239.5) / 750.0 * t, t]
        });
        let square: f32 = (0..3).map(|i| (ends[0][i] - ends[1][i]) * (ends[0][i] - ends[1][i])).sum();
        let want = ((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0)).sqrt();
        assert!((square.sqrt() - want).abs() < 0.12, "{} for {want} mm", square.sqrt());
    }
    assert!(seen >= 4);
    for [x, y, _, height] in BLOCKS_MM {
        let t = 60.0 - height;
        let (u, v) = (x / t * 750.0 + 319.5, y / t * 750.0 + 239.5);
        if u < WIDTH as f32 {
            assert!((depth[v as usize * WIDTH + u as usize] - t).abs() < 1e-3);
        }
    }
}

#[test]
fn a_glide_keeps_its_speed_and_stays_near_its_distance() {
    for (speed, distance_mm) in [(5.0, 50.0), (100.0, 50.0), (200.0, 20.0)] {
        let params = SceneParams {
            camera_speed_mm_s: speed,
            camera_path: CameraPath::Glide,
            distance_mm,
            fps: 3000.0,
            ..SceneParams::default()
        };
        let script = super::motion::Script::new(&params);
        assert_eq!(script.pose(0.0).translation_mm, [0.0; 3]);
        let mut turns = 0;
        for i in 0..9000 {
            let [a, b] = [i, i + 1].map(|k| script.pose(f64::from(k)).translation_mm);
            let step = (0..3).map(|k| (b[k] - a[k]) * (b[k] - a[k])).sum::<f64>().sqrt() * 3000.0;
            // Only the steps in which it turns from nearer to away are shorter.
            if (step - speed).abs() > 1e-6 * speed {
                turns += 1;
            }
            assert!(step <= speed * (1.0 + 1e-6) && a[2].abs() <= 4.0, "{step} mm/s at {a:?}");
        }
        assert!(turns <= 70, "{turns} steps of another speed than {speed} mm/s");
    }
}

#[test]
fn the_script_keeps_its_speed_limit_and_breath() {
    for seed in 0..40 {
        let params = SceneParams { seed, camera_speed_mm_s: 25.0, ..SceneParams::default() };
        let script = super::motion::Script::new(&params);
        for i in 0..3000 {
            let (a, b) = (script.pose(f64::from(i)), script.pose(f64::from(i) + 0.01));
            let square: f64 = (0..3).map(|k| (b.translation_mm[k] - a.translation_mm[k]).powi(2)).sum();
            assert!(square.sqrt() * 3000.0 <= 25.001, "seed {seed} frame {i}: {} mm/s", square.sqrt() * 3000.0);
            assert!(script.breath_mm(f64::from(i)).abs() <= 1.3);
        }
        assert_eq!(script.pose(0.0), Pose { translation_mm: [0.0; 3], ..script.pose(0.0) });
    }
}

#[test]
fn a_ring_closes_with_every_lap_and_keeps_its_speed_limit() {
    let limit = 20.0;
    let params = SceneParams {
        camera_path: CameraPath::Ring,
        path_mm: 30.0,
        camera_speed_mm_s: limit,
        ..SceneParams::default()
    };
    let script = super::motion::Script::new(&params);
    let away = |frames: f64| script.pose(frames).translation_mm.iter().map(|v| v * v).sum::<f64>().sqrt();
    // Circumference over speed, a little more for the way up and down.
    let lap = (0..400).map(|i| 130.0 + f64::from(i) * 0.05).min_by(|a, b| away(*a).total_cmp(&away(*b))).unwrap();
    assert!((141.0..147.0).contains(&lap) && away(lap) < 0.05, "{lap} frames, {} mm", away(lap));
    assert!((away(lap / 2.0) - 30.0).abs() < 0.1, "{}", away(lap / 2.0));
    let (start, end) = (script.pose(0.0), script.pose(lap));
    assert!(start.quaternion.iter().zip(end.quaternion).all(|(a, b)| (a - b).abs() < 1e-3), "{end:?}");
    let mut top: f64 = 0.0;
    for i in 0..300 {
        let (a, b) = (script.pose(f64::from(i)), script.pose(f64::from(i) + 0.01));
        let square: f64 = (0..3).map(|k| (b.translation_mm[k] - a.translation_mm[k]).powi(2)).sum();
        top = top.max(square.sqrt() * 3000.0);
    }
    assert!(top <= limit + 0.001 && top > 0.95 * limit, "{top} mm/s");
}

#[test]
fn tissue_without_relief_is_a_plane() {
    let params = SceneParams { relief: 0.0, breathing_mm: 0.0, camera_speed_mm_s: 0.0, ..quiet(SceneKind::Bowel) };
    let mut phantom = Phantom::new(params, even_rig(), &Serial).unwrap();
    let mut depth = vec![0.0; WIDTH * HEIGHT];
    let out =
        TruthMut { depth_mm: Some(ViewMut::new(&mut depth, WIDTH, HEIGHT, 1)), disparity_px: None, visible: None };
    phantom.truth(0, None, &Serial, out).unwrap();
    assert!(depth.iter().all(|z| (z - 50.0).abs() < 1e-3));
    let views = draw(&mut phantom, 0, None, &Serial);
    let (low, high) = views[0].iter().fold((255, 0), |(low, high), v| (low.min(*v), high.max(*v)));
    assert!(high - low > 60, "it still has its skin: {low} to {high}");
}

#[test]
fn mistakes_are_named() {
    let bad = SceneParams { distance_mm: f64::NAN, ..SceneParams::default() };
    let refused = Phantom::new(bad, even_rig(), &Serial).err();
    assert!(matches!(refused, Some(PhantomError::OutOfRange { name: "distance_mm", .. })), "{refused:?}");
    assert!("lung".parse::<SceneKind>().unwrap_err().to_string().contains("liver"));
    let mut phantom = Phantom::new(SceneParams::default(), even_rig(), &Serial).unwrap();
    let mut bytes = vec![0; WIDTH * HEIGHT * 3];
    let mut one = [ViewMut::new(&mut bytes, WIDTH, HEIGHT, 3)];
    assert_eq!(phantom.render(0, None, &Serial, &mut one), Err(PhantomError::WrongViewCount { got: 1, want: 2 }));
    let pose = Pose { translation_mm: [f64::NAN; 3], ..Pose::IDENTITY };
    assert_eq!(phantom.homography(0, Some(pose), &Serial), Err(PhantomError::BadPose));
}

#[test]
fn tissue_that_is_baked_when_it_is_seen_is_that_baked_at_once() {
    let steep = Pose { quaternion: [0.94, 0.31, -0.14, 0.0], translation_mm: [-8.0, 24.0, -4.0] };
    let level = Pose { quaternion: [0.707, 0.707, 0.0, 0.0], translation_mm: [0.0, 0.0, -10.0] };
    let mut bent = Rig::stereo(320, 240, 15.0);
    bent.cameras[0].distortion = [-0.3, 0.1, 0.002, -0.003, 0.0];
    let even = Rig::stereo(320, 240, 15.0);
    // With whether the frames see all of a period.
    let cases = [
        (SceneKind::Liver, &even, vec![(0, None), (200, None)], false),
        (SceneKind::Cavity, &bent, vec![(30, None), (9, Some(steep))], true),
        (SceneKind::Bowel, &bent, vec![(75, None)], false),
        (SceneKind::Board, &even, vec![(3, None)], false),
        (SceneKind::Liver, &even, vec![(5, Some(level))], true),
    ];
    for (scene, rig, frames, is_whole) in cases {
        let [mut lazy, mut whole] = [0, 1].map(|_| Phantom::new(quiet(scene), rig.clone(), &Serial).unwrap());
        whole.bake_all(&Serial);
        for (frame, pose) in frames {
            let [part, all] = [&mut lazy, &mut whole].map(|phantom| draw(phantom, frame, pose, &Serial));
            assert!(part == all, "{scene:?}, frame {frame}");
        }
        assert_eq!(lazy.is_baked(), is_whole, "{scene:?}");
    }
}
