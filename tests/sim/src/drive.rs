//! Runs a case in its world: starts the graph, changes it, waits for faults, and closes it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::engine::fault::{Action, Fault};
use crate::engine::log::Level;
use crate::engine::memory::{FrameRef, memory, room_for};
use crate::engine::observe::{Event, Observer, ReportFn};
use crate::engine::{Applied, ApplyError, Engine, Options, Outcome, Report};
use crate::world::disk::Disk;
use crate::world::time::Instant;
use crate::world::{self, Dice, note, thread};
use panoscope_abi::{Frame, Tick};
use panoscope_graph::ParamValue;

use crate::case::{Case, rule_of};
use crate::graphs::{Edit, Maker, Model, Node};
use crate::harm::Harm;
use crate::observe::{self, Seen};
use crate::plugins::simulated;

/// Time limit for an expected event, in simulated time.
const PATIENCE: Duration = Duration::from_secs(25);
/// Time limit for opening a node.
const OPEN_LIMIT: Duration = Duration::from_secs(3);
/// Time limit for closing a node.
const CLOSE_LIMIT: Duration = Duration::from_secs(2);
/// Usual limit of frame memory, bytes.
const MEMORY_BYTES: i64 = 2 << 30;

/// A version of the graph, from the first ticks that its sources made for it.
#[derive(Clone, Debug)]
pub struct Version {
    /// The graph of this version.
    pub model: Model,
    /// First tick of each source whose region was changed.
    pub switched_at: Vec<(String, u64)>,
}

/// Results of a run.
#[derive(Debug, Default)]
pub struct Ran {
    /// The versions in order.
    pub versions: Vec<Version>,
    /// All values that each node had, in order.
    pub values: BTreeMap<String, Vec<u32>>,
    /// Reported faults.
    pub faults: Vec<Fault>,
    /// Ticks that the observer saw dropped.
    pub dropped: Vec<(String, u64)>,
    /// The report.
    pub report: Option<Report>,
    /// How the run ended.
    pub outcome: Option<Outcome>,
    /// Errors and warnings of the log.
    pub log: Vec<String>,
    /// Whether a change opened a node that did not return.
    pub hung_edit: bool,
    /// Expected events that did not occur.
    pub failures: Vec<String>,
    /// Numbers of changes that were applied and refused.
    pub edits: (usize, usize),
}

