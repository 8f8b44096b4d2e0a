//! Time of a frame on the GPU, its way there and back included, and that of the processor on two threads: the median of
//! 30, both by turns. A word as argument picks the sizes that hold it: `PANOSCOPE_GPU=nvidia cargo bench -p
//! panoscope-stitch -- 3840`.

#[path = "../../../tests/support/gpu.rs"]
mod support;

use panoscope_base::Threads;
use panoscope_imaging::stitch::*;
use panoscope_imaging::{Parallel, View, ViewMut};
use panoscope_node::device::{Gpu, Store};
use panoscope_stitch::gpu::warp::{SharedFrame, Warper, locked};
use support::{bench_sizes, beside, image, print, upload, waves};

fn panorama(gpu: Gpu, size: (usize, usize), pool: &dyn Parallel) {
    let (width, height) = size;
    let k = width as f64 / 640.0;
    let params = CompositeParams {
        seam: SeamMethod::DynamicProgramming,
        blend: BlendMethod::Feather,
        blend_px: 24,
        ..CompositeParams::default()
    };
    let pictures = [waves(size, 0), waves(size, (290.0 * k) as usize)];
    let views = pictures.each_ref().map(|pixels| View::new(&pixels[..], width, height, 3));
    let plane = [1.0, 0.0, 290.0 * k, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let cell_px = (20.0 * k) as usize;
    let mut compositors = [Compositor::new(params.clone()), Compositor::new(params)];
    let images = SharedFrame::default();
    let mut stores: [Store; 2] = Default::default();
    let [a, b] = &mut stores;
    let held = [image(gpu, a, size, 3), image(gpu, b, size, 3)];
    locked(&images).views = held.to_vec();
    let warper = Warper::new(gpu, images).expect("a warper");
    compositors[1].set_painter(Some(Box::new(warper)));
    let mut frame = 0;
    let mut outs = [Vec::new(), Vec::new()];
    let [first, second] = &mut compositors;
    let [out, made] = &mut outs;
    let mut compose = |compositor: &mut Compositor, out: &mut Vec<u8>| {
        if compositor.has_painter() {
            upload(gpu, &held, &pictures);
        }
        // Another mesh in each frame, as of moving cameras.
        frame += 1;
        let lattice = Lattice { cell_px, first: [10, -1], columns: 42, rows: height / cell_px + 3 };
        let wave = |x: f64, y: f64| k * (2.0 + 0.1 * f64::from(frame % 7)) * ((x / 80.0).sin() + (y / 60.0).cos());
        let mesh = Mesh::new(lattice, |[x, y]| [x - 290.0 * k + wave(x / k, y / k), y]).expect("a mesh");
        compositor.set_mesh(1, Some(&mesh));
        let canvas = compositor.canvas(&views, &[IDENTITY, plane], GeometryState::Fresh).expect("a canvas");
        out.resize(canvas.width * canvas.height * 3, 0);
        let mut target = ViewMut::new(out, canvas.width, canvas.height, 3);
        let given = [IDENTITY, plane];
        compositor.compose(&views, &given, GeometryState::Fresh, pool, &mut target, None).expect("a panorama");
        assert!(compositor.take_painter_fault().is_none(), "the GPU draws");
    };
    let compose = std::cell::RefCell::new(&mut compose);
    let times = beside(|| (compose.borrow_mut())(first, out), || (compose.borrow_mut())(second, made));
    print("panorama by a mesh", size, times);
}

fn main() {
    let pool = Threads::new(2);
    bench_sizes(|gpu, size| panorama(gpu, size, &pool));
}
