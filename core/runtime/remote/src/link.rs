//! The link: the process that a host starts for a machine and treats as the process of a group.

use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::fmt::Display;
use std::io::{Seek, SeekFrom};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use panoscope_engine::isolation::Pixels;
use panoscope_engine::sync::lock;
use panoscope_host::isolate::relay::{self, Bytes, Given, Link, LinkLane, LinkNumbers, Open, Request, kind};
use panoscope_host::isolate::{EXIT_LINK, system_ns};
use panoscope_host::loader::sealed::Fingerprint;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

use crate::clock::Offset;
use crate::error::RemoteError;
use crate::files::Hashes;
use crate::h264::{self, Decoders, Encoders};
use crate::keys::Identity;
use crate::mirror::{Pool, Pools};
use crate::network::{self, Address, UNNAMED};
use panoscope_host::isolate::relay::messages::{self as message, BadMessage, FileHash, Message, Turn};

/// Attempts to reach the machine within its timeout.
const ATTEMPTS: u32 = 4;
/// Probes of the clock within the timeout.
const PROBES: u32 = 10;

/// Settings of the machine in the arguments of the process.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Arguments {
    address: String,
    pixels: Pixels,
    timeout: Duration,
    plaintext: bool,
    machine: String,
}

impl Arguments {
    /// Parses the arguments after [`panoscope_host::isolate::LINK_COMMAND`].
    fn parse(words: &[OsString]) -> Option<Self> {
        let words: Vec<&str> = words.iter().map(|word| word.to_str()).collect::<Option<_>>()?;
        let [address, pixels, timeout_ms, plaintext, machine] = words[..] else { return None };
        Some(Self {
            address: address.to_owned(),
            pixels: Pixels::named(pixels)?,
            timeout: Duration::from_millis(timeout_ms.parse().ok()?),
            plaintext: plaintext == "true",
            machine: machine.to_owned(),
        })
    }
}

/// Ends the process with a message that the host shows.
pub(crate) fn lose(words: impl Display) -> ! {
    eprintln!("{words}");
    leave(EXIT_LINK)
}

pub(crate) fn leave(code: i32) -> ! {
    // SAFETY: ends the process. Threads of zenoh may still run, so that nothing is destroyed.
    unsafe { libc::_exit(code) }
}

fn seconds(time: Duration) -> String {
    format!("{} s", time.as_secs_f64())
}

/// A message of a lane that was received; the bytes of its frames begin at `begin`.
struct Received {
    turn: Turn,
    payload: ZBytes,
    begin: u64,
}

/// Frames that the other machine already has.
#[derive(Default)]
struct There {
    /// For pools of this machine: the use count of the buffer when the frame was sent.
    sent: HashMap<(u32, u64), u32>,
    /// For the group's own pools: frames made there, or sent. Only the other machine writes these.
    own: HashSet<(u32, u64)>,
}

/// State shared by the threads of the process.
struct Connection {
    arguments: Arguments,
    down: Publisher<'static>,
    /// Locked while a message is sent, so that a frame precedes every message that names it.
    there: Mutex<There>,
    pools: Pools,
    encoders: Mutex<Encoders>,
    decoders: Mutex<Decoders>,
    hashes: Hashes,
    clock: Mutex<Offset>,
    heard_ns: AtomicI64,
    sent_bytes: AtomicU64,
    received_bytes: AtomicU64,
    lanes: Mutex<HashMap<u32, Sender<Received>>>,
    shown: Mutex<Vec<Weak<LinkLane>>>,
    is_ready: Mutex<bool>,
    changed: Condvar,
}

/// Runs the process until its host ends or its machine is lost. `words` are the arguments after
/// [`panoscope_host::isolate::LINK_COMMAND`]; standard input is the socket of the host.
pub fn run(words: &[OsString]) -> ! {
    let Some(arguments) = Arguments::parse(words) else {
        lose("the program that started this link is of another version")
    };
    let link = match Link::take() {
        Ok(link) => link,
        Err(cause) => lose(format_args!("its link cannot start: {cause}")),
    };
    let Arguments { address, timeout, plaintext, .. } = &arguments;
    if let Err(error) = h264::check(arguments.pixels) {
        lose(error);
    }
    let (session, host) = match reach(address, *timeout, *plaintext, "panoscope serve") {
        Ok(reached) => reached,
        Err(error) => lose(error),
    };
    match serve(&arguments, &link, &session, &host) {
        Ok(connection) => {
            let _ = connection.down.put(message::write(&Message::Bye)).wait();
            let _ = session.close().wait();
            leave(0)
        }
        Err(error) => lose(error),
    }
}

