//! A thread that finishes the files of running graphs when the thread that ends the process cannot.

use std::sync::atomic::{AtomicBool, AtomicI32, AtomicPtr, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

use super::line::Line;
use crate::clock;
use crate::current_node::{NodeNames, thread_id};
use crate::fault::{Action, Cause, Fault, unix_ms};
use crate::log;
use crate::node::NodeRuntime;
use crate::schedule::Shared;
use crate::sync::lock;

/// Time limit for finishing files, because the crashed code may hold locks.
pub(super) const LIMIT: Duration = Duration::from_secs(5);

/// Time limit for passing on log lines and faults.
pub(super) const LINES: Duration = Duration::from_millis(500);

/// Pipe on which the rescue thread waits, because a signal handler can write to a pipe.
static WAKE: AtomicI32 = AtomicI32::new(-1);
static THREAD: AtomicI32 = AtomicI32::new(0);
static DONE: AtomicBool = AtomicBool::new(false);
/// The node that crashed, if any.
static VICTIM: AtomicPtr<NodeNames> = AtomicPtr::new(std::ptr::null_mut());

/// Graphs that run.
static ENGINES: Mutex<Vec<Weak<Shared>>> = Mutex::new(Vec::new());

/// Registers a running graph.
pub(crate) fn register(shared: &Arc<Shared>) {
    let mut engines = lock(&ENGINES);
    engines.retain(|engine| engine.strong_count() > 0);
    engines.push(Arc::downgrade(shared));
}

/// Whether a graph runs.
pub(super) fn any_engine() -> bool {
    ENGINES.try_lock().is_ok_and(|engines| engines.iter().any(|engine| engine.strong_count() > 0))
}

/// Starts the thread. Without it nothing is finished after a crash, but everything else works.
pub(super) fn start() {
    let mut ends = [-1; 2];
    // SAFETY: a plain system call that fills the array.
    if unsafe { libc::pipe2(ends.as_mut_ptr(), libc::O_CLOEXEC) } != 0 {
        return;
    }
    let wait = move || {
        THREAD.store(thread_id(), Ordering::Relaxed);
        let mut byte = 0u8;
        // SAFETY: reads one byte into a byte.
        while unsafe { libc::read(ends[0], (&raw mut byte).cast(), 1) } < 1 {}
        let victim = VICTIM.load(Ordering::Acquire);
        let told = std::panic::catch_unwind(|| finish(victim, Instant::now() + LIMIT));
        let mut words = Line::new();
        words.text(told.as_deref().unwrap_or("  files: may be incomplete, finishing them failed")).print();
        words.text(&last_line()).print();
        DONE.store(true, Ordering::Release);
    };
    if std::thread::Builder::new().name("rescue".to_owned()).spawn(wait).is_ok() {
        WAKE.store(ends[1], Ordering::Release);
    }
}

/// Another thread crashed. If it is the rescue thread, waiting for it ends.
pub(super) fn crashed(thread: i32) {
    if thread == THREAD.load(Ordering::Relaxed) {
        DONE.store(true, Ordering::Release);
    }
}

/// Has the rescue thread finish the files of all other nodes and waits for it. Called in the signal handler of the
/// thread that crashed.
pub(super) fn after_crash(victim: Option<&NodeNames>) {
    VICTIM.store(victim.map_or(std::ptr::null_mut(), |who| std::ptr::from_ref(who).cast_mut()), Ordering::Release);
    let pipe = WAKE.load(Ordering::Acquire);
    // SAFETY: writes one byte that is there; allowed in a signal handler.
    if pipe < 0 || unsafe { libc::write(pipe, b"!".as_ptr().cast(), 1) } != 1 {
        return;
    }
    let steps = LIMIT.as_millis() / STEP_MS + 100;
    for _ in 0..steps {
        if DONE.load(Ordering::Acquire) {
            return;
        }
        // SAFETY: waits; allowed in a signal handler.
        unsafe { libc::poll(std::ptr::null_mut(), 0, STEP_MS as i32) };
    }
    Line::new().text("  files: may be incomplete, completing them took too long").print();
}

const STEP_MS: u128 = 10;

/// Finishes the files of all graphs on the calling thread. Returns a text for the user.
pub(super) fn ask(limit: Duration) -> String {
    finish(std::ptr::null_mut(), Instant::now() + limit)
}

/// Closes all nodes that write, except the crashed one, and ends the recordings.
fn finish(victim: *const NodeNames, until: Instant) -> String {
    let engines: Vec<Arc<Shared>> = loop {
        // The thread that crashed may hold it.
        match ENGINES.try_lock() {
            Ok(engines) => break engines.iter().filter_map(Weak::upgrade).collect(),
            Err(_) if Instant::now() < until => std::thread::sleep(Duration::from_millis(1)),
            Err(_) => return "  files: may be incomplete, completing them took too long".to_owned(),
        }
    };
    let (mut finished, mut torn) = (Vec::new(), Vec::new());
    for shared in &engines {
        shared.stop();
        let plan = shared.plan.load_full();
        if let Some((_, runtime)) = plan.live().find(|(_, runtime)| Arc::as_ptr(&runtime.who) == victim) {
            record_crash(shared, runtime);
        }
        for (_, runtime) in plan.live().filter(|(_, runtime)| runtime.side_effects) {
            let list = if close(shared, runtime, victim, until) { &mut finished } else { &mut torn };
            list.push(format!("`{}`", runtime.id));
        }
        if let Some(observer) = &shared.context.observer {
            let list = if observer.break_off(until) { &mut finished } else { &mut torn };
            list.push("the recording".to_owned());
        }
    }
    log::flush_all(LINES);
    let list = |names: &[String]| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    match (engines.is_empty(), torn.is_empty()) {
        (true, _) => "  files: no graph was running".to_owned(),
        (false, true) => format!("  files: finished are those of {}", list(&finished)),
        (false, false) => {
            format!("  files: finished are those of {}; may be incomplete: those of {}", list(&finished), list(&torn))
        }
    }
}

/// The last line of a run that was ended by force.
fn last_line() -> String {
    let engines = ENGINES.try_lock().map(|engines| engines.iter().filter_map(Weak::upgrade).collect::<Vec<_>>());
    let (mut frames, mut dropped, mut faults) = (0, 0, 0);
    for shared in engines.unwrap_or_default() {
        let plan = shared.plan.load();
        frames += plan.live().map(|(_, runtime)| runtime.ticks.made()).max().unwrap_or(0);
        for (_, runtime) in plan.live() {
            dropped += runtime.stats.dropped.load(Ordering::Relaxed);
            faults += runtime.stats.faults.load(Ordering::Relaxed);
        }
    }
    format!("failed: the program was ended after {frames} frames, {dropped} dropped, {faults} faults")
}

/// Completes a node's files and closes it once it is at rest; `false` if it crashed, does not come to rest, or fails.
fn close(shared: &Shared, runtime: &NodeRuntime, victim: *const NodeNames, until: Instant) -> bool {
    if Arc::as_ptr(&runtime.who) == victim {
        return false;
    }
    loop {
        // Ticks that wait for it are written first, as long as there is time.
        let idle = runtime.join.try_lock().is_ok_and(|join| !join.is_running());
        if idle && let Some(mut exec) = runtime.exec.take() {
            runtime.finish(&shared.context, &mut exec.instance);
            exec.instance.close();
            // Not put back, so that no thread runs the node again.
            std::mem::forget(exec);
            return !lock(&shared.context.stopped).contains_key(&runtime.id);
        }
        if Instant::now() >= until {
            return false;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Adds the crash to the faults, the fault log and the recording.
fn record_crash(shared: &Shared, runtime: &NodeRuntime) {
    let fault = Fault {
        unix_ms: unix_ms(),
        run_ms: clock::now_ns().saturating_sub(shared.start_ns) as f64 / 1e6,
        node: runtime.id.clone(),
        cause: Cause::Crash,
        words: "its plugin ended the program".to_owned(),
        done: Action::Stop,
        seq: Some(runtime.busy.tick().seq),
        late_ms: None,
        count: 1,
    };
    if let Some(observer) = &shared.context.observer {
        observer.event(crate::observe::Event::Fault(fault.clone()));
    }
    shared.context.faults.put(fault);
}
