//! The switch from one plan to the next: the part of a change that cannot fail.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use panoscope_graph::{Catalog, Graph};

use super::change::{Change, NodeChange, Opened, Opens, When, connections, inherited};
use super::resume_inputs;
use crate::applied::Applied;
use crate::engine::{Current, Engine, type_name};
use crate::instance::Instance;
use crate::node::NodeRuntime;
use crate::observe::Event;
use crate::params::Snapshot;
use crate::plan::{self, Extent, Plan};
use crate::plugins::Plugins;
use crate::region::Region;
use crate::schedule::Ready;
use crate::sync::lock;

/// A switch of the plan while the touched regions are at rest.
pub(super) struct Switch<'a> {
    pub engine: &'a Engine,
    pub old: &'a Arc<Plan>,
    pub current: &'a Current,
    pub catalog: &'a Catalog,
    pub plugins: &'a dyn Plugins,
    pub when: &'a When<'a>,
    /// When the regions were asked to rest.
    pub start: Instant,
}

impl Switch<'_> {
    /// Switches to the plan of `change`, with these new instances.
    pub(super) fn run(&self, change: Change, graph: Graph, opened: Vec<Opened>) -> Applied {
        let shared = &self.engine.shared;
        let mut applied = Applied::default();
        // Keeps the count of unfinished nodes above zero until the switch is complete.
        shared.unfinished.fetch_add(1, Ordering::AcqRel);
        let order = lock(&shared.finishing);
        let Change { plan, node_changes, removed, held, quiet } = change;
        let opened = opened.into_iter();
        let unused: Vec<_> = opened.filter_map(|opened| Self::install(&plan, &node_changes, opened)).collect();
        let threads = self.set_up_nodes(&plan, &graph, &node_changes, &quiet, &mut applied);
        for &slot in &removed {
            applied.removed.push(self.old.runtimes[slot].id.clone());
            if retire(&self.old.runtimes[slot]) {
                shared.unfinished.fetch_sub(1, Ordering::AcqRel);
            }
        }
        self.reset_regions(&plan, &held);
        let slots = plan.slots.clone();
        let plan = Arc::new(plan);
        shared.plan.store(Arc::clone(&plan));
        for (region, extent) in held.iter().filter(|(region, _)| has_region(&plan, region)) {
            let runtime = &plan.runtimes[extent.head];
            if runtime.source {
                let first = region.next_seq().unwrap_or_else(|| runtime.ticks.made());
                applied.switched_at.push((runtime.id.clone(), first));
            }
        }
        if !held.is_empty() {
            applied.pause = self.start.elapsed();
        }
        self.record(&graph, &held, &applied);
        self.engine.current.store(Arc::new(Current::new(graph, self.catalog, slots)));
        if let (When::Recorded(edit), Some(decider)) = (self.when, &shared.context.decider) {
            decider.edited(*edit);
        }
        drop(order);

        for slot in threads {
            plan.runtimes[slot].runner.leave.reset();
            self.engine.start_thread(slot, &plan.runtimes[slot]);
        }
        self.resume(&plan, &node_changes, &held, &mut applied);
        shared.one_finished();
        for (slot, instance) in unused {
            shared.close_guarded(&plan.runtimes[slot], vec![instance]);
        }
        let replaced = node_changes.iter().enumerate().filter(|(_, c)| c.is_replaced()).map(|(n, _)| plan.slots[n]);
        self.engine.close_old(self.old, &removed.into_iter().chain(replaced).collect::<Vec<_>>());
        applied
    }

    /// Gives all nodes their inputs, values and policy. Returns the slots of nodes whose thread is to start.
    fn set_up_nodes(
        &self,
        plan: &Plan,
        graph: &Graph,
        node_changes: &[NodeChange],
        quiet: &[usize],
        applied: &mut Applied,
    ) -> Vec<usize> {
        let shared = &self.engine.shared;
        let mut threads = Vec::new();
        // A replaced node counts as finished as soon as its successor took over, so ask before.
        let was_finished: Vec<bool> = self.old.runtimes.iter().map(|r| lock(&r.join).is_finished()).collect();
        for (node, &change) in node_changes.iter().enumerate() {
            let slot = plan.slots[node];
            let runtime = &plan.runtimes[slot];
            let settings = &graph.nodes[node];
            let finished = self.rewire(plan, graph, &was_finished, node, change);
            let restarts = (change.is_replaced() || change.is_rewired()) && finished;
            if change.is_added() || restarts {
                shared.unfinished.fetch_add(1, Ordering::AcqRel);
            }
            let had_to_leave = || quiet.contains(&slot) && !lock(&runtime.join).is_finished();
            if runtime.owns_thread() && (change.is_added() || change.is_replaced() || restarts || had_to_leave()) {
                threads.push(slot);
            }
            if change.is_tuned() && shared.context.decider.is_none() {
                runtime.set_snapshot(Snapshot::new(settings.params.clone()));
            }
            runtime.set_policy(settings.on_fault, settings.budget_ms, settings.max_rate_hz);
            let lists = [
                (change.is_added(), &mut applied.added),
                (change.is_replaced(), &mut applied.replaced),
                (change.is_reopened(), &mut applied.reopened),
                (change.is_rewired(), &mut applied.rewired),
                (change.is_tuned(), &mut applied.tuned),
            ];
            for (_, list) in lists.into_iter().filter(|(belongs, _)| *belongs) {
                list.push(settings.id.clone());
            }
        }
        threads
    }

    /// Counts the ticks of new regions, and of those at rest, from zero.
    fn reset_regions(&self, plan: &Plan, held: &[(Arc<Region>, Extent)]) {
        for (region, extent) in plan.regions.iter().zip(&plan.extents) {
            if held.iter().any(|(h, _)| Arc::ptr_eq(h, region)) || !has_region(self.old, region) {
                region.reset(extent.leaves, extent.limit);
                extent.members.iter().for_each(|&member| plan.runtimes[member].reset_done_ticks());
            }
        }
    }

    /// Passes the change to the observer.
    fn record(&self, graph: &Graph, held: &[(Arc<Region>, Extent)], applied: &Applied) {
        let Some(observer) = &self.engine.shared.context.observer else { return };
        let heads = held.iter().map(|(_, extent)| self.old.runtimes[extent.head].id.clone());
        let admitted = heads.map(|head| (observer.admitted_by(&head), head)).map(|(n, head)| (head, n)).collect();
        let plugins = if applied.replaced.is_empty() { Vec::new() } else { self.plugins.files(&graph.plugins) };
        let (graph, applied) = (Box::new(graph.clone()), Box::new(applied.clone()));
        observer.event(Event::Edit { graph, admitted, applied, plugins });
    }

    /// Lets the regions go on, and fires nodes whose inputs are complete under the new plan.
    fn resume(&self, plan: &Plan, node_changes: &[NodeChange], held: &[(Arc<Region>, Extent)], applied: &mut Applied) {
        let shared = &self.engine.shared;
        let mut ready = Ready::default();
        for (region, extent) in held {
            if has_region(plan, region) {
                // What a source of another type made while the region paused has no reader any more.
                let head = extent.head;
                if self.old.runtimes[head].output_names != plan.runtimes[head].output_names {
                    let waiting = region.take_pending();
                    waiting.into_iter().for_each(|tick| shared.drop_tick(&plan.runtimes[head], region, tick));
                }
                self.engine.resume(plan, region, extent, &mut ready);
            } else {
                resume_inputs(plan, extent);
            }
        }
        if !held.is_empty() {
            applied.pause = self.start.elapsed();
        }
        // Completes pending ticks of an ended source and fires nodes that waited only for the change.
        for (node, change) in node_changes.iter().enumerate() {
            let slot = plan.slots[node];
            if change.gets_inputs() && !plan.runtimes[slot].source {
                shared.try_fire(plan, slot, &mut ready);
            }
        }
        ready.dispatch_ready(shared, plan, 0);
    }

    /// Puts an opened instance into its node. Returns one that still waited there, with its slot; the caller closes it.
    fn install(plan: &Plan, node_changes: &[NodeChange], opened: Opened) -> Option<(usize, Instance)> {
        let Opened { node, instance, snapshot } = opened;
        let slot = plan.slots[node];
        let (runtime, change) = (&plan.runtimes[slot], node_changes[node]);
        if change.is_reopened() && change.opens() == Some(Opens::Beside) {
            runtime.recovery.begin_restart();
            return runtime.replace_instance(instance, Some(snapshot)).map(|unused| (slot, unused));
        }
        runtime.exec.with(|exec| {
            exec.instance = instance.begun();
            // A node that was bypassed after a fault runs again.
            exec.bypassed = false;
            exec.bad_in_a_row = 0;
        });
        runtime.recovery.set_permanent(false);
        if change.is_reopened() {
            runtime.recovery.begin_restart();
            // One that waited would take over at the next tick.
            let unused = runtime.take_replacement();
            runtime.set_snapshot(snapshot);
            return unused.map(|unused| (slot, unused));
        }
        None
    }

    /// Gives a node its inputs. Returns whether it, or its predecessor, was finished.
    fn rewire(&self, plan: &Plan, graph: &Graph, was_finished: &[bool], node: usize, change: NodeChange) -> bool {
        let (old, current) = (self.old, self.current);
        let slot = plan.slots[node];
        let runtime = &plan.runtimes[slot];
        let subscribed =
            if change.is_replaced() { old.runtimes[slot].subscribers.bits() } else { runtime.subscribers.bits() };
        runtime.set_outputs_read(plan::outputs_read(graph, node) | subscribed);
        self.engine.shared.context.make_all_recorded_outputs(runtime);
        if !change.gets_inputs() {
            // Its producers may be in other regions now, which changes how many packets may wait, or closed a loop.
            lock(&runtime.join).set_wires(plan::wires(graph, node));
            return false;
        }
        let new = connections(graph, &plan.slots, node);
        let before = current.graph.node(&graph.nodes[node].id).filter(|_| !change.is_added());
        let from = match before {
            Some(before) => inherited(&connections(&current.graph, &current.slots, before), &new),
            None => vec![None; new.len()],
        };
        let ended: Vec<usize> = (0..new.len())
            .filter(|&i| from[i].is_none() && old.alive.get(new[i].from_node) == Some(&true))
            .filter(|&i| was_finished.get(new[i].from_node) == Some(&true))
            .collect();
        let mut finished = false;
        if change.is_replaced() {
            let before = &old.runtimes[slot];
            let mut old_join = lock(&before.join);
            let fresh = std::mem::take(&mut *lock(&runtime.join));
            old_join.rewire(fresh, &from);
            let mut new_join = old_join.hand_over();
            finished = new_join.unfinish();
            *lock(&runtime.join) = new_join;
            drop(old_join);
            runtime.ticks.continue_from(&before.ticks);
            if type_name(before.node_type) == type_name(runtime.node_type) {
                runtime.subscribers.adopt(&before.subscribers);
            }
            retire(before);
        } else if change.is_rewired() {
            let (join, ranges) = plan::inputs(graph, self.catalog, node);
            let mut inputs = lock(&runtime.join);
            inputs.rewire(join, &from);
            finished = inputs.unfinish();
            drop(inputs);
            runtime.set_ranges(ranges.clone());
            runtime.exec.with(|exec| exec.ranges = ranges);
        }
        for index in ended {
            lock(&runtime.join).end(index);
        }
        finished
    }
}

/// Removes a node from the graph; `true` when it was not finished.
fn retire(runtime: &Arc<NodeRuntime>) -> bool {
    let unfinished = lock(&runtime.join).finish();
    runtime.recovery.begin_restart();
    runtime.runner.retire();
    unfinished
}

fn has_region(plan: &Plan, region: &Arc<Region>) -> bool {
    plan.regions.iter().any(|known| Arc::ptr_eq(known, region))
}
