//! Nodes on the GPU: the images of the processor; without a GPU, and when it fails, the processor makes them.

#[path = "../../../tests/support/gpu.rs"]
mod support;

use std::ffi::c_void;
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use panoscope_imaging::fit::Fit;
use panoscope_imaging::{View, ViewMut};
use panoscope_node::abi::{
    self, Calibration, Camera, Detection, Device, DeviceStep, Homography, Pose, Roi, Status, Tip,
};
use panoscope_node::device::{DeviceImage, Steps};
use panoscope_node::harness::{Harness, Level, Setup, lend_device};
use panoscope_node::pick::{Grid, Picker};
use panoscope_node::{Bgr8, Depth, Mask, Node, Rect};
use panoscope_overlay::colorize::Colorize;
use panoscope_overlay::gpu::fit::{DeviceFit, FitJob};
use panoscope_overlay::overlay::Overlay;
use panoscope_overlay::screen::Screen;
use panoscope_overlay::trajectory::Trajectory;

use support::{Held, device, difference, picture, table};

#[test]
fn images_are_brought_to_the_sizes_of_their_places() {
    let Some(gpu) = device() else { return };
    let mut fit = DeviceFit::new(gpu).expect("a kernel");
    let source = (203, 151);
    // Image, place, largest difference: copied, up to two pixels under one, more, more than 257.
    let cases = [
        (source, source, 0),
        (source, (202, 151), 0),
        (source, (150, 111), 0),
        (source, (102, 76), 0),
        (source, (101, 75), 0),
        (source, (77, 57), 0),
        (source, (41, 31), 0),
        (source, (13, 10), 0),
        (source, (11, 9), 1),
        (source, (1, 1), 1),
        ((5, 3), (3, 2), 0),
        ((8, 6), (4, 3), 0),
        ((3, 700), (1, 2), 1),
    ];
    for (padding, start) in [(0, 0), (5, 36_usize)] {
        for (number, (from, to, limit)) in cases.into_iter().enumerate() {
            let stride = 3 * from.0 + padding;
            let pixels = picture(from.0, from.1, stride, number as u32);
            let image = Held::of(gpu, &pixels, from.0, from.1, stride);
            // One row more, for the start.
            let place = Held::new(gpu, to.0, to.1 + start.div_ceil(3 * to.0), 3);
            let to_image = DeviceImage { height: to.1, ..place.image };
            fit.run(Steps::default(), &[FitJob { from: image.image, to: to_image, start, from_start: 0 }])
                .expect("placed");
            let row = DeviceImage::stride_bytes(to.0, 3);
            let mut made = vec![0; start + row * to.1];
            gpu.read(place.image.buffer, &mut made).expect("read");
            let made: Vec<u8> = made[start..].chunks_exact(row).flat_map(|row| &row[..3 * to.0]).copied().collect();
            let mut expected = vec![0; 3 * to.0 * to.1];
            let view = View::with_stride(&pixels, from.0, from.1, 3, stride);
            Fit::default().place(&mut ViewMut::new(&mut expected, to.0, to.1, 3), &view, (0, 0), to);
            let (most, _) = difference(&made, &expected);
            assert!(most <= limit, "{from:?} as {to:?}: {most}");
        }
    }
}

#[test]
fn chosen_pixels_are_read() {
    let Some(gpu) = device() else { return };
    let mut picker = Picker::new(gpu).expect("a kernel");
    let (width, height) = (37, 23);
    // Pixels of bytes, of words, of points; rows with and without padding.
    for (pixel_bytes, padding) in [(1, 0), (1, 3), (3, 0), (3, 5), (4, 0), (4, 12), (16, 0)] {
        let stride = width * pixel_bytes + padding;
        let bytes: Vec<u8> = (0..stride * height).map(|at| (at * 37 % 251) as u8).collect();
        let image = Held::of(gpu, &bytes, width, height, stride);
        let grids = [
            Grid::of_area(Rect::new(5, 3, 9, 4)),
            Grid::of_steps((width, height), [7, 5]),
            Grid::default(),
            Grid { columns: vec![36], rows: vec![0, 1, 22] },
            Grid::of_area(Rect::whole(width, height)),
        ];
        let words = picker.pick(image.image, pixel_bytes, &grids).expect("read").to_vec();
        let mut rows = words.iter().flat_map(|word| word.to_le_bytes());
        for grid in &grids {
            let row_bytes = grid.columns.len() * pixel_bytes;
            for y in grid.rows.iter().filter(|_| row_bytes > 0) {
                let row: Vec<u8> = rows.by_ref().take(row_bytes.next_multiple_of(4)).collect();
                let pixel = |x: &u32| &bytes[*y as usize * stride + *x as usize * pixel_bytes..][..pixel_bytes];
                let expected: Vec<u8> = grid.columns.iter().flat_map(pixel).copied().collect();
                assert_eq!(row[..row_bytes], expected, "{pixel_bytes} bytes, {padding} more, row {y}");
            }
        }
        assert_eq!(rows.count(), 0);
    }
}

