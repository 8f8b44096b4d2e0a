//! A Universal Robots arm over RTDE ([`crate::rtde`]), with the deadman `ur/panoscope_arm.script` on its controller.
//!
//! RTDE inputs keep their last value, so silence on this side does not stop the arm. Every package therefore carries
//! another heartbeat; the robot's program follows targets only while it changes, and echoes it. The age of an answer is
//! the age of the heartbeat that it echoes.
//!
//! The robot's safety system has priority: its stops are reported unchanged and never acknowledged from here.

use std::time::Duration;

use panoscope_arm_core::{Cause, JOINTS, JointVector};

use crate::arm_port::{Answer, ArmPort, Identity};
use crate::clock;
use crate::dashboard::{self, ANSWER_WITHIN, UPDATE};
use crate::port::PortError;
use crate::rtde::{self, Command, INPUTS, Kind, MAX_LEN, OUTPUTS, Package, Reader, Received, State};
use crate::tcp::TcpPort;

/// The program that runs on the robot's controller.
pub const PROGRAM: &str = include_str!("../ur/panoscope_arm.script");
/// Version of [`PROGRAM`].
pub const PROGRAM_VERSION: i32 = 1;
/// RTDE's port.
pub const RTDE_PORT: u16 = 30004;
/// The dashboard server's port.
pub const DASHBOARD_PORT: u16 = 29999;

/// Time between two packages. Two control cycles of an e-Series arm, half of one of a CB3 arm.
const PERIOD: Duration = Duration::from_millis(4);
/// Time limit of the first echoed heartbeat.
const FIRST_ECHO: Duration = Duration::from_millis(600);
/// Time for which the robot's program is asked to clear its stop.
const RELEASE_WITHIN: Duration = Duration::from_millis(250);
/// Time for which the last set-point stays the target after a movement: the joints lag behind their targets.
const SETTLE: Duration = Duration::from_millis(200);
/// Heartbeats wrap to 0 at this value.
const BEAT_END: i32 = 1_000_000;
/// Maximum number of heartbeats without an echo.
const OUTSTANDING: usize = 64;
/// Largest difference between the controller's clock and this one within [`CLOCK_SPAN_NS`], ns.
const CLOCK_OFF_NS: i64 = 250_000_000;
/// Time after which the clocks are set equal again, ns: 250 ms in 5 s distinguish a clock that is 5 % slow from late
/// packages.
const CLOCK_SPAN_NS: i64 = 5_000_000_000;
/// Highest speed of a joint of these robots, rad/s; a package with a higher speed counts as damaged.
const FASTEST_RAD_S: f64 = 3.2;
/// Noise of the encoders between two packages, rad.
const NOISE_RAD: f64 = 0.002;
/// Value of `robot_mode` of an arm that is switched on with its brakes released.
const ROBOT_RUNNING: i32 = 7;
/// Value of `runtime_state` while a program runs.
const PROGRAM_PLAYING: u32 = 2;
/// States of the robot's program that follow or can follow.
const PROGRAM_READY: [i32; 2] = [2, 3];
const MAKE_READY: &str = "make the robot ready at its pendant and start panoscope_arm.script there";
const COPY_PROGRAM: &str = "copy the panoscope_arm.script of this version to the robot and start it";

/// Connection to an arm.
#[derive(Clone, Debug)]
pub struct UrConnection {
    /// Name or address of the controller.
    pub host: String,
    /// RTDE's port.
    pub rtde_port: u16,
    /// The dashboard server's port.
    pub dashboard_port: u16,
    /// The robot's joint angles where the angles of the arm's file are 0, rad.
    pub home: JointVector,
    /// Time without an answer after which the arm is stopped.
    pub answer_within: Duration,
}

impl UrConnection {
    /// `home` as text, which [`home_of`] reads.
    pub fn home_text(&self) -> String {
        self.home.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
    }

    fn place(&self) -> String {
        format!("{}:{}", self.host, self.rtde_port)
    }
}

/// Six finite angles, separated by commas; `None` for anything else.
pub fn home_of(text: &str) -> Option<JointVector> {
    let angles: Vec<f64> = text.split(',').map(|word| word.trim().parse().ok()).collect::<Option<_>>()?;
    (angles.len() == JOINTS && angles.iter().all(|v| v.is_finite())).then(|| JointVector::from_column_slice(&angles))
}

