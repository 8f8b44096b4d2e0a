//! What a replaying engine follows: which ticks enter, which packets meet, with which values and instances nodes run.
//!
//! Everything in a run that depends on time was written down where it was decided; here it is looked up instead of decided again. What is
//! not in the script follows from the ticks.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use panoscope_abi::Tick;
use panoscope_graph::{Graph, ParamValue};

use super::format::Event;
use super::recording::{Recording, RecordingError, SourceTick};
use crate::apply::Applied;
use crate::cell::{Cell, Surroundings, lock};
use crate::exec::{Doing, Exec, Instance, LeftBehind};
use crate::fault::{Action, Cause};
use crate::log::Level;
use crate::memory::FrameRef;
use crate::outputs::OutputRule;
use crate::params::Snapshot;
use crate::stats::bump;

/// The tick of each connection's packet.
pub(crate) struct Wanted {
    pub tick: Tick,
    pub inputs: Vec<Option<(u32, u64)>>,
}

/// A recorded packet that the source may not put out here, such as one of a format that it does not declare any more.
fn withhold(cell: &Cell, around: &Surroundings, tick: &Tick, cause: Cause, words: &str) {
    bump(&cell.stats.faults);
    around.log.say(Level::Error, &cell.id, words);
    cell.note(around, cause, Action::Withhold, Some(tick.seq), || words.to_owned());
}

enum Turn {
    Values(Vec<ParamValue>),
    Opened(Vec<ParamValue>),
    LeftOut { closed: bool },
}

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

/// One step of what steered the graph.
pub(crate) enum Step {
    /// Position in [`Script::edits`].
    Edit(usize),
    /// The values that a node was set to, for the graph as it is known.
    Set(String, Vec<ParamValue>),
}

/// A source's ticks and how far they have been played.
#[derive(Default)]
pub(crate) struct SourceScript {
    ticks: Vec<SourceTick>,
    next: AtomicUsize,
}

impl SourceScript {
    /// The next tick; the same again until [`Self::done`].
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
    /// Ticks admitted before an edit, and its number.
    edits: Vec<(u64, usize)>,
}

/// See the module.
pub struct Script {
    recording: Arc<Recording>,
    sources: HashMap<String, SourceScript>,
    turns: HashMap<String, Mutex<VecDeque<NodeTurn>>>,
    took: HashMap<String, Mutex<VecDeque<Wanted>>>,
    heads: HashMap<String, HeadScript>,
    pub(crate) edits: Vec<ScriptEdit>,
    pub(crate) steps: Vec<Step>,
    applied: AtomicUsize,
    /// The graph is another one: only the sources are played.
    sources_only: bool,
    /// Nodes that act on the world are left out.
    muted: bool,
    /// Values that win over the recorded ones: node, position, value.
    overrides: Vec<(String, usize, ParamValue)>,
    failed: OnceLock<String>,
}