/// The GPU is that of the process: one test at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn open<N: Node>(device: &str, params: &str) -> Harness<N> {
    Harness::open(Setup::new(&format!("params = {{ device = \"{device}\"{params} }}"))).unwrap()
}

/// The rows of output `image` of a tick.
fn rows<N: Node>(node: &mut Harness<N>) -> Vec<u8> {
    let out = node.process().unwrap();
    let image = out.plane::<Bgr8>("image").unwrap();
    (0..image.height).flat_map(|y| image.row(y).to_vec()).collect()
}

fn give<N: Node>(node: &mut Harness<N>, input: &str, size: (usize, usize), seed: u32) {
    node.input_image_from_device::<Bgr8>(input, size.0, size.1, &picture(size.0, size.1, 3 * size.0, seed));
}

/// A tick of `screen`: two images that shrink, one that grows, one of the host, one that is missing.
fn screen(node: &mut Harness<Screen>, seed: u32) -> Vec<u8> {
    give(node, "main", (723, 417), seed);
    give(node, "side", (301, 202), seed + 1);
    give(node, "side", (31, 22), seed + 2);
    node.input_image::<Bgr8>("side", 501, 300, &picture(501, 300, 3 * 501, seed + 3));
    node.input_empty("side");
    rows(node)
}

/// A tick of `overlay` with a bar.
fn overlay(node: &mut Harness<Overlay>, text: &str, seed: u32) -> Vec<u8> {
    give(node, "image", (323, 141), seed);
    node.input_text("text", text);
    rows(node)
}

const BELOW: &str = ", words = \"below\", label = \"panorama\"";

/// Runs ticks on both devices, with and without a GPU: the same images.
fn check<N: Node>(params: &str, ticks: usize, tick: impl Fn(&mut Harness<N>, usize) -> Vec<u8>) {
    let _alone = alone();
    for gpu in [table(), None] {
        lend_device(gpu);
        let [mut cpu, mut other] = ["cpu", "gpu"].map(|device| open::<N>(device, params));
        for at in 0..ticks {
            assert!(tick(&mut cpu, at) == tick(&mut other, at), "{params}, tick {at}");
        }
        assert!(cpu.logs().is_empty());
        let lines: Vec<_> = other.logs().iter().map(|line| (line.level, line.message.as_str())).collect();
        match &lines[..] {
            [(Level::Info, message)] => assert!(gpu.is_some() && message.starts_with("computes on "), "{message}"),
            [(Level::Warn, message)] => {
                assert!(gpu.is_none() && message.contains("the processor computes the images: "), "{message}");
            }
            _ => panic!("{lines:?}"),
        }
    }
    lend_device(None);
}

#[test]
fn screens_do_not_depend_on_the_device() {
    for params in [", width = 641, height = 359", ", titles = \"a;b\", max_age_ms = 0", ", width = 2001, height = 1300"]
    {
        check::<Screen>(params, 2, |node, at| screen(node, at as u32));
    }
}

#[test]
fn images_with_a_bar_do_not_depend_on_the_device() {
    const TEXTS: [&str; 6] = ["", "12 mm", "12 mm", "13 mm", "13 mm\nthe arm follows the tip", "12 mm"];
    for params in ["", ", max_aspect = 1.2", ", bar_lines = 3, text_scale = 3.5", ", wanted_width = 700"] {
        let tick = |node: &mut Harness<Overlay>, at: usize| overlay(node, TEXTS[at], at as u32);
        check::<Overlay>(&format!("{BELOW}{params}"), TEXTS.len(), tick);
    }
    // What is drawn on the image: on the GPU, but for masks.
    for params in [BELOW, ", words = \"below\", line_px = 9.0, offset_px = [-40, 11]"] {
        check::<Overlay>(params, 7, marked);
    }
}

