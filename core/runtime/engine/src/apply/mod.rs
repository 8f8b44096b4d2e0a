//! Changing a running graph: one transaction from the graph that runs to another checked one.
//!
//! New nodes open while the old ones run. The regions that the change touches stop admitting ticks; sources continue
//! and their ticks are retained. When the ticks inside have finished, the engine switches the plan and the retained
//! ticks enter. Other regions are not affected. A failure before the switch leaves everything as it was.

mod change;
mod switch;

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use panoscope_graph::{Catalog, Graph, Mode};

use self::change::{Change, NodeChange, Opened, Opens, When};
use self::switch::Switch;
use crate::applied::{Applied, ApplyError};
use crate::busy::CallKind;
use crate::engine::{Engine, type_name};
use crate::guard::{CallError, Limit};
use crate::instance::Instance;
use crate::log::Level;
use crate::memory::memory;
use crate::node::NodeRuntime;
use crate::params::Snapshot;
use crate::plan::{Extent, Plan};
use crate::plugins::Plugins;
use crate::region::Region;
use crate::schedule::Ready;
use crate::sync::lock;

/// Maximum wait for the ticks inside a region.
const MAX_DRAIN: Duration = Duration::from_secs(10);

/// Maximum wait for the threads of nodes that were removed.
const MAX_LEAVE: Duration = Duration::from_secs(2);

impl Engine {
    /// Changes the running graph into another one that was checked against `catalog`, as one transaction: all of it or
    /// nothing.
    ///
    /// Nodes of the same name and type keep their instance, counters and inputs; untouched paths lose no tick.
    ///
    /// # Errors
    /// The running graph is unchanged.
    pub fn apply(&self, graph: Graph, catalog: &Catalog, plugins: &dyn Plugins) -> Result<Applied, ApplyError> {
        self.apply_when(graph, catalog, plugins, &When::Now)
    }

    /// Like [`Self::apply`], but switched at given ticks: for each source of `at`, the tick of that number is the first
    /// that meets the new graph. Blocks until these ticks have come.
    ///
    /// # Errors
    /// As [`Self::apply`], and when such a tick has already entered the graph.
    pub fn apply_at(
        &self,
        graph: Graph,
        catalog: &Catalog,
        plugins: &dyn Plugins,
        at: &[(String, u64)],
    ) -> Result<Applied, ApplyError> {
        self.apply_when(graph, catalog, plugins, &When::At(at))
    }

    /// Makes change number `edit` of the run that the decider repeats, at the same tick as in that run.
    ///
    /// # Errors
    /// As [`Self::apply`].
    pub fn apply_as_decided(
        &self,
        edit: usize,
        graph: Graph,
        catalog: &Catalog,
        plugins: &dyn Plugins,
    ) -> Result<Applied, ApplyError> {
        self.apply_when(graph, catalog, plugins, &When::Recorded(edit))
    }

    fn apply_when(
        &self,
        graph: Graph,
        catalog: &Catalog,
        plugins: &dyn Plugins,
        when: &When<'_>,
    ) -> Result<Applied, ApplyError> {
        let _change = self.change.lock();
        let shared = &self.shared;
        if shared.is_stopping() || self.is_finished() {
            return Err(ApplyError::Ended);
        }
        if (graph.mode == Mode::Batch) != shared.context.batch {
            return Err(ApplyError::Mode);
        }
        let (old, current) = (shared.plan.load_full(), self.current.load_full());
        let entry = |plugin: &str, node_type: &str| plugins.entry(plugin, node_type);
        let as_once = match (when, &shared.context.decider) {
            (When::Recorded(edit), Some(decider)) => decider.replaced(*edit),
            _ => &[],
        };
        shared.context.groups.set_isolator(plugins.isolator());
        let mut change = Change::between(&old, &current, &graph, catalog, &entry, as_once, &shared.context)?;
        if let When::At(at) = when {
            change.hold_also(&old, at)?;
        }
        // Nodes that the change closes write until the switch; nodes that it opens start writing after it.
        let leaving = shared.context.claims.leaving(change.leaving(&old, &graph));
        let mut early = self.open_early(&change, &graph)?;

        // From here until the switch the held regions process no tick.
        let start = Instant::now();
        let still = self
            .come_to(&old, &change, when)
            .and_then(|()| self.hold(&old, &change))
            .and_then(|()| self.transfer_states(&old, &change, &mut early))
            .and_then(|()| self.open_late(&old, &change, &graph));
        let still = match still {
            // The engine is closing and waits for this change only for a limited time.
            Ok(late) if shared.is_stopping() => Err((ApplyError::Ended, late)),
            Ok(late) => Ok(late),
            Err(error) => Err((error, Vec::new())),
        };
        let late = match still {
            Ok(late) => late,
            Err((error, late)) => {
                self.let_go(&old, &change);
                early.extend(late);
                self.close_opened(&change, early);
                return Err(error);
            }
        };
        drop(leaving);
        early.extend(late);
        let switch = Switch { engine: self, old: &old, current: &current, catalog, plugins, when, start };
        Ok(switch.run(change, graph, early))
    }

