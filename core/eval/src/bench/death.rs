//! Time until the death of an isolated node's process is detected, and until its nodes work again.

use std::time::{Duration, Instant};

use panoscope_engine::Engine;

use super::graph::{self, Pace};
use crate::error::Result;
use crate::figures::Figure;
use crate::run;
use crate::session::{Session, check_cancelled, note};
use crate::statistics::percentile;
use crate::system;

const RATE_HZ: f64 = 100.0;
/// Time between two kills, longer than the host waits before it starts a process that died for the first time.
const BETWEEN: Duration = Duration::from_millis(1_500);
/// Maximum recovery time; a longer one counts as this.
const PATIENCE: Duration = Duration::from_secs(10);

/// Kills the process of a node repeatedly while frames pass through it.
pub fn measure(session: &dyn Session, quick: bool) -> Result<Vec<Figure>> {
    let kills = if quick { 5 } else { 60 };
    let text = graph::isolated(&graph::chain("pass", 1, None, Pace::Hz(RATE_HZ)), "n0");
    let engine = graph::start(session, &text, None)?;
    let (mut noticed_ms, mut back_ms) = (Vec::new(), Vec::new());
    for _ in 0..kills {
        check_cancelled(session)?;
        let until = Instant::now() + PATIENCE;
        wait(until, || State::of(&engine).process_id.is_some());
        std::thread::sleep(BETWEEN);
        let before = State::of(&engine);
        let Some(id) = before.process_id else { continue };
        let killed = Instant::now();
        if !system::kill(id) {
            continue;
        }
        let until = killed + PATIENCE;
        wait(until, || State::of(&engine).faults > before.faults);
        noticed_ms.push(killed.elapsed().as_secs_f64() * 1e3);
        wait(until, || State::of(&engine).processes > before.processes);
        let reopened = State::of(&engine);
        wait(until, || State::of(&engine).delivered > reopened.delivered);
        back_ms.push(killed.elapsed().as_secs_f64() * 1e3);
    }
    engine.stop();
    run::close(&engine)?;
    note!(session, "{} processes of an isolated node killed at {RATE_HZ} frames a second", back_ms.len());
    let figure = |name: &str, values: &[f64], share: f64, input: &str| {
        Figure::new(&format!("isolated_death/{name}"), percentile(values, share), "ms", input)
    };
    let (noticed, back) = ("SIGKILL to the fault of its node", "SIGKILL to the next frame from a new process");
    Ok(vec![
        figure("noticed_p50", &noticed_ms, 0.5, noticed),
        figure("noticed_p99", &noticed_ms, 0.99, noticed),
        figure("next_frame_p50", &back_ms, 0.5, back),
        figure("next_frame_p99", &back_ms, 0.99, back),
    ])
}

struct State {
    process_id: Option<u32>,
    processes: u64,
    faults: u64,
    delivered: u64,
}

impl State {
    fn of(engine: &Engine) -> Self {
        let report = engine.report();
        let group = report.groups.values().next();
        Self {
            process_id: group.and_then(|group| group.process_id),
            processes: group.map_or(0, |group| group.processes),
            faults: report.nodes.get("n0").map_or(0, |node| node.faults),
            delivered: report.nodes.get("sink").map_or(0, |sink| sink.count),
        }
    }
}

/// Waits until `is_so` or a time; polls five times per millisecond.
fn wait(until: Instant, is_so: impl Fn() -> bool) {
    while !is_so() && Instant::now() < until {
        std::thread::sleep(Duration::from_micros(200));
    }
}