/// Cause for which an arm in this state does not follow. The robot's safety system comes first.
fn stop_of(state: &State) -> Option<Cause> {
    let has = |bits: &[u32]| bits.iter().any(|bit| state.safety_bits & (1 << bit) != 0);
    if has(&[8, 9]) {
        Some(Cause::HardwareFault)
    } else if has(&[5, 6, 7]) {
        Some(Cause::HardwareStop)
    } else if has(&[2]) {
        Some(Cause::ProtectiveStop)
    } else if has(&[3, 4, 10]) || !has(&[0, 1]) {
        Some(Cause::SafeguardStop)
    } else if state.robot_mode != ROBOT_RUNNING {
        Some(Cause::RobotOff)
    } else if state.runtime_state != PROGRAM_PLAYING || state.program_version != PROGRAM_VERSION {
        Some(Cause::ProgramNotRunning)
    } else {
        (!PROGRAM_READY.contains(&state.program_state)).then_some(Cause::DeviceStopped)
    }
}

/// Whether a state can follow another one. This detects damaged packages, which have no checksum and TCP's is weak.
fn can_follow(before: &State, after: &State) -> bool {
    let seconds = after.timestamp_s - before.timestamp_s;
    let reach_rad = FASTEST_RAD_S * seconds + NOISE_RAD;
    // Written so that NaN cannot follow.
    seconds > 0.0 && (0..JOINTS).all(|k| (after.angles[k] - before.angles[k]).abs() <= reach_rad)
}

/// Compares the controller's clock with this machine's. The deadman counts control cycles, so a slow controller stops
/// late.
#[derive(Debug, Default)]
struct ClockCheck {
    /// Controller time and local time at the last comparison, ns.
    anchor: Option<(i64, i64)>,
    newest_ns: i64,
}

impl ClockCheck {
    /// Whether the controller's clock runs at the right rate.
    fn is_right(&mut self, now_ns: i64, device_ns: i64) -> bool {
        let (here, there) = *self.anchor.get_or_insert((now_ns, device_ns));
        let is_forward = device_ns >= std::mem::replace(&mut self.newest_ns, device_ns);
        let off_ns = (now_ns - here).saturating_sub(device_ns.saturating_sub(there));
        if now_ns - here > CLOCK_SPAN_NS {
            self.anchor = Some((now_ns, device_ns));
        }
        is_forward && off_ns.saturating_abs() <= CLOCK_OFF_NS
    }
}

/// A heartbeat that was sent and not echoed yet.
#[derive(Clone, Copy, Default)]
struct Sent {
    beat: i32,
    at_ns: i64,
    is_open: bool,
}

/// The connection to the controller and its newest state.
pub struct UrLink {
    place: String,
    port: TcpPort,
    reader: Reader,
    /// Numbers of the recipes of outputs and inputs.
    recipes: (u8, u8),
    home: JointVector,
    beat: i32,
    sent: [Sent; OUTSTANDING],
    /// The newest echo: it is repeated in every package.
    echo: Option<i32>,
    state: Option<State>,
    clock: ClockCheck,
    answer: Answer,
    identity: Identity,
    /// Until when the robot's program is asked to clear its stop, ns.
    release_until_ns: i64,
    /// The newest set-point, and until when it stays the target, ns.
    last: (JointVector, i64),
    out: Vec<u8>,
}

impl UrLink {
    /// Connects and waits until the robot's program echoes a heartbeat. Moves nothing and clears no stop.
    ///
    /// # Errors
    /// The controller cannot be reached, another program uses its inputs, its software is too old, or the robot's
    /// program does not run.
    pub fn open(connection: &UrConnection) -> Result<(Self, Identity), PortError> {
        let serial = dashboard::serial_number(&connection.host, connection.dashboard_port)?;
        let mut link = Self {
            place: connection.place(),
            port: TcpPort::open(&connection.host, connection.rtde_port, MAX_LEN)?,
            reader: Reader::new(),
            recipes: (0, 0),
            home: connection.home,
            beat: 0,
            sent: [Sent::default(); OUTSTANDING],
            echo: None,
            state: None,
            clock: ClockCheck::default(),
            answer: Answer::default(),
            identity: Identity { serial, watchdog_ms: 0 },
            release_until_ns: i64::MIN,
            last: (JointVector::zeros(), i64::MIN),
            out: Vec::with_capacity(MAX_LEN),
        };
        link.set_up()?;
        link.first_echo()?;
        let identity = link.identity;
        Ok((link, identity))
    }

