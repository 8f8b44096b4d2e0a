//! The server's state of the running graph.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use panoscope_engine::fault::FaultCursor;
use panoscope_engine::isolation::LinkReport;
use panoscope_engine::memory::FrameRef;
use panoscope_engine::{Engine, Preview, Report, WireTooOld, clock};
use panoscope_graph::{Catalog, Graph};
use serde::Serialize;

use crate::paint::Range;
use crate::pictures::{self, PictureError, Shown};

/// Time without a request after which an image is no longer taken from the graph.
const MAX_UNSEEN: Duration = Duration::from_secs(3);
/// Time between two checks for changes of the graph.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Maximum number of faults that are shown.
const MAX_FAULTS: usize = 10;

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The newest image of an output.
#[derive(Clone)]
struct Picture {
    frame: FrameRef,
    /// When its oldest light arrived, in ns of the engine's clock.
    arrived_ns: Option<i64>,
}

#[derive(Default)]
struct Known {
    report: Option<Report>,
    faults: Vec<FaultLine>,
    shown: Vec<Shown>,
    pictures: HashMap<String, Picture>,
    /// Ranges of the colours of maps.
    ranges: HashMap<String, Range>,
    /// Time of the last request of each image.
    asked: HashMap<String, Instant>,
}

/// An image for a client.
pub struct Encoded {
    /// JPEG.
    pub jpeg: Vec<u8>,
    /// Number of its tick.
    pub tick: u64,
    /// Time since its oldest light arrived.
    pub age_ms: Option<f64>,
}

/// State used only by the graph's thread.
struct Source {
    previews: HashMap<String, (String, Preview)>,
    looked: Option<Instant>,
    /// The graph at the last check.
    graph: Option<Graph>,
    faults: FaultCursor,
}

impl Default for Source {
    fn default() -> Self {
        let faults = FaultCursor::new(MAX_FAULTS);
        Self { previews: HashMap::new(), looked: None, graph: None, faults }
    }
}

/// State shared by the graph's thread and the server.
#[derive(Default)]
pub struct Shared {
    known: Mutex<Known>,
    source: Mutex<Source>,
}

/// A fault.
#[derive(Clone, Debug, Serialize)]
struct FaultLine {
    unix_ms: u64,
    node: String,
    words: String,
}

/// Content of `/state`.
#[derive(Debug, Serialize)]
pub struct State {
    graph: String,
    seconds: f64,
    frames: u64,
    fps: f64,
    pictures: Vec<PictureState>,
    nodes: Vec<NodeState>,
    ages: Vec<AgeState>,
    /// Connections to other machines, by group.
    links: BTreeMap<String, LinkReport>,
    faults: Vec<FaultLine>,
}

#[derive(Debug, Serialize)]
struct PictureState {
    name: String,
    label: String,
    /// Number of its tick; `null` before the first one.
    tick: Option<u64>,
    /// Time since its light arrived.
    age_ms: Option<f64>,
}

#[derive(Debug, Serialize)]
struct NodeState {
    node: String,
    count: u64,
    p50_ms: f64,
    p99_ms: f64,
    dropped: u64,
    faults: u64,
    /// Ticks per input at which it was older than `max_age_ms` and counted as absent.
    too_old_on: Vec<WireTooOld>,
    stopped: Option<String>,
}

/// Ages at a sink: of the oldest light, and of the newest.
#[derive(Debug, Serialize)]
struct AgeState {
    sink: String,
    p50_ms: f64,
    p99_ms: f64,
    max_ms: f64,
    newest_p50_ms: f64,
    newest_p99_ms: f64,
}

impl Picture {
    fn age_ms(&self) -> Option<f64> {
        let age_ns = clock::now_ns().saturating_add_signed(self.arrived_ns?.saturating_neg());
        Some(age_ns as f64 / 1e6)
    }
}

