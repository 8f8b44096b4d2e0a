//! Time of a frame on the GPU, its way there and back included, and that of the processor on two threads: the median of
//! 30, both by turns. A word as argument picks the sizes that hold it: `PANOSCOPE_GPU=nvidia cargo bench -p
//! panoscope-gpu -- 3840`.

use std::sync::Arc;
use std::time::Instant;

use panoscope_base::Threads;
use panoscope_gpu::{CHOICE, Gpu, GpuBlockMatcher, Rectifier, RectifyJob, Warper};
use panoscope_imaging::stereo::{BlockMatcher, BlockMatchingParams, CameraModel, RectifiedCamera, RemapTable};
use panoscope_imaging::stitch::*;
use panoscope_imaging::{Parallel, Rect, View, ViewMut};

const ROUNDS: usize = 30;

/// Waves and blocks: edges at all scales.
fn picture((width, height): (usize, usize), shift: usize) -> Vec<u8> {
    let at = |x: usize, y: usize| {
        let (u, v) = ((x + shift) as f64, y as f64);
        let wave = 40.0 * (0.021 * u + 0.3 * (0.013 * v).sin()).sin() + 25.0 * (0.11 * v + 0.017 * u).sin();
        let block = ((u / 23.0).floor() as i64 * 7919 + (v / 19.0).floor() as i64 * 104_729).rem_euclid(41) as f64;
        [100.0, 90.0, 150.0].map(|c| (c + wave + block).clamp(0.0, 255.0) as u8)
    };
    (0..height).flat_map(|y| (0..width).flat_map(move |x| at(x, y))).collect()
}

/// Medians of two ways to do the same, by turns, ms.
fn beside(mut first: impl FnMut(), mut second: impl FnMut()) -> [f64; 2] {
    let mut times = [Vec::new(), Vec::new()];
    for round in 0..ROUNDS + 3 {
        for (way, times) in times.iter_mut().enumerate() {
            let start = Instant::now();
            if way == 0 {
                first()
            } else {
                second()
            }
            // The first rounds fill caches and make memory.
            if round >= 3 {
                times.push(start.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
    times.map(|mut times| {
        times.sort_unstable_by(f64::total_cmp);
        times[times.len() / 2]
    })
}

fn print(name: &str, size: (usize, usize), [cpu, gpu]: [f64; 2]) {
    println!("{name:<32} {:>4}x{:<4} {cpu:9.2} ms {gpu:9.2} ms {:7.2}", size.0, size.1, cpu / gpu);
}

fn rectify(gpu: &Arc<Gpu>, size: (usize, usize), factor: usize, pool: &dyn Parallel) {
    let (width, height) = (size.0 / factor, size.1 / factor);
    let focal = width as f64;
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    let barrel = [-0.1, 0.0, 0.0, 0.0];
    let camera = CameraModel::new((width, height), (focal, focal), (cx, cy), &barrel).expect("a camera");
    let eye = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let target = RectifiedCamera { focal_px: focal, cx, cy };
    let whole = Rect::whole(width, height);
    let map = RemapTable::new(&camera, &eye, target, (width, height), whole, pool).expect("a map");
    let mut rectifier = Rectifier::new(gpu.clone(), factor, Some([&map, &map])).expect("a rectifier");
    let pictures = [picture(size, 0), picture(size, 40)];
    let views = pictures.each_ref().map(|pixels| View::new(&pixels[..], size.0, size.1, 3));
    let bytes = width * height * 3;
    let (mut small, mut out, mut made) =
        (vec![0; bytes], [vec![0; bytes], vec![0; bytes]], [vec![0; bytes], vec![0; bytes]]);
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
            let [left, right] = made.each_mut().map(|out| ViewMut::new(out, width, height, 3));
            let jobs = [RectifyJob { view: views[0], out: left }, RectifyJob { view: views[1], out: right }];
            rectifier.run(jobs.map(Some), pool).expect("rectified");
        },
    );
    print(&format!("rectify both views, scale {factor}"), size, times);
}

fn panorama(gpu: &Arc<Gpu>, size: (usize, usize), pool: &dyn Parallel) {
    let (width, height) = size;
    let k = width as f64 / 640.0;
    let params = CompositeParams {
        seam: SeamMethod::DynamicProgramming,
        blend: BlendMethod::Feather,
        blend_px: 24,
        ..CompositeParams::default()
    };
    let pictures = [picture(size, 0), picture(size, (290.0 * k) as usize)];
    let views = pictures.each_ref().map(|pixels| View::new(&pixels[..], width, height, 3));
    let plane = [1.0, 0.0, 290.0 * k, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let cell_px = (20.0 * k) as usize;
    let mut compositors = [Compositor::new(params.clone()), Compositor::new(params)];
    let warper = Warper::new(gpu.clone()).expect("a warper");
    compositors[1].set_painter(Some(Box::new(warper)));
    let mut frame = 0;
    let mut outs = [Vec::new(), Vec::new()];
    let [first, second] = &mut compositors;
    let [out, made] = &mut outs;
    let mut compose = |compositor: &mut Compositor, out: &mut Vec<u8>| {
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

fn matching(gpu: &Arc<Gpu>, size: (usize, usize), pool: &dyn Parallel) {
    let (width, height) = size;
    let gray = |shift: usize| -> Vec<u8> { picture(size, shift).as_chunks::<3>().0.iter().map(|p| p[1]).collect() };
    let pictures = [gray(0), gray(width / 20)];
    let [left, right] = pictures.each_ref().map(|pixels| View::new(&pixels[..], width, height, 1));
    let params = BlockMatchingParams { search_px: 128, ..BlockMatchingParams::default() };
    let mut matcher = BlockMatcher::new(params.clone()).expect("a matcher");
    let mut on_gpu = GpuBlockMatcher::new(gpu.clone()).expect("a matcher");
    let whole = Rect::whole(width, height);
    let mut maps = [(); 4].map(|()| vec![0.0; width * height]);
    let [a, b, c, d] = maps.each_mut();
    let times = beside(
        || {
            let [a, b] = [&mut *a, &mut *b].map(|map| ViewMut::new(map, width, height, 1));
            matcher.compute(left, right, whole, pool, a, Some(b)).expect("a match");
        },
        || {
            let [mut c, mut d] = [&mut *c, &mut *d].map(|map| ViewMut::new(map, width, height, 1));
            on_gpu.compute(&params, left, right, whole, &mut c, Some(&mut d), pool).expect("a match");
        },
    );
    print("block matching, 128 disparities", size, times);
}

fn main() {
    let choice = std::env::var(CHOICE).ok();
    let gpu = match Gpu::open(choice.as_deref()) {
        Ok(gpu) => Arc::new(gpu),
        Err(e) => return panoscope_testing::skipped!("{e}"),
    };
    let pool = Threads::new(2);
    println!("{}\n{:<32} {:>9} {:>12} {:>12} {:>7}", gpu.name(), "", "views", "processor", "GPU", "times");
    for size in [(640, 480), (1920, 1080), (3840, 2160)] {
        let case = format!("{}x{}", size.0, size.1);
        if std::env::args().skip(1).any(|word| !word.starts_with("--") && !case.contains(&word)) {
            continue;
        }
        rectify(&gpu, size, 1, &pool);
        rectify(&gpu, size, 2, &pool);
        matching(&gpu, size, &pool);
        panorama(&gpu, size, &pool);
    }
}
