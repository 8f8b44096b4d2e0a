//! Runs a graph with fingerprints of all its packets while a test disturbs it.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use panoscope_engine::fault::Fault;
use panoscope_engine::{Engine, Options, Outcome, Report};
use panoscope_record::{Digests, RecordOptions, Recorder, head};

use crate::{await_end, ready};

/// A finished run, with everything that happened.
pub struct DisturbedRun {
    /// Counters and times.
    pub report: Report,
    /// How it ended.
    pub outcome: Outcome,
    /// All faults.
    pub faults: Vec<Fault>,
    /// Fingerprint of each packet, by port and tick.
    pub packets: BTreeMap<String, BTreeMap<u64, u64>>,
}

impl DisturbedRun {
    /// Fingerprints of the packets of a port, in order.
    ///
    /// # Panics
    /// When there is no such port.
    pub fn port(&self, name: &str) -> Vec<u64> {
        let port = self.packets.get(name).unwrap_or_else(|| panic!("no port {name}"));
        port.values().copied().collect()
    }
}

/// Runs a graph text as if it were `graph.toml` in `folder`, on two threads; `disturb` is called every few milliseconds until it ends.
///
/// # Panics
/// The graph is invalid, does not start, or stands still.
pub fn run_disturbed(folder: &Path, text: &str, options: Options, disturb: impl FnMut(&Engine)) -> DisturbedRun {
    let path = folder.join("graph.toml");
    let ready = ready(&path, text).unwrap_or_else(|mistakes| panic!("{mistakes}"));
    let record = RecordOptions { digests: true, ..RecordOptions::default() };
    let recorder = Recorder::start(record, head(&ready));
    let recorder = recorder.unwrap_or_else(|error| panic!("{error}"));
    let faults = Arc::new(Mutex::new(Vec::new()));
    let heard = Arc::clone(&faults);
    let hear = move |fault: &Fault| heard.lock().expect("no panic").push(fault.clone());
    let options =
        Options { threads: 2, faults: Some(Box::new(hear)), observer: Some(Arc::clone(&recorder) as _), ..options };
    let live = ready.start(options).unwrap_or_else(|error| panic!("{error}"));
    let engine = live.engine();
    await_end(engine, disturb);
    let outcome = engine.close(Duration::from_secs(30));
    let report = engine.report();
    drop(live);
    let Digests { ports, .. } = recorder.finish().digests.expect("fingerprints");
    let packets = ports
        .into_iter()
        .map(|(name, port)| (name, port.packets.iter().map(|packet| (packet.seq, packet.hash)).collect()))
        .collect();
    let faults = faults.lock().expect("no panic").clone();
    DisturbedRun { report, outcome, faults, packets }
}
