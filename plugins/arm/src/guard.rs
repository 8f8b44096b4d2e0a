//! How both drivers use the interlock: they hand it tips, latch and release stops, and report why it stopped.

use std::time::Duration;

use panoscope_arm_core::Interlock;
use panoscope_arm_core::interlock::{Cause, Evidence};
use panoscope_node::abi::Tip;
use panoscope_node::{Context, Timed};

/// Latches and releases stops according to a driver's parameters.
#[derive(Clone, Copy, Debug, Default)]
pub struct Switches {
    reset: Option<u64>,
}

impl Switches {
    /// Latches while `emergency_stop` is on; releases when `reset` changes while it is off.
    pub fn obey(&mut self, lock: &mut Interlock, emergency_stop: bool, reset: u64) {
        let is_new = self.reset.replace(reset).is_some_and(|old| old != reset);
        if emergency_stop {
            lock.latch(Cause::EmergencyStop);
        } else if is_new {
            lock.release();
        }
    }
}

/// The part of a tip that the interlock checks.
pub fn evidence(tip: &Tip) -> Evidence {
    Evidence { score: tip.score, in_space: tip.xyz_valid == 1 && tip.xyz_mm.iter().all(|v| v.is_finite()) }
}

/// Age of a packet's light, ns; the maximum where it is unknown.
pub fn age_ns(cx: &Context<'_>, packet: &impl Timed) -> i64 {
    duration_ns(cx.age(packet))
}

/// Converts a time to ns; saturates at the maximum.
pub fn duration_ns(time: Duration) -> i64 {
    i64::try_from(time.as_nanos()).unwrap_or(i64::MAX)
}

/// Replaces the content of `text` with a description of the state.
pub fn words(stop: Option<Cause>, latched: bool, text: &mut String) {
    text.clear();
    text.push_str(match stop {
        None => "arm follows",
        Some(_) if latched => "ARM STOPPED: ",
        Some(_) => "arm waits: ",
    });
    text.push_str(stop.map_or("", Cause::words));
}

/// Writes events to the host's log; stops are warnings.
pub fn log_events(cx: &Context<'_>, lock: &mut Interlock) {
    while let Some(event) = lock.take_event() {
        if event.stop.is_some() { cx.warn(&event.to_string()) } else { cx.info(&event.to_string()) }
    }
}