    /// Waits for the ticks before the change.
    fn come_to(&self, old: &Plan, change: &Change, when: &When<'_>) -> Result<(), ApplyError> {
        let shared = &self.shared;
        let mut named = Vec::new();
        if let When::At(at) = when {
            for (source, seq) in *at {
                let is = |(_, extent): &&(Arc<Region>, Extent)| old.runtimes[extent.head].id == *source;
                let Some((region, extent)) = change.held.iter().find(is) else { continue };
                let made = old.runtimes[extent.head].ticks.made();
                let passed = |next| ApplyError::Passed { source_node: source.clone(), seq: *seq, next };
                region.pause_before(*seq, made).map_err(passed)?;
                named.push((region, extent.head));
            }
        }
        let waits = || match (when, &shared.context.decider) {
            (When::Now, _) | (When::Recorded(_), None) => false,
            (When::At(_), _) => {
                let over = |head: usize| lock(&old.runtimes[head].join).is_finished();
                named.iter().any(|(region, head)| !region.is_paused() && !over(*head))
            }
            (When::Recorded(edit), Some(decider)) => {
                decider.waits_before(*edit) || change.held.iter().any(|h| busy_member(old, h).is_some())
            }
        };
        while waits() {
            if shared.is_stopping() || self.is_finished() {
                return Err(ApplyError::Ended);
            }
            std::thread::sleep(Duration::from_micros(100));
        }
        Ok(())
    }

