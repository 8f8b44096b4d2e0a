//! Measures of a sweep.

use std::fmt;

use panoscope_graph::{Catalog, Graph};

use super::error::{RowError, SweepError};
use super::part;
use panoscope_base::packet::{Numbers, has_numbers};
use panoscope_engine::{NodeReport, Report};

/// Counters of every node, measured as `node.p50_ms`.
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

/// Measured rows of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rows {
    /// The only row; a table with more is refused.
    Only,
    /// This row, from 1.
    Nth(usize),
    /// All rows, as values of the same measure.
    All,
}

/// A measure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Measure {
    /// Each packet of an output: a scalar, or a column of a table.
    Port {
        /// Name of the node.
        node: String,
        /// Its output.
        port: String,
        /// Type of its packets.
        packet: String,
        /// Column, if it is a table.
        column: Option<String>,
        /// Rows, if it is a table.
        rows: Rows,
    },
    /// A metric of the node in each tick, or a counter at the end of the run.
    Number {
        /// Name of the node.
        node: String,
        /// The number's name.
        name: String,
    },
}

impl fmt::Display for Measure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Port { node, port, column: Some(column), rows, .. } => match rows {
                Rows::Only => write!(f, "{node}.{port}.{column}"),
                Rows::Nth(row) => write!(f, "{node}.{port}.{column}[{row}]"),
                Rows::All => write!(f, "{node}.{port}.{column}[*]"),
            },
            Self::Port { node, port: name, .. } | Self::Number { node, name } => write!(f, "{node}.{name}"),
        }
    }
}

impl Measure {
    /// Reads `node.port`, `node.port.column` or `node.name`; also returns the position of the node.
    pub(super) fn of(text: &str, graph: &Graph, catalog: &Catalog) -> Result<(Self, usize), SweepError> {
        let bad = |reason: String| SweepError::Measure { measure: text.to_owned(), reason };
        let words = "write it as NODE.PORT, NODE.PORT.COLUMN or NODE.NUMBER";
        let (id, rest) = text.split_once('.').ok_or_else(|| bad(words.to_owned()))?;
        let node = graph.node(id).ok_or_else(|| bad(part::no_node(graph, id)))?;
        let node_type = graph.nodes[node].node_type(catalog);
        let (port, column, rows) = match rest.split_once('.') {
            Some((port, column)) => {
                let (column, rows) = rows_of(column).map_err(|error| bad(error.to_string()))?;
                (port, Some(column.to_owned()), rows)
            }
            None => (rest, None, Rows::Only),
        };
        let outputs: Vec<&str> =
            node_type.outputs.iter().filter(|p| has_numbers(&p.packet.name)).map(|p| p.name.as_str()).collect();
        let Some(output) = node_type.output(port) else {
            if column.is_some() {
                let outputs = part::list(&outputs);
                return Err(bad(format!("`{id}` has no output `{port}`; its outputs with numbers: {outputs}")));
            }
            return Ok((Self::Number { node: id.to_owned(), name: port.to_owned() }, node));
        };
        let packet = node_type.outputs[output].packet.name.clone();
        match (packet.as_str(), &column) {
            ("scalar", None) | ("table", Some(_)) => {}
            ("scalar", Some(_)) => return Err(bad("a scalar has no columns".to_owned())),
            ("table", None) => return Err(bad(format!("it is a table: name a column, {id}.{port}.COLUMN"))),
            _ => {
                let outputs = part::list(&outputs);
                return Err(bad(format!(
                    "its packets are {packet}, without numbers; outputs of `{id}` with numbers: {outputs}"
                )));
            }
        }
        Ok((Self::Port { node: id.to_owned(), port: port.to_owned(), packet, column, rows }, node))
    }

    /// The reason, if the received packets show that the measure does not exist at any value.
    pub(super) fn wrong(&self, received: &Received) -> Option<String> {
        let Self::Port { column: Some(column), rows, .. } = self else { return None };
        if let Some(others) = &received.others {
            let others: Vec<&str> = others.iter().map(String::as_str).collect();
            return Some(format!("there is no column `{column}`; columns are {}", part::list(&others)));
        }
        (*rows == Rows::Only && received.max_rows > 1).then(|| {
            format!(
                "the table has {} rows, which may be different measures: name one, {self}[1] to {self}[{}], or take all as one with {self}[*]",
                received.max_rows, received.max_rows
            )
        })
    }

