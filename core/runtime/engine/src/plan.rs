//! Lays out a checked graph for the scheduler: readers of each output, inline chains, regions.
//!
//! A node has a *slot*, a number that it keeps as long as a node of its name is in the graph, so that ticks and tasks
//! in flight mean the same node before and after a change. Slots of removed nodes are reused.

use std::ops::Range;
use std::sync::Arc;

use panoscope_abi::{self as abi, PortRange};
use panoscope_graph::{Align, Catalog, Edge, Graph, Mode, Node, NodeKind};

use crate::isolation::Group;
use crate::join::{Join, Rule, Slot};
use crate::light::Sources;
use crate::node::{NodeRuntime, NodeSpec};
use crate::params::Snapshot;
use crate::pool::Urgency;
use crate::rate;
use crate::region::Region;

/// A reader of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Reader {
    pub node: usize,
    pub slot: usize,
    /// It reads gray8 and the producer may make bgr8.
    pub convert: bool,
    /// Formats that it accepts, one bit each; 0 for any.
    pub accepts: u32,
}

/// The only reader of a node, if it runs inline after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Inline {
    pub port: usize,
    pub node: usize,
    /// Whether it runs with an empty input.
    pub optional: bool,
    pub accepts: u32,
}

/// A step of an inline chain.
pub(crate) struct Link {
    pub runtime: Arc<NodeRuntime>,
    pub node: u32,
    /// Output of the node before it.
    pub port: u32,
    pub accepts: u32,
    pub optional: bool,
    /// Whether the node has no other input.
    pub lone: bool,
    pub sink: bool,
}

/// The connections of a node as the scheduler needs them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Wiring {
    /// Readers of each output.
    pub readers: Vec<Vec<Reader>>,
    pub inline: Option<Inline>,
    /// First node of the inline chain that contains this one.
    pub chain_head: usize,
    pub region: usize,
    /// Whether its ticks end here: no reader by an exact input.
    pub leaf: bool,
    /// Whether no output has a reader.
    pub sink: bool,
    /// Whether a tick waits for its outputs.
    pub urgency: Urgency,
}

/// The nodes of a region.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Extent {
    pub head: usize,
    pub leaves: u32,
    pub limit: u32,
    /// Sorted.
    pub members: Vec<usize>,
}

/// A graph laid out for the scheduler. All lists but the regions' are indexed by slot.
pub(crate) struct Plan {
    pub runtimes: Vec<Arc<NodeRuntime>>,
    /// Slots without a node keep the runtime of the node that was there.
    pub alive: Vec<bool>,
    pub wiring: Vec<Wiring>,
    /// All inline chains one after the other, each in node order without its head.
    links: Vec<Link>,
    /// The range of `links` that follows each node.
    following: Vec<Range<u32>>,
    pub regions: Vec<Arc<Region>>,
    pub extents: Vec<Extent>,
    /// For each region, its readers in other regions: node and input slot.
    pub outsiders: Vec<Vec<(usize, usize)>>,
    /// Slot of each node of the graph.
    pub slots: Vec<usize>,
    /// Whether an input waits for the nearest packet, so that the watchdog has to check its deadline.
    pub nearest: bool,
    /// Ticks of a region that may be in flight; see [`crate::Options::ticks_at_once`].
    pub ticks_at_once: Option<u32>,
}

impl Sources for Plan {
    #[inline]
    fn arrived_ns(&self, tick: &abi::Tick) -> Option<i64> {
        self.runtimes.get(tick.source as usize)?.ticks.arrived_ns(tick.seq)
    }

    fn is_constant(&self, tick: &abi::Tick) -> bool {
        let source = self.runtimes.get(tick.source as usize);
        source.is_some_and(|source| !source.exclusive && source.ticks.is_only_one(tick.seq))
    }

    fn is_forgotten(&self, tick: &abi::Tick) -> bool {
        self.runtimes.get(tick.source as usize).is_some_and(|source| source.ticks.is_forgotten(tick.seq))
    }
}

impl Plan {
    /// All nodes with their slots.
    pub fn live(&self) -> impl Iterator<Item = (usize, &Arc<NodeRuntime>)> {
        self.runtimes.iter().enumerate().filter(|(slot, _)| self.alive[*slot])
    }

