//! A seeded campaign against the real process on a pseudo-terminal: harm of every kind at a random moment of a movement. Checked on the arm's true
//! angles: it stays within its limits, it brakes in time, and no stop is forgotten.
//!
//! PANOSCOPE_ARM_CASES sets the number of cases (default 96), PANOSCOPE_ARM_SEED the first seed. A failure names its seed.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use panoscope_arm_core::campaign::Random;
use panoscope_arm_core::interlock::caps::{self, TubePose};
use panoscope_arm_core::interlock::{Evidence, Settings, measured};
use panoscope_arm_core::{Cause, Chain, JointVector};
use panoscope_arm_guard::client::Guard;
use panoscope_arm_guard::clock;
use panoscope_arm_guard::link::Connection;
use panoscope_arm_guard::message::{Request, Status};
use panoscope_firmware::{Behaviour, Firmware};
use rustix::process::{Pid, Signal, kill_process};

/// Cases that run beside each other: most of their time is waiting.
const BESIDE: usize = 8;
/// Limit of each wait; a loaded machine may hold every thread up.
const LIMIT: Duration = Duration::from_secs(10);

/// What happens to the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Harm {
    /// The program stops asking: it hangs, or was stopped.
    Silence,
    /// The program ends.
    Ends,
    /// The guard is killed.
    GuardKilled,
    /// The guard is stopped for a while.
    GuardStopped,
    /// Ticks that were kept are played back.
    OldLight,
    /// Stamps jump into the future or the past.
    ClockJumps,
    /// Requests arrive in another order.
    Reordered,
    /// Requests hold numbers that are none, or too many.
    HostileNumbers,
    /// Thousands of requests at once.
    Flood,
    /// Bytes of the line are flipped, lost and doubled.
    ByteDamage,
    /// The arm does not answer any more.
    Silent,
    /// The arm answers late.
    Late,
    /// The arm answers garbage.
    Garbage,
    /// The arm's answers have wrong numbers.
    WrongNumbers,
    /// The cable is unplugged.
    Unplugged,
    /// The motors do not move.
    Stuck,
    /// The motors run away.
    Runaway,
    /// The hardware stop.
    HardwareStop,
    /// The hardware has a fault.
    HardwareFault,
    /// A person's emergency stop.
    EmergencyStop,
    /// An emergency stop while the disk is full, then the guard is killed.
    DiskFull,
    /// A second program wants the arm.
    SecondMaster,
}

const HARMS: [Harm; 22] = [
    Harm::Silence,
    Harm::Ends,
    Harm::GuardKilled,
    Harm::GuardStopped,
    Harm::OldLight,
    Harm::ClockJumps,
    Harm::Reordered,
    Harm::HostileNumbers,
    Harm::Flood,
    Harm::ByteDamage,
    Harm::Silent,
    Harm::Late,
    Harm::Garbage,
    Harm::WrongNumbers,
    Harm::Unplugged,
    Harm::Stuck,
    Harm::Runaway,
    Harm::HardwareStop,
    Harm::HardwareFault,
    Harm::EmergencyStop,
    Harm::DiskFull,
    Harm::SecondMaster,
];

impl Harm {
    /// Whether a person has to release the arm afterwards.
    fn latches(self) -> bool {
        !matches!(
            self,
            Self::Silence
                | Self::OldLight
                | Self::ClockJumps
                | Self::Reordered
                | Self::HostileNumbers
                | Self::Flood
                | Self::ByteDamage
                | Self::SecondMaster
        )
    }

    /// Whether nothing that arrives after it may move the arm on: the time until it brakes counts.
    fn is_timed(self) -> bool {
        matches!(self, Self::Silence | Self::Ends | Self::GuardKilled | Self::OldLight | Self::EmergencyStop)
    }

    fn of_firmware(self, behaviour: &mut Behaviour) {
        match self {
            Self::ByteDamage => behaviour.damaged_bytes = 0.004,
            Self::Silent => behaviour.is_silent = true,
            Self::Late => behaviour.delay = Duration::from_millis(450),
            Self::Garbage => behaviour.is_garbage = true,
            Self::WrongNumbers => behaviour.has_wrong_numbers = true,
            Self::Unplugged => behaviour.is_unplugged = true,
            Self::Stuck => behaviour.is_stuck = true,
            Self::Runaway => behaviour.runaway_rad_s = 0.9,
            Self::HardwareStop => behaviour.is_stopped = true,
            Self::HardwareFault => behaviour.has_fault = true,
            _ => {}
        }
    }
}

