//! The loop of the guard. It owns the connection to the arm, the interlock and the latches, and continues when the
//! program does not.
//!
//! Every few milliseconds ([`ArmPort::period`]) it reads the arm's answers and the program's requests, advances the
//! interlock to the present, and sends a set-point while anything moves. Nothing is allocated and no file is written
//! while the arm moves.

use std::os::fd::{AsFd, OwnedFd};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use panoscope_arm_core::interlock::Measured;
use panoscope_arm_core::interlock::caps::STEP_NS;
use panoscope_arm_core::{Cause, Chain, Interlock, JointVector};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::net::{RecvFlags, SendFlags, recv, send};
use thiserror::Error;

use crate::arm_port::{ArmPort, Identity};
use crate::clock;
use crate::latch::{LatchError, LatchStore, Record};
use crate::message::{MAX_LEN, Report, Request, Status};
use crate::port::PortError;
use crate::realtime;
use crate::target::Target;

/// Damaged lines in a row that count as noise; more stop the arm.
const NOISE_LINES: u32 = 2;
/// Maximum lag of the arm behind its set-points, s at its speed.
const LAG_S: f64 = 0.15;
const LAG_RAD: f64 = 0.02;
/// Maximum number of requests read in one turn, so that a flood cannot block the loop.
const REQUESTS_PER_TURN: u32 = 256;
/// Minimum time between two checks of encoder angles, ns.
const MEASURED_STEP_NS: i64 = 5_000_000;
/// Maximum distance of a time stamp into the future, ns.
const FUTURE_NS: i64 = 1_000_000;
/// Time limit in which the arm clears its own stop.
const CLEAR_WITHIN: Duration = Duration::from_millis(250);
/// Longest time to brake after the program has ended.
const LEAVE_WITHIN: Duration = Duration::from_secs(2);
/// Minimum speed in bits per second at which a line has room for a set-point between two periods.
const FAST_BAUD: u32 = 230_400;
/// Minimum speed in bits per second at which it has room for two more.
const FASTER_BAUD: u32 = 460_800;
/// Time between the turns that follow the expiry of a demand.
const SOON: Duration = Duration::from_millis(2);

