//! One call of a node: its inputs, its outputs, and what is recorded about it.

mod decided;
pub(crate) mod failures;
mod finish;
pub(crate) mod open;
mod trial;

use std::sync::atomic::Ordering;

use panoscope_abi::{self as abi, Frame, PortRange, Tick};

use crate::busy::{Abandoned, CallKind};
use crate::clock;
use crate::current_node;
use crate::exec::{Exec, Port};
use crate::fault::{Action, Cause};
use crate::host::{CallContext, Refused, output_bit};
use crate::instance::Instance;
use crate::isolation::STATUS_DIED;
use crate::light::{Sources, later};
use crate::log::Level;
use crate::memory::{FrameRef, Memory, device_in_use, memory};
use crate::node::{NodeRuntime, SizeChange};
use crate::observe::Event;
use crate::outputs::is_same;
use crate::params::Snapshot;
use crate::retained::attention;
use crate::run_context::RunContext;
use crate::scratch::{CallOutputs, Scratch, clear};
use crate::stats::bump;
use crate::trace::Call;

/// Frames that a node may retain between calls.
pub(crate) const MAX_RETAINED_FRAMES: usize = 128;
/// Calls in a row without output after which a node counts as silent.
const SILENT_CALLS: u32 = 30;

/// Readers that run inline have one input.
const ONE_INPUT: &[PortRange] = &[PortRange { first: 0, count: 1 }];

/// Result of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CallOutcome {
    Ok,
    /// A source has ended.
    End,
    /// Not called: an input was empty, or the node is down.
    Skipped,
    /// It failed; the graph continues.
    Fault,
    /// It failed, and the graph has to stop.
    Stop,
    /// The watchdog abandoned this call; the thread must return without touching anything.
    Abandoned,
}

/// Inputs and outputs of a call.
pub(crate) struct Ports<'w> {
    pub inputs: &'w mut [FrameRef],
    /// Whether the node has one input port with one connection.
    pub lone: bool,
    pub made: &'w mut CallOutputs,
    /// The sources of the graph.
    pub sources: &'w dyn Sources,
}

/// A call that ended on the thread that made it.
pub(crate) struct Called {
    pub outcome: CallOutcome,
    pub end_ns: u64,
    pub bypassed: bool,
    /// For a source: the arrival that it declared for the tick, ns of the host's clock.
    pub arrived_ns: Option<i64>,
}

/// A call without an outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NoOutcome {
    /// The engine closed the node, which does not run again.
    Closed,
    /// The watchdog abandoned the call, see [`NodeRuntime::abandoned_call_returned`].
    Abandoned,
}

/// Whether to call a node for a tick.
enum Due {
    /// Call it; the time counts from `start_ns`.
    Run {
        start_ns: u64,
    },
    Skip,
    /// The watchdog abandoned its `open`.
    Abandoned,
}

/// Which of up to 64 inputs are not empty, one bit each.
fn present(inputs: &[FrameRef]) -> u64 {
    inputs.iter().zip(0..64).fold(0, |bits, (input, at)| bits | u64::from(!input.is_empty()) << at)
}

/// Bytes of frames together.
fn bytes<'f>(frames: impl Iterator<Item = &'f Frame>) -> u64 {
    frames.map(|frame| frame.len as u64).sum()
}

impl NodeRuntime {
    /// Takes the node's [`Exec`], calls the node for one tick, and puts the `Exec` back. The caller releases the
    /// inputs.
    #[inline]
    pub fn call_node(
        &self,
        context: &RunContext,
        tick: &mut Tick,
        complete: bool,
        start_ns: u64,
        ports: &mut Ports<'_>,
    ) -> Result<Called, NoOutcome> {
        let Some(mut exec) = self.exec.take() else { return Err(NoOutcome::Closed) };
        let (outcome, end_ns) = self.run(&mut exec, context, tick, complete, start_ns, ports);
        if outcome == CallOutcome::Abandoned {
            return Err(NoOutcome::Abandoned);
        }
        let arrived_ns = if exec.source { exec.times.take_arrived_ns() } else { None };
        let bypassed = exec.bypassed;
        self.exec.put(exec);
        Ok(Called { outcome, end_ns, bypassed, arrived_ns })
    }

    /// An abandoned call returned: releases what its thread still holds. The watchdog has done everything else.
    #[cold]
    pub fn abandoned_call_returned(&self, scratch: &mut Scratch) {
        scratch.clear();
        self.recovery.remove_stuck();
    }

