//! What both drivers do with the interlock: tell it what arrived, let latched stops go, say why it stopped.

use panoscope_arm_core::Interlock;
use panoscope_arm_core::interlock::{Cause, Evidence, Settings};
use panoscope_node::Context;
use panoscope_node::abi::Tip;

/// Switches of a driver that latch and let go.
#[derive(Clone, Copy, Debug, Default)]
pub struct Switches {
    reset: Option<u64>,
}

impl Switches {
    /// Obeys `emergency_stop`, and `reset` when its number changes while nothing is pressed.
    pub fn obey(&mut self, lock: &mut Interlock, emergency_stop: bool, reset: u64) {
        let is_new = self.reset.replace(reset).is_some_and(|old| old != reset);
        if emergency_stop {
            lock.latch(Cause::EmergencyStop);
        } else if is_new {
            lock.release();
        }
    }
}

/// Settings from a driver's parameters.
pub fn settings(max_age_ms: f64, min_score: f64) -> Settings {
    Settings { max_age_ms, min_score }
}

/// What a tip proves.
pub fn evidence(tip: &Tip) -> Evidence {
    Evidence { score: tip.score, in_space: tip.xyz_valid == 1 && tip.xyz_mm.iter().all(|v| v.is_finite()) }
}

/// The state in words, for pictures and files, written over what stood in `text`.
pub fn words(stop: Option<Cause>, latched: bool, text: &mut String) {
    text.clear();
    text.push_str(match stop {
        None => "arm follows",
        Some(_) if latched => "ARM STOPPED: ",
        Some(_) => "arm waits: ",
    });
    text.push_str(stop.map_or("", Cause::words));
}

/// Writes events to the host's log: stops as warnings.
pub fn tell(cx: &Context<'_>, lock: &mut Interlock) {
    while let Some(event) = lock.take_event() {
        if event.stop.is_some() { cx.warn(&event.to_string()) } else { cx.info(&event.to_string()) }
    }
}