    /// Opens nodes of the new graph one after the other, each within its time limit. If one fails, closes those opened
    /// before it.
    fn open_each(&self, change: &Change, graph: &Graph, nodes: &[usize]) -> Result<Vec<Opened>, ApplyError> {
        let shared = &self.shared;
        let runtime = |node: usize| &change.plan.runtimes[change.plan.slots[node]];
        let snapshots: Vec<Arc<Snapshot>> = nodes
            .iter()
            .map(|&node| {
                shared.context.make_all_recorded_outputs(runtime(node));
                let reopened = change.node_changes[node].is_reopened();
                if reopened { Snapshot::new(graph.nodes[node].params.clone()) } else { runtime(node).snapshot() }
            })
            .collect();
        let calls = nodes.iter().zip(&snapshots).map(|(&node, snapshot)| shared.opening(runtime(node), snapshot));
        let mut opened = Vec::with_capacity(nodes.len());
        let mut failed = None;
        let limit = Limit::until_stop(shared.context.open_limit);
        shared.guarded(limit, Result::is_ok, calls.collect::<Vec<_>>(), |_, answer| {
            let (node, snapshot) = (nodes[opened.len()], &snapshots[opened.len()]);
            match answer {
                Ok(Ok(instance)) => opened.push(Opened { node, instance, snapshot: Arc::clone(snapshot) }),
                Ok(Err(refusal)) => {
                    let (id, node_type) = (graph.nodes[node].id.clone(), graph.nodes[node].type_name.clone());
                    failed = Some(ApplyError::Open { node: id, node_type, reason: refusal.message });
                }
                Err(error) => failed = Some(no_answer(&graph.nodes[node].id, &error)),
            }
            if failed.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        match failed {
            None => Ok(opened),
            Some(error) => {
                self.close_opened(change, opened);
                Err(error)
            }
        }
    }

    /// Closes instances that were opened for a change that failed.
    fn close_opened(&self, change: &Change, opened: Vec<Opened>) {
        for Opened { node, instance, .. } in opened {
            self.shared.close_guarded(&change.plan.runtimes[change.plan.slots[node]], vec![instance]);
        }
    }

    /// Opens the instances that may be open next to the running nodes.
    fn open_early(&self, change: &Change, graph: &Graph) -> Result<Vec<Opened>, ApplyError> {
        // A decider sets the tick at which a node continues with a new instance.
        let scripted = self.shared.context.decider.is_some();
        let wanted = |c: NodeChange| c.opens() == Some(Opens::Beside) && !(c.is_reopened() && scripted);
        let nodes: Vec<usize> = (0..graph.nodes.len()).filter(|&n| wanted(change.node_changes[n])).collect();
        self.open_each(change, graph, &nodes)
    }

    /// Waits until no node is busy. Fails when the engine stops or the time is over.
    fn wait_for(&self, until: Instant, busy: impl Fn() -> Option<String>) -> Result<(), ApplyError> {
        let before_bytes = memory().in_use_bytes();
        // Sources go on meanwhile, and so do other regions: they need frames, too.
        let max_bytes = (memory().limit_bytes() - before_bytes) / 4 * 3;
        while let Some(node) = busy() {
            let waiting_bytes = memory().in_use_bytes() - before_bytes;
            if waiting_bytes > max_bytes {
                return Err(ApplyError::Memory { node, waiting_mb: waiting_bytes >> 20 });
            }
            if self.shared.is_stopping() {
                return Err(ApplyError::Ended);
            }
            if Instant::now() >= until {
                return Err(ApplyError::Busy { node, seconds: MAX_DRAIN.as_secs() });
            }
            std::thread::sleep(Duration::from_micros(50));
        }
        Ok(())
    }

    /// Saves the state of a node at rest for its successor, and closes it if `closes` is set.
    ///
    /// # Errors
    /// The node did not return: its instance is lost, and the node restarts.
    fn save(&self, runtime: &Arc<NodeRuntime>, closes: bool) -> Result<Option<Vec<u8>>, ApplyError> {
        let shared = &self.shared;
        let limit = Limit::until_stop(shared.context.close_limit);
        let Some(mut instance) = runtime.take_instance() else { return Ok(None) };
        let lost = |error: CallError| {
            shared.report_no_return(runtime, &error);
            shared.start_restart(runtime);
            no_answer(&runtime.id, &error)
        };
        let mut state = None;
        if instance.saves_state() {
            let me = Arc::clone(shared);
            let save = move || {
                let state = instance.save_state(&me.context.host);
                (instance, state)
            };
            (instance, state) = shared.call_guarded(limit, runtime, CallKind::SaveState, save).map_err(lost)?;
        }
        if closes {
            let (me, mine) = (Arc::clone(shared), Arc::clone(runtime));
            let end = move || mine.end(&me.context, instance);
            shared.call_guarded(limit, runtime, CallKind::Close, end).map_err(lost)?;
        } else {
            runtime.exec.with(|exec| exec.instance = instance);
        }
        Ok(state)
    }

    /// Loads a state into a new instance.
    ///
    /// # Errors
    /// The node did not return: the instance is lost.
    fn load(
        &self,
        runtime: &Arc<NodeRuntime>,
        instance: Instance,
        state: Option<&Vec<u8>>,
    ) -> Result<Instance, ApplyError> {
        let Some(state) = state.cloned() else { return Ok(instance) };
        match self.shared.load_guarded(runtime, instance, state) {
            Ok((instance, understood)) => {
                if !understood {
                    runtime.warn_state_lost(&self.shared.context);
                }
                Ok(instance)
            }
            Err(error) => Err(no_answer(&runtime.id, &error)),
        }
    }

    /// Transfers the states of replaced nodes to their successors, which are open at the same time. All are at rest.
    fn transfer_states(&self, old: &Plan, change: &Change, early: &mut Vec<Opened>) -> Result<(), ApplyError> {
        let mut rest = std::mem::take(early).into_iter();
        let mut failed = Ok(());
        for Opened { node, instance, snapshot } in rest.by_ref() {
            let slot = change.plan.slots[node];
            let runtime = &change.plan.runtimes[slot];
            let heir = change.node_changes[node].is_replaced()
                && type_name(old.runtimes[slot].node_type) == type_name(runtime.node_type);
            let state = if heir { self.save(&old.runtimes[slot], false) } else { Ok(None) };
            let loaded = match state {
                Ok(state) => self.load(runtime, instance, state.as_ref()),
                Err(error) => {
                    early.push(Opened { node, instance, snapshot });
                    failed = Err(error);
                    break;
                }
            };
            match loaded {
                Ok(instance) => early.push(Opened { node, instance, snapshot }),
                Err(error) => {
                    failed = Err(error);
                    break;
                }
            }
        }
        early.extend(rest);
        failed
    }

    /// Pauses the touched regions and waits until no tick is inside.
    fn hold(&self, old: &Plan, change: &Change) -> Result<(), ApplyError> {
        let until = Instant::now() + MAX_DRAIN;
        for &slot in &change.quiet {
            old.runtimes[slot].runner.leave.request();
            old.runtimes[slot].runner.wake();
        }
        let pause = |(region, extent): &(Arc<Region>, Extent)| {
            extent.members.iter().for_each(|&member| lock(&old.runtimes[member].join).pause());
            region.pause();
        };
        if self.shared.context.batch {
            // A region may wait for packets of regions before it, so pause the last one first.
            for held in change.held.iter().rev() {
                pause(held);
                self.wait_for(until, || busy_member(old, held))?;
            }
        } else {
            change.held.iter().for_each(pause);
            self.wait_for(until, || change.held.iter().find_map(|held| busy_member(old, held)))?;
        }
        self.wait_for(until, || {
            let stays = |slot: &&usize| old.runtimes[**slot].runner.has_thread();
            change.quiet.iter().find(stays).map(|&slot| old.runtimes[slot].id.clone())
        })
    }

    /// Closes exclusive predecessors and opens their successors. On failure reopens all predecessors.
    fn open_late(&self, old: &Plan, change: &Change, graph: &Graph) -> Result<Vec<Opened>, ApplyError> {
        let nodes: Vec<usize> =
            (0..graph.nodes.len()).filter(|&n| change.node_changes[n].opens_after_close()).collect();
        if nodes.is_empty() {
            return Ok(Vec::new());
        }
        let replaced = nodes.iter().filter(|&&n| !change.node_changes[n].is_added()).map(|&n| change.plan.slots[n]);
        let closing: Vec<usize> =
            replaced.chain(change.removed.iter().copied().filter(|&s| old.runtimes[s].exclusive)).collect();
        let mut states: Vec<(usize, Option<Vec<u8>>)> = Vec::new();
        for &slot in &closing {
            match self.save(&old.runtimes[slot], true) {
                Ok(state) => states.push((slot, state)),
                Err(error) => {
                    self.reopen(old, &states);
                    return Err(error);
                }
            }
        }
        let mut opened: Vec<Opened> = Vec::new();
        for node in nodes {
            let slot = change.plan.slots[node];
            let state = states.iter().find(|(s, _)| *s == slot).and_then(|(_, state)| state.as_ref());
            let new = self.open_each(change, graph, &[node]).and_then(|new| {
                let loaded = new.into_iter().map(|Opened { node, instance, snapshot }| {
                    let instance = self.load(&change.plan.runtimes[slot], instance, state)?;
                    Ok(Opened { node, instance, snapshot })
                });
                loaded.collect::<Result<Vec<_>, ApplyError>>()
            });
            match new {
                Ok(new) => opened.extend(new),
                Err(error) => {
                    self.close_opened(change, opened);
                    self.reopen(old, &states);
                    return Err(error);
                }
            }
        }
        Ok(opened)
    }

    /// Reopens nodes that were closed for a change that failed.
    fn reopen(&self, old: &Plan, states: &[(usize, Option<Vec<u8>>)]) {
        for (slot, state) in states {
            let runtime = &old.runtimes[*slot];
            let opened = self.shared.open_guarded(runtime, &runtime.snapshot()).map_err(|error| error.to_string());
            let loaded = opened
                .and_then(|instance| self.load(runtime, instance, state.as_ref()).map_err(|error| error.to_string()));
            match loaded {
                Ok(instance) => _ = runtime.exec.with(|exec| exec.instance = instance.begun()),
                Err(words) => {
                    runtime.open_failed(&self.shared.context, &words, None);
                    self.shared.start_restart(runtime);
                }
            }
        }
    }

    /// Undoes the pause after a change that failed.
    fn let_go(&self, old: &Plan, change: &Change) {
        for &slot in &change.quiet {
            let runtime = &old.runtimes[slot];
            // A thread that has not seen the request yet continues.
            if runtime.runner.leave.withdraw() {
                continue;
            }
            while runtime.runner.has_thread() {
                std::thread::sleep(Duration::from_micros(50));
            }
            runtime.runner.leave.reset();
            self.start_thread(slot, runtime);
        }
        let mut ready = Ready::default();
        // A region that was never paused continues by itself.
        for (region, extent) in change.held.iter().filter(|(region, _)| region.stop_waiting()) {
            self.resume(old, region, extent, &mut ready);
        }
        ready.dispatch_ready(&self.shared, old, 0);
    }

    fn start_thread(&self, slot: usize, runtime: &Arc<NodeRuntime>) {
        if let Err(cause) = self.shared.start_thread(slot, runtime) {
            self.shared.fail_for_good(format!("no thread could be started for node `{}`: {cause}", runtime.id));
        }
    }

    fn resume(&self, plan: &Plan, region: &Region, extent: &Extent, ready: &mut Ready) {
        let head = extent.head;
        resume_inputs(plan, extent);
        let mut waited = region.resume();
        while !waited.is_empty() {
            for outputs in waited {
                self.shared.enter(plan, head, outputs, ready);
            }
            waited = region.handed_over().into_iter().collect();
        }
        self.shared.try_fire_head(plan, head, ready);
    }

    /// Closes nodes that are no longer part of the graph, so that their files are finished.
    fn close_old(&self, old: &Plan, slots: &[usize]) {
        let until = Instant::now() + MAX_LEAVE;
        for &slot in slots {
            let runtime = &old.runtimes[slot];
            // A node with its own thread closes on that thread.
            let stays = || runtime.owns_thread() && runtime.runner.has_thread();
            while stays() && Instant::now() < until {
                runtime.runner.wake();
                std::thread::sleep(Duration::from_micros(200));
            }
            if stays() {
                // The thread closes the node if it ever returns. Workers that are stuck in its loops are replaced too.
                let words = "it was removed and does not return; it is left behind, and its files may be incomplete";
                self.shared.context.log.write(Level::Error, &runtime.id, words);
                let mut threads = lock(&self.shared.own_threads);
                let number =
                    threads.iter().find(|(_, thread)| Arc::ptr_eq(&thread.runtime, runtime)).map(|(number, _)| *number);
                number.map(|number| threads.remove(&number));
                drop(threads);
                if let Some(Err(cause)) = number.map(|number| self.shared.pool.give_up(number)) {
                    self.shared.fail_for_good(format!("no thread could be started to replace one that hangs: {cause}"));
                }
                continue;
            }
            let (instances, _) = runtime.take_instances();
            self.shared.close_guarded(runtime, instances);
        }
        self.shared.forget_ended_threads();
    }
}

/// The error of a call that did not return.
fn no_answer(node: &str, error: &CallError) -> ApplyError {
    ApplyError::NoReturn { node: node.to_owned(), reason: error.to_string() }
}

/// Ends the pause of the inputs of a region's nodes.
fn resume_inputs(plan: &Plan, extent: &Extent) {
    let alive = extent.members.iter().filter(|&&member| plan.alive[member]);
    alive.for_each(|&member| lock(&plan.runtimes[member].join).resume());
}

/// A node of a paused region that is still busy.
fn busy_member(plan: &Plan, (region, extent): &(Arc<Region>, Extent)) -> Option<String> {
    let works = |slot: usize| {
        let runtime = &plan.runtimes[slot];
        // A source may continue: its region retains what it makes.
        !runtime.source && (lock(&runtime.join).is_running() || !runtime.exec.is_home())
    };
    let member = extent.members.iter().copied().find(|&slot| works(slot));
    let inside = region.in_flight() > 0;
    member.or(inside.then_some(extent.head)).map(|slot| plan.runtimes[slot].id.clone())
}