    /// The region of a node.
    pub fn region_of(&self, node: usize) -> &Arc<Region> {
        &self.regions[self.wiring[node].region]
    }

    /// The first node after a source whose region is one inline chain: the thread that admits the only tick of the region runs
    /// the chain without queue or lock.
    #[inline]
    pub fn sole_chain(&self, source: usize) -> Option<&Link> {
        let links = self.following(source);
        let extent = &self.extents[self.wiring[source].region];
        links.first().filter(|_| extent.head == source && extent.members.len() == links.len() + 1)
    }

    /// The nodes that run inline after a node, one after the other.
    #[inline]
    pub fn following(&self, node: usize) -> &[Link] {
        let Range { start, end } = self.following[node];
        &self.links[start as usize..end as usize]
    }
}

fn rule(edge: &Edge, any_trigger: bool) -> Rule {
    match edge.align {
        _ if edge.delay > 0 => Rule::Delay,
        Align::Exact => Rule::Exact,
        Align::Latest => Rule::Latest { trigger: edge.trigger || !any_trigger },
        Align::Nearest { tolerance_ms } => Rule::Nearest { tolerance_ns: (tolerance_ms * 1e6) as i64 },
    }
}

fn is_exact(edge: &Edge) -> bool {
    edge.delay == 0 && edge.align == Align::Exact
}

/// Finds the engine's entry of a node type: plugin, type.
pub(crate) type Entry<'a> = &'a dyn Fn(&str, &str) -> Option<&'static abi::NodeType>;

/// A plugin was reloaded without a node type that the graph uses.
#[derive(Debug, thiserror::Error)]
#[error("plugin `{plugin}` no longer offers `{node_type}`")]
pub(crate) struct NoNodeType {
    plugin: String,
    node_type: String,
}

