//! One call of a node: what it is given, what is taken from it, what is remembered of it.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use panoscope_abi::{self as abi, PortRange, Tick};

use super::{
    CallOutcome, MOST_KEPT_FRAMES, NodeRuntime, ONE_INPUT, Ports, REMEMBERED_SIZES, Refused, Resized, RunContext,
    SILENT_CALLS,
};
use crate::busy::{CallKind, LeftBehind};
use crate::clock;
use crate::ending::who;
use crate::exec::{Exec, Port};
use crate::fault::{Action, Cause};
use crate::host::CallContext;
use crate::instance::Instance;
use crate::log::Level;
use crate::observe::Event;
use crate::outputs::is_same;
use crate::params::Snapshot;
use crate::retained::attention;
use crate::scratch::{CallOutputs, clear};
use crate::stats::bump;
use crate::sync::lock;

/// Whether a node is called for a tick.
enum May {
    /// From then on.
    Run {
        start_ns: u64,
    },
    Skip,
    /// It did not return from opening.
    LeftBehind,
}

impl NodeRuntime {
    /// Calls the node for one tick; answers how it went and the time at its end. The inputs are the caller's to give back.
    pub fn run(
        &self,
        exec: &mut Exec,
        around: &RunContext,
        tick: &mut Tick,
        complete: bool,
        start_ns: u64,
        ports: &mut Ports<'_>,
    ) -> (CallOutcome, u64) {
        let mut start_ns = start_ns;
        let mut led = None;
        if let Some(decider) = &around.decider {
            match self.lead(&**decider, exec, around, tick) {
                Ok(runs) => led = runs,
                Err(LeftBehind) => return (CallOutcome::Abandoned, start_ns),
            }
            start_ns = clock::now_ns();
        }
        if self.config_epoch.load(Ordering::Acquire) != exec.config_epoch {
            if let Err(LeftBehind) = self.catch_up(exec, around, tick, led.is_some()) {
                return (CallOutcome::Abandoned, start_ns);
            }
            start_ns = clock::now_ns();
        }
        ports.made.set_len(exec.outputs_len as usize);
        if !complete {
            bump(&self.stats.skipped);
            return (CallOutcome::Skipped, start_ns);
        }
        let may = match led {
            None => self.may_run(exec, around, tick, start_ns),
            Some(true) => May::Run { start_ns },
            Some(false) => May::Skip,
        };
        let start_ns = match may {
            May::Run { start_ns } => start_ns,
            May::Skip => {
                self.skipped_tick(around, tick, false);
                return (CallOutcome::Skipped, start_ns);
            }
            May::LeftBehind => return (CallOutcome::Abandoned, start_ns),
        };
        let allocations = around.thread_allocations.map(|count| count());
        self.busy.begin(tick, start_ns);
        let (status, refused) = self.call(exec, around, tick, ports);
        if !self.busy.end(start_ns) {
            return (CallOutcome::Abandoned, start_ns);
        }
        let end_ns = clock::now_ns();
        if let Some((count, before)) = around.thread_allocations.zip(allocations) {
            let more = count().wrapping_sub(before);
            if more != 0 {
                self.stats.allocations.fetch_add(more, Ordering::Relaxed);
            }
        }
        let spent_ns = end_ns.saturating_sub(start_ns);
        exec.time.count_one(spent_ns);
        if spent_ns > exec.longest_ns {
            exec.longest_ns = spent_ns;
            exec.time.raise(spent_ns);
        }
        if exec.limited && exec.budget_ns != 0 && spent_ns > exec.budget_ns {
            self.over_budget(around, tick, spent_ns, exec.budget_ns);
        }
        let ran = if status == abi::STATUS_OK {
            self.accept(exec, around, tick, refused, end_ns, ports.made)
        } else {
            ports.made.clear();
            if status == abi::STATUS_END && exec.source {
                CallOutcome::End
            } else {
                self.failed(exec, around, status, refused, tick, end_ns)
            }
        };
        if !matches!(ran, CallOutcome::Ok | CallOutcome::End | CallOutcome::Abandoned) {
            self.skipped_tick(around, tick, !exec.instance.is_open());
        }
        (ran, end_ns)
    }

