//! A simulated arm's controller on a pseudo-terminal. It speaks the line protocol of [`panoscope_arm_core::line`], with its own watchdog, motors with
//! lag, encoders with noise, late answers, and a line that damages bytes. [`ur`] is the same for a Universal Robots arm over RTDE.

mod rtde_server;
pub mod ur;
mod ur_behaviour;
pub mod urscript;

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Write};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_arm_core::JointVector;
use panoscope_arm_core::campaign::Random;
use panoscope_arm_core::line::{DeviceState, Line, Reader, Received, Serial, VERSION};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// Period of the simulated controller.
const PERIOD: Duration = Duration::from_millis(1);
/// Deceleration by the controller's own watchdog, rad/s^2.
const BRAKE_RAD_S2: f64 = 4.0;
/// Maximum acceleration of the motors, rad/s^2. A real motor does not jump when set-points arrive late and together.
const MOTOR_RAD_S2: f64 = 20.0;
/// Minimum movement that is logged, rad.
const LOGGED_RAD: f64 = 1e-7;
/// Maximum step in which movements are computed, s.
const MAX_STEP_S: f64 = 0.001;

/// Behaviour of the controller and its line. Everything may change while it runs.
#[derive(Clone, Copy, Debug)]
pub struct Behaviour {
    /// Time limit of the watchdog, ms.
    pub watchdog_ms: u32,
    /// Time constant of the motors, s; 0 is immediate.
    pub lag_s: f64,
    /// Encoder noise, rad, uniformly distributed.
    pub noise_rad: f64,
    /// Delay of answers.
    pub delay: Duration,
    /// Share of bytes, in both directions, that are lost, doubled, flipped, or followed by a random one.
    pub damaged_bytes: f64,
    /// Sends garbage instead of answers.
    pub is_garbage: bool,
    /// Does not answer.
    pub is_silent: bool,
    /// The motors do not move.
    pub is_stuck: bool,
    /// Speed at which the arm drifts by itself in its last joint, rad/s.
    pub runaway_rad_s: f64,
    /// The hardware stop is pressed.
    pub is_stopped: bool,
    /// The hardware has a fault.
    pub has_fault: bool,
    /// Answers every line with the previous line's number.
    pub has_wrong_numbers: bool,
    /// Speaks version 1 of the protocol.
    pub is_version_1: bool,
    /// The cable is unplugged.
    pub is_unplugged: bool,
}

impl Default for Behaviour {
    fn default() -> Self {
        Self {
            watchdog_ms: 30,
            lag_s: 0.015,
            noise_rad: 1e-5,
            delay: Duration::ZERO,
            damaged_bytes: 0.0,
            is_garbage: false,
            is_silent: false,
            is_stuck: false,
            runaway_rad_s: 0.0,
            is_stopped: false,
            has_fault: false,
            has_wrong_numbers: false,
            is_version_1: false,
            is_unplugged: false,
        }
    }
}

/// Events of the arm.
#[derive(Clone, Debug, Default)]
pub struct Log {
    /// Valid set-points: arrival, angles and speeds.
    pub set_points: Vec<(Instant, JointVector, JointVector)>,
    /// True angles, one entry per period in which the arm moved by more than 1e-7 rad: motors come to rest exponentially.
    pub angles: Vec<(Instant, JointVector)>,
    /// How often the watchdog stopped the arm.
    pub watchdog: u32,
    /// When it last did.
    pub watchdog_at: Option<Instant>,
    /// Number of `C` lines.
    pub clears: u32,
    /// When the last one arrived.
    pub cleared_at: Option<Instant>,
    /// Number of lines that were refused.
    pub damaged: u64,
    /// Number of lines that were accepted.
    pub lines: u64,
}

struct State {
    behaviour: Behaviour,
    log: Log,
    angles: JointVector,
}

