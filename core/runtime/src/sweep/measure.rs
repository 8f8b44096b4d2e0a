//! What is measured in a sweep.

use std::fmt;

use panoscope_graph::{Catalog, Graph};

use super::{SweepError, part};
use crate::numbers::{self, tells_numbers};
use crate::report::{NodeReport, Report};

/// Counters that every node has, to be measured as `node.p50_ms`.
pub const COUNTERS: [&str; 7] = ["p50_ms", "p99_ms", "max_ms", "count", "dropped", "skipped", "faults"];

fn counter(node: &NodeReport, name: &str) -> Option<f64> {
    Some(match name {
        "p50_ms" => node.p50_ms,
        "p99_ms" => node.p99_ms,
        "max_ms" => node.max_ms,
        "count" => node.count as f64,
        "dropped" => node.dropped as f64,
        "skipped" => node.skipped as f64,
        "faults" => node.faults as f64,
        _ => return None,
    })
}

/// What is measured.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Measure {
    /// Each packet of an output: a scalar, or a column of a table, all rows alike.
    Port {
        /// The node.
        node: String,
        /// Its output.
        port: String,
        /// Type of its packets.
        packet: String,
        /// Of a table.
        column: Option<String>,
    },
    /// A number that the node tells, or a counter, at the end of the run.
    Told {
        /// The node.
        node: String,
        /// The number's name.
        name: String,
    },
}

impl fmt::Display for Measure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Port { node, port, column: Some(column), .. } => write!(f, "{node}.{port}.{column}"),
            Self::Port { node, port: name, .. } | Self::Told { node, name } => write!(f, "{node}.{name}"),
        }
    }
}

impl Measure {
    /// Reads `node.port`, `node.port.column` or `node.name`; answers the node's position, too.
    pub(super) fn of(text: &str, graph: &Graph, catalog: &Catalog) -> Result<(Self, usize), SweepError> {
        let bad = |reason: String| SweepError::Measure { measure: text.to_owned(), reason };
        let words = "write it as NODE.PORT, NODE.PORT.COLUMN or NODE.NUMBER";
        let (id, rest) = text.split_once('.').ok_or_else(|| bad(words.to_owned()))?;
        let node = graph.node(id).ok_or_else(|| bad(part::no_node(graph, id)))?;
        let node_type = graph.nodes[node].node_type(catalog);
        let (port, column) = match rest.split_once('.') {
            Some((port, column)) => (port, Some(column.to_owned())),
            None => (rest, None),
        };
        let told: Vec<&str> =
            node_type.outputs.iter().filter(|p| tells_numbers(&p.packet.name)).map(|p| p.name.as_str()).collect();
        let Some(output) = node_type.output(port) else {
            if column.is_some() {
                let told = part::list(&told);
                return Err(bad(format!("`{id}` has no output `{port}`; its outputs with numbers: {told}")));
            }
            return Ok((Self::Told { node: id.to_owned(), name: port.to_owned() }, node));
        };
        let packet = node_type.outputs[output].packet.name.clone();
        match (packet.as_str(), &column) {
            ("scalar", None) | ("table", Some(_)) => {}
            ("scalar", Some(_)) => return Err(bad("a scalar has no columns".to_owned())),
            ("table", None) => return Err(bad(format!("it is a table: name a column, {id}.{port}.COLUMN"))),
            _ => {
                let told = part::list(&told);
                return Err(bad(format!("it carries {packet}, no numbers; outputs of `{id}` with numbers: {told}")));
            }
        }
        Ok((Self::Port { node: id.to_owned(), port: port.to_owned(), packet, column }, node))
    }

    /// What a run came to.
    pub(super) fn summary(&self, heard: &Heard, report: &Report) -> Result<Summary, String> {
        match self {
            Self::Port { column, .. } => {
                if let (Some(column), Some(others)) = (column, &heard.others) {
                    let others: Vec<&str> = others.iter().map(String::as_str).collect();
                    return Err(format!("there is no column `{column}`; columns are {}", part::list(&others)));
                }
                if heard.values.is_empty() && heard.missing == 0 {
                    return Err("nothing came out of it".to_owned());
                }
                Ok(Summary::of(&heard.values, heard.missing))
            }
            Self::Told { node, name } => {
                let Some(found) = report.nodes.get(node) else { return Err(format!("`{node}` did not run")) };
                let value = found.metrics.get(name).copied().or_else(|| counter(found, name));
                let value = value.ok_or_else(|| {
                    let names = found.metrics.keys().map(String::as_str);
                    let names: Vec<&str> = names.chain(COUNTERS).collect();
                    format!("`{node}` tells no number `{name}`; it tells {}", part::list(&names))
                })?;
                Ok(Summary::of(&[value], 0))
            }
        }
    }
}

/// Values of a port so far.
#[derive(Debug, Default)]
pub(super) struct Heard {
    values: Vec<f64>,
    missing: u64,
    /// Columns of a table that does not have the wanted one.
    others: Option<Vec<String>>,
}

impl Heard {
    /// Takes a packet.
    pub fn take(&mut self, bytes: &[u8], packet: &str, column: Option<&str>) {
        let Some(told) = numbers::read(bytes, packet) else { return };
        let at = match column {
            None => 0,
            Some(wanted) => match told.names.iter().position(|name| name == wanted) {
                Some(at) => at,
                None => {
                    self.others = Some(told.names);
                    return;
                }
            },
        };
        for value in told.rows().filter_map(|row| row.get(at)) {
            if value.is_finite() { self.values.push(*value) } else { self.missing += 1 }
        }
    }
}

/// What many values of a measure came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Finite values.
    pub count: u64,
    /// Values that were not finite: unknown.
    pub missing: u64,
    /// Mean of the finite ones; NaN when there are none, as are the following.
    pub mean: f64,
    /// Half of them are no larger.
    pub median: f64,
    /// The smallest.
    pub min: f64,
    /// The largest.
    pub max: f64,
    /// Standard deviation.
    pub deviation: f64,
}

impl Summary {
    fn of(values: &[f64], missing: u64) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let median = match sorted.len() {
            0 => f64::NAN,
            n if n % 2 == 1 => sorted[n / 2],
            n => f64::midpoint(sorted[n / 2 - 1], sorted[n / 2]),
        };
        Self {
            count: values.len() as u64,
            missing,
            mean,
            median,
            min: sorted.first().copied().unwrap_or(f64::NAN),
            max: sorted.last().copied().unwrap_or(f64::NAN),
            deviation: variance.sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Summary;

    #[test]
    fn a_summary_has_mean_median_and_ends() {
        let s = Summary::of(&[4.0, 1.0, 3.0, 2.0], 1);
        assert_eq!((s.count, s.missing, s.mean, s.median, s.min, s.max), (4, 1, 2.5, 2.5, 1.0, 4.0));
        assert!((s.deviation - 1.25f64.sqrt()).abs() < 1e-12);
        assert!(Summary::of(&[], 3).mean.is_nan());
    }
}