    /// Writes an event of this node into the recording, if there is one.
    #[inline]
    pub fn write_down(&self, around: &RunContext, event: impl FnOnce(String) -> Event) {
        if let Some(observer) = &around.observer {
            observer.event(event(self.id.clone()));
        }
    }

    #[cold]
    fn over_budget(&self, around: &RunContext, tick: &Tick, spent_ns: u64, budget_ns: u64) {
        bump(&self.stats.over_budget);
        let words = || format!("took {:.1} ms of {:.1} ms", spent_ns as f64 / 1e6, budget_ns as f64 / 1e6);
        self.note(around, Cause::Slow, Action::Note, Some(tick.seq), words);
    }

    /// Takes over what others changed since the last call. Where a recording leads, it says when a replacement takes its turn.
    #[cold]
    fn catch_up(&self, exec: &mut Exec, around: &RunContext, tick: &Tick, led: bool) -> Result<(), LeftBehind> {
        exec.config_epoch = self.config_epoch.load(Ordering::Acquire);
        if !led && self.replace.load(Ordering::Relaxed) {
            self.take_replacement(exec, around, tick)?;
        }
        if let Some(snapshot) = self.values.newer(exec.snapshot()) {
            let values = || snapshot.owned().to_vec();
            self.write_down(around, |node| Event::Values { node, tick: *tick, values: values() });
            exec.set_snapshot(snapshot);
        }
        exec.period_ns = self.period_ns.load(Ordering::Relaxed);
        exec.budget_ns = self.budget_ns.load(Ordering::Relaxed);
        exec.limited = exec.period_ns > 0 || exec.budget_ns != 0;
        Ok(())
    }

    /// Calls the plugin for something else than a tick, on the thread that runs the node and under the eyes of the watchdog.
    ///
    /// # Errors
    /// The watchdog gave the call up: what it answered is dropped here, by the thread that was left behind.
    pub fn aside<R>(&self, kind: CallKind, tick: &Tick, call: impl FnOnce() -> R) -> Result<R, LeftBehind> {
        let start_ns = clock::now_ns();
        self.busy.begin_kind(kind, tick, start_ns);
        let answer = call();
        if self.busy.end(start_ns) { Ok(answer) } else { Err(LeftBehind) }
    }

    /// The node made nothing of a tick although its inputs were there.
    pub fn skipped_tick(&self, around: &RunContext, tick: &Tick, closed: bool) {
        self.write_down(around, |node| Event::Skipped { node, tick: *tick, closed });
    }

    /// The node goes on with an instance that was opened with these values.
    pub fn opened(&self, snapshot: &Snapshot, around: &RunContext, tick: &Tick) {
        let values = || snapshot.owned().to_vec();
        self.write_down(around, |node| Event::Opened { node, tick: *tick, values: values() });
    }

    #[cold]
    fn take_replacement(&self, exec: &mut Exec, around: &RunContext, tick: &Tick) -> Result<(), LeftBehind> {
        self.replace.store(false, Ordering::Relaxed);
        let Some((mut instance, snapshot)) = lock(&self.replacement).take() else { return Ok(()) };
        self.hand_over(exec, &mut instance, around, tick)?;
        let old = std::mem::replace(&mut exec.instance, instance.begun());
        if old.is_open() {
            self.aside(CallKind::Close, tick, || self.end(around, old))?;
        }
        if let Some(snapshot) = snapshot {
            self.set_snapshot(Arc::clone(&snapshot));
            exec.set_snapshot(snapshot);
        }
        exec.bypassed = false;
        self.recovery.gives_up.store(false, Ordering::Release);
        exec.bad_in_a_row = 0;
        if around.observer.is_some() {
            self.opened(&self.snapshot(), around, tick);
        }
        Ok(())
    }

    /// Gives the state of the running instance to its successor, where both know how.
    pub fn hand_over(
        &self,
        exec: &mut Exec,
        successor: &mut Instance,
        around: &RunContext,
        tick: &Tick,
    ) -> Result<(), LeftBehind> {
        if !exec.instance.saves_state() {
            return Ok(());
        }
        if let Some(state) = self.aside(CallKind::SaveState, tick, || exec.instance.save_state(&around.host))?
            && !self.aside(CallKind::LoadState, tick, || successor.load_state(&state))?
        {
            self.starts_anew(around);
        }
        Ok(())
    }

