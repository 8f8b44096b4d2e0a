//! Changing a running graph: one transaction from the graph that runs to another checked one.
//!
//! New nodes are opened beside the running ones. The regions that the change touches stop admitting ticks; sources go on and
//! their ticks are kept. When the ticks inside are through, the plan is switched and the kept ticks enter. Untouched regions do not
//! notice. Whatever fails before the switch leaves everything as it was.

mod change;
mod outcome;
mod switch;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use panoscope_graph::{Catalog, Graph, Mode};

use self::change::{Change, Fate};
pub use self::outcome::{Applied, ApplyError};
use crate::cell::{Cell, lock};
use crate::engine::Engine;
use crate::exec::Instance;
use crate::loader::Loader;
use crate::log::Level;
use crate::params::Snapshot;
use crate::plan::{Extent, Plan};
use crate::region::Region;
use crate::schedule::Ready;

/// Longest wait for the ticks inside a region.
const LONGEST_DRAIN: Duration = Duration::from_secs(10);

/// When a change is to be made.
enum When<'a> {
    Now,
    /// Before these ticks.
    At(&'a [(String, u64)]),
    /// Where the change of this number was made in the recording that is replayed.
    Recorded(usize),
}

/// An instance opened for the change: the node of the new graph, and its values if they are new.
struct Opened {
    node: usize,
    instance: Instance,
    snapshot: Arc<Snapshot>,
}

impl Engine {
    /// Changes the running graph into another one that was checked against `catalog`, as one transaction: all of it or nothing.
    ///
    /// Nodes of the same name and type go on with their instance, counters and inputs; no tick is lost on paths that are not touched.
    ///
    /// # Errors
    /// Everything is as before then.
    pub fn apply(&self, graph: Graph, catalog: &Catalog, loader: &Loader) -> Result<Applied, ApplyError> {
        self.apply_when(graph, catalog, loader, &When::Now)
    }

    /// Like [`Self::apply`], switched between two named ticks: for each source of `at`, the tick of that number is the first that meets the
    /// new graph. Blocks until these ticks have come.
    ///
    /// # Errors
    /// As [`Self::apply`], and when such a tick has already entered the graph.
    pub fn apply_at(
        &self,
        graph: Graph,
        catalog: &Catalog,
        loader: &Loader,
        at: &[(String, u64)],
    ) -> Result<Applied, ApplyError> {
        self.apply_when(graph, catalog, loader, &When::At(at))
    }

    /// Makes a change of a recording at the tick at which it was made.
    pub(crate) fn apply_as_recorded(
        &self,
        edit: usize,
        graph: Graph,
        catalog: &Catalog,
        loader: &Loader,
    ) -> Result<Applied, ApplyError> {
        self.apply_when(graph, catalog, loader, &When::Recorded(edit))
    }

    fn apply_when(
        &self,
        graph: Graph,
        catalog: &Catalog,
        loader: &Loader,
        when: &When<'_>,
    ) -> Result<Applied, ApplyError> {
        let _change = lock(&self.change);
        let shared = &self.shared;
        if shared.is_stopping() || self.is_finished() {
            return Err(ApplyError::Ended);
        }
        if (graph.mode == Mode::Batch) != shared.around.batch {
            return Err(ApplyError::Mode);
        }
        let (old, current) = (shared.plan.load_full(), self.current.load_full());
        let entry = |plugin: &str, node_type: &str| loader.entry(plugin, node_type);
        let as_once = match (when, &shared.around.script) {
            (When::Recorded(edit), Some(script)) => script.edits[*edit].applied.replaced.as_slice(),
            _ => &[],
        };
        let claims = &shared.around.claims;
        let mut change = Change::between(&old, &current, &graph, catalog, &entry, as_once, claims)
            .map_err(|reason| ApplyError::Stale { reason })?;
        if let When::At(at) = when {
            change.hold_also(&old, at)?;
        }
        let _visit = shared.pool.visit();
        // Nodes that the change ends write until the switch; those that it opens begin after it.
        let leaving = shared.around.claims.leaving(change.leaving(&old, &graph));
        let early = self.open_early(&change, &graph)?;

        // From here until the switch whole parts of the graph stand still.
        let start = Instant::now();
        let still = self
            .come_to(&old, &change, when)
            .and_then(|()| self.hold(&old, &change))
            .and_then(|()| self.open_late(&old, &change, &graph));
        let late = match still {
            Ok(late) => late,
            Err(error) => {
                self.let_go(&old, &change);
                return Err(error);
            }
        };
        drop(leaving);
        let applied = self.switch(&old, &current, change, graph, catalog, loader, when, early, late, start);
        Ok(applied)
    }

