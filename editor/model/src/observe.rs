//! Looks at the running graph for the window: pictures five to ten times a second at most, counters twice. Runs on a thread of its own, so that the
//! window only ever takes what is ready.
//!
//! Of each output that is looked at, two frames at most are kept alive: the newest one, and the one that is being made ready.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_engine::fault::{Action, Fault};
use panoscope_engine::memory::FrameRef;
use panoscope_engine::{NodeWindow, Preview, Window};

use crate::picture::{self, Look, Range};
use crate::session::Handle;
use crate::surface::{self, Painter, Sight};
use panoscope_engine::sync::lock;

/// Shortest time from one picture of an output to the next, while one is shown large.
pub const LARGE_INTERVAL: Duration = Duration::from_millis(100);
/// The same for thumbnails: drawing the window costs more than making them.
pub const THUMBNAIL_INTERVAL: Duration = Duration::from_millis(200);
const COUNTERS_INTERVAL: Duration = Duration::from_millis(500);
/// Points of history per node: two minutes.
const HISTORY: usize = 240;

/// An output: node and port.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Output {
    /// The node.
    pub node: String,
    /// Its output.
    pub port: String,
}

impl Output {
    /// From its parts.
    pub fn new(node: &str, port: &str) -> Self {
        Self { node: node.to_owned(), port: port.to_owned() }
    }
}

impl std::fmt::Display for Output {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}", self.node, self.port)
    }
}

/// Where a wire ends: a place of an input.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct WireEnd {
    /// The node.
    pub node: String,
    /// Its input, a position among its type's.
    pub port: usize,
    /// Place in a list input.
    pub index: usize,
}

/// An output that someone wants to see.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wanted {
    /// Type of its packets.
    pub packet: String,
    /// Most pixels across.
    pub most_width: usize,
    /// Of a cloud: from where it is looked at as a surface; without it, it is shown as the camera saw it.
    pub sight: Option<Sight>,
    /// Of a cloud: its points are wanted, too.
    pub points: bool,
}

/// Counters of all nodes at one time.
#[derive(Clone, Debug, Default)]
pub struct Counters {
    /// By node.
    pub nodes: BTreeMap<String, NodeWindow>,
    /// Time of p50 and p99 in ms over the last two minutes, by node; oldest first, seconds since the window was opened.
    pub history: HashMap<String, VecDeque<Point>>,
    /// Most packets that waited on each wire between one look and the next, with seconds since the window was opened; oldest first.
    pub queues: BTreeMap<WireEnd, VecDeque<[f64; 2]>>,
    /// Newest fault of each node.
    pub faults: HashMap<String, Fault>,
    /// All faults that are remembered, oldest first.
    pub fault_list: Vec<Fault>,
}

impl Counters {
    /// Last faults of nodes that are left out since then, until an edit brings them back.
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
    /// 99 % took no longer, ms.
    pub p99_ms: f64,
    /// Calls per second.
    pub fps: f64,
}

#[derive(Default)]
struct Board {
    wanted: HashMap<Output, Wanted>,
    interval: Option<Duration>,
    /// Newest looks that were not taken yet.
    looks: HashMap<Output, Look>,
    counters: Arc<Counters>,
}