    /// Says that a saved state is lost.
    pub fn starts_anew(&self, around: &RunContext) {
        around.log.write(Level::Warn, &self.id, "the state of its predecessor was not understood: it starts anew");
    }

    #[inline]
    fn may_run(&self, exec: &mut Exec, around: &RunContext, tick: &Tick, start_ns: u64) -> May {
        let last = exec.last_fired_ns;
        // After a step back in capture time a node does not wait until the old time comes again.
        if exec.limited
            && exec.period_ns > 0
            && last != i64::MIN
            && (0..exec.period_ns).contains(&tick.capture_ns.saturating_sub(last))
        {
            return May::Skip;
        }
        if exec.bypassed {
            return May::Skip;
        }
        let mut start_ns = start_ns;
        if !exec.instance.is_open() {
            if !around.batch {
                return May::Skip;
            }
            match self.open_in_batch(exec, around, tick) {
                Ok(true) => start_ns = clock::now_ns(),
                Ok(false) => return May::Skip,
                Err(LeftBehind) => return May::LeftBehind,
            }
        }
        if !exec.source {
            exec.last_fired_ns = tick.capture_ns;
        }
        May::Run { start_ns }
    }

    fn call(
        &self,
        exec: &mut Exec,
        around: &RunContext,
        tick: &mut Tick,
        ports: &mut Ports<'_>,
    ) -> (abi::Status, Option<Refused>) {
        let Some(process) = exec.process else { return (abi::STATUS_INVALID, None) };
        let made = &mut *ports.made;
        match &mut made.shown[..] {
            [one] => *one = abi::Frame::EMPTY,
            all => all.fill(abi::Frame::EMPTY),
        }
        let (inputs, inputs_len) = (ports.inputs.as_ptr().cast::<abi::Frame>(), ports.inputs.len());
        let (params, params_len) = exec.params();
        let ranges: &[PortRange] = if ports.lone { ONE_INPUT } else { &exec.ranges };
        let mut context = CallContext {
            outputs: made.outputs.as_mut_ptr(),
            shown: made.shown.as_mut_ptr(),
            outputs_len: made.outputs.len(),
            inputs,
            inputs_len,
            lent: None,
            first_formats: exec.first_formats(),
            cell: self,
            holds: &exec.instance.holds,
            log: &around.log,
            failure: &mut exec.failure,
            has_failure: false,
            refused: None,
            random: None,
            tick: *tick,
            wait_for_memory: around.unhurried(),
        };
        let mut call = abi::Call {
            struct_size: size_of::<abi::Call>() as u32,
            flags: if around.batch { abi::CALL_BATCH } else { 0 },
            host: &raw const around.host,
            call: (&raw mut context).cast(),
            tick: *tick,
            inputs,
            inputs_len,
            input_ranges: ranges.as_ptr(),
            input_ranges_len: ranges.len(),
            outputs: made.shown.as_mut_ptr(),
            outputs_len: made.shown.len(),
            params,
            params_len,
            params_version: exec.params_version,
            outputs_read: self.outputs_read.load(Ordering::Relaxed),
        };
        let raw = exec.instance.raw;
        who::begin_call(self);
        // SAFETY: the contract: an open instance that no other thread uses, and a call whose parts outlive it.
        let status = exec.instance.kept.during(|| unsafe { process(raw, &raw mut call) });
        who::end_call();
        let refused = context.refused.take();
        let reports = context.has_failure && status >= abi::STATUS_OK;
        if let Some(lent) = context.lent {
            // The output holds the input's reference from here on.
            ports.inputs[lent.input as usize].forget();
        }
        if exec.source {
            tick.capture_ns = call.tick.capture_ns;
            for frame in made.outputs.iter_mut().filter(|f| !f.is_empty()) {
                frame.tick = *tick;
            }
        }
        if reports {
            self.reported(exec, around, tick, status);
        }
        (status, refused)
    }

