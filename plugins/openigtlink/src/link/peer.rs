//! One connected program: a queue of messages to send, a thread that writes, a thread that reads.

use std::collections::{BTreeMap, VecDeque};
use std::io::Write;
use std::net::{Shutdown, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::{Shared, lock};

/// A program that reads nothing for this long is disconnected.
const WRITE_LIMIT: Duration = Duration::from_secs(5);
/// Maximum number of waiting large messages per device: only the newest matters, and each takes megabytes.
const MAX_LARGE: usize = 2;
/// Size from which a message counts as large.
const LARGE_BYTES: usize = 64 << 10;

/// A message to send.
#[derive(Clone, Debug)]
pub struct Outgoing {
    /// Message type.
    pub kind: &'static str,
    /// Device name.
    pub device: String,
    /// Header and body.
    pub bytes: Arc<Vec<u8>>,
    /// Whether programs get the type without a request.
    pub is_pushed: bool,
    /// Whether it answers a request: it is then sent even if its type was stopped.
    pub is_answer: bool,
    /// Maximum number of waiting messages of this device.
    pub most: usize,
}

/// A program's subscription to one message type.
#[derive(Clone, Copy, Debug, Default)]
struct Flow {
    /// Whether it asked to start (`true`) or to stop; `None` if it asked for neither.
    asked: Option<bool>,
    /// Minimum time between two messages of one device.
    interval: Duration,
}

struct Item {
    kind: &'static str,
    device: String,
    is_answer: bool,
    bytes: Arc<Vec<u8>>,
}

#[derive(Default)]
struct Queue {
    items: VecDeque<Item>,
    /// By message type.
    flows: BTreeMap<&'static str, Flow>,
    /// When the newest message of each device was queued, if an interval was requested.
    last: BTreeMap<(&'static str, String), Instant>,
    is_closed: bool,
}

/// One connected program.
pub struct Peer {
    /// Address of the program, as text.
    pub words: String,
    pub(super) stream: TcpStream,
    queue: Mutex<Queue>,
    changed: Condvar,
    is_writing: AtomicBool,
}

impl Peer {
    pub(super) fn new(stream: TcpStream) -> std::io::Result<Self> {
        // Small messages must not wait for more to come.
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_LIMIT))?;
        // Notices a machine that was switched off, also where nothing is sent.
        rustix::net::sockopt::set_socket_keepalive(&stream, true)?;
        rustix::net::sockopt::set_tcp_keepidle(&stream, Duration::from_secs(5))?;
        rustix::net::sockopt::set_tcp_keepintvl(&stream, Duration::from_secs(2))?;
        rustix::net::sockopt::set_tcp_keepcnt(&stream, 3)?;
        let words = stream.peer_addr()?.to_string();
        let (queue, changed, is_writing) = (Mutex::default(), Condvar::new(), AtomicBool::new(false));
        Ok(Self { words, stream, queue, changed, is_writing })
    }

    /// Ends the connection: wakes both threads.
    pub fn close(&self) {
        lock(&self.queue).is_closed = true;
        self.changed.notify_all();
        // It may be closed already.
        let _ = self.stream.shutdown(Shutdown::Both);
    }

    /// Whether it requested a message type.
    pub fn is_asked_for(&self, kind: &str) -> bool {
        lock(&self.queue).flows.get(kind).is_some_and(|flow| flow.asked == Some(true))
    }

    /// Number of messages that are not written yet.
    pub fn waiting(&self) -> usize {
        let queue = lock(&self.queue);
        if queue.is_closed { 0 } else { queue.items.len() + usize::from(self.is_writing.load(Ordering::Acquire)) }
    }

    /// Starts or stops a message type.
    pub fn set_flow(&self, kind: &'static str, is_on: bool, interval: Duration) {
        lock(&self.queue).flows.insert(kind, Flow { asked: Some(is_on), interval });
    }

    /// Queues a message if the program accepts its type. Returns how many were dropped for it.
    pub fn offer(&self, message: &Outgoing, wait: bool) -> u64 {
        let mut queue = lock(&self.queue);
        let flow = queue.flows.get(message.kind).copied().unwrap_or_default();
        if queue.is_closed || !(message.is_answer || flow.asked.unwrap_or(message.is_pushed)) {
            return 0;
        }
        if !flow.interval.is_zero() && !message.is_answer {
            let (now, key) = (Instant::now(), (message.kind, message.device.clone()));
            if queue.last.get(&key).is_some_and(|last| now.duration_since(*last) < flow.interval) {
                return 0;
            }
            queue.last.insert(key, now);
        }
        let most = if message.bytes.len() >= LARGE_BYTES { message.most.min(MAX_LARGE) } else { message.most };
        let is_same = |item: &Item| {
            (item.kind, item.is_answer) == (message.kind, message.is_answer) && item.device == message.device
        };
        let mut dropped = 0;
        while queue.items.iter().filter(|item| is_same(item)).count() >= most.max(1) {
            if queue.is_closed {
                return dropped;
            }
            if wait {
                queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
            } else if let Some(oldest) = queue.items.iter().position(is_same) {
                queue.items.remove(oldest);
                dropped += 1;
            }
        }
        let Outgoing { kind, device, bytes, is_answer, .. } = message.clone();
        queue.items.push_back(Item { kind, device, is_answer, bytes });
        drop(queue);
        self.changed.notify_all();
        dropped
    }

    /// Writes queued messages until the connection ends.
    pub(super) fn write(&self, shared: &Shared) {
        loop {
            let mut queue = lock(&self.queue);
            let item = loop {
                if queue.is_closed {
                    return;
                }
                match queue.items.pop_front() {
                    Some(item) => break item,
                    None => queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner),
                }
            };
            self.is_writing.store(true, Ordering::Release);
            drop(queue);
            // A sender in batch mode may wait for room.
            self.changed.notify_all();
            let result = (&self.stream).write_all(&item.bytes);
            self.is_writing.store(false, Ordering::Release);
            match result {
                Ok(()) => shared.totals.sent.fetch_add(1, std::sync::atomic::Ordering::Relaxed),
                Err(error) => {
                    if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) {
                        let limit_s = WRITE_LIMIT.as_secs();
                        shared
                            .remark(true, format!("{} read nothing for {limit_s} s and was disconnected", self.words));
                    }
                    self.close();
                    return;
                }
            };
        }
    }
}