impl Script {
    /// The script of a recording: for its own graph, or for another one whose sources are called `names` in the recording.
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
            heads: HashMap::new(),
            edits: Vec::new(),
            steps: Vec::new(),
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
                // What one graph had no time for another one may have.
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
            Event::LeftOut { node, source, seq, closed } => {
                (node, turn(*source, *seq, Turn::LeftOut { closed: *closed }))
            }
            Event::Took { node, source, seq, capture_ns, inputs } => {
                let tick = Tick { source: *source, flags: 0, seq: *seq, capture_ns: *capture_ns };
                let wanted = Wanted { tick, inputs: inputs.clone() };
                let list = self.took.entry(node.clone()).or_default();
                list.get_mut().unwrap_or_else(std::sync::PoisonError::into_inner).push_back(wanted);
                return;
            }
            Event::Set { node, values } => {
                self.steps.push(Step::Set(node.clone(), self.overridden(node, values)));
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
                self.steps.push(Step::Edit(number));
                return;
            }
            Event::Head(_) | Event::Tick { .. } | Event::Dropped { .. } | Event::Fault(_) | Event::End { .. } => return,
        };
        let list = self.turns.entry(node.clone()).or_default();
        list.get_mut().unwrap_or_else(std::sync::PoisonError::into_inner).push_back(new);
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

    /// Whether a node is never opened: its ticks come from the recording, or it would act on the world.
    pub(crate) fn closes(&self, cell: &Cell) -> bool {
        cell.source || (self.muted && cell.side_effects)
    }

    pub(crate) fn source(&self, node: &str) -> Option<&SourceScript> {
        self.sources.get(node)
    }

    /// The packets of a tick, one frame per output of the node.
    pub(crate) fn outputs(
        &self,
        cell: &Cell,
        around: &Surroundings,
        recorded: &SourceTick,
        tick: Tick,
    ) -> Result<Vec<FrameRef>, RecordingError> {
        let output = |rule: &OutputRule| match recorded.packets.iter().find(|(port, _)| *port == rule.name) {
            Some((port, packet)) => {
                let frame = self.recording.frame(&format!("{}.{port}", cell.id), packet)?;
                if let Err((cause, words)) = rule.admit(frame.frame()) {
                    withhold(cell, around, &tick, cause, &words);
                    return Ok(FrameRef::empty(tick));
                }
                let mut raw = frame.into_raw();
                raw.tick = tick;
                // SAFETY: the reference that `into_raw` gave up; only the tick is another.
                Ok(unsafe { FrameRef::adopt(raw) })
            }
            None => Ok(FrameRef::empty(tick)),
        };
        cell.rules.iter().map(output).collect()
    }

    /// The replay cannot go on.
    pub(crate) fn fail(&self, reason: String) {
        let _ = self.failed.set(reason);
    }

    /// Why the replay did not come to its end.
    pub fn failure(&self) -> Option<&str> {
        self.failed.get().map(String::as_str)
    }

    /// Whether the head of a region may let another tick in before the next change of the graph.
    pub(crate) fn may_enter(&self, head: &str) -> bool {
        let Some(script) = self.heads.get(head) else { return true };
        let (applied, admitted) = (self.applied.load(Ordering::Acquire), script.admitted.load(Ordering::Acquire));
        script.edits.iter().find(|(_, edit)| *edit >= applied).is_none_or(|(count, _)| admitted < *count)
    }

    /// A region's head let a tick in.
    pub(crate) fn entered(&self, head: &str) {
        if let Some(script) = self.heads.get(head) {
            script.admitted.fetch_add(1, Ordering::AcqRel);
        }
    }

    /// A head that an edit waits for and that has not let all ticks in which come before it.
    pub(crate) fn missing_before(&self, edit: usize) -> Option<&str> {
        let behind = |(head, count): &&(String, u64)| {
            let over = match self.sources.get(head) {
                Some(source) => source.next().is_none(),
                None => self.took.get(head).is_none_or(|took| lock(took).is_empty()),
            };
            !over && self.heads.get(head).is_some_and(|h| h.admitted.load(Ordering::Acquire) < *count)
        };
        self.edits.get(edit)?.admitted.iter().find(behind).map(|(head, _)| head.as_str())
    }

    /// An edit is made: what comes after it may enter.
    pub(crate) fn edited(&self, edit: usize) {
        self.applied.store(edit + 1, Ordering::Release);
    }

    /// Whether nodes follow the script, not only sources.
    pub(crate) fn leads_nodes(&self) -> bool {
        !self.sources_only
    }

    /// The packets that a node took next in the recording.
    pub(crate) fn took(&self, node: &str) -> Option<&Mutex<VecDeque<Wanted>>> {
        self.took.get(node)
    }

    /// Brings a node to where it was before this tick; whether it is to run, if the script knows.
    #[cold]
    pub(crate) fn lead(
        &self,
        cell: &Cell,
        exec: &mut Exec,
        around: &Surroundings,
        tick: &Tick,
    ) -> Result<Option<bool>, LeftBehind> {
        if self.closes(cell) {
            return Ok(Some(false));
        }
        if self.sources_only {
            return Ok(None);
        }
        let mut runs = true;
        if let Some(all) = self.turns.get(&cell.id) {
            // The list is not locked while the plugin is called.
            let next = || {
                let mut turns = lock(all);
                // A tick that is missing here, behind a gap: what it brought still holds.
                let due = turns.front().is_some_and(|t| t.source == tick.source && t.seq <= tick.seq);
                if due { turns.pop_front() } else { None }
            };
            while let Some(next) = next() {
                let here = next.seq == tick.seq;
                match next.turn {
                    Turn::Values(values) => {
                        let snapshot = Snapshot::new(values);
                        cell.write_down(around, |node| Event::Values {
                            node,
                            source: tick.source,
                            seq: tick.seq,
                            values: snapshot.owned().to_vec(),
                        });
                        cell.set_snapshot(Arc::clone(&snapshot));
                        exec.set_snapshot(snapshot);
                    }
                    Turn::Opened(values) => self.open(cell, exec, around, tick, values)?,
                    Turn::LeftOut { closed } => {
                        runs &= !here;
                        if closed {
                            cell.left_out(around, tick, true);
                            let old = std::mem::replace(&mut exec.instance, Instance::none(cell.node_type));
                            cell.aside(Doing::Close, tick, || cell.end(around, old))?;
                        }
                    }
                }
            }
        }
        Ok(Some(runs && exec.instance.is_open()))
    }

    fn open(
        &self,
        cell: &Cell,
        exec: &mut Exec,
        around: &Surroundings,
        tick: &Tick,
        values: Vec<ParamValue>,
    ) -> Result<(), LeftBehind> {
        let snapshot = Snapshot::new(values);
        cell.opened(&snapshot, around, tick);
        match cell.aside(Doing::Open, tick, || cell.open(around, &snapshot))? {
            Ok(mut instance) => {
                if instance.is_open() {
                    cell.hand_over(exec, &mut instance, around, tick)?;
                }
                let old = std::mem::replace(&mut exec.instance, instance.begun());
                cell.aside(Doing::Close, tick, || cell.end(around, old))?;
                cell.set_snapshot(Arc::clone(&snapshot));
                exec.set_snapshot(snapshot);
                exec.bypassed = false;
                exec.bad_in_a_row = 0;
            }
            Err(words) => {
                let words = format!("it opened when it was recorded, now it does not: {words}");
                around.log.say(Level::Error, &cell.id, &words);
                self.fail(format!("node `{}`: {words}", cell.id));
            }
        }
        Ok(())
    }
}
