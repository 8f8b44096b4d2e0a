//! Failed calls of a node: how it recovers, and how faults are reported.

use std::sync::Arc;

use panoscope_abi::{self as abi, Tick};
use panoscope_graph::OnFault;

use super::CallOutcome;
use super::open::NotOpened;
use crate::busy::{Abandoned, CallKind};
use crate::clock;
use crate::exec::Exec;
use crate::fault::{Action, Cause, Fault, unix_ms};
use crate::host::Refused;
use crate::instance::Instance;
use crate::log::Level;
use crate::node::NodeRuntime;
use crate::observe::Event;
use crate::params::Snapshot;
use crate::run_context::RunContext;
use crate::scratch::CallOutputs;
use crate::stats::bump;

/// Bad outputs in a row after which the node restarts.
const MAX_BAD_OUTPUTS: u32 = 10;

impl NodeRuntime {
    /// An output failed its check: withholds the packet, and fails the call after too many in a row.
    #[cold]
    pub(crate) fn bad_output(
        &self,
        exec: &mut Exec,
        made: &mut CallOutputs,
        context: &RunContext,
        tick: &Tick,
        (cause, words): (Cause, String),
        end_ns: u64,
    ) -> CallOutcome {
        exec.troubled = true;
        exec.bad_in_a_row += 1;
        if exec.bad_in_a_row >= MAX_BAD_OUTPUTS || (cause == Cause::BadOutput && self.on_fault() != OnFault::Restart) {
            made.clear();
            exec.failure.clear();
            exec.failure.push_str(&words);
            return self.failed(exec, context, abi::STATUS_ERROR, Some(Box::new((cause, words))), tick, end_ns);
        }
        bump(&self.stats.faults);
        if self.count(cause).is_power_of_two() {
            context.log.write(Level::Error, &self.id, &words);
        }
        self.report_repeated_fault(context, cause, Action::Withhold, Some(tick.seq), || words);
        CallOutcome::Ok
    }

    /// Reports a fault that a call described although it returned success or the end of its source.
    #[cold]
    pub(crate) fn reported(&self, exec: &mut Exec, context: &RunContext, tick: &Tick, status: abi::Status) {
        let words = std::mem::take(&mut exec.failure);
        let done = if status == abi::STATUS_END { Action::End } else { Action::Note };
        bump(&self.stats.faults);
        context.log.write(Level::Error, &self.id, &words);
        self.report_fault(context, Cause::Error, done, Some(tick.seq), None, words);
    }

    /// Saves where a failed source is. From its start it would repeat the same fault forever.
    #[cold]
    fn save_position(&self, exec: &mut Exec, context: &RunContext, tick: &Tick) -> Result<(), Abandoned> {
        if !exec.source || !exec.instance.saves_state() {
            return Ok(());
        }
        match self.call_watched(CallKind::SaveState, tick, || exec.instance.save_state(&context.host))? {
            Some(state) => self.recovery.save_position(exec, state),
            None => self.recovery.save_kept_position(),
        }
        Ok(())
    }

    /// The position at which a reopened source continues. The caller puts it back only if the instance understood it,
    /// so that a position on which an instance hangs is not tried twice.
    pub(crate) fn take_position(&self, instance: &Instance) -> Option<Vec<u8>> {
        if instance.is_open() { self.recovery.take_position() } else { None }
    }

    /// Records whether an instance continues at a position.
    pub(crate) fn position_taken(&self, context: &RunContext, state: Vec<u8>, understood: bool) {
        if understood {
            // Kept for the next fault: this instance may fail before it has a position of its own.
            self.recovery.restore_position(state);
        } else {
            self.position_lost(context);
        }
    }

    /// Logs that the position of a source is lost.
    pub(crate) fn position_lost(&self, context: &RunContext) {
        context.log.write(Level::Warn, &self.id, "it lost its position and starts from the beginning");
    }

    /// Reopens a failed node on the thread that runs it; a source continues where it was.
    fn open_again(
        &self,
        context: &RunContext,
        snapshot: &Snapshot,
        tick: &Tick,
    ) -> Result<Result<Instance, NotOpened>, Abandoned> {
        let opened = self.call_watched(CallKind::Open, tick, || self.open(context, snapshot))?;
        let Ok(mut instance) = opened else { return Ok(opened) };
        if let Some(state) = self.take_position(&instance) {
            let understood = self.call_watched(CallKind::LoadState, tick, || instance.load_state(&state))?;
            self.position_taken(context, state, understood);
        }
        Ok(Ok(instance))
    }

    /// In batch, reopens a failed node before a tick that does not depend on the clock.
    #[cold]
    pub(crate) fn open_in_batch(&self, exec: &mut Exec, context: &RunContext, tick: &Tick) -> Result<bool, Abandoned> {
        if self.on_fault() != OnFault::Restart {
            return Ok(false);
        }
        if exec.skip_calls > 0 {
            exec.skip_calls -= 1;
            return Ok(false);
        }
        let broken = self.recovery.take_broken();
        if !broken.is_empty() {
            self.call_watched(CallKind::Close, tick, || {
                broken.into_iter().for_each(|instance| self.end(context, instance))
            })?;
        }
        let snapshot = Arc::clone(exec.snapshot());
        let opened = self.open_again(context, &snapshot, tick)?;
        Ok(match opened {
            Ok(instance) => {
                bump(&self.stats.restarts);
                context.log.write(Level::Info, &self.id, "opened again");
                exec.instance = instance.begun();
                self.opened(&snapshot, context, tick);
                true
            }
            Err(NotOpened { message }) => {
                exec.troubled = true;
                exec.failures_in_a_row += 1;
                exec.skip_calls = skipped_calls(exec.failures_in_a_row);
                exec.bypassed = self.has_given_up();
                self.open_failed(context, &message, Some(tick.seq));
                false
            }
        })
    }

