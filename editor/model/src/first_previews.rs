//! Previews that exist before the first tick, so that they miss no packet: a run of one image may be over before a window asks for its pictures.

use std::collections::HashMap;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use panoscope_engine::sync::lock;
use panoscope_engine::{Engine, Preview};

use crate::output::Output;

/// Maximum time for which the first run waits until a window has asked for pictures.
const MAX_WAIT: Duration = Duration::from_secs(1);

#[derive(Default)]
struct State {
    /// Whether somebody is going to ask.
    is_expected: bool,
    asked: Vec<Output>,
    /// The previews of the newest run, and the generation of the graph that they belong to.
    made: (u64, HashMap<Output, Preview>),
}

/// The outputs that a window previews, and their previews in a run that begins.
#[derive(Default)]
pub struct FirstPreviews {
    state: Mutex<State>,
    changed: Condvar,
}

impl FirstPreviews {
    /// Makes the first run wait until somebody asks, for a second at most.
    pub fn expect(&self) {
        lock(&self.state).is_expected = true;
    }

    /// Asks for outputs in runs that begin.
    pub fn ask<'a>(&self, outputs: impl Iterator<Item = &'a Output>) {
        lock(&self.state).asked = outputs.cloned().collect();
        self.changed.notify_all();
    }

    /// Subscribes to what was asked for in a run before its first tick. A run of a batch ends: there also to all outputs that are made anyway, which
    /// may be asked for at its end.
    pub fn subscribe(&self, engine: &Engine, generation: u64) {
        let waits = |state: &mut State| state.is_expected && state.asked.is_empty();
        let state = self.changed.wait_timeout_while(lock(&self.state), MAX_WAIT, waits);
        let mut state = state.unwrap_or_else(PoisonError::into_inner).0;
        // A window that shows no pictures is waited for once.
        state.is_expected = false;
        let mut outputs = state.asked.clone();
        if engine.is_batch() {
            outputs.extend(engine.outputs_read().into_iter().map(|(node, port)| Output { node, port }));
        }
        let preview = |output: Output| engine.preview(&output.node, &output.port).map(|preview| (output, preview));
        state.made = (generation, outputs.into_iter().filter_map(preview).collect());
    }

    /// Takes the previews of the run, if the graph is still the one that began. Those of an earlier one end.
    pub fn take(&self, generation: u64) -> HashMap<Output, Preview> {
        let (of, previews) = std::mem::take(&mut lock(&self.state).made);
        if of == generation { previews } else { HashMap::new() }
    }
}