    /// Statistics of a run.
    pub(super) fn summary(&self, received: &Received, report: &Report) -> Result<Summary, NoSummary> {
        if let Some(reason) = self.wrong(received) {
            return Err(NoSummary::Measure(reason));
        }
        match self {
            Self::Port { rows, .. } => {
                if let Rows::Nth(row) = rows
                    && received.max_rows > 0
                    && *row > received.max_rows
                {
                    let most = received.max_rows;
                    return Err(NoSummary::Run(format!("there is no row {row}: the table has up to {most}")));
                }
                if received.values.is_empty() && received.missing == 0 {
                    return Err(NoSummary::Run("it returned no packets".to_owned()));
                }
                Ok(Summary::of(&received.values, received.missing))
            }
            Self::Number { node, name } => {
                let ran = |node: &str| NoSummary::Run(format!("`{node}` did not run"));
                let found = report.nodes.get(node).ok_or_else(|| ran(node))?;
                if !received.numbers.is_empty() {
                    let (finite, unknown): (Vec<f64>, Vec<f64>) =
                        received.numbers.iter().map(|(_, v)| *v).partition(|v| v.is_finite());
                    return Ok(Summary::of(&finite, unknown.len() as u64));
                }
                if found.count == 0 && found.metrics.is_empty() && !COUNTERS.contains(&name.as_str()) {
                    return Err(ran(node));
                }
                let value = counter(found, name).ok_or_else(|| {
                    let names = found.metrics.keys().map(String::as_str);
                    let names: Vec<&str> = names.chain(COUNTERS).collect();
                    NoSummary::Measure(format!(
                        "`{node}` reports no number `{name}`; it reports {}",
                        part::list(&names)
                    ))
                })?;
                Ok(Summary::of(&[value], 0))
            }
        }
    }
}

/// A run without statistics.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum NoSummary {
    /// The measure does not exist, whatever the value.
    Measure(String),
    /// The run failed.
    Run(String),
}

/// Parses a column and its rows: `x_mm`, `x_mm[2]`, `x_mm[*]`.
fn rows_of(column: &str) -> Result<(&str, Rows), RowError> {
    let Some((name, index)) = column.strip_suffix(']').and_then(|c| c.rsplit_once('[')) else {
        return Ok((column, Rows::Only));
    };
    match (index, index.parse::<usize>()) {
        ("*", _) => Ok((name, Rows::All)),
        (_, Ok(row)) if row > 0 => Ok((name, Rows::Nth(row))),
        _ => Err(RowError { column: name.to_owned(), index: index.to_owned() }),
    }
}

/// Received values of a measure.
#[derive(Debug, Default)]
pub(super) struct Received {
    values: Vec<f64>,
    missing: u64,
    /// Columns of a table without the requested one.
    others: Option<Vec<String>>,
    /// Maximum number of rows of a table.
    max_rows: usize,
    /// Numbers that the node reported: tick and value.
    numbers: Vec<((u32, u64), f64)>,
}

impl Received {
    /// Adds a packet.
    pub fn take(&mut self, bytes: &[u8], packet: &str, column: Option<&str>, rows: Rows) {
        let Ok(Some(numbers)) = Numbers::read(bytes, packet) else { return };
        let at = match column {
            None => 0,
            Some(wanted) => match numbers.names.iter().position(|name| name == wanted) {
                Some(at) => at,
                None => {
                    self.others = Some(numbers.names);
                    return;
                }
            },
        };
        let count = numbers.rows().count();
        self.max_rows = self.max_rows.max(count);
        let wanted = |index: usize| match rows {
            Rows::Nth(row) => index + 1 == row,
            Rows::Only | Rows::All => true,
        };
        let values = numbers.rows().enumerate().filter(|(index, _)| wanted(*index)).filter_map(|(_, row)| row.get(at));
        for value in values {
            if value.is_finite() { self.values.push(*value) } else { self.missing += 1 }
        }
        if matches!(rows, Rows::Nth(row) if row > count) {
            self.missing += 1;
        }
    }

