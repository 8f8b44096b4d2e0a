//! Composites on the GPU: equal to the processor's except for rounding; without a GPU, and when it fails, the processor
//! draws.

use std::ffi::c_void;
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use panoscope_node::abi::{self, Device, DeviceStep, Homography, Status};
use panoscope_node::harness::{Harness, Level, Setup, lend_device};
use panoscope_node::{Bgr8, Disparity, Node};

use crate::support::table;
use panoscope_stitch::{Composite, CompositeMesh};

const SIZE: (usize, usize) = (201, 119);
const MAP: [f64; 9] = [1.01, 0.02, 90.0, -0.01, 0.99, 3.0, 1e-5, -2e-5, 1.0];

fn view(shift: f64) -> Vec<u8> {
    let at = |i: usize| ((i % SIZE.0) as f64 + shift, (i / SIZE.0) as f64);
    let wave = |(x, y): (f64, f64)| 50.0 * (0.11 * x).sin() + 30.0 * (0.09 * y + 0.02 * x).cos();
    (0..SIZE.0 * SIZE.1).flat_map(|i| [100.0, 120.0, 140.0].map(|base| (base + wave(at(i))) as u8)).collect()
}

/// The GPU is that of the process: one test at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn open<N: Node>(device: &str, params: &str) -> Harness<N> {
    Harness::open(Setup::new(&format!("params = {{ device = \"{device}\"{params} }}"))).unwrap()
}

/// Rows of the panorama of a tick.
fn tick<N: Node>(node: &mut Harness<N>, disparity: Option<&[f32]>) -> Vec<u8> {
    let homography = Homography { left_from_right: MAP, rms_px: 0.5, inliers: 100, state: abi::STATE_FRESH };
    node.input_image::<Bgr8>("left", SIZE.0, SIZE.1, &view(0.0));
    node.input_image::<Bgr8>("right", SIZE.0, SIZE.1, &view(90.0));
    if let Some(disparity) = disparity {
        node.input_image::<Disparity>("disparity", SIZE.0, SIZE.1, disparity);
    }
    let out = node.input_value("homography", homography).process().unwrap();
    let panorama = out.plane::<Bgr8>("panorama").unwrap();
    (0..panorama.height).flat_map(|y| panorama.row(y).to_vec()).collect()
}

/// Compares the panoramas of both devices, with and without a GPU.
fn check<N: Node>(params: &str, disparity: Option<&[f32]>) {
    for gpu in [table(), None] {
        lend_device(gpu);
        let [mut cpu, mut other] = ["cpu", "gpu"].map(|device| open::<N>(device, params));
        for _ in 0..2 {
            let (expected, found) = (tick(&mut cpu, disparity), tick(&mut other, disparity));
            let limit = if gpu.is_some() { 3 } else { 0 };
            assert_eq!(expected.len(), found.len());
            assert!(expected.iter().zip(&found).all(|(a, b)| a.abs_diff(*b) <= limit), "{params}");
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
}

/// A disparity that bends the right view.
fn disparity() -> Vec<f32> {
    let at = |x: f32| if x > 95.0 { 90.0 + x / 40.0 } else { f32::NAN };
    (0..SIZE.0 * SIZE.1).map(|i| at((i % SIZE.0) as f32)).collect()
}

#[test]
fn panoramas_hardly_depend_on_the_device() {
    let _alone = alone();
    let odd = ", canvas_width = 303, canvas_height = 127";
    for params in ["", odd, ", blend = \"none\"", ", blend = \"feather\", border = \"crop\"", ", up_cue = true"] {
        check::<Composite>(params, None);
        check::<CompositeMesh>(params, Some(&disparity()));
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

#[test]
fn the_processor_draws_frames_that_the_device_loses() {
    let _alone = alone();
    let Some(gpu) = breaking() else { return };
    lend_device(Some(gpu));
    let params = ", blend = \"feather\"";
    let expected = tick(&mut open::<Composite>("cpu", params), None);
    // Both views, samples, columns around the seam, panorama.
    for left in 0..5 {
        LEFT.store(left, Ordering::Relaxed);
        let mut node = open::<Composite>("gpu", params);
        assert!(tick(&mut node, None) == expected, "after {left} submissions");
        let warnings = |node: &Harness<Composite>| node.logs().iter().filter(|line| line.level == Level::Warn).count();
        assert_eq!(warnings(&node), 1, "after {left} submissions");
        // The next frame, and one on the GPU again.
        tick(&mut node, None);
        assert_eq!(warnings(&node), 1);
        LEFT.store(i32::MAX, Ordering::Relaxed);
        for device in ["cpu", "gpu"] {
            node.set_params(&format!("params = {{ device = \"{device}\"{params} }}")).unwrap();
            let made = tick(&mut node, None);
            assert!(made.iter().zip(&expected).all(|(a, b)| a.abs_diff(*b) <= 3), "{device} after {left} submissions");
        }
        assert_eq!(warnings(&node), 1);
    }
    lend_device(None);
}