    /// Calls the node for one tick. Returns the outcome and the time at its end.
    fn run(
        &self,
        exec: &mut Exec,
        context: &RunContext,
        tick: &mut Tick,
        complete: bool,
        start_ns: u64,
        ports: &mut Ports<'_>,
    ) -> (CallOutcome, u64) {
        let mut start_ns = start_ns;
        let mut led = None;
        if let Some(decider) = &context.decider {
            match self.follow_decider(&**decider, exec, context, tick) {
                Ok(runs) => led = runs,
                Err(Abandoned) => return (CallOutcome::Abandoned, start_ns),
            }
            start_ns = clock::now_ns();
        }
        if self.config_epoch.get() != exec.config_epoch {
            if let Err(Abandoned) = self.catch_up(exec, context, tick, led.is_some()) {
                return (CallOutcome::Abandoned, start_ns);
            }
            start_ns = clock::now_ns();
        }
        ports.made.set_len(exec.outputs_len as usize);
        if !complete {
            bump(&self.stats.skipped);
            self.trace(context, tick, (start_ns, start_ns), false, [0; 2]);
            return (CallOutcome::Skipped, start_ns);
        }
        let may = match led {
            None => self.is_due(exec, context, tick, start_ns, ports.inputs),
            Some(true) => Due::Run { start_ns },
            Some(false) => Due::Skip,
        };
        let start_ns = match may {
            Due::Run { start_ns } => start_ns,
            Due::Skip => {
                self.skipped_tick(context, tick, false);
                self.trace(context, tick, (start_ns, start_ns), false, [0; 2]);
                return (CallOutcome::Skipped, start_ns);
            }
            Due::Abandoned => return (CallOutcome::Abandoned, start_ns),
        };
        let allocations = context.thread_allocations.map(|count| count());
        // Before the call, which may hand an input on.
        let read_bytes = context.tracer.as_ref().map_or(0, |_| bytes(ports.inputs.iter().map(FrameRef::frame)));
        self.busy.begin(tick, start_ns);
        let (status, refused) = self.call(exec, context, tick, ports);
        if !self.busy.end(start_ns) {
            return (CallOutcome::Abandoned, start_ns);
        }
        let end_ns = clock::now_ns();
        if let Some((count, before)) = context.thread_allocations.zip(allocations) {
            let more = count().wrapping_sub(before);
            if more != 0 {
                self.stats.allocations.fetch_add(more, Ordering::Relaxed);
            }
        }
        let spent_ns = end_ns.saturating_sub(start_ns);
        // The call in which a source says that it has ended made no frame.
        let ends = status == abi::STATUS_END && exec.source;
        if !ends {
            exec.time.count_one(spent_ns);
            if spent_ns > exec.max_ns {
                exec.max_ns = spent_ns;
                exec.time.raise(spent_ns);
            }
        }
        if exec.limited && exec.budget_ns != 0 && spent_ns > exec.budget_ns {
            self.over_budget(context, tick, spent_ns, exec.budget_ns);
        }
        let outcome = if status == abi::STATUS_OK {
            self.accept(exec, context, tick, refused, end_ns, ports.made)
        } else {
            ports.made.clear();
            if ends { CallOutcome::End } else { self.failed(exec, context, status, refused, tick, end_ns) }
        };
        let made_bytes = context.tracer.as_ref().map_or(0, |_| bytes(ports.made.outputs.iter()));
        self.trace(context, tick, (start_ns, end_ns), outcome == CallOutcome::Ok, [read_bytes, made_bytes]);
        if !matches!(outcome, CallOutcome::Ok | CallOutcome::End | CallOutcome::Abandoned) {
            self.skipped_tick(context, tick, !exec.instance.is_open());
        }
        (outcome, end_ns)
    }

    /// Passes the times of a call to the tracer, if there is one.
    #[inline]
    fn trace(
        &self,
        context: &RunContext,
        tick: &Tick,
        (start_ns, end_ns): (u64, u64),
        made: bool,
        [read_bytes, made_bytes]: [u64; 2],
    ) {
        if let Some(tracer) = &context.tracer {
            let (node, made_bytes) = (self.id.as_str(), if made { made_bytes } else { 0 });
            tracer.call(&Call { node, tick, start_ns, end_ns, made, read_bytes, made_bytes });
        }
    }

    /// Passes an event of this node to the observer, if there is one.
    #[inline]
    pub fn record_event(&self, context: &RunContext, event: impl FnOnce(String) -> Event) {
        if let Some(observer) = &context.observer {
            observer.event(event(self.id.clone()));
        }
    }

