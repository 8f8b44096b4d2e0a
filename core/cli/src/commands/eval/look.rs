//! Running a graph made as text, and reading what its nodes put out.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use panoscope_base::packet;
use panoscope_engine::memory::FrameRef;
use panoscope_engine::{Engine, Listener, NumberListener, Options, Outcome, Preview, Report};
use panoscope_graph::GraphText;

use crate::{allocations, graph_file};

/// A packet of type `table`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Column names with their units.
    pub names: Vec<String>,
    /// Rows of as many numbers.
    pub rows: Vec<Vec<f64>>,
}

impl Table {
    /// Reads a packet; `None` when it is no whole table.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let table = packet::Table::parse(bytes).ok()?;
        let values: Vec<f64> = table.values().collect();
        let rows = values.chunks_exact(table.columns().max(1)).map(<[f64]>::to_vec).collect();
        Some(Self { names: table.names().map(str::to_owned).collect(), rows })
    }

    /// All values of a column.
    pub fn column(&self, name: &str) -> Option<Vec<f64>> {
        let index = self.names.iter().position(|n| n == name)?;
        Some(self.rows.iter().map(|row| row[index]).collect())
    }
}

/// How a graph is run.
pub struct Plan<'a> {
    /// The graph.
    pub text: &'a str,
    /// What messages call it; its folder is what paths start from.
    pub path: &'a Path,
    /// Ticks of each source.
    pub frames: Option<u64>,
    /// Threads of the pool; 0: one per core.
    pub threads: usize,
    /// Node and output whose newest packet is wanted at the end.
    pub ports: &'a [(&'a str, &'a str)],
    /// When ticks begin.
    pub pace: Pace,
}

/// When a tick begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// At the capture time of its frame.
    Camera,
    /// As soon as the graph takes it; ticks overlap.
    Free,
    /// When the one before it has ended: nothing but the node is at work while it is timed.
    Alone,
}

/// What a run left behind.
pub struct Seen {
    /// The newest packet of each port asked for; none when there was none.
    pub packets: Vec<Option<FrameRef>>,
    /// Counters of the engine.
    pub report: Report,
}

/// Runs the graph to its end; without a number of frames until each port has shown a packet.
pub fn run(plan: &Plan<'_>) -> Result<Seen> {
    run_and_listen(plan, Vec::new(), None)
}

/// As [`run`], with ports whose every packet is heard, and a node whose told numbers are.
pub fn run_and_listen(plan: &Plan<'_>, listen: Vec<Listener>, numbers: Option<NumberListener>) -> Result<Seen> {
    let text = GraphText::parse(plan.path, plan.text);
    let ready = match graph_file::ready(&text) {
        Ok(ready) => ready,
        Err(diagnostics) => bail!("{}", diagnostics.render(false).trim_end()),
    };
    let options = Options {
        threads: plan.threads,
        frames: plan.frames,
        paced: plan.pace == Pace::Camera,
        ticks_at_once: (plan.pace == Pace::Alone).then_some(1),
        listen,
        numbers,
        graph_dir: plan.path.parent().unwrap_or(Path::new("")).to_owned(),
        process_allocations: allocations::process(),
        thread_allocations: allocations::thread(),
        ..Options::default()
    };
    let engine = Engine::start(ready.graph, &ready.catalog, &ready.loader, options)?;
    let previews: Vec<Preview> = plan
        .ports
        .iter()
        .map(|(node, port)| engine.preview(node, port).with_context(|| format!("there is no output {node}.{port}")))
        .collect::<Result<_>>()?;
    let mut packets: Vec<Option<FrameRef>> = plan.ports.iter().map(|_| None).collect();
    loop {
        let ended = engine.wait(Some(Duration::from_millis(10)));
        for (packet, preview) in packets.iter_mut().zip(&previews) {
            if let Some(newer) = preview.take() {
                *packet = Some(newer);
            }
        }
        if ended || (plan.frames.is_none() && packets.iter().all(Option::is_some)) {
            break;
        }
        if crate::interrupt::asked() {
            bail!("interrupted");
        }
    }
    let outcome = engine.close(Duration::from_secs(10));
    if let Outcome::Failed(reason) = outcome {
        bail!("{reason}");
    }
    let report = engine.report();
    if let Some((node, _)) = report.nodes.iter().find(|(_, n)| n.faults > 0 && n.faults >= n.count) {
        let words = engine.recent_log().into_iter().rev().find(|(_, id, _)| id == node);
        bail!("node `{node}` failed: {}", words.map_or_else(String::new, |(_, _, words)| words));
    }
    Ok(Seen { packets, report })
}

#[cfg(test)]
mod tests {
    use super::Table;

    #[test]
    fn tables_are_read_as_nodes_write_them() {
        let mut bytes = Vec::new();
        for word in [2u32, 2, 8, 0] {
            bytes.extend(word.to_ne_bytes());
        }
        bytes.extend(b"a\nb_px\0\0");
        for number in [1.0f64, 2.0, 3.0, 4.5] {
            bytes.extend(number.to_ne_bytes());
        }
        let table = Table::read(&bytes).unwrap();
        assert_eq!(table.column("b_px"), Some(vec![2.0, 4.5]));
        assert_eq!(table.column("c"), None);
        assert_eq!(Table::read(&bytes[..bytes.len() - 1]), None, "cut off");
    }
}