    fn unsuitable(&self, what: String, advice: &'static str) -> PortError {
        PortError::Unsuitable { place: self.place.clone(), what, advice }
    }

    /// Negotiates versions and recipes and starts the exchange.
    fn set_up(&mut self) -> Result<(), PortError> {
        let speaks = self.ask(Kind::ProtocolVersion, &rtde::VERSION.to_be_bytes(), |it| match it {
            Package::ProtocolVersion(is_accepted) => Some(is_accepted),
            _ => None,
        })?;
        if !speaks {
            return Err(
                self.unsuitable(format!("the controller does not speak version {} of RTDE", rtde::VERSION), UPDATE)
            );
        }
        let version = self.ask(Kind::ControllerVersion, &[], |it| match it {
            Package::ControllerVersion(version) => Some(version),
            _ => None,
        })?;
        let is_known = matches!(version, [3, 12..=u32::MAX, ..] | [5, 6..=u32::MAX, ..]);
        if !is_known {
            let [major, minor, fix, _] = version;
            return Err(self.unsuitable(format!("the controller has software {major}.{minor}.{fix}"), UPDATE));
        }
        let frequency_hz = if version[0] == 3 { 125.0_f64 } else { 500.0 };
        let payload = [&frequency_hz.to_be_bytes()[..], rtde::names(&OUTPUTS).as_bytes()].concat();
        let (recipe, types) = self.ask(Kind::Outputs, &payload, |it| match it {
            Package::Outputs(recipe, types) => Some((recipe, types.to_owned())),
            _ => None,
        })?;
        self.check_types(&OUTPUTS, &types)?;
        self.recipes.0 = recipe;
        let payload = rtde::names(&INPUTS);
        let (recipe, types) = self.ask(Kind::Inputs, payload.as_bytes(), |it| match it {
            Package::Inputs(recipe, types) => Some((recipe, types.to_owned())),
            _ => None,
        })?;
        self.check_types(&INPUTS, &types)?;
        self.recipes.1 = recipe;
        if self.recipes.0 == 0 || self.recipes.1 == 0 {
            return Err(self.unsuitable("the controller refused the list of fields".to_owned(), UPDATE));
        }
        let has_started = self.ask(Kind::Start, &[], |it| match it {
            Package::Started(has_started) => Some(has_started),
            _ => None,
        })?;
        if has_started { Ok(()) } else { Err(self.unsuitable("the controller does not start RTDE".to_owned(), UPDATE)) }
    }

    /// Compares the types that the controller gave to fields with those that are needed.
    fn check_types(&self, fields: &[(&str, &str)], types: &str) -> Result<(), PortError> {
        let given: Vec<&str> = types.split(',').map(str::trim).collect();
        if given.contains(&"IN_USE") {
            return Err(PortError::InUse { path: self.place.clone().into() });
        }
        let wrong = fields.iter().zip(&given).find(|((_, needed), given)| needed != *given);
        match wrong {
            Some(((name, _), &"NOT_FOUND")) => Err(self.unsuitable(format!("the controller has no `{name}`"), UPDATE)),
            Some(((name, needed), given)) => {
                Err(self.unsuitable(format!("`{name}` is {needed} in RTDE, but {given} here"), UPDATE))
            }
            None if given.len() != fields.len() => {
                let what = format!("the controller answers {} types to {} fields", given.len(), fields.len());
                Err(self.unsuitable(what, UPDATE))
            }
            None => Ok(()),
        }
    }