    #[cold]
    fn over_budget(&self, context: &RunContext, tick: &Tick, spent_ns: u64, budget_ns: u64) {
        bump(&self.stats.over_budget);
        let words = || format!("took {:.1} ms of {:.1} ms", spent_ns as f64 / 1e6, budget_ns as f64 / 1e6);
        self.report_repeated_fault(context, Cause::Slow, Action::Note, Some(tick.seq), words);
    }

    /// Applies changes made since the last call. In a replay the decider sets when a replacement takes over.
    #[cold]
    fn catch_up(&self, exec: &mut Exec, context: &RunContext, tick: &Tick, led: bool) -> Result<(), Abandoned> {
        exec.config_epoch = self.config_epoch.get();
        if !led && self.config.has_replacement() {
            self.install_replacement(exec, context, tick)?;
        }
        if let Some(snapshot) = self.config.newer_values(exec.snapshot()) {
            let values = || snapshot.owned().to_vec();
            self.record_event(context, |node| Event::Values { node, tick: *tick, values: values() });
            exec.set_snapshot(snapshot);
        }
        // In batch nothing is held up.
        exec.rate.set(self.config.period_ns(), (!context.batch).then_some(self.rate_phase_ns));
        exec.budget_ns = self.config.budget_ns();
        exec.limited = exec.rate.is_limited() || exec.budget_ns != 0;
        Ok(())
    }

    /// Makes another kind of call than `process`, on the thread that runs the node, watched by the watchdog.
    ///
    /// # Errors
    /// The watchdog abandoned the call; its result is dropped here, on the abandoned thread.
    pub fn call_watched<R>(&self, kind: CallKind, tick: &Tick, call: impl FnOnce() -> R) -> Result<R, Abandoned> {
        let start_ns = clock::now_ns();
        self.busy.begin_kind(kind, tick, start_ns);
        let answer = call();
        if self.busy.end(start_ns) { Ok(answer) } else { Err(Abandoned) }
    }

    /// Records that the node skipped a tick although its inputs were complete.
    pub fn skipped_tick(&self, context: &RunContext, tick: &Tick, closed: bool) {
        self.record_event(context, |node| Event::Skipped { node, tick: *tick, closed });
    }

    /// Records that the node continues with an instance that was opened with these values.
    pub fn opened(&self, snapshot: &Snapshot, context: &RunContext, tick: &Tick) {
        let values = || snapshot.owned().to_vec();
        self.record_event(context, |node| Event::Opened { node, tick: *tick, values: values() });
    }

    #[cold]
    fn install_replacement(&self, exec: &mut Exec, context: &RunContext, tick: &Tick) -> Result<(), Abandoned> {
        let Some((mut instance, snapshot)) = self.config.take_replacement() else { return Ok(()) };
        if let Some(snapshot) = snapshot {
            exec.set_snapshot(snapshot);
        }
        self.transfer_state(exec, &mut instance, context, tick)?;
        self.recovery.forget_kept_position();
        let old = std::mem::replace(&mut exec.instance, instance.begun());
        if old.is_open() {
            self.call_watched(CallKind::Close, tick, || self.end(context, old))?;
        }
        exec.bypassed = false;
        self.recovery.set_permanent(false);
        exec.bad_in_a_row = 0;
        if context.observer.is_some() {
            self.opened(&self.snapshot(), context, tick);
        }
        Ok(())
    }

    /// Transfers the state of the running instance to its successor, if both support it.
    pub fn transfer_state(
        &self,
        exec: &mut Exec,
        successor: &mut Instance,
        context: &RunContext,
        tick: &Tick,
    ) -> Result<(), Abandoned> {
        if !exec.instance.saves_state() {
            return Ok(());
        }
        if let Some(state) = self.call_watched(CallKind::SaveState, tick, || exec.instance.save_state(&context.host))?
            && !self.call_watched(CallKind::LoadState, tick, || successor.load_state(&state))?
        {
            self.warn_state_lost(context);
        }
        Ok(())
    }

    /// Logs that a saved state is lost.
    pub fn warn_state_lost(&self, context: &RunContext) {
        context.log.write(Level::Warn, &self.id, "it did not understand the state of its predecessor and starts anew");
    }

    #[inline]
    fn is_due(&self, exec: &mut Exec, context: &RunContext, tick: &Tick, start_ns: u64, inputs: &[FrameRef]) -> Due {
        if exec.limited && exec.rate.is_limited() && !exec.rate.is_due(tick.capture_ns, present(inputs)) {
            return Due::Skip;
        }
        if exec.bypassed {
            return Due::Skip;
        }
        let mut start_ns = start_ns;
        if !exec.instance.is_open() {
            if !context.batch {
                return Due::Skip;
            }
            match self.open_in_batch(exec, context, tick) {
                Ok(true) => start_ns = clock::now_ns(),
                Ok(false) => return Due::Skip,
                Err(Abandoned) => return Due::Abandoned,
            }
        }
        if exec.limited && !exec.source {
            exec.rate.run(tick.capture_ns);
        }
        Due::Run { start_ns }
    }

