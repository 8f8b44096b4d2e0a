//! The switch of a plan: nothing here fails.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use panoscope_graph::{Catalog, Graph};

use super::change::{Change, Fate, connections, inherited};
use super::{Applied, Opened, When, retire};
use crate::engine::{Current, Engine, type_name};
use crate::instance::Instance;
use crate::observe::Event;
use crate::params::Snapshot;
use crate::plan::{self, Plan};
use crate::plugins::Plugins;
use crate::schedule::Ready;
use crate::sync::lock;

impl Engine {
    /// The switch itself; nothing here fails.
    pub(super) fn switch(
        &self,
        old: &Arc<Plan>,
        current: &Current,
        change: Change,
        graph: Graph,
        catalog: &Catalog,
        plugins: &dyn Plugins,
        when: &When<'_>,
        early: Vec<Opened>,
        late: Vec<Opened>,
        start: Instant,
    ) -> Applied {
        let shared = &self.shared;
        let mut applied = Applied::default();
        // The count must not touch zero on the way.
        shared.unfinished.fetch_add(1, Ordering::AcqRel);
        let order = lock(&shared.finishing);
        let Change { plan, fates, removed, held, quiet } = change;
        let mut unused = Vec::new();
        for opened in early.into_iter().chain(late) {
            unused.extend(Self::install(&plan, &fates, opened));
        }
        let mut threads = Vec::new();
        // Replaced nodes count as finished as soon as their successors took over.
        let over: Vec<bool> = old.cells.iter().map(|c| lock(&c.join).finished).collect();
        for (node, fate) in fates.iter().enumerate() {
            let slot = plan.slots[node];
            let cell = &plan.cells[slot];
            let id = &graph.nodes[node].id;
            let finished = self.rewire(old, &over, current, &plan, &graph, catalog, node, *fate);
            if fate.added || ((fate.replaced || fate.rewired) && finished) {
                shared.unfinished.fetch_add(1, Ordering::AcqRel);
            }
            if cell.owns_thread()
                && (fate.added
                    || fate.replaced
                    || (fate.rewired && finished)
                    || (quiet.contains(&slot) && !lock(&cell.join).finished))
            {
                threads.push(slot);
            }
            if fate.tuned && shared.around.decider.is_none() {
                cell.set_snapshot(Snapshot::new(graph.nodes[node].params.clone()));
            }
            let policy = &graph.nodes[node];
            cell.set_policy(policy.on_fault, policy.budget_ms, policy.max_rate_hz);
            let names = [
                (fate.added, &mut applied.added),
                (fate.replaced, &mut applied.replaced),
                (fate.reopened, &mut applied.reopened),
                (fate.rewired && !fate.replaced, &mut applied.rewired),
                (fate.tuned, &mut applied.tuned),
            ];
            for (_, list) in names.into_iter().filter(|(yes, _)| *yes) {
                list.push(id.clone());
            }
        }
        for &slot in &removed {
            applied.removed.push(old.cells[slot].id.clone());
            if retire(&old.cells[slot]) {
                shared.unfinished.fetch_sub(1, Ordering::AcqRel);
            }
        }
        for (region, extent) in plan.regions.iter().zip(&plan.extents) {
            let was_held = held.iter().any(|(h, _)| Arc::ptr_eq(h, region));
            let known = old.regions.iter().any(|r| Arc::ptr_eq(r, region));
            if was_held || !known {
                region.reset(extent.leaves, extent.limit);
                for &member in &extent.members {
                    plan.cells[member].done_ticks.store(0, Ordering::Relaxed);
                }
            }
        }
        let slots = plan.slots.clone();
        let plan = Arc::new(plan);
        shared.plan.store(Arc::clone(&plan));
        for (region, extent) in held.iter().filter(|(region, _)| plan.regions.iter().any(|r| Arc::ptr_eq(r, region))) {
            let cell = &plan.cells[extent.head];
            if cell.source {
                let first = region.first_pending().unwrap_or_else(|| cell.ticks.made.load(Ordering::Relaxed));
                applied.switched_at.push((cell.id.clone(), first));
            }
        }
        if !held.is_empty() {
            applied.pause = start.elapsed();
        }
        if let Some(observer) = &shared.around.observer {
            let heads = held.iter().map(|(_, extent)| old.cells[extent.head].id.clone());
            let admitted = heads.map(|head| (observer.admitted_by(&head), head)).map(|(n, head)| (head, n)).collect();
            let plugins = if applied.replaced.is_empty() { Vec::new() } else { plugins.files(&graph.plugins) };
            let (graph, applied) = (Box::new(graph.clone()), Box::new(applied.clone()));
            observer.event(Event::Edit { graph, admitted, applied, plugins });
        }
        self.current.store(Arc::new(Current::new(graph, catalog, slots)));
        if let (When::Recorded(edit), Some(decider)) = (when, &shared.around.decider) {
            decider.edited(*edit);
        }
        drop(order);

        for slot in threads {
            plan.cells[slot].runner.leave.reset();
            self.start_thread(slot, &plan.cells[slot]);
        }
        let mut ready = Ready::default();
        for (region, extent) in &held {
            let head = extent.head;
            if plan.regions.iter().any(|r| Arc::ptr_eq(r, region)) {
                self.resume(&plan, region, head, &mut ready);
            } else if plan.alive[head] {
                lock(&plan.cells[head].join).resume();
            }
        }
        if !held.is_empty() {
            applied.pause = start.elapsed();
        }
        // What hangs on a source that has ended finishes now; what waits may go on.
        for (node, fate) in fates.iter().enumerate() {
            let slot = plan.slots[node];
            if (fate.added || fate.replaced || fate.rewired) && !plan.cells[slot].source {
                shared.try_fire(&plan, slot, &mut ready);
            }
        }
        ready.dispatch_ready(shared, &plan, 0);
        shared.one_finished();
        for (slot, instance) in unused {
            shared.close_guarded(&plan.cells[slot], vec![instance]);
        }
        let replaced = fates.iter().enumerate().filter(|(_, f)| f.replaced).map(|(n, _)| plan.slots[n]);
        self.close_old(old, &removed.into_iter().chain(replaced).collect::<Vec<_>>());
        applied
    }