/// The entry of a node of the graph.
pub(crate) fn entry_of(graph: &Graph, node: usize, entry: Entry<'_>) -> Result<&'static abi::NodeType, NoNodeType> {
    let node = &graph.nodes[node];
    entry(&node.plugin, &node.type_name)
        .ok_or_else(|| NoNodeType { plugin: node.plugin.clone(), node_type: node.type_name.clone() })
}

/// The node through which ticks enter the region of `node`.
fn head_of(graph: &Graph, mut node: usize) -> usize {
    while let Some(edge) = graph.inputs_of(node).iter().find(|e| is_exact(e)) {
        node = edge.from_node;
    }
    node
}

/// Queue length of an edge in live mode, see [`Slot::capacity`].
fn capacity(graph: &Graph, edge: &Edge, any_trigger: bool) -> usize {
    let rule = rule(edge, any_trigger);
    if rule == Rule::Delay && head_of(graph, edge.from_node) == head_of(graph, edge.to_node) {
        // Each tick of the region needs its packet.
        return usize::MAX;
    }
    edge.queue.map_or_else(|| Slot::usual_capacity(rule), |queue| queue as usize)
}

/// Queue length of each edge into a node, and whether the edge closes a loop, in the order of the slots.
pub(crate) fn wires(graph: &Graph, node: usize) -> impl Iterator<Item = (usize, bool)> {
    let edges = graph.inputs_of(node);
    let any_trigger = edges.iter().any(|e| e.trigger);
    edges.iter().map(move |edge| (capacity(graph, edge, any_trigger), is_state(graph, edge)))
}

/// Whether an edge feeds a state back through a loop, see [`crate::light`].
fn is_state(graph: &Graph, edge: &Edge) -> bool {
    edge.delay > 0 && leads_to(graph, edge.to_node, edge.from_node)
}

/// Whether an output of node `from` reaches node `to`.
fn leads_to(graph: &Graph, from: usize, to: usize) -> bool {
    let mut reached = vec![false; graph.nodes.len()];
    let mut next = vec![from];
    while let Some(node) = next.pop() {
        if !std::mem::replace(&mut reached[node], true) {
            next.extend(graph.outputs_of(node).map(|edge| edge.to_node));
        }
    }
    reached[to]
}

/// Empty inputs of a node, and the slots of each port.
pub(crate) fn inputs(graph: &Graph, catalog: &Catalog, node: usize) -> (Join, Vec<PortRange>) {
    let description = graph.nodes[node].node_type(catalog);
    let edges = graph.inputs_of(node);
    let any_trigger = edges.iter().any(|e| e.trigger);
    let mut ranges = Vec::with_capacity(description.inputs.len());
    let mut slots = Vec::with_capacity(edges.len());
    for (port, declared) in description.inputs.iter().enumerate() {
        let (first, is_calibration) = (slots.len() as u32, declared.packet.name == "calibration");
        for edge in edges.iter().filter(|e| e.to_port == port) {
            // Each entry of a list may be empty.
            let optional = declared.optional || declared.list;
            let mut slot = Slot::new(rule(edge, any_trigger), optional, capacity(graph, edge, any_trigger));
            slot.shows_light = !is_calibration && !edge.guide;
            slot.is_state = is_state(graph, edge);
            slot.max_age_ns = edge.max_age_ms.filter(|_| !is_calibration).map(|ms| (ms * 1e6) as i64);
            slots.push(slot);
        }
        ranges.push(PortRange { first, count: slots.len() as u32 - first });
    }
    (Join::new(slots, graph.mode == Mode::Batch), ranges)
}

/// Which outputs of a node have a reader, one bit each.
pub(crate) fn outputs_read(graph: &Graph, node: usize) -> u64 {
    graph.outputs_of(node).fold(0u64, |bits, e| bits | 1u64.checked_shl(e.from_port as u32).unwrap_or(0))
}

/// The kind that a node counts as: a node that waits for another machine must not occupy the pool, and a node pinned to
/// a core needs its own thread.
fn kind(node: &Node, declared: NodeKind) -> NodeKind {
    let is_pinned = node.cpu.is_some() && declared == NodeKind::Compute;
    if node.machine.is_some() || is_pinned { NodeKind::Blocking } else { declared }
}

/// The runtime of a node of the graph, without an open instance.
pub(crate) fn runtime(
    graph: &Graph,
    catalog: &Catalog,
    node: usize,
    node_type: &'static abi::NodeType,
    group: Option<Arc<dyn Group>>,
) -> Arc<NodeRuntime> {
    let (join, ranges) = inputs(graph, catalog, node);
    let outputs_read = outputs_read(graph, node);
    let description = graph.nodes[node].node_type(catalog);
    let (earlier, node) = (&graph.nodes[..node], &graph.nodes[node]);
    let rate_phase_ns = node.max_rate_hz.map_or(0, |hz| {
        let periods_ns: Vec<i64> =
            earlier.iter().filter_map(|node| node.max_rate_hz).chain([hz]).map(rate::period_ns).collect();
        rate::phase_ns(&periods_ns)
    });
    let spec = NodeSpec {
        id: node.id.clone(),
        node_type,
        group,
        kind: kind(node, description.kind),
        source: description.source,
        on_fault: node.on_fault,
        budget_ms: node.budget_ms,
        max_rate_hz: node.max_rate_hz,
        rate_phase_ns,
        cpu: node.cpu,
        ranges,
        outputs_read,
    };
    Arc::new(NodeRuntime::new(spec, join, Snapshot::new(node.params.clone())))
}

/// Lays out a graph whose nodes have runtimes. `slots` is the slot of each node; regions of `old` whose head stays are
/// kept.
pub(crate) fn lay_out(
    graph: &Graph,
    catalog: &Catalog,
    runtimes: Vec<Arc<NodeRuntime>>,
    slots: Vec<usize>,
    ticks_at_once: Option<u32>,
    old: Option<&Plan>,
) -> Plan {
    let mut alive = vec![false; runtimes.len()];
    slots.iter().for_each(|&slot| alive[slot] = true);
    let mut wiring = readers(graph, catalog, &slots, runtimes.len());
    inline_chains(graph, catalog, &runtimes, &slots, &mut wiring);
    let (regions, extents) = find_regions(graph, &slots, &mut wiring, ticks_at_once, old);
    let nearest = graph.edges.iter().any(|e| matches!(e.align, Align::Nearest { .. }));
    let (links, following) = link(&runtimes, &alive, &wiring);
    let outsiders = extents.iter().enumerate().map(|(region, extent)| outsiders(&wiring, region, extent)).collect();
    Plan { runtimes, alive, wiring, links, following, regions, extents, outsiders, slots, nearest, ticks_at_once }
}

/// The readers of every output, by slot.
fn readers(graph: &Graph, catalog: &Catalog, slots: &[usize], slot_count: usize) -> Vec<Wiring> {
    let mut wiring = vec![Wiring::default(); slot_count];
    for (node, &slot) in slots.iter().enumerate() {
        wiring[slot].readers = vec![Vec::new(); graph.nodes[node].node_type(catalog).outputs.len()];
        wiring[slot].chain_head = slot;
    }
    for (node, &to) in slots.iter().enumerate() {
        let description = graph.nodes[node].node_type(catalog);
        // `inputs_of` is sorted by port and list position, like the slots.
        for (slot, edge) in graph.inputs_of(node).iter().enumerate() {
            let formats = &description.inputs[edge.to_port].packet.formats;
            let accepts = formats.iter().filter_map(|f| format_number(f)).fold(0, |bits, f| bits | abi::format_bit(f));
            let reader = Reader { node: to, slot, convert: edge.convert, accepts };
            wiring[slots[edge.from_node]].readers[edge.from_port].push(reader);
        }
    }
    wiring
}

fn outsiders(wiring: &[Wiring], region: usize, extent: &Extent) -> Vec<(usize, usize)> {
    let readers = extent.members.iter().flat_map(|&member| wiring[member].readers.iter().flatten());
    readers.filter(|r| wiring[r.node].region != region).map(|r| (r.node, r.slot)).collect()
}

/// Lists the inline chains in the order in which they run.
fn link(runtimes: &[Arc<NodeRuntime>], alive: &[bool], wiring: &[Wiring]) -> (Vec<Link>, Vec<Range<u32>>) {
    let mut links = Vec::new();
    let mut following = vec![0..0; runtimes.len()];
    for head in (0..runtimes.len()).filter(|&slot| alive[slot] && wiring[slot].chain_head == slot) {
        let mut chain = vec![head];
        let mut last = head;
        while let Some(inline) = wiring[last].inline {
            last = inline.node;
            chain.push(last);
            let runtime = Arc::clone(&runtimes[last]);
            links.push(Link {
                node: last as u32,
                port: inline.port as u32,
                accepts: inline.accepts,
                optional: inline.optional,
                lone: runtime.node_type.inputs_len == 1,
                sink: wiring[last].sink,
                runtime,
            });
        }
        let end = links.len() as u32;
        for (index, node) in chain.iter().enumerate() {
            following[*node] = end - (chain.len() - 1 - index) as u32..end;
        }
    }
    (links, following)
}

fn format_number(name: &str) -> Option<u32> {
    panoscope_base::format::image_named(name).map(|format| format.id)
}

/// A reader runs inline if it reads nothing else and its producer has no other reader. After a source it runs inline
/// where it can, see [`Plan::sole_chain`], and else from its queue: it heads its chain.
fn inline_chains(
    graph: &Graph,
    catalog: &Catalog,
    runtimes: &[Arc<NodeRuntime>],
    slots: &[usize],
    wiring: &mut [Wiring],
) {
    let compute = |slot: usize| runtimes[slot].kind == NodeKind::Compute && !runtimes[slot].source;
    let leads = |slot: usize| runtimes[slot].source || compute(slot);
    for &node in &graph.order {
        let slot = slots[node];
        let mut readers =
            wiring[slot].readers.iter().enumerate().flat_map(|(port, r)| r.iter().map(move |r| (port, *r)));
        let (Some((port, reader)), None) = (readers.next(), readers.next()) else { continue };
        let Some(edge) = graph.outputs_of(node).next() else { continue };
        let edges = graph.inputs_of(edge.to_node);
        let alone = edges.len() == 1 && is_exact(edge) && edge.list_index == 0;
        if alone && !reader.convert && leads(slot) && compute(reader.node) {
            let declared = &graph.nodes[edge.to_node].node_type(catalog).inputs[edge.to_port];
            let optional = declared.optional || declared.list;
            wiring[slot].inline = Some(Inline { port, node: reader.node, optional, accepts: reader.accepts });
            if !runtimes[slot].source {
                // Producers come first in `order`.
                wiring[reader.node].chain_head = wiring[slot].chain_head;
            }
        }
    }
}

/// Ticks inside a region in batch. Independent of the number of threads, because results of a loop with a delay depend
/// on the overlap.
const TICKS_IN_BATCH: u32 = 4;
/// Ticks inside a live region: one starts while the one before it ends.
pub const TICKS_LIVE: u32 = 2;

/// Which nodes a tick waits for: nodes without readers (sinks), nodes that lead there by inputs that wait, and nodes
/// that close a loop. A node read only by `latest` inputs may run late: its readers continue without it.
fn urgencies(graph: &Graph) -> Vec<Urgency> {
    let mut urgent = vec![false; graph.nodes.len()];
    for &node in graph.order.iter().rev() {
        let waits = |edge: &Edge| {
            let inputs = || graph.inputs_of(edge.to_node).iter().filter(|e| e.delay == 0);
            // A node without an input that waits fires on its `latest` inputs.
            let fires = || {
                let any_trigger = inputs().any(|e| e.trigger);
                inputs().all(|e| e.align == Align::Latest) && (edge.trigger || !any_trigger)
            };
            urgent[edge.to_node] && (edge.align != Align::Latest || fires())
        };
        let mut readers = graph.outputs_of(node).peekable();
        urgent[node] = readers.peek().is_none() || readers.any(|edge| edge.delay > 0 || waits(edge));
    }
    urgent.into_iter().map(|urgent| if urgent { Urgency::Urgent } else { Urgency::Patient }).collect()
}

fn find_regions(
    graph: &Graph,
    slots: &[usize],
    wiring: &mut [Wiring],
    ticks_at_once: Option<u32>,
    old: Option<&Plan>,
) -> (Vec<Arc<Region>>, Vec<Extent>) {
    let count = graph.nodes.len();
    let batch = graph.mode == Mode::Batch;
    let mut head = vec![usize::MAX; count];
    for &node in &graph.order {
        let upstream = graph.inputs_of(node).iter().find(|e| is_exact(e));
        head[node] = upstream.map_or(node, |e| head[e.from_node]);
    }
    let mut exact_reader = vec![false; count];
    for edge in graph.edges.iter().filter(|e| is_exact(e)) {
        exact_reader[edge.from_node] = true;
    }
    let mut number = vec![usize::MAX; count];
    let mut extents: Vec<Extent> = Vec::new();
    for &node in &graph.order {
        if head[node] == node {
            number[node] = extents.len();
            let limit = ticks_at_once.unwrap_or(if batch { TICKS_IN_BATCH } else { TICKS_LIVE });
            extents.push(Extent { head: slots[node], leaves: 0, limit, members: Vec::new() });
        }
        let extent = &mut extents[number[head[node]]];
        extent.members.push(slots[node]);
        extent.leaves += u32::from(!exact_reader[node]);
        for edge in graph.inputs_of(node).iter().filter(|e| is_exact(e)) {
            if ticks_at_once.is_none() {
                extent.limit = extent.limit.max(edge.queue.unwrap_or(1));
            }
        }
    }
    for node in 0..count {
        let wiring = &mut wiring[slots[node]];
        wiring.region = number[head[node]];
        wiring.leaf = !exact_reader[node];
        wiring.sink = wiring.readers.iter().all(Vec::is_empty);
    }
    for (node, urgency) in urgencies(graph).into_iter().enumerate() {
        wiring[slots[node]].urgency = urgency;
    }
    let regions = extents
        .iter_mut()
        .map(|extent| {
            extent.members.sort_unstable();
            let known = old.and_then(|old| old.regions.iter().zip(&old.extents).find(|(_, e)| e.head == extent.head));
            match known {
                Some((region, _)) => Arc::clone(region),
                None => Arc::new(Region::new(extent.head, extent.leaves, extent.limit)),
            }
        })
        .collect();
    (regions, extents)
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_graph::{OnFault, Preset};

    /// A graph of nodes by name; edges as `from > to`, `from ~ to` for the newest there is, `from . to` for that of the
    /// tick before.
    fn graph(nodes: &[&str], edges: &[&str]) -> Graph {
        let node = |id: &&str| Node {
            id: (*id).to_owned(),
            type_index: 0,
            type_name: "pass".to_owned(),
            plugin: "flow".to_owned(),
            params: Vec::new(),
            on_fault: OnFault::default(),
            budget_ms: None,
            max_rate_hz: None,
            cpu: None,
            isolate: None,
            machine: None,
            deny: panoscope_graph::Deny::default(),
            span: 0..0,
            line: 0,
        };
        let place = |id: &str| nodes.iter().position(|n| *n == id).expect("a node");
        let mut edges: Vec<Edge> = edges
            .iter()
            .map(|edge| {
                let [from, kind, to] = edge.split(' ').collect::<Vec<_>>()[..] else { panic!("{edge}") };
                Edge {
                    from_node: place(from),
                    from_port: 0,
                    to_node: place(to),
                    to_port: 0,
                    list_index: 0,
                    align: if kind == "~" { Align::Latest } else { Align::Exact },
                    queue: None,
                    delay: u8::from(kind == "."),
                    trigger: false,
                    convert: false,
                    max_age_ms: None,
                    guide: false,
                    span: 0..0,
                }
            })
            .collect();
        edges.sort_by_key(|e| e.to_node);
        (1..).zip(&mut edges).for_each(|(port, edge)| edge.to_port = port);
        Graph {
            name: "test".to_owned(),
            mode: Mode::Live,
            plugins: Vec::new(),
            isolated_plugins: Vec::new(),
            nodes: nodes.iter().map(node).collect(),
            edges,
            order: (0..nodes.len()).collect(),
            preset: Preset::default(),
            editor: toml::Table::new(),
        }
    }

    fn patient(nodes: &[&str], edges: &[&str]) -> Vec<String> {
        let graph = graph(nodes, edges);
        let patient = urgencies(&graph).into_iter().zip(&graph.nodes).filter(|(u, _)| *u == Urgency::Patient);
        patient.map(|(_, node)| node.id.clone()).collect()
    }

    #[test]
    fn what_leads_to_an_end_is_urgent() {
        assert!(patient(&["camera", "smooth", "video"], &["camera > smooth", "smooth > video"]).is_empty());
    }

    #[test]
    fn what_is_only_looked_at_waits_and_so_does_what_leads_there() {
        let nodes = ["camera", "match", "find", "screen"];
        let edges = ["camera > match", "match > find", "camera > screen", "find ~ screen"];
        assert_eq!(patient(&nodes, &edges), ["match", "find"]);
        // A second reader that waits makes it urgent.
        let nodes = ["camera", "match", "find", "screen", "file"];
        let edges = [&edges[..], &["find > file"]].concat();
        assert!(patient(&nodes, &edges).is_empty());
    }

    #[test]
    fn what_fires_its_reader_does_not_wait() {
        let nodes = ["camera", "slow", "screen"];
        assert!(patient(&nodes, &["camera ~ screen", "camera > slow", "slow ~ screen"]).is_empty());
        // One of both fires it alone.
        let mut graph = graph(&nodes, &["camera ~ screen", "camera > slow", "slow ~ screen"]);
        graph.edges.iter_mut().filter(|e| e.from_node == 0).for_each(|e| e.trigger = true);
        assert_eq!(urgencies(&graph), [Urgency::Urgent, Urgency::Patient, Urgency::Urgent]);
    }

    /// Text with parts and the same graph in one file are laid out alike: same order, readers, regions and urgency, so
    /// hops cost the same.
    #[test]
    fn parts_do_not_change_the_plan() {
        use panoscope_graph::{GraphOptions, GraphText, NodeType, PacketType, Port, check};
        use std::path::Path;
        let port = |name: &str| Port {
            name: name.to_owned(),
            doc: String::new(),
            packet: PacketType { name: "image".to_owned(), formats: vec!["gray8".to_owned()], layout_hash: 0 },
            optional: false,
            list: false,
        };
        let node = |name: &str, inputs: &[&str], outputs: &[&str]| NodeType {
            name: name.to_owned(),
            plugin: "flow".to_owned(),
            inputs: inputs.iter().map(|p| port(p)).collect(),
            outputs: outputs.iter().map(|p| port(p)).collect(),
            source: inputs.is_empty(),
            side_effects: outputs.is_empty(),
            ..NodeType::default()
        };
        let node_types =
            vec![node("frames", &[], &["image"]), node("pass", &["image"], &["image"]), node("drain", &["image"], &[])];
        let catalog = Catalog { plugins: vec!["flow".to_owned()], node_types, ..Catalog::default() };
        let head = "plugins = [\"flow\"]\n";
        let pass = |id: &str, from: &str| {
            let input =
                if from.is_empty() { String::new() } else { format!("inputs = {{ image = \"{from}.image\" }}\n") };
            format!("[nodes.\"{id}\"]\ntype = \"pass\"\n{input}")
        };
        let ends = |last: &str| {
            let drains = ["screen", "file"]
                .map(|id| format!("[nodes.{id}]\ntype = \"drain\"\ninputs = {{ image = \"{last}.image\" }}\n"));
            drains.concat()
                + "[nodes.late]\ntype = \"drain\"\ninputs = { image = { from = \"source.image\", align = \"latest\" } }\n"
        };
        let source = "[nodes.source]\ntype = \"frames\"\n";
        // Two parts of two parts of two nodes: eight hops.
        let two = |what: &str, inner: &str| {
            format!(
                "{head}[part]\ninputs = {{ image = \"a.image\" }}\noutputs = {{ image = \"b.image\" }}\n[nodes.a]\n{what} = \"{inner}\"\n[nodes.b]\n{what} = \"{inner}\"\ninputs = {{ image = \"a.image\" }}\n"
            )
        };
        let folder = std::path::absolute(Path::new("graphs-of-no-file")).expect("a folder");
        let texts = [("leaf.toml", two("type", "pass")), ("twig.toml", two("graph", "leaf.toml"))];
        let texts = texts.map(|(name, text)| (folder.join(name), text)).into_iter().collect();
        let options = GraphOptions { texts, ..GraphOptions::default() };
        let used = |id: &str, from: &str| {
            format!("[nodes.{id}]\ngraph = \"twig.toml\"\ninputs = {{ image = \"{from}.image\" }}\n")
        };
        let parts = format!("{head}{source}{}{}{}", used("x", "source"), used("y", "x"), ends("y"));
        let ids: Vec<String> =
            ["x", "y"].iter().flat_map(|t| ["a/a", "a/b", "b/a", "b/b"].map(|n| format!("{t}/{n}"))).collect();
        let mut flat = format!("{head}{source}");
        for (at, id) in ids.iter().enumerate() {
            flat += &pass(id, if at == 0 { "source" } else { &ids[at - 1] });
        }
        flat += &ends("y/b/b");
        let plan = |text: &str| {
            let text = GraphText::parse_with(&folder.join("graph.toml"), text, &options);
            let (graph, _) = check(&text, &catalog).into_result().unwrap_or_else(|d| panic!("{}", d.render(false)));
            let slots: Vec<usize> = (0..graph.nodes.len()).collect();
            let mut wiring = readers(&graph, &catalog, &slots, slots.len());
            let (_, extents) = find_regions(&graph, &slots, &mut wiring, None, None);
            let ids: Vec<String> = graph.nodes.iter().map(|n| n.id.clone()).collect();
            (ids, graph.order, wiring, extents)
        };
        let (parts, flat) = (plan(&parts), plan(&flat));
        assert_eq!(parts.0.len(), 12);
        assert_eq!(parts, flat);
    }

    #[test]
    fn a_delayed_input_is_a_state_only_on_a_loop() {
        let edges = ["camera > find", "find > arm", "arm . camera", "camera . screen", "find ~ screen"];
        let graph = graph(&["camera", "find", "arm", "screen"], &edges);
        let states = |node: usize| wires(&graph, node).map(|(_, is_state)| is_state).collect::<Vec<_>>();
        assert_eq!((0..4).map(states).collect::<Vec<_>>(), [vec![true], vec![false], vec![false], vec![false, false]]);
    }

    #[test]
    fn what_closes_a_loop_is_urgent() {
        let nodes = ["camera", "arm", "screen"];
        assert!(patient(&nodes, &["camera > arm", "camera > screen", "arm . camera"]).is_empty());
    }
}