#[derive(Default)]
struct Outcome {
    cases: u64,
    escapes: u64,
    forgotten: u64,
    not_moving: u64,
    /// Time from the harm until set-points, or the arm's own watchdog, brake, ms.
    hold_ms: Vec<f64>,
    failures: Vec<String>,
}

struct Case {
    random: Random,
    harm: Harm,
    folder: PathBuf,
    firmware: Firmware,
    guard: Option<Guard>,
    reset: u64,
    rad_s: f64,
}

impl Case {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let harm = HARMS[(seed % HARMS.len() as u64) as usize];
        let folder = std::env::temp_dir().join(format!("panoscope-campaign-{}-{seed}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let behaviour = Behaviour {
            // A loaded machine must not look like a dead guard; where the guard dies, the true limit counts.
            watchdog_ms: if harm == Harm::GuardKilled { 30 } else { 500 },
            lag_s: 0.005 + 0.02 * random.unit(),
            noise_rad: 2e-5 * random.unit(),
            ..Behaviour::default()
        };
        let firmware = Firmware::plug_in(&format!("CASE-{seed}"), behaviour).expect("a pseudo-terminal");
        let rad_s = (0.05 + 0.1 * random.unit()) * if random.of(2) == 0 { 1.0 } else { -1.0 };
        Self { random, harm, folder, firmware, guard: None, reset: 0, rad_s }
    }

    fn connection(&self) -> Connection {
        let answer_within = Duration::from_millis(240);
        Connection { path: self.firmware.path().into(), baud: 921_600, answer_within }
    }

    fn start(&mut self) -> Result<(), String> {
        let guard = Guard::start(&self.connection(), Path::new(""), Some(&self.folder));
        self.guard = Some(guard.map_err(|error| error.to_string())?);
        Ok(())
    }

    fn request(&self) -> Request {
        let now_ns = clock::now_ns();
        Request {
            sent_ns: now_ns,
            tip: Some((now_ns, Evidence { score: 0.9, in_space: true })),
            demand: Some((now_ns, [0.0, 0.0, 0.0, 0.0, 0.0, self.rad_s, 0.0, 0.0], 6)),
            settings: Settings::default(),
            emergency_stop: false,
            reset: self.reset,
        }
    }

    /// Sends `each` until `done`; `None` after the limit or the guard's end.
    fn drive(
        &mut self,
        mut each: impl FnMut(&mut Self) -> Request,
        mut done: impl FnMut(&Self, &Status) -> bool,
    ) -> Option<Status> {
        let start = Instant::now();
        while start.elapsed() < LIMIT {
            let request = each(self);
            let guard = self.guard.as_mut()?;
            guard.request(&request);
            let status = guard.status(|_| ())?;
            if done(self, &status) {
                return Some(status);
            }
            std::thread::sleep(Duration::from_millis(8));
        }
        None
    }

    /// Releases the arm until it moves. False when it does not, which a loaded machine can cause.
    fn move_on(&mut self) -> bool {
        for _ in 0..6 {
            let from = self.firmware.angles()[5];
            let Some(known) = self.drive(|case| case.request(), |_, _| true) else { return false };
            self.reset += 1;
            let patience_ns = known.at_ns + 1_500_000_000;
            let moved = self.drive(
                |case| case.request(),
                |case, status| {
                    let far = (case.firmware.angles()[5] - from).abs() > 0.008;
                    (status.stop.is_none() && far) || (status.latched && status.at_ns > patience_ns)
                },
            );
            if moved.is_some_and(|status| status.stop.is_none()) {
                return true;
            }
        }
        false
    }

