//! Changing a running graph: one transaction from the graph that runs to another checked one.
//!
//! New nodes are opened beside the running ones. The regions that the change touches stop admitting ticks; sources go on and
//! their ticks are kept. When the ticks inside are through, the plan is switched and the kept ticks enter. Untouched regions do not
//! notice. Whatever fails before the switch leaves everything as it was.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use panoscope_abi as abi;
use panoscope_graph::{Align, Catalog, Graph, Mode};
use serde::{Deserialize, Serialize};

use crate::cell::{Cell, lock};
use crate::engine::{Current, Engine, TICKS_IN_FLIGHT, type_name};
use crate::exec::Instance;
use crate::loader::Loader;
use crate::log::Level;
use crate::params::Snapshot;
use crate::plan::{self, Extent, Plan};
use crate::record::{Event, plugin_hashes};
use crate::region::Region;
use crate::schedule::Ready;

/// Longest wait for the ticks inside a region.
const LONGEST_DRAIN: Duration = Duration::from_secs(10);

/// What a change did, by node name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Applied {
    /// New nodes.
    pub added: Vec<String>,
    /// Nodes that are gone.
    pub removed: Vec<String>,
    /// Nodes of another type, or of a rebuilt plugin.
    pub replaced: Vec<String>,
    /// Nodes opened anew with other values.
    pub reopened: Vec<String>,
    /// Nodes whose inputs changed.
    pub rewired: Vec<String>,
    /// Nodes with other values that need no reopening.
    pub tuned: Vec<String>,
    /// Time during which no tick entered the parts that were changed; zero when none was held up.
    pub pause: Duration,
    /// For each source whose region was switched: its name and the number of its first tick after the switch at the latest.
    pub switched_at: Vec<(String, u64)>,
}

impl Applied {
    /// Whether both graphs were the same.
    pub fn is_nothing(&self) -> bool {
        let lists = [&self.added, &self.removed, &self.replaced, &self.reopened, &self.rewired, &self.tuned];
        lists.iter().all(|list| list.is_empty())
    }
}

impl std::fmt::Display for Applied {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let lists = [
            ("added", &self.added),
            ("removed", &self.removed),
            ("replaced", &self.replaced),
            ("reopened", &self.reopened),
            ("rewired", &self.rewired),
            ("tuned", &self.tuned),
        ];
        for (done, nodes) in lists.into_iter().filter(|(_, nodes)| !nodes.is_empty()) {
            write!(f, "{done} {}; ", nodes.join(", "))?;
        }
        write!(f, "paused {:.1} ms", self.pause.as_secs_f64() * 1e3)
    }
}

/// Why a change was not made; everything is as before.
#[derive(Debug, thiserror::Error)]
pub enum ApplyError {
    /// A node did not open.
    #[error("node `{node}` ({node_type}) did not open, nothing was changed: {reason}")]
    Open {
        /// The node's name.
        node: String,
        /// Its type.
        node_type: String,
        /// What it said.
        reason: String,
    },
    /// The graph does not fit the loaded plugins any more.
    #[error("{reason}; check the graph again")]
    Stale {
        /// What changed.
        reason: String,
    },
    /// `live` and `batch` do not mix.
    #[error("the mode cannot change while the graph runs")]
    Mode,
    /// The graph has come to its end.
    #[error("the graph does not run any more")]
    Ended,
    /// The tick to switch at has entered the graph.
    #[error(
        "tick {seq} of `{source_node}` has passed, nothing was changed: tick {next} is the first that can be kept out"
    )]
    Passed {
        /// The source.
        source_node: String,
        /// As asked for.
        seq: u64,
        /// The first tick that has not entered.
        next: u64,
    },
    /// A tick was named of something that makes none.
    #[error("`{node}` is no source of the running graph, nothing was changed: ticks are named by their source")]
    NoSource {
        /// As asked for.
        node: String,
    },
    /// Ticks under way did not come to their end.
    #[error("node `{node}` did not come to rest within {seconds} s, nothing was changed")]
    Busy {
        /// A node that still works.
        node: String,
        /// How long was waited.
        seconds: u64,
    },
}