/// A running controller. Dropping it unplugs the cable.
pub struct Firmware {
    path: String,
    state: Arc<(Mutex<State>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

fn locked(state: &Mutex<State>) -> MutexGuard<'_, State> {
    // Plain data: what a panicking thread left is whole.
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Firmware {
    /// Starts an arm at joint angles of 0.
    ///
    /// # Errors
    /// The system has no pseudo-terminal, or the serial number is invalid.
    pub fn plug_in(serial: &str, behaviour: Behaviour) -> io::Result<Self> {
        let serial = Serial::new(serial).ok_or_else(|| io::Error::other("invalid serial number"))?;
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = ptsname(&master, Vec::new())?.into_string().map_err(io::Error::other)?;
        rustix::fs::fcntl_setfl(&master, rustix::fs::OFlags::NONBLOCK)?;
        let state = State { behaviour, log: Log::default(), angles: JointVector::zeros() };
        let state = Arc::new((Mutex::new(state), Condvar::new()));
        let its_state = Arc::clone(&state);
        let thread = std::thread::Builder::new()
            .name("firmware".to_owned())
            .spawn(move || Controller::new(File::from(master), serial, its_state).run())?;
        Ok(Self { path, state, thread: Some(thread) })
    }

    /// The device to open.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Changes the arm's behaviour.
    pub fn set(&self, change: impl FnOnce(&mut Behaviour)) {
        change(&mut locked(&self.state.0).behaviour);
    }

    /// A copy of the log so far.
    pub fn log(&self) -> Log {
        locked(&self.state.0).log.clone()
    }

    /// Reads from the log without copying it.
    pub fn inspect<T>(&self, of: impl FnOnce(&Log) -> T) -> T {
        of(&locked(&self.state.0).log)
    }

    /// True joint angles, rad.
    pub fn angles(&self) -> JointVector {
        locked(&self.state.0).angles
    }

    /// Waits until `done` accepts the log; returns false after `limit`.
    pub fn wait(&self, limit: Duration, mut done: impl FnMut(&Log) -> bool) -> bool {
        let (state, changed) = &*self.state;
        let result = changed.wait_timeout_while(locked(state), limit, |state| !done(&state.log));
        result.map_or_else(|poisoned| poisoned.into_inner().1, |(_, timeout)| timeout).timed_out().eq(&false)
    }
}

impl Drop for Firmware {
    fn drop(&mut self) {
        self.set(|behaviour| behaviour.is_unplugged = true);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Controller {
    line: File,
    serial: Serial,
    shared: Arc<(Mutex<State>, Condvar)>,
    reader: Reader,
    random: Random,
    /// Delayed answers, with the time at which they are sent.
    late: VecDeque<(Instant, Vec<u8>)>,
    angles: JointVector,
    logged: JointVector,
    speed: JointVector,
    target: Option<(JointVector, JointVector)>,
    is_held: bool,
    fed: Instant,
}

impl Controller {
    fn new(line: File, serial: Serial, shared: Arc<(Mutex<State>, Condvar)>) -> Self {
        Self {
            line,
            serial,
            shared,
            reader: Reader::default(),
            random: Random::new(17),
            late: VecDeque::new(),
            angles: JointVector::zeros(),
            logged: JointVector::zeros(),
            speed: JointVector::zeros(),
            target: None,
            is_held: false,
            fed: Instant::now(),
        }
    }

    fn run(mut self) {
        let mut before = Instant::now();
        loop {
            let behaviour = locked(&self.shared.0).behaviour;
            if behaviour.is_unplugged {
                return;
            }
            let now = Instant::now();
            self.read(&behaviour, now);
            self.turn(&behaviour, now, (now - before).as_secs_f64());
            before = now;
            {
                let mut state = locked(&self.shared.0);
                state.angles = self.angles;
                if (self.angles - self.logged).amax() > LOGGED_RAD {
                    self.logged = self.angles;
                    state.log.angles.push((now, self.angles));
                }
            }
            self.shared.1.notify_all();
            self.write(&behaviour, now);
            std::thread::sleep(PERIOD);
        }
    }

    /// Damages some bytes.
    fn damaged(&mut self, bytes: &[u8], share: f64) -> Vec<u8> {
        let mut out = Vec::with_capacity(bytes.len() + 8);
        for &byte in bytes {
            if share > 0.0 && self.random.unit() < share {
                match self.random.of(4) {
                    0 => {}
                    1 => out.extend([byte, byte]),
                    2 => out.extend([byte, self.random.bits() as u8]),
                    _ => out.push(byte ^ (1 << self.random.of(8))),
                }
            } else {
                out.push(byte);
            }
        }
        out
    }

    fn read(&mut self, behaviour: &Behaviour, now: Instant) {
        let mut buffer = [0; 4096];
        // Nobody has opened the other end yet, or nothing was sent.
        let count = self.line.read(&mut buffer).unwrap_or(0);
        let bytes = self.damaged(&buffer[..count], behaviour.damaged_bytes);
        if behaviour.is_version_1 {
            if bytes.windows(2).any(|two| two == b"H ") {
                self.late.push_back((now, b"A 1 R 0 0 0 0 0 0*22\n".to_vec()));
            }
            return;
        }
        let mut lines = Vec::new();
        self.reader.take(&bytes, |line| lines.push(line));
        for line in lines {
            let Received::Line(line) = line else {
                locked(&self.shared.0).log.damaged += 1;
                continue;
            };
            locked(&self.shared.0).log.lines += 1;
            let answer = self.answer(&line, behaviour, now);
            if let Some(answer) = answer.filter(|_| !behaviour.is_silent) {
                let mut bytes = Vec::new();
                if behaviour.is_garbage {
                    bytes.extend(b"\x00\xffA 12 R 5*00\n~~~\n\nA\n*\n");
                } else {
                    answer.write(&mut bytes);
                }
                self.late.push_back((now + behaviour.delay, bytes));
            }
        }
    }

    fn answer(&mut self, line: &Line, behaviour: &Behaviour, now: Instant) -> Option<Line> {
        let seq = match *line {
            Line::Hello { seq, .. } => {
                let (version, watchdog_ms) = (VERSION, behaviour.watchdog_ms);
                return Some(Line::Identity { seq, version, serial: self.serial, watchdog_ms });
            }
            Line::Query { seq } => seq,
            Line::Clear { seq } => {
                let log = &mut locked(&self.shared.0).log;
                (log.clears, log.cleared_at) = (log.clears + 1, Some(now));
                (self.is_held, self.target) = (false, None);
                seq
            }
            Line::Set { seq, position, velocity } => {
                self.fed = now;
                if self.state(behaviour) == DeviceState::Ready {
                    self.target = Some((position, velocity));
                }
                locked(&self.shared.0).log.set_points.push((now, position, velocity));
                seq
            }
            Line::Identity { .. } | Line::Answer { .. } => return None,
        };
        let seq = if behaviour.has_wrong_numbers { seq.saturating_sub(100) } else { seq };
        let noise = JointVector::from_fn(|_, _| (self.random.unit() - 0.5) * 2.0 * behaviour.noise_rad);
        Some(Line::Answer { seq, state: self.state(behaviour), position: self.angles + noise })
    }

    fn state(&self, behaviour: &Behaviour) -> DeviceState {
        if behaviour.is_stopped {
            DeviceState::HardwareStop
        } else if behaviour.has_fault {
            DeviceState::Fault
        } else if self.is_held {
            DeviceState::Watchdog
        } else {
            DeviceState::Ready
        }
    }

    /// Moves the motors for `dt_s`.
    fn turn(&mut self, behaviour: &Behaviour, now: Instant, dt_s: f64) {
        let is_moving = self.target.is_some_and(|(_, velocity)| velocity != JointVector::zeros());
        if is_moving && now - self.fed > Duration::from_millis(u64::from(behaviour.watchdog_ms)) {
            (self.is_held, self.target) = (true, None);
            let log = &mut locked(&self.shared.0).log;
            (log.watchdog, log.watchdog_at) = (log.watchdog + 1, Some(now));
        }
        if behaviour.is_stopped || behaviour.has_fault {
            self.target = None;
        }
        if !behaviour.is_stuck {
            // A controller that was held up computes what its motors did meanwhile.
            let mut left_s = dt_s;
            while left_s > 0.0 {
                let step_s = left_s.min(MAX_STEP_S);
                self.step(behaviour, step_s);
                left_s -= step_s;
            }
        }
        self.angles[5] += behaviour.runaway_rad_s * dt_s;
    }

    /// Moves the motors for a short time.
    fn step(&mut self, behaviour: &Behaviour, dt_s: f64) {
        match self.target {
            // Motors that run away do not listen.
            Some((position, _)) if behaviour.runaway_rad_s == 0.0 => {
                let off = position - self.angles;
                let lag_s = behaviour.lag_s.max(dt_s);
                for k in 0..off.len() {
                    // Not faster than it can brake before the set-point.
                    let wanted = (off[k].abs() / lag_s).min((2.0 * MOTOR_RAD_S2 * off[k].abs()).sqrt());
                    let change = wanted.copysign(off[k]) - self.speed[k];
                    self.speed[k] += change.clamp(-MOTOR_RAD_S2 * dt_s, MOTOR_RAD_S2 * dt_s);
                }
            }
            _ => {
                // Brakes evenly.
                let largest = self.speed.amax();
                let slower = (largest - BRAKE_RAD_S2 * dt_s).max(0.0);
                self.speed *= if largest > 0.0 { slower / largest } else { 0.0 };
            }
        }
        self.angles += self.speed * dt_s;
    }

    fn write(&mut self, behaviour: &Behaviour, now: Instant) {
        while let Some((due, bytes)) = self.late.pop_front() {
            if due > now {
                self.late.push_front((due, bytes));
                return;
            }
            let bytes = self.damaged(&bytes, behaviour.damaged_bytes);
            let _ = self.line.write_all(&bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn controller() -> Controller {
        let line = File::open("/dev/null").expect("a file without bytes");
        let state = State { behaviour: Behaviour::default(), log: Log::default(), angles: JointVector::zeros() };
        let serial = Serial::new("TEST-1").expect("a serial number");
        Controller::new(line, serial, Arc::new((Mutex::new(state), Condvar::new())))
    }

    fn turn_joint(rad: f64) -> JointVector {
        JointVector::from_fn(|k, _| if k == 5 { rad } else { 0.0 })
    }

    #[test]
    fn a_stop_while_the_arm_catches_up_does_not_throw_it() {
        let mut behaviour = Behaviour { lag_s: 0.005, watchdog_ms: 1000, ..Behaviour::default() };
        let mut arm = controller();
        let start = Instant::now();
        // 30 ms of set-points at 0.15 rad/s arrive together, and the hardware stop is pressed 1 ms later.
        (arm.fed, arm.target) = (start, Some((turn_joint(0.0045), turn_joint(0.15))));
        arm.turn(&behaviour, start, 1e-3);
        behaviour.is_stopped = true;
        (0..1000).for_each(|_| arm.turn(&behaviour, start, 1e-3));
        assert!(arm.angles[5] > 0.0 && arm.angles[5] < 0.0045, "it came to rest at {} rad", arm.angles[5]);
        assert_eq!(arm.speed, JointVector::zeros());
    }

    #[test]
    fn motors_follow_set_points_with_their_lag() {
        for lag_s in [0.0, 0.005, 0.025] {
            let behaviour = Behaviour { lag_s, watchdog_ms: 10_000, ..Behaviour::default() };
            let mut arm = controller();
            let start = Instant::now();
            let mut largest = 0.0_f64;
            for ms in 0..600 {
                let asked = 0.15e-3 * f64::from((ms / 10 * 10).min(400));
                (arm.fed, arm.target) = (start, Some((turn_joint(asked), turn_joint(0.15))));
                let before = arm.angles[5];
                arm.turn(&behaviour, start, 1e-3);
                largest = largest.max((arm.angles[5] - before) * 1e3);
                assert!((arm.angles[5] - asked).abs() < 0.15 * (0.02 + 2.0 * lag_s), "{ms} ms: {}", arm.angles[5]);
            }
            assert!((arm.angles[5] - 0.06).abs() < 1e-4, "{lag_s} s: {}", arm.angles[5]);
            assert!(largest < 0.5, "{largest} rad/s");
        }
    }
}