    /// Does the harm, and lets the arm come to rest. Returns when it happened.
    fn harm(&mut self) -> Instant {
        let harm = self.harm;
        let at = Instant::now();
        self.firmware.set(|behaviour| harm.of_firmware(behaviour));
        let until = Duration::from_millis(500);
        let second = 1_000_000_000;
        match harm {
            Harm::Silence => std::thread::sleep(until),
            Harm::Ends => self.guard = None,
            Harm::GuardKilled | Harm::GuardStopped => {
                self.signal(if harm == Harm::GuardKilled { Signal::KILL } else { Signal::STOP });
                // The arm's own watchdog waits 500 ms in the second case.
                let _ = self.drive(|case| case.request(), |_, _| at.elapsed() > until + until / 2);
                self.signal(Signal::CONT);
                std::thread::sleep(until);
            }
            Harm::OldLight => {
                let old = |case: &mut Self| {
                    let mut asked = case.request();
                    asked.tip = asked.tip.map(|(light_ns, tip)| (light_ns - 2 * second, tip));
                    asked
                };
                self.drive(old, |_, _| at.elapsed() > until);
            }
            Harm::ClockJumps => {
                let jumps = |case: &mut Self| {
                    let mut asked = case.request();
                    asked.sent_ns = match case.random.of(4) {
                        0 => asked.sent_ns + 3600 * second,
                        1 => asked.sent_ns - 3600 * second,
                        2 => [i64::MIN, i64::MAX, 0, -1][case.random.of(4) as usize],
                        _ => asked.sent_ns,
                    };
                    asked
                };
                self.drive(jumps, |_, _| at.elapsed() > until);
            }
            Harm::Reordered => {
                let mut held = Vec::new();
                let shuffled = |case: &mut Self| {
                    held.push(case.request());
                    let index = case.random.of(held.len() as u64) as usize;
                    if held.len() > 5 { held.swap_remove(index) } else { held[index] }
                };
                self.drive(shuffled, |_, _| at.elapsed() > until);
            }
            Harm::HostileNumbers => {
                let hostile = |case: &mut Self| {
                    let mut asked = case.request();
                    if let Some((_, values, count)) = &mut asked.demand {
                        let random = &mut case.random;
                        values.iter_mut().for_each(|value| *value = random.hostile());
                        *count = if random.of(2) == 0 { 6 } else { random.bits() as u32 };
                    }
                    asked.settings.max_age_ms = case.random.hostile();
                    asked.settings.min_score = case.random.hostile();
                    asked
                };
                self.drive(hostile, |_, _| at.elapsed() > until);
            }
            Harm::Flood => {
                while at.elapsed() < until {
                    for _ in 0..500 {
                        let asked = self.request();
                        if let Some(guard) = &mut self.guard {
                            guard.request(&asked);
                        }
                    }
                    std::thread::yield_now();
                }
            }
            Harm::EmergencyStop | Harm::DiskFull => {
                if harm == Harm::DiskFull {
                    let file =
                        self.folder.join(format!("{}.new", self.guard.as_ref().map_or("", |guard| guard.serial())));
                    let _ = std::fs::create_dir(file);
                }
                self.drive(|case| Request { emergency_stop: true, ..case.request() }, |_, _| at.elapsed() > until);
                if harm == Harm::DiskFull {
                    self.signal(Signal::KILL);
                }
            }
            Harm::SecondMaster => {
                let second = Guard::start(&self.connection(), Path::new(""), Some(&self.folder));
                assert!(second.is_err(), "two programs drive one arm");
            }
            _ => {
                self.drive(|case| case.request(), |_, _| at.elapsed() > until + until);
            }
        }
        at
    }

    fn signal(&self, signal: Signal) {
        let id = self.guard.as_ref().and_then(|guard| i32::try_from(guard.process_id()).ok()).and_then(Pid::from_raw);
        if let Some(id) = id {
            // A process that has ended takes no signal.
            let _ = kill_process(id, signal);
        }
    }

    /// Whether the arm's true angles left the limits; a runaway or a stuck motor is the arm's own doing.
    fn escape(&self, chain: &Chain) -> Option<String> {
        if matches!(self.harm, Harm::Runaway | Harm::Stuck) {
            return None;
        }
        let home = chain.stance(&JointVector::zeros()).base_from_tip * nalgebra::Vector3::z();
        let log = self.firmware.log();
        for (at, angles) in &log.angles {
            let tube = TubePose::of(chain, &chain.stance(angles), &home);
            let is_inside =
                tube.pivot_mm <= caps::PIVOT_MM + measured::PIVOT_MARGIN_MM && tube.tilt_rad <= caps::TILT_RAD;
            if !is_inside || angles.iter().any(|v| !v.is_finite()) {
                return Some(format!("outside the workspace: {tube:?}"));
            }
            // Over at least 60 ms: set-points that a loaded machine held up arrive together.
            let before = log.angles.iter().rev().find(|(then, _)| *at >= *then + Duration::from_millis(60));
            if let Some((then, angles_then)) = before {
                let speed = (angles - angles_then).amax() / (*at - *then).as_secs_f64();
                // 300 ms of held-up set-points at most.
                if speed > caps::SPEED_RAD_S * measured::SPEED_SHARE + 0.02 {
                    return Some(format!("{speed:.3} rad/s"));
                }
            }
        }
        None
    }

