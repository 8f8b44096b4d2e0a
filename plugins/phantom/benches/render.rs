//! Time of a stereo pair with noise, by scene: core time on one thread and wall time on two, the minimum of many runs, in ms. `cargo bench -p
//! panoscope-phantom` or, for one scene, `... -- bowel`.

use std::time::Instant;

use panoscope_base::Threads;
use panoscope_imaging::{Serial, ViewMut};
use panoscope_phantom::render::{Phantom, Rig, SceneKind, SceneParams, TruthMut};

/// CPU time of this thread so far, ns, if the system reports it (Linux). On a busy machine it is more reliable than the clock.
fn core_ns() -> Option<f64> {
    std::fs::read_to_string("/proc/thread-self/schedstat").ok()?.split(' ').next()?.parse().ok()
}

fn min_core_ms(runs: u64, mut body: impl FnMut(u64)) -> f64 {
    let mut least = f64::MAX;
    for run in 0..runs {
        let (clock, start) = (Instant::now(), core_ns());
        body(run);
        let spent =
            core_ns().zip(start).map_or(clock.elapsed().as_secs_f64() * 1e3, |(end, start)| (end - start) * 1e-6);
        least = least.min(spent);
    }
    least
}

fn min_ms(runs: u64, mut body: impl FnMut(u64)) -> f64 {
    let mut least = f64::MAX;
    for run in 0..runs {
        let start = Instant::now();
        body(run);
        least = least.min(start.elapsed().as_secs_f64() * 1e3);
    }
    least
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let pair = Threads::new(2);
    for (scene, tools) in SceneKind::ALL.map(|scene| (scene, 0)).into_iter().chain([(SceneKind::Liver, 2)]) {
        if !wanted.is_empty() && !wanted.iter().any(|w| w == scene.name()) {
            continue;
        }
        let (width, height) = (640, 480);
        let params = SceneParams { scene, tools, ..SceneParams::default() };
        let start = Instant::now();
        let mut phantom = Phantom::new(params, Rig::stereo(width, height, 15.0), &pair).expect("fixed parameters");
        let open = start.elapsed().as_secs_f64() * 1e3;
        let (mut left, mut right) = (vec![0; width * height * 3], vec![0; width * height * 3]);
        let mut views = [ViewMut::new(&mut left, width, height, 3), ViewMut::new(&mut right, width, height, 3)];
        let one = min_core_ms(25, |f| phantom.render(f, None, &Serial, &mut views).expect("fixed sizes"));
        let two = min_ms(25, |f| phantom.render(f, None, &pair, &mut views).expect("fixed sizes"));
        let mut plane = vec![0.0; width * height];
        let truth = min_ms(10, |f| {
            let disparity_px = Some(ViewMut::new(&mut plane, width, height, 1));
            phantom.truth(f, None, &pair, TruthMut { disparity_px, ..TruthMut::default() }).expect("fixed sizes");
        });
        println!(
            "{:6} {tools} tools: open {open:4.0} ms, pair {one:5.1} ms of one core, {two:5.1} ms on 2, disparity {truth:5.1} ms on 2",
            scene.name()
        );
    }
}
