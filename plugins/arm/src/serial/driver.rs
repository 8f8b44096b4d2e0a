//! The driver's own thread: it owns line and interlock, and goes on when the graph does not.
//!
//! Every 10 ms it reads what the arm answered, steps the interlock to now, and sends a set-point while anything moves. The node leaves demands and
//! tips with their arrival times; nobody waits for anybody. This thread has a clock of its own, since it has to see that others stopped.

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

/// Time between two lines.
const PERIOD: Duration = Duration::from_millis(10);
/// How long an arm may take to answer for the first time.
const FIRST_ANSWER: Duration = Duration::from_millis(500);
/// Lines without sense in a row that are put down to noise.
const NOISE_LINES: u32 = 2;
/// How far the arm may lag behind its set-points, s of its speed, and beside that, rad.
const LAG_S: f64 = 0.15;
const LAG_RAD: f64 = 0.02;

/// Where the line is.
#[derive(Clone, Debug)]
pub struct Place {
    /// The device's file.
    pub path: PathBuf,
    /// Bits per second.
    pub baud: u32,
    /// Longest time without an answer.
    pub answer_within: Duration,
}

/// What the node leaves for the thread.
#[derive(Debug, Default)]
pub struct Inbox {
    /// Joint velocities, rad/s, as many as were asked for.
    pub demand: Option<([f64; 8], usize)>,
    /// What the tip proves, and how old it was when it came.
    pub tip: Option<(Evidence, Duration)>,
    /// Settings.
    pub settings: Option<Settings>,
    /// Whether somebody presses.
    pub emergency_stop: bool,
    /// A latched stop is to be let go.
    pub release: bool,
}

/// What the thread knows.
#[derive(Clone, Debug)]
pub struct Outbox {
    /// Where the encoders are, rad.
    pub encoders: JointVector,
    /// Where the set-points are, rad and rad/s.
    pub set_point: (JointVector, JointVector),
    /// Why it stands.
    pub stop: Option<Cause>,
    /// Whether the stop latched.
    pub latched: bool,
    /// Stops so far.
    pub stops: u64,
    /// Age of the newest answer, ms.
    pub answer_age_ms: f64,
    /// How far the set-points miss the trocar, mm, and how deep the tube stands, mm.
    pub pivot_mm: f64,
    /// See `pivot_mm`.
    pub depth_mm: f64,
    /// For the log; bounded.
    pub events: VecDeque<Event>,
}

/// Shared between node and thread.
struct Shared {
    inbox: Mutex<Inbox>,
    outbox: Mutex<Outbox>,
    leave: AtomicBool,
}

/// Latched stops outlive the node: one that is opened again on the same line starts with them.
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
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Driver {
    /// Opens the line, asks where the arm is, and starts the thread.
    ///
    /// # Errors
    /// No such line, nobody there that speaks the protocol, no thread to be had.
    pub fn start(place: &Place, chain: Chain) -> Result<Self, PortError> {
        let mut line = ArmLine::open(place)?;
        line.encoders = line.hello(&place.path)?;
        let mut lock = Interlock::new(chain, line.encoders, 0);
        let known = locked(&LATCHED).iter().find(|(path, _)| *path == place.path).map(|(_, cause)| *cause);
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
            pivot_mm: lock.place().pivot_mm,
            depth_mm: lock.place().depth_mm,
            events: VecDeque::with_capacity(64),
        };
        let shared = Arc::new(Shared {
            inbox: Mutex::new(Inbox::default()),
            outbox: Mutex::new(outbox),
            leave: AtomicBool::new(false),
        });
        let mut work = Work {
            shared: Arc::clone(&shared),
            place: place.clone(),
            line: Some(line),
            lock,
            start: Instant::now(),
            was_latched: known,
        };
        let thread = std::thread::Builder::new()
            .name("arm_serial".to_owned())
            .spawn(move || work.run())
            .map_err(PortError::Gone)?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Leaves something for the thread.
    pub fn tell(&self, what: impl FnOnce(&mut Inbox)) {
        what(&mut locked(&self.shared.inbox));
    }

    /// What the thread knows; its events are taken by `event`.
    pub fn look(&self, mut event: impl FnMut(Event)) -> Outbox {
        let mut outbox = locked(&self.shared.outbox);
        while let Some(next) = outbox.events.pop_front() {
            event(next);
        }
        outbox.clone()
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        self.shared.leave.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic in there was told by its hook; the arm's own watchdog has stopped it.
            let _ = thread.join();
        }
    }
}