/// When a change is to be made.
enum When<'a> {
    Now,
    /// Before these ticks.
    At(&'a [(String, u64)]),
    /// Where the change of this number was made in the recording that is replayed.
    Recorded(usize),
}

/// What becomes of a node of the new graph.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Fate {
    /// There was none of this name.
    added: bool,
    /// It was of another type.
    replaced: bool,
    reopened: bool,
    rewired: bool,
    tuned: bool,
    /// It cannot be open beside its predecessor, or had better not.
    late: bool,
}

/// A change laid out, with the cells of new nodes.
struct Change {
    plan: Plan,
    fates: Vec<Fate>,
    /// Slots that lose their node.
    removed: Vec<usize>,
    /// Old regions that must come to rest.
    held: Vec<(Arc<Region>, Extent)>,
    /// Sources whose thread must leave for the switch.
    quiet: Vec<usize>,
}

/// What an input is connected to, as far as the scheduler is concerned.
type Connection = (usize, usize, usize, usize, Align, Option<u32>, u8, bool, bool);

fn connections(graph: &Graph, slots: &[usize], node: usize) -> Vec<Connection> {
    let edges = graph.inputs_of(node).iter();
    edges
        .map(|e| {
            let from = slots[e.from_node];
            (from, e.from_port, e.to_port, e.list_index, e.align, e.queue, e.delay, e.trigger, e.convert)
        })
        .collect()
}

/// For each new connection, the old one that it goes on with.
fn inherited(old: &[Connection], new: &[Connection]) -> Vec<Option<usize>> {
    let mut taken = vec![false; old.len()];
    let same = |a: &Connection, b: &Connection| (a.0, a.1, a.2, a.4, a.6) == (b.0, b.1, b.2, b.4, b.6);
    new.iter()
        .map(|connection| {
            let found = old.iter().enumerate().position(|(i, o)| !taken[i] && same(o, connection))?;
            taken[found] = true;
            Some(found)
        })
        .collect()
}

