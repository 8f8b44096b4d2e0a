//! Checks of the whole renderer: exactness against slow and simple yardsticks, equality of all paths.

use std::sync::atomic::{AtomicUsize, Ordering};

use panoscope_imaging::{Parallel, Serial, View, ViewMut};

use super::cast::Field;
use super::relief::NODES;
use super::*;

/// Threads that share the chunks of a loop.
struct Threads(usize);

impl Parallel for Threads {
    fn threads(&self) -> usize {
        self.0
    }
    fn run(&self, chunks: usize, body: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..self.0 {
                scope.spawn(|| {
                    loop {
                        let chunk = next.fetch_add(1, Ordering::Relaxed);
                        if chunk >= chunks {
                            break;
                        }
                        body(chunk);
                    }
                });
            }
        });
    }
}

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

/// Mean absolute difference of the left view and the warped right view where both see, in grey levels, and the
/// share of such pixels above 8.
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
        let mut phantom = Phantom::new(params.clone(), rig.clone(), &Threads(threads)).unwrap();
        assert_eq!(first, draw(&mut phantom, 33, None, &Threads(threads)), "{threads} threads differ");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_every_machine() {
    let mut phantom = Phantom::new(SceneParams::default(), Rig::stereo(WIDTH, HEIGHT, 15.0), &Threads(2)).unwrap();
    let bytes: Vec<u8> = [0, 31].into_iter().flat_map(|f| draw(&mut phantom, f, None, &Threads(2)).concat()).collect();
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
fn a_lens_and_its_inverse_agree() {
    let k = [-0.35, 0.15, 0.002, -0.001, -0.02];
    for place in [[0.0, 0.0], [0.4, -0.3], [-0.42, 0.31]] {
        let ray = super::lens::undistort(&k, place).unwrap();
        let (seen, _) = super::lens::distort(&k, ray);
        assert!((seen[0] - place[0]).abs() < 1e-12 && (seen[1] - place[1]).abs() < 1e-12);
    }
    let mut rig = even_rig();
    rig.cameras[1].distortion = [-4.0, 0.0, 0.0, 0.0, 0.0];
    let refused = Phantom::new(quiet(SceneKind::Board), rig, &Serial).err();
    assert!(matches!(refused, Some(PhantomError::BadDistortion { camera: 1, .. })), "{refused:?}");
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

/// Counts the allocations of each thread.
struct Counting;

std::thread_local! {
    static ALLOCATIONS: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

// SAFETY: all memory comes from the system's allocator.
unsafe impl std::alloc::GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: std::alloc::Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: as the caller promised.
        unsafe { std::alloc::System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: std::alloc::Layout) {
        // SAFETY: as the caller promised.
        unsafe { std::alloc::System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

#[test]
fn steady_frames_allocate_nothing() {
    let params = SceneParams { smoke: 0.3, blood_drops: 3, motion_blur: 2, ..SceneParams::default() };
    let mut phantom = Phantom::new(params, Rig::stereo(320, 240, 15.0), &Serial).unwrap();
    let (mut left, mut right) = (vec![0; 320 * 240 * 3], vec![0; 320 * 240 * 3]);
    let (mut depth, mut visible, mut wide) = (vec![0.0; 320 * 240], vec![0; 320 * 240], vec![0; 400 * 300 * 3]);
    let canvas = Canvas { width: 400, height: 300, offset_x: 20.0, offset_y: 20.0 };
    let mut before = 0;
    for frame in 0..3 {
        if frame == 1 {
            before = ALLOCATIONS.get();
        }
        let mut views = [ViewMut::new(&mut left, 320, 240, 3), ViewMut::new(&mut right, 320, 240, 3)];
        phantom.render(frame, None, &Serial, &mut views).unwrap();
        let out = TruthMut {
            depth_mm: Some(ViewMut::new(&mut depth, 320, 240, 1)),
            visible: Some(ViewMut::new(&mut visible, 320, 240, 1)),
            ..TruthMut::default()
        };
        phantom.truth(frame, None, &Serial, out).unwrap();
        phantom.homography(0, None, &Serial).unwrap();
        phantom.wide(frame, None, canvas, &Serial, &mut ViewMut::new(&mut wide, 400, 300, 3)).unwrap();
    }
    assert!(before > 0);
    assert_eq!(ALLOCATIONS.get() - before, 0, "allocations in two steady frames");
}

#[test]
fn faults_of_the_sensor_show() {
    let plain = |change: fn(&mut SceneParams)| {
        let mut params = SceneParams::default();
        change(&mut params);
        let mut phantom = Phantom::new(params, Rig::stereo(160, 120, 15.0), &Serial).unwrap();
        draw(&mut phantom, 10, None, &Serial)
    };
    let clean = plain(|_| {});
    let difference = |other: &[Vec<u8>], camera: usize| -> f64 {
        let sum: u64 = clean[camera].iter().zip(&other[camera]).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        sum as f64 / clean[camera].len() as f64
    };
    let noiseless = difference(&plain(|p| p.noise = 0.0), 0);
    assert!((0.3..3.0).contains(&noiseless), "noise of {noiseless} grey levels");
    assert!(difference(&plain(|p| p.smoke = 0.6), 0) > 15.0);
    let stained = difference(&plain(|p| p.blood_drops = 8), 1);
    assert!(stained > 1.5 * noiseless, "drops change {stained} grey levels, noise {noiseless}");
    let blurred = difference(&plain(|p| (p.motion_blur, p.camera_speed_mm_s) = (4, 25.0)), 0);
    assert!(blurred > noiseless, "motion blur changes the picture");
    let black = plain(|p| p.black = Some(BlackOut { camera: 1, first: 10, end: 11 }));
    assert!(black[1].iter().all(|&b| b == 0) && black[0] == clean[0]);
    let later = plain(|p| p.black = Some(BlackOut { camera: 1, first: 11, end: 15 }));
    assert_eq!(later, clean);
    let suffering = |kind: IncidentKind, first: u64, end: u64| {
        let params = SceneParams { incident: Some(Incident { kind, first, end }), ..SceneParams::default() };
        draw(&mut Phantom::new(params, Rig::stereo(160, 120, 15.0), &Serial).unwrap(), 10, None, &Serial)
    };
    for kind in [IncidentKind::Smoke, IncidentKind::Blur, IncidentKind::Covered] {
        let during = suffering(kind, 10, 11);
        assert!(difference(&during, 1) > 4.0, "{kind:?} changes {} gray levels", difference(&during, 1));
        assert_eq!(during[0] == clean[0], kind == IncidentKind::Covered, "{kind:?}");
        for (first, end) in [(5, 10), (11, 15)] {
            assert_eq!(suffering(kind, first, end), clean, "{kind:?} {first}..{end}");
        }
    }
    let jump = |first: u64, end: u64| suffering(IncidentKind::Jump, first, end);
    assert_eq!(jump(11, 12), clean);
    assert!(jump(10, 11) == jump(4, 5) && jump(10, 11)[0] != clean[0], "it stays where it jumped to");
}

#[test]
fn a_distorted_view_is_the_ideal_one_seen_through_the_lens() {
    let params = SceneParams { specular: 0.0, ..quiet(SceneKind::Board) };
    let mut rig = even_rig();
    let k = [-0.25, 0.08, 0.001, -0.0015, 0.0];
    rig.cameras[1] = CameraModel { distortion: k, ..rig.cameras[0] };
    let mut phantom = Phantom::new(params, rig, &Serial).unwrap();
    let pictures = draw(&mut phantom, 20, None, &Serial);
    let ideal = View::new(&pictures[0], WIDTH, HEIGHT, 3);
    let (mut sum, mut count) = (0.0, 0);
    for v in (40..HEIGHT - 40).step_by(3) {
        for u in (40..WIDTH - 40).step_by(3) {
            // The ideal pixel (x, y) appears in the distorted picture at `seen`.
            let (seen, _) = super::lens::distort(&k, [(u as f64 - 319.5) / 750.0, (v as f64 - 239.5) / 750.0]);
            let (x, y) = (seen[0] * 750.0 + 319.5, seen[1] * 750.0 + 239.5);
            let at = |i: usize, j: usize| f64::from(pictures[1][3 * ((y as usize + j) * WIDTH + x as usize + i)]);
            let (a, b) = (x.fract(), y.fract());
            let top = at(0, 0) * (1.0 - a) + at(1, 0) * a;
            let bottom = at(0, 1) * (1.0 - a) + at(1, 1) * a;
            sum += (top * (1.0 - b) + bottom * b - f64::from(ideal.row(v)[3 * u])).abs();
            count += 1;
        }
    }
    let mean = sum / f64::from(count);
    assert!(mean < 1.2, "{mean} grey levels between the views");
}

#[test]
fn instruments_are_where_the_truth_says() {
    let params = SceneParams { tools: 7, ..quiet(SceneKind::Liver) };
    let mut phantom = Phantom::new(params.clone(), even_rig(), &Serial).unwrap();
    let mut bare = Phantom::new(SceneParams { tools: 0, ..params.clone() }, even_rig(), &Serial).unwrap();
    let mut kinds = Vec::new();
    let mut tips_seen = 0;
    for frame in [3, 90, 200] {
        let mut ids = vec![9; WIDTH * HEIGHT];
        let mut tools = Vec::new();
        let mut plane = ViewMut::new(&mut ids, WIDTH, HEIGHT, 1);
        phantom.tools(frame, None, &Serial, &mut plane, &mut tools).unwrap();
        let (with, without) = (draw(&mut phantom, frame, None, &Serial), draw(&mut bare, frame, None, &Serial));
        let (depth, _, visible) = truth(&mut phantom, frame, None);
        let (tissue, ..) = truth(&mut bare, frame, None);
        for (i, &id) in ids.iter().enumerate() {
            let pixels = 3 * i..3 * i + 3;
            if id == 0 {
                assert_eq!(with[0][pixels.clone()], without[0][pixels], "pixel {i} shows tissue");
                assert_eq!(depth[i], tissue[i]);
            } else {
                assert!(depth[i] < tissue[i], "pixel {i} of instrument {id}");
            }
        }
        assert_eq!(tools.len(), 7);
        for tool in &tools {
            let mine: Vec<_> = (0..ids.len()).filter(|&i| ids[i] == tool.id).map(|i| (i % WIDTH, i / WIDTH)).collect();
            assert_eq!(mine.len(), tool.pixels);
            if let Some(left) = mine.iter().map(|p| p.0).min() {
                let (right, top) = (mine.iter().map(|p| p.0).max(), mine.iter().map(|p| p.1).min());
                let bottom = mine.iter().map(|p| p.1).max();
                let [x, y, w, h] = tool.bounds_px;
                assert_eq!((x, Some(x + w - 1), Some(y), Some(y + h - 1)), (left, right, top, bottom));
            }
            if tool.tip_visible {
                tips_seen += 1;
                let place = [0, 1].map(|k| tool.tip_mm[k] / tool.tip_mm[2] * 750.0 + [319.5, 239.5][k]);
                assert!((place[0] - tool.tip_px[0]).abs() < 1e-9 && (place[1] - tool.tip_px[1]).abs() < 1e-9);
            }
            kinds.push(tool.kind);
        }
        assert!(ids.iter().filter(|&&id| id > 0).count() > 5000, "instruments are in view");
        // What the right view shows at the true disparity is the same instrument.
        assert!(ids.iter().zip(&visible).any(|(&id, &seen)| id > 0 && seen == 255));
    }
    assert!(ToolKind::ALL.iter().all(|kind| kinds.contains(kind)) && tips_seen >= 3);
    phantom.force_portable(true);
    let portable = draw(&mut phantom, 90, None, &Threads(2));
    phantom.force_portable(false);
    assert_eq!(portable, draw(&mut phantom, 90, None, &Serial));
}

#[test]
fn rays_enter_parts_where_a_slow_search_does() {
    use super::solid::{Paint, Part, Solid, add, dot};
    let paint = Paint { albedo: [0.5; 3], metal: 0.0 };
    let n = [0.6, 0.0, 0.8];
    let part =
        Part { a: [-4.0, 1.0, 30.0], radius_a: 3.0, b: [6.0, -2.0, 36.0], radius_b: 1.2, flat: (n, 0.5), paint, id: 1 };
    // Inside: within the ball of some point of the axis, after undoing the squeeze.
    let round = |v: [f64; 3]| add(v, n, dot(v, n));
    let axis = round(add(part.b, part.a, -1.0));
    let inside = |p: [f64; 3]| {
        let p = round(add(p, part.a, -1.0));
        (0..=2000).any(|i| {
            let s = f64::from(i) / 2000.0;
            let gap = add(p, axis, -s);
            dot(gap, gap).sqrt() < 3.0 + (1.2 - 3.0) * s
        })
    };
    let mut hits = 0;
    for j in -12..=12 {
        for i in -14..=20 {
            let d = [f64::from(i) / 75.0, f64::from(j) / 75.0, 1.0];
            let entry = Solid::new(part).enter(d);
            let slow = (0..2400).map(|k| 24.0 + f64::from(k) * 0.01).find(|&t| inside(d.map(|v| v * t)));
            match (entry, slow) {
                (Some(entry), Some(slow)) => {
                    hits += 1;
                    assert!((entry.t - slow).abs() < 0.03, "{d:?}: {} for {slow}", entry.t);
                    assert!(dot(entry.normal, d) < 1e-6, "the normal looks at the camera");
                    let inv = 1.0 / dot(d, d).sqrt();
                    assert!(part.near(d.map(|v| v * inv), 1e-6));
                }
                (Some(entry), None) => assert!(!inside(d.map(|v| v * (entry.t + 0.3))), "{d:?} grazes only"),
                (None, found) => assert!(found.is_none(), "{d:?} missed"),
            }
        }
    }
    assert!(hits > 60, "{hits} rays met the part");
}

#[test]
fn scripted_instruments_never_hide_their_own_tips() {
    let motions = [ToolMotion::Still, ToolMotion::Step, ToolMotion::Ramp, ToolMotion::Circle, ToolMotion::Strokes];
    for (motion, kind) in motions.into_iter().flat_map(|m| [(m, ToolKind::Hook), (m, ToolKind::Grasper)]) {
        let params = SceneParams {
            distance_mm: 85.0,
            tools: 1,
            tool_kinds: vec![kind],
            tool_motion: motion,
            ..quiet(SceneKind::Bowel)
        };
        let rig = Rig::stereo(160, 120, 15.0);
        let mut phantom = Phantom::new(params, rig, &Serial).unwrap();
        let (mut ids, mut tools) = (vec![0; 160 * 120], Vec::new());
        let rest = Pose { quaternion: [1.0, 0.0, 0.0, 0.0], translation_mm: [0.0; 3] };
        for frame in (0..1200).step_by(15) {
            // The camera stands before the tip, as the arm would have it.
            let mut plane = ViewMut::new(&mut ids, 160, 120, 1);
            phantom.tools(frame, Some(rest), &Serial, &mut plane, &mut tools).unwrap();
            let tip = tools[0].tip_mm;
            let follow = Pose { translation_mm: [tip[0] - 7.5, tip[1], tip[2] - 65.6], ..rest };
            phantom.tools(frame, Some(follow), &Serial, &mut plane, &mut tools).unwrap();
            assert!(tools[0].tip_visible, "{motion:?} {kind:?}, frame {frame}: {:?}", tools[0]);
        }
    }
}
