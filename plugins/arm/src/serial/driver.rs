//! The driver's own thread. It owns the line and the interlock, and keeps running when the graph stalls.
//!
//! Every 10 ms it reads the arm's answers, advances the interlock to the present, and sends a set-point while anything moves. The node posts requests
//! and tips; neither thread waits for the other. This thread has its own clock, because it has to notice that the graph has stalled.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_arm_core::interlock::{Cause, Event, Evidence, Settings};
use panoscope_arm_core::line::{Line, Reader, SEQ_END};
use panoscope_arm_core::{Chain, Interlock, JointVector};

use super::port::{Port, PortError};

/// Time between two lines to the arm.
const PERIOD: Duration = Duration::from_millis(10);
/// Time limit of the arm's first answer.
const FIRST_ANSWER: Duration = Duration::from_millis(500);
/// Unreadable lines in a row that count as noise; more stop the arm.
const NOISE_LINES: u32 = 2;
/// Largest lag of the arm behind its set-points: s at its speed, plus rad.
const LAG_S: f64 = 0.15;
const LAG_RAD: f64 = 0.02;

/// How to reach the arm.
#[derive(Clone, Debug)]
pub struct Connection {
    /// The device's file.
    pub path: PathBuf,
    /// Bits per second.
    pub baud: u32,
    /// Time without an answer after which the arm is stopped.
    pub answer_within: Duration,
}

/// When a packet was posted, and how old its light was then.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// When the node received the packet.
    pub posted: Instant,
    /// Age of the light at that moment.
    pub age_ns: i64,
}

/// Requested joint velocities.
#[derive(Clone, Copy, Debug)]
pub struct Demand {
    /// rad/s.
    pub velocity: [f64; 8],
    /// How many of them were given.
    pub count: usize,
    /// Its time and that of the light that it was computed from.
    pub light: Light,
}

/// Posted by the node, taken by the thread.
#[derive(Debug, Default)]
pub struct Inbox {
    /// Requested joint velocities.
    pub demand: Option<Demand>,
    /// The newest tip.
    pub tip: Option<(Evidence, Light)>,
    /// New settings of the interlock.
    pub settings: Option<Settings>,
    /// Whether `emergency_stop` is on.
    pub emergency_stop: bool,
    /// Releases a latched stop.
    pub release: bool,
}

/// State of the arm, written by the thread, read by the node.
#[derive(Clone, Debug)]
pub struct Outbox {
    /// Joint angles by the encoders, rad.
    pub encoders: JointVector,
    /// Newest set-point: rad and rad/s.
    pub set_point: (JointVector, JointVector),
    /// Cause of the present stop.
    pub stop: Option<Cause>,
    /// Whether the stop latched.
    pub latched: bool,
    /// Stops since the driver started.
    pub stops: u64,
    /// Age of the newest answer, ms.
    pub answer_age_ms: f64,
    /// Distance of the tube from the trocar at the set-points, mm.
    pub pivot_mm: f64,
    /// Depth of the tube behind the trocar at the set-points, mm.
    pub depth_mm: f64,
    /// Events for the log, 64 at most.
    pub events: VecDeque<Event>,
}

/// Shared between node and thread.
struct Shared {
    inbox: Mutex<Inbox>,
    outbox: Mutex<Outbox>,
    leave: AtomicBool,
}

/// Latched stops outlive the node: a driver that is opened again on the same line starts stopped.
static LATCHED: Mutex<Vec<(PathBuf, Cause)>> = Mutex::new(Vec::new());

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Plain data: what a panicking thread left is whole.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn remember(path: &std::path::Path, cause: Option<Cause>) {
    let mut all = locked(&LATCHED);
    all.retain(|(known, _)| known != path);
    all.extend(cause.map(|cause| (path.to_owned(), cause)));
}

