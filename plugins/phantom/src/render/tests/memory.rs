//! Drawing frames allocates nothing after the first one.

use super::*;

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
    let mut seen = vec![0; 400 * 300];
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
        phantom.footprint(frame, None, canvas, &Serial, &mut ViewMut::new(&mut seen, 400, 300, 1)).unwrap();
    }
    assert!(before > 0);
    assert_eq!(ALLOCATIONS.get() - before, 0, "allocations in two steady frames");
}