impl Change {
    fn between(
        old: &Plan,
        current: &Current,
        graph: &Graph,
        catalog: &Catalog,
        entry: plan::Entry<'_>,
        as_once: &[String],
    ) -> Result<Self, String> {
        let mut cells = old.cells.clone();
        let mut free: Vec<usize> = (0..cells.len()).filter(|&s| !old.alive[s]).rev().collect();
        let mut slots = Vec::with_capacity(graph.nodes.len());
        let mut fates = Vec::with_capacity(graph.nodes.len());
        for node in 0..graph.nodes.len() {
            let node_type = plan::entry_of(graph, node, entry)?;
            let description = graph.nodes[node].node_type(catalog);
            let before = current.graph.node(&graph.nodes[node].id);
            let mut fate = Fate::default();
            match before {
                Some(before) => {
                    let slot = current.slots[before];
                    let cell = &old.cells[slot];
                    let pinned_elsewhere = cell.owns_thread() && cell.cpu != graph.nodes[node].cpu;
                    fate.replaced = !std::ptr::eq(cell.node_type, node_type)
                        || pinned_elsewhere
                        || as_once.contains(&graph.nodes[node].id);
                    if !fate.replaced {
                        let values = &current.graph.nodes[before].params;
                        let differs = |i: &usize| values.get(*i) != graph.nodes[node].params.get(*i);
                        let changed: Vec<usize> = (0..description.params.len()).filter(differs).collect();
                        fate.reopened = changed.iter().any(|&i| description.params[i].reopen);
                        fate.tuned = !changed.is_empty() && !fate.reopened;
                    }
                    slots.push(slot);
                }
                None => {
                    fate.added = true;
                    slots.push(free.pop().unwrap_or(cells.len() + fates.iter().filter(|f: &&Fate| f.added).count()));
                }
            }
            if fate.added || fate.replaced {
                let slot = slots[node];
                let cell = plan::cell(graph, catalog, node, node_type);
                if slot < cells.len() {
                    cells[slot] = cell;
                } else {
                    // Appended slots are numbered one after the other.
                    slots[node] = cells.len();
                    cells.push(cell);
                }
            }
            fates.push(fate);
        }
        let kept = |slot: usize| slots.contains(&slot);
        let removed: Vec<usize> = current.slots.iter().copied().filter(|&slot| !kept(slot)).collect();
        for node in 0..graph.nodes.len() {
            if let (false, Some(before)) = (fates[node].added, current.graph.node(&graph.nodes[node].id)) {
                let was = connections(&current.graph, &current.slots, before);
                fates[node].rewired = was != connections(graph, &slots, node);
            }
        }
        let gives_device_back = |cell: &Cell| {
            let freed =
                removed.iter().copied().chain((0..slots.len()).filter(|&n| fates[n].replaced).map(|n| slots[n]));
            freed
                .into_iter()
                .any(|s| old.cells[s].exclusive && type_name(old.cells[s].node_type) == type_name(cell.node_type))
        };
        let late: Vec<bool> = (0..slots.len())
            .map(|node| {
                let cell = &cells[slots[node]];
                let fate = fates[node];
                ((fate.replaced || fate.reopened) && (cell.exclusive || cell.side_effects))
                    || (fate.added && cell.exclusive && gives_device_back(cell))
            })
            .collect();
        for (fate, late) in fates.iter_mut().zip(late) {
            fate.late = late;
        }
        let plan = plan::lay_out(graph, catalog, cells, slots, TICKS_IN_FLIGHT, Some(old));
        let mut change = Self { plan, fates, removed, held: Vec::new(), quiet: Vec::new() };
        change.find_held(old);
        Ok(change)
    }

    /// Brings the regions of these sources to rest too.
    fn hold_also(&mut self, old: &Plan, at: &[(String, u64)]) -> Result<(), ApplyError> {
        for (source, _) in at {
            let no_source = || ApplyError::NoSource { node: source.clone() };
            let (slot, _) = old.live().find(|(_, c)| c.source && c.id == *source).ok_or_else(no_source)?;
            if !self.held.iter().any(|(_, extent)| extent.head == slot) {
                let number = old.wiring[slot].region;
                self.held.push((Arc::clone(&old.regions[number]), old.extents[number].clone()));
            }
        }
        Ok(())
    }

    /// Finds the old regions that the change touches.
    fn find_held(&mut self, old: &Plan) {
        let mut touched = vec![false; self.plan.cells.len()];
        for &slot in &self.removed {
            touched[slot] = true;
        }
        for (node, fate) in self.fates.iter().enumerate() {
            let slot = self.plan.slots[node];
            touched[slot] |= fate.added || fate.replaced || fate.rewired || (fate.reopened && fate.late);
        }
        self.quiet = (0..old.cells.len()).filter(|&s| old.alive[s] && touched[s] && old.cells[s].source).collect();
        for (slot, _) in old.live() {
            let (was, is) = (&old.wiring[slot], &self.plan.wiring[slot]);
            let same = was.readers == is.readers
                && (was.inline, was.chain_head, was.leaf, was.sink) == (is.inline, is.chain_head, is.leaf, is.sink);
            touched[slot] |= !same;
        }
        for (region, extent) in old.regions.iter().zip(&old.extents) {
            let same = self.plan.extents.iter().any(|e| e == extent);
            if !same || extent.members.iter().any(|&m| touched[m]) {
                self.held.push((Arc::clone(region), extent.clone()));
            }
        }
    }
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
        let mut change = Change::between(&old, &current, &graph, catalog, &entry, as_once)
            .map_err(|reason| ApplyError::Stale { reason })?;
        if let When::At(at) = when {
            change.hold_also(&old, at)?;
        }
        let _visit = shared.pool.visit();
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

