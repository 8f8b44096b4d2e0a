//! The running side: listens for windows and serves their requests. Nothing here waits for a window.

use std::collections::{BTreeMap, HashMap};
use std::io::BufReader;
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::Child;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::isolate::system_ns;
use crate::loader::Live;
use crate::loader::live::LiveError;
use crate::loader::sealed::readable;
use panoscope_engine::fault::FaultCursor;
use panoscope_engine::memory::FrameRef;
use panoscope_engine::sync::lock;
use panoscope_engine::{ApplyError, Engine, NodeWindow, Preview, Window, clock};
use panoscope_graph::ParamValue;

use crate::attach::message::{self, Command, Message, Opened, Refused, Wanted};
use crate::attach::packet::Outgoing;
use crate::attach::queue::Queue;
use crate::attach::tunnel::{self, Frame, Kind};
use crate::attach::{PAIR_TICKS, program, rules};

/// Maximum number of unacknowledged packets of one output.
const MAX_UNDERWAY: u32 = 2;
/// Time between two polls of the previews.
const STEP: Duration = Duration::from_millis(10);
/// Time between two polls while no window is attached.
const IDLE: Duration = Duration::from_millis(100);
/// Time between two readings of counters and values.
const READ_EVERY: Duration = Duration::from_millis(500);
/// Time until the listening program is restarted.
const START_AGAIN: Duration = Duration::from_secs(1);
/// Maximum number of faults sent to a window.
const MAX_FAULTS: usize = 200;
/// Maximum number of waiting edits; further ones are refused.
const MAX_EDITS: usize = 16;

/// Settings for windows that attach to a graph.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Address to listen on: `tls/IP:PORT`, or `tcp/127.0.0.1:PORT` inside one machine.
    pub address: String,
    /// Name of this machine for windows; default: the name in its keys.
    pub name: Option<String>,
    /// Folder with the keys of this machine; default: `PANOSCOPE_KEYS`.
    pub keys: Option<PathBuf>,
    /// Whether an address without encryption may be reachable from other machines.
    pub plaintext: bool,
    /// Machines whose windows may read, by the names in their certificates.
    pub readers: Vec<String>,
    /// Machines whose windows may read and edit.
    pub editors: Vec<String>,
}

/// Windows cannot attach.
#[derive(Debug, thiserror::Error)]
pub enum AttachError {
    /// The listening program does not start.
    #[error("windows cannot attach: {0}")]
    Start(#[from] std::io::Error),
    /// The listening program cannot listen.
    #[error("windows cannot attach at {address}: {words}")]
    Listen {
        /// The address to listen on.
        address: String,
        /// Reason that the program reported.
        words: String,
    },
}

/// An output whose packets a window receives.
struct Feed {
    wanted: Wanted,
    preview: Preview,
    underway: u32,
    /// Time when the last packet was sent.
    at: Option<Instant>,
}

impl Feed {
    /// Whether it may send now.
    fn is_due(&self, interval: Duration) -> bool {
        self.underway < MAX_UNDERWAY && self.at.is_none_or(|at| at.elapsed() >= interval)
    }

