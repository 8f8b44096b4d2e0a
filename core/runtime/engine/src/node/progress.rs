//! Published data of a node's calls: sizes, metrics, counts of faults.
//!
//! The running call writes; reports, previews and the scheduler read.

use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use panoscope_abi::{Frame, Tick};

use crate::exec::Exec;
use crate::fault::{CAUSES, Cause};
use crate::sync::lock;

/// Size changes that are kept: a reader may lag a few ticks behind.
const SIZE_CHANGES: usize = 8;

/// Names of metrics of one node. A longer report helps no one, and each name costs memory until the end of the run.
const MAX_METRICS: usize = 1024;

/// An output changed its size.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SizeChange {
    pub output: usize,
    pub tick: Tick,
    pub from: (u32, u32),
    pub to: (u32, u32),
}

/// Published state of a node's calls; see the module.
#[derive(Default)]
pub(crate) struct Progress {
    metrics: Mutex<Vec<(String, f64)>>,
    size_changes: Mutex<VecDeque<SizeChange>>,
    fault_counts: [AtomicU64; CAUSES],
    /// Outputs that made a packet so far, one bit each.
    ports_made: AtomicU64,
}

impl Progress {
    /// Keeps the newest value of a metric.
    pub fn set_metric(&self, name: &str, value: f64) {
        let mut metrics = lock(&self.metrics);
        let is_full = metrics.len() >= MAX_METRICS;
        match metrics.iter_mut().find(|(known, _)| known == name) {
            Some((_, newest)) => *newest = value,
            None if !is_full => metrics.push((name.to_owned(), value)),
            None => {}
        }
    }

    /// The newest value of each metric.
    pub fn metrics(&self) -> Vec<(String, f64)> {
        lock(&self.metrics).clone()
    }

    /// Records that an output changed its size.
    #[cold]
    pub fn record_size_change(&self, change: SizeChange) {
        let mut newest = lock(&self.size_changes);
        if newest.len() >= SIZE_CHANGES {
            newest.pop_front();
        }
        newest.push_back(change);
    }

    /// The first recent size change that fulfils a condition.
    pub fn find_size_change(&self, condition: impl Fn(&SizeChange) -> bool) -> Option<SizeChange> {
        lock(&self.size_changes).iter().find(|change| condition(change)).copied()
    }

    /// Records that an output made its first packet.
    pub fn record_port(&self, _exec: &mut Exec, output: usize) {
        self.ports_made.fetch_or(port_bit(output), Ordering::Relaxed);
    }

    /// Records which outputs a recording made in place of a call.
    pub fn record_ports(&self, outputs: &[Frame]) {
        let made = outputs.iter().enumerate().filter(|(_, frame)| !frame.is_empty());
        let bits = made.fold(0u64, |bits, (output, _)| bits | port_bit(output));
        self.ports_made.fetch_or(bits, Ordering::Relaxed);
    }

    /// Outputs that made a packet so far, one bit each.
    pub fn ports_made(&self) -> u64 {
        self.ports_made.load(Ordering::Relaxed)
    }

    /// Counts a fault; returns how many of its cause there are now.
    pub fn count_fault(&self, cause: Cause) -> u64 {
        self.fault_counts[cause as usize].fetch_add(1, Ordering::Relaxed) + 1
    }

    /// Faults of a cause so far.
    pub fn faults(&self, cause: Cause) -> u64 {
        self.fault_counts[cause as usize].load(Ordering::Relaxed)
    }
}

/// The bit of an output; 0 beyond the 64th.
fn port_bit(output: usize) -> u64 {
    1u64.checked_shl(output as u32).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_metrics_are_limited() {
        let progress = Progress::default();
        (0..MAX_METRICS + 5).for_each(|k| progress.set_metric(&format!("m{k}"), k as f64));
        progress.set_metric("m0", -1.0);
        let metrics = progress.metrics();
        assert_eq!((metrics.len(), metrics[0].1), (MAX_METRICS, -1.0), "known names have new values");
    }
}
