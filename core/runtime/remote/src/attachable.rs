//! Listens for windows of other machines on a running graph. Its parent runs the graph and gives it a socket as
//! standard input.

use std::collections::HashMap;
use std::io::{self, BufReader};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use panoscope_engine::sync::lock;
use panoscope_host::attach::Queue;
use panoscope_host::attach::tunnel::{self, Frame, Kind};
use panoscope_host::isolate::system_ns;
use zenoh::bytes::ZBytes;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

use crate::error::RemoteError;
use crate::keys::{self, Identity};
use crate::network::{self, Address, UNNAMED};

/// Maximum number of windows at a time.
const MAX_WINDOWS: usize = 16;
/// Multiple of a window's own timeout after which it counts as gone.
const PATIENCE: u32 = 2;
/// Time without reading a message after which a window counts as stuck.
const MAX_STUCK: Duration = Duration::from_secs(10);
/// Time between two checks for lost windows.
const LOOK: Duration = Duration::from_millis(100);
/// Name of a machine without certificates for its windows.
const NO_NAME: &str = "engine";

/// First byte of a message: greeting.
pub(crate) const HELLO: u8 = 1;
/// A frame's content.
pub(crate) const DATA: u8 = 2;
/// The end of the connection, with the reason.
pub(crate) const BYE: u8 = 3;

/// The socket that the parent left as standard input.
pub(crate) fn parent() -> Result<UnixStream, RemoteError> {
    let socket = io::stdin().as_fd().try_clone_to_owned().map(UnixStream::from)?;
    socket.peer_addr().map_err(|_| RemoteError::NoParent)?;
    Ok(socket)
}

/// A message of one first byte and content.
pub(crate) fn message(kind: u8, content: Vec<u8>) -> ZBytes {
    let mut bytes = ZBytes::writer();
    bytes.append(ZBytes::from(vec![kind]));
    bytes.append(ZBytes::from(content));
    bytes.finish()
}

/// Splits a message into its first byte and its content.
pub(crate) fn split(sample: &Sample) -> Option<(u8, Vec<u8>)> {
    let bytes = sample.payload().to_bytes();
    let (kind, content) = bytes.split_first()?;
    (content.len() <= tunnel::MAX_BYTES).then(|| (*kind, content.to_vec()))
}

struct Window {
    host: String,
    id: String,
    out: Queue,
    /// Begin of the current send, ns; 0 between two messages.
    sending_ns: AtomicI64,
    heard_ns: AtomicI64,
    patience: Duration,
}

struct Shared {
    name: String,
    session: Session,
    parent: Mutex<UnixStream>,
    windows: Mutex<HashMap<u32, Arc<Window>>>,
    next: AtomicU32,
}

/// Listens until the parent ends. If `name` is empty, the name in the keys is used.
///
/// # Errors
/// The address cannot be used, or names and keys are missing.
pub fn run(
    name: &str,
    address: &str,
    identity: Option<Identity>,
    plaintext: bool,
    hosts: &[&str],
) -> Result<(), RemoteError> {
    let parent = parent()?;
    let address = Address::parse(address, plaintext)?;
    let own = identity.as_ref().map(|identity| identity.name.clone());
    let name = if name.is_empty() { own.unwrap_or_else(|| NO_NAME.to_owned()) } else { name.to_owned() };
    if let Some(bad) = [name.as_str()].iter().chain(hosts).find(|name| !keys::is_name(name)) {
        return Err(RemoteError::BadName { name: (*bad).to_owned() });
    }
    if address.is_tls && hosts.is_empty() {
        return Err(RemoteError::NoWindows);
    }
    let hosts: Vec<String> = match address.is_tls {
        true => hosts.iter().map(|host| (*host).to_owned()).collect(),
        false => vec![UNNAMED.to_owned()],
    };
    let session = network::listen(&name, &address, identity.as_ref(), &hosts)?;
    let from = parent.try_clone()?;
    let shared = Arc::new(Shared {
        name: name.clone(),
        session,
        parent: Mutex::new(parent),
        windows: Mutex::default(),
        next: AtomicU32::new(1),
    });
    let mut subscribers = Vec::new();
    for host in hosts {
        for key in ["down", "ping"] {
            let (mine, host) = (Arc::clone(&shared), host.clone());
            let pattern = format!("panoscope/{name}/{host}/*/{key}");
            let callback = move |sample: Sample| {
                let Some(id) = network::session_of(&sample) else { return };
                match key {
                    "down" => mine.receive(&host, &id, &sample),
                    _ => mine.answer_probe(&host, &id, &sample),
                }
            };
            subscribers.push(shared.session.declare_subscriber(pattern).callback(callback).wait()?);
        }
    }
    shared.tell(&Frame::words(Kind::Ready, 0, &name));
    let watching = Arc::clone(&shared);
    std::thread::Builder::new().spawn(move || watching.watch())?;
    let mut from = BufReader::new(from);
    while let Ok(Some(frame)) = tunnel::receive(&mut from) {
        let window = lock(&shared.windows).get(&frame.session).cloned();
        let Some(window) = window else { continue };
        let (kind, session) = (frame.kind, frame.session);
        match kind {
            Kind::Data | Kind::Close => {
                if let Err(full) = window.out.push(frame) {
                    shared.end(session, &full.to_string());
                }
            }
            Kind::Ready | Kind::Open | Kind::Clock => {}
        }
        if kind == Kind::Close {
            window.out.close();
            lock(&shared.windows).remove(&session);
        }
    }
    // What was sent last may still be on its way.
    std::thread::sleep(LOOK);
    crate::link::leave(0)
}