    /// Notes that a packet is sent.
    fn sends(&mut self, packet: FrameRef, is_first: bool) -> Sent {
        (self.underway, self.at) = (self.underway + 1, Some(Instant::now()));
        Sent { wanted: self.wanted.clone(), packet, is_first }
    }
}

/// A packet on its way to a window.
struct Sent {
    wanted: Wanted,
    packet: FrameRef,
    /// Whether the next one is of the same tick.
    is_first: bool,
}

/// Packets of the outputs that are due. Two outputs of a group are due together, and send packets of one tick if there are any.
fn due(feeds: &mut [Feed], interval: Duration) -> Vec<Sent> {
    let mut groups: BTreeMap<u32, Vec<&mut Feed>> = BTreeMap::new();
    feeds.iter_mut().for_each(|feed| groups.entry(feed.wanted.group).or_default().push(feed));
    let mut sent = Vec::new();
    for (group, mut feeds) in groups {
        if let [a, b] = &mut feeds[..]
            && group != 0
        {
            if !a.is_due(interval) || !b.is_due(interval) {
                continue;
            }
            if let Some((first, second)) = a.preview.take_pair(&b.preview) {
                sent.extend([a.sends(first, true), b.sends(second, false)]);
                continue;
            }
        }
        let due = feeds.into_iter().filter(|feed| feed.is_due(interval));
        sent.extend(due.filter_map(|feed| feed.preview.take().map(|packet| feed.sends(packet, false))));
    }
    sent
}

/// An attached window.
struct Session {
    host: String,
    may_edit: bool,
    wanted: Vec<Wanted>,
    interval: Duration,
    feeds: Vec<Feed>,
    /// Whether it has to be sent the current graph.
    lacks_graph: bool,
    /// Whether it has to be sent the current counters and values.
    lacks_counters: bool,
}

struct Edit {
    session: u32,
    id: u64,
    base: String,
    text: String,
}

#[derive(Default)]
struct State {
    sessions: HashMap<u32, Session>,
    edits: Vec<Edit>,
    /// Lines for the log about windows that came and went.
    lines: Vec<String>,
    ended_previews: Vec<String>,
}

struct Shared {
    options: Options,
    state: Mutex<State>,
    /// Frames for the listening program.
    out: Mutex<Arc<Queue>>,
    ends: AtomicBool,
    /// Whether the listening program stopped reading.
    is_stuck: AtomicBool,
    /// Socket of the listening program, used to end it.
    socket: Mutex<Option<UnixStream>>,
}

/// State of the run's thread.
struct Known {
    text: String,
    changed_by: String,
    window: Window,
    read_at: Option<Instant>,
    nodes: BTreeMap<String, NodeWindow>,
    faults: FaultCursor,
    values: BTreeMap<String, Vec<ParamValue>>,
}

/// A running graph to which windows of other machines attach, until this is dropped.
pub struct Attachable {
    shared: Arc<Shared>,
    known: Mutex<Known>,
    name: String,
}

/// Starts the listening program and waits until it listens. Also returns the name of this machine.
fn start(options: &Options) -> Result<(Child, UnixStream, String), AttachError> {
    let keys = options.keys.as_ref().map_or_else(String::new, |keys| keys.display().to_string());
    let name = options.name.clone().unwrap_or_default();
    let mut arguments =
        vec![tunnel::ATTACHABLE.to_owned(), name, options.address.clone(), keys, options.plaintext.to_string()];
    let mut hosts: Vec<String> = options.readers.iter().chain(&options.editors).cloned().collect();
    hosts.sort();
    hosts.dedup();
    arguments.extend(hosts);
    let (mut child, mut socket) = program::start(&arguments, None)?;
    match tunnel::receive(&mut socket) {
        Ok(Some(frame)) if frame.kind == Kind::Ready => Ok((child, socket, frame.text())),
        _ => {
            drop(socket);
            let words = program::last_words(&mut child);
            let _ = child.wait();
            let words = words.unwrap_or_else(|| "the program that listens ended without a word".to_owned());
            Err(AttachError::Listen { address: options.address.clone(), words })
        }
    }
}

impl Attachable {
    /// Starts to listen.
    ///
    /// # Errors
    /// The address cannot be used, or keys are missing.
    pub fn start(options: Options) -> Result<Self, AttachError> {
        let (child, socket, name) = start(&options)?;
        let shared = Arc::new(Shared {
            options,
            state: Mutex::default(),
            out: Mutex::default(),
            ends: AtomicBool::new(false),
            is_stuck: AtomicBool::new(false),
            socket: Mutex::default(),
        });
        let mine = Arc::clone(&shared);
        std::thread::Builder::new().name("attachable".to_owned()).spawn(move || mine.listen(child, socket))?;
        let known = Known {
            text: String::new(),
            changed_by: String::new(),
            window: Window::default(),
            read_at: None,
            nodes: BTreeMap::new(),
            faults: FaultCursor::new(MAX_FAULTS),
            values: BTreeMap::new(),
        };
        Ok(Self { shared, known: Mutex::new(known), name })
    }

    /// Name of this machine for windows.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Applies edits of windows and sends changes to them. Call it about ten times a second, on the thread that changes
    /// the graph. Returns lines for the log.
    pub fn update(&self, live: &mut Live) -> Vec<String> {
        let mut known = lock(&self.known);
        let known = &mut *known;
        let mut lines = self.apply(live, known);
        if known.text != live.text() {
            live.text().clone_into(&mut known.text);
            lock(&self.shared.state).sessions.values_mut().for_each(|session| session.lacks_graph = true);
        }
        self.send_graph(live, known);
        self.read(live.engine(), known);
        self.subscribe(live.engine());
        lines.append(&mut lock(&self.shared.state).lines);
        lines
    }

