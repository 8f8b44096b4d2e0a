//! Graphs of test frames and pass-through nodes, made as TOML text and run by the real engine.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use panoscope_engine::{Engine, Options, Report};
use panoscope_graph::GraphText;

use crate::error::Result;
use crate::run;
use crate::session::{Session, check_cancelled};
use crate::system::usage;

/// Frame format of every hop.
pub const INPUT: &str = "640x480 bgr8";

/// Pace of the frames.
#[derive(Clone, Copy)]
pub enum Pace {
    /// As fast as they are accepted, none lost.
    Saturated,
    /// Live, at this many frames per second.
    Hz(f64),
}

/// `frames` -> `count` nodes of type `node` in a row -> `drain`.
pub fn chain(node: &str, count: usize, queue: Option<u32>, pace: Pace) -> String {
    let mut text = head(pace);
    let mut last = "source".to_owned();
    for index in 0..count {
        let _ = write!(text, "[nodes.n{index}]\ntype = \"{node}\"\ninputs = {{ image = {} }}\n", edge(&last, queue));
        last = format!("n{index}");
    }
    let _ = write!(text, "[nodes.sink]\ntype = \"drain\"\ninputs = {{ image = {} }}\n", edge(&last, queue));
    text
}

/// A graph text with one of its nodes in a separate process.
pub fn isolated(text: &str, node: &str) -> String {
    text.replacen(&format!("[nodes.{node}]\n"), &format!("[nodes.{node}]\nisolate = \"bench\"\n"), 1)
}

/// `frames` -> `pass` -> as many `drain` nodes side by side.
pub fn fan_out(readers: usize) -> String {
    let mut text = head(Pace::Saturated);
    text.push_str("[nodes.n0]\ntype = \"pass\"\ninputs = { image = \"source.image\" }\n");
    for index in 0..readers {
        let _ = write!(text, "[nodes.sink{index}]\ntype = \"drain\"\ninputs = {{ image = \"n0.image\" }}\n");
    }
    text
}

fn head(pace: Pace) -> String {
    let (mode, rate) = match pace {
        Pace::Saturated => ("batch", 30.0),
        Pace::Hz(rate) => ("live", rate),
    };
    format!(
        "mode = \"{mode}\"\nplugins = [\"flow\"]\n[nodes.source]\ntype = \"frames\"\nparams = {{ pattern = \"none\", rate_hz = {rate:?} }}\n"
    )
}

fn edge(from: &str, queue: Option<u32>) -> String {
    match queue {
        Some(queue) => format!("{{ from = \"{from}.image\", queue = {queue} }}"),
        None => format!("\"{from}.image\""),
    }
}

/// Cost of a run.
pub struct Run {
    /// Counters of the engine.
    pub report: Report,
    /// Processor time of the whole process, all threads.
    pub cpu_seconds: f64,
    /// Times a thread gave its core up to wait.
    pub waits: u64,
}

impl Run {
    /// Wall time per tick.
    pub fn ns_per_tick(&self) -> f64 {
        self.report.seconds * 1e9 / self.report.frames.max(1) as f64
    }
}

/// Runs a graph for `frames` frames.
pub fn run(session: &dyn Session, text: &str, frames: u64) -> Result<Run> {
    let before = usage();
    let engine = start(session, text, Some(frames))?;
    engine.watch(Duration::from_millis(100), |_| check_cancelled(session))?;
    let report = run::close(&engine)?;
    let after = usage();
    Ok(Run {
        report,
        cpu_seconds: after.cpu_seconds - before.cpu_seconds,
        waits: after.voluntary_waits - before.voluntary_waits,
    })
}

/// Starts a graph, for a number of frames or until it is stopped.
pub fn start(session: &dyn Session, text: &str, frames: Option<u64>) -> Result<Arc<Engine>> {
    check_cancelled(session)?;
    let ready = run::ready(&GraphText::parse(Path::new("bench.toml"), text))?;
    let counters = session.allocation_counters();
    let options = Options {
        frames,
        process_allocations: counters.process,
        thread_allocations: counters.thread,
        ..Options::default()
    };
    Ok(Arc::clone(ready.start(options)?.engine()))
}
