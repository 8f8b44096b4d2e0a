//! A node that is led by a [`Decider`]: what is due before a tick is done, whether it is due or not by the clock.

use std::sync::Arc;

use panoscope_abi::Tick;
use panoscope_graph::ParamValue;

use super::{NodeRuntime, RunContext};
use crate::busy::{CallKind, LeftBehind};
use crate::decide::{Decider, Turn};
use crate::exec::Exec;
use crate::instance::Instance;
use crate::log::Level;
use crate::observe::Event;
use crate::params::Snapshot;

impl NodeRuntime {
    /// Brings the node to where it was before this tick; whether it is to run, if the decider knows.
    ///
    /// # Errors
    /// The watchdog gave a call of the plugin up.
    #[cold]
    pub fn lead(
        &self,
        decider: &dyn Decider,
        exec: &mut Exec,
        around: &RunContext,
        tick: &Tick,
    ) -> Result<Option<bool>, LeftBehind> {
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
                    self.write_down(around, |node| Event::Values {
                        node,
                        tick: *tick,
                        values: snapshot.owned().to_vec(),
                    });
                    self.set_snapshot(Arc::clone(&snapshot));
                    exec.set_snapshot(snapshot);
                }
                Turn::Opened(values) => self.open_as_led(decider, exec, around, tick, values)?,
                Turn::Skipped { here, closed } => {
                    runs &= !here;
                    if closed {
                        self.skipped_tick(around, tick, true);
                        let old = std::mem::replace(&mut exec.instance, Instance::none(self.node_type));
                        self.aside(CallKind::Close, tick, || self.end(around, old))?;
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
        around: &RunContext,
        tick: &Tick,
        values: Vec<ParamValue>,
    ) -> Result<(), LeftBehind> {
        let snapshot = Snapshot::new(values);
        self.opened(&snapshot, around, tick);
        match self.aside(CallKind::Open, tick, || self.open(around, &snapshot))? {
            Ok(mut instance) => {
                if instance.is_open() {
                    self.hand_over(exec, &mut instance, around, tick)?;
                }
                let old = std::mem::replace(&mut exec.instance, instance.begun());
                self.aside(CallKind::Close, tick, || self.end(around, old))?;
                self.set_snapshot(Arc::clone(&snapshot));
                exec.set_snapshot(snapshot);
                exec.bypassed = false;
                exec.bad_in_a_row = 0;
            }
            Err(words) => {
                let words = format!("it opened when it was recorded, now it does not: {words}");
                around.log.write(Level::Error, &self.id, &words);
                decider.fail(format!("node `{}`: {words}", self.id));
            }
        }
        Ok(())
    }
}
