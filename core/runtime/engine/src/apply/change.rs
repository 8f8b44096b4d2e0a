//! A planned change: what it does to each node, and which regions it must hold.

use std::sync::Arc;

use panoscope_abi as abi;
use panoscope_graph::{Catalog, Edge, Graph, Node, NodeType};

use crate::applied::ApplyError;
use crate::claims::Claims;
use crate::engine::{Current, type_name};
use crate::instance::Instance;
use crate::node::NodeRuntime;
use crate::params::Snapshot;
use crate::plan::{self, Extent, Plan};
use crate::region::Region;
use crate::run_context::RunContext;

/// When a change is to be made.
pub(super) enum When<'a> {
    Now,
    /// Before these ticks.
    At(&'a [(String, u64)]),
    /// At the position that this change had in the run that the decider repeats.
    Recorded(usize),
}

/// An instance opened for the change, with its node of the new graph and its values.
pub(super) struct Opened {
    pub node: usize,
    pub instance: Instance,
    pub snapshot: Arc<Snapshot>,
}

/// When the new instance of a node opens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Opens {
    /// Next to the running nodes.
    Beside,
    /// After its predecessor closed (exclusive device, or a node that acts on the world).
    AfterClose,
}

/// Change of the values of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Values {
    Same,
    /// They take effect on the running instance.
    Live,
    /// They need a new instance.
    Reopen(Opens),
}

/// Effect of a change on a node of the new graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NodeChange {
    /// There was no node of this name.
    Added(Opens),
    /// There was one of another type, or on another CPU.
    Replaced(Opens),
    /// The node continues.
    RetainedFrames { values: Values, rewired: bool },
}

impl NodeChange {
    pub fn is_added(self) -> bool {
        matches!(self, Self::Added(_))
    }

    pub fn is_replaced(self) -> bool {
        matches!(self, Self::Replaced(_))
    }

    /// The same node, with other inputs.
    pub fn is_rewired(self) -> bool {
        matches!(self, Self::RetainedFrames { rewired: true, .. })
    }

    /// The same node with a new instance, for its values.
    pub fn is_reopened(self) -> bool {
        matches!(self, Self::RetainedFrames { values: Values::Reopen(_), .. })
    }

    /// The same instance with new values.
    pub fn is_tuned(self) -> bool {
        matches!(self, Self::RetainedFrames { values: Values::Live, .. })
    }

    /// Whether the node's inputs are rebuilt.
    pub fn gets_inputs(self) -> bool {
        self.is_added() || self.is_replaced() || self.is_rewired()
    }

    /// When its new instance opens, if it gets one.
    pub fn opens(self) -> Option<Opens> {
        match self {
            Self::Added(opens) | Self::Replaced(opens) | Self::RetainedFrames { values: Values::Reopen(opens), .. } => {
                Some(opens)
            }
            Self::RetainedFrames { .. } => None,
        }
    }

    /// Whether its new instance opens after the old one closed.
    pub fn opens_after_close(self) -> bool {
        self.opens() == Some(Opens::AfterClose)
    }

    fn set_opens(&mut self, new: Opens) {
        match self {
            Self::Added(opens) | Self::Replaced(opens) | Self::RetainedFrames { values: Values::Reopen(opens), .. } => {
                *opens = new
            }
            Self::RetainedFrames { .. } => {}
        }
    }
}

/// A planned change, with the runtimes of new nodes.
pub(super) struct Change {
    pub plan: Plan,
    pub node_changes: Vec<NodeChange>,
    /// Slots that lose their node.
    pub removed: Vec<usize>,
    /// Old regions that the change holds.
    pub held: Vec<(Arc<Region>, Extent)>,
    /// Sources whose thread must end for the switch.
    pub quiet: Vec<usize>,
}

/// The connections of a node's inputs as the scheduler sees them: between slots instead of nodes, independent of their
/// order in the text.
pub(super) fn connections(graph: &Graph, slots: &[usize], node: usize) -> Vec<Edge> {
    let to_node = slots[node];
    let of_slots = |edge: &Edge| Edge { from_node: slots[edge.from_node], to_node, span: 0..0, ..edge.clone() };
    graph.inputs_of(node).iter().map(of_slots).collect()
}

/// For each new connection, the old one that it continues.
pub(super) fn inherited(old: &[Edge], new: &[Edge]) -> Vec<Option<usize>> {
    let mut taken = vec![false; old.len()];
    let key = |edge: &Edge| (edge.from_node, edge.from_port, edge.to_port, edge.align, edge.delay);
    let same = |a: &Edge, b: &Edge| key(a) == key(b);
    new.iter()
        .map(|connection| {
            let found = old.iter().enumerate().position(|(i, o)| !taken[i] && same(o, connection))?;
            taken[found] = true;
            Some(found)
        })
        .collect()
}

/// Whether a node of the running graph gets a new runtime: it is of another type or a rebuilt plugin, or runs in
/// another process or on another machine.
fn is_replaced(
    runtime: &NodeRuntime,
    node_type: &'static abi::NodeType,
    was: &Node,
    is: &Node,
    as_once: &[String],
) -> bool {
    !std::ptr::eq(runtime.declared, node_type)
        || was.isolate != is.isolate
        || was.deny != is.deny
        || was.machine != is.machine
        || runtime.cpu != is.cpu
        || as_once.contains(&is.id)
}