    /// Reports that a node did not reopen.
    pub fn open_failed(&self, context: &RunContext, words: &str, seq: Option<u64>) {
        bump(&self.stats.faults);
        context.log.write(Level::Error, &self.id, &format!("could not be opened again: {words}"));
        let gives_up = self.has_given_up();
        if gives_up {
            self.lost(context, words);
        }
        let done = if gives_up { Action::Bypass } else { Action::Restart };
        self.report_fault(context, Cause::Open, done, seq, None, words.to_owned());
    }

    #[cold]
    pub(crate) fn failed(
        &self,
        exec: &mut Exec,
        context: &RunContext,
        status: abi::Status,
        refused: Option<Refused>,
        tick: &Tick,
        now_ns: u64,
    ) -> CallOutcome {
        if status == abi::STATUS_EXHAUSTED {
            bump(&self.stats.dropped);
            let words = "the tick was dropped: frame memory is used up";
            if (self.count(Cause::Exhausted) + 1).is_power_of_two() {
                context.log.write(Level::Warn, &self.id, words);
            }
            self.report_repeated_fault(context, Cause::Exhausted, Action::Withhold, Some(tick.seq), || {
                words.to_owned()
            });
            return CallOutcome::Fault;
        }
        bump(&self.stats.faults);
        let mut words = std::mem::take(&mut exec.failure);
        let mut cause = if status == abi::STATUS_PANIC { Cause::Panic } else { Cause::Error };
        if let Some((because, details)) = refused.map(|refused| *refused) {
            cause = because;
            if !details.is_empty() && details != words {
                words = if words.is_empty() { details } else { format!("{details} ({words})") };
            }
        }
        if words.is_empty() {
            words = "it failed without an error message".to_owned();
        }
        context.log.write(Level::Error, &self.id, &words);
        exec.troubled = true;
        self.recovery.count_failure(exec);
        exec.skip_calls = skipped_calls(exec.failures_in_a_row);
        exec.failed_at_ns = now_ns;
        exec.bad_in_a_row = 0;
        exec.silent_calls = 0;
        let gives_up = status == abi::STATUS_STOPPED;
        self.recovery.set_permanent(gives_up);
        if gives_up {
            self.lost(context, &words);
        }
        let (done, outcome) = match self.on_fault() {
            OnFault::Restart if gives_up => (Action::Bypass, CallOutcome::Fault),
            OnFault::Restart => (Action::Restart, CallOutcome::Fault),
            OnFault::Bypass => (Action::Bypass, CallOutcome::Fault),
            OnFault::Stop => (Action::Stop, CallOutcome::Stop),
        };
        // Report first: the node may not return from what follows.
        self.report_fault(context, cause, done, Some(tick.seq), None, words);
        if self.save_position(exec, context, tick).is_err() {
            return CallOutcome::Abandoned;
        }
        // After a fault the instance is not used again. Closing it may take long, so the restart thread does.
        let broken = std::mem::replace(&mut exec.instance, Instance::none(self.node_type));
        self.recovery.request_restart(exec, broken);
        exec.bypassed = done == Action::Bypass;
        outcome
    }

    fn count(&self, cause: Cause) -> u64 {
        self.progress.faults(cause)
    }

    /// Reports a fault that may come with every tick: only counts 1, 2, 4, 8 ... are written out.
    #[cold]
    pub fn report_repeated_fault(
        &self,
        context: &RunContext,
        cause: Cause,
        done: Action,
        seq: Option<u64>,
        words: impl FnOnce() -> String,
    ) {
        if (self.count(cause) + 1).is_power_of_two() {
            self.report_fault(context, cause, done, seq, None, words());
        } else {
            self.progress.count_fault(cause);
        }
    }

    /// Counts a fault and passes it to the fault log and the observer.
    pub fn report_fault(
        &self,
        context: &RunContext,
        cause: Cause,
        done: Action,
        seq: Option<u64>,
        late_ms: Option<f64>,
        words: String,
    ) {
        let count = self.progress.count_fault(cause);
        let fault = Fault {
            unix_ms: unix_ms(),
            run_ms: clock::now_ns().saturating_sub(context.start_ns) as f64 / 1e6,
            node: self.id.clone(),
            cause,
            words,
            done,
            seq,
            late_ms,
            count,
        };
        if let Some(observer) = &context.observer {
            observer.event(Event::Fault(fault.clone()));
        }
        context.faults.put(fault);
    }
}

/// Pause before a restart: 0, 10, 20, 40 ... 2,000 ms.
pub(crate) fn backoff_ms(failures: u32) -> u64 {
    if failures <= 1 { 0 } else { (10u64 << (failures - 2).min(8)).min(2000) }
}

/// The same in calls, for batch: 0, 1, 3, 7 ... 255.
fn skipped_calls(failures: u32) -> u32 {
    (1u32 << (failures.max(1) - 1).min(8)) - 1
}
