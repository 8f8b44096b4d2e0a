//! Time of a stereo pair with noise, by scene: core time on one thread and wall time on two, the least of many
//! runs, in ms.
//!
//! `cargo bench -p panoscope-phantom` or, for one scene, `... -- bowel`.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Instant;

use panoscope_imaging::{Parallel, Serial, ViewMut};
use panoscope_phantom::render::{Phantom, Rig, SceneKind, SceneParams, TruthMut};

/// One helper thread that takes chunks beside the caller.
struct Pair {
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    job: Mutex<(u64, Option<Job>)>,
    ready: Condvar,
    next: AtomicUsize,
    helpers: AtomicUsize,
}

#[derive(Clone, Copy)]
struct Job {
    chunks: usize,
    body: *const (dyn Fn(usize) + Sync),
}

// SAFETY: the body outlives the loop: `run` returns only when the helper has left it.
unsafe impl Send for Job {}

fn work(shared: &Shared, job: Job) {
    loop {
        let chunk = shared.next.fetch_add(1, Ordering::AcqRel);
        if chunk >= job.chunks {
            return;
        }
        // SAFETY: see `Job`.
        unsafe { (*job.body)(chunk) };
    }
}

impl Pair {
    fn new() -> Self {
        let shared = Arc::<Shared>::default();
        let mine = Arc::clone(&shared);
        std::thread::spawn(move || {
            let mut done = 0;
            loop {
                let mut job = mine.job.lock().unwrap();
                while job.0 == done || job.1.is_none() {
                    job = mine.ready.wait(job).unwrap();
                }
                done = job.0;
                let Some(todo) = job.1 else { continue };
                mine.helpers.fetch_add(1, Ordering::AcqRel);
                drop(job);
                work(&mine, todo);
                mine.helpers.fetch_sub(1, Ordering::AcqRel);
            }
        });
        Self { shared }
    }
}

impl Parallel for Pair {
    fn threads(&self) -> usize {
        2
    }
    fn run(&self, chunks: usize, body: &(dyn Fn(usize) + Sync)) {
        // SAFETY: only the lifetime is forgotten; see `Job`.
        let body: *const (dyn Fn(usize) + Sync) = unsafe { std::mem::transmute(body) };
        let job = Job { chunks, body };
        self.shared.next.store(0, Ordering::Release);
        {
            let mut slot = self.shared.job.lock().unwrap();
            *slot = (slot.0 + 1, Some(job));
        }
        self.shared.ready.notify_one();
        work(&self.shared, job);
        self.shared.job.lock().unwrap().1 = None;
        while self.shared.helpers.load(Ordering::Acquire) != 0 {
            std::hint::spin_loop();
        }
    }
}

/// Time this thread spent on a core so far, ns, where the system tells (Linux): says more than the clock on a
/// busy machine.
fn core_ns() -> Option<f64> {
    std::fs::read_to_string("/proc/thread-self/schedstat").ok()?.split(' ').next()?.parse().ok()
}

fn least_core_ms(runs: u64, mut body: impl FnMut(u64)) -> f64 {
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

fn least_ms(runs: u64, mut body: impl FnMut(u64)) -> f64 {
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
    let pair = Pair::new();
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
        let one = least_core_ms(25, |f| phantom.render(f, None, &Serial, &mut views).expect("fixed sizes"));
        let two = least_ms(25, |f| phantom.render(f, None, &pair, &mut views).expect("fixed sizes"));
        let mut plane = vec![0.0; width * height];
        let truth = least_ms(10, |f| {
            let disparity_px = Some(ViewMut::new(&mut plane, width, height, 1));
            phantom.truth(f, None, &pair, TruthMut { disparity_px, ..TruthMut::default() }).expect("fixed sizes");
        });
        println!(
            "{:6} {tools} tools: open {open:4.0} ms, pair {one:5.1} ms of one core, {two:5.1} ms on 2, disparity {truth:5.1} ms on 2",
            scene.name()
        );
    }
}