    fn call(
        &self,
        exec: &mut Exec,
        context: &RunContext,
        tick: &mut Tick,
        ports: &mut Ports<'_>,
    ) -> (abi::Status, Option<Refused>) {
        let Some(process) = exec.process else { return (abi::STATUS_INVALID, None) };
        if device_in_use() && !exec.fetches {
            ports.inputs.iter().for_each(|input| _ = memory().fetch(input.frame()));
        }
        let made = &mut *ports.made;
        match &mut made.shown[..] {
            [one] => *one = abi::Frame::EMPTY,
            all => all.fill(abi::Frame::EMPTY),
        }
        let (inputs, inputs_len) = (ports.inputs.as_ptr().cast::<abi::Frame>(), ports.inputs.len());
        let (params, params_len) = exec.params();
        let ranges: &[PortRange] = if ports.lone { ONE_INPUT } else { &exec.ranges };
        let mut call_context = CallContext {
            outputs: made.outputs.as_mut_ptr(),
            shown: made.shown.as_mut_ptr(),
            outputs_len: made.outputs.len(),
            inputs,
            inputs_len,
            lent: None,
            first_formats: exec.first_formats(),
            runtime: self,
            holds: &exec.instance.holds,
            written: 0,
            failure: &mut exec.failure,
            has_failure: false,
            refused: None,
            random: None,
            tick: *tick,
            context,
            sources: Some(ports.sources),
            times: Some(&mut exec.times),
            has_times: false,
            is_trial: false,
        };
        let mut call = abi::Call {
            struct_size: size_of::<abi::Call>() as u32,
            flags: if context.batch { abi::CALL_BATCH } else { 0 },
            host: &raw const context.host,
            call: (&raw mut call_context).cast(),
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
            outputs_read: self.outputs_read(),
        };
        let raw = exec.instance.raw;
        current_node::begin_call(self);
        // SAFETY: the plugin contract: an open instance that no other thread uses, and a call whose parts outlive it.
        let status = exec.instance.retained.during(|| unsafe { process(raw, &raw mut call) });
        current_node::end_call();
        let mut refused = call_context.refused.take();
        let reports = call_context.has_failure && status >= abi::STATUS_OK;
        if call_context.has_times {
            self.take_times(tick, &mut call_context, &mut made.outputs);
        }
        if let Some(lent) = call_context.lent {
            // From here on the output holds the input's reference.
            ports.inputs[lent.input as usize].forget();
        }
        if call_context.written != 0 {
            self.find_overruns(call_context.written, &mut refused, made);
        }
        if self.group.is_some() {
            self.receive(status, &mut refused, made);
        }
        if exec.source {
            tick.capture_ns = call.tick.capture_ns;
            for frame in made.outputs.iter_mut().filter(|f| !f.is_empty()) {
                frame.tick = *tick;
            }
        }
        if reports {
            self.reported(exec, context, tick, status);
        }
        (status, refused)
    }

    /// Withholds outputs whose end the node overran: the next buffer, of any node, may be damaged.
    fn find_overruns(&self, written: u64, refused: &mut Option<Refused>, made: &mut CallOutputs) {
        for (index, frame) in made.outputs.iter_mut().enumerate() {
            if written & output_bit(index as u32) == 0 || frame.is_empty() || memory().is_intact(frame.buffer) {
                continue;
            }
            let name = self.rules.get(index).map_or("?", |rule| &rule.name);
            let words = format!(
                "it wrote beyond the {} bytes of output `{name}`: frames of other nodes may be damaged; repair the plugin, or run the node \
                 with `isolate`",
                frame.len
            );
            refused.get_or_insert_with(|| Box::new((Cause::BadOutput, words)));
            // SAFETY: the call has ended, so the output holds its reference.
            unsafe { clear(std::slice::from_mut(frame)) };
            made.shown[index] = abi::Frame::EMPTY;
        }
    }

