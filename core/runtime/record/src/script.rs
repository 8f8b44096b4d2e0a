//! The decisions that a replay repeats: which ticks enter, which packets meet, with which values and instances nodes
//! run.
//!
//! The recording contains every decision of the run that depended on time. The script looks them up instead of deciding
//! again. Everything else depends on the ticks only.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use panoscope_abi::Tick;
use panoscope_engine::Applied;
use panoscope_engine::decide::{self, Ages, Decider, FramesError, Turn, Wanted};
use panoscope_engine::memory::FrameRef;
use panoscope_engine::sync::lock;
use panoscope_graph::{Graph, ParamValue};

use crate::format::Event;
use crate::recording::{Packet, Recording, SourceTick};

struct NodeTurn {
    source: u32,
    seq: u64,
    turn: Turn,
}

/// A change of the graph in a recording.
pub(crate) struct ScriptEdit {
    pub graph: Graph,
    pub applied: Applied,
    admitted: Vec<(String, u64)>,
}

/// A recorded change of the graph or of values.
pub(crate) enum RecordedChange {
    /// A change of the graph: index in [`Script::edits`].
    Edit(usize),
    /// New values of a node.
    Set(String, Vec<ParamValue>),
}

/// A source's ticks and the position of the next one.
#[derive(Default)]
pub(crate) struct SourceScript {
    ticks: Vec<SourceTick>,
    next: AtomicUsize,
}

impl SourceScript {
    /// The next tick; the same one until [`Self::done`] is called.
    pub fn next(&self) -> Option<&SourceTick> {
        self.ticks.get(self.next.load(Ordering::Relaxed))
    }

    pub fn done(&self) {
        self.next.fetch_add(1, Ordering::Relaxed);
    }
}

#[derive(Default)]
struct HeadScript {
    admitted: AtomicU64,
    /// Number of ticks admitted before an edit, and the edit's index.
    edits: Vec<(u64, usize)>,
}

/// Input ages by node, then by slot of the source and number of the tick.
pub struct Script {
    recording: Arc<Recording>,
    sources: HashMap<String, SourceScript>,
    turns: HashMap<String, Mutex<VecDeque<NodeTurn>>>,
    took: HashMap<String, Mutex<VecDeque<Wanted>>>,
    /// By node, then by slot of the source and number of the tick.
    ages: HashMap<String, HashMap<(u32, u64), Ages>>,
    heads: HashMap<String, HeadScript>,
    pub(crate) edits: Vec<ScriptEdit>,
    pub(crate) changes: Vec<RecordedChange>,
    applied: AtomicUsize,
    /// Whether only the sources are replayed, because the graph is another one.
    sources_only: bool,
    /// Whether nodes with side effects are skipped.
    muted: bool,
    /// Values that override the recorded ones: node, position of the parameter, value.
    overrides: Vec<(String, usize, ParamValue)>,
    failed: OnceLock<String>,
}

impl Script {
    /// The script of a recording: for its own graph, or for another one whose sources are called `names` in the
    /// recording.
    pub(crate) fn new(
        recording: Arc<Recording>,
        names: &BTreeMap<String, String>,
        sources_only: bool,
        muted: bool,
        overrides: Vec<(String, usize, ParamValue)>,
    ) -> Self {
        let mut this = Self {
            sources: HashMap::new(),
            turns: HashMap::new(),
            took: HashMap::new(),
            ages: HashMap::new(),
            heads: HashMap::new(),
            edits: Vec::new(),
            changes: Vec::new(),
            applied: AtomicUsize::new(0),
            sources_only,
            muted,
            overrides,
            failed: OnceLock::new(),
            recording: Arc::clone(&recording),
        };
        for (node, recorded) in names {
            let mut ticks = recording.sources.get(recorded).cloned().unwrap_or_default();
            if sources_only {
                // Another graph may have time for ticks that the recorded one dropped.
                ticks.iter_mut().for_each(|t| t.admitted = true);
            }
            this.sources.insert(node.clone(), SourceScript { ticks, ..SourceScript::default() });
        }
        if !sources_only {
            recording.events.iter().for_each(|event| this.take(event));
        }
        this
    }

    fn take(&mut self, event: &Event) {
        let turn = |source: u32, seq: u64, turn: Turn| NodeTurn { source, seq, turn };
        let (node, new) = match event {
            Event::Values { node, source, seq, values } => {
                (node, turn(*source, *seq, Turn::Values(self.overridden(node, values))))
            }
            Event::Opened { node, source, seq, values } => {
                (node, turn(*source, *seq, Turn::Opened(self.overridden(node, values))))
            }
            Event::Skipped { node, source, seq, closed } => {
                (node, turn(*source, *seq, Turn::Skipped { here: false, closed: *closed }))
            }
            Event::Took { node, source, seq, capture_ns, inputs } => {
                let tick = Tick { source: *source, flags: 0, seq: *seq, capture_ns: *capture_ns };
                let wanted = Wanted { tick, inputs: inputs.clone() };
                let list = self.took.entry(node.clone()).or_default();
                list.get_mut().unwrap_or_else(PoisonError::into_inner).push_back(wanted);
                return;
            }
            Event::Ages { node, source, seq, now_ns, arrived } => {
                let ages = Ages { now_ns: *now_ns, arrived: arrived.clone() };
                self.ages.entry(node.clone()).or_default().insert((*source, *seq), ages);
                return;
            }
            Event::Set { node, values } => {
                self.changes.push(RecordedChange::Set(node.clone(), self.overridden(node, values)));
                return;
            }
            Event::Edit { graph, admitted, applied, .. } => {
                let number = self.edits.len();
                for (head, count) in admitted {
                    self.heads.entry(head.clone()).or_default().edits.push((*count, number));
                }
                let mut graph = Graph::clone(graph);
                for node in &mut graph.nodes {
                    node.params = self.overridden(&node.id, &node.params);
                }
                let (applied, admitted) = (Applied::clone(applied), admitted.clone());
                self.edits.push(ScriptEdit { graph, applied, admitted });
                self.changes.push(RecordedChange::Edit(number));
                return;
            }
            Event::Head(_) | Event::Tick { .. } | Event::Dropped { .. } | Event::Fault(_) | Event::End { .. } => return,
        };
        let list = self.turns.entry(node.clone()).or_default();
        list.get_mut().unwrap_or_else(PoisonError::into_inner).push_back(new);
    }