/// The observer's thread and what it saw.
pub struct Observer {
    board: Arc<Mutex<Board>>,
    quit: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Observer {
    /// Starts looking.
    ///
    /// # Errors
    /// The system gave no thread.
    pub fn new(handle: Handle) -> std::io::Result<Self> {
        let (board, quit) = (Arc::<Mutex<Board>>::default(), Arc::new(AtomicBool::new(false)));
        let eye = Eye {
            handle,
            board: Arc::clone(&board),
            quit: Arc::clone(&quit),
            views: HashMap::new(),
            generation: 0,
            window: Window::default(),
            start: Instant::now(),
            faults_seen: 0,
        };
        let thread = std::thread::Builder::new().name("observer".to_owned()).spawn(move || eye.run())?;
        Ok(Self { board, quit, thread: Some(thread) })
    }

    /// Says which outputs are to be seen from now on, and how often.
    pub fn want(&self, wanted: HashMap<Output, Wanted>, interval: Duration) {
        let mut board = lock(&self.board);
        board.interval = Some(interval);
        if board.wanted != wanted {
            board.looks.retain(|output, _| wanted.contains_key(output));
            board.wanted = wanted;
        }
    }

    /// What came since the last call.
    pub fn take(&self) -> HashMap<Output, Look> {
        std::mem::take(&mut lock(&self.board).looks)
    }

    /// The newest counters.
    pub fn counters(&self) -> Arc<Counters> {
        Arc::clone(&lock(&self.board).counters)
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

struct View {
    preview: Preview,
    range: Range,
    /// Of a surface: what was painted last, to be painted again when it is turned.
    surface: Option<Surface>,
}

impl View {
    /// The newest packet made ready, if there is one, or if it is to be looked at from elsewhere.
    fn look(&mut self, want: &Wanted) -> Option<Look> {
        let frame = self.preview.take();
        let Some(sight) = &want.sight else {
            self.surface = None;
            let frame = frame?;
            let mut look = picture::look(&frame, &want.packet, want.most_width, &mut self.range);
            if want.points {
                look.cloud = surface::cloud_of(frame.frame(), frame.bytes()).map(Arc::new);
            }
            return Some(look);
        };
        let next = match (frame, self.surface.take()) {
            (Some(frame), old) => {
                let painter = old.map(|s| s.painter).unwrap_or_default();
                Surface { sight: *sight, frame, painter }
            }
            (None, Some(old)) if old.sight != *sight => Surface { sight: *sight, ..old },
            (None, old) => {
                self.surface = old;
                return None;
            }
        };
        let surface = self.surface.insert(next);
        let (frame, bytes) = (surface.frame.frame(), surface.frame.bytes());
        let mut look = Look::of_tick(frame);
        if let Some((pixels, painted)) = surface.painter.paint(frame, bytes, sight) {
            (look.pixels, look.painted) = (Some(pixels), painted);
        }
        Some(look)
    }
}

struct Surface {
    sight: Sight,
    frame: FrameRef,
    painter: Painter,
}

struct Eye {
    handle: Handle,
    board: Arc<Mutex<Board>>,
    quit: Arc<AtomicBool>,
    views: HashMap<Output, View>,
    generation: u64,
    window: Window,
    start: Instant,
    faults_seen: u64,
}

impl Eye {
    fn run(mut self) {
        let mut count_at = Instant::now();
        while !self.quit.load(Ordering::Acquire) {
            let began = Instant::now();
            let mut news = self.pictures();
            if began >= count_at {
                count_at = began + COUNTERS_INTERVAL;
                news |= self.counters();
            }
            if news {
                self.handle.wake();
            }
            let interval = lock(&self.board).interval.unwrap_or(THUMBNAIL_INTERVAL);
            std::thread::park_timeout(interval.saturating_sub(began.elapsed()));
        }
    }

    /// Takes the newest frame of each wanted output; answers whether there was one.
    fn pictures(&mut self) -> bool {
        let Some(engine) = self.handle.engine() else { return false };
        let generation = self.handle.status().generation;
        let wanted = lock(&self.board).wanted.clone();
        // A node that was removed and added again is another one.
        if generation != self.generation {
            self.generation = generation;
            self.views.clear();
        }
        let gone: Vec<Output> = self.views.keys().filter(|o| !wanted.contains_key(*o)).cloned().collect();
        for output in gone {
            self.views.remove(&output);
            engine.end_previews(&output.node);
        }
        let mut news = false;
        for (output, want) in wanted {
            if !self.views.contains_key(&output) {
                let Some(preview) = engine.preview(&output.node, &output.port) else { continue };
                self.views.insert(output.clone(), View { preview, range: None, surface: None });
            }
            let Some(view) = self.views.get_mut(&output) else { continue };
            if let Some(look) = view.look(&want) {
                let ingest_ns = engine.ingest_ns(&look.tick);
                lock(&self.board).looks.insert(output, Look { ingest_ns, ..look });
                news = true;
            }
        }
        news
    }

    /// Reads the counters; answers whether they moved.
    fn counters(&mut self) -> bool {
        let Some(engine) = self.handle.engine() else { return false };
        let nodes = engine.window(&mut self.window);
        let old = Arc::clone(&lock(&self.board).counters);
        if old.nodes == nodes {
            return false;
        }
        let faults: u64 = nodes.values().map(|n| n.faults + n.restarts).sum();
        let mut new = Counters { nodes, ..Counters::clone(&old) };
        // A withheld packet is a fault that no counter shows, so look now and then without a reason as well.
        if faults != self.faults_seen || new.history.values().next().is_none_or(|h| h.len() % 4 == 0) {
            self.faults_seen = faults;
            new.fault_list = engine.recent_faults();
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
        lock(&self.board).counters = Arc::new(new);
        true
    }
}