#[derive(Default)]
struct Watch {
    dropped: Mutex<Vec<(String, u64)>>,
    admitted: Mutex<BTreeMap<String, u64>>,
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Observer for Watch {
    fn wants_all_outputs(&self) -> bool {
        false
    }

    fn wants_all_source_outputs(&self) -> bool {
        false
    }

    fn event(&self, event: Event) {
        if let Event::Dropped { node, seq } = event {
            lock(&self.dropped).push((node, seq));
        }
    }

    fn admitted(&self, head: &str) {
        *lock(&self.admitted).entry(head.to_owned()).or_default() += 1;
    }

    fn admitted_by(&self, head: &str) -> u64 {
        lock(&self.admitted).get(head).copied().unwrap_or(0)
    }

    fn outputs(&self, _: &str, _: &Arc<[String]>, _: &[Frame]) {}

    fn source_tick(&self, _: &str, _: &Arc<[String]>, _: &Tick, _: &[Frame]) {}

    fn report_to(&self, _: Box<ReportFn>) {}

    fn break_off(&self, _: Instant) -> bool {
        true
    }
}

/// A running case.
struct Driver {
    case: Case,
    dice: Dice,
    maker: Maker,
    engine: Engine,
    watch: Arc<Watch>,
    ran: Ran,
}

fn options(case: &Case, watch: &Arc<Watch>) -> Options {
    Options {
        threads: case.threads,
        frames: case.model.batch.then_some(case.frames),
        ticks_at_once: case.ticks_at_once,
        hang: Duration::from_secs(2),
        open_limit: OPEN_LIMIT,
        close_limit: CLOSE_LIMIT,
        observer: case.observed.then(|| Arc::clone(watch) as Arc<dyn Observer>),
        ..Options::default()
    }
}

/// Runs the case. Must be called in its world.
pub fn run(case: Case) -> Ran {
    observe::begin(Disk::new(case.disk.clone()));
    memory().set_limit_bytes(MEMORY_BYTES);
    let mut ran = Ran::default();
    let plugins = simulated();
    let graph = match plugins.graph(&case.model) {
        Ok(graph) => graph,
        Err(mistakes) => {
            ran.failures.push(format!("the graph has mistakes: {mistakes}"));
            return ran;
        }
    };
    let watch = Arc::new(Watch::default());
    let engine = match Engine::start(graph, plugins.catalog(), plugins, options(&case, &watch)) {
        Ok(engine) => engine,
        // A full disk holds no new file.
        Err(error) => {
            let fails = |node: &&crate::graphs::Node| node.refuses || node.open_ms > 0.0;
            let culprit = case.model.nodes.iter().find(fails);
            let named = culprit.is_some_and(|node| error.to_string().contains(&format!("`{}`", node.id)));
            if !named && !case.disk_fails() && !case.is_short_of_threads() {
                ran.failures.push(format!("it does not start: {error}"));
            }
            return ran;
        }
    };
    if case.start_fails {
        ran.failures.push("it starts although a node does not open".to_owned());
    }
    ran.versions.push(Version { model: case.model.clone(), switched_at: Vec::new() });
    let mut dice = Dice::new(case.driver_seed);
    let mut maker = Maker::with_names(dice.split(), 1_000);
    maker.keeps = case.culprit().and_then(|node| node.trouble.as_ref()).is_none_or(|t| t.harm != Harm::ReleaseTwice);
    let mut driver = Driver { case, dice, maker, engine, watch, ran };
    driver.note_values();
    driver.live();
    driver.end();
    driver.ran
}

fn sleep_ms(ms: u64) {
    thread::sleep(Duration::from_millis(ms));
}

impl Driver {
    fn model(&self) -> &Model {
        // The first version was added before the driver was made.
        &self.ran.versions[self.ran.versions.len() - 1].model
    }

    /// Records the values of the newest graph as allowed values of the nodes.
    fn note_values(&mut self) {
        let nodes: Vec<(String, u32)> = self.model().nodes.iter().map(|n| (n.id.clone(), n.values())).collect();
        for (node, values) in nodes {
            let known = self.ran.values.entry(node).or_default();
            if known.last() != Some(&values) {
                known.push(values);
            }
        }
    }

    fn until(&mut self, what: &str, done: impl Fn(&Engine) -> bool) -> bool {
        let end = Instant::now() + PATIENCE;
        while !done(&self.engine) {
            if Instant::now() > end {
                let log: Vec<String> = self.engine.recent_log().into_iter().map(|line| format!("{line:?}")).collect();
                self.ran.failures.push(format!("{what}; log: {}", log.join("; ")));
                return false;
            }
            sleep_ms(5);
        }
        true
    }

    fn live(&mut self) {
        sleep_ms(self.dice.within(1, 120));
        let pinch = self.case.pinch_bytes;
        for edit in 0..self.case.edits {
            if edit == 0
                && let Some(more) = pinch
            {
                memory().set_limit_bytes(memory().in_use_bytes() + more);
                sleep_ms(self.dice.within(5, 100));
                memory().set_limit_bytes(MEMORY_BYTES);
            }
            sleep_ms(self.dice.within(0, 60));
            if self.engine.is_finished() {
                break;
            }
            let model = self.model().clone();
            let edit = self.maker.edit(&model);
            self.edit(edit);
        }
        if !self.case.model.batch {
            self.see_faults();
            sleep_ms(400);
            self.engine.stop();
        }
    }