impl Shared {
    fn tell(&self, frame: &Frame) {
        // A parent that is gone ends what is read from it too.
        let _ = tunnel::send(&mut *lock(&self.parent), frame);
    }

    fn key(&self, host: &str, id: &str, what: &str) -> String {
        format!("{}/{what}", network::prefix(&self.name, host, id))
    }

    fn window(&self, host: &str, id: &str) -> Option<(u32, Arc<Window>)> {
        let windows = lock(&self.windows);
        let found = windows.iter().find(|(_, window)| window.host == host && window.id == id);
        found.map(|(number, window)| (*number, Arc::clone(window)))
    }

    fn answer_probe(&self, host: &str, id: &str, sample: &Sample) {
        let now_ns = system_ns();
        let makes_sense = network::answer_probe(&self.session, self.key(host, id, "pong"), sample, now_ns);
        if let Some((_, window)) = self.window(host, id).filter(|_| makes_sense) {
            window.heard_ns.store(now_ns, Ordering::Relaxed);
        }
    }

    fn receive(self: &Arc<Self>, host: &str, id: &str, sample: &Sample) {
        let Some((kind, content)) = split(sample) else { return };
        match (kind, self.window(host, id)) {
            (HELLO, None) => self.begin(host, id, &content),
            (DATA, Some((session, window))) => {
                window.heard_ns.store(system_ns(), Ordering::Relaxed);
                self.tell(&Frame { kind: Kind::Data, session, bytes: content });
            }
            (BYE, Some((session, _))) => self.end(session, "it was closed"),
            _ => {}
        }
    }

    /// Begins the session of a window, whose greeting states its version and timeout.
    fn begin(self: &Arc<Self>, host: &str, id: &str, hello: &[u8]) {
        let up = match network::publisher(&self.session, self.key(host, id, "up"), false) {
            Ok(up) => up,
            Err(error) => return eprintln!("{host}: {error}"),
        };
        let refuse = |words: String| _ = up.put(message(BYE, words.into_bytes())).wait();
        let Some((timeout_ms, theirs)) = hello.split_first_chunk::<4>() else {
            return refuse("the versions differ; install the same on both".to_owned());
        };
        let (own, theirs) = (crate::version(), String::from_utf8_lossy(theirs).into_owned());
        if own != theirs {
            let words =
                format!("the versions differ: {theirs} here, {own} on `{}`; install the same on both", self.name);
            return refuse(words);
        }
        let session = self.next.fetch_add(1, Ordering::Relaxed);
        let mut windows = lock(&self.windows);
        if windows.len() >= MAX_WINDOWS {
            return refuse(format!("{MAX_WINDOWS} windows are attached already"));
        }
        let patience = Duration::from_millis(u32::from_le_bytes(*timeout_ms).clamp(100, 60_000).into()) * PATIENCE;
        let heard_ns = AtomicI64::new(system_ns());
        let (out, sending_ns) = (Queue::default(), AtomicI64::new(0));
        let window = Arc::new(Window { host: host.to_owned(), id: id.to_owned(), out, sending_ns, heard_ns, patience });
        // An empty queue has room.
        let _ = window.out.push(Frame::words(Kind::Ready, session, &self.name));
        windows.insert(session, Arc::clone(&window));
        drop(windows);
        // Before the first message of the window.
        self.tell(&Frame::words(Kind::Open, session, host));
        // One thread for each: a slow window makes no other one wait.
        if std::thread::Builder::new().spawn(move || write(&up, &window)).is_err() {
            self.end(session, "a thread could not be started");
        }
    }

    fn end(&self, session: u32, why: &str) {
        let window = lock(&self.windows).remove(&session);
        if let Some(window) = window {
            window.out.close();
            self.tell(&Frame::words(Kind::Close, session, why));
        }
    }

    /// Closes windows that are silent for too long.
    fn watch(&self) {
        loop {
            std::thread::sleep(LOOK);
            let now_ns = system_ns();
            let since = |ns: i64| Duration::from_nanos(now_ns.saturating_sub(ns).max(0).unsigned_abs());
            let why_gone = |window: &Window| {
                let sending_ns = window.sending_ns.load(Ordering::Relaxed);
                if since(window.heard_ns.load(Ordering::Relaxed)) > window.patience {
                    Some(format!("it sent nothing for {} s", window.patience.as_secs_f64()))
                } else if sending_ns != 0 && since(sending_ns) > MAX_STUCK {
                    Some(format!("it has read nothing for {} s", MAX_STUCK.as_secs()))
                } else {
                    None
                }
            };
            let windows = lock(&self.windows);
            let gone: Vec<(u32, String)> =
                windows.iter().filter_map(|(session, window)| Some((*session, why_gone(window)?))).collect();
            drop(windows);
            gone.iter().for_each(|(session, why)| self.end(*session, why));
        }
    }
}

/// Sends messages to a window until it is closed.
fn write(up: &zenoh::pubsub::Publisher<'static>, window: &Window) {
    while let Some(frame) = window.out.pop() {
        let kind = match frame.kind {
            Kind::Ready => HELLO,
            Kind::Close => BYE,
            _ => DATA,
        };
        window.sending_ns.store(system_ns(), Ordering::Relaxed);
        if up.put(message(kind, frame.bytes)).wait().is_err() {
            return;
        }
        window.sending_ns.store(0, Ordering::Relaxed);
    }
}
