//! Time budget of a frame: the chain of calls that its sink waited for, from the end of the source's call to the end of
//! the sink's.

use std::collections::HashMap;

use panoscope_engine::text_table::{number, table};
use panoscope_graph::{Align, Graph};

use super::{Call, Calls};

/// Time that one node takes per frame, means over all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Share {
    /// The node.
    pub node: String,
    /// Share of frames whose chain contains it, 0..1.
    pub on_chain: f64,
    /// Mean time from its last input to its start, ms: its thread was busy, or the work was handed to another thread.
    pub wait_ms: f64,
    /// Time of its calls, ms.
    pub work_ms: f64,
}

/// Time budget of a frame at one sink.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// The sink.
    pub sink: String,
    /// Frames that it received.
    pub pictures: usize,
    /// Mean time from the end of the source's call to the end of the sink's, ms; the sum of all shares.
    pub total_ms: f64,
    /// The nodes of the chain, in the order of the graph.
    pub shares: Vec<Share>,
}

/// Sums for a node.
#[derive(Clone, Copy, Default)]
struct Sum {
    pictures: usize,
    wait_ns: u64,
    work_ns: u64,
}

/// The nodes of a graph in its order, each with the nodes that it waits for: the producers of its inputs of the same
/// tick without delay.
#[derive(Clone, Debug, Default)]
pub struct Waits(Vec<(String, Vec<String>)>);

impl Waits {
    /// The nodes of a graph and what they wait for.
    pub fn of(graph: &Graph) -> Self {
        let id = |node: usize| graph.nodes[node].id.clone();
        let producers = |node: usize| {
            let waited_for = graph.inputs_of(node).iter().filter(|edge| edge.align == Align::Exact && edge.delay == 0);
            waited_for.map(|edge| id(edge.from_node)).collect()
        };
        Self(graph.order.iter().map(|&node| (id(node), producers(node))).collect())
    }

    pub(super) fn position(&self, node: &str) -> Option<usize> {
        self.0.iter().position(|(id, _)| id == node)
    }

    /// Names of the nodes, in the order of the graph.
    pub(super) fn names(&self) -> Vec<String> {
        self.0.iter().map(|(id, _)| id.clone()).collect()
    }

    /// For each node the positions of those that it waits for.
    pub(super) fn producers(&self) -> Vec<Vec<usize>> {
        self.0.iter().map(|(_, from)| from.iter().filter_map(|id| self.position(id)).collect()).collect()
    }

    /// Nodes by name, each with those that it waits for.
    #[cfg(test)]
    pub(super) fn between(nodes: &[(&str, &[&str])]) -> Self {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        Self(nodes.iter().map(|(id, from)| ((*id).to_owned(), owned(from))).collect())
    }
}

impl Budget {
    /// The budget of the frames that `sink` received; `None` if the timeline has none of them from the source on.
    pub fn of(calls: &Calls, waits: &Waits, sink: &str) -> Option<Self> {
        Self::mean(sink, waits, &chains(calls, waits, sink))
    }

    /// The budget of the slowest hundredth of the frames that `sink` received, at least one, and what ran while their chains waited; `None` as
    /// for [`Budget::of`].
    pub fn of_slowest(calls: &Calls, waits: &Waits, sink: &str) -> Option<(Self, Vec<Beside>)> {
        let mut chains = chains(calls, waits, sink);
        chains.sort_by_key(|chain| std::cmp::Reverse(chain.time_ns));
        chains.truncate(chains.len().div_ceil(100));
        Some((Self::mean(sink, waits, &chains)?, Beside::of(calls, &chains)))
    }

    /// Means over some frames.
    fn mean(sink: &str, waits: &Waits, chains: &[Chain]) -> Option<Self> {
        let pictures = chains.len();
        if pictures == 0 {
            return None;
        }
        let mut sums = vec![Sum::default(); waits.0.len()];
        for Step { node, wait_ns, work_ns, .. } in chains.iter().flat_map(|chain| &chain.steps) {
            let sum = &mut sums[*node];
            *sum = Sum { pictures: sum.pictures + 1, wait_ns: sum.wait_ns + wait_ns, work_ns: sum.work_ns + work_ns };
        }
        let ms = |ns: u64| ns as f64 / 1e6 / pictures as f64;
        let shares = waits.0.iter().zip(&sums).filter(|(_, sum)| sum.pictures > 0).map(|((node, _), sum)| Share {
            node: node.clone(),
            on_chain: sum.pictures as f64 / pictures as f64,
            wait_ms: ms(sum.wait_ns),
            work_ms: ms(sum.work_ns),
        });
        let total_ms = ms(chains.iter().map(|chain| chain.time_ns).sum());
        Some(Self { sink: sink.to_owned(), pictures, total_ms, shares: shares.collect() })
    }