    /// The switch itself; nothing here fails.
    fn switch(
        &self,
        old: &Arc<Plan>,
        current: &Current,
        change: Change,
        graph: Graph,
        catalog: &Catalog,
        loader: &Loader,
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
        for opened in early.into_iter().chain(late) {
            self.install(old, &plan, &fates, opened);
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
            if fate.tuned && shared.around.script.is_none() {
                cell.set_snapshot(Snapshot::new(graph.nodes[node].params.clone()));
            }
            let manners = &graph.nodes[node];
            cell.set_manners(manners.on_fault, manners.budget_ms, manners.max_rate_hz);
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
                let first = region.first_pending().unwrap_or_else(|| cell.made.load(Ordering::Relaxed));
                applied.switched_at.push((cell.id.clone(), first));
            }
        }
        if !held.is_empty() {
            applied.pause = start.elapsed();
        }
        if let Some(recorder) = &shared.around.recorder {
            let heads = held.iter().map(|(_, extent)| old.cells[extent.head].id.clone());
            let admitted = heads.map(|head| (recorder.admitted_by(&head), head)).map(|(n, head)| (head, n)).collect();
            let plugins = if applied.replaced.is_empty() { Vec::new() } else { plugin_hashes(&graph, loader) };
            let (graph, applied) = (Box::new(graph.clone()), Box::new(applied.clone()));
            recorder.say(Event::Edit { graph, admitted, applied, plugins });
        }
        self.current.store(Arc::new(Current::new(graph, catalog, slots)));
        if let (When::Recorded(edit), Some(script)) = (when, &shared.around.script) {
            script.edited(*edit);
        }
        drop(order);

        for slot in threads {
            plan.cells[slot].leave.reset();
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
                shared.poke(&plan, slot, &mut ready);
            }
        }
        ready.settle(shared, &plan, 0);
        shared.one_finished();
        let replaced = fates.iter().enumerate().filter(|(_, f)| f.replaced).map(|(n, _)| plan.slots[n]);
        self.close_old(old, &removed.into_iter().chain(replaced).collect::<Vec<_>>());
        applied
    }

    /// Puts an opened instance where it belongs, with the state of its predecessor.
    fn install(&self, old: &Plan, plan: &Plan, fates: &[Fate], opened: Opened) {
        let Opened { node, mut instance, snapshot } = opened;
        let slot = plan.slots[node];
        let (cell, fate) = (&plan.cells[slot], fates[node]);
        if fate.reopened && !fate.late {
            cell.mending.fetch_add(1, Ordering::AcqRel);
            cell.replace_instance(instance, Some(snapshot));
            return;
        }
        let same_type = |a: &'static abi::NodeType, b: &'static abi::NodeType| type_name(a) == type_name(b);
        if fate.replaced
            && !fate.late
            && same_type(old.cells[slot].node_type, cell.node_type)
            && let Some(mut exec) = old.cells[slot].exec.take()
        {
            old.cells[slot].hand_over(&mut exec, &mut instance, &self.shared.around);
            old.cells[slot].exec.put(exec);
        }
        if let Some(mut exec) = cell.exec.take() {
            exec.instance = instance;
            cell.exec.put(exec);
        }
        if fate.reopened {
            cell.mending.fetch_add(1, Ordering::AcqRel);
            cell.set_snapshot(snapshot);
        }
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
        let tapped = if fate.replaced { old.cells[slot].taps.bits() } else { cell.taps.bits() };
        cell.outputs_read.store(plan::outputs_read(graph, node) | tapped, Ordering::Relaxed);
        self.shared.around.widen(cell);
        if !(fate.added || fate.replaced || fate.rewired) {
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
            cell.made.store(before.made.load(Ordering::Relaxed), Ordering::Relaxed);
            if type_name(before.node_type) == type_name(cell.node_type) {
                cell.taps.adopt(&before.taps);
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
            cell.close_instance();
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