    fn overridden(&self, node: &str, values: &[ParamValue]) -> Vec<ParamValue> {
        let mut values = values.to_vec();
        for (_, at, value) in self.overrides.iter().filter(|(n, _, _)| n == node) {
            if let Some(slot) = values.get_mut(*at) {
                *slot = value.clone();
            }
        }
        values
    }

    /// Reason of an early end of the replay, if there was one.
    pub fn failure(&self) -> Option<&str> {
        self.failed.get().map(String::as_str)
    }
}

impl Decider for Script {
    fn closes(&self, is_source: bool, has_side_effects: bool) -> bool {
        is_source || (self.muted && has_side_effects)
    }

    fn leads_nodes(&self) -> bool {
        !self.sources_only
    }

    fn has_source(&self, node: &str) -> bool {
        self.sources.contains_key(node)
    }

    fn source_next(&self, node: &str) -> Option<decide::SourceTick> {
        let &SourceTick { seq, capture_ns, admitted, gap, .. } = self.sources.get(node)?.next()?;
        Some(decide::SourceTick { seq, capture_ns, admitted, gap })
    }

    fn source_done(&self, node: &str) {
        if let Some(source) = self.sources.get(node) {
            source.done();
        }
    }

    fn source_frames(&self, node: &str, ports: &[String]) -> Result<Vec<Option<FrameRef>>, FramesError> {
        let Some(tick) = self.sources.get(node).and_then(SourceScript::next) else { return Ok(Vec::new()) };
        // Ticks that were dropped may belong to a successor of the source that plays them.
        let is_unknown = |(port, _): &&(String, Packet)| !self.sources_only && tick.admitted && !ports.contains(port);
        if let Some((port, _)) = tick.packets.iter().find(is_unknown) {
            return Err(FramesError::NoOutput { seq: tick.seq, node: node.to_owned(), port: port.clone() });
        }
        let frame = |name: &String| {
            let packet = tick.packets.iter().find(|(port, _)| port == name);
            packet.map(|(port, packet)| self.recording.frame(&format!("{node}.{port}"), packet)).transpose()
        };
        let frames: Result<_, _> = ports.iter().map(frame).collect();
        frames.map_err(|error| FramesError::Read { reason: error.to_string() })
    }

    fn took(&self, node: &str) -> Option<&Mutex<VecDeque<Wanted>>> {
        self.took.get(node)
    }

    fn next_turn(&self, node: &str, tick: &Tick) -> Option<Turn> {
        let mut turns = lock(self.turns.get(node)?);
        // The decision's tick may be missing because of a gap; the decision still applies to the next tick.
        let due = turns.front().is_some_and(|t| t.source == tick.source && t.seq <= tick.seq);
        let NodeTurn { seq, turn, .. } = if due { turns.pop_front()? } else { return None };
        Some(match turn {
            Turn::Skipped { closed, .. } => Turn::Skipped { here: seq == tick.seq, closed },
            other => other,
        })
    }

    fn ages(&self, node: &str, tick: &Tick) -> Option<Ages> {
        self.ages.get(node)?.get(&(tick.source, tick.seq)).cloned()
    }

    fn may_enter(&self, head: &str) -> bool {
        let Some(script) = self.heads.get(head) else { return true };
        let (applied, admitted) = (self.applied.load(Ordering::Acquire), script.admitted.load(Ordering::Acquire));
        script.edits.iter().find(|(_, edit)| *edit >= applied).is_none_or(|(count, _)| admitted < *count)
    }

    fn entered(&self, head: &str) {
        if let Some(script) = self.heads.get(head) {
            script.admitted.fetch_add(1, Ordering::AcqRel);
        }
    }

    fn waits_before(&self, edit: usize) -> bool {
        let pending = |(head, count): &(String, u64)| {
            let ended = match self.sources.get(head) {
                Some(source) => source.next().is_none(),
                None => self.took.get(head).is_none_or(|took| lock(took).is_empty()),
            };
            !ended && self.heads.get(head).is_some_and(|h| h.admitted.load(Ordering::Acquire) < *count)
        };
        self.edits.get(edit).is_some_and(|edit| edit.admitted.iter().any(pending))
    }

    fn replaced(&self, edit: usize) -> &[String] {
        self.edits.get(edit).map_or(&[], |edit| &edit.applied.replaced)
    }

    fn edited(&self, edit: usize) {
        self.applied.store(edit + 1, Ordering::Release);
    }

    fn fail(&self, reason: String) {
        let _ = self.failed.set(reason);
    }

    fn has_failed(&self) -> bool {
        self.failed.get().is_some()
    }
}