/// The running driver.
pub struct Driver {
    path: PathBuf,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Driver {
    /// Opens the line, asks where the arm is, and starts the thread.
    ///
    /// # Errors
    /// The line cannot be opened, no arm answers on it, or the thread cannot be started.
    pub fn start(connection: &Connection, chain: Chain) -> Result<Self, PortError> {
        let mut line = ArmLine::open(connection)?;
        line.encoders = line.hello(&connection.path)?;
        let mut lock = Interlock::new(chain, line.encoders, 0);
        let known = locked(&LATCHED).iter().find(|(path, _)| *path == connection.path).map(|(_, cause)| *cause);
        if let Some(cause) = known {
            lock.latch(cause);
        }
        let outbox = Outbox {
            encoders: line.encoders,
            set_point: (line.encoders, JointVector::zeros()),
            stop: lock.stopped(),
            latched: lock.latched().is_some(),
            stops: 0,
            answer_age_ms: 0.0,
            pivot_mm: lock.tube().pivot_mm,
            depth_mm: lock.tube().depth_mm,
            events: VecDeque::with_capacity(64),
        };
        let shared = Arc::new(Shared {
            inbox: Mutex::new(Inbox::default()),
            outbox: Mutex::new(outbox),
            leave: AtomicBool::new(false),
        });
        let mut work = Work {
            shared: Arc::clone(&shared),
            connection: connection.clone(),
            line: Some(line),
            lock,
            start: Instant::now(),
            was_latched: known,
        };
        let thread = std::thread::Builder::new()
            .name("arm_serial".to_owned())
            .spawn(move || work.run())
            .map_err(PortError::Gone)?;
        Ok(Self { path: connection.path.clone(), shared, thread: Some(thread) })
    }

    /// Posts to the thread.
    pub fn post(&self, what: impl FnOnce(&mut Inbox)) {
        what(&mut locked(&self.shared.inbox));
    }

    /// The newest state. Calls `event` once for each new event.
    ///
    /// # Errors
    /// The thread has ended by itself. The stop is latched: a driver that is opened again on this line starts stopped.
    pub fn read(&self, mut event: impl FnMut(Event)) -> Result<Outbox, PortError> {
        if self.thread.as_ref().is_none_or(JoinHandle::is_finished) {
            remember(&self.path, Some(Cause::DriverFailed));
            return Err(PortError::DriverFailed);
        }
        let mut outbox = locked(&self.shared.outbox);
        while let Some(next) = outbox.events.pop_front() {
            event(next);
        }
        Ok(outbox.clone())
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        self.shared.leave.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // The panic hook has reported a panic there; the arm's own watchdog has stopped the arm.
            let _ = thread.join();
        }
    }
}

/// The open line and the newest answer.
struct ArmLine {
    port: Port,
    reader: Reader,
    seq: u32,
    encoders: JointVector,
    answered: Instant,
    nonsense: u32,
    is_ready: bool,
    out: Vec<u8>,
}

impl ArmLine {
    fn open(connection: &Connection) -> Result<Self, PortError> {
        Ok(Self {
            port: Port::open(&connection.path, connection.baud)?,
            reader: Reader::default(),
            seq: 0,
            encoders: JointVector::zeros(),
            answered: Instant::now(),
            nonsense: 0,
            is_ready: true,
            out: Vec::with_capacity(256),
        })
    }

    fn send(&mut self, line: impl FnOnce(u32) -> Line) -> Result<(), PortError> {
        self.seq = (self.seq + 1) % SEQ_END;
        self.out.clear();
        line(self.seq).write(&mut self.out);
        self.port.write(&self.out)
    }

    /// Reads all answers that have arrived.
    fn listen(&mut self) -> Result<(), PortError> {
        let mut buffer = [0; 512];
        // Bounded, so that a device that sends without pause cannot hold this thread.
        for _ in 0..16 {
            let count = self.port.read(&mut buffer)?;
            if count == 0 {
                break;
            }
            let Self { reader, encoders, answered, nonsense, is_ready, .. } = self;
            reader.take(&buffer[..count], |line| match line {
                Some(Line::Answer { ready, position, .. }) => {
                    (*encoders, *answered, *nonsense, *is_ready) = (position, Instant::now(), 0, ready);
                }
                _ => *nonsense = nonsense.saturating_add(1),
            });
        }
        Ok(())
    }