    /// Adds a metric of the node; the last one of a tick counts.
    pub fn take_number(&mut self, tick: (u32, u64), value: f64) {
        match self.numbers.last_mut() {
            Some((last, slot)) if *last == tick => *slot = value,
            _ => self.numbers.push((tick, value)),
        }
    }
}

/// Statistics of the values of a measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Number of finite values.
    pub count: u64,
    /// Number of values that were not finite.
    pub missing: u64,
    /// Failed calls of any node in the run; their ticks lack its outputs or are not measured.
    pub failed_calls: u64,
    /// Mean of the finite values; NaN if there are none, like the following.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// Minimum.
    pub min: f64,
    /// Maximum.
    pub max: f64,
    /// Standard deviation.
    pub deviation: f64,
    /// The last value, for measures that count from the start.
    pub last: f64,
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
            failed_calls: 0,
            mean,
            median,
            min: sorted.first().copied().unwrap_or(f64::NAN),
            max: sorted.last().copied().unwrap_or(f64::NAN),
            deviation: variance.sqrt(),
            last: values.last().copied().unwrap_or(f64::NAN),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Measure, Received, Rows, Summary, rows_of};

    fn table(rows: &[[f64; 2]]) -> Vec<u8> {
        let mut bytes: Vec<u8> = [rows.len() as u32, 2, 8, 0].iter().flat_map(|n| n.to_le_bytes()).collect();
        bytes.extend(b"mm\nerr\0\0");
        rows.iter().flatten().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes
    }

    fn received(rows: Rows, packets: &[&[[f64; 2]]]) -> Received {
        let mut received = Received::default();
        packets.iter().for_each(|packet| received.take(&table(packet), "table", Some("mm"), rows));
        received
    }

    #[test]
    fn rows_of_several_measures_are_not_pooled() {
        let of = |rows| Measure::Port {
            node: "measure".to_owned(),
            port: "table".to_owned(),
            packet: "table".to_owned(),
            column: Some("mm".to_owned()),
            rows,
        };
        let two: [&[[f64; 2]]; 2] = [&[[10.0, 0.1], [70.0, 0.2]], &[[12.0, 0.1], [72.0, 0.2]]];
        let wrong = of(Rows::Only).wrong(&received(Rows::Only, &two)).expect("two measures are no one");
        assert!(wrong.contains("measure.table.mm[1] to measure.table.mm[2]"), "{wrong}");
        assert!(of(Rows::Only).wrong(&received(Rows::Only, &[&[[10.0, 0.1]], &[]])).is_none());
        assert_eq!(received(Rows::Nth(2), &two).values, [70.0, 72.0]);
        assert_eq!(received(Rows::All, &two).values, [10.0, 70.0, 12.0, 72.0]);
        let short = received(Rows::Nth(2), &[&[[10.0, 0.1]], &[[1.0, 0.1], [2.0, 0.1]]]);
        assert_eq!((short.values, short.missing), (vec![2.0], 1));
        assert_eq!(rows_of("mm[3]"), Ok(("mm", Rows::Nth(3))));
        assert_eq!(rows_of("mm[*]"), Ok(("mm", Rows::All)));
        assert!(rows_of("mm[0]").is_err() && rows_of("mm[last]").is_err());
        assert_eq!(of(Rows::All).to_string(), "measure.table.mm[*]");
    }

    #[test]
    fn a_number_reported_twice_in_a_tick_counts_once() {
        let mut received = Received::default();
        for (tick, value) in [((0, 1), 5.0), ((0, 1), 6.0), ((0, 2), 7.0)] {
            received.take_number(tick, value);
        }
        assert_eq!(received.numbers, [((0, 1), 6.0), ((0, 2), 7.0)]);
    }

    #[test]
    fn a_summary_has_mean_median_and_ends() {
        let s = Summary::of(&[4.0, 1.0, 3.0, 2.0], 1);
        assert_eq!((s.count, s.missing, s.mean, s.median, s.min, s.max), (4, 1, 2.5, 2.5, 1.0, 4.0));
        assert!((s.deviation - 1.25f64.sqrt()).abs() < 1e-12);
        assert!(Summary::of(&[], 3).mean.is_nan());
    }
}
