//! The paths of ticks through the running graph: when each node began and ended, what it waited for, and why a tick was dropped.

use std::collections::HashMap;
use std::sync::Arc;

use panoscope_engine::trace::{self, Tracer};
use panoscope_record::timeline::{Call, Calls, Dropped, Timeline};

use crate::graph_view::GraphView;

/// Number of calls that are remembered.
const CALLS: usize = 16_384;
/// Number of dropped ticks that are remembered.
const DROPS: usize = 256;
/// Number of late ticks that are listed.
const LATE: usize = 12;
/// Number of dropped ticks that are listed.
const LISTED_DROPS: usize = 12;

/// Remembers the newest calls of all nodes.
pub struct Trace(Timeline);

impl Default for Trace {
    fn default() -> Self {
        Self(Timeline::with_room(CALLS, DROPS))
    }
}

impl Tracer for Trace {
    fn call(&self, call: &trace::Call<'_>) {
        self.0.call(call);
    }

    fn dropped(&self, node: &str, seq: u64, at_ns: u64) {
        self.0.dropped(node, seq, at_ns);
    }
}

/// A tick whose path can be shown.
#[derive(Clone, Debug, PartialEq)]
pub struct TickEntry {
    /// The source that made it.
    pub source: String,
    /// Its number.
    pub seq: u64,
    /// Time from the end of the source's call until the last node was done, ms.
    pub total_ms: f64,
    /// For a dropped tick: which tick was in its place, and what it was at.
    pub dropped: Option<DropReason>,
}

/// Why a tick was dropped.
#[derive(Clone, Debug, PartialEq)]
pub struct DropReason {
    /// Number of the tick that was under way.
    pub behind: u64,
    /// The nodes that were at work on it.
    pub at: Vec<String>,
}

/// One call on the path of a tick. Times count from the end of the source's call, ms.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// The node.
    pub node: String,
    /// When all its inputs of this tick were there.
    pub ready_ms: f64,
    /// When it began.
    pub start_ms: f64,
    /// When it ended.
    pub end_ms: f64,
    /// The node whose output came last.
    pub after: Option<String>,
    /// Whether it made outputs; it was skipped or failed otherwise.
    pub made: bool,
}

impl Step {
    /// Time that it worked, ms.
    pub fn work_ms(&self) -> f64 {
        self.end_ms - self.start_ms
    }

    /// Time that it waited after its inputs were there, ms: its thread was busy with something else.
    pub fn wait_ms(&self) -> f64 {
        (self.start_ms - self.ready_ms).max(0.0)
    }
}

/// The path of one tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path {
    /// The source.
    pub source: String,
    /// Number of the tick.
    pub seq: u64,
    /// All calls, by their start.
    pub steps: Vec<Step>,
}

/// A wait that is shorter than this share of the longest work is not mentioned.
const NOTABLE_WAIT: f64 = 0.1;

impl Path {
    /// The step with the longest work, and the one with the longest wait if it is worth a word.
    pub fn longest(&self) -> Option<String> {
        let work = self.steps.iter().max_by(|a, b| a.work_ms().total_cmp(&b.work_ms()))?;
        let wait = self.steps.iter().max_by(|a, b| a.wait_ms().total_cmp(&b.wait_ms()))?;
        let mut words = format!("`{}` worked longest: {:.1} ms", work.node, work.work_ms());
        if wait.wait_ms() > work.work_ms() * NOTABLE_WAIT {
            words += &format!("; `{}` waited longest: {:.1} ms for its turn", wait.node, wait.wait_ms());
        }
        Some(words)
    }
}

fn ms(from_ns: u64, to_ns: u64) -> f64 {
    (to_ns as f64 - from_ns as f64) / 1e6
}

/// The calls of each tick, by source slot and number.
fn by_tick(calls: &[Call]) -> HashMap<(u32, u64), Vec<Call>> {
    let mut ticks: HashMap<(u32, u64), Vec<Call>> = HashMap::new();
    for call in calls {
        ticks.entry((call.source, call.seq)).or_default().push(*call);
    }
    // Without the call of its source a tick is not whole.
    for calls in ticks.values_mut() {
        calls.sort_by_key(|call| call.start_ns);
    }
    ticks
}

impl Trace {
    fn copy(&self) -> (Vec<Call>, Vec<Dropped>, Vec<Arc<str>>) {
        let Calls { calls, drops, nodes, .. } = self.0.snapshot();
        (calls.into(), drops.into(), nodes)
    }