    /// Applies the received edits in order.
    fn apply(&self, live: &mut Live, known: &mut Known) -> Vec<String> {
        let edits = std::mem::take(&mut lock(&self.shared.state).edits);
        let mut lines = Vec::new();
        for Edit { session, id, base, text } in edits {
            let from = lock(&self.shared.state).sessions.get(&session).map(|s| (s.host.clone(), s.may_edit));
            let Some((host, may_edit)) = from else { continue };
            let result = if may_edit { change(live, &base, &text) } else { Err(only_reads(&host)) };
            match &result {
                Ok(words) => {
                    lines.push(format!("changed by a window on `{host}`: {words}"));
                    known.changed_by = format!("a window on `{host}`");
                }
                Err(why) => lines.push(format!("a change by a window on `{host}` is refused: {}", why.words)),
            }
            self.shared.send(session, &Message::Ran { id, result });
        }
        lines
    }

    /// Sends the graph to windows that do not have it.
    fn send_graph(&self, live: &Live, known: &Known) {
        let mut state = lock(&self.shared.state);
        if !state.sessions.values().any(|session| session.lacks_graph) {
            return;
        }
        let graph = live.engine().graph();
        let mut catalog = live.loader().catalog_of_graph(&graph);
        catalog.offers.clear();
        for (id, session) in state.sessions.iter_mut().filter(|(_, session)| session.lacks_graph) {
            session.lacks_graph = false;
            let opened = Opened {
                text: known.text.clone(),
                graph: graph.clone(),
                catalog: catalog.clone(),
                may_edit: session.may_edit,
                changed_by: known.changed_by.clone(),
            };
            // Nodes that were replaced need new subscriptions.
            session.feeds.clear();
            self.shared.send(*id, &Message::Opened(Box::new(opened)));
        }
    }

    /// Reads counters, faults and values at intervals and sends those that changed.
    fn read(&self, engine: &Engine, known: &mut Known) {
        let now = Instant::now();
        let is_empty = lock(&self.shared.state).sessions.is_empty();
        let is_time = known.read_at.is_none_or(|at| now.duration_since(at) >= READ_EVERY);
        if is_empty || !is_time {
            return;
        }
        known.read_at = Some(now);
        let nodes = engine.window(&mut known.window);
        let nodes: BTreeMap<_, _> = nodes.into_iter().map(|(id, node)| (id, node.finite())).collect();
        let of = |node: &String| Some((node.clone(), engine.param_values(node)?));
        let values: BTreeMap<_, _> = nodes.keys().filter_map(of).collect();
        let changed = (nodes != known.nodes, engine.faults_since(&mut known.faults), values != known.values);
        (known.nodes, known.values) = (nodes, values);
        let mut state = lock(&self.shared.state);
        for (id, session) in &mut state.sessions {
            let lacks = std::mem::take(&mut session.lacks_counters);
            if changed.0 || lacks {
                self.shared.send(*id, &Message::Counters(known.nodes.clone()));
            }
            if changed.1 || lacks {
                self.shared.send(*id, &Message::Faults(known.faults.newest().cloned().collect()));
            }
            if changed.2 || lacks {
                self.shared.send(*id, &Message::Values(known.values.clone()));
            }
        }
    }

    /// Updates the previews to those that windows request.
    fn subscribe(&self, engine: &Engine) {
        let mut state = lock(&self.shared.state);
        let mut ended = std::mem::take(&mut state.ended_previews);
        for session in state.sessions.values_mut().filter(|session| !session.lacks_graph) {
            let Session { wanted, feeds, .. } = session;
            feeds.retain(|feed| {
                let stays = wanted.contains(&feed.wanted);
                ended.extend((!stays).then(|| feed.wanted.node.clone()));
                stays
            });
            for one in wanted.iter() {
                if feeds.iter().all(|feed| feed.wanted != *one)
                    && let Some(preview) = engine.preview(&one.node, &one.port)
                {
                    preview.keep(if one.group == 0 { 1 } else { PAIR_TICKS });
                    feeds.push(Feed { wanted: one.clone(), preview, underway: 0, at: None });
                }
            }
        }
        drop(state);
        ended.sort();
        ended.dedup();
        ended.iter().for_each(|node| engine.end_previews(node));
    }