    /// Time from the harm until set-points, or the arm's own watchdog, brake, ms.
    fn hold_ms(&self, at: Instant) -> Option<f64> {
        let log = self.firmware.log();
        let speed = self.rad_s.abs();
        let braked = log.set_points.iter().find(|(when, _, velocity)| *when > at && velocity.amax() < 0.97 * speed);
        // No set-point brakes when the guard is gone: the arm's own watchdog does.
        let when = braked.map(|(when, ..)| *when).or(log.watchdog_at.filter(|when| *when > at))?;
        Some((when - at).as_secs_f64() * 1e3)
    }

    /// Whether the next start of the guard forgets the stop.
    fn forgets(&mut self) -> Result<bool, String> {
        self.guard = None;
        if self.harm == Harm::Unplugged {
            // The pseudo-terminal is gone with its cable: the same device under a new one.
            self.firmware = Firmware::plug_in(&self.serial(), Behaviour { watchdog_ms: 500, ..Behaviour::default() })
                .map_err(|error| error.to_string())?;
        }
        self.firmware.set(|behaviour| *behaviour = Behaviour { watchdog_ms: 500, ..Behaviour::default() });
        self.start()?;
        let status = self.drive(|case| case.request(), |_, _| true).ok_or("the guard does not run")?;
        let known = status.stop.filter(|cause| *cause != Cause::AwaitsOperator);
        Ok(!status.latched || known.is_none())
    }

    fn serial(&self) -> String {
        let name = self.folder.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        format!("CASE-{}", name.rsplit('-').next().unwrap_or_default())
    }
}

impl Drop for Case {
    fn drop(&mut self) {
        self.guard = None;
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn run(seed: u64, chain: &Chain, outcome: &Mutex<Outcome>) {
    let mut case = Case::new(seed);
    let harm = case.harm;
    let fail = |words: String| {
        outcome.lock().expect("whole").failures.push(format!("seed {seed}, {harm:?}: {words}"));
    };
    if let Err(words) = case.start() {
        return fail(words);
    }
    if !case.move_on() {
        outcome.lock().expect("whole").not_moving += 1;
        return;
    }
    std::thread::sleep(Duration::from_millis(case.random.of(60)));
    let at = case.harm();
    let hold = case.hold_ms(at).filter(|_| harm.is_timed());
    let escape = case.escape(chain);
    let forgets = if harm.latches() { case.forgets() } else { Ok(false) };
    let mut all = outcome.lock().expect("whole");
    all.cases += 1;
    if harm.is_timed() && hold.is_none() {
        all.failures.push(format!("seed {seed}, {harm:?}: the arm does not brake"));
    }
    all.hold_ms.extend(hold);
    if let Some(words) = escape {
        all.escapes += 1;
        all.failures.push(format!("seed {seed}, {harm:?}: {words}"));
    }
    match forgets {
        Ok(false) => {}
        Ok(true) => {
            all.forgotten += 1;
            all.failures.push(format!("seed {seed}, {harm:?}: the stop was forgotten"));
        }
        Err(words) => all.failures.push(format!("seed {seed}, {harm:?}: {words}")),
    }
}

#[test]
fn no_harm_moves_the_arm_out_of_its_limits_and_no_stop_is_forgotten() {
    let number =
        |name: &str, default: u64| std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default);
    let (cases, first) = (number("PANOSCOPE_ARM_CASES", 96), number("PANOSCOPE_ARM_SEED", 0));
    let chain = Chain::shipped().expect("the shipped arm");
    let (next, outcome) = (AtomicU64::new(first), Mutex::new(Outcome::default()));
    std::thread::scope(|scope| {
        for _ in 0..BESIDE {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first + cases {
                        return;
                    }
                    run(seed, &chain, &outcome);
                }
            });
        }
    });
    let mut all = outcome.into_inner().expect("whole");
    all.hold_ms.sort_by(f64::total_cmp);
    let at =
        |share: f64| all.hold_ms.get(((all.hold_ms.len() as f64 - 1.0) * share) as usize).copied().unwrap_or(f64::NAN);
    println!(
        "{} cases: escapes {}, forgotten {}, did not move {}; hold p50 {:.1} p99 {:.1} max {:.1} ms",
        all.cases,
        all.escapes,
        all.forgotten,
        all.not_moving,
        at(0.5),
        at(0.99),
        at(1.0)
    );
    assert!(all.failures.is_empty(), "{:#?}", all.failures);
    assert!(all.cases * 10 >= cases * 8, "only {} of {cases} cases moved the arm", all.cases);
}