    /// The newest dropped ticks, then the latest of the remembered ones: those that took longest from the end of the source's call.
    pub fn notable(&self, view: &GraphView) -> Vec<TickEntry> {
        let (calls, drops, names) = self.copy();
        let ticks = by_tick(&calls);
        let is_source = |node: u32| is_source(view, &names[node as usize]);
        let mut late: Vec<(f64, u32, u64)> = ticks
            .values()
            .filter_map(|calls| {
                let first = calls.first().filter(|first| is_source(first.node))?;
                let end_ns = calls.iter().map(|call| call.end_ns).max()?;
                Some((ms(first.end_ns, end_ns), first.node, first.seq))
            })
            .collect();
        late.sort_by(|a, b| b.0.total_cmp(&a.0));
        let dropped = drops.iter().rev().take(LISTED_DROPS).filter_map(|drop| {
            let (behind, at) = in_place_of(drop, &ticks)?;
            let mut at: Vec<String> = at.into_iter().map(|node| names[node as usize].to_string()).collect();
            at.dedup();
            let source = names[drop.node as usize].to_string();
            Some(TickEntry { source, seq: drop.seq, total_ms: 0.0, dropped: Some(DropReason { behind, at }) })
        });
        let late = late.into_iter().take(LATE).map(|(total_ms, node, seq)| TickEntry {
            source: names[node as usize].to_string(),
            seq,
            total_ms,
            dropped: None,
        });
        dropped.chain(late).collect()
    }

    /// The path of a tick; for a dropped one, of the tick that was in its place. `None` when it is not remembered any more.
    pub fn path(&self, view: &GraphView, entry: &TickEntry) -> Option<Path> {
        let (calls, _, names) = self.copy();
        let seq = entry.dropped.as_ref().map_or(entry.seq, |reason| reason.behind);
        let of_source = |call: &&Call| *names[call.node as usize] == *entry.source && call.seq == seq;
        let source = calls.iter().rev().find(of_source)?;
        let mut of_tick: Vec<Call> =
            calls.iter().filter(|call| (call.source, call.seq) == (source.source, seq)).copied().collect();
        of_tick.sort_by_key(|call| call.start_ns);
        let flat = view.flat();
        let ends: HashMap<&str, u64> = of_tick.iter().map(|call| (&*names[call.node as usize], call.end_ns)).collect();
        let steps = of_tick.iter().map(|call| {
            let node = &*names[call.node as usize];
            let producers = flat.node(node).into_iter().flat_map(|index| {
                let into = flat.wires.iter().filter(move |wire| wire.to == index && !wire.delayed);
                into.map(|wire| flat.nodes[wire.from].id())
            });
            let last =
                producers.filter_map(|id| Some((*ends.get(id)?, id))).filter(|(end, _)| *end <= call.start_ns).max();
            let is_first = node == &*entry.source;
            Step {
                node: node.to_owned(),
                ready_ms: ms(source.end_ns, last.map_or(call.start_ns, |(end_ns, _)| end_ns)),
                start_ms: ms(source.end_ns, call.start_ns),
                end_ms: ms(source.end_ns, call.end_ns),
                after: last.filter(|_| !is_first).map(|(_, id)| id.to_owned()),
                made: call.made,
            }
        });
        Some(Path { source: entry.source.clone(), seq, steps: steps.collect() })
    }
}

fn is_source(view: &GraphView, id: &str) -> bool {
    let flat = view.flat();
    flat.node(id).is_some_and(|n| flat.nodes[n].node_type.as_ref().is_some_and(|t| t.source))
}

/// The tick of the same source that was under way when one was dropped, and the nodes that were at work on it.
fn in_place_of(drop: &Dropped, ticks: &HashMap<(u32, u64), Vec<Call>>) -> Option<(u64, Vec<u32>)> {
    let of_source = ticks.iter().filter_map(|((_, seq), calls)| {
        let first = calls.first().filter(|first| first.node == drop.node && *seq < drop.seq)?;
        let end_ns = calls.iter().map(|call| call.end_ns).max()?;
        // It had left the source, and was not done.
        (calls.len() > 1 && first.end_ns <= drop.at_ns && end_ns >= drop.at_ns).then_some((*seq, calls))
    });
    let (seq, calls) = of_source.max_by_key(|(seq, _)| *seq)?;
    let at = calls.iter().filter(|call| call.start_ns <= drop.at_ns && drop.at_ns <= call.end_ns);
    let mut at: Vec<u32> = at.map(|call| call.node).collect();
    if at.is_empty() {
        // Between two nodes: the one that came next.
        at.extend(calls.iter().find(|call| call.start_ns > drop.at_ns).map(|call| call.node));
    }
    Some((seq, at))
}

