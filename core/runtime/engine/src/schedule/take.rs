//! Choice of a node's next tick: by the clock, or by the decider.

use std::sync::atomic::Ordering;

use panoscope_abi::Tick;

use super::{Next, Ready, Shared};
use crate::clock;
use crate::fault::{Action, Cause};
use crate::join::{Join, Take};
use crate::light::Lights;
use crate::memory::FrameRef;
use crate::node::NodeRuntime;
use crate::observe::Event;
use crate::plan::Plan;
use crate::region::Region;
use crate::sync::lock;

impl Shared {
    fn gate<'p>(&self, plan: &'p Plan, node: usize, join: &Join) -> Option<&'p Region> {
        plan.regions.get(plan.wiring[node].region).filter(|_| join.heads_region()).map(|r| &**r)
    }

    /// Tries to take the next tick of a node that no thread runs, or that this thread just ran.
    pub(super) fn decide(&self, plan: &Plan, node: usize, join: &mut Join) -> Next {
        let now_ns = if join.is_timed() { clock::now_ns() } else { 0 };
        let lights = Lights { sources: plan, by_capture: self.context.ignores_wall_clock(), now_ns };
        let take = if self.context.observer.is_none() && self.context.decider.is_none() {
            join.try_take(self.gate(plan, node, join), &lights)
        } else {
            self.take_observed(plan, node, join, &lights)
        };
        if let Some(slot) = join.too_old_on.take() {
            self.report_too_old(&plan.runtimes[node], join, slot);
        }
        if take == Take::Wait && join.nearest_deadline_ns != 0 {
            self.waiting_nearest.store(1, Ordering::Relaxed);
        }
        join.set_running(matches!(take, Take::Fire { .. }));
        match take {
            Take::Fire { .. } => Next::Run,
            Take::Wait => Next::Idle,
            Take::Finished if join.finish() => Next::Finish,
            Take::Finished => Next::Idle,
        }
    }

    /// Like [`Join::try_take`], with decisions that depend on time reported to the observer or made by the decider.
    #[cold]
    fn take_observed(&self, plan: &Plan, node: usize, join: &mut Join, lights: &Lights<'_>) -> Take {
        let (runtime, region) = (&plan.runtimes[node], self.gate(plan, node, join));
        let decider = self.context.decider.as_ref().filter(|d| d.leads_nodes() && join.is_timed());
        let take = match decider {
            Some(decider) => {
                let may_enter = region.is_none() || decider.may_enter(&runtime.id);
                let take = join.take_wanted(region, decider.took(&runtime.id), may_enter, lights);
                if matches!(take, Take::Fire { .. }) && region.is_some() {
                    decider.entered(&runtime.id);
                }
                take
            }
            None => join.try_take(region, lights),
        };
        if let (Take::Fire { tick, .. }, Some(observer), true) = (take, &self.context.observer, join.is_timed()) {
            if region.is_some() {
                observer.admitted(&runtime.id);
            }
            observer.event(Event::Took { node: runtime.id.clone(), tick, inputs: join.staged_ticks() });
        }
        take
    }

    /// Puts the inputs of a source into `inputs`; `false` while the previous tick's value is still being made.
    pub(crate) fn take_source(&self, runtime: &NodeRuntime, tick: Tick, inputs: &mut Vec<FrameRef>) -> bool {
        let mut join = lock(&runtime.join);
        let now_ns = if join.is_timed() { clock::now_ns() } else { 0 };
        let lights = Lights { sources: self, by_capture: self.context.ignores_wall_clock(), now_ns };
        let is_staged = join.take_source(tick, &lights);
        if let Some(slot) = join.too_old_on.take() {
            self.report_too_old(runtime, &join, slot);
        }
        inputs.append(&mut join.staged);
        is_staged
    }

    /// Reports an input that counts as absent, because it is older than its edge allows.
    #[cold]
    fn report_too_old(&self, runtime: &NodeRuntime, join: &Join, slot: usize) {
        let seq = join.staged_take.map(|(tick, _)| tick.seq);
        runtime.report_repeated_fault(&self.context, Cause::TooOld, Action::Withhold, seq, || {
            let name = runtime.port_of_slot(slot).map_or("?", |port| runtime.input_name(port));
            let slot = &join.slots[slot];
            let (count, max_ms) = (slot.too_old, slot.max_age_ns.unwrap_or(0) as f64 / 1e6);
            let message = format!(
                "input `{name}` was older than `max_age_ms = {max_ms}` at {count} ticks so far: they went on without it"
            );
            self.context.log.write(crate::log::Level::Warn, &runtime.id, &message);
            message
        });
    }

    /// Takes the next tick of the node that this thread runs. Returns whether it is staged.
    pub fn take_next(&self, plan: &Plan, node: usize, ready: &mut Ready) -> bool {
        let next = self.decide(plan, node, &mut lock(&plan.runtimes[node].join));
        if next == Next::Finish {
            self.finish(node, ready);
        }
        next == Next::Run
    }

    /// Tries to fire a node that no thread runs.
    pub fn try_fire(&self, plan: &Plan, node: usize, ready: &mut Ready) {
        let mut join = lock(&plan.runtimes[node].join);
        if !join.is_idle() {
            return;
        }
        let next = self.decide(plan, node, &mut join);
        drop(join);
        self.go_on(plan, node, next, ready);
    }

    pub(super) fn go_on(&self, plan: &Plan, node: usize, next: Next, ready: &mut Ready) {
        match next {
            // Wakes a sleeping thread first, because waking takes longer than the rest of this function.
            Next::Run if plan.runtimes[node].owns_thread() => self.dispatch(plan, node),
            Next::Run => ready.push(self, plan, node),
            Next::Idle => {}
            Next::Finish => self.finish(node, ready),
        }
    }
}