/// A tick of `overlay` with marks that change: none, a rectangle, boxes at the edges, a tip, an outline, distances, a mask.
fn marked(node: &mut Harness<Overlay>, at: usize) -> Vec<u8> {
    if at % 2 == 1 {
        node.input_value("roi", Roi { x: 20, y: 30, width: 50, height: 40 });
    }
    if at >= 2 {
        let item = |x_px, y_px, track_id| Detection {
            x_px,
            y_px,
            width_px: 90.0,
            height_px: 60.0,
            score: 0.9,
            class_index: track_id as u32 % 2,
            track_id,
        };
        let items = [item(-20.0, 100.0, 1), item(270.0, -9.0, 2), item(100.0 + 10.0 * at as f32, 40.0, 3)];
        node.input_detections("detections", &items[..(at - 1).min(3)], "hook\ngrasper", (323, 141));
    }
    if at >= 3 {
        let (u_px, v_px) = (160.0, 70.0 + at as f64);
        let tip = Tip { u_px, v_px, xyz_mm: [1.0, 2.0, 60.0], score: 0.9, class_index: 0, xyz_valid: 1, track_id: 1 };
        node.input_value("tip", tip);
    }
    if at >= 4 {
        let left_from_right = [0.9, 0.02, 30.0, -0.01, 0.95, 4.0, 0.0, 0.0, 1.0];
        let state = abi::STATE_FRESH;
        node.input_value("homography", Homography { left_from_right, state, rms_px: 0.5, inliers: 40 });
    }
    if at >= 5 {
        let columns =
            ["u_px", "v_px", "tissue_u_px", "tissue_v_px", "tissue_mm", "tissue_state", "tip_mm", "tip_state"];
        node.input_table("nearness", &columns, &[200.0, 90.0, 220.0, 130.0, 3.5, 1.0, 9.0, 1.0]);
    }
    if at == 6 {
        let mask: Vec<u8> = (0..323 * 141).map(|k| if k % 5 == 0 { 255 } else { 0 }).collect();
        node.input_image::<Mask>("mask", 323, 141, &mask);
    }
    overlay(node, "12 mm", at as u32)
}