impl Shared {
    /// Publishes the state; see [`crate::Monitor::update`].
    pub fn update(&self, engine: &Engine, catalog: impl FnOnce(&Graph) -> Catalog) {
        let mut source = lock(&self.source);
        let now = Instant::now();
        if source.looked.is_none_or(|looked| now.duration_since(looked) >= LOOK_EVERY) {
            source.looked = Some(now);
            let graph = engine.graph();
            let shown = (source.graph.as_ref() != Some(&graph)).then(|| pictures::of_graph(&graph, &catalog(&graph)));
            source.graph = Some(graph);
            let mut known = lock(&self.known);
            if engine.faults_since(&mut source.faults) {
                let lines = source.faults.newest().rev().map(|fault| FaultLine {
                    unix_ms: fault.unix_ms,
                    node: fault.node.clone(),
                    words: fault.words.clone(),
                });
                known.faults = lines.collect();
            }
            known.shown = shown.unwrap_or_else(|| std::mem::take(&mut known.shown));
            known.report = Some(engine.report());
        }
        let wanted: Vec<Shown> = {
            let known = lock(&self.known);
            let is_asked = |name: &String| known.asked.get(name).is_some_and(|at| now.duration_since(*at) < MAX_UNSEEN);
            known.shown.iter().filter(|shown| is_asked(&shown.name())).cloned().collect()
        };
        source.subscribe(engine, &wanted);
        for (name, (_, preview)) in &source.previews {
            if let Some(frame) = preview.take() {
                let arrived_ns = engine.arrived_ns(&frame.tick());
                lock(&self.known).pictures.insert(name.clone(), Picture { frame, arrived_ns });
            }
        }
        // Frames of pictures that nobody looks at go back to the graph.
        lock(&self.known).pictures.retain(|name, _| source.previews.contains_key(name));
    }

    /// The newest image of an output; `None` for names that are not shown; `Err` with a reason while there is no
    /// image.
    pub fn picture(&self, name: &str) -> Option<Result<Encoded, PictureError>> {
        let mut known = lock(&self.known);
        let packet = known.shown.iter().find(|shown| shown.name() == name)?.packet.clone();
        known.asked.insert(name.to_owned(), Instant::now());
        let picture = known.pictures.get(name).cloned();
        let mut range = known.ranges.get(name).copied().flatten();
        drop(known);
        let encode = |picture: Picture| {
            let jpeg = pictures::jpeg(&picture.frame, &packet, &mut range)?;
            lock(&self.known).ranges.insert(name.to_owned(), range);
            Ok(Encoded { jpeg, tick: picture.frame.tick().seq, age_ms: picture.age_ms() })
        };
        Some(picture.map_or_else(|| Err(PictureError::None), encode))
    }

    /// The counters; `None` before the first update.
    pub fn report(&self) -> Option<Report> {
        lock(&self.known).report.clone()
    }

    /// The state of the graph; `None` before the first update.
    pub fn state(&self) -> Option<State> {
        let known = lock(&self.known);
        let report = known.report.as_ref()?;
        let picture = |shown: &Shown| {
            let picture = known.pictures.get(&shown.name());
            PictureState {
                name: shown.name(),
                label: shown.label.clone(),
                tick: picture.map(|picture| picture.frame.tick().seq),
                age_ms: picture.and_then(Picture::age_ms),
            }
        };
        let nodes = report.nodes.iter().map(|(node, n)| NodeState {
            node: node.clone(),
            count: n.count,
            p50_ms: n.p50_ms,
            p99_ms: n.p99_ms,
            dropped: n.dropped,
            faults: n.faults,
            too_old_on: n.too_old_on.clone(),
            stopped: report.stopped.get(node).cloned(),
        });
        let ages = report.paths.iter().map(|(sink, path)| AgeState {
            sink: sink.clone(),
            p50_ms: path.age_p50_ms,
            p99_ms: path.age_p99_ms,
            max_ms: path.age_max_ms,
            newest_p50_ms: path.newest_age_p50_ms,
            newest_p99_ms: path.newest_age_p99_ms,
        });
        let links = report.groups.iter().filter_map(|(group, counts)| Some((group.clone(), counts.link.clone()?)));
        Some(State {
            graph: report.graph.clone(),
            seconds: report.seconds,
            frames: report.frames,
            fps: report.fps,
            pictures: known.shown.iter().map(picture).collect(),
            nodes: nodes.collect(),
            ages: ages.collect(),
            links: links.collect(),
            faults: known.faults.clone(),
        })
    }
}

impl Source {
    /// Subscribes to requested outputs and drops other previews.
    fn subscribe(&mut self, engine: &Engine, wanted: &[Shown]) {
        let mut ended = Vec::new();
        self.previews.retain(|name, (node, _)| {
            let stays = wanted.iter().any(|shown| shown.name() == *name);
            if !stays {
                ended.push(node.clone());
            }
            stays
        });
        ended.iter().for_each(|node| engine.end_previews(node));
        for shown in wanted {
            if !self.previews.contains_key(&shown.name())
                && let Some(preview) = engine.preview(&shown.node, &shown.output)
            {
                self.previews.insert(shown.name(), (shown.node.clone(), preview));
            }
        }
    }
}