    /// Copies the packets of an isolated node to memory that its process cannot write, so that what a reader checked
    /// stays true. Pixels stay where they are: all bytes are pixels.
    #[cold]
    fn receive(&self, status: abi::Status, refused: &mut Option<Refused>, made: &mut CallOutputs) {
        if status == STATUS_DIED {
            *refused = Some(Box::new((Cause::Crash, String::new())));
        }
        for (frame, shown) in made.outputs.iter_mut().zip(&mut made.shown) {
            let own = !frame.is_empty() && self.domain() == Some(Memory::domain_of(frame.buffer));
            if !own || frame.format != abi::FORMAT_BYTES {
                continue;
            }
            let new = match memory().allocate(frame.len) {
                Ok((buffer, data)) => abi::Frame { buffer, data, ..*frame },
                Err(error) => {
                    refused.get_or_insert_with(|| Box::new((Cause::Exhausted, error.to_string())));
                    abi::Frame::EMPTY
                }
            };
            if !new.is_empty() {
                // SAFETY: two buffers of at least `len` bytes; the new one is known only here.
                unsafe { std::ptr::copy_nonoverlapping(frame.data, new.data, frame.len) };
            }
            let untouched = is_same(frame, shown);
            // SAFETY: the call has ended, so the output holds its reference, which `new` replaces.
            drop(unsafe { FrameRef::adopt(std::mem::replace(frame, new)) });
            if untouched {
                *shown = new;
            }
        }
    }

    /// Passes the input ages that the node received to the observer, and the age that it declared to its readers.
    #[cold]
    fn take_times(&self, tick: &mut Tick, call: &mut CallContext<'_>, outputs: &mut [abi::Frame]) {
        let run = call.context;
        if let Some(ages) = run.observer.as_ref().and_then(|_| call.answered()) {
            self.record_event(run, |node| Event::Ages { node, tick: *tick, ages });
        }
        let lag = call.end_times();
        tick.flags = later(tick.flags, lag);
        outputs.iter_mut().for_each(|frame| frame.tick.flags = later(frame.tick.flags, lag));
    }

    /// Checks the outputs of a call that reported success.
    #[inline]
    fn accept(
        &self,
        exec: &mut Exec,
        context: &RunContext,
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
                    self.progress.record_port(exec, index);
                } else if from != (0, 0) {
                    self.progress.record_size_change(SizeChange { output: index, tick: *tick, from, to });
                }
            }
        }
        if let Some(refused) = refused {
            return self.bad_output(exec, made, context, tick, *refused, end_ns);
        }
        let silent = count == 0 && exec.outputs_len != 0;
        if exec.troubled || silent || attention() {
            return self.accept_troubled(exec, context, tick, silent, end_ns, made);
        }
        CallOutcome::Ok
    }

    /// The rest of [`Self::accept`] for a node with recent faults, without outputs, or with retained frames.
    #[cold]
    fn accept_troubled(
        &self,
        exec: &mut Exec,
        context: &RunContext,
        tick: &Tick,
        silent: bool,
        end_ns: u64,
        made: &mut CallOutputs,
    ) -> CallOutcome {
        exec.bad_in_a_row = 0;
        self.report_refused_frames(exec, context, tick);
        if exec.instance.retained.count() > MAX_RETAINED_FRAMES {
            made.clear();
            exec.failure.clear();
            exec.failure.push_str("it retains too many frames: a leak");
            let leak = Box::new((Cause::Leak, String::new()));
            return self.failed(exec, context, abi::STATUS_ERROR, Some(leak), tick, end_ns);
        }
        if silent {
            exec.silent_calls = exec.silent_calls.saturating_add(1);
            let silent = exec.silent_calls;
            if silent >= SILENT_CALLS && silent.is_multiple_of(SILENT_CALLS) && self.outputs_read() != 0 {
                let words = || format!("its inputs are complete, but it made nothing for {silent} ticks");
                self.report_repeated_fault(context, Cause::Silent, Action::Note, Some(tick.seq), words);
            }
        } else {
            exec.silent_calls = 0;
        }
        if exec.failed_at_ns != 0 {
            self.stats.recovery.record(end_ns.saturating_sub(exec.failed_at_ns));
            exec.failed_at_ns = 0;
        }
        if exec.failures_in_a_row != 0 {
            self.recovery.report_success(exec);
        }
        exec.troubled = silent;
        CallOutcome::Ok
    }

    /// Reports that the host refused to retain or release a frame which the node does not hold. The node continues.
    fn report_refused_frames(&self, exec: &Exec, context: &RunContext, tick: &Tick) {
        if exec.instance.retained.take_refused() == 0 {
            return;
        }
        bump(&self.stats.faults);
        self.report_repeated_fault(context, Cause::Release, Action::Note, Some(tick.seq), || {
            let words = "it released or retained a frame that it does not hold; the host refused this".to_owned();
            context.log.write(Level::Error, &self.id, &words);
            words
        });
    }
}