/// The guard could not start.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The arm cannot be reached.
    #[error(transparent)]
    Port(#[from] PortError),
    /// Latched stops cannot be kept.
    #[error(transparent)]
    Latch(#[from] LatchError),
    /// The socket to the program cannot be used.
    #[error("the connection to the program failed: {0}")]
    Socket(#[from] Errno),
}

/// Settings of the guard.
pub struct Options {
    /// Connection to the arm.
    pub target: Target,
    /// The arm.
    pub chain: Chain,
    /// Folder of the latches.
    pub latches: PathBuf,
}

/// Runs until the program closes its end of `socket` and the arm is at rest.
///
/// # Errors
/// The arm is not found, or latched stops cannot be kept. The program receives the reason as [`Report::Failed`], too.
pub fn serve(socket: OwnedFd, options: Options) -> Result<(), ServeError> {
    match Server::start(socket.try_clone().map_err(|_| Errno::MFILE)?, options) {
        Ok(mut server) => {
            server.run();
            Ok(())
        }
        Err(error) => {
            let mut out = [0; MAX_LEN];
            let _ = send(socket.as_fd(), Report::Failed(error.to_string()).encode(&mut out), SendFlags::empty());
            Err(error)
        }
    }
}

struct Server {
    socket: OwnedFd,
    options: Options,
    link: Option<Box<dyn ArmPort>>,
    /// Time between two turns.
    period: Duration,
    identity: Identity,
    latches: LatchStore,
    lock: Interlock,
    measured: Measured,
    /// Time of the newest encoder angles that were checked, ns.
    judged_ns: i64,
    /// The newest `reset`; the first request sets it.
    reset: Option<u64>,
    /// When the present stop latched, ns: an older reset does not release it.
    latched_ns: i64,
    last_sent_ns: i64,
    refused: u64,
    has_host: bool,
    /// Whether the last line was a set-point of a moving arm.
    was_moving: bool,
    /// Number of early turns left after a demand expired or the program ended, because the first steps of braking are
    /// below the resolution of a line.
    soon: u8,
}

impl Server {
    fn start(socket: OwnedFd, options: Options) -> Result<Self, ServeError> {
        let (link, identity) = options.target.open()?;
        let (latches, stop) = LatchStore::open(&options.latches, &identity.serial)?;
        let mut lock = Interlock::new(options.chain.clone(), link.answer().encoders, clock::now_ns());
        lock.latch(stop.unwrap_or(Cause::AwaitsOperator));
        let measured = Measured::new(&options.chain);
        let granted = realtime::request();
        let server = Self {
            socket,
            options,
            period: link.period(),
            link: Some(link),
            identity,
            latches,
            lock,
            measured,
            judged_ns: i64::MIN,
            reset: None,
            latched_ns: clock::now_ns(),
            last_sent_ns: i64::MIN,
            refused: 0,
            has_host: true,
            was_moving: false,
            soon: 0,
        };
        let granted = (granted.locked_memory, granted.real_time);
        server.report(&Report::Ready { serial: identity.serial, watchdog_ms: identity.watchdog_ms, granted });
        Ok(server)
    }

    fn run(&mut self) {
        let mut next = Instant::now();
        let mut leaving: Option<Instant> = None;
        loop {
            self.turn();
            if !self.has_host {
                let since = *leaving.get_or_insert_with(Instant::now);
                if self.lock.set_point().is_at_rest() || since.elapsed() > LEAVE_WITHIN {
                    return;
                }
            }
            // Missed periods are skipped, not made up for.
            next = (next + self.period).max(Instant::now());
            if self.wait(next) {
                next = Instant::now();
            }
        }
    }

    /// Sleeps until `next`, or until the demand expires or the program ends, so that braking is sent at once. True when
    /// it woke early.
    fn wait(&mut self, next: Instant) -> bool {
        let left = next.saturating_duration_since(Instant::now());
        let mut sleep = left;
        if self.soon > 0 {
            self.soon -= 1;
            sleep = sleep.min(SOON);
        } else if let Target::Serial(line) = &self.options.target
            && line.baud >= FAST_BAUD
            && let Some(expires_ns) = self.lock.expires_ns()
        {
            // Two steps later the first set-point that brakes exists, wherever the expiry lies between two steps.
            let until_ns = expires_ns.saturating_add(2 * STEP_NS).saturating_sub(clock::now_ns());
            let until = Duration::from_nanos(until_ns.max(STEP_NS).unsigned_abs());
            if until < sleep {
                sleep = until;
                self.soon = if line.baud >= FASTER_BAUD { 2 } else { 0 };
            }
        }
        if !self.has_host {
            std::thread::sleep(sleep);
            return sleep < left;
        }
        let timeout = Timespec { tv_sec: 0, tv_nsec: sleep.subsec_nanos().into() };
        let mut host = [PollFd::new(&self.socket, PollFlags::RDHUP)];
        let has_ended = poll(&mut host, Some(&timeout)).is_ok_and(|count| count > 0);
        if has_ended {
            self.soon = 2;
        }
        has_ended || sleep < left
    }

    /// Latches a stop that was found at `at_ns`.
    fn latch(&mut self, cause: Cause, at_ns: i64) {
        if self.lock.latched().is_none() {
            self.latched_ns = at_ns;
        }
        self.lock.latch(cause);
    }

    fn turn(&mut self) {
        let now_ns = clock::now_ns();
        if let Some(cause) = self.listen(now_ns) {
            self.latch(cause, now_ns);
        }
        self.receive(now_ns);
        // A release takes time.
        let now_ns = clock::now_ns();
        self.lock.advance(now_ns, &mut |_| {});
        let point = *self.lock.set_point();
        // A program that has ended asks for nothing: the arm was left at rest, which is recorded.
        let is_moving = !point.is_at_rest() || (self.lock.stop().is_none() && self.has_host);
        if let Some(link) = &mut self.link {
            // The last set-point has speed 0: without it the arm's watchdog takes the end of a movement for a failure.
            let sent =
                if is_moving || self.was_moving { link.set(&point.position, &point.velocity) } else { link.query() };
            if sent.is_err() {
                self.link = None;
                self.latch(Cause::Unplugged, now_ns);
            }
        }
        self.was_moving = is_moving;
        if !is_moving {
            self.record();
        }
        self.publish(now_ns);
    }

    /// Writes a latched stop. Until then the file contains `released`, which counts as a stop after a restart.
    fn record(&mut self) {
        let record = match self.lock.latched() {
            // Nothing has changed since the start.
            Some(Cause::AwaitsOperator | Cause::CannotRecord) => return,
            Some(cause) => Record::Latched(cause),
            None if !self.has_host => Record::Rest,
            None => return,
        };
        // A disk that is full now may have room later: the next turn tries again.
        let _ = self.latches.write(record);
    }

    /// Reads the arm's answers. Returns a stop cause if they are missing, invalid, or beyond a limit.
    fn listen(&mut self, now_ns: i64) -> Option<Cause> {
        let link = self.link.as_mut()?;
        if let Err(error) = link.listen() {
            self.link = None;
            return Some(error.cause());
        }
        if link.answer().damaged > NOISE_LINES || link.identity().is_some_and(|identity| identity != self.identity) {
            link.forgive();
            return Some(Cause::Garbage);
        }
        let answer = *link.answer();
        let limit_ns = (self.options.target.answer_within() + self.period).as_nanos() as i64;
        if now_ns.saturating_sub(answer.answered_ns) > limit_ns {
            // The arm's own reason says more.
            return Some(answer.stop.unwrap_or(Cause::Stalled));
        }
        if answer.stop.is_some() {
            return answer.stop;
        }
        if answer.measured_ns.saturating_sub(self.judged_ns) >= MEASURED_STEP_NS {
            self.judged_ns = answer.measured_ns;
            if let Some(cause) = self.measured.check(&self.options.chain, answer.measured_ns, &answer.encoders) {
                return Some(cause);
            }
        }
        let point = self.lock.set_point();
        let off = (answer.encoders - point.position).amax();
        (off > LAG_RAD + LAG_S * point.velocity.amax().max(0.1)).then_some(Cause::NotFollowing)
    }

    /// Reads the program's requests and applies the newest one; an emergency stop in any of them takes effect.
    fn receive(&mut self, now_ns: i64) {
        if !self.has_host {
            return;
        }
        let mut newest: Option<Request> = None;
        // When the newest reset was made that no emergency stop followed.
        let mut reset_ns = None;
        let mut buffer = [0; MAX_LEN];
        for _ in 0..REQUESTS_PER_TURN {
            match recv(self.socket.as_fd(), &mut buffer, RecvFlags::DONTWAIT) {
                Ok((_, 0)) => {
                    self.host_has_ended();
                    return;
                }
                Ok((_, length)) => match Request::decode(&buffer[..length.min(MAX_LEN)]) {
                    Some(request) if self.is_in_order(&request, now_ns) => {
                        self.last_sent_ns = request.sent_ns;
                        if self.reset.replace(request.reset).is_some_and(|old| old != request.reset) {
                            reset_ns = Some(request.sent_ns);
                        }
                        if request.emergency_stop {
                            self.latch(Cause::EmergencyStop, request.sent_ns);
                            reset_ns = None;
                        }
                        newest = Some(request);
                    }
                    _ => self.refused += 1,
                },
                Err(Errno::AGAIN | Errno::INTR) => break,
                Err(_) => {
                    self.host_has_ended();
                    return;
                }
            }
        }
        if let Some(request) = newest {
            self.apply(&request, reset_ns.is_some_and(|at_ns| at_ns > self.latched_ns));
        }
    }

    /// Whether a request is newer than the last one and not from the future.
    fn is_in_order(&self, request: &Request, now_ns: i64) -> bool {
        request.sent_ns > self.last_sent_ns && request.sent_ns <= now_ns.saturating_add(FUTURE_NS)
    }

    fn host_has_ended(&mut self) {
        self.has_host = false;
        if !self.lock.set_point().is_at_rest() {
            self.latch(Cause::HostGone, clock::now_ns());
        }
        self.lock.demand(clock::now_ns(), JointVector::zeros().as_slice());
    }

    fn apply(&mut self, request: &Request, is_reset: bool) {
        self.lock.set(request.settings);
        if is_reset {
            self.release();
        }
        if let Some((light_ns, evidence)) = request.tip {
            self.lock.tip(light_ns, evidence);
        }
        if let Some((light_ns, values, count)) = request.demand {
            // Another number of values than the arm has joints is an invalid demand.
            self.lock.demand_of_light(request.sent_ns, light_ns, values.get(..count as usize).unwrap_or(&[]));
        }
    }

    /// Releases a latched stop after a person's reset. Reopens a lost line; set-points start at the arm's present
    /// angles.
    ///
    /// The arm is at rest, so this may block.
    fn release(&mut self) {
        if !self.lock.set_point().is_at_rest() {
            return;
        }
        let refused = match self.try_release() {
            Ok(()) => return,
            Err(cause) => cause,
        };
        // The newest reason counts: it is what a person has to remove.
        self.lock.release();
        self.lock.latch(refused);
    }

    fn try_release(&mut self) -> Result<(), Cause> {
        if self.link.is_none() {
            let (link, identity) = self.options.target.open().map_err(|error| error.cause())?;
            if identity.serial != self.identity.serial {
                // Another arm has other latches: it needs a guard of its own.
                return Err(Cause::Garbage);
            }
            self.link = Some(link);
        }
        let Some(link) = &mut self.link else { return Err(Cause::Unplugged) };
        link.forgive();
        let start_ns = clock::now_ns();
        let start = Instant::now();
        let lost = |error: PortError| error.cause();
        link.clear().map_err(lost)?;
        while link.answer().answered_ns < start_ns || link.answer().stop.is_some() {
            if start.elapsed() > CLEAR_WITHIN {
                return Err(link.answer().stop.unwrap_or(Cause::Stalled));
            }
            std::thread::sleep(self.period);
            link.listen().map_err(lost)?;
            link.query().map_err(lost)?;
        }
        let answer = *link.answer();
        self.measured.restart();
        self.judged_ns = answer.measured_ns;
        if let Some(cause) = self.measured.check(&self.options.chain, answer.measured_ns, &answer.encoders) {
            return Err(cause);
        }
        self.latches.write(Record::Released).map_err(|_| Cause::CannotRecord)?;
        let stops = self.lock.stops();
        let mut lock = Interlock::new(self.options.chain.clone(), answer.encoders, clock::now_ns());
        lock.count_stops_from(stops);
        self.lock = lock;
        Ok(())
    }

    fn publish(&mut self, now_ns: i64) {
        let tube = self.lock.tube();
        let point = *self.lock.set_point();
        let (encoders, answered_ns) = self
            .link
            .as_ref()
            .map_or((point.position, now_ns), |link| (link.answer().encoders, link.answer().answered_ns));
        let status = Status {
            at_ns: now_ns,
            encoders,
            set_point: (point.position, point.velocity),
            stop: self.lock.latched().or(self.lock.stopped()),
            latched: self.lock.latched().is_some(),
            stops: self.lock.stops(),
            answer_age_ms: now_ns.saturating_sub(answered_ns).max(0) as f64 / 1e6,
            pivot_mm: tube.pivot_mm,
            depth_mm: tube.depth_mm,
            refused: self.refused,
        };
        let mut out = [0; MAX_LEN];
        self.put(status.encode(&mut out));
        while let Some(event) = self.lock.take_event() {
            self.report(&Report::Event(event));
        }
    }

    fn report(&self, report: &Report) {
        self.put(report.encode(&mut [0; MAX_LEN]));
    }

    fn put(&self, record: &[u8]) {
        // A program that does not read loses records; the arm does not wait for it.
        let _ = send(self.socket.as_fd(), record, SendFlags::DONTWAIT | SendFlags::NOSIGNAL);
    }
}