    /// Waits until the expected fault is reported, and until good frames arrive again.
    fn see_faults(&mut self) {
        let Some(culprit) = self.case.culprit().cloned() else { return };
        let Some(trouble) = culprit.trouble.clone() else { return };
        let Some(rule) = rule_of(trouble.harm) else { return };
        // A change may have made another node of it, or taken it out. What an instance retains goes with it: two may both stay below the limit.
        let is_same = |node: &Node| {
            node.kind == culprit.kind && (trouble.harm != Harm::Leak || node.reopened == culprit.reopened)
        };
        let is_there = self.ran.versions.iter().all(|v| v.model.node(&culprit.id).is_some_and(is_same));
        if rule.causes.is_empty() || !is_there || self.case.is_short_of_threads() {
            return;
        }
        let id = culprit.id.clone();
        let named = |engine: &Engine| {
            engine.recent_faults().iter().any(|f| f.node == id && rule.causes.contains(&f.cause))
                || engine.is_finished()
        };
        let last = trouble.first + trouble.ticks;
        let good = |seen: &Seen| match seen {
            Seen::Called { node, seq, .. } | Seen::Made { node, seq } => *node == id && *seq > last,
            _ => false,
        };
        let harms = || observe::count(|seen| matches!(seen, Seen::Harmed { node, .. } if *node == id));
        // Its ticks may have been dropped.
        let missed = || observe::count(good) > 0 && harms() < rule.calls;
        let named = |engine: &Engine| named(engine) || missed();
        let what = format!("the fault {:?} of `{id}` was not reported", trouble.harm);
        if !self.until(&what, named) || trouble.on_fault != "restart" {
            return;
        }
        let over = |engine: &Engine| {
            let left_out = engine.recent_faults().iter().any(|f| f.node == id && f.done == Action::Bypass);
            left_out || observe::count(good) > 0 || engine.is_finished()
        };
        let what = format!("no good tick of `{id}` came after {:?}", trouble.harm);
        self.until(&what, over);
    }

    fn edit(&mut self, edit: Edit) {
        let before = self.model().clone();
        note(|| format!("edit {edit:?}"));
        match edit {
            Edit::Value { node, reopens, value } => {
                let param = if reopens { "reopened" } else { "live" };
                let mut next = before;
                if let Some(node) = next.node_mut(&node) {
                    *(if reopens { &mut node.reopened } else { &mut node.live }) = value;
                }
                let set = self.engine.set_param(&node, param, ParamValue::Int(i64::from(value)));
                note(|| format!("set {set:?}"));
                match set {
                    Ok(()) => self.became(next, Vec::new()),
                    Err(error) => {
                        self.ran.edits.1 += 1;
                        self.ran.hung_edit |= error.to_string().contains("did not return");
                        let culprit = self.case.culprit().is_some_and(|culprit| culprit.id == node);
                        if !culprit && !self.case.is_short_of_threads() {
                            self.ran.failures.push(format!("a good value was refused: {error}"));
                        }
                    }
                }
            }
            Edit::Graph(next) => self.apply(&before, next, None),
            Edit::GraphAt(next, ahead) => {
                self.apply(&before, next, Some(observe::next_tick("camera0") + ahead));
            }
        }
    }

