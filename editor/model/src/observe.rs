//! Renders previews of the running graph for the window, at most five to ten times per second, and reads its counters twice per second. It
//! runs on a thread of its own, so that the window's thread never waits.
//!
//! For each previewed output two frames are retained: the newest one, and the one that was rendered last, which is rendered again when it is asked
//! for in another way. Of outputs that are compared or shown as a stereo pair a few more are, among which one tick of both is searched.
//!
//! The first previews exist before the first tick, see [`crate::first_previews`]: the pictures of a run that is over at once are shown too.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_engine::fault::{Action, Fault, FaultCursor};
use panoscope_engine::{NodeReport, NodeWindow, Window};
use panoscope_host::attach::PAIR_TICKS;
use serde::{Deserialize, Serialize};

use crate::comparing::{self, Comparison, ComparisonRequest};
pub use crate::output::{Output, WireEnd};
use crate::picture::RenderedPacket;
use crate::probe::{Probe, ProbeRequest};
use crate::session::{Handle, Phase};
use crate::surface::Viewpoint;
use panoscope_engine::sync::lock;

mod feed;
mod preview;
use feed::{Fed, Feed, wanted};
use preview::OutputPreview;

/// Minimum time between two previews of an output while one is shown large.
pub const LARGE_INTERVAL: Duration = Duration::from_millis(100);
/// Minimum time between two thumbnails: drawing the window costs more than rendering them.
pub const THUMBNAIL_INTERVAL: Duration = Duration::from_millis(200);
/// Number of packets of each eye among which one tick is searched: both come from one camera, one after the other.
const EYE_TICKS: usize = 4;
/// Number of kept maps of confidence. Each is made before the points of its tick, and few are made before these are.
const CONFIDENCE_TICKS: usize = 4;
const COUNTERS_INTERVAL: Duration = Duration::from_millis(500);
/// Number of points in a node's history: two minutes.
const HISTORY: usize = 240;

/// How an output is to be previewed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PreviewRequest {
    /// Type of its packets.
    pub packet: String,
    /// Maximum width of the preview in px.
    pub max_width: usize,
    /// For a cloud: the viewpoint to render it from as a surface; `None` to show it as the camera saw it.
    pub viewpoint: Option<Viewpoint>,
    /// For a cloud: whether its points are needed too.
    pub points: bool,
    /// The output whose packets are shown with these, both of one tick: the other eye of a stereo pair.
    pub pair: Option<Output>,
    /// For these points: the output with the confidence of their disparities.
    pub confidence: Option<Output>,
}

/// Counters and histories of all nodes.
#[derive(Clone, Debug, Default)]
pub struct Counters {
    /// Counters of the last window of time, by node.
    pub nodes: BTreeMap<String, NodeWindow>,
    /// Times and rates over the last two minutes, by node; oldest first.
    pub history: HashMap<String, VecDeque<Point>>,
    /// Maximum queue length of each wire per reading, as [seconds since the window was opened, packets]; oldest first.
    pub queues: BTreeMap<WireEnd, VecDeque<[f64; 2]>>,
    /// Newest fault of each node.
    pub faults: HashMap<String, Fault>,
    /// All recent faults, oldest first.
    pub fault_list: Vec<Fault>,
    /// The whole run, once it is over: [`Self::nodes`] has then its times, with rates of 0.
    pub over: Option<Over>,
}

/// What a run was that is over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Over {
    /// Ticks of the busiest source.
    pub frames: u64,
    /// How long it ran, s.
    pub seconds: f64,
}

impl Counters {
    /// Whether a node reports a metric of this name with a value above 0.5; `None` where none reports it.
    pub fn metric_is_on(&self, metric: &str) -> Option<bool> {
        let values = self.nodes.values().flat_map(|n| &n.metrics).filter(|(name, _)| name == metric);
        values.map(|(_, value)| *value > 0.5).reduce(|a, b| a || b)
    }