    /// Puts an opened instance where it belongs; answers one that waited there and is not wanted any more, with its slot.
    fn install(plan: &Plan, fates: &[Fate], opened: Opened) -> Option<(usize, Instance)> {
        let Opened { node, instance, snapshot } = opened;
        let slot = plan.slots[node];
        let (cell, fate) = (&plan.cells[slot], fates[node]);
        if fate.reopened && !fate.late {
            cell.recovery.restarting.fetch_add(1, Ordering::AcqRel);
            return cell.replace_instance(instance, Some(snapshot)).map(|unused| (slot, unused));
        }
        if let Some(mut exec) = cell.exec.take() {
            exec.instance = instance.begun();
            // A node that was left out after a fault has another chance.
            exec.bypassed = false;
            exec.bad_in_a_row = 0;
            cell.exec.put(exec);
        }
        cell.recovery.gives_up.store(false, Ordering::Release);
        if fate.reopened {
            cell.recovery.restarting.fetch_add(1, Ordering::AcqRel);
            cell.set_snapshot(snapshot);
        }
        None
    }

    /// Gives a node its inputs; answers whether it, or its predecessor, was finished.
    fn rewire(
        &self,
        old: &Plan,
        over: &[bool],
        current: &Current,
        plan: &Plan,
        graph: &Graph,
        catalog: &Catalog,
        node: usize,
        fate: Fate,
    ) -> bool {
        let slot = plan.slots[node];
        let cell = &plan.cells[slot];
        let tapped = if fate.replaced { old.cells[slot].subscribers.bits() } else { cell.subscribers.bits() };
        cell.outputs_read.store(plan::outputs_read(graph, node) | tapped, Ordering::Relaxed);
        self.shared.around.widen(cell);
        if !(fate.added || fate.replaced || fate.rewired) {
            // Where its producers are in other regions now, so may be what can wait.
            lock(&cell.join).set_capacities(plan::capacities(graph, node));
            return false;
        }
        let new = connections(graph, &plan.slots, node);
        let before = current.graph.node(&graph.nodes[node].id).filter(|_| !fate.added);
        let from = match before {
            Some(before) => inherited(&connections(&current.graph, &current.slots, before), &new),
            None => vec![None; new.len()],
        };
        let ended: Vec<usize> = (0..new.len())
            .filter(|&i| from[i].is_none() && old.alive.get(new[i].0) == Some(&true))
            .filter(|&i| over.get(new[i].0) == Some(&true))
            .collect();
        let mut finished = false;
        if fate.replaced {
            let before = &old.cells[slot];
            let mut was = lock(&before.join);
            let fresh = std::mem::take(&mut *lock(&cell.join));
            finished = was.finished;
            was.rewire(fresh, &from);
            let mut is = std::mem::take(&mut *was);
            is.finished = false;
            *lock(&cell.join) = is;
            was.finished = true;
            drop(was);
            cell.ticks.made.store(before.ticks.made.load(Ordering::Relaxed), Ordering::Relaxed);
            if type_name(before.node_type) == type_name(cell.node_type) {
                cell.subscribers.adopt(&before.subscribers);
            }
            retire(before);
        } else if fate.rewired {
            let (join, ranges) = plan::inputs(graph, catalog, node);
            let mut inputs = lock(&cell.join);
            inputs.rewire(join, &from);
            finished = std::mem::replace(&mut inputs.finished, false);
            drop(inputs);
            *lock(&cell.ranges) = ranges.clone();
            if let Some(mut exec) = cell.exec.take() {
                exec.ranges = ranges;
                cell.exec.put(exec);
            }
        }
        for index in ended {
            lock(&cell.join).end(index);
        }
        finished
    }
}