    fn apply(&mut self, before: &Model, next: Model, at: Option<u64>) {
        let plugins = simulated();
        let graph = match plugins.graph(&next) {
            Ok(graph) => graph,
            Err(mistakes) => return self.ran.failures.push(format!("a change has mistakes: {mistakes}")),
        };
        let applied = match at {
            None => self.engine.apply(graph, plugins.catalog(), plugins),
            Some(seq) => self.engine.apply_at(graph, plugins.catalog(), plugins, &[("camera0".to_owned(), seq)]),
        };
        note(|| format!("applied {applied:?}"));
        let opens = |node: &crate::graphs::Node| {
            before.node(&node.id).is_none_or(|old| old.values() != node.values() || old.kind != node.kind)
        };
        let fails = next.nodes.iter().any(|node| (node.refuses || node.open_ms > 0.0) && opens(node));
        self.ran.hung_edit |= next.nodes.iter().any(|node| node.open_ms > 0.0 && opens(node));
        match applied {
            Ok(Applied { switched_at, .. }) => {
                if fails {
                    self.ran.failures.push("a change was made although a node of it does not open".to_owned());
                }
                // A source that has ended makes no such tick.
                let goes_on =
                    !self.case.model.batch && self.case.culprit().is_none_or(|culprit| culprit.id != "camera0");
                if goes_on
                    && let Some(seq) = at
                    && let Some((_, first)) = switched_at.iter().find(|(source, _)| source == "camera0")
                    && *first < seq
                {
                    self.ran.failures.push(format!("a change for tick {seq} was made at tick {first}"));
                }
                self.became(next, switched_at);
            }
            Err(error) => {
                self.ran.edits.1 += 1;
                let why = match &error {
                    ApplyError::Open { .. } | ApplyError::NoReturn { .. } => {
                        fails
                            || self.case.disk_fails()
                            || self.case.culprit().is_some()
                            || self.case.is_short_of_threads()
                    }
                    ApplyError::Passed { .. } => at.is_some(),
                    ApplyError::Ended => {
                        self.engine.is_finished()
                            || self.case.model.batch
                            || self.case.stops()
                            || self.case.is_short_of_threads()
                    }
                    ApplyError::Busy { .. } => self.case.culprit().is_some(),
                    _ => false,
                };
                if !why {
                    self.ran.failures.push(format!("a good change was refused: {error}"));
                }
                self.ran.hung_edit |= matches!(error, ApplyError::NoReturn { .. });
                let names = |graph: &panoscope_graph::Graph| {
                    graph
                        .nodes
                        .iter()
                        .map(|n| (n.id.clone(), n.type_name.clone(), n.params.clone()))
                        .collect::<Vec<_>>()
                };
                if let Ok(old) = plugins.graph(before)
                    && names(&old) != names(&self.engine.graph())
                {
                    self.ran.failures.push("a refused change changed the graph".to_owned());
                }
            }
        }
    }

    fn became(&mut self, model: Model, switched_at: Vec<(String, u64)>) {
        self.ran.edits.0 += 1;
        self.ran.versions.push(Version { model, switched_at });
        self.note_values();
    }

    fn end(&mut self) {
        if !self.engine.wait(Some(PATIENCE)) {
            let log: Vec<String> = self.engine.recent_log().into_iter().map(|line| format!("{line:?}")).collect();
            self.ran.failures.push(format!("the graph does not come to its end; log: {}", log.join("; ")));
        }
        let outcome = self.engine.close(Duration::from_secs(3));
        self.ran.faults = self.engine.recent_faults();
        self.ran.report = Some(self.engine.report());
        self.ran.dropped = lock(&self.watch.dropped).clone();
        let log = self.engine.recent_log().into_iter();
        self.ran.log = log
            .filter(|(level, ..)| *level <= Level::Warn)
            .map(|(_, node, words)| format!("{node}: {words}"))
            .collect();
        self.ran.outcome = Some(outcome);
    }
}

/// A finished case.
pub struct Done {
    /// The case.
    pub case: Case,
    /// How the world ended.
    pub ended: world::Ended<Ran>,
    /// What the nodes saw.
    pub seen: Vec<Seen>,
    /// The disk at the end.
    pub disk: Disk,
    /// Frame memory that was not released, bytes.
    pub kept_bytes: i64,
}

/// Initialises what a process initialises once (pools of frames, state of the first graph), so that its first run is like all others.
fn warm_up() {
    static DONE: std::sync::Once = std::sync::Once::new();
    DONE.call_once(|| {
        for bits in 0..24 {
            let len = room_for(1 << bits);
            if let Ok((buffer, data)) = memory().allocate(len) {
                // SAFETY: the one reference of a new buffer, which is given up here.
                drop(unsafe { FrameRef::adopt(Frame { buffer, data, len, ..Frame::EMPTY }) });
            }
        }
        world::run(world::Settings::default(), || drop(run(Case::new(1))));
    });
}

/// Runs a case in a separate world.
pub fn play(case: Case, keep_trace: bool) -> Done {
    let _alone = observe::alone();
    warm_up();
    let settings = world::Settings { keep_trace, ..case.world.clone() };
    simulated();
    let before = memory().in_use_bytes();
    crate::engine::forget();
    let mine = case.clone();
    let ended = world::run(settings, move || run(mine));
    Done { case, ended, seen: observe::seen(), disk: observe::disk(), kept_bytes: memory().in_use_bytes() - before }
}
