//! A change laid out: what becomes of every node, and which regions must come to rest for it.

use std::sync::Arc;

use panoscope_graph::{Align, Catalog, Graph};

use super::ApplyError;
use crate::claims::Claims;
use crate::engine::{Current, type_name};
use crate::node::NodeRuntime;
use crate::plan::{self, Extent, Plan};
use crate::region::Region;

/// What becomes of a node of the new graph.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Fate {
    /// There was none of this name.
    pub added: bool,
    /// It was of another type.
    pub replaced: bool,
    pub reopened: bool,
    pub rewired: bool,
    pub tuned: bool,
    /// It cannot be open beside its predecessor, or had better not.
    pub late: bool,
}

/// A change laid out, with the cells of new nodes.
pub(super) struct Change {
    pub plan: Plan,
    pub fates: Vec<Fate>,
    /// Slots that lose their node.
    pub removed: Vec<usize>,
    /// Old regions that must come to rest.
    pub held: Vec<(Arc<Region>, Extent)>,
    /// Sources whose thread must leave for the switch.
    pub quiet: Vec<usize>,
}

/// What an input is connected to, as far as the scheduler is concerned.
pub(super) type Connection = (usize, usize, usize, usize, Align, Option<u32>, u8, bool, bool);

pub(super) fn connections(graph: &Graph, slots: &[usize], node: usize) -> Vec<Connection> {
    let edges = graph.inputs_of(node).iter();
    edges
        .map(|e| {
            let from = slots[e.from_node];
            (from, e.from_port, e.to_port, e.list_index, e.align, e.queue, e.delay, e.trigger, e.convert)
        })
        .collect()
}

/// For each new connection, the old one that it goes on with.
pub(super) fn inherited(old: &[Connection], new: &[Connection]) -> Vec<Option<usize>> {
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
    pub(super) fn between(
        old: &Plan,
        current: &Current,
        graph: &Graph,
        catalog: &Catalog,
        entry: plan::Entry<'_>,
        as_once: &[String],
        claims: &Claims,
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
        let gives_device_back = |cell: &NodeRuntime| {
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
                // What claims its files can write beside its predecessor, so that a refused change leaves that one as it is.
                let acts = cell.side_effects && !claims.are_used_by(&cell.id);
                ((fate.replaced || fate.reopened) && (cell.exclusive || acts))
                    || (fate.added && cell.exclusive && gives_device_back(cell))
            })
            .collect();
        for (fate, late) in fates.iter_mut().zip(late) {
            fate.late = late;
        }
        let plan = plan::lay_out(graph, catalog, cells, slots, old.ticks_at_once, Some(old));
        let mut change = Self { plan, fates, removed, held: Vec::new(), quiet: Vec::new() };
        change.find_held(old);
        Ok(change)
    }

    /// Names of nodes whose instance of now ends with the change.
    pub(super) fn leaving(&self, old: &Plan, graph: &Graph) -> Vec<String> {
        let removed = self.removed.iter().map(|&slot| old.cells[slot].id.clone());
        let fates = self.fates.iter().zip(&graph.nodes);
        let anew = fates.filter(|(f, _)| f.replaced || f.reopened).map(|(_, node)| node.id.clone());
        removed.chain(anew).collect()
    }

    /// Brings the regions of these sources to rest too.
    pub(super) fn hold_also(&mut self, old: &Plan, at: &[(String, u64)]) -> Result<(), ApplyError> {
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