/// Connects to a machine where `command` listens, within its timeout. Also returns the name of this host.
pub(crate) fn reach(
    address: &str,
    timeout: Duration,
    plaintext: bool,
    command: &'static str,
) -> Result<(Session, String), RemoteError> {
    let address = Address::parse(address, plaintext)?;
    let identity = match address.is_tls {
        true => {
            let folder = Identity::folder().ok_or(RemoteError::NoKeys)?;
            let remedy = "make keys with `panoscope keys`, and set PANOSCOPE_KEYS to this machine's folder";
            Some(Identity::read(&folder).map_err(|cause| RemoteError::UnreadableKeys { cause, remedy })?)
        }
        false => None,
    };
    let host = identity.as_ref().map_or_else(|| UNNAMED.to_owned(), |identity| identity.name.clone());
    let end = Instant::now() + timeout;
    wait_for_answer(&address.text, timeout, end, command)?;
    // What zenoh does on the way has limits of its own, which are longer.
    let (limit, text) = (timeout, address.text.clone());
    let (done, opened) = channel::<()>();
    let watch = move || {
        if opened.recv_timeout(limit).is_err_and(|error| error == std::sync::mpsc::RecvTimeoutError::Timeout) {
            lose(format_args!(
                "{text} answers, but no connection was made within {}; is it `{command}`?",
                seconds(limit)
            ));
        }
    };
    std::thread::Builder::new().spawn(watch)?;
    // What accepts and closes at once counts as one attempt, as long as one that does not answer.
    let pause = timeout / ATTEMPTS / 2;
    let session = loop {
        match network::connect(&address, identity.as_ref()) {
            Ok(session) => break session,
            Err(_) if Instant::now() + pause < end => std::thread::sleep(pause),
            Err(cause) => return Err(RemoteError::Refused { address: address.text, cause, is_tls: address.is_tls }),
        }
    };
    drop(done);
    Ok((session, host))
}

/// Waits until something accepts connections at an address. Several short attempts notice a recovered network sooner
/// than one attempt that the system repeats.
fn wait_for_answer(address: &str, timeout: Duration, end: Instant, command: &'static str) -> Result<(), RemoteError> {
    let host = address.split_once('/').map_or(address, |(_, host)| host);
    loop {
        let begin = Instant::now();
        let cause = match host.to_socket_addrs() {
            Ok(addresses) => {
                let mut cause = "it has no address".to_owned();
                for one in addresses {
                    match TcpStream::connect_timeout(&one, timeout / ATTEMPTS) {
                        Ok(_) => return Ok(()),
                        Err(error) => cause = error.to_string(),
                    }
                }
                cause
            }
            Err(error) => error.to_string(),
        };
        if Instant::now() >= end {
            return Err(RemoteError::NoAnswer { address: address.to_owned(), timeout, cause, command });
        }
        std::thread::sleep((timeout / ATTEMPTS / 2).saturating_sub(begin.elapsed()));
    }
}