/// A tick of `trajectory`: the tip moves, and is lost at times.
fn trajectory(node: &mut Harness<Trajectory>, at: usize) -> Vec<u8> {
    give(node, "image", (1283, 721), at as u32);
    let (fx, fy, cx, cy) = (1500.0, 1500.0, 640.0, 360.0);
    let camera = Camera { width: 1283, height: 721, fx, fy, cx, cy, distortion: [0.0; 14] };
    let (eye, projection) =
        ([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let calibration = Calibration {
        left: camera,
        right: camera,
        right_from_left_rotation: eye,
        right_from_left_mm: [-5.0, 0.0, 0.0],
        rectified_from_left: eye,
        rectified_from_right: eye,
        left_projection: projection,
        right_projection: projection,
        baseline_mm: 5.0,
        rms_px: 0.0,
        is_rectified: 1,
        stated_error: 0,
    };
    let pose = Pose { a_from_b_wxyz: [1.0, 0.0, 0.0, 0.0], a_from_b_mm: [0.0; 3], a: [0; 16], b: [0; 16] };
    node.input_value("calibration", calibration).input_value("camera_pose", pose);
    if at % 5 != 3 {
        let turn = at as f64 * 0.7;
        let xyz_mm = [20.0 * turn.sin(), 14.0 * turn.cos(), 60.0 + at as f64];
        let (u_px, v_px) = (640.0 + 1500.0 * xyz_mm[0] / xyz_mm[2], 360.0 + 1500.0 * xyz_mm[1] / xyz_mm[2]);
        node.input_value("tip", Tip { u_px, v_px, xyz_mm, score: 0.9, class_index: 0, xyz_valid: 1, track_id: 1 });
    }
    rows(node)
}

#[test]
fn trajectories_do_not_depend_on_the_device() {
    for params in ["", ", box_share = 1.0, line_px = 7.0", ", show_box = false, goal_mm = 0.0"] {
        check::<Trajectory>(params, 9, trajectory);
    }
}

/// A tick of `colorize`: depths with unknown ones and ones beyond the range.
fn colorize(node: &mut Harness<Colorize>, shift: f32) -> Vec<u8> {
    let (width, height) = (301, 143);
    let depth = |k: usize| match k % 97 {
        0 => f32::NAN,
        1 => f32::INFINITY,
        2 => -f32::INFINITY,
        3 => -1e9,
        4 => 1e9,
        _ => shift + 40.0 + (k % width) as f32 * 0.1 + (k / width) as f32 * 0.2,
    };
    let depths: Vec<f32> = (0..width * height).map(depth).collect();
    node.input_image_from_device::<Depth>("depth", width, height, &depths);
    rows(node)
}

#[test]
fn maps_in_colours_do_not_depend_on_the_device() {
    for params in [
        ", scale_beside = true",
        ", scale_beside = true, low = 45.0, high = 60.0, colors = \"viridian\"",
        ", scale_bar = false, colors = \"gray\"",
        "",
    ] {
        check::<Colorize>(params, 4, |node, at| colorize(node, [0.0, 0.5, 300.0, 301.0][at]));
    }
}

/// Submissions until [`breaking`] fails.
static LEFT: AtomicI32 = AtomicI32::new(i32::MAX);

/// The device of [`table`] until it breaks.
fn breaking() -> Option<&'static Device> {
    unsafe extern "C" fn submit(ctx: *mut c_void, steps: *const DeviceStep, len: usize) -> Status {
        match table().and_then(|table| table.submit) {
            // SAFETY: the caller's promise to this function is that to the device's.
            Some(submit) if LEFT.fetch_sub(1, Ordering::Relaxed) > 0 => unsafe { submit(ctx, steps, len) },
            _ => abi::STATUS_ERROR,
        }
    }
    static TABLE: OnceLock<Option<Device>> = OnceLock::new();
    TABLE.get_or_init(|| table().map(|table| Device { submit: Some(submit), ..*table })).as_ref()
}

/// The device breaks after each of the first submissions; later it is chosen again.
fn check_lost<N: Node>(params: &str, submissions: i32, tick: impl Fn(&mut Harness<N>) -> Vec<u8>) {
    let _alone = alone();
    let Some(gpu) = breaking() else { return };
    lend_device(Some(gpu));
    let expected = tick(&mut open::<N>("cpu", params));
    for left in 0..=submissions {
        LEFT.store(left, Ordering::Relaxed);
        let mut node = open::<N>("gpu", params);
        let warnings = |node: &Harness<N>| node.logs().iter().filter(|line| line.level == Level::Warn).count();
        let lost = usize::from(left < submissions);
        for _ in 0..1 + lost {
            assert!(tick(&mut node) == expected, "after {left} submissions");
            assert_eq!(warnings(&node), lost, "after {left} submissions");
        }
        LEFT.store(i32::MAX, Ordering::Relaxed);
        for device in ["cpu", "gpu"] {
            node.set_params(&format!("params = {{ device = \"{device}\"{params} }}")).unwrap();
            assert!(tick(&mut node) == expected, "{device} after {left} submissions");
        }
        assert_eq!(warnings(&node), lost);
    }
    lend_device(None);
}

#[test]
fn the_processor_makes_images_that_the_device_loses() {
    // The harness copies two images to the GPU, the node submits all its work at once.
    check_lost::<Screen>(", width = 641, height = 359", 3, |node| screen(node, 0));
    check_lost::<Overlay>(BELOW, 2, |node| overlay(node, "12 mm", 0));
    // And the parts that are drawn on.
    check_lost::<Overlay>(BELOW, 3, |node| marked(node, 4));
    // Without a tip: what is drawn does not depend on the ticks before.
    check_lost::<Trajectory>("", 3, |node| trajectory(node, 3));
    // The map, the sample, the colours.
    check_lost::<Colorize>(", scale_beside = true", 3, |node| colorize(node, 0.0));
}