    /// Sends packets to windows until [`Self::finish`]; on a separate thread, so that a change of the graph does not
    /// delay packets.
    pub fn send_packets(&self, engine: &Engine) {
        let mut taken = Vec::new();
        while !self.shared.ends.load(Ordering::Acquire) {
            let mut is_idle = true;
            for (id, session) in &mut lock(&self.shared.state).sessions {
                is_idle = false;
                taken.extend(due(&mut session.feeds, session.interval).into_iter().map(|sent| (*id, sent)));
            }
            for (id, Sent { wanted, packet: frame, is_first }) in taken.drain(..) {
                let now_ns = i64::try_from(clock::now_ns()).unwrap_or(i64::MAX);
                let age_ns = engine.arrived_ns(&frame.tick()).map(|arrived_ns| now_ns.saturating_sub(arrived_ns));
                let output = (wanted.node.as_str(), wanted.port.as_str());
                if let Some(packet) = Outgoing::of(output, &frame, wanted.max_width, age_ns, system_ns()) {
                    let bytes = message::write_packet(&packet.first(is_first));
                    self.shared.put(Frame { kind: Kind::Data, session: id, bytes });
                }
            }
            std::thread::sleep(if is_idle { IDLE } else { STEP });
        }
    }

    /// Tells windows that the run is over, and ends [`Self::send_packets`].
    pub fn finish(&self, words: &str) {
        let sessions: Vec<u32> = lock(&self.shared.state).sessions.keys().copied().collect();
        let message = Message::Ended { words: words.to_owned() };
        sessions.iter().for_each(|id| self.shared.send(*id, &message));
        self.shared.ends.store(true, Ordering::Release);
    }
}

impl Drop for Attachable {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Release);
        // The last messages are written first: the writer ends with its queue.
        lock(&self.shared.out).close();
        std::thread::sleep(STEP);
        if let Some(socket) = &*lock(&self.shared.socket) {
            let _ = socket.shutdown(Shutdown::Both);
        }
    }
}

/// Refuses an edit of a window that may only read.
fn only_reads(host: &str) -> Refused {
    let words = format!("windows on `{host}` only read: it is not among the machines of --allow-edit");
    Refused { node: None, words }
}

/// Changes the running graph, or says why not.
fn change(live: &mut Live, base: &str, text: &str) -> Result<String, Refused> {
    let plain = |words: String| Refused { node: None, words };
    if base != live.text() {
        return Err(plain("the graph was changed elsewhere meanwhile; review it and change it again".to_owned()));
    }
    rules::check(live.text(), text).map_err(|error| plain(error.to_string()))?;
    live.apply_text(text).map(|applied| applied.to_string()).map_err(|error| {
        let node = match &error {
            LiveError::Apply(
                ApplyError::Open { node, .. }
                | ApplyError::NoReturn { node, .. }
                | ApplyError::Busy { node, .. }
                | ApplyError::Memory { node, .. },
            ) => Some(node.clone()),
            _ => None,
        };
        Refused { node, words: readable(&error.to_string()) }
    })
}

impl Shared {
    fn put(&self, frame: Frame) {
        let full = lock(&self.out).push(frame);
        // A program that reads nothing any more is ended and started again, and windows come back.
        if full.is_err()
            && let Some(socket) = &*lock(&self.socket)
        {
            self.is_stuck.store(true, Ordering::Release);
            let _ = socket.shutdown(Shutdown::Both);
        }
    }

    fn send(&self, session: u32, message: &Message) {
        self.put(Frame { kind: Kind::Data, session, bytes: message::write_message(message) });
    }

