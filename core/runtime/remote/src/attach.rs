//! Connects a window to a running graph of another machine. Its parent is the window and gives it a socket as standard
//! input.

use std::io::BufReader;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use panoscope_engine::sync::lock;
use panoscope_host::attach::tunnel::{self, ClockFrame, Frame, Kind};
use panoscope_host::isolate::system_ns;
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::sample::Sample;

use crate::attachable::{BYE, DATA, HELLO, message, parent, split};
use crate::clock::Offset;
use crate::error::RemoteError;
use crate::keys;
use crate::link::{leave, lose, reach};
use crate::network;

/// Probes of the clock within the machine's timeout.
const PROBES: u32 = 10;

struct Connection {
    parent: Mutex<UnixStream>,
    clock: Mutex<Offset>,
    heard_ns: AtomicI64,
    is_ready: AtomicBool,
    address: String,
    name: String,
    timeout: Duration,
}

/// Carries frames until the window ends; ends the process with a message if the machine is lost.
///
/// # Errors
/// The program was started with invalid arguments.
pub fn run(address: &str, timeout_ms: &str, plaintext: bool, name: &str) -> Result<(), RemoteError> {
    let parent = parent()?;
    let timeout_ms: u32 =
        timeout_ms.parse().map_err(|cause| RemoteError::NotANumber { text: timeout_ms.to_owned(), cause })?;
    let timeout = Duration::from_millis(timeout_ms.clamp(100, 60_000).into());
    if !keys::is_name(name) {
        lose(RemoteError::BadName { name: name.to_owned() });
    }
    let (session, host) = match reach(address, timeout, plaintext, "panoscope run --attachable") {
        Ok(reached) => reached,
        Err(error) => lose(error),
    };
    let prefix = network::prefix(name, &host, &session.zid().to_string());
    let from = parent.try_clone()?;
    let connection = Arc::new(Connection {
        parent: Mutex::new(parent),
        clock: Mutex::default(),
        heard_ns: AtomicI64::new(system_ns()),
        is_ready: AtomicBool::new(false),
        address: address.to_owned(),
        name: name.to_owned(),
        timeout,
    });
    let hear = |key: &str, receive: fn(&Connection, &Sample)| {
        let mine = Arc::clone(&connection);
        let callback = move |sample: Sample| {
            mine.heard_ns.store(system_ns(), Ordering::Relaxed);
            receive(&mine, &sample);
        };
        session.declare_subscriber(format!("{prefix}/{key}")).callback(callback).wait()
    };
    // They live as long as the session.
    let _up = hear("up", Connection::receive)?;
    let _pong = hear("pong", Connection::measure)?;
    let publish = |key: &str, is_urgent| network::publisher(&session, format!("{prefix}/{key}"), is_urgent);
    let (ping, down) = (publish("ping", true)?, publish("down", false)?);
    let called = address.to_owned();
    let watch = network::watch_end(&down, move || lose(format_args!("the connection to {called} ended")))?;
    let hello = [&timeout_ms.to_le_bytes()[..], crate::version().as_bytes()].concat();
    down.put(message(HELLO, hello)).wait()?;
    connection.tell(&Frame::words(Kind::Ready, 0, &host));
    let mine = Arc::clone(&connection);
    std::thread::Builder::new().spawn(move || mine.probe(&ping))?;
    let mut from = BufReader::new(from);
    while let Ok(Some(frame)) = tunnel::receive(&mut from) {
        if frame.kind == Kind::Data {
            down.put(message(DATA, frame.bytes)).wait()?;
        }
    }
    // A connection that this side closes is not lost.
    drop(watch);
    let _ = down.put(message(BYE, Vec::new())).wait();
    let _ = session.close().wait();
    leave(0)
}

impl Connection {
    fn tell(&self, frame: &Frame) {
        // A window that is gone ends what is read from it too.
        let _ = tunnel::send(&mut *lock(&self.parent), frame);
    }

    fn receive(&self, sample: &Sample) {
        match split(sample) {
            Some((HELLO, _)) => self.is_ready.store(true, Ordering::Relaxed),
            Some((DATA, bytes)) => self.tell(&Frame { kind: Kind::Data, session: 0, bytes }),
            Some((BYE, words)) => lose(String::from_utf8_lossy(&words)),
            _ => lose("a message of the machine is malformed; install the same version on both"),
        }
    }

    /// Measures the clock with the answer to a probe: send time and remote clock.
    fn measure(&self, sample: &Sample) {
        let now_ns = system_ns();
        let clock = {
            let mut clock = lock(&self.clock);
            let Some(()) = clock.take_answer(&sample.payload().to_bytes(), now_ns) else { return };
            let round_trip_ns = clock.round_trip_ns();
            clock.at(now_ns).map(|(offset_ns, error_ns)| ClockFrame { offset_ns, error_ns, round_trip_ns })
        };
        if let Some(clock) = clock {
            self.tell(&Frame { kind: Kind::Clock, session: 0, bytes: clock.bytes() });
        }
    }

    /// Measures the clock, and ends the process when the machine is silent for too long.
    fn probe(&self, ping: &Publisher<'static>) {
        let begin_ns = system_ns();
        let beyond = |since_ns: i64| {
            Duration::from_nanos(system_ns().saturating_sub(since_ns).max(0).unsigned_abs()) > self.timeout
        };
        loop {
            let _ = ping.put(system_ns().to_le_bytes()).wait();
            std::thread::sleep(self.timeout / PROBES);
            let (address, name, seconds) = (&self.address, &self.name, self.timeout.as_secs_f64());
            if beyond(self.heard_ns.load(Ordering::Relaxed))
                || beyond(begin_ns) && !self.is_ready.load(Ordering::Relaxed)
            {
                lose(match self.is_ready.load(Ordering::Relaxed) {
                    true => format!("{address} sent nothing for {seconds} s"),
                    false => format!(
                        "{address} does not answer within {seconds} s: its name is not `{name}`, or it lets no window of this machine attach"
                    ),
                });
            }
        }
    }
}
