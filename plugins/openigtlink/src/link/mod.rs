//! Connections to other programs. Separate threads read and write, so that no node waits for the network.

mod answer;
mod client;
mod connected;
mod inbox;
mod peer;
mod server;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use panoscope_node::{Choice, Context};

pub use inbox::{Filter, Inbox, Received};
pub use peer::Outgoing;
use peer::Peer;

/// Maximum number of programs that a server serves at a time.
pub const MAX_PEERS: usize = 32;
/// Maximum number of remarks that wait for a node to log them.
const MAX_REMARKS: usize = 32;
/// Maximum number of messages kept for requests.
const MAX_NEWEST: usize = 256;

/// Why there is no connection.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum LinkError {
    /// The system does not allow listening on the address.
    #[error("cannot listen on {at}: {reason}; {help}")]
    Listen { at: SocketAddr, reason: String, help: &'static str },
    /// `address` is not an IP address.
    #[error("`{address}` is not an IP address to listen on; write 127.0.0.1, 0.0.0.0 or the address of a network card")]
    Address { address: String },
    /// The system cannot start a thread.
    #[error("no thread could be started for the connection: {0}")]
    Thread(std::io::Error),
}

/// Which side opens the connection.
#[derive(Choice, Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Waits for programs that connect; serves up to 32 at a time.
    Server,
    /// Connects to a program, and reconnects whenever the connection is lost.
    Client,
}

/// Key that identifies a connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Which side connects.
    pub role: Role,
    /// Address to listen on or to connect to.
    pub address: String,
    /// TCP port.
    pub port: u16,
}

impl Endpoint {
    /// Address and port as text.
    pub fn words(&self) -> String {
        match self.address.contains(':') {
            true => format!("[{}]:{}", self.address, self.port),
            false => format!("{}:{}", self.address, self.port),
        }
    }
}

/// An event that a node should log.
#[derive(Clone, Debug)]
pub struct Remark {
    /// Whether it is a fault: something is lost until it comes back.
    pub is_fault: bool,
    /// Whether a program has closed its connection, which ends a batch run.
    pub is_end: bool,
    /// Whether a client has no connection at the moment; it reconnects by itself.
    pub is_apart: bool,
    /// The message.
    pub words: String,
}

impl Remark {
    /// Logs the event. In live mode a peer that restarts is not a fault: what it would have sent meanwhile does not exist.
    pub fn log(&self, cx: &Context<'_>) {
        match self {
            Self { is_apart: true, .. } if !cx.is_batch() => cx.warn(&self.words),
            Self { is_fault: true, .. } => cx.fault(&self.words),
            _ => cx.info(&self.words),
        }
    }
}

/// Counts since the link was created.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Number of connections now.
    pub peers: usize,
    /// Number of messages written.
    pub sent: u64,
    /// Number of messages dropped because a program was slow.
    pub dropped: u64,
    /// Number of messages received, without requests.
    pub received: u64,
    /// Number of messages received with a wrong CRC or malformed content.
    pub damaged: u64,
    /// Number of messages received of unknown types.
    pub skipped: u64,
}

#[derive(Default)]
struct Totals {
    sent: AtomicU64,
    dropped: AtomicU64,
    received: AtomicU64,
    damaged: AtomicU64,
    skipped: AtomicU64,
}

