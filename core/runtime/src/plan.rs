//! From a checked graph to what the scheduler walks: who reads what, which nodes run inline, which form a region.

use std::sync::Arc;

use panoscope_abi::{self as abi, PortRange};
use panoscope_graph::{Align, Catalog, Edge, Graph, Mode, NodeKind};

use crate::cell::{Cell, CellSpec, lock};
use crate::join::{Join, Rule, Slot};
use crate::params::Snapshot;
use crate::region::Region;

/// A reader of an output.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reader {
    pub node: usize,
    pub slot: usize,
    /// It wants gray8 where bgr8 may come.
    pub convert: bool,
}

/// A reader that runs inline after its producer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InlineReader {
    /// Output of the producer.
    pub port: usize,
    pub node: usize,
    /// Its input may be empty.
    pub optional: bool,
}

/// What the scheduler needs to know of a node besides its cell.
#[derive(Default)]
pub(crate) struct Wiring {
    /// Readers of each output.
    pub readers: Vec<Vec<Reader>>,
    /// The one reader, when it runs inline after this node.
    pub inline_reader: Option<InlineReader>,
    pub region: usize,
    /// No exact reader: its tick ends here.
    pub leaf: bool,
    /// Nobody reads any output.
    pub sink: bool,
}

/// A graph laid out for the scheduler.
pub(crate) struct Plan {
    pub cells: Vec<Arc<Cell>>,
    pub wiring: Vec<Wiring>,
    pub regions: Vec<Arc<Region>>,
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

/// Lays out a graph. `entry` finds the engine's entry of a node type.
pub(crate) fn build(
    graph: &Graph,
    catalog: &Catalog,
    entry: &dyn Fn(&str, &str) -> Option<&'static abi::NodeType>,
    ticks_in_flight: u32,
) -> Result<Plan, String> {
    let count = graph.nodes.len();
    let batch = graph.mode == Mode::Batch;
    let mut cells = Vec::with_capacity(count);
    let mut wiring: Vec<Wiring> = Vec::with_capacity(count);
    for (index, node) in graph.nodes.iter().enumerate() {
        let node_type = entry(&node.plugin, &node.type_name)
            .ok_or_else(|| format!("plugin `{}` no longer offers `{}`", node.plugin, node.type_name))?;
        let description = node.node_type(catalog);
        let edges = graph.inputs_of(index);
        let any_trigger = edges.iter().any(|e| e.trigger);
        let mut ranges = Vec::with_capacity(description.inputs.len());
        let mut slots = Vec::with_capacity(edges.len());
        for (port, declared) in description.inputs.iter().enumerate() {
            let first = slots.len() as u32;
            for edge in edges.iter().filter(|e| e.to_port == port) {
                // A list's entries may be empty one by one.
                let optional = declared.optional || declared.list;
                slots.push(Slot::new(rule(edge, any_trigger), optional, edge.queue.unwrap_or(1) as usize));
            }
            ranges.push(PortRange { first, count: slots.len() as u32 - first });
        }
        let read =
            graph.outputs_of(index).fold(0u64, |bits, e| bits | 1u64.checked_shl(e.from_port as u32).unwrap_or(0));
        let spec = CellSpec {
            id: node.id.clone(),
            node_type,
            kind: description.kind,
            source: description.source,
            on_fault: node.on_fault,
            budget_ms: node.budget_ms,
            max_rate_hz: node.max_rate_hz,
            cpu: node.cpu,
            ranges,
            outputs_read: read,
        };
        cells.push(Arc::new(Cell::new(spec, Join::new(slots, batch), Snapshot::new(node.params.clone()))));
        wiring.push(Wiring { readers: vec![Vec::new(); description.outputs.len()], ..Wiring::default() });
    }
    for node in 0..count {
        // `inputs_of` is sorted by port and list position, like the slots.
        for (slot, edge) in graph.inputs_of(node).iter().enumerate() {
            wiring[edge.from_node].readers[edge.from_port].push(Reader { node, slot, convert: edge.convert });
        }
    }
    inline_chains(graph, &cells, &mut wiring);
    let regions = find_regions(graph, &cells, &mut wiring, batch, ticks_in_flight);
    Ok(Plan { cells, wiring, regions })
}

/// A reader runs inline when it reads nothing else and nobody else reads its producer.
fn inline_chains(graph: &Graph, cells: &[Arc<Cell>], wiring: &mut [Wiring]) {
    for index in 0..cells.len() {
        let mut readers =
            wiring[index].readers.iter().enumerate().flat_map(|(port, r)| r.iter().map(move |r| (port, *r)));
        let (Some((port, reader)), None) = (readers.next(), readers.next()) else { continue };
        let edges = graph.inputs_of(reader.node);
        let compute = |i: usize| cells[i].kind == NodeKind::Compute && !cells[i].source;
        let alone = edges.len() == 1 && is_exact(&edges[0]) && edges[0].list_index == 0;
        if alone && !reader.convert && compute(index) && compute(reader.node) {
            let optional = lock(&cells[reader.node].join).slots.first().is_some_and(|s| s.optional);
            wiring[index].inline_reader = Some(InlineReader { port, node: reader.node, optional });
        }
    }
}

fn find_regions(
    graph: &Graph,
    cells: &[Arc<Cell>],
    wiring: &mut [Wiring],
    batch: bool,
    ticks_in_flight: u32,
) -> Vec<Arc<Region>> {
    let count = cells.len();
    let mut head = vec![usize::MAX; count];
    for &node in &graph.order {
        let upstream = graph.inputs_of(node).iter().find(|e| is_exact(e));
        head[node] = upstream.map_or(node, |e| head[e.from_node]);
    }
    let mut numbers = vec![usize::MAX; count];
    let mut regions = Vec::new();
    for &node in &graph.order {
        if head[node] != node {
            continue;
        }
        let inside = |n: usize| head[n] == node;
        let mut limit = if batch { ticks_in_flight.max(2) } else { 2 };
        for edge in graph.edges.iter().filter(|e| inside(e.to_node) && is_exact(e)) {
            limit = limit.max(edge.queue.unwrap_or(1));
        }
        let exact_reader = |n: usize| graph.outputs_of(n).any(|e| is_exact(e));
        let leaves = (0..count).filter(|&n| inside(n) && !exact_reader(n)).count();
        numbers[node] = regions.len();
        regions.push(Arc::new(Region::new(node, leaves as u32, limit)));
    }
    for node in 0..count {
        wiring[node].region = numbers[head[node]];
        wiring[node].leaf = !graph.outputs_of(node).any(|e| is_exact(e));
        wiring[node].sink = wiring[node].readers.iter().all(Vec::is_empty);
    }
    regions
}
