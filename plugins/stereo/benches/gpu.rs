//! Time of a frame on the GPU, its way there and back included, and that of the processor on two threads: the median of
//! 30, both by turns. A word as argument picks the sizes that hold it: `PANOSCOPE_GPU=nvidia cargo bench -p
//! panoscope-stereo -- 3840`.

#[path = "../../../tests/support/gpu.rs"]
mod support;

use panoscope_base::Threads;
use panoscope_imaging::stereo::{BlockMatcher, BlockMatchingParams, CameraModel, RectifiedCamera, RemapTable};
use panoscope_imaging::{Parallel, Rect, View, ViewMut};
use panoscope_node::device::{Gpu, Store};
use panoscope_stereo::gpu::block_matching::GpuBlockMatcher;
use panoscope_stereo::gpu::rectify::{Rectifier, RectifyJob};
use support::{bench_sizes, beside, image, print, upload, waves};

fn rectify(gpu: Gpu, size: (usize, usize), factor: usize, pool: &dyn Parallel) {
    let (width, height) = (size.0 / factor, size.1 / factor);
    let focal = width as f64;
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    let barrel = [-0.1, 0.0, 0.0, 0.0];
    let camera = CameraModel::new((width, height), (focal, focal), (cx, cy), &barrel).expect("a camera");
    let eye = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let target = RectifiedCamera { focal_px: focal, cx, cy };
    let whole = Rect::whole(width, height);
    let map = RemapTable::new(&camera, &eye, target, (width, height), whole, pool).expect("a map");
    let mut rectifier = Rectifier::new(gpu, factor, Some([&map, &map])).expect("a rectifier");
    let pictures = [waves(size, 0), waves(size, 40)];
    let views = pictures.each_ref().map(|pixels| View::new(&pixels[..], size.0, size.1, 3));
    let bytes = width * height * 3;
    let (mut small, mut out, mut made) = (vec![0; bytes], [vec![0; bytes], vec![0; bytes]], vec![0; bytes]);
    let mut stores: [Store; 4] = Default::default();
    let [a, b, c, d] = &mut stores;
    let given = [image(gpu, a, size, 3), image(gpu, b, size, 3)];
    let target = [image(gpu, c, (width, height), 3), image(gpu, d, (width, height), 3)];
    let times = beside(
        || {
            for (view, out) in views.iter().zip(&mut out) {
                let mut source = *view;
                if factor > 1 {
                    panoscope_imaging::shrink::shrink(source, factor, ViewMut::new(&mut small, width, height, 3), pool);
                    source = View::new(&small, width, height, 3);
                }
                map.remap(source, ViewMut::new(out, width, height, 3), pool).expect("rectified");
            }
        },
        || {
            upload(gpu, &given, &pictures);
            rectifier.run([0, 1].map(|k| Some(RectifyJob { view: given[k], out: target[k] }))).expect("rectified");
            target.iter().for_each(|image| gpu.read(image.buffer, &mut made).expect("read"));
        },
    );
    print(&format!("rectify both views, scale {factor}"), size, times);
}

fn matching(gpu: Gpu, size: (usize, usize), pool: &dyn Parallel) {
    let (width, height) = size;
    let gray = |shift: usize| -> Vec<u8> { waves(size, shift).as_chunks::<3>().0.iter().map(|p| p[1]).collect() };
    let pictures = [gray(0), gray(width / 20)];
    let [left, right] = pictures.each_ref().map(|pixels| View::new(&pixels[..], width, height, 1));
    let params = BlockMatchingParams { search_px: 128, ..BlockMatchingParams::default() };
    let mut matcher = BlockMatcher::new(params.clone()).expect("a matcher");
    let mut on_gpu = GpuBlockMatcher::new(gpu).expect("a matcher");
    let whole = Rect::whole(width, height);
    let mut maps = [(); 2].map(|()| vec![0.0; width * height]);
    let [a, b] = maps.each_mut();
    let mut made = vec![0; 4 * width * height];
    let mut stores: [Store; 4] = Default::default();
    let [c, d, e, f] = &mut stores;
    let given = [image(gpu, c, size, 1), image(gpu, d, size, 1)];
    let target = [image(gpu, e, size, 4), image(gpu, f, size, 4)];
    let times = beside(
        || {
            let [a, b] = [&mut *a, &mut *b].map(|map| ViewMut::new(map, width, height, 1));
            matcher.compute(left, right, whole, pool, a, Some(b)).expect("a match");
        },
        || {
            upload(gpu, &given, &pictures);
            on_gpu.compute(&params, given, whole, (target[0], Some(target[1]))).expect("a match");
            target.iter().for_each(|image| gpu.read(image.buffer, &mut made).expect("read"));
        },
    );
    print("block matching, 128 disparities", size, times);
}

fn main() {
    let pool = Threads::new(2);
    bench_sizes(|gpu, size| {
        rectify(gpu, size, 1, &pool);
        rectify(gpu, size, 2, &pool);
        matching(gpu, size, &pool);
    });
}