/// The line with what came over it.
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
    fn open(place: &Place) -> Result<Self, PortError> {
        Ok(Self {
            port: Port::open(&place.path, place.baud)?,
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

    /// Reads what is there.
    fn listen(&mut self) -> Result<(), PortError> {
        let mut buffer = [0; 512];
        // A device that never stops talking is not listened to for ever.
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
    place: Place,
    line: Option<ArmLine>,
    lock: Interlock,
    start: Instant,
    was_latched: Option<Cause>,
}

impl Work {
    fn now_ns(&self) -> i64 {
        i64::try_from(self.start.elapsed().as_nanos()).unwrap_or(i64::MAX)
    }

    fn run(&mut self) {
        let mut next = Instant::now();
        let mut leaving = None;
        loop {
            if self.shared.leave.load(Ordering::Acquire) {
                // Nothing is asked for any more: the interlock brakes, then the thread goes.
                let since = *leaving.get_or_insert_with(Instant::now);
                if self.lock.set_point().is_at_rest() || since.elapsed() > Duration::from_secs(2) {
                    return;
                }
            }
            self.turn(leaving.is_some());
            next += PERIOD;
            let now = Instant::now();
            // Turns that were missed are not made up for.
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
        // Stays pressed until the node says otherwise.
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
        if let Some((evidence, age)) = inbox.tip.filter(|_| !leaving) {
            self.lock.tip(now_ns.saturating_sub(age.as_nanos() as i64), evidence);
        }
        if let Some((values, count)) = inbox.demand.filter(|_| !leaving) {
            self.lock.demand(now_ns, &values[..count.min(values.len())]);
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
            remember(&self.place.path, self.was_latched);
        }
        self.report(point);
    }

    /// Reads answers; a cause when something is wrong with them.
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
        if line.answered.elapsed() > self.place.answer_within + PERIOD {
            return Some(Cause::Stalled);
        }
        if !line.is_ready {
            return Some(Cause::DeviceStopped);
        }
        let point = self.lock.set_point();
        let off = (line.encoders - point.position).amax();
        (off > LAG_RAD + LAG_S * point.velocity.amax().max(0.1)).then_some(Cause::NotFollowing)
    }

    /// Lets a latched stop go: the line is opened again if it broke off, and set-points begin where the arm is.
    fn release(&mut self) {
        if !self.lock.set_point().is_at_rest() {
            return;
        }
        if self.line.is_none() {
            self.line = ArmLine::open(&self.place).ok();
        }
        let Some(line) = &mut self.line else { return };
        let Ok(encoders) = line.hello(&self.place.path) else { return };
        let (now_ns, stops) = (self.now_ns(), self.lock.stops());
        let mut lock = Interlock::new(self.lock.chain().clone(), encoders, now_ns);
        lock.count_stops_from(stops);
        self.lock = lock;
    }

    fn report(&mut self, point: panoscope_arm_core::SetPoint) {
        let place = self.lock.place();
        let mut outbox = locked(&self.shared.outbox);
        if let Some(line) = &self.line {
            outbox.encoders = line.encoders;
            outbox.answer_age_ms = line.answered.elapsed().as_secs_f64() * 1e3;
        }
        outbox.set_point = (point.position, point.velocity);
        outbox.stop = self.lock.stopped();
        outbox.latched = self.lock.latched().is_some();
        outbox.stops = self.lock.stops();
        (outbox.pivot_mm, outbox.depth_mm) = (place.pivot_mm, place.depth_mm);
        while let Some(event) = self.lock.take_event() {
            if outbox.events.len() == 64 {
                outbox.events.pop_front();
            }
            outbox.events.push_back(event);
        }
    }
}
