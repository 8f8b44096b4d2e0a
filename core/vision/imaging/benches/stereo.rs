//! Times of the stereo chain at 640x480 and 64 disparities on a synthetic pair, on one and two threads.

use panoscope_base::Threads;
use panoscope_imaging::stereo::{
    BilateralSolver, BilateralSolverParams, BlockMatcher, BlockMatchingParams, CameraModel, FilterInput, Rectification,
    RectifyParams, RemapTable, ReprojectInput, ReprojectParams, SemiGlobalMatcher, SemiGlobalParams, SmallHoles,
    StereoCameras, WlsFilter, WlsParams, reproject,
};
use panoscope_imaging::{Parallel, Rect, View, ViewMut};
use std::time::Instant;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const RUNS: usize = 40;

fn texture(x: f64, y: f64) -> u8 {
    let waves = [(0.11, 0.07, 40.0), (0.31, -0.23, 30.0), (0.05, 0.41, 25.0), (0.83, 0.57, 18.0), (1.9, 1.3, 10.0)];
    let sum: f64 = waves.iter().map(|(u, v, size)| size * (u * x + v * y + (0.03 * x * v).sin() * 3.0).sin()).sum();
    (128.0 + sum).clamp(0.0, 255.0) as u8
}

fn time(name: &str, mut body: impl FnMut()) -> f64 {
    body();
    let mut times: Vec<f64> = (0..RUNS)
        .map(|_| {
            let start = Instant::now();
            body();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!("  {name:<32} min {:7.3} ms   median {:7.3} ms", times[0], times[RUNS / 2]);
    times[0]
}

fn all(pool: &dyn Parallel) {
    println!("{} thread(s), {WIDTH}x{HEIGHT}, 64 disparities", pool.threads());
    let n = WIDTH * HEIGHT;
    let depth = |x: f64, y: f64| 30.0 + 12.0 * (x / 90.0).sin() + 8.0 * (y / 70.0).cos();
    let right: Vec<u8> = (0..n).map(|i| texture((i % WIDTH) as f64, (i / WIDTH) as f64)).collect();
    let left: Vec<u8> = (0..n)
        .map(|i| {
            let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
            texture(x - depth(x, y), y)
        })
        .collect();
    let bgr: Vec<u8> = left.iter().flat_map(|value| [value / 2, *value, value.saturating_add(20)]).collect();
    let roi = Rect::whole(WIDTH, HEIGHT);
    let view = |data| View::<u8>::new(data, WIDTH, HEIGHT, 1);
    fn map_view(data: &[f32]) -> View<'_, f32> {
        View::new(data, WIDTH, HEIGHT, 1)
    }
    let mut maps = vec![vec![0.0f32; n]; 6];
    let [raw, raw_right, smooth, confidence, solved, depth_map] = &mut maps[..] else { return };
    fn out(data: &mut [f32]) -> ViewMut<'_, f32> {
        ViewMut::new(data, WIDTH, HEIGHT, 1)
    }

    let camera = CameraModel::new((WIDTH, HEIGHT), (750.0, 750.0), (320.0, 240.0), &[-0.2, 0.05, 0.0, 0.0]);
    let turn = [[0.9998, -0.02, 0.0], [0.02, 0.9998, 0.0], [0.0, 0.0, 1.0]];
    if let Ok(camera) = camera {
        let cameras = StereoCameras {
            left: camera.clone(),
            right: camera.clone(),
            rotation: turn,
            translation_mm: [-15.0, 0.1, 0.1],
        };
        if let Ok(rectification) = Rectification::new(&cameras, RectifyParams::default())
            && let Ok(map) = RemapTable::left(&camera, &rectification, roi, pool)
        {
            let mut target = vec![0; 3 * n];
            time("rectify one view, BGR", || {
                let _ = map.remap(View::new(&bgr, WIDTH, HEIGHT, 3), ViewMut::new(&mut target, WIDTH, HEIGHT, 3), pool);
            });
            time("rectify one view, gray", || {
                let _ = map.remap(view(&left), ViewMut::new(&mut target[..n], WIDTH, HEIGHT, 1), pool);
            });
            let params = ReprojectParams::default();
            raw.fill(30.0);
            time("reproject, depth only", || {
                let input = ReprojectInput { disparity: map_view(raw), confidence: None, roi };
                let _ = reproject(input, &rectification, &params, pool, out(depth_map), None);
            });
        }
    }
    let (Ok(mut semi), Ok(mut block), Ok(mut wls), Ok(mut solver)) = (
        SemiGlobalMatcher::new(SemiGlobalParams::default()),
        BlockMatcher::new(BlockMatchingParams::default()),
        WlsFilter::new(WlsParams::default()),
        BilateralSolver::new(BilateralSolverParams::default()),
    ) else {
        return;
    };
    time("semi-global left + right", || {
        let _ = semi.compute(view(&left), view(&right), roi, pool, out(raw), Some(out(raw_right)));
    });
    let mut total = time("block matching left + right", || {
        let _ = block.compute(view(&left), view(&right), roi, pool, out(raw), Some(out(raw_right)));
    });
    total += time("weighted least squares", || {
        let guide = View::new(&bgr, WIDTH, HEIGHT, 3);
        let (disparity, right) = (map_view(raw), Some(map_view(raw_right)));
        let input = FilterInput { guide, disparity, disparity_right: right, confidence: None, roi };
        let _ = wls.compute(input, pool, out(smooth), Some(out(confidence)));
    });
    total += time("bilateral solver, cold", || {
        solver.reset();
        let guide = View::new(&bgr, WIDTH, HEIGHT, 3);
        let (disparity, trust) = (map_view(smooth), Some(map_view(confidence)));
        let input = FilterInput { guide, disparity, disparity_right: None, confidence: trust, roi };
        let _ = solver.compute(input, pool, out(solved), None);
    });
    println!("  chain (sum of the last three)    min {total:7.3} ms   {} vertices", solver.vertices());
    // What the match alone leaves open has the most holes.
    let (focal_px, baseline_mm) = (750.0, 15.0);
    depth_map.iter_mut().zip(&*raw).for_each(|(depth, disparity)| *depth = focal_px * baseline_mm / disparity);
    let mut holes = SmallHoles::default();
    let mut count = 0;
    time("small holes of a surface", || count = holes.find(map_view(depth_map), focal_px, baseline_mm, 0.0015).len());
    println!("  filled points                    {count}");
}

fn main() {
    all(&panoscope_imaging::Serial);
    all(&Threads::new(2));
}