    /// The budget as a table.
    pub fn text(&self) -> String {
        let mut rows = vec![["node", "on the chain %", "wait ms", "work ms"].map(str::to_owned).to_vec()];
        for share in &self.shares {
            let (wait, work) = (number(share.wait_ms, 2), number(share.work_ms, 2));
            rows.push(vec![share.node.clone(), number(100.0 * share.on_chain, 0), wait, work]);
        }
        let sum = |part: fn(&Share) -> f64| number(self.shares.iter().map(part).sum(), 2);
        rows.push(vec!["all".to_owned(), String::new(), sum(|s| s.wait_ms), sum(|s| s.work_ms)]);
        table(&rows)
    }
}

/// Calls of one node that ran while chains of calls waited.
#[derive(Clone, Debug, PartialEq)]
pub struct Beside {
    /// The node.
    pub node: String,
    /// Time of its calls within the waits, ms, mean over the frames of the chains.
    pub ms: f64,
}

impl Beside {
    /// All nodes with calls within the waits of these chains, the longest first.
    fn of(calls: &Calls, chains: &[Chain]) -> Vec<Self> {
        let mut ns = vec![0_u64; calls.nodes.len()];
        for step in chains.iter().flat_map(|chain| &chain.steps) {
            for call in &calls.calls {
                let (start, end) = (call.start_ns.max(step.start_ns - step.wait_ns), call.end_ns.min(step.start_ns));
                ns[call.node as usize] += end.saturating_sub(start);
            }
        }
        let named = calls.nodes.iter().zip(&ns).filter(|(_, ns)| **ns > 0);
        let mut all: Vec<Self> = named
            .map(|(node, ns)| Self { node: node.to_string(), ms: *ns as f64 / 1e6 / chains.len() as f64 })
            .collect();
        all.sort_by(|a, b| b.ms.total_cmp(&a.ms));
        all
    }

    /// As a table.
    pub fn text(all: &[Self]) -> String {
        let mut rows = vec![["node", "beside waits ms"].map(str::to_owned).to_vec()];
        rows.extend(all.iter().map(|beside| vec![beside.node.clone(), number(beside.ms, 2)]));
        table(&rows)
    }
}

/// The chain of calls that one frame waited for.
struct Chain {
    /// From the sink back to the call after the source's.
    steps: Vec<Step>,
    /// Sum of all steps.
    time_ns: u64,
}

/// The chains of the frames that `sink` received.
fn chains(calls: &Calls, waits: &Waits, sink: &str) -> Vec<Chain> {
    let positions: Vec<Option<usize>> = calls.nodes.iter().map(|node| waits.position(node)).collect();
    let producers = waits.producers();
    let mut by_tick: HashMap<(u32, u64), HashMap<usize, Call>> = HashMap::new();
    for call in calls.calls.iter().filter(|call| call.made) {
        if let Some(node) = positions[call.node as usize] {
            by_tick.entry((call.source, call.seq)).or_default().insert(node, *call);
        }
    }
    let Some(sink_at) = waits.position(sink) else { return Vec::new() };
    by_tick.values().filter_map(|of_tick| chain(of_tick, &producers, sink_at)).collect()
}

/// A call of the chain.
struct Step {
    node: usize,
    start_ns: u64,
    wait_ns: u64,
    work_ns: u64,
}

/// The chain of a frame at `sink`; `None` if the timeline does not have all of it.
fn chain(of_tick: &HashMap<usize, Call>, producers: &[Vec<usize>], sink: usize) -> Option<Chain> {
    let (mut node, mut steps) = (sink, Vec::new());
    let end_ns = of_tick.get(&sink)?.end_ns;
    loop {
        let call = of_tick.get(&node)?;
        let ends = producers[node].iter().filter_map(|from| Some((*from, of_tick.get(from)?.end_ns)));
        let last = ends.filter(|(_, end)| *end <= call.start_ns).max_by_key(|(_, end)| *end);
        let Some((before, ready_ns)) = last else {
            // The source: its call waits for light and is not counted. A node whose producers are no longer in the timeline is none.
            let time_ns = end_ns - call.end_ns;
            return (node != sink && producers[node].is_empty()).then_some(Chain { steps, time_ns });
        };
        let (wait_ns, work_ns) = (call.start_ns - ready_ns, call.end_ns - call.start_ns);
        steps.push(Step { node, start_ns: call.start_ns, wait_ns, work_ns });
        node = before;
    }
}

