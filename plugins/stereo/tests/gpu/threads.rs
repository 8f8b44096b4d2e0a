//! Kernels of several nodes share one device.

use super::support::{Held, device, picture};
use panoscope_imaging::Rect;
use panoscope_imaging::stereo::BlockMatchingParams;
use panoscope_stereo::gpu::block_matching::GpuBlockMatcher;
use panoscope_stereo::gpu::rectify::{Rectifier, RectifyJob};

const SIZE: (usize, usize) = (128, 48);
const FRAMES: u32 = 60;

#[test]
fn kernels_on_several_threads_do_not_disturb_each_other() {
    let Some(gpu) = device() else { return };
    let shrink = |side: u32| {
        let mut rectifier = Rectifier::new(gpu, 2, None).expect("a rectifier");
        let pixels = picture(SIZE.0, SIZE.1, SIZE.0 * 3, side);
        let mut first = None;
        for frame in 0..FRAMES {
            let view = Held::of(gpu, &pixels, SIZE.0, SIZE.1, SIZE.0 * 3);
            let out = Held::new(gpu, SIZE.0 / 2, SIZE.1 / 2, 3);
            let job = RectifyJob { view: view.image, out: out.image };
            rectifier.run([Some(job), None]).unwrap_or_else(|e| panic!("frame {frame}: {e}"));
            let out = out.rows(gpu, SIZE.0 / 2 * 3);
            assert!(first.get_or_insert_with(|| out.clone()) == &out, "frame {frame} of thread {side}");
        }
    };
    let matches = || {
        let mut matcher = GpuBlockMatcher::new(gpu).expect("a matcher");
        let gray: Vec<u8> = picture(SIZE.0, SIZE.1, SIZE.0 * 3, 9).as_chunks::<3>().0.iter().map(|p| p[0]).collect();
        let view = Held::of(gpu, &gray, SIZE.0, SIZE.1, SIZE.0);
        let params = BlockMatchingParams { search_px: 32, block_px: 9, ..BlockMatchingParams::default() };
        for frame in 0..FRAMES {
            let map = Held::of(gpu, &[0; 4 * SIZE.0 * SIZE.1], SIZE.0, SIZE.1, 4 * SIZE.0);
            let done = matcher.compute(&params, [view.image; 2], Rect::whole(SIZE.0, SIZE.1), (map.image, None));
            done.unwrap_or_else(|e| panic!("frame {frame}: {e}"));
            let values = map.rows(gpu, 4 * SIZE.0);
            let values = values.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
            assert!(values.filter(|value| value.is_finite()).all(|value| value.abs() < 1.0), "frame {frame}");
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(|| shrink(1));
        scope.spawn(|| shrink(2));
        scope.spawn(matches);
    });
}
