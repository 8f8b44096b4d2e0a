//! Replay of a node: applies the events that the [`Decider`] has for it before each tick.

use std::sync::Arc;

use panoscope_abi::Tick;
use panoscope_graph::ParamValue;

use crate::busy::{Abandoned, CallKind};
use crate::decide::{Decider, Turn};
use crate::exec::Exec;
use crate::instance::Instance;
use crate::log::Level;
use crate::node::NodeRuntime;
use crate::observe::Event;
use crate::params::Snapshot;
use crate::run_context::RunContext;

impl NodeRuntime {
    /// Applies the events before this tick. Returns whether the node runs, if the decider knows.
    ///
    /// # Errors
    /// The watchdog abandoned a call of the plugin.
    #[cold]
    pub fn follow_decider(
        &self,
        decider: &dyn Decider,
        exec: &mut Exec,
        context: &RunContext,
        tick: &Tick,
    ) -> Result<Option<bool>, Abandoned> {
        if decider.closes(self.source, self.side_effects) {
            return Ok(Some(false));
        }
        if !decider.leads_nodes() {
            return Ok(None);
        }
        let mut runs = true;
        while let Some(turn) = decider.next_turn(&self.id, tick) {
            match turn {
                Turn::Values(values) => {
                    let snapshot = Snapshot::new(values);
                    self.record_event(context, |node| Event::Values {
                        node,
                        tick: *tick,
                        values: snapshot.owned().to_vec(),
                    });
                    self.set_snapshot(Arc::clone(&snapshot));
                    exec.set_snapshot(snapshot);
                }
                Turn::Opened(values) => self.open_as_led(decider, exec, context, tick, values)?,
                Turn::Skipped { here, closed } => {
                    runs &= !here;
                    if closed {
                        self.skipped_tick(context, tick, true);
                        let old = std::mem::replace(&mut exec.instance, Instance::none(self.node_type));
                        self.call_watched(CallKind::Close, tick, || self.end(context, old))?;
                    }
                }
            }
        }
        Ok(Some(runs && exec.instance.is_open()))
    }

    fn open_as_led(
        &self,
        decider: &dyn Decider,
        exec: &mut Exec,
        context: &RunContext,
        tick: &Tick,
        values: Vec<ParamValue>,
    ) -> Result<(), Abandoned> {
        let snapshot = Snapshot::new(values);
        self.opened(&snapshot, context, tick);
        match self.call_watched(CallKind::Open, tick, || self.open(context, &snapshot))? {
            Ok(mut instance) => {
                if instance.is_open() {
                    self.transfer_state(exec, &mut instance, context, tick)?;
                }
                let old = std::mem::replace(&mut exec.instance, instance.begun());
                self.call_watched(CallKind::Close, tick, || self.end(context, old))?;
                self.set_snapshot(Arc::clone(&snapshot));
                exec.set_snapshot(snapshot);
                exec.bypassed = false;
                exec.bad_in_a_row = 0;
            }
            Err(words) => {
                let words = format!("it opened in the recorded run, but not now: {words}");
                context.log.write(Level::Error, &self.id, &words);
                decider.fail(format!("node `{}`: {words}", self.id));
            }
        }
        Ok(())
    }
}