/// Carries messages until the host ends.
fn serve(arguments: &Arguments, link: &Link, session: &Session, host: &str) -> Result<Arc<Connection>, RemoteError> {
    let prefix = network::prefix(&arguments.machine, host, &session.zid().to_string());
    let connection = Arc::new(Connection {
        arguments: arguments.clone(),
        down: network::publisher(session, format!("{prefix}/down"), false)?,
        there: Mutex::default(),
        pools: Pools::default(),
        encoders: Mutex::default(),
        decoders: Mutex::default(),
        hashes: Hashes::default(),
        clock: Mutex::default(),
        heard_ns: AtomicI64::new(system_ns()),
        sent_bytes: AtomicU64::new(0),
        received_bytes: AtomicU64::new(0),
        lanes: Mutex::default(),
        shown: Mutex::default(),
        is_ready: Mutex::default(),
        changed: Condvar::new(),
    });
    let hear = |key: &str, receive: fn(&Connection, &Sample) -> Result<(), BadMessage>| {
        let mine = Arc::clone(&connection);
        let callback = move |sample: Sample| {
            mine.heard_ns.store(system_ns(), Ordering::Relaxed);
            mine.received_bytes.fetch_add(sample.payload().len() as u64, Ordering::Relaxed);
            if let Err(bad) = receive(&mine, &sample) {
                lose(bad);
            }
        };
        session.declare_subscriber(format!("{prefix}/{key}")).callback(callback).wait()
    };
    // They live as long as the session.
    let _up = hear("up", Connection::receive)?;
    let _pong = hear("pong", Connection::measure)?;
    let ping = network::publisher(session, format!("{prefix}/ping"), true)?;
    let address = arguments.address.clone();
    let end = move || lose(format_args!("the connection to {address} ended"));
    // Ends with this function: a connection that this side closes is not lost.
    let _watch = network::watch_end(&connection.down, end)?;
    let settings = link.settings;
    let hello = Message::Hello {
        version: crate::version(),
        group: arguments.machine.clone(),
        threads: settings.threads,
        memory_bytes: settings.memory_bytes,
        deny: settings.deny,
        pixels: arguments.pixels,
        timeout_ms: u32::try_from(arguments.timeout.as_millis()).unwrap_or(u32::MAX),
    };
    connection.send(&hello, Vec::new())?;
    let mine = Arc::clone(&connection);
    std::thread::Builder::new().spawn(move || mine.probe(&ping))?;
    connection.wait_until_ready()?;
    hand_over(&connection, link)?;
    Ok(connection)
}

/// Sends what the host gives, in its order, until there is no more, and carries the messages of each lane on a thread.
fn hand_over(connection: &Arc<Connection>, link: &Link) -> Result<(), RemoteError> {
    let mut lanes = 0;
    while let Some(given) = link.next()? {
        match given {
            Given::Pool { number, len, is_own, file } => {
                let pool = Pool::map(&file, len, is_own, is_own)?;
                connection.send(&Message::Pool { number, len: len as u64, is_own }, Vec::new())?;
                // From here on frames of it may be sent.
                connection.pools.add(number, pool);
            }
            Given::Plugin { id, path, image } => {
                let mut image = image;
                let hash = Fingerprint::of_open(&mut image)?;
                let path = path.display().to_string();
                connection.send(&Message::Plugin { id, path, sha256: hash.sha256 }, Vec::new())?;
            }
            Given::Lane(lane) => {
                lanes += 1;
                let (sender, received) = channel();
                lock(&connection.lanes).insert(lanes, sender);
                connection.send(&Message::Lane { id: lanes }, Vec::new())?;
                let lane = Arc::new(lane);
                lock(&connection.shown).push(Arc::downgrade(&lane));
                let (mine, id) = (Arc::clone(connection), lanes);
                let work = move || {
                    if let Err(cause) = mine.carry(id, &lane, &received) {
                        lose(RemoteError::Lane { cause: Box::new(cause) });
                    }
                    lock(&mine.lanes).remove(&id);
                };
                std::thread::Builder::new().spawn(work)?;
            }
        }
    }
    Ok(())
}

impl Connection {
    /// Sends a message with the bytes of its frames.
    fn send(&self, message: &Message, frames: Vec<Vec<u8>>) -> Result<(), RemoteError> {
        let _one_at_a_time = lock(&self.there);
        self.put(message, frames)
    }

    fn put(&self, message: &Message, frames: Vec<Vec<u8>>) -> Result<(), RemoteError> {
        let head = message::write(message);
        let mut bytes = ZBytes::writer();
        bytes.append(ZBytes::from(head));
        frames.into_iter().for_each(|frame| bytes.append(ZBytes::from(frame)));
        let bytes = bytes.finish();
        self.sent_bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Ok(self.down.put(bytes).wait()?)
    }

    /// Decodes a message of the server.
    fn receive(&self, sample: &Sample) -> Result<(), BadMessage> {
        let payload = sample.payload();
        let mut reader = payload.reader();
        match message::read(&mut reader).map_err(|_| BadMessage)? {
            Message::Ready => {
                *lock(&self.is_ready) = true;
                self.changed.notify_all();
            }
            Message::Lost { words } => lose(words),
            Message::Turn(turn) => {
                let begin = (payload.len() - reader.remaining()) as u64;
                // A lane that is closed has no reader any more.
                if let Some(lane) = lock(&self.lanes).get(&turn.lane) {
                    let _ = lane.send(Received { turn, payload: payload.clone(), begin });
                }
            }
            _ => return Err(BadMessage),
        }
        Ok(())
    }