    /// Looks at what a call made that says it went well.
    #[inline]
    fn accept(
        &self,
        exec: &mut Exec,
        around: &RunContext,
        tick: &Tick,
        mut refused: Option<Refused>,
        end_ns: u64,
        made: &mut CallOutputs,
    ) -> CallOutcome {
        let mut count = 0;
        for (index, (frame, shown)) in made.outputs.iter_mut().zip(&made.shown).enumerate() {
            if frame.is_empty() && shown.is_empty() {
                continue;
            }
            count += 1;
            let port = exec.port(index);
            if (port.inspected >> frame.format & 1 == 1 || !is_same(frame, shown))
                && let Err(objection) = self.rules[index].inspect(frame, shown)
            {
                // SAFETY: the call has ended, so the output holds its reference.
                unsafe { clear(std::slice::from_mut(frame)) };
                refused = Some(Box::new(objection));
            } else if (port.width, port.height) != (frame.width, frame.height) {
                let (from, to) = ((port.width, port.height), (frame.width, frame.height));
                (port.width, port.height) = to;
                if from == Port::NEVER {
                    self.ports_made.fetch_or(1u64.checked_shl(index as u32).unwrap_or(0), Ordering::Relaxed);
                } else if from != (0, 0) {
                    self.resize(Resized { output: index, tick: *tick, from, to });
                }
            }
        }
        if let Some(refused) = refused {
            return self.bad_output(exec, made, around, tick, *refused, end_ns);
        }
        let silent = count == 0 && exec.outputs_len != 0;
        if exec.troubled || silent || attention() {
            return self.accept_troubled(exec, around, tick, silent, end_ns, made);
        }
        CallOutcome::Ok
    }

    /// The rest of [`Self::accept`] for a node of whom something is remembered, or that made nothing or kept a frame.
    #[cold]
    fn accept_troubled(
        &self,
        exec: &mut Exec,
        around: &RunContext,
        tick: &Tick,
        silent: bool,
        end_ns: u64,
        made: &mut CallOutputs,
    ) -> CallOutcome {
        exec.bad_in_a_row = 0;
        self.blame_for_refused(exec, around, tick);
        if exec.instance.kept.count() > MOST_KEPT_FRAMES {
            made.clear();
            exec.failure.clear();
            exec.failure.push_str("it keeps more frames than any node may: a leak");
            let leak = Box::new((Cause::Leak, String::new()));
            return self.failed(exec, around, abi::STATUS_ERROR, Some(leak), tick, end_ns);
        }
        if silent {
            exec.silent_calls = exec.silent_calls.saturating_add(1);
            let silent = exec.silent_calls;
            if silent >= SILENT_CALLS
                && silent.is_multiple_of(SILENT_CALLS)
                && self.outputs_read.load(Ordering::Relaxed) != 0
            {
                let words = || format!("its inputs are complete, but it made nothing for {silent} ticks");
                self.note(around, Cause::Silent, Action::Note, Some(tick.seq), words);
            }
        } else {
            exec.silent_calls = 0;
        }
        if exec.failed_at_ns != 0 {
            self.stats.recovery.record(end_ns.saturating_sub(exec.failed_at_ns));
            exec.failed_at_ns = 0;
        }
        if exec.failures_in_a_row != 0 {
            exec.failures_in_a_row = 0;
            self.recovery.failures.store(0, Ordering::Relaxed);
        }
        exec.troubled = silent;
        CallOutcome::Ok
    }

    /// A node that kept or gave back what it does not hold: nothing was done, so the node goes on.
    fn blame_for_refused(&self, exec: &Exec, around: &RunContext, tick: &Tick) {
        if exec.instance.kept.take_refused() == 0 {
            return;
        }
        bump(&self.stats.faults);
        self.note(around, Cause::Release, Action::Note, Some(tick.seq), || {
            let words = "it gave back or kept a frame that it does not hold; this was refused".to_owned();
            around.log.write(Level::Error, &self.id, &words);
            words
        });
    }

    #[cold]
    fn resize(&self, resized: Resized) {
        let mut newest = lock(&self.resized);
        if newest.len() >= REMEMBERED_SIZES {
            newest.pop_front();
        }
        newest.push_back(resized);
    }
}