    /// Waits for the first answer.
    fn hello(&mut self, path: &std::path::Path) -> Result<JointVector, PortError> {
        let start = Instant::now();
        let mut garbage = 0;
        while start.elapsed() < FIRST_ANSWER {
            let before = self.answered;
            self.send(|seq| Line::Clear { seq })?;
            self.send(|seq| Line::Hello { seq })?;
            std::thread::sleep(PERIOD);
            self.listen()?;
            if self.answered > before {
                self.nonsense = 0;
                return Ok(self.encoders);
            }
            garbage = self.nonsense;
        }
        Err(PortError::NoArm { path: path.to_owned(), wait_ms: FIRST_ANSWER.as_millis(), garbage })
    }
}

/// What the thread owns.
struct Work {
    shared: Arc<Shared>,
    connection: Connection,
    line: Option<ArmLine>,
    lock: Interlock,
    start: Instant,
    was_latched: Option<Cause>,
}

impl Work {
    /// A moment by the interlock's clock, ns.
    fn at(&self, moment: Instant) -> i64 {
        i64::try_from(moment.saturating_duration_since(self.start).as_nanos()).unwrap_or(i64::MAX)
    }

    fn now_ns(&self) -> i64 {
        self.at(Instant::now())
    }

    fn run(&mut self) {
        let mut next = Instant::now();
        let mut leaving = None;
        loop {
            if self.shared.leave.load(Ordering::Acquire) {
                // No more requests arrive: the interlock brakes, then the thread ends.
                let since = *leaving.get_or_insert_with(Instant::now);
                if self.lock.set_point().is_at_rest() || since.elapsed() > Duration::from_secs(2) {
                    return;
                }
            }
            self.turn(leaving.is_some());
            next += PERIOD;
            let now = Instant::now();
            // Missed periods are skipped, not made up for.
            next = next.max(now);
            std::thread::sleep(next - now);
        }
    }

    fn turn(&mut self, leaving: bool) {
        let now_ns = self.now_ns();
        if let Some(cause) = self.listen() {
            self.lock.latch(cause);
        }
        let inbox = std::mem::take(&mut *locked(&self.shared.inbox));
        // Stays on until the node posts again.
        locked(&self.shared.inbox).emergency_stop |= inbox.emergency_stop;
        if let Some(settings) = inbox.settings {
            self.lock.set(settings);
        }
        if inbox.release && !inbox.emergency_stop {
            self.release();
        }
        if inbox.emergency_stop {
            self.lock.latch(Cause::EmergencyStop);
        }
        if let Some((evidence, light)) = inbox.tip.filter(|_| !leaving) {
            self.lock.tip(self.at(light.posted).saturating_sub(light.age_ns), evidence);
        }
        if let Some(Demand { velocity, count, light }) = inbox.demand.filter(|_| !leaving) {
            let made_ns = self.at(light.posted);
            let velocity = &velocity[..count.min(velocity.len())];
            self.lock.demand_of_light(made_ns, made_ns.saturating_sub(light.age_ns), velocity);
        }
        self.lock.advance(now_ns, &mut |_| {});
        let point = *self.lock.set_point();
        let moving = !point.is_at_rest() || self.lock.stop().is_none();
        if let Some(line) = &mut self.line {
            let sent = if moving {
                line.send(|seq| Line::Set { seq, position: point.position, velocity: point.velocity })
            } else {
                line.send(|seq| Line::Hello { seq })
            };
            if sent.is_err() {
                self.line = None;
                self.lock.latch(Cause::Unplugged);
            }
        }
        if self.lock.latched() != self.was_latched {
            self.was_latched = self.lock.latched();
            remember(&self.connection.path, self.was_latched);
        }
        self.report(point);
    }

