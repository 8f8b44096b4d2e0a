//! A simulated Universal Robots controller: RTDE and dashboard servers on ports of this machine, motors with lag, encoders with noise, a safety
//! system, and an interpreter that runs the robot's program ([`crate::urscript`]).
//!
//! It is written from the documented protocol and shares no code with the guard. Its clock counts control cycles. Cycles that a loaded machine misses
//! are skipped in the clock and do not run the program, so the robot's deadman fires late there, never early.

use std::io;
use std::net::TcpListener;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use panoscope_arm_core::JointVector;
use panoscope_arm_core::campaign::Random;

use crate::rtde_server::{Registers, Servers, Status};
pub use crate::ur_behaviour::UrBehaviour;
use crate::urscript::{Motion, Program, Robot};

/// Braking without a program, rad/s^2.
const BRAKE_RAD_S2: f64 = 4.0;

impl UrBehaviour {
    /// `robot_mode`, `safety_status_bits`, `runtime_state`, as the RTDE guide lists them.
    fn status(&self, is_program_running: bool) -> Status {
        let bit = |is_on: bool, bit: u32| u32::from(is_on) << bit;
        let is_pausing = self.is_protective || self.is_safeguard;
        let is_stopped = is_pausing || self.is_emergency || self.has_fault;
        let safety_bits = bit(!is_stopped, 0)
            | bit(self.is_protective, 2)
            | bit(self.is_safeguard, 4)
            | bit(self.is_emergency, 6)
            | bit(self.is_emergency, 7)
            | bit(self.has_fault, 9)
            | bit(is_stopped, 10);
        let robot_mode = if self.is_off || self.is_emergency || self.has_fault { 3 } else { 7 };
        let runtime_state = match (is_program_running, is_pausing) {
            (false, _) => 1,
            (true, false) => 2,
            (true, true) => 4,
        };
        Status { robot_mode, safety_bits, runtime_state }
    }
}

/// The start of braking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Braking {
    /// Control cycle.
    pub cycle: u64,
    /// Cycle in which the newest data package arrived.
    pub package_cycle: u64,
    /// The program's reason; 0 if the program did not stop the arm.
    pub reason: i32,
}

/// Events of the arm.
#[derive(Clone, Debug, Default)]
pub struct UrLog {
    /// Number of control cycles run.
    pub cycle: u64,
    /// True angles, one entry per cycle in which the arm moved: controller time, s, and rad.
    pub angles: Vec<(f64, JointVector)>,
    /// Number of data packages received.
    pub packages: u64,
    /// Cycle of the newest package.
    pub package_cycle: u64,
    /// Targets of the program, rad: cycle and angles, one entry per change.
    pub targets: Vec<(u64, JointVector)>,
    /// When the arm began to brake.
    pub braking: Vec<Braking>,
    /// How often the program's stop was cleared.
    pub releases: u32,
    /// How often the program stopped the arm because the heartbeat was missing.
    pub deadman: u32,
    /// How often the program was started.
    pub starts: u32,
    /// Why the program ended.
    pub program_error: Option<String>,
    /// Number of connections that were closed because of invalid data.
    pub refused: u32,
}

pub(crate) struct State {
    pub behaviour: UrBehaviour,
    pub log: UrLog,
    angles: JointVector,
    is_over: bool,
}