/// Two tables: MB that each node read and made per frame, and the time of each thread in calls.
pub fn work_tables(calls: &Calls, pictures: u64) -> [String; 2] {
    let per_picture = 1e6 * pictures.max(1) as f64;
    let mut bytes = vec![(0_u64, 0_u64, 0_u64); calls.nodes.len()];
    let mut busy_ns = vec![0_u64; calls.threads.len()];
    for call in calls.calls.iter().filter(|call| call.made) {
        let node = &mut bytes[call.node as usize];
        *node = (node.0 + call.read_bytes, node.1 + call.made_bytes, node.2 + call.end_ns - call.start_ns);
        busy_ns[call.thread as usize] += call.end_ns - call.start_ns;
    }
    let mut moved = vec![["node", "read MB", "made MB", "GB/s"].map(str::to_owned).to_vec()];
    let mut order: Vec<usize> = (0..bytes.len()).collect();
    order.sort_by_key(|node| std::cmp::Reverse(bytes[*node].0 + bytes[*node].1));
    for node in order {
        let (read, made, ns) = bytes[node];
        let rate = (read + made) as f64 / ns as f64;
        let [read, made] = [read, made].map(|bytes| number(bytes as f64 / per_picture, 2));
        moved.push(vec![calls.nodes[node].to_string(), read, made, number(rate, 2)]);
    }
    let begin = calls.calls.iter().map(|call| call.start_ns).min().unwrap_or(0);
    let end = calls.calls.iter().map(|call| call.end_ns).max().unwrap_or(0);
    let mut threads = vec![["thread", "in calls %"].map(str::to_owned).to_vec()];
    for (name, ns) in calls.threads.iter().zip(&busy_ns) {
        threads.push(vec![name.clone(), number(100.0 * *ns as f64 / (end - begin) as f64, 1)]);
    }
    [table(&moved), table(&threads)]
}

#[cfg(test)]
mod tests {
    use super::super::Timeline;
    use super::super::tests::enter;
    use super::*;

    fn waits() -> Waits {
        let node = |id: &str, from: &[&str]| (id.to_owned(), from.iter().map(|id| (*id).to_owned()).collect());
        Waits(vec![
            node("camera", &[]),
            node("slow", &["camera"]),
            node("fast", &["camera"]),
            node("sink", &["slow", "fast"]),
        ])
    }

    #[test]
    fn the_chain_goes_through_what_was_waited_for() {
        let timeline = Timeline::default();
        for (seq, begin) in [(0, 0), (1, 100)] {
            enter(&timeline, "camera", seq, begin, begin + 10);
            enter(&timeline, "slow", seq, begin + 11, begin + 20);
            enter(&timeline, "fast", seq, begin + 11, begin + 12);
            enter(&timeline, "sink", seq, begin + 23, begin + 25);
        }
        // Not through yet: it does not count.
        enter(&timeline, "camera", 2, 200, 210);
        let budget = Budget::of(&timeline.snapshot(), &waits(), "sink").expect("two pictures");
        assert_eq!((budget.pictures, budget.total_ms), (2, 15.0), "from the camera's end to the sink's");
        let share =
            |node: &str, wait_ms: f64, work_ms: f64| Share { node: node.to_owned(), on_chain: 1.0, wait_ms, work_ms };
        assert_eq!(budget.shares, [share("slow", 1.0, 9.0), share("sink", 3.0, 2.0)], "`fast` was not waited for");
        let sum: f64 = budget.shares.iter().map(|share| share.wait_ms + share.work_ms).sum();
        assert_eq!(sum, budget.total_ms);
        assert!(
            budget.text().lines().last().is_some_and(|all| all.contains("4.00") && all.contains("11.00")),
            "{}",
            budget.text()
        );
    }

    #[test]
    fn the_slowest_hundredth_names_what_ran_while_it_waited() {
        let timeline = Timeline::default();
        for (seq, begin) in (0..101).map(|seq| (seq, seq * 100)) {
            // Two of 101 are slow: the sink waits while another node works.
            let late = if seq == 7 || seq == 50 { 20 } else { 1 };
            enter(&timeline, "camera", seq, begin, begin + 10);
            if late == 20 {
                enter(&timeline, "other", 1000 + seq, begin + 15, begin + 40);
            }
            enter(&timeline, "sink", seq, begin + 10 + late, begin + 15 + late);
        }
        let waits = Waits::between(&[("camera", &[]), ("sink", &["camera"]), ("other", &[])]);
        let (budget, beside) = Budget::of_slowest(&timeline.snapshot(), &waits, "sink").expect("pictures");
        assert_eq!((budget.pictures, budget.total_ms), (2, 25.0));
        assert_eq!(beside, [Beside { node: "other".to_owned(), ms: 15.0 }]);
    }

    #[test]
    fn without_a_picture_there_is_no_budget() {
        let timeline = Timeline::default();
        enter(&timeline, "slow", 0, 11, 20);
        enter(&timeline, "sink", 0, 23, 25);
        assert_eq!(Budget::of(&timeline.snapshot(), &waits(), "sink"), None, "its source is not in the timeline");
        assert_eq!(Budget::of(&timeline.snapshot(), &waits(), "other"), None, "no such node");
    }

    #[test]
    fn tables_show_bytes_and_threads() {
        let timeline = Timeline::default();
        enter(&timeline, "camera", 0, 0, 10);
        enter(&timeline, "sink", 0, 15, 20);
        let [moved, threads] = work_tables(&timeline.snapshot(), 1);
        assert!(moved.contains("camera"), "{moved}");
        assert!(threads.contains("75.0"), "15 of 20 ms: {threads}");
    }
}
