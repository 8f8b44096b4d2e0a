//! Views rectified on the device have the same bytes as those of the processor.

use super::support::{Held, device, picture};
use panoscope_imaging::shrink::shrink;
use panoscope_imaging::stereo::{CameraModel, RectifiedCamera, RemapTable};
use panoscope_imaging::{Rect, Serial, View, ViewMut};
use panoscope_stereo::gpu::rectify::{Rectifier, RectifyJob};

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
        let mut rectifier = Rectifier::new(gpu, factor, given).expect("a rectifier");
        // Twice: the second frame finds the memory of the first.
        for seed in [1, 2] {
            let pictures = [picture(width, height, stride, seed), picture(width, height, stride, seed + 10)];
            let views = pictures.each_ref().map(|p| View::with_stride(&p[..], width, height, 3, stride));
            let given = pictures.each_ref().map(|p| Held::of(gpu, p, width, height, stride));
            let made = [0, 1].map(|_| Held::new(gpu, w, h, 3));
            let job = |side: usize| RectifyJob { view: given[side].image, out: made[side].image };
            rectifier.run([Some(job(0)), (seed == 1).then(|| job(1))]).expect("rectified");
            for side in 0..if seed == 1 { 2 } else { 1 } {
                let mut small = vec![0; w * h * 3];
                shrink(views[side], factor, ViewMut::new(&mut small, w, h, 3), &Serial);
                let mut expected = small.clone();
                if is_turned {
                    let source = View::new(&small[..], w, h, 3);
                    maps[side].remap(source, ViewMut::new(&mut expected, w, h, 3), &Serial).expect("remapped");
                }
                let found = made[side].rows(gpu, w * 3);
                assert!(found == expected, "{width}x{height} / {factor}, side {side}, frame {seed}");
            }
        }
    }
}

#[test]
fn pictures_of_another_size_are_refused() {
    let Some(gpu) = device() else { return };
    let map = map(64, 40, 0.05);
    assert!(Rectifier::new(gpu, 1, None).is_err());
    let mut rectifier = Rectifier::new(gpu, 1, Some([&map, &map])).expect("a rectifier");
    let (view, out) = (Held::new(gpu, 32, 40, 3), Held::new(gpu, 64, 40, 3));
    let job = RectifyJob { view: view.image, out: out.image };
    let refused = rectifier.run([Some(job), None]).expect_err("refused").to_string();
    assert!(refused.contains("32x40"), "{refused}");
    assert!(rectifier.run([None, None]).is_ok());
}
