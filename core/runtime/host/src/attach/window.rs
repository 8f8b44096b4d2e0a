//! The window's side: keeps a connection to a running graph of another machine, and the newest data from it. No
//! function waits unless it says so.

use std::collections::{BTreeMap, HashMap};
use std::io::{self, BufReader};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::process::Child;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::isolate::system_ns;
use panoscope_engine::fault::Fault;
use panoscope_engine::sync::lock;
use panoscope_engine::{NodeWindow, clock};
use panoscope_graph::ParamValue;

use crate::attach::message::{self, BadMessage, Command, Incoming, Message, Opened, Refused, Wanted};
use crate::attach::packet::Packet;
use crate::attach::program;
use crate::attach::target::Target;
use crate::attach::tunnel::{self, ClockFrame, Frame, Kind};

/// Time until the next attempt to connect.
const AGAIN: Duration = Duration::from_millis(200);
/// Maximum time of a change.
const MAX_CHANGE: Duration = Duration::from_secs(60);

/// State of the connection to the machine.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Contact {
    /// Not connected yet; the last attempt failed for this reason.
    #[default]
    None,
    /// Connected.
    Attached,
    /// The connection was lost for this reason; attempts to reconnect go on.
    Lost(String),
    /// The run has ended there, with the machine's reason.
    Ended(String),
}

/// The clock of the machine, measured continuously.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clock {
    /// Its monotonic clock minus this machine's, ns.
    pub offset_ns: i64,
    /// Maximum error of the offset, ns.
    pub error_ns: u64,
    /// Round-trip time, ns.
    pub round_trip_ns: u64,
}

/// State of the connection and of its graph.
#[derive(Clone, Debug, Default)]
pub struct State {
    /// Whether there is a connection.
    pub contact: Contact,
    /// Reason of the last failed attempt; empty while connected.
    pub problem: String,
    /// Name under which the other machine knows this one.
    pub here: String,
    /// Number of lost connections.
    pub losses: u64,
    /// Time of the last change of `contact`.
    pub since: Option<Instant>,
    /// The running graph; `None` before the first contact.
    pub opened: Option<Arc<Opened>>,
    /// Incremented with each `opened`.
    pub revision: u64,
    /// The machine's clock; `None` before the first measurement of a connection.
    pub clock: Option<Clock>,
}

/// Result of an edit: a description of the change, or the refusal.
pub type Edit = Result<String, Refused>;

/// Called when something has changed.
type Wake = dyn Fn() + Send + Sync;

#[derive(Default)]
struct Inner {
    state: State,
    nodes: Arc<BTreeMap<String, NodeWindow>>,
    faults: Arc<Vec<Fault>>,
    values: HashMap<String, Vec<ParamValue>>,
    /// The newest packet of each output, and when its light arrived, ns of this process's clock.
    packets: HashMap<(String, String), (Packet, Option<i64>)>,
    /// The first of two packets of one tick, until the second one arrives: both are new at one time.
    first: Option<(Packet, Option<i64>)>,
    wanted: Vec<Wanted>,
    interval_ms: u64,
    answers: HashMap<u64, Edit>,
    next_id: u64,
    /// Frames for the connecting program, while it runs.
    out: Option<Sender<Frame>>,
    socket: Option<UnixStream>,
    ends: bool,
}

struct Shared {
    target: Target,
    inner: Mutex<Inner>,
    changed: Condvar,
    wake: Mutex<Option<Arc<Wake>>>,
}

/// A connection to a running graph of another machine. It reconnects whenever it is lost, until this is dropped.
pub struct Attachment {
    shared: Arc<Shared>,
}