/// Which values of a node that keeps its runtime differ.
fn changed_values(description: &NodeType, was: &Node, is: &Node) -> Values {
    let differs = |i: &usize| was.params.get(*i) != is.params.get(*i);
    let changed: Vec<usize> = (0..description.params.len()).filter(differs).collect();
    if changed.iter().any(|&i| description.params[i].reopen) {
        Values::Reopen(Opens::Beside)
    } else if changed.is_empty() {
        Values::Same
    } else {
        Values::Live
    }
}

/// Whether a node opens only after its predecessor, or one of the nodes in `freed`, has closed.
fn opens_after_close(change: NodeChange, runtime: &NodeRuntime, freed: &[&NodeRuntime], claims: &Claims) -> bool {
    if change.is_added() {
        let has_same_device = |old: &&NodeRuntime| type_name(old.node_type) == type_name(runtime.node_type);
        return runtime.exclusive && freed.iter().filter(|old| old.exclusive).any(has_same_device);
    }
    // A node that claims its files can write beside its predecessor, so that a refused change leaves that one as it is.
    runtime.exclusive || (runtime.side_effects && !claims.are_used_by(&runtime.id))
}

impl Change {
    pub(super) fn between(
        old: &Plan,
        current: &Current,
        graph: &Graph,
        catalog: &Catalog,
        entry: plan::Entry<'_>,
        as_once: &[String],
        context: &RunContext,
    ) -> Result<Self, ApplyError> {
        let stale = |error: &dyn std::fmt::Display| ApplyError::Stale { reason: error.to_string() };
        let mut runtimes = old.runtimes.clone();
        let mut free: Vec<usize> = (0..runtimes.len()).filter(|&s| !old.alive[s]).rev().collect();
        let mut slots = Vec::with_capacity(graph.nodes.len());
        let mut node_changes = Vec::with_capacity(graph.nodes.len());
        for node in 0..graph.nodes.len() {
            let node_type = plan::entry_of(graph, node, entry).map_err(|error| stale(&error))?;
            let description = graph.nodes[node].node_type(catalog);
            let before = current.graph.node(&graph.nodes[node].id);
            let change = match before {
                Some(before) => {
                    let slot = current.slots[before];
                    slots.push(slot);
                    let (was, is) = (&current.graph.nodes[before], &graph.nodes[node]);
                    if is_replaced(&old.runtimes[slot], node_type, was, is, as_once) {
                        NodeChange::Replaced(Opens::Beside)
                    } else {
                        let values = changed_values(description, was, is);
                        NodeChange::RetainedFrames { values, rewired: false }
                    }
                }
                None => {
                    slots.push(free.pop().unwrap_or(runtimes.len()));
                    NodeChange::Added(Opens::Beside)
                }
            };
            if change.is_added() || change.is_replaced() {
                let slot = slots[node];
                let group = context.groups.of(&graph.nodes[node]).map_err(|error| stale(&error))?;
                let runtime = plan::runtime(graph, catalog, node, node_type, group);
                if slot < runtimes.len() {
                    runtimes[slot] = runtime;
                } else {
                    runtimes.push(runtime);
                }
            }
            node_changes.push(change);
        }
        let kept = |slot: usize| slots.contains(&slot);
        let removed: Vec<usize> = current.slots.iter().copied().filter(|&slot| !kept(slot)).collect();
        for node in 0..graph.nodes.len() {
            let Some(before) = current.graph.node(&graph.nodes[node].id) else { continue };
            if let NodeChange::RetainedFrames { rewired, .. } = &mut node_changes[node] {
                let was = connections(&current.graph, &current.slots, before);
                *rewired = was != connections(graph, &slots, node);
            }
        }
        let replaced = (0..slots.len()).filter(|&n| node_changes[n].is_replaced()).map(|n| slots[n]);
        let freed: Vec<&NodeRuntime> =
            removed.iter().copied().chain(replaced).map(|slot| &*old.runtimes[slot]).collect();
        for (change, &slot) in node_changes.iter_mut().zip(&slots) {
            if opens_after_close(*change, &runtimes[slot], &freed, &context.claims) {
                change.set_opens(Opens::AfterClose);
            }
        }
        let plan = plan::lay_out(graph, catalog, runtimes, slots, old.ticks_at_once, Some(old));
        let mut change = Self { plan, node_changes, removed, held: Vec::new(), quiet: Vec::new() };
        change.find_held(old);
        Ok(change)
    }

    /// Names of nodes whose current instance the change closes.
    pub(super) fn leaving(&self, old: &Plan, graph: &Graph) -> Vec<String> {
        let removed = self.removed.iter().map(|&slot| old.runtimes[slot].id.clone());
        let nodes = self.node_changes.iter().zip(&graph.nodes);
        let anew = nodes.filter(|(c, _)| c.is_replaced() || c.is_reopened()).map(|(_, node)| node.id.clone());
        removed.chain(anew).collect()
    }

    /// Also holds the regions of these sources.
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
        let mut touched = vec![false; self.plan.runtimes.len()];
        for &slot in &self.removed {
            touched[slot] = true;
        }
        for (node, change) in self.node_changes.iter().enumerate() {
            let slot = self.plan.slots[node];
            touched[slot] |= change.gets_inputs() || change.opens_after_close();
        }
        self.quiet =
            (0..old.runtimes.len()).filter(|&s| old.alive[s] && touched[s] && old.runtimes[s].source).collect();
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