#[cfg(test)]
mod tests {
    use panoscope_abi::Tick;
    use panoscope_graph::{NodeOutline, NodeType};

    use super::*;
    use crate::graph_view::{NodeView, Wire};

    fn view() -> GraphView {
        let node = |id: &str, source: bool| NodeView {
            outline: NodeOutline {
                id: id.to_owned(),
                type_name: String::new(),
                inputs: Vec::new(),
                params: toml::Table::new(),
                line: 1,
            },
            node_type: Some(Arc::new(NodeType { source, ..NodeType::default() })),
            position: None,
            mistakes: Vec::new(),
            is_part: false,
        };
        let wire = |from: usize, to: usize| Wire {
            from,
            output: "image".to_owned(),
            to,
            input: "image".to_owned(),
            index: 0,
            delayed: false,
        };
        GraphView {
            nodes: vec![node("camera", true), node("slow", false), node("sink", false)],
            wires: vec![wire(0, 1), wire(1, 2)],
            valid: true,
            ..GraphView::default()
        }
    }

    fn run(trace: &Trace, seq: u64, begin_ms: u64, slow_ms: u64) {
        let tick = Tick { source: 7, flags: 0, seq, capture_ns: 0 };
        let at = |ms: u64| (begin_ms + ms) * 1_000_000;
        call(trace, "camera", &tick, at(0), at(1));
        call(trace, "slow", &tick, at(3), at(3 + slow_ms));
        call(trace, "sink", &tick, at(4 + slow_ms), at(5 + slow_ms));
    }

    fn call(trace: &Trace, node: &str, tick: &Tick, start_ns: u64, end_ns: u64) {
        trace.call(&trace::Call { node, tick, start_ns, end_ns, made: true, read_bytes: 0, made_bytes: 0 });
    }

    #[test]
    fn a_path_has_times_waits_and_what_was_waited_for() {
        let (trace, view) = (Trace::default(), view());
        run(&trace, 0, 0, 4);
        run(&trace, 1, 100, 40);
        let all = trace.notable(&view);
        assert_eq!((all[0].seq, all[0].total_ms), (1, 44.0), "the latest first");
        let path = trace.path(&view, &all[0]).expect("it is remembered");
        let nodes: Vec<&str> = path.steps.iter().map(|step| step.node.as_str()).collect();
        assert_eq!(nodes, ["camera", "slow", "sink"]);
        let slow = &path.steps[1];
        assert_eq!((slow.wait_ms(), slow.work_ms(), slow.after.as_deref()), (2.0, 40.0, Some("camera")));
        assert_eq!(path.longest().as_deref(), Some("`slow` worked longest: 40.0 ms"));
        assert_eq!(trace.path(&view, &TickEntry { seq: 9, ..all[0].clone() }), None);
    }

    #[test]
    fn a_drop_names_the_tick_in_its_place_and_where_that_was() {
        let (trace, view) = (Trace::default(), view());
        run(&trace, 3, 0, 50);
        trace.dropped("camera", 4, 20_000_000);
        run(&trace, 5, 100, 1);
        let all = trace.notable(&view);
        let reason = all[0].dropped.clone().expect("it was dropped");
        assert_eq!((all[0].seq, reason), (4, DropReason { behind: 3, at: vec!["slow".to_owned()] }));
        assert_eq!(trace.path(&view, &all[0]).expect("the tick in its place").seq, 3);
    }

    #[test]
    fn only_the_newest_calls_are_kept() {
        let trace = Trace::default();
        for seq in 0..2 * CALLS as u64 {
            call(&trace, "n", &Tick { source: 0, flags: 0, seq, capture_ns: 0 }, seq, seq + 1);
            trace.dropped("n", seq, seq);
        }
        let (calls, drops, names) = trace.copy();
        assert_eq!((calls.len(), drops.len(), names.len()), (CALLS, DROPS, 1));
    }
}