impl Attachment {
    /// Starts to connect.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn open(target: Target) -> io::Result<Self> {
        let inner = Inner { interval_ms: 200, ..Inner::default() };
        let shared =
            Arc::new(Shared { target, inner: Mutex::new(inner), changed: Condvar::new(), wake: Mutex::default() });
        let mine = Arc::clone(&shared);
        std::thread::Builder::new().name("attachment".to_owned()).spawn(move || mine.keep())?;
        Ok(Self { shared })
    }

    /// Sets the function that is called when something has changed.
    pub fn set_wake(&self, wake: Arc<Wake>) {
        *lock(&self.shared.wake) = Some(wake);
    }

    /// The machine.
    pub fn target(&self) -> &Target {
        &self.shared.target
    }

    /// State of the connection and of its graph.
    pub fn state(&self) -> State {
        lock(&self.shared.inner).state.clone()
    }

    /// Waits up to `most` for the first graph. Returns whether there is one.
    pub fn wait_opened(&self, most: Duration) -> bool {
        let inner = lock(&self.shared.inner);
        let waited = self.shared.changed.wait_timeout_while(inner, most, |inner| inner.state.opened.is_none());
        waited.unwrap_or_else(PoisonError::into_inner).0.state.opened.is_some()
    }

    /// Counters and times of each node.
    pub fn nodes(&self) -> Arc<BTreeMap<String, NodeWindow>> {
        Arc::clone(&lock(&self.shared.inner).nodes)
    }

    /// The newest faults, oldest first.
    pub fn faults(&self) -> Arc<Vec<Fault>> {
        Arc::clone(&lock(&self.shared.inner).faults)
    }

    /// Values of a node's parameters; `None` while they are unknown.
    pub fn values(&self, node: &str) -> Option<Vec<ParamValue>> {
        lock(&self.shared.inner).values.get(node).cloned()
    }

    /// Sets which outputs send packets, and the minimum time between two packets of an output.
    pub fn request_packets(&self, mut wanted: Vec<Wanted>, interval: Duration) {
        wanted.sort();
        wanted.truncate(message::MAX_OUTPUTS);
        let interval_ms = u64::try_from(interval.as_millis()).unwrap_or(u64::MAX);
        let mut inner = lock(&self.shared.inner);
        if inner.wanted != wanted || inner.interval_ms != interval_ms {
            inner.packets.retain(|(node, port), _| wanted.iter().any(|one| one.node == *node && one.port == *port));
            (inner.wanted, inner.interval_ms) = (wanted, interval_ms);
            inner.send_wanted();
        }
    }

    /// The newest packet of an output since the last call, and the latest possible arrival of its light, ns of this
    /// process's clock.
    pub fn take_packet(&self, node: &str, port: &str) -> Option<(Packet, Option<i64>)> {
        lock(&self.shared.inner).give((node, port))
    }

    /// The newest packets of two compared outputs, where they are of one tick and neither was taken; as in [`Self::take_packet`].
    pub fn take_pair(&self, outputs: [(&str, &str); 2]) -> Option<[(Packet, Option<i64>); 2]> {
        let mut inner = lock(&self.shared.inner);
        let tick = |(node, port): (&str, &str)| {
            let packet = &inner.packets.get(&(node.to_owned(), port.to_owned()))?.0;
            Some((packet.frame.tick().source, packet.frame.tick().seq))
        };
        let [a, b] = outputs.map(tick);
        if a.is_none() || a != b {
            return None;
        }
        let [a, b] = outputs.map(|output| inner.give(output));
        Some([a?, b?])
    }

    /// Replaces the running graph by the one in `text`, which was edited from `base`, and waits for the answer as long
    /// as `goes_on`, which is polled, returns `true`.
    pub fn run(&self, base: &str, text: &str, goes_on: impl Fn() -> bool) -> Edit {
        let lost = |words: &str| Err(Refused { node: None, words: words.to_owned() });
        let mut inner = lock(&self.shared.inner);
        inner.next_id += 1;
        let id = inner.next_id;
        if inner.out.is_none() || inner.state.contact != Contact::Attached {
            return lost("the machine is not connected: nothing was changed");
        }
        let losses = inner.state.losses;
        inner.send(&Command::Run { id, base: base.to_owned(), text: text.to_owned() });
        let until = Instant::now() + MAX_CHANGE;
        loop {
            if let Some(answer) = inner.answers.remove(&id) {
                return answer;
            }
            if inner.state.losses != losses || inner.state.contact != Contact::Attached {
                return lost("the connection was lost: whether the change was made shows when it is back");
            }
            if Instant::now() > until || !goes_on() {
                return lost("the machine did not answer: whether the change was made shows in its graph");
            }
            let wait = self.shared.changed.wait_timeout(inner, Duration::from_millis(100));
            inner = wait.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Drop for Attachment {
    fn drop(&mut self) {
        let mut inner = lock(&self.shared.inner);
        inner.ends = true;
        if let Some(socket) = &inner.socket {
            let _ = socket.shutdown(Shutdown::Both);
        }
        drop(inner);
        self.shared.changed.notify_all();
    }
}

impl Inner {
    fn send(&self, command: &Command) {
        if let Some(out) = &self.out {
            let _ = out.send(Frame { kind: Kind::Data, session: 0, bytes: message::write_command(command) });
        }
    }

    /// Hands out the newest packet of an output, which is underway no more.
    fn give(&mut self, (node, port): (&str, &str)) -> Option<(Packet, Option<i64>)> {
        let taken = self.packets.remove(&(node.to_owned(), port.to_owned()))?;
        self.send(&Command::Taken { node: node.to_owned(), port: port.to_owned() });
        Some(taken)
    }

    fn send_wanted(&self) {
        self.send(&Command::Preview { wanted: self.wanted.clone(), interval_ms: self.interval_ms });
    }
}

/// End of a connection to a machine.
#[derive(Debug, thiserror::Error)]
enum LinkEnd {
    /// A measurement of the clock is malformed.
    #[error("a measurement of the clock is malformed")]
    Clock,
    /// A message is malformed.
    #[error(transparent)]
    Message(#[from] BadMessage),
    /// The connecting program closed it.
    #[error("{words}")]
    Closed { words: String },
}

impl Shared {
    fn act<T>(&self, act: impl FnOnce(&mut Inner) -> T) -> T {
        let result = act(&mut lock(&self.inner));
        self.changed.notify_all();
        let wake = lock(&self.wake).clone();
        if let Some(wake) = wake {
            wake();
        }
        result
    }

    /// Reconnects whenever the connection ends.
    fn keep(&self) {
        loop {
            let Target { address, timeout_ms, plaintext, name, keys } = &self.target;
            let arguments = [tunnel::ATTACH, address, &timeout_ms.to_string(), &plaintext.to_string(), name];
            let words = match program::start(&arguments.map(str::to_owned), keys.as_deref()) {
                Ok((child, socket)) => self.connected(child, socket),
                Err(error) => error.to_string(),
            };
            let ends = self.act(|inner| {
                (inner.out, inner.socket) = (None, None);
                let state = &mut inner.state;
                state.clock = None;
                if state.contact == Contact::Attached {
                    state.losses += 1;
                    (state.contact, state.since) = (Contact::Lost(words.clone()), Some(Instant::now()));
                }
                state.problem = words;
                inner.ends
            });
            if ends {
                return;
            }
            let inner = lock(&self.inner);
            let waited = self.changed.wait_timeout_while(inner, AGAIN, |inner| !inner.ends);
            if waited.unwrap_or_else(PoisonError::into_inner).0.ends {
                return;
            }
        }
    }

    /// Receives frames until the connection ends; returns the reason.
    fn connected(&self, mut child: Child, socket: UnixStream) -> String {
        let end = |child: &mut Child| {
            let words = program::last_words(child);
            let _ = child.wait();
            words.unwrap_or_else(|| "the connection ended".to_owned())
        };
        let (Ok(to), Ok(from)) = (socket.try_clone(), socket.try_clone()) else { return end(&mut child) };
        let (out, frames) = channel();
        let writer = std::thread::Builder::new().name("attachment out".to_owned()).spawn(move || write(to, &frames));
        let ends = lock(&self.inner).ends;
        if writer.is_err() || ends {
            let _ = child.kill();
            return end(&mut child);
        }
        self.act(|inner| inner.socket = Some(socket));
        let mut from = BufReader::new(from);
        let mut words = None;
        while let Ok(Some(frame)) = tunnel::receive(&mut from) {
            if let Err(error) = self.take(frame, &out) {
                words = Some(error.to_string());
                break;
            }
        }
        let _ = from.get_ref().shutdown(Shutdown::Both);
        drop(out);
        self.act(|inner| inner.out = None);
        if words.is_some() {
            let _ = child.kill();
        }
        let last = end(&mut child);
        words.unwrap_or(last)
    }

    fn take(&self, frame: Frame, out: &Sender<Frame>) -> Result<(), LinkEnd> {
        match frame.kind {
            Kind::Ready => self.act(|inner| {
                inner.out = Some(out.clone());
                inner.state.here = frame.text();
            }),
            Kind::Clock => {
                let ClockFrame { offset_ns, error_ns, round_trip_ns } =
                    ClockFrame::read(&frame.bytes).ok_or(LinkEnd::Clock)?;
                self.act(|inner| inner.state.clock = Some(Clock { offset_ns, error_ns, round_trip_ns }));
            }
            Kind::Data => match message::read_incoming(&frame.bytes)? {
                Incoming::Message(message) => self.act(|inner| inner.take_message(message)),
                Incoming::Packet(packet) => self.act(|inner| inner.take_packet(*packet)),
            },
            Kind::Close => return Err(LinkEnd::Closed { words: frame.text() }),
            Kind::Open => {}
        }
        Ok(())
    }
}

impl Inner {
    fn take_message(&mut self, message: Message) {
        match message {
            Message::Opened(opened) => {
                let state = &mut self.state;
                if state.contact != Contact::Attached {
                    (state.contact, state.since) = (Contact::Attached, Some(Instant::now()));
                    state.problem.clear();
                }
                state.opened = Some(Arc::from(opened));
                state.revision += 1;
                // Its side has forgotten the packets that are underway, as it has new subscriptions.
                self.send_wanted();
            }
            Message::Counters(nodes) => self.nodes = Arc::new(nodes),
            Message::Faults(faults) => self.faults = Arc::new(faults),
            Message::Values(values) => self.values = values.into_iter().collect(),
            Message::Ran { id, result } => {
                // Only one is waited for.
                self.answers.clear();
                self.answers.insert(id, result);
            }
            Message::Ended { words } => {
                (self.state.contact, self.state.since) = (Contact::Ended(words), Some(Instant::now()));
            }
        }
    }

    fn take_packet(&mut self, packet: Packet) {
        let arrived_ns = self.state.clock.zip(packet.age_ns).map(|(clock, age_ns)| {
            // At latest: a picture is never shown as younger than it is.
            let error_ns = i64::try_from(clock.error_ns).unwrap_or(i64::MAX);
            let made_here_ns = packet.made_ns.saturating_sub(clock.offset_ns);
            let way_ns = system_ns().saturating_sub(made_here_ns).saturating_add(error_ns).max(0);
            let now_ns = i64::try_from(clock::now_ns()).unwrap_or(i64::MAX);
            now_ns.saturating_sub(age_ns.max(0).saturating_add(way_ns))
        });
        let first = self.first.take();
        first.into_iter().for_each(|(packet, arrived_ns)| self.put(packet, arrived_ns));
        match packet.is_first {
            true => self.first = Some((packet, arrived_ns)),
            false => self.put(packet, arrived_ns),
        }
    }

    /// Makes a packet the newest one of its output.
    fn put(&mut self, packet: Packet, arrived_ns: Option<i64>) {
        let key = (packet.node.clone(), packet.port.clone());
        let is_wanted = self.wanted.iter().any(|one| one.node == key.0 && one.port == key.1);
        // One that nobody wants any more, or that came before the last one was taken, is underway no more.
        if !is_wanted || self.packets.insert(key.clone(), (packet, arrived_ns)).is_some() {
            self.send(&Command::Taken { node: key.0, port: key.1 });
        }
    }
}

/// Writes frames until their sender or the socket is closed.
fn write(mut to: UnixStream, frames: &Receiver<Frame>) {
    while let Ok(frame) = frames.recv() {
        if tunnel::send(&mut to, &frame).is_err() {
            return;
        }
    }
}