    /// The last faults of nodes that are bypassed since then; an edit opens such a node again.
    pub fn switched_off(&self) -> impl Iterator<Item = &Fault> {
        let rests = |fault: &&Fault| self.nodes.get(&fault.node).is_some_and(|node| node.fps == 0.0);
        self.faults.values().filter(|fault| fault.done == Action::Bypass).filter(rests)
    }
}

/// One point of a node's history.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Seconds since the window was opened.
    pub at_s: f64,
    /// Median time of a call, ms.
    pub p50_ms: f64,
    /// 99th percentile of the time of a call, ms.
    pub p99_ms: f64,
    /// Calls per second.
    pub fps: f64,
}

#[derive(Default)]
struct Mailbox {
    requests: HashMap<Output, PreviewRequest>,
    interval: Option<Duration>,
    /// The newest previews that the window has not taken yet.
    previews: HashMap<Output, RenderedPacket>,
    /// What is asked about the values of pictures, and the newest answers.
    probe_requests: HashMap<Output, ProbeRequest>,
    probes: HashMap<Output, Probe>,
    /// Which outputs are compared in numbers, and the newest numbers.
    compared: Option<ComparisonRequest>,
    comparison: Option<Comparison>,
    counters: Arc<Counters>,
    /// For each node, the time of the newest fault that the user has acknowledged, ms since 1970.
    acknowledged: HashMap<String, u64>,
}

impl Mailbox {
    /// Takes counters over, without faults that were acknowledged.
    fn set_counters(&mut self, mut counters: Counters) {
        let is_known = |fault: &Fault| self.acknowledged.get(&fault.node).is_some_and(|until| fault.unix_ms <= *until);
        counters.faults.retain(|_, fault| !is_known(fault));
        self.counters = Arc::new(counters);
    }
}

/// The observer's thread and its results.
pub struct Observer {
    handle: Handle,
    mailbox: Arc<Mutex<Mailbox>>,
    quit: Arc<AtomicBool>,
    rounds: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Observer {
    /// Starts the observer's thread.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn new(handle: Handle) -> std::io::Result<Self> {
        handle.first_previews().expect();
        let (mailbox, quit) = (Arc::<Mutex<Mailbox>>::default(), Arc::new(AtomicBool::new(false)));
        let rounds = Arc::new(AtomicU64::new(0));
        let worker = Worker {
            handle: handle.clone(),
            mailbox: Arc::clone(&mailbox),
            quit: Arc::clone(&quit),
            rounds: Arc::clone(&rounds),
            outputs: HashMap::new(),
            compared: None,
            generation: 0,
            window: Window::default(),
            start: Instant::now(),
            faults: FaultCursor::new(usize::MAX),
        };
        let thread = std::thread::Builder::new().name("observer".to_owned()).spawn(move || worker.run())?;
        Ok(Self { handle, mailbox, quit, rounds, thread: Some(thread) })
    }

    /// Sets which outputs are previewed, and the minimum time between two previews.
    pub fn set_requests(&self, requests: HashMap<Output, PreviewRequest>, interval: Duration) {
        let mut mailbox = lock(&self.mailbox);
        mailbox.interval = Some(interval);
        if mailbox.requests != requests {
            self.handle.first_previews().ask(requests.keys());
            mailbox.previews.retain(|output, _| requests.contains_key(output));
            mailbox.requests = requests;
        }
    }

    /// Takes the previews rendered since the last call.
    pub fn take(&self) -> HashMap<Output, RenderedPacket> {
        std::mem::take(&mut lock(&self.mailbox).previews)
    }

    /// Sets what is asked about the values of previewed pictures.
    pub fn set_probes(&self, requests: HashMap<Output, ProbeRequest>) {
        let mut mailbox = lock(&self.mailbox);
        if mailbox.probe_requests != requests {
            mailbox.probes.retain(|output, _| requests.contains_key(output));
            mailbox.probe_requests = requests;
        }
    }