    /// Reads answers. Returns a cause to stop when they are missing or wrong.
    fn listen(&mut self) -> Option<Cause> {
        let line = self.line.as_mut()?;
        if line.listen().is_err() {
            self.line = None;
            return Some(Cause::Unplugged);
        }
        if line.nonsense > NOISE_LINES {
            line.nonsense = 0;
            return Some(Cause::Garbage);
        }
        if line.answered.elapsed() > self.connection.answer_within + PERIOD {
            return Some(Cause::Stalled);
        }
        if !line.is_ready {
            return Some(Cause::DeviceStopped);
        }
        let point = self.lock.set_point();
        let off = (line.encoders - point.position).amax();
        (off > LAG_RAD + LAG_S * point.velocity.amax().max(0.1)).then_some(Cause::NotFollowing)
    }

    /// Releases a latched stop. Opens a lost line again; set-points start at the arm's present angles.
    fn release(&mut self) {
        if !self.lock.set_point().is_at_rest() {
            return;
        }
        if self.line.is_none() {
            self.line = ArmLine::open(&self.connection).ok();
        }
        let Some(line) = &mut self.line else { return };
        let Ok(encoders) = line.hello(&self.connection.path) else { return };
        let (now_ns, stops) = (self.now_ns(), self.lock.stops());
        let mut lock = Interlock::new(self.lock.chain().clone(), encoders, now_ns);
        lock.count_stops_from(stops);
        self.lock = lock;
    }

    fn report(&mut self, point: panoscope_arm_core::SetPoint) {
        let tube = self.lock.tube();
        let mut outbox = locked(&self.shared.outbox);
        if let Some(line) = &self.line {
            outbox.encoders = line.encoders;
            outbox.answer_age_ms = line.answered.elapsed().as_secs_f64() * 1e3;
        }
        outbox.set_point = (point.position, point.velocity);
        outbox.stop = self.lock.stopped();
        outbox.latched = self.lock.latched().is_some();
        outbox.stops = self.lock.stops();
        (outbox.pivot_mm, outbox.depth_mm) = (tube.pivot_mm, tube.depth_mm);
        while let Some(event) = self.lock.take_event() {
            if outbox.events.len() == 64 {
                outbox.events.pop_front();
            }
            outbox.events.push_back(event);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_ends_by_itself_is_an_error_and_latches() {
        let chain = crate::joints::arm_of(std::path::Path::new("")).expect("the arm of the plugin");
        let encoders = JointVector::zeros();
        let lock = Interlock::new(chain, encoders, 0);
        let outbox = Outbox {
            encoders,
            set_point: (encoders, encoders),
            stop: None,
            latched: false,
            stops: 0,
            answer_age_ms: 0.0,
            pivot_mm: lock.tube().pivot_mm,
            depth_mm: lock.tube().depth_mm,
            events: VecDeque::new(),
        };
        let (inbox, outbox, leave) = (Mutex::default(), Mutex::new(outbox), AtomicBool::new(false));
        let shared = Arc::new(Shared { inbox, outbox, leave });
        let (end, ended) = std::sync::mpsc::channel::<()>();
        let thread = std::thread::spawn(move || {
            let _ = ended.recv();
            panic!("as a driver's thread may");
        });
        let path = PathBuf::from("/dev/of_the_test");
        let driver = Driver { path: path.clone(), shared, thread: Some(thread) };
        assert!(driver.read(|_| {}).is_ok_and(|outbox| outbox.stop.is_none()));
        drop(end);
        while driver.read(|_| {}).is_ok() {
            std::thread::yield_now();
        }
        assert!(driver.read(|_| {}).is_err_and(|error| error.to_string().contains("driver")));
        drop(driver);
        let known = locked(&LATCHED).iter().find(|(known, _)| *known == path).map(|(_, cause)| *cause);
        assert_eq!(known, Some(Cause::DriverFailed), "the next driver on this line starts stopped");
        remember(&path, None);
    }
}
