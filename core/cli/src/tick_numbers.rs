//! Numbers of a run, a row per tick: what scalar and table outputs carry, and what nodes report.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use panoscope_abi::Tick;
use panoscope_base::packet::{Numbers, has_numbers};
use panoscope_engine::memory::FrameRef;
use panoscope_engine::sync::lock;
use panoscope_engine::{Listener, NumberListener};
use panoscope_graph::{Catalog, Graph, GraphText};
use serde::Serialize;

/// Stands for all outputs with numbers.
const ALL: &str = "*";

/// A measure cannot be read from the graph.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum MeasureError {
    /// It is not of the form `NODE.NAME`.
    #[error("--measure {measure}: write it as NODE.OUTPUT, NODE.OUTPUT.COLUMN or NODE.NUMBER")]
    Form {
        /// As it was given.
        measure: String,
    },
    /// The graph has no such node.
    #[error("--measure {measure}: the graph has no node `{node}`; its nodes are {nodes}")]
    Node {
        /// As it was given.
        measure: String,
        /// Name of the node.
        node: String,
        /// Names of all nodes.
        nodes: String,
    },
    /// The output carries no numbers.
    #[error("--measure {measure}: the output carries {packet}, which has no numbers")]
    Packet {
        /// As it was given.
        measure: String,
        /// Type of its packets.
        packet: String,
    },
}

/// An output with numbers.
#[derive(Debug)]
struct Port {
    node: String,
    output: String,
    packet: String,
    /// Name of its columns, as it was asked for: `NODE.OUTPUT`.
    name: String,
    /// The only column of a table that is wanted; all without it.
    column: Option<String>,
}

/// Column of the CSV file: measure, and the row of a table, from 0.
type Column = (String, usize);

#[derive(Debug, Default)]
struct Rows {
    columns: BTreeMap<Column, u32>,
    /// By source and number of the tick: capture time in ns, and values by column.
    ticks: BTreeMap<(u32, u64), (i64, BTreeMap<u32, f64>)>,
}

impl Rows {
    fn put(&mut self, tick: &Tick, column: Column, value: f64) {
        let next = self.columns.len() as u32;
        let index = *self.columns.entry(column).or_insert(next);
        let row = self.ticks.entry((tick.source, tick.seq)).or_insert_with(|| (tick.capture_ns, BTreeMap::new()));
        row.1.insert(index, value);
    }

    fn table(&self) -> TickTable {
        let is_list = |name: &str| self.columns.keys().any(|(other, row)| other == name && *row > 0);
        let column = |(name, row): &Column| if is_list(name) { format!("{name}[{}]", row + 1) } else { name.clone() };
        let mut rows = Vec::new();
        for ((source, tick), (capture_ns, values)) in &self.ticks {
            let value = |index| values.get(index).copied().filter(|value| value.is_finite());
            rows.push(TickRow(*source, *tick, *capture_ns, self.columns.values().map(value).collect()));
        }
        TickTable { columns: self.columns.keys().map(column).collect(), rows }
    }
}

/// Numbers by tick. The rows of a table with more than one are columns: `NODE.OUTPUT.COLUMN[1]`, ...
#[derive(Debug, PartialEq, Serialize)]
pub struct TickTable {
    /// Names of the numbers, sorted.
    pub columns: Vec<String>,
    /// In the order of source and tick.
    pub rows: Vec<TickRow>,
}

/// Source, number of the tick, capture time in ns, and a value for each column; `None` where it is missing or not finite.
#[derive(Debug, PartialEq, Serialize)]
pub struct TickRow(pub u32, pub u64, pub i64, pub Vec<Option<f64>>);

/// Collects numbers of a run.
#[derive(Debug)]
pub struct TickNumbers {
    ports: Vec<Port>,
    /// Node, name of its number, and name of the column.
    numbers: Vec<(String, String, String)>,
    rows: Arc<Mutex<Rows>>,
}

impl TickNumbers {
    /// `measures` are `NODE.OUTPUT`, `NODE.OUTPUT.COLUMN`, `NODE.NUMBER`, or `*` for all outputs with numbers.
    ///
    /// # Errors
    /// The graph has no such node, or the output carries no numbers.
    pub fn new(measures: &[String], text: &GraphText, graph: &Graph, catalog: &Catalog) -> Result<Self, MeasureError> {
        let mut collected = Self { ports: Vec::new(), numbers: Vec::new(), rows: Arc::default() };
        for measure in measures {
            if measure != ALL {
                collected.add(measure, &text.resolve_output(measure), graph, catalog)?;
                continue;
            }
            for node in &graph.nodes {
                let outputs = node.node_type(catalog).outputs.iter().filter(|output| has_numbers(&output.packet.name));
                collected.ports.extend(outputs.map(|output| Port {
                    node: node.id.clone(),
                    output: output.name.clone(),
                    packet: output.packet.name.clone(),
                    name: format!("{}.{}", node.id, output.name),
                    column: None,
                }));
            }
        }
        Ok(collected)
    }