    /// Measures the clock with the answer to a probe: send time and remote clock.
    fn measure(&self, sample: &Sample) -> Result<(), BadMessage> {
        lock(&self.clock).take_answer(&sample.payload().to_bytes(), system_ns()).ok_or(BadMessage)?;
        // Whoever waits has looked at the clock before, or looks again.
        drop(lock(&self.is_ready));
        self.changed.notify_all();
        Ok(())
    }

    /// The other machine's clock minus this one's, ns, and its maximum error.
    fn offset(&self) -> Option<(i64, u64)> {
        lock(&self.clock).at(system_ns())
    }

    fn wait_until_ready(&self) -> Result<(), RemoteError> {
        let timeout = self.arguments.timeout;
        let waiting = |is_ready: &mut bool| !(*is_ready && self.offset().is_some());
        let waited = self.changed.wait_timeout_while(lock(&self.is_ready), timeout, waiting);
        let waited = waited.unwrap_or_else(PoisonError::into_inner).1;
        match waited.timed_out() {
            false => Ok(()),
            true => Err(RemoteError::NoGreeting { machine: self.arguments.machine.clone(), timeout }),
        }
    }

    /// Measures the clock, publishes the state of the connection, and ends the process when the machine is silent for
    /// too long.
    fn probe(&self, ping: &Publisher<'static>) {
        let timeout = self.arguments.timeout;
        loop {
            let _ = ping.put(system_ns().to_le_bytes()).wait();
            std::thread::sleep(timeout / PROBES);
            let silent_ns = system_ns().saturating_sub(self.heard_ns.load(Ordering::Relaxed)).max(0);
            // Before that `wait_until_ready` says better what is wrong.
            if *lock(&self.is_ready) && Duration::from_nanos(silent_ns.unsigned_abs()) > timeout {
                lose(format_args!("{} sent nothing for {}", self.arguments.address, seconds(timeout)));
            }
            let numbers = LinkNumbers {
                clock: self.offset(),
                round_trip_ns: lock(&self.clock).round_trip_ns(),
                sent_bytes: self.sent_bytes.load(Ordering::Relaxed),
                received_bytes: self.received_bytes.load(Ordering::Relaxed),
            };
            lock(&self.shown).retain(|lane| {
                lane.upgrade().is_some_and(|lane| {
                    lane.show(&numbers);
                    true
                })
            });
        }
    }

    /// Carries the messages of a lane until its instance is closed.
    fn carry(&self, id: u32, lane: &LinkLane, received: &Receiver<Received>) -> Result<(), RemoteError> {
        let (mut message, mut rewritten) = (Vec::new(), Vec::new());
        let mut request = 0;
        // The host's clock minus the system's, ns.
        let mut host_clock = None;
        loop {
            // The host is gone: the main thread leaves.
            let Ok(asked) = lane.receive(&mut message) else { return Ok(()) };
            if asked != kind::ANSWER {
                request = asked;
            }
            self.pass(id, asked, &mut message, &mut host_clock)?;
            // The sender lives as long as this thread.
            let Ok(Received { turn, payload, begin }) = received.recv() else { return Ok(()) };
            let mut reader = payload.reader();
            reader.seek(SeekFrom::Start(begin))?;
            self.pools.fill(&turn.frames, true, &mut reader, id, &self.decoders)?;
            let (answer, is_done) = (&turn.message, turn.kind == kind::DONE);
            if is_done && request == kind::PROCESS {
                for output in relay::outputs(answer)? {
                    if self.is_own(&output)? {
                        lock(&self.there).own.insert((output.pool, output.offset));
                    }
                }
            }
            let is_over = is_done && (request == kind::CLOSE || (request == kind::OPEN && !relay::succeeded(answer)?));
            let arrived_ns = self.arrival(&turn, host_clock).filter(|_| is_done && request == kind::PROCESS);
            let answer = match arrived_ns {
                Some(arrived_ns) => {
                    relay::arrived(answer, arrived_ns, &mut rewritten)?;
                    &rewritten
                }
                None => answer,
            };
            lane.post(turn.kind, answer)?;
            if is_over {
                return Ok(());
            }
        }
    }