/// Type and device of a message.
type Name = (&'static str, String);

/// State that the threads of a link share.
struct Shared {
    endpoint: Endpoint,
    is_stopping: AtomicBool,
    /// Wakes threads that sleep in `pause`.
    pause: (Mutex<()>, Condvar),
    peers: Mutex<Vec<Arc<Peer>>>,
    /// Number of connections so far.
    connected: AtomicU64,
    inboxes: Mutex<Vec<Weak<Inbox>>>,
    /// The newest message of each device, for `GET_` requests.
    newest: Mutex<BTreeMap<Name, Arc<Vec<u8>>>>,
    remarks: Mutex<Vec<Remark>>,
    totals: Totals,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    fn new(endpoint: Endpoint) -> Self {
        Self {
            endpoint,
            is_stopping: AtomicBool::new(false),
            pause: Default::default(),
            peers: Mutex::default(),
            connected: AtomicU64::new(0),
            inboxes: Mutex::default(),
            newest: Mutex::default(),
            remarks: Mutex::default(),
            totals: Totals::default(),
        }
    }

    fn is_stopping(&self) -> bool {
        self.is_stopping.load(Ordering::Acquire)
    }

    /// Sleeps, but returns early when the link ends.
    fn pause(&self, time: Duration) {
        let guard = lock(&self.pause.0);
        if !self.is_stopping() {
            drop(self.pause.1.wait_timeout(guard, time));
        }
    }

    fn remark(&self, is_fault: bool, words: String) {
        self.add_remark(Remark { is_fault, is_end: false, is_apart: false, words });
    }

    fn add_remark(&self, remark: Remark) {
        let mut remarks = lock(&self.remarks);
        if remarks.len() < MAX_REMARKS {
            remarks.push(remark);
        }
    }

    /// Ends all connections and threads.
    fn stop(&self) {
        self.is_stopping.store(true, Ordering::Release);
        drop(lock(&self.pause.0));
        self.pause.1.notify_all();
        lock(&self.peers).iter().for_each(|peer| peer.close());
        lock(&self.inboxes).iter().filter_map(Weak::upgrade).for_each(|inbox| inbox.close());
    }
}

/// A server with its clients, or a connection to a server. Closed when dropped.
pub struct Link {
    shared: Arc<Shared>,
    bound: Option<SocketAddr>,
    threads: Vec<JoinHandle<()>>,
}

static LINKS: Mutex<Vec<(Endpoint, Weak<Link>)>> = Mutex::new(Vec::new());

impl Link {
    /// The link of an endpoint, or a new one. Port 0 always makes a new one.
    ///
    /// # Errors
    /// A server cannot listen.
    pub fn get(endpoint: &Endpoint) -> Result<Arc<Self>, LinkError> {
        let mut links = lock(&LINKS);
        links.retain(|(_, link)| link.strong_count() > 0);
        let known = links.iter().find(|(known, _)| known == endpoint && endpoint.port != 0);
        if let Some(link) = known.and_then(|(_, link)| link.upgrade()) {
            return Ok(link);
        }
        let link = Arc::new(Self::start(endpoint)?);
        links.push((endpoint.clone(), Arc::downgrade(&link)));
        Ok(link)
    }

    fn start(endpoint: &Endpoint) -> Result<Self, LinkError> {
        let shared = Arc::new(Shared::new(endpoint.clone()));
        let (thread, bound) = match endpoint.role {
            Role::Server => {
                let (thread, bound) = server::start(&shared)?;
                (thread, Some(bound))
            }
            Role::Client => (client::start(&shared)?, None),
        };
        Ok(Self { shared, bound, threads: vec![thread] })
    }

    /// Address on which a server listens.
    pub fn bound(&self) -> Option<SocketAddr> {
        self.bound
    }

    /// Where it listens or connects to, as text.
    pub fn words(&self) -> String {
        self.bound.map_or_else(|| self.shared.endpoint.words(), |bound| bound.to_string())
    }

    /// Whether any program is connected.
    pub fn is_connected(&self) -> bool {
        !lock(&self.shared.peers).is_empty()
    }

    /// Whether every program that was connected has left, and there was at least one.
    pub fn has_ended(&self) -> bool {
        self.shared.connected.load(Ordering::Acquire) > 0 && !self.is_connected()
    }

    /// Whether any program asked for messages of type `kind` by a request.
    pub fn is_asked_for(&self, kind: &str) -> bool {
        lock(&self.shared.peers).iter().any(|peer| peer.is_asked_for(kind))
    }

    /// Queues a message for every program that accepts its type. Without any, the message is dropped. With `wait`, it waits for room in a full queue
    /// instead of dropping the oldest message.
    pub fn send(&self, message: &Outgoing, wait: bool) {
        let peers: Vec<Arc<Peer>> = lock(&self.shared.peers).clone();
        let mut newest = lock(&self.shared.newest);
        if peers.is_empty() {
            newest.clear();
            return;
        }
        if newest.len() < MAX_NEWEST
            || newest.keys().any(|(kind, device)| *kind == message.kind && *device == message.device)
        {
            newest.insert((message.kind, message.device.clone()), Arc::clone(&message.bytes));
        }
        drop(newest);
        for peer in peers {
            let dropped = peer.offer(message, wait);
            self.shared.totals.dropped.fetch_add(dropped, Ordering::Relaxed);
        }
    }

    /// Adds a queue for received messages.
    pub fn subscribe(&self, filter: Filter, most: usize, is_batch: bool) -> Arc<Inbox> {
        let inbox = Arc::new(Inbox::new(filter, most, is_batch));
        let mut inboxes = lock(&self.shared.inboxes);
        inboxes.retain(|inbox| inbox.strong_count() > 0);
        inboxes.push(Arc::downgrade(&inbox));
        inbox
    }

    /// Waits until the queued messages are written, at most `limit`. Returns how many are not.
    pub fn drain(&self, limit: Duration) -> usize {
        let begin = Instant::now();
        loop {
            let waiting: usize = lock(&self.shared.peers).iter().map(|peer| peer.waiting()).sum();
            if waiting == 0 || begin.elapsed() >= limit {
                return waiting;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Takes the remarks since the last call.
    pub fn remarks(&self) -> Vec<Remark> {
        std::mem::take(&mut *lock(&self.shared.remarks))
    }

    /// Counts since the link was created.
    pub fn counts(&self) -> Counts {
        let totals = &self.shared.totals;
        Counts {
            peers: lock(&self.shared.peers).len(),
            sent: totals.sent.load(Ordering::Relaxed),
            dropped: totals.dropped.load(Ordering::Relaxed),
            received: totals.received.load(Ordering::Relaxed),
            damaged: totals.damaged.load(Ordering::Relaxed),
            skipped: totals.skipped.load(Ordering::Relaxed),
        }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.shared.stop();
        for thread in self.threads.drain(..) {
            // A panic was printed when it happened.
            let _ = thread.join();
        }
    }
}

/// UTC, ns since 1970. The protocol's timestamps are UTC; nothing that a graph computes depends on it.
pub fn utc_ns() -> i128 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_nanos() as i128)
}