    /// The newest values of pictures.
    pub fn probes(&self) -> HashMap<Output, Probe> {
        lock(&self.mailbox).probes.clone()
    }

    /// Sets which outputs are compared in numbers, tick by tick; both must be previewed.
    pub fn compare(&self, request: Option<ComparisonRequest>) {
        let mut mailbox = lock(&self.mailbox);
        if mailbox.compared != request {
            mailbox.compared = request;
            mailbox.comparison = None;
        }
    }

    /// How the newest packets of one tick of the compared outputs differ.
    pub fn comparison(&self) -> Option<Comparison> {
        lock(&self.mailbox).comparison
    }

    /// Takes the newest fault of a node, or of all nodes, out of the counters until there is another one. Returns how many there were.
    pub fn acknowledge(&self, node: Option<&str>) -> usize {
        let mut mailbox = lock(&self.mailbox);
        let counters = Counters::clone(&mailbox.counters);
        let faults = counters.faults.values().filter(|fault| node.is_none_or(|node| fault.node == node));
        let known: Vec<(String, u64)> = faults.map(|fault| (fault.node.clone(), fault.unix_ms)).collect();
        let count = known.len();
        mailbox.acknowledged.extend(known);
        mailbox.set_counters(counters);
        count
    }

    /// The newest counters.
    pub fn counters(&self) -> Arc<Counters> {
        Arc::clone(&lock(&self.mailbox).counters)
    }