    fn is_own(&self, frame: &Bytes) -> Result<bool, BadMessage> {
        Ok(self.pools.get(frame.pool)?.is_own)
    }

    /// Time at which a result was made, ns of the host's clock. It is the arrival of the light of a source's tick
    /// unless the source sets one.
    fn arrival(&self, turn: &Turn, host_clock: Option<i64>) -> Option<i64> {
        let (offset_ns, _) = self.offset()?;
        Some(turn.at_ns.saturating_sub(offset_ns).saturating_add(host_clock?))
    }

    /// Sends a message of the host, with the frames that the other machine lacks.
    fn pass(
        &self,
        lane: u32,
        asked: u32,
        message: &mut Vec<u8>,
        host_clock: &mut Option<i64>,
    ) -> Result<(), RemoteError> {
        let offset_ns = self.offset().map_or(0, |(offset_ns, _)| offset_ns);
        let mut turn = Turn { lane, kind: asked, ..Turn::default() };
        let mut inputs = Vec::new();
        if asked == kind::PROCESS {
            let mut request = Request::read(message)?;
            if let Some(difference_ns) = request.move_clock(offset_ns) {
                *host_clock = Some(difference_ns);
                request.write(message);
            }
            // Before the lock: a pool that is still on its way is sent by another thread.
            for (slot, input) in (0..).zip(request.inputs()) {
                inputs.push((slot, input, self.is_own(&input)?));
            }
        } else if asked == kind::OPEN {
            let hash = |path: &str| Some(FileHash { sha256: self.hashes.of(path.as_ref())?, path: path.to_owned() });
            turn.files = Open::read(message)?.files().filter_map(hash).collect();
        }
        turn.message = std::mem::take(message);
        let mut there = lock(&self.there);
        let mut frames = Vec::new();
        for (slot, input, is_own) in inputs {
            if there.takes(&input, is_own) {
                let stream = (lane, slot);
                let (head, bytes) = self.pools.coded(&input, self.arguments.pixels, stream, &self.encoders)?;
                turn.frames.push(head);
                frames.push(bytes);
            }
        }
        turn.at_ns = system_ns().saturating_add(offset_ns);
        let turn = Message::Turn(turn);
        self.put(&turn, frames)?;
        if let Message::Turn(turn) = turn {
            // Its memory is used again.
            *message = turn.message;
        }
        Ok(())
    }
}

impl There {
    /// Whether a frame has to be sent; it then counts as sent.
    fn takes(&mut self, frame: &Bytes, is_own: bool) -> bool {
        let buffer = (frame.pool, frame.offset);
        match is_own {
            true => self.own.insert(buffer),
            false => self.sent.insert(buffer, frame.uses) != Some(frame.uses),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_frame_crosses_once() {
        let mut there = There::default();
        let frame = |offset, uses| Bytes { pool: 3, offset, len: 8, is_pixels: true, colour_px: None, uses };
        assert!(there.takes(&frame(0, 1), false) && !there.takes(&frame(0, 1), false));
        assert!(there.takes(&frame(64, 1), false), "another buffer");
        assert!(there.takes(&frame(0, 2), false), "the buffer was handed out again: other bytes");
        assert!(
            there.takes(&frame(0, 0), true) && !there.takes(&frame(0, 0), true),
            "only the other machine writes it"
        );
    }

    #[test]
    fn arguments_are_those_of_the_host() {
        let words = |words: &[&str]| words.iter().map(OsString::from).collect::<Vec<_>>();
        let parsed =
            Arguments::parse(&words(&["tls/10.0.0.2:7447", "lz4", "1500", "false", "rack"])).expect("arguments");
        assert_eq!(
            (parsed.timeout, parsed.pixels, parsed.plaintext),
            (Duration::from_millis(1500), Pixels::Lz4, false)
        );
        assert_eq!(Arguments::parse(&words(&["tls/10.0.0.2:7447", "jpeg", "1500", "false", "rack"])), None);
        assert_eq!(Arguments::parse(&words(&["tls/10.0.0.2:7447", "raw", "soon", "false", "rack"])), None);
        assert_eq!(Arguments::parse(&words(&["rack"])), None);
    }
}