    /// Restarts the listening program whenever it ends.
    fn listen(self: &Arc<Self>, child: Child, socket: UnixStream) {
        let mut running = Some((child, socket));
        while !self.ends.load(Ordering::Acquire) {
            if let Some((mut child, socket)) = running.take() {
                self.serve(socket);
                if self.is_stuck.swap(false, Ordering::AcqRel) {
                    let _ = child.kill();
                }
                let words = program::last_words(&mut child);
                let _ = child.wait();
                if self.ends.load(Ordering::Acquire) {
                    return;
                }
                let mut state = lock(&self.state);
                let gone: Vec<Session> = state.sessions.drain().map(|(_, session)| session).collect();
                let nodes = gone.iter().flat_map(|session| session.feeds.iter().map(|feed| feed.wanted.node.clone()));
                state.ended_previews.extend(nodes);
                let why = words.unwrap_or_else(|| "it ended".to_owned());
                state.lines.push(format!("warning: no window can attach for now: {why}; listening again soon"));
            }
            std::thread::sleep(START_AGAIN);
            running = start(&self.options).ok().map(|(child, socket, _)| (child, socket));
        }
    }

    /// Receives frames until the listening program ends.
    fn serve(self: &Arc<Self>, socket: UnixStream) {
        let (Ok(to), Ok(from)) = (socket.try_clone(), socket.try_clone()) else { return };
        *lock(&self.socket) = Some(socket);
        let out = Arc::new(Queue::default());
        *lock(&self.out) = Arc::clone(&out);
        let frames = Arc::clone(&out);
        let writer = std::thread::Builder::new().name("attachable out".to_owned()).spawn(move || write(to, &frames));
        if writer.is_ok() {
            let mut from = BufReader::new(from);
            while let Ok(Some(frame)) = tunnel::receive(&mut from) {
                self.take(frame);
            }
        }
        // A program that is being started again has no windows: what is sent meanwhile is dropped.
        out.close();
    }

    fn take(&self, frame: Frame) {
        let mut state = lock(&self.state);
        let state = &mut *state;
        match frame.kind {
            Kind::Open => {
                let host = frame.text();
                let may_edit = self.options.editors.contains(&host);
                let rights = if may_edit { "reads and edits" } else { "reads" };
                state.lines.push(format!("a window on `{host}` is attached; it {rights}"));
                let session = Session {
                    host,
                    may_edit,
                    wanted: Vec::new(),
                    interval: Duration::from_millis(100),
                    feeds: Vec::new(),
                    lacks_graph: true,
                    lacks_counters: true,
                };
                state.sessions.insert(frame.session, session);
            }
            Kind::Close => {
                if let Some(session) = state.sessions.remove(&frame.session) {
                    state.ended_previews.extend(session.feeds.iter().map(|feed| feed.wanted.node.clone()));
                    state.lines.push(format!("the window on `{}` is gone: {}", session.host, frame.text()));
                }
            }
            Kind::Data => match message::read_command(&frame.bytes) {
                Ok(command) => self.obey(state, frame.session, command),
                Err(error) => {
                    if let Some(session) = state.sessions.remove(&frame.session) {
                        state.lines.push(format!("the window on `{}` is let go: {error}", session.host));
                    }
                    self.put(Frame::words(Kind::Close, frame.session, &error.to_string()));
                }
            },
            Kind::Ready | Kind::Clock => {}
        }
    }

    fn obey(&self, state: &mut State, id: u32, command: Command) {
        let Some(session) = state.sessions.get_mut(&id) else { return };
        match command {
            Command::Preview { wanted, interval_ms } => {
                session.wanted = wanted;
                session.interval = Duration::from_millis(interval_ms.clamp(10, 10_000));
            }
            Command::Taken { node, port } => {
                let of = |feed: &&mut Feed| feed.wanted.node == node && feed.wanted.port == port;
                session.feeds.iter_mut().filter(of).for_each(|feed| feed.underway = feed.underway.saturating_sub(1));
            }
            Command::Run { id: edit, base, text } => {
                if state.edits.len() < MAX_EDITS {
                    state.edits.push(Edit { session: id, id: edit, base, text });
                } else {
                    let words = "too many changes wait; try again".to_owned();
                    self.send(id, &Message::Ran { id: edit, result: Err(Refused { node: None, words }) });
                }
            }
        }
    }
}

/// Writes frames until their queue or the socket is closed.
fn write(mut to: UnixStream, frames: &Queue) {
    while let Some(frame) = frames.pop() {
        if tunnel::send(&mut to, &frame).is_err() {
            frames.close();
            return;
        }
    }
}