    /// `resolved` is the measure with the node's name in the flattened graph.
    fn add(&mut self, measure: &str, resolved: &str, graph: &Graph, catalog: &Catalog) -> Result<(), MeasureError> {
        let asked = || measure.to_owned();
        let (id, rest) = resolved.split_once('.').ok_or_else(|| MeasureError::Form { measure: asked() })?;
        let Some(node) = graph.node(id) else {
            let nodes: Vec<&str> = graph.nodes.iter().map(|node| node.id.as_str()).collect();
            return Err(MeasureError::Node { measure: asked(), node: id.to_owned(), nodes: nodes.join(", ") });
        };
        let (output, column) = rest.split_once('.').map_or((rest, None), |(output, column)| (output, Some(column)));
        let node_type = graph.nodes[node].node_type(catalog);
        let Some(output) = node_type.output(output).map(|index| &node_type.outputs[index]) else {
            self.numbers.push((id.to_owned(), rest.to_owned(), asked()));
            return Ok(());
        };
        let packet = output.packet.name.clone();
        if !has_numbers(&packet) {
            return Err(MeasureError::Packet { measure: asked(), packet });
        }
        let suffix = column.map_or(0, |column| column.len() + 1);
        self.ports.push(Port {
            node: id.to_owned(),
            output: output.name.clone(),
            packet,
            name: measure[..measure.len() - suffix].to_owned(),
            column: column.map(str::to_owned),
        });
        Ok(())
    }

    /// Listeners on the outputs.
    pub fn listeners(&self) -> Vec<Listener> {
        let listener = |port: &Port| {
            let (packet, name, column) = (port.packet.clone(), port.name.clone(), port.column.clone());
            let rows = Arc::clone(&self.rows);
            let hear = move |frame: &FrameRef| {
                // A packet that is malformed leaves its cells empty.
                let Ok(Some(numbers)) = Numbers::read(frame.bytes(), &packet) else { return };
                let (tick, mut rows) = (frame.tick(), lock(&rows));
                if packet == "scalar" {
                    numbers.values.iter().for_each(|value| rows.put(&tick, (name.clone(), 0), *value));
                    return;
                }
                for (index, row) in numbers.rows().enumerate() {
                    let cells = numbers.names.iter().zip(row);
                    for (cell, value) in cells.filter(|(cell, _)| column.as_ref().is_none_or(|wanted| wanted == *cell))
                    {
                        rows.put(&tick, (format!("{name}.{cell}"), index), *value);
                    }
                }
            };
            Listener { node: port.node.clone(), output: port.output.clone(), hear: Arc::new(hear) }
        };
        self.ports.iter().map(listener).collect()
    }

    /// One listener for each node that reports a wanted number.
    pub fn number_listeners(&self) -> Vec<NumberListener> {
        let mut by_node: BTreeMap<&str, Vec<(String, String)>> = BTreeMap::new();
        for (node, number, name) in &self.numbers {
            by_node.entry(node).or_default().push((number.clone(), name.clone()));
        }
        let listener = |(node, wanted): (&str, Vec<(String, String)>)| {
            let rows = Arc::clone(&self.rows);
            let hear = move |tick: &Tick, reported: &str, value: f64| {
                for (_, name) in wanted.iter().filter(|(number, _)| number == reported) {
                    lock(&rows).put(tick, (name.clone(), 0), value);
                }
            };
            NumberListener { node: node.to_owned(), hear: Arc::new(hear) }
        };
        by_node.into_iter().map(listener).collect()
    }

    /// The numbers so far.
    pub fn table(&self) -> TickTable {
        lock(&self.rows).table()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_in_the_order_of_ticks_and_columns_in_that_of_names() {
        let mut rows = Rows::default();
        let tick = |seq: u64| Tick { seq, capture_ns: 100 * seq as i64, ..Tick::default() };
        rows.put(&tick(1), ("b.x".to_owned(), 0), 0.25);
        rows.put(&tick(0), ("c.y".to_owned(), 0), f64::NAN);
        rows.put(&tick(0), ("a.table.mm".to_owned(), 1), 2.0);
        rows.put(&tick(0), ("a.table.mm".to_owned(), 0), 1.5);
        let table = rows.table();
        assert_eq!(table.columns, ["a.table.mm[1]", "a.table.mm[2]", "b.x", "c.y"]);
        let first = TickRow(0, 0, 0, vec![Some(1.5), Some(2.0), None, None]);
        assert_eq!(table.rows, [first, TickRow(0, 1, 100, vec![None, None, Some(0.25), None])]);
    }
}
