//! Views rectified on the device have the same bytes as those of the processor.

use crate::common::{device, picture};
use panoscope_gpu::{GpuError, Rectifier, RectifyJob};
use panoscope_imaging::shrink::shrink;
use panoscope_imaging::stereo::{CameraModel, RectifiedCamera, RemapTable};
use panoscope_imaging::{Rect, Serial, View, ViewMut};

/// A camera with distortion that is turned by a few degrees, so that a corner of the rectified view is not covered.
fn map(width: usize, height: usize, turn: f64) -> RemapTable {
    let focal = width as f64;
    let (cx, cy) = (width as f64 / 2.0 - 3.0, height as f64 / 2.0 + 2.0);
    let barrel = [-0.12, 0.0, 0.0, 0.0];
    let camera = CameraModel::new((width, height), (focal, focal * 1.01), (cx, cy), &barrel).expect("a camera");
    let (sin, cos) = turn.sin_cos();
    let rotation = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
    let target = RectifiedCamera { focal_px: focal, cx, cy };
    RemapTable::new(&camera, &rotation, target, (width, height), Rect::whole(width, height), &Serial).expect("a map")
}

#[test]
fn views_are_shrunk_and_turned_as_on_the_processor() {
    let Some(gpu) = device() else { return };
    for (width, height, stride, factor, is_turned) in [
        (64, 40, 192, 1, true),
        (131, 77, 400, 1, true),
        (262, 155, 786, 2, true),
        (262, 155, 800, 2, false),
        (403, 301, 1209, 3, true),
        (403, 301, 1209, 3, false),
    ] {
        let (w, h) = (width / factor, height / factor);
        let maps = [map(w, h, 0.05), map(w, h, -0.08)];
        let given = is_turned.then(|| [&maps[0], &maps[1]]);
        let mut rectifier = Rectifier::new(gpu.clone(), factor, given).expect("a rectifier");
        // Twice: the second frame finds the memory of the first.
        for seed in [1, 2] {
            let pictures = [picture(width, height, stride, seed), picture(width, height, stride, seed + 10)];
            let views = pictures.each_ref().map(|p| View::with_stride(&p[..], width, height, 3, stride));
            let mut made = [vec![7; w * h * 3 + 5 * h], vec![7; w * h * 3 + 5 * h]];
            let [left, right] = made.each_mut().map(|out| ViewMut::with_stride(out, w, h, 3, w * 3 + 5));
            let jobs = [
                Some(RectifyJob { view: views[0], out: left }),
                (seed == 1).then_some(RectifyJob { view: views[1], out: right }),
            ];
            rectifier.run(jobs, &Serial).expect("rectified");
            for side in 0..if seed == 1 { 2 } else { 1 } {
                let mut small = vec![0; w * h * 3];
                shrink(views[side], factor, ViewMut::new(&mut small, w, h, 3), &Serial);
                let mut expected = small.clone();
                if is_turned {
                    let source = View::new(&small[..], w, h, 3);
                    maps[side].remap(source, ViewMut::new(&mut expected, w, h, 3), &Serial).expect("remapped");
                }
                let found: Vec<u8> =
                    made[side].chunks_exact(w * 3 + 5).flat_map(|row| &row[..w * 3]).copied().collect();
                assert!(found == expected, "{width}x{height} / {factor}, side {side}, frame {seed}");
            }
        }
    }
}

#[test]
fn pictures_of_another_size_are_refused() {
    let Some(gpu) = device() else { return };
    let map = map(64, 40, 0.05);
    assert!(matches!(Rectifier::new(gpu.clone(), 1, None), Err(GpuError::Input { .. })));
    let mut rectifier = Rectifier::new(gpu, 1, Some([&map, &map])).expect("a rectifier");
    let pixels = picture(32, 40, 96, 1);
    let mut out = vec![0; 64 * 40 * 3];
    let job = RectifyJob { view: View::new(&pixels[..], 32, 40, 3), out: ViewMut::new(&mut out, 64, 40, 3) };
    let refused = rectifier.run([Some(job), None], &Serial).expect_err("refused").to_string();
    assert!(refused.contains("32x40"), "{refused}");
    assert!(rectifier.run([None, None], &Serial).is_ok());
}