/// A running controller. Dropping it ends it.
pub struct UrSimulator {
    ports: (u16, u16),
    state: Arc<(Mutex<State>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

/// The program with another value of its constant `SILENT_S`, s: a loaded machine delays threads for longer than the true value allows.
///
/// # Errors
/// The program has no such constant.
pub fn with_silent_s(program: &str, seconds: f64) -> io::Result<String> {
    let line = program.lines().find(|line| line.trim_start().starts_with("SILENT_S ="));
    let line = line.ok_or_else(|| io::Error::other("the program has no SILENT_S"))?;
    Ok(program.replace(line, &format!("  SILENT_S = {seconds:?}")))
}

pub(crate) fn locked(state: &Mutex<State>) -> MutexGuard<'_, State> {
    // Plain data: what a panicking thread left is whole.
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl UrSimulator {
    /// Starts an arm at `angles`, rad, with `program` as the robot's program.
    ///
    /// # Errors
    /// The program cannot be read, or this machine has no free port.
    pub fn plug_in(serial: &str, program: &str, angles: JointVector, behaviour: UrBehaviour) -> io::Result<Self> {
        let listeners = (TcpListener::bind(("127.0.0.1", 0))?, TcpListener::bind(("127.0.0.1", 0))?);
        Self::with_listeners(serial, program, angles, behaviour, listeners)
    }

    /// As [`Self::plug_in`], on the given ports of RTDE and of the dashboard server.
    ///
    /// # Errors
    /// The program cannot be read, or a port is in use.
    pub fn plug_in_at(
        serial: &str,
        program: &str,
        angles: JointVector,
        behaviour: UrBehaviour,
        ports: (u16, u16),
    ) -> io::Result<Self> {
        let listeners = (TcpListener::bind(("127.0.0.1", ports.0))?, TcpListener::bind(("127.0.0.1", ports.1))?);
        Self::with_listeners(serial, program, angles, behaviour, listeners)
    }

    fn with_listeners(
        serial: &str,
        program: &str,
        angles: JointVector,
        behaviour: UrBehaviour,
        listeners: (TcpListener, TcpListener),
    ) -> io::Result<Self> {
        Program::read(program).map_err(io::Error::other)?;
        let ports = (listeners.0.local_addr()?.port(), listeners.1.local_addr()?.port());
        let servers = Servers::new(listeners.0, listeners.1, serial.to_owned())?;
        let state = State { behaviour, log: UrLog::default(), angles, is_over: false };
        let state = Arc::new((Mutex::new(state), Condvar::new()));
        let controller = Controller {
            servers,
            shared: Arc::clone(&state),
            text: program.to_owned(),
            program: None,
            registers: Registers::default(),
            random: Random::new(23),
            time_s: 100.0,
            angles,
            speed: JointVector::zeros(),
            was_servo: false,
        };
        let thread = std::thread::Builder::new().name("ur simulator".to_owned()).spawn(move || controller.run())?;
        Ok(Self { ports, state, thread: Some(thread) })
    }

    /// Ports of RTDE and of the dashboard server.
    pub fn ports(&self) -> (u16, u16) {
        self.ports
    }

    /// Changes the controller's behaviour.
    pub fn set(&self, change: impl FnOnce(&mut UrBehaviour)) {
        change(&mut locked(&self.state.0).behaviour);
    }

    /// A copy of the log so far.
    pub fn log(&self) -> UrLog {
        locked(&self.state.0).log.clone()
    }

    /// True joint angles, rad.
    pub fn angles(&self) -> JointVector {
        locked(&self.state.0).angles
    }

    /// Waits until `done` accepts the log; returns false after `limit`.
    pub fn wait(&self, limit: Duration, mut done: impl FnMut(&UrLog) -> bool) -> bool {
        let (state, changed) = &*self.state;
        let result = changed.wait_timeout_while(locked(state), limit, |state| !done(&state.log));
        !result.map_or_else(|poisoned| poisoned.into_inner().1, |(_, timeout)| timeout).timed_out()
    }
}

impl Drop for UrSimulator {
    fn drop(&mut self) {
        locked(&self.state.0).is_over = true;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Controller {
    servers: Servers,
    shared: Arc<(Mutex<State>, Condvar)>,
    text: String,
    program: Option<Program>,
    registers: Registers,
    random: Random,
    /// The controller's clock, s.
    time_s: f64,
    angles: JointVector,
    speed: JointVector,
    was_servo: bool,
}

/// The program's view of the controller.
struct View<'a> {
    registers: &'a mut Registers,
    angles: JointVector,
    step_s: f64,
}

impl Robot for View<'_> {
    fn input_int(&self, register: usize) -> i32 {
        self.registers.input_ints[register]
    }

    fn input_float(&self, register: usize) -> f64 {
        self.registers.input_floats[register]
    }

    fn set_output_int(&mut self, register: usize, value: i32) {
        self.registers.output_ints[register] = value;
    }

    fn angles(&self) -> [f64; 6] {
        self.angles.into()
    }

    fn step_s(&self) -> f64 {
        self.step_s
    }
}

impl Controller {
    fn run(mut self) {
        let mut due = Instant::now();
        loop {
            let (behaviour, is_over) = {
                let state = locked(&self.shared.0);
                (state.behaviour, state.is_over)
            };
            if is_over {
                return;
            }
            let step_s = behaviour.step_s();
            let pace = Duration::from_secs_f64(step_s / behaviour.clock_rate);
            let now = Instant::now();
            // A cycle that comes late stands for those that were missed.
            let missed = now.saturating_duration_since(due).as_secs_f64() / pace.as_secs_f64();
            let steps = 1.0 + missed.floor();
            due += pace.mul_f64(steps);
            self.time_s += step_s * steps;
            self.cycle(&behaviour, step_s * steps);
            self.shared.1.notify_all();
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
    }

    /// One control cycle, after `seconds` of the controller's clock.
    fn cycle(&mut self, behaviour: &UrBehaviour, seconds: f64) {
        let packages = self.servers.receive(behaviour, &mut self.registers, &mut self.random);
        {
            let log = &mut locked(&self.shared.0).log;
            log.cycle += 1;
            log.refused += packages.refused;
            if packages.data > 0 {
                log.packages += packages.data;
                log.package_cycle = log.cycle;
            }
        }
        let before = (self.registers.output_ints[25], self.registers.output_ints[26]);
        let motion = self.run_program(behaviour);
        let was = self.angles;
        self.move_joints(behaviour, motion, seconds);
        self.note(before, motion, was);
        let status = behaviour.status(self.program.is_some());
        let noise = JointVector::from_fn(|_, _| (self.random.unit() - 0.5) * 2.0 * behaviour.noise_rad);
        let measured = (self.angles + noise, self.speed);
        self.servers.send(behaviour, &self.registers, status, self.time_s, measured, &mut self.random);
    }

    /// Starts, pauses or ends the program, and runs its cycle.
    fn run_program(&mut self, behaviour: &UrBehaviour) -> Motion {
        let has_power = !behaviour.is_emergency && !behaviour.has_fault && !behaviour.is_off;
        if !has_power || behaviour.is_program_stopped {
            self.program = None;
            return Motion::None;
        }
        if behaviour.is_protective || behaviour.is_safeguard {
            return Motion::None;
        }
        if self.program.is_none() {
            // The text was read before: this cannot fail.
            self.program = Program::read(&self.text).ok();
            locked(&self.shared.0).log.starts += 1;
        }
        let Some(program) = &mut self.program else { return Motion::None };
        let is_still = self.speed == JointVector::zeros();
        let mut view = View { registers: &mut self.registers, angles: self.angles, step_s: behaviour.step_s() };
        match program.cycle(&mut view, is_still) {
            Ok(motion) => motion,
            Err(error) => {
                self.program = None;
                let mut state = locked(&self.shared.0);
                state.log.program_error = Some(error);
                state.behaviour.is_program_stopped = true;
                Motion::None
            }
        }
    }

    fn move_joints(&mut self, behaviour: &UrBehaviour, motion: Motion, seconds: f64) {
        let before = self.angles;
        match motion {
            _ if behaviour.is_stuck => self.speed = JointVector::zeros(),
            Motion::Servo(target) => {
                let share = (seconds / behaviour.lag_s.max(seconds)).min(1.0);
                self.angles += (JointVector::from(target) - self.angles) * share;
                self.speed = (self.angles - before) / seconds;
            }
            Motion::Stop(_) | Motion::None => {
                let rad_s2 = if let Motion::Stop(rad_s2) = motion { rad_s2 } else { BRAKE_RAD_S2 };
                let largest = self.speed.amax();
                let slower = (largest - rad_s2 * seconds).max(0.0);
                self.speed *= if largest > 0.0 { slower / largest } else { 0.0 };
                self.angles += self.speed * seconds;
            }
        }
        self.angles[5] += behaviour.runaway_rad_s * seconds;
    }

    fn note(&mut self, before: (i32, i32), motion: Motion, was: JointVector) {
        let now = (self.registers.output_ints[25], self.registers.output_ints[26]);
        let mut state = locked(&self.shared.0);
        state.angles = self.angles;
        let log = &mut state.log;
        let cycle = log.cycle;
        if self.angles != was {
            log.angles.push((self.time_s, self.angles));
        }
        if let Motion::Servo(target) = motion {
            let target = JointVector::from(target);
            if log.targets.last().is_none_or(|(_, last)| *last != target) {
                log.targets.push((cycle, target));
            }
        }
        let is_servo = matches!(motion, Motion::Servo(_));
        if self.was_servo && !is_servo {
            log.braking.push(Braking { cycle, package_cycle: log.package_cycle, reason: now.1 });
        }
        self.was_servo = is_servo;
        log.releases += u32::from(before.0 == 1 && now.0 == 2);
        log.deadman += u32::from(before.0 != 1 && now == (1, 2));
    }
}