    /// How often its thread has looked at the run: a number that stands still belongs to a thread that is stuck.
    pub fn rounds(&self) -> u64 {
        self.rounds.load(Ordering::Relaxed)
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.quit.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

struct Worker {
    handle: Handle,
    mailbox: Arc<Mutex<Mailbox>>,
    quit: Arc<AtomicBool>,
    rounds: Arc<AtomicU64>,
    outputs: HashMap<Output, OutputPreview>,
    /// The outputs and the tick that were compared last.
    compared: Option<(ComparisonRequest, u64)>,
    generation: u64,
    window: Window,
    start: Instant,
    faults: FaultCursor,
}

impl Worker {
    fn run(mut self) {
        let mut count_at = Instant::now();
        while !self.quit.load(Ordering::Acquire) {
            let began = Instant::now();
            self.rounds.fetch_add(1, Ordering::Relaxed);
            let mut changed = self.pictures();
            if began >= count_at {
                count_at = began + COUNTERS_INTERVAL;
                changed |= self.counters();
            }
            if changed {
                self.handle.wake();
            }
            let interval = lock(&self.mailbox).interval.unwrap_or(THUMBNAIL_INTERVAL);
            std::thread::park_timeout(interval.saturating_sub(began.elapsed()));
        }
    }

    /// Renders the newest packet of each requested output; returns whether there was one.
    fn pictures(&mut self) -> bool {
        let machine = self.handle.attachment().cloned();
        let (engine, generation) = self.handle.running();
        if machine.is_none() && engine.is_none() {
            return false;
        }
        let (requests, probes, compared, interval) = {
            let mailbox = lock(&self.mailbox);
            let interval = mailbox.interval.unwrap_or(THUMBNAIL_INTERVAL);
            (mailbox.requests.clone(), mailbox.probe_requests.clone(), mailbox.compared.clone(), interval)
        };
        // A node that was removed and added again needs a new subscription.
        if generation != self.generation {
            self.generation = generation;
            let first = self.handle.first_previews().take(generation).into_iter();
            self.outputs = first.map(|(output, preview)| (output, OutputPreview::new(Feed::Engine(preview)))).collect();
        }
        if let Some(machine) = &machine {
            machine.request_packets(wanted(&requests, compared.as_ref()), interval);
        }
        // A run of a batch ends: what nobody looks at now may be asked for then.
        let is_batch = engine.as_ref().is_some_and(|engine| engine.is_batch());
        let unwanted = self.outputs.keys().filter(|output| !is_batch && !requests.contains_key(*output));
        let removed: Vec<Output> = unwanted.cloned().collect();
        for output in removed {
            if let Some(mut view) = self.outputs.remove(&output) {
                view.set_confidence(None, None, engine.as_deref());
            }
            if let Some(engine) = &engine {
                engine.end_previews(&output.node);
            }
        }
        let mut changed = false;
        for output in requests.keys() {
            if !self.outputs.contains_key(output) {
                let Some(feed) = Feed::of(output, machine.as_ref(), engine.as_deref()) else { continue };
                self.outputs.insert(output.clone(), OutputPreview::new(feed));
            }
        }
        let mut of_one_tick = HashMap::new();
        let eyes = requests.iter().filter_map(|(output, request)| Some((output, request.pair.as_ref()?)));
        for (a, b) in eyes.chain(compared.as_ref().map(|pair| (&pair.output, &pair.other))) {
            if !of_one_tick.contains_key(a) {
                of_one_tick.extend(self.take_pair(a, b));
            }
        }
        let goes_on = engine.as_ref().is_none_or(|engine| !engine.is_finished());
        // New at one time, so that nobody takes one of two that belong together.
        let mut rendered = Vec::new();
        for (output, request) in requests {
            let Some(view) = self.outputs.get_mut(&output) else { continue };
            let asked = probes.get(&output);
            let is_compared = compared.as_ref().is_some_and(|pair| pair.is_of(&output));
            view.set_confidence(request.confidence.as_ref(), machine.as_ref(), engine.as_deref());
            let (packets, maps) = match (is_compared, &request.pair) {
                (true, _) => (PAIR_TICKS, PAIR_TICKS),
                (false, Some(_)) => (EYE_TICKS, CONFIDENCE_TICKS),
                (false, None) => (1, CONFIDENCE_TICKS),
            };
            view.keep(packets, maps);
            let fed = of_one_tick.remove(&output).map(|fed| view.measured(fed)).or_else(|| view.take(goes_on));
            let render = view.render(fed, &request, goes_on);
            if let Some(probe) = asked.and_then(|asked| view.probe(&request, asked)) {
                lock(&self.mailbox).probes.insert(output.clone(), probe);
                changed = true;
            }
            if let Some(render) = render {
                let (arrived_ns, size) = match view.elsewhere() {
                    Some((arrived_ns, size)) => (arrived_ns, size),
                    None => (engine.as_ref().and_then(|engine| engine.arrived_ns(&render.tick)), render.size),
                };
                rendered.push((output, RenderedPacket { arrived_ns, size, ..render }));
            }
        }
        changed |= !rendered.is_empty();
        lock(&self.mailbox).previews.extend(rendered);
        changed | compared.is_some_and(|pair| self.compare(pair))
    }

    /// The newest packets of one tick of two outputs.
    fn take_pair(&self, a: &Output, b: &Output) -> Vec<(Output, Fed)> {
        let (Some(first), Some(second)) = (self.outputs.get(a), self.outputs.get(b)) else { return Vec::new() };
        let found = first.feed.take_pair(&second.feed);
        found.into_iter().flat_map(|found| [a.clone(), b.clone()].into_iter().zip(found)).collect()
    }

    /// Compares two outputs, where their shown packets are of one tick; returns whether there is something new.
    fn compare(&mut self, pair: ComparisonRequest) -> bool {
        let shown = |output: &Output| self.outputs.get(output)?.last();
        let (Some(a), Some(b)) = (shown(&pair.output), shown(&pair.other)) else { return false };
        let (tick, other) = (a.frame().tick, b.frame().tick);
        let seq = tick.seq;
        let is_known = self.compared.as_ref().is_some_and(|(known, at)| (known, *at) == (&pair, seq));
        if (tick.source, seq) != (other.source, other.seq) || is_known {
            return false;
        }
        let measures = comparing::compare((a.frame(), a.bytes()), (b.frame(), b.bytes()), &pair.packet);
        lock(&self.mailbox).comparison = Some(Comparison { seq, measures });
        self.compared = Some((pair, seq));
        true
    }

    /// Counters of the last window of time; `None` while nothing runs.
    fn readings(&mut self) -> Option<BTreeMap<String, NodeWindow>> {
        match self.handle.attachment() {
            Some(machine) => Some(BTreeMap::clone(&machine.nodes())),
            None => Some(self.handle.engine()?.window(&mut self.window)),
        }
    }

    /// The run that is over with the times of its nodes; `None` while it is not.
    fn ended(&self) -> Option<(Over, BTreeMap<String, NodeWindow>)> {
        if !matches!(self.handle.status().phase, Phase::Ended | Phase::Failed(_)) {
            return None;
        }
        let report = self.handle.engine()?.report();
        let node = |(id, of_run): (String, NodeReport)| {
            let path = report.paths.get(&id);
            let window = NodeWindow {
                fps: 0.0,
                p50_ms: of_run.p50_ms,
                p99_ms: of_run.p99_ms,
                age_p50_ms: path.map(|path| path.age_p50_ms),
                age_p99_ms: path.map(|path| path.age_p99_ms),
                count: of_run.count,
                dropped: of_run.dropped,
                copies: of_run.copies,
                ..NodeWindow::default()
            };
            (id, window)
        };
        Some((Over { frames: report.frames, seconds: report.seconds }, report.nodes.into_iter().map(node).collect()))
    }

    /// The newest faults, oldest first; `None` if there are no new ones.
    fn new_faults(&mut self) -> Option<Vec<Fault>> {
        if let Some(machine) = self.handle.attachment() {
            return Some(Vec::clone(&machine.faults()));
        }
        let engine = self.handle.engine()?;
        engine.faults_since(&mut self.faults).then(|| self.faults.newest().cloned().collect())
    }

    /// Reads the counters; returns whether they changed.
    fn counters(&mut self) -> bool {
        let Some(nodes) = self.readings() else { return false };
        let old = Arc::clone(&lock(&self.mailbox).counters);
        let over = self.ended();
        let nodes = match &over {
            Some((_, of_run)) => {
                let of_run = of_run.clone().into_iter();
                // What the report does not have, metrics and restarts, is as it was last.
                let whole = of_run.map(|(id, run)| match nodes.get(&id) {
                    Some(last) => {
                        let (faults, restarts, metrics) = (last.faults, last.restarts, last.metrics.clone());
                        (id, NodeWindow { faults, restarts, metrics, queues: last.queues.clone(), ..run })
                    }
                    None => (id, run),
                });
                whole.collect()
            }
            None => nodes,
        };
        if old.nodes == nodes {
            return false;
        }
        let mut new = Counters { nodes, over: over.map(|(over, _)| over), ..Counters::clone(&old) };
        if let Some(faults) = self.new_faults() {
            new.fault_list = faults;
            new.faults = new.fault_list.iter().map(|f| (f.node.clone(), f.clone())).collect();
        }
        let at_s = self.start.elapsed().as_secs_f64();
        new.history.retain(|node, _| new.nodes.contains_key(node));
        for (id, node) in &new.nodes {
            let history = new.history.entry(id.clone()).or_default();
            if history.len() >= HISTORY {
                history.pop_front();
            }
            history.push_back(Point { at_s, p50_ms: node.p50_ms, p99_ms: node.p99_ms, fps: node.fps });
        }
        new.queues.retain(|end, _| new.nodes.contains_key(&end.node));
        for (id, node) in &new.nodes {
            for queue in &node.queues {
                let end = WireEnd { node: id.clone(), port: queue.port, index: queue.index };
                let history = new.queues.entry(end).or_default();
                if history.len() >= HISTORY {
                    history.pop_front();
                }
                history.push_back([at_s, queue.most as f64]);
            }
        }
        lock(&self.mailbox).set_counters(new);
        true
    }
}