    /// Lets the ticks pass that come before the change.
    fn come_to(&self, old: &Plan, change: &Change, when: &When<'_>) -> Result<(), ApplyError> {
        let shared = &self.shared;
        let mut named = Vec::new();
        if let When::At(at) = when {
            for (source, seq) in *at {
                let is = |(_, extent): &&(Arc<Region>, Extent)| old.cells[extent.head].id == *source;
                let Some((region, extent)) = change.held.iter().find(is) else { continue };
                let made = old.cells[extent.head].made.load(Ordering::Acquire);
                let passed = |next| ApplyError::Passed { source_node: source.clone(), seq: *seq, next };
                region.pause_before(*seq, made).map_err(passed)?;
                named.push((region, extent.head));
            }
        }
        let waits = || match (when, &shared.around.script) {
            (When::Now, _) | (When::Recorded(_), None) => false,
            (When::At(_), _) => {
                let over = |head: usize| lock(&old.cells[head].join).finished;
                named.iter().any(|(region, head)| !region.is_paused() && !over(*head))
            }
            (When::Recorded(edit), Some(script)) => {
                script.missing_before(*edit).is_some() || change.held.iter().any(|h| busy_member(old, h).is_some())
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

    fn open_one(&self, change: &Change, graph: &Graph, node: usize) -> Result<Opened, ApplyError> {
        let cell = &change.plan.cells[change.plan.slots[node]];
        self.shared.around.widen(cell);
        let snapshot =
            if change.fates[node].reopened { Snapshot::new(graph.nodes[node].params.clone()) } else { cell.snapshot() };
        match cell.open(&self.shared.around, &snapshot) {
            Ok(instance) => Ok(Opened { node, instance, snapshot }),
            Err(reason) => Err(ApplyError::Open {
                node: graph.nodes[node].id.clone(),
                node_type: graph.nodes[node].type_name.clone(),
                reason,
            }),
        }
    }

    /// Opens what may be open beside the running nodes.
    fn open_early(&self, change: &Change, graph: &Graph) -> Result<Vec<Opened>, ApplyError> {
        // In a replay the script says at which tick a node goes on with a new instance.
        let scripted = self.shared.around.script.is_some();
        let wanted = |f: &Fate| (f.added || f.replaced || (f.reopened && !scripted)) && !f.late;
        let nodes = (0..graph.nodes.len()).filter(|&n| wanted(&change.fates[n]));
        nodes.map(|node| self.open_one(change, graph, node)).collect()
    }

    /// Brings the touched regions to rest.
    fn hold(&self, old: &Plan, change: &Change) -> Result<(), ApplyError> {
        let until = Instant::now() + LONGEST_DRAIN;
        for &slot in &change.quiet {
            old.cells[slot].leave.wish();
            self.shared.wake(&old.cells[slot]);
        }
        let pause = |(region, extent): &(Arc<Region>, Extent)| {
            lock(&old.cells[extent.head].join).pause();
            region.pause();
        };
        if self.shared.around.batch {
            // A region may wait for packets of those before it: the last ones come to rest first.
            for held in change.held.iter().rev() {
                pause(held);
                wait_for(until, || busy_member(old, held))?;
            }
        } else {
            change.held.iter().for_each(pause);
            wait_for(until, || change.held.iter().find_map(|held| busy_member(old, held)))?;
        }
        wait_for(until, || {
            let stays = |slot: &&usize| old.cells[**slot].has_thread.load(Ordering::Acquire);
            change.quiet.iter().find(stays).map(|&slot| old.cells[slot].id.clone())
        })
    }

    /// Opens what cannot be open beside its predecessor, which is closed first. On failure all predecessors are open again.
    fn open_late(&self, old: &Plan, change: &Change, graph: &Graph) -> Result<Vec<Opened>, ApplyError> {
        let nodes: Vec<usize> = (0..graph.nodes.len()).filter(|&n| change.fates[n].late).collect();
        if nodes.is_empty() {
            return Ok(Vec::new());
        }
        let replaced = nodes.iter().filter(|&&n| !change.fates[n].added).map(|&n| change.plan.slots[n]);
        let closing: Vec<usize> =
            replaced.chain(change.removed.iter().copied().filter(|&s| old.cells[s].exclusive)).collect();
        let mut states: Vec<(usize, Option<Vec<u8>>)> = Vec::new();
        for &slot in &closing {
            if let Some(mut exec) = old.cells[slot].exec.take() {
                states.push((slot, exec.instance.save_state(&self.shared.around.host)));
                old.cells[slot].finish(&self.shared.around, &mut exec.instance);
                exec.instance.close();
                old.cells[slot].exec.put(exec);
            }
        }
        let mut opened = Vec::new();
        for node in nodes {
            match self.open_one(change, graph, node) {
                Ok(mut new) => {
                    let slot = change.plan.slots[node];
                    let state = states.iter().find(|(s, _)| *s == slot).and_then(|(_, state)| state.as_ref());
                    self.load(&change.plan.cells[slot], &mut new.instance, state);
                    opened.push(new);
                }
                Err(error) => {
                    drop(opened);
                    self.reopen(old, &states);
                    return Err(error);
                }
            }
        }
        Ok(opened)
    }

    fn load(&self, cell: &Cell, instance: &mut Instance, state: Option<&Vec<u8>>) {
        if let Some(state) = state
            && !instance.load_state(state)
        {
            let words = "the state of its predecessor was not understood: it starts anew";
            self.shared.around.log.say(Level::Warn, &cell.id, words);
        }
    }

    /// Opens nodes again that were closed for a change that failed.
    fn reopen(&self, old: &Plan, states: &[(usize, Option<Vec<u8>>)]) {
        for (slot, state) in states {
            let cell = &old.cells[*slot];
            match cell.open(&self.shared.around, &cell.snapshot()) {
                Ok(mut instance) => {
                    self.load(cell, &mut instance, state.as_ref());
                    if let Some(mut exec) = cell.exec.take() {
                        exec.instance = instance;
                        cell.exec.put(exec);
                    }
                }
                Err(words) => {
                    cell.open_failed(&self.shared.around, &words, None);
                    self.shared.start_mending(cell);
                }
            }
        }
    }

    /// Ends a change that failed: all goes on as before.
    fn let_go(&self, old: &Plan, change: &Change) {
        for &slot in &change.quiet {
            let cell = &old.cells[slot];
            // A thread that has not seen the wish yet stays.
            if cell.leave.take_back() {
                continue;
            }
            while cell.has_thread.load(Ordering::Acquire) {
                std::thread::sleep(Duration::from_micros(50));
            }
            cell.leave.reset();
            self.start_thread(slot, cell);
        }
        let mut ready = Ready::default();
        // One that was never paused goes on by itself.
        for (region, extent) in change.held.iter().filter(|(region, _)| region.stop_waiting()) {
            self.resume(old, region, extent.head, &mut ready);
        }
        ready.settle(&self.shared, old, 0);
    }

    fn start_thread(&self, slot: usize, cell: &Arc<Cell>) {
        if let Err(cause) = self.shared.start_thread(slot, cell) {
            self.shared.fail(format!("no thread could be started for node `{}`: {cause}", cell.id));
        }
    }

    fn resume(&self, plan: &Plan, region: &Region, head: usize, ready: &mut Ready) {
        lock(&plan.cells[head].join).resume();
        let mut waited = region.resume();
        while !waited.is_empty() {
            for outputs in waited {
                self.shared.enter(plan, head, outputs, ready);
            }
            waited = region.handed_over().into_iter().collect();
        }
        self.shared.poke_head(plan, head, ready);
    }

    /// Closes what is not part of the graph any more, so that its files are finished.
    fn close_old(&self, old: &Plan, slots: &[usize]) {
        let until = Instant::now() + Duration::from_secs(2);
        for &slot in slots {
            let cell = &old.cells[slot];
            // A node with a thread of its own closes there.
            while cell.owns_thread() && cell.has_thread.load(Ordering::Acquire) && Instant::now() < until {
                self.shared.wake(cell);
                std::thread::sleep(Duration::from_micros(200));
            }
            cell.close_instance(&self.shared.around);
        }
    }
}

/// Takes a node out of the graph; `true` when it was not finished.
fn retire(cell: &Arc<Cell>) -> bool {
    let finished = std::mem::replace(&mut lock(&cell.join).finished, true);
    cell.mending.fetch_add(1, Ordering::AcqRel);
    cell.retired.store(true, Ordering::Release);
    cell.leave.wish();
    cell.wake.store(true, Ordering::Release);
    if let Some(thread) = &*lock(&cell.thread) {
        thread.unpark();
    }
    !finished
}

/// A node of a paused region that still works.
fn busy_member(plan: &Plan, (region, extent): &(Arc<Region>, Extent)) -> Option<String> {
    let works = |slot: usize| {
        let cell = &plan.cells[slot];
        // A source may go on: what it makes is kept.
        !cell.source && (lock(&cell.join).running || !cell.exec.is_home())
    };
    let member = extent.members.iter().copied().find(|&slot| works(slot));
    let inside = region.in_flight() > 0;
    member.or(inside.then_some(extent.head)).map(|slot| plan.cells[slot].id.clone())
}

fn wait_for(until: Instant, busy: impl Fn() -> Option<String>) -> Result<(), ApplyError> {
    while let Some(node) = busy() {
        if Instant::now() >= until {
            return Err(ApplyError::Busy { node, seconds: LONGEST_DRAIN.as_secs() });
        }
        std::thread::sleep(Duration::from_micros(50));
    }
    Ok(())
}