    /// Sends a package and waits for its answer.
    fn ask<T>(
        &mut self,
        kind: Kind,
        payload: &[u8],
        mut answer: impl FnMut(Package<'_>) -> Option<T>,
    ) -> Result<T, PortError> {
        self.out.clear();
        rtde::write(&mut self.out, kind, |out| out.extend_from_slice(payload));
        self.port.write(&self.out)?;
        let start_ns = clock::now_ns();
        let (mut found, mut text) = (None, String::new());
        while found.is_none() {
            if clock::now_ns() - start_ns > ANSWER_WITHIN.as_nanos() as i64 {
                let says = if text.is_empty() { String::new() } else { format!(" (it says: {text})") };
                let what = format!("the controller does not answer `{}`{says}", char::from(kind as u8));
                return Err(self.unsuitable(what, "check the address and RTDE's port"));
            }
            std::thread::sleep(Duration::from_millis(1));
            self.poll(|received| match received {
                Received::Package(Package::Text(bytes)) => text = bytes.escape_ascii().to_string(),
                Received::Package(package) if found.is_none() => found = answer(package),
                _ => {}
            })?;
        }
        found.ok_or_else(|| PortError::Unreadable { place: self.place.clone() })
    }

    /// Waits for a state of the robot, then for the echo of a heartbeat of this connection.
    fn first_echo(&mut self) -> Result<(), PortError> {
        let start_ns = clock::now_ns();
        while self.answer.answered_ns < start_ns {
            // The echo that stands in the register is of an earlier connection.
            if let Some(state) = self.state {
                if self.echo.is_none() {
                    self.echo = Some(state.beat);
                    self.beat = state.beat.clamp(0, BEAT_END - 1);
                }
                self.query()?;
            }
            std::thread::sleep(PERIOD);
            self.listen()?;
            if clock::now_ns() - start_ns > FIRST_ECHO.as_nanos() as i64 {
                return Err(self.no_echo());
            }
        }
        // Another version may echo heartbeats and do something else with the rest.
        if self.state.is_none_or(|state| state.program_version != PROGRAM_VERSION) {
            return Err(self.no_echo());
        }
        self.answer.damaged = 0;
        self.identity.watchdog_ms = self.state.map_or(0, |state| u32::try_from(state.watchdog_ms).unwrap_or(0));
        Ok(())
    }

    fn no_echo(&self) -> PortError {
        let place = self.place.clone();
        let Some(state) = self.state else {
            return self.unsuitable("the controller sends no data".to_owned(), UPDATE);
        };
        let is_playing = state.robot_mode == ROBOT_RUNNING && state.runtime_state == PROGRAM_PLAYING;
        if is_playing && state.program_version != PROGRAM_VERSION {
            let theirs = state.program_version;
            let what = if theirs == 0 {
                "the program that runs on the robot is not panoscope_arm.script".to_owned()
            } else {
                format!("panoscope_arm.script on the robot has version {theirs}, this program needs {PROGRAM_VERSION}")
            };
            return self.unsuitable(what, COPY_PROGRAM);
        }
        match stop_of(&state) {
            Some(cause) if cause != Cause::DeviceStopped => PortError::NotReady { place, cause, advice: MAKE_READY },
            _ => self.unsuitable("panoscope_arm.script does not answer on the robot".to_owned(), COPY_PROGRAM),
        }
    }

    /// Reads what has arrived and calls `each` with every package.
    fn poll(&mut self, mut each: impl FnMut(Received<'_>)) -> Result<(), PortError> {
        let mut buffer = [0; MAX_LEN];
        let mut is_broken = false;
        // Bounded, so that a controller that sends without pause cannot hold this thread.
        for _ in 0..16 {
            let count = self.port.read(&mut buffer)?;
            if count == 0 {
                break;
            }
            self.reader.take(&buffer[..count], |received| {
                is_broken |= received == Received::Broken;
                each(received);
            });
        }
        if is_broken { Err(PortError::Unreadable { place: self.place.clone() }) } else { Ok(()) }
    }

    /// Records the echo of a heartbeat.
    fn close(&mut self, beat: i32) {
        if self.echo.is_none() || self.echo == Some(beat) {
            return;
        }
        let sent = &mut self.sent[beat.unsigned_abs() as usize % OUTSTANDING];
        if sent.beat != beat || !sent.is_open {
            self.answer.damaged = self.answer.damaged.saturating_add(1);
            return;
        }
        sent.is_open = false;
        self.echo = Some(beat);
        self.answer.answered_ns = self.answer.answered_ns.max(sent.at_ns);
        self.answer.damaged = 0;
    }

    fn send(&mut self, command: Command, angles: &JointVector) -> Result<(), PortError> {
        let (beat, at_ns) = ((self.beat + 1) % BEAT_END, clock::now_ns());
        self.out.clear();
        rtde::write_inputs(&mut self.out, self.recipes.1, beat, command, &(angles + self.home));
        if self.port.write(&self.out)? {
            self.beat = beat;
            self.sent[beat as usize % OUTSTANDING] = Sent { beat, at_ns, is_open: true };
        }
        Ok(())
    }
}

impl ArmPort for UrLink {
    fn listen(&mut self) -> Result<(), PortError> {
        let outputs = self.recipes.0;
        let (mut newest, mut echoes, mut damaged) = (None, [0; 2 * OUTSTANDING], 0_u32);
        let (mut count, mut before) = (0, self.state);
        self.poll(|received| match received {
            Received::Package(Package::Data(recipe, values)) if recipe == outputs => match State::read(values) {
                Some(state) if before.is_none_or(|before| can_follow(&before, &state)) => {
                    // The array has room for all heartbeats whose echo may be outstanding.
                    if (count == 0 || echoes[count - 1] != state.beat) && count < echoes.len() {
                        echoes[count] = state.beat;
                        count += 1;
                    }
                    before = Some(state);
                    newest = before;
                }
                _ => damaged += 1,
            },
            Received::Package(Package::Text(_) | Package::Paused(_)) => {}
            _ => damaged += 1,
        })?;
        for beat in &echoes[..count] {
            self.close(*beat);
        }
        self.answer.damaged = self.answer.damaged.saturating_add(damaged);
        if let Some(state) = newest {
            let device_ns = (state.timestamp_s * 1e9) as i64;
            let is_right = state.timestamp_s.is_finite() && self.clock.is_right(clock::now_ns(), device_ns);
            self.answer.encoders = state.angles - self.home;
            self.answer.measured_ns = device_ns;
            self.answer.stop = stop_of(&state).or((!is_right).then_some(Cause::DeviceClock));
            self.state = Some(state);
        }
        Ok(())
    }

    fn query(&mut self) -> Result<(), PortError> {
        let (now_ns, at) = (clock::now_ns(), self.answer.encoders);
        match self.answer.stop {
            None if now_ns < self.last.1 => {
                let target = self.last.0;
                self.send(Command::Follow, &target)
            }
            Some(Cause::DeviceStopped) if now_ns < self.release_until_ns => self.send(Command::Release, &at),
            _ => self.send(Command::Hold, &at),
        }
    }

    fn set(&mut self, position: &JointVector, _velocity: &JointVector) -> Result<(), PortError> {
        self.release_until_ns = i64::MIN;
        self.last = (*position, clock::now_ns() + SETTLE.as_nanos() as i64);
        self.send(Command::Follow, position)
    }

    fn clear(&mut self) -> Result<(), PortError> {
        // The command is a level, not an event: a control cycle may see every second package only.
        self.release_until_ns = clock::now_ns() + RELEASE_WITHIN.as_nanos() as i64;
        self.clock = ClockCheck::default();
        self.last.1 = i64::MIN;
        self.query()
    }

    fn answer(&self) -> &Answer {
        &self.answer
    }

    fn forgive(&mut self) {
        self.answer.damaged = 0;
    }

    fn identity(&self) -> Option<Identity> {
        Some(self.identity)
    }

    fn period(&self) -> Duration {
        PERIOD
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state() -> State {
        State {
            timestamp_s: 5.0,
            angles: JointVector::zeros(),
            speeds: JointVector::zeros(),
            robot_mode: ROBOT_RUNNING,
            safety_bits: 1,
            runtime_state: PROGRAM_PLAYING,
            beat: 0,
            program_state: 2,
            reason: 0,
            program_version: PROGRAM_VERSION,
            watchdog_ms: 30,
        }
    }

    /// Value of a constant of the program.
    fn constant(name: &str) -> f64 {
        let start = format!("{name} = ");
        let value = PROGRAM.lines().find_map(|line| line.trim().strip_prefix(start.as_str()));
        value.and_then(|value| value.parse().ok()).unwrap_or(f64::NAN)
    }

    #[test]
    fn both_sides_agree_on_numbers() {
        assert_eq!(constant("VERSION"), f64::from(PROGRAM_VERSION));
        for (command, name) in [(Command::Hold, "HOLD"), (Command::Follow, "FOLLOW"), (Command::Release, "RELEASE")] {
            assert_eq!(constant(name), f64::from(command as i32), "{name}");
        }
        assert_eq!([constant("READY"), constant("FOLLOWS")], PROGRAM_READY.map(f64::from));
        assert_eq!(constant("SILENT_S"), 0.03);
    }

    #[test]
    fn every_stop_of_the_robot_has_its_name() {
        assert_eq!(stop_of(&state()), None);
        assert_eq!(stop_of(&State { safety_bits: 2, ..state() }), None, "reduced mode");
        let bits = [
            (0, Cause::SafeguardStop),
            (1 << 2, Cause::ProtectiveStop),
            (1 << 3, Cause::SafeguardStop),
            (1 << 4, Cause::SafeguardStop),
            (1 << 5, Cause::HardwareStop),
            (1 << 6, Cause::HardwareStop),
            (1 << 7, Cause::HardwareStop),
            (1 << 8, Cause::HardwareFault),
            (1 << 9, Cause::HardwareFault),
            (1 << 10, Cause::SafeguardStop),
            // The worst counts.
            (0b111_1111_1100, Cause::HardwareFault),
            (0b100_1100_0100, Cause::HardwareStop),
            (0b100_0000_0100, Cause::ProtectiveStop),
        ];
        for (safety_bits, cause) in bits {
            for normal in [0, 1] {
                let off = State { safety_bits: safety_bits | normal, robot_mode: 3, runtime_state: 1, ..state() };
                if safety_bits != 0 || normal == 0 {
                    assert_eq!(stop_of(&off), Some(cause), "{safety_bits:b}");
                }
            }
        }
        for robot_mode in [-1, 0, 1, 2, 3, 4, 5, 6, 8, i32::MAX] {
            assert_eq!(stop_of(&State { robot_mode, ..state() }), Some(Cause::RobotOff));
        }
        for runtime_state in [0, 1, 3, 4, 5, 6] {
            assert_eq!(stop_of(&State { runtime_state, ..state() }), Some(Cause::ProgramNotRunning));
        }
        assert_eq!(stop_of(&State { program_version: 2, ..state() }), Some(Cause::ProgramNotRunning));
        for (program_state, stop) in [(0, true), (1, true), (2, false), (3, false), (4, true), (-1, true)] {
            assert_eq!(stop_of(&State { program_state, ..state() }), stop.then_some(Cause::DeviceStopped));
        }
    }

    #[test]
    fn a_joint_does_not_jump() {
        let after = |timestamp_s: f64, angle: f64| {
            let mut next = State { timestamp_s, ..state() };
            next.angles[3] = angle;
            next
        };
        assert!(can_follow(&state(), &after(5.002, 0.006)));
        assert!(can_follow(&state(), &after(5.1, -0.3)));
        for (at, angle) in [(5.002, 0.02), (5.002, -0.02), (5.0, 0.0), (4.9, 0.0), (f64::NAN, 0.0), (5.002, f64::NAN)] {
            assert!(!can_follow(&state(), &after(at, angle)), "{at} {angle}");
        }
    }

    #[test]
    fn a_wrong_clock_is_noticed_and_a_late_package_is_not() {
        let run = |device_ns: &dyn Fn(i64) -> i64| {
            let mut clock = ClockCheck::default();
            (0..3000).all(|k| clock.is_right(k * 4_000_000, device_ns(k * 4_000_000)))
        };
        assert!(run(&|ns| ns + 77), "another zero");
        assert!(run(&|ns| ns + ns / 100), "1 % fast");
        assert!(!run(&|ns| ns - ns / 10), "10 % slow");
        assert!(!run(&|ns| ns + ns / 10), "10 % fast");
        assert!(run(&|ns| if ns % 1_000_000_000 < 200_000_000 { ns - ns % 1_000_000_000 } else { ns }), "held up");
        assert!(!run(&|ns| if ns == 400_000_000 { 0 } else { ns }), "backwards");
        assert!(!run(&|_| 0), "it stands");
    }

    #[test]
    fn a_home_is_six_angles() {
        let home = JointVector::from([0.1, -1.234567890123456, 1e-9, -3.0, 0.0, 6.2]);
        let connection = UrConnection {
            host: "robot".to_owned(),
            rtde_port: RTDE_PORT,
            dashboard_port: DASHBOARD_PORT,
            home,
            answer_within: Duration::from_millis(30),
        };
        assert_eq!(home_of(&connection.home_text()), Some(home));
        for text in ["", "0,0,0,0,0", "0,0,0,0,0,0,0", "0,0,0,0,0,x", "0,0,0,0,0,nan", "0,0,0,0,0,inf"] {
            assert_eq!(home_of(text), None, "{text}");
        }
    }
}
