//! One case: an arm, its guard, what steers it, and the harm.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use panoscope_arm_core::campaign::Random;
use panoscope_arm_core::interlock::{Evidence, Settings};
use panoscope_arm_core::{Cause, Chain, JointVector};
use panoscope_arm_guard::client::Guard;
use panoscope_arm_guard::clock;
use panoscope_arm_guard::link::Connection;
use panoscope_arm_guard::message::{Request, Status};
use panoscope_firmware::{Behaviour, Firmware};
use rustix::process::{Pid, Signal, kill_process};

use super::harm::{HARMS, Harm};
use super::host::Host;
use super::judge;

/// Limit of each wait; a loaded machine may hold every thread up.
const LIMIT: Duration = Duration::from_secs(10);
/// Time between two requests.
const TICK: Duration = Duration::from_millis(8);
/// An arm that has not moved for this time is at rest.
const REST: Duration = Duration::from_millis(100);
/// Largest movement of an arm at rest, rad: motors come to rest exponentially, encoders have noise.
const REST_RAD: f64 = 1e-4;
const SECOND_NS: i64 = 1_000_000_000;
const MS_NS: i64 = 1_000_000;

/// What is found.
pub struct Findings {
    pub harm: Harm,
    /// Time from the harm until the arm brakes, ms.
    pub hold_ms: Option<f64>,
    /// Limits that the arm exceeded.
    pub escape: Option<String>,
    /// Whether the next start forgets the stop.
    pub is_forgotten: bool,
    /// What else is wrong.
    pub wrong: Option<String>,
}

pub struct Case {
    seed: u64,
    random: Random,
    harm: Harm,
    folder: PathBuf,
    firmware: Firmware,
    guard: Option<Guard>,
    host: Option<Host>,
    reset: u64,
    rad_s: f64,
}

/// A folder in memory, where there is one: the campaign waits for no disk. `latch.rs` tests what is on the disk.
fn folder(seed: u64) -> PathBuf {
    let memory = Path::new("/dev/shm");
    let base = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    base.join(format!("panoscope-campaign-{}-{seed}", std::process::id()))
}

impl Case {
    pub fn new(seed: u64) -> Result<Self, String> {
        let mut random = Random::new(seed);
        let harm = HARMS[(seed % HARMS.len() as u64) as usize];
        let folder = folder(seed);
        let _ = std::fs::remove_dir_all(&folder);
        let behaviour = Behaviour {
            // A loaded machine must not look like a dead guard; where the guard dies, the true limit counts.
            watchdog_ms: if harm == Harm::GuardKilled { 30 } else { 500 },
            lag_s: 0.005 + 0.02 * random.unit(),
            noise_rad: 2e-5 * random.unit(),
            ..Behaviour::default()
        };
        let firmware = Firmware::plug_in(&serial(seed), behaviour).map_err(|error| error.to_string())?;
        let rad_s = (0.05 + 0.1 * random.unit()) * if random.of(2) == 0 { 1.0 } else { -1.0 };
        Ok(Self { seed, random, harm, folder, firmware, guard: None, host: None, reset: 0, rad_s })
    }

    /// Runs the case. `None` when the arm never moved, which a loaded machine can cause.
    pub fn run(&mut self, chain: &Chain) -> Result<Option<Findings>, String> {
        let has_moved = if self.harm.has_host() {
            match Host::start(self.firmware.path(), &self.folder, self.rad_s) {
                Ok(host) => self.host = Some(host),
                Err(words) if passes(&words) => return Ok(None),
                Err(words) => return Err(words),
            }
            self.wait_until(|case| case.is_steady())
        } else {
            self.start()?;
            self.move_on()
        };
        if !has_moved {
            return Ok(None);
        }
        // At a random moment of the movement, with requests up to it.
        let (start, wait) = (Instant::now(), Duration::from_millis(self.random.of(60)));
        if self.host.is_some() {
            std::thread::sleep(wait);
        } else {
            self.drive(|case| case.request(), |_, _| start.elapsed() >= wait);
        }
        let (at, wrong) = self.do_harm();
        let harm = self.harm;
        let braked_at = self.firmware.inspect(judge::braked_at).filter(|_| harm.is_timed());
        let is_unbraked = harm.is_timed() && braked_at.is_none();
        // A loaded machine may have stopped the arm before: that measures nothing.
        let hold_ms = braked_at.filter(|when| *when > at).map(|when| (when - at).as_secs_f64() * 1e3);
        let wrong = wrong.err().or(is_unbraked.then(|| "the arm does not brake".to_owned()));
        // A runaway or a stuck motor is the arm's own doing.
        let is_judged = !matches!(harm, Harm::Runaway | Harm::Stuck);
        let escape = if is_judged { self.firmware.inspect(|log| judge::escape(log, chain)) } else { None };
        let is_forgotten = harm.latches() && self.forgets()?;
        Ok(Some(Findings { harm, hold_ms, escape, is_forgotten, wrong }))
    }

    fn connection(&self, path: &Path) -> Connection {
        Connection { path: path.to_owned(), baud: 921_600, answer_within: Duration::from_millis(240) }
    }

    /// Starts a guard. An earlier one may still be braking: it has the arm until it ends.
    fn start(&mut self) -> Result<(), String> {
        let start = Instant::now();
        loop {
            match Guard::start(&self.connection(self.firmware.path().as_ref()), Path::new(""), Some(&self.folder)) {
                Ok(guard) => {
                    self.guard = Some(guard);
                    return Ok(());
                }
                Err(error) if !passes(&error.to_string()) || start.elapsed() > LIMIT => return Err(error.to_string()),
                Err(_) => std::thread::sleep(TICK),
            }
        }
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
            std::thread::sleep(TICK);
        }
        None
    }

    /// Waits without a request; false after the limit.
    fn wait_until(&self, mut done: impl FnMut(&Self) -> bool) -> bool {
        let start = Instant::now();
        while start.elapsed() < LIMIT {
            if done(self) {
                return true;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        false
    }

    fn is_steady(&self) -> bool {
        self.firmware.inspect(|log| judge::is_steady(log, self.rad_s))
    }

    /// Releases the arm until it moves. False when it does not, which a loaded machine can cause.
    fn move_on(&mut self) -> bool {
        for _ in 0..6 {
            let Some(known) = self.drive(|case| case.request(), |_, _| true) else { return false };
            self.reset += 1;
            let patience_ns = known.at_ns + 1_500_000_000;
            let moved = self.drive(
                |case| case.request(),
                |case, status| {
                    (status.stop.is_none() && case.is_steady()) || (status.latched && status.at_ns > patience_ns)
                },
            );
            if moved.is_some_and(|status| status.stop.is_none()) {
                return true;
            }
        }
        false
    }

    /// Does the harm, and lets the arm come to rest where it has to. Returns when it happened, and what is wrong.
    fn do_harm(&mut self) -> (Instant, Result<(), String>) {
        let harm = self.harm;
        if harm == Harm::DiskFull {
            // The file that is written before it takes the place of the record: each write to it finds no space left on the device (ENOSPC).
            let file = self.folder.join(format!("{}.new", serial(self.seed)));
            let _ = std::os::unix::fs::symlink("/dev/full", file);
        }
        let mut at = Instant::now();
        self.firmware.set(|behaviour| harm.of_firmware(behaviour));
        let until = Duration::from_millis(200 + self.random.of(200));
        let result = match harm {
            Harm::HostKilled | Harm::HostStopped | Harm::HostHangs | Harm::HostCrashes => {
                at = self.harm_host();
                self.comes_to_rest_alone()
            }
            Harm::Ends => {
                self.guard = None;
                self.comes_to_rest_alone()
            }
            Harm::GuardKilled => {
                self.signal(Signal::KILL);
                self.comes_to_rest_alone()
            }
            Harm::GuardStopped => {
                self.signal(Signal::STOP);
                // The arm's own watchdog waits 500 ms here. The program sees that the guard does not report.
                let gone = self.drive(|case| case.request(), |_, status| status.stop.is_some());
                let rests = self.comes_to_rest_alone();
                self.signal(Signal::CONT);
                let latches = self.drive(|case| case.request(), |_, s| s.latched && s.stop != Some(Cause::GuardGone));
                rests
                    .and(gone.map(drop).ok_or_else(|| "the program does not see that the guard is stopped".to_owned()))
                    .and(latches.map(drop).ok_or_else(|| "a guard that was stopped goes on".to_owned()))
            }
            Harm::OldLight => {
                let old = |case: &mut Self| {
                    let mut asked = case.request();
                    asked.tip = asked.tip.map(|(light_ns, tip)| (light_ns - 2 * SECOND_NS, tip));
                    asked
                };
                self.comes_to_rest(old)
            }
            Harm::LiveEdit => self.live_edit(until),
            Harm::LateTicks => {
                let delay_ns = (40 + self.random.of(160)) as i64 * MS_NS;
                let mut kept = std::collections::VecDeque::new();
                self.comes_to_rest(move |case| {
                    kept.push_back(case.request());
                    let is_due = |request: &Request| clock::now_ns() - request.sent_ns >= delay_ns;
                    // The newest that is due; until then the last one once more.
                    while kept.len() > 1 && kept.get(1).is_some_and(is_due) {
                        kept.pop_front();
                    }
                    kept[0]
                })
            }
            Harm::SlowClock => {
                let start_ns = clock::now_ns();
                let unit = self.random.unit();
                let rate = if self.random.of(2) == 0 { 0.3 + 0.5 * unit } else { 1.3 + unit };
                self.comes_to_rest(move |case| {
                    let mut asked = case.request();
                    let shift_ns = ((asked.sent_ns - start_ns) as f64 * (rate - 1.0)) as i64;
                    asked.sent_ns += shift_ns;
                    asked.tip = asked.tip.map(|(light_ns, tip)| (light_ns + shift_ns, tip));
                    asked.demand = asked.demand.map(|(light_ns, values, count)| (light_ns + shift_ns, values, count));
                    asked
                })
            }
            Harm::ClockJumps => {
                let jumps = |case: &mut Self| {
                    let mut asked = case.request();
                    asked.sent_ns = match case.random.of(4) {
                        0 => asked.sent_ns + 3600 * SECOND_NS,
                        1 => asked.sent_ns - 3600 * SECOND_NS,
                        2 => [i64::MIN, i64::MAX, 0, -1][case.random.of(4) as usize],
                        _ => asked.sent_ns,
                    };
                    asked
                };
                self.drive_for(until, jumps)
            }
            Harm::Reordered => {
                let mut held = Vec::new();
                self.drive_for(until, move |case| {
                    held.push(case.request());
                    let index = case.random.of(held.len() as u64) as usize;
                    if held.len() > 5 { held.swap_remove(index) } else { held[index] }
                })
            }
            Harm::HostileNumbers => self.drive_for(until, Self::hostile),
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
                Ok(())
            }
            Harm::ByteDamage => self.drive_for(until, |case| case.request()),
            Harm::EmergencyStop => self.comes_to_rest(|case| Request { emergency_stop: true, ..case.request() }),
            Harm::DiskFull => {
                let rests = self.comes_to_rest(|case| Request { emergency_stop: true, ..case.request() });
                self.signal(Signal::KILL);
                rests
            }
            Harm::SecondMaster => self.second_master(),
            _ => {
                let latched = self.drive(|case| case.request(), |_, status| status.latched);
                latched.map(drop).ok_or_else(|| "the fault is not noticed".to_owned())
            }
        };
        (at, result)
    }

    fn harm_host(&mut self) -> Instant {
        let Some(host) = &mut self.host else { return Instant::now() };
        let at = Instant::now();
        match self.harm {
            Harm::HostKilled => host.signal(Signal::KILL),
            Harm::HostStopped => host.signal(Signal::STOP),
            Harm::HostCrashes => host.command("crash"),
            _ => {
                host.command("hang");
                let _ = host.line();
                return Instant::now();
            }
        }
        at
    }

    /// A live edit of the region with the arm: no tick for a while, then the kept ticks one after the other, each with
    /// the age of its light.
    fn live_edit(&mut self, until: Duration) -> Result<(), String> {
        let (start, mut rest) = (Instant::now(), Rest::default());
        let mut kept = std::collections::VecDeque::new();
        // The arm rests before the ticks are played back, and all of them are too old by then.
        while start.elapsed() < until || !rest.is_reached(&self.firmware) {
            if start.elapsed() > LIMIT {
                return Err("the arm does not come to rest".to_owned());
            }
            kept.push_back(self.request());
            std::thread::sleep(TICK);
        }
        let before = self.firmware.angles();
        while let Some(old) = kept.pop_front() {
            // Called now, as the node is; its pictures are as old as they are.
            let Some(guard) = &mut self.guard else { break };
            guard.request(&Request { sent_ns: clock::now_ns(), ..old });
            std::thread::sleep(TICK);
        }
        let moved = (self.firmware.angles() - before).amax();
        if moved > REST_RAD { Err(format!("kept ticks moved the arm by {moved:.4} rad")) } else { Ok(()) }
    }

    fn hostile(&mut self) -> Request {
        let mut asked = self.request();
        let random = &mut self.random;
        if let Some((_, values, count)) = &mut asked.demand {
            values.iter_mut().for_each(|value| *value = random.hostile());
            *count = if random.of(2) == 0 { 6 } else { random.bits() as u32 };
        }
        if let Some((_, tip)) = &mut asked.tip {
            tip.score = if random.of(2) == 0 { tip.score } else { random.hostile() };
        }
        asked.settings = Settings { max_age_ms: random.hostile(), min_score: random.hostile() };
        asked
    }

    fn second_master(&mut self) -> Result<(), String> {
        let link = self.folder.join("arm");
        std::os::unix::fs::symlink(self.firmware.path(), &link).map_err(|error| error.to_string())?;
        for path in [PathBuf::from(self.firmware.path()), link] {
            if Guard::start(&self.connection(&path), Path::new(""), Some(&self.folder)).is_ok() {
                return Err(format!("two guards drive one arm, the second by {}", path.display()));
            }
            self.drive(|case| case.request(), |_, _| true);
        }
        match Host::start(self.firmware.path(), &self.folder, self.rad_s) {
            Ok(_) => Err("two programs drive one arm".to_owned()),
            Err(words) if words.contains("another program") => Ok(()),
            Err(words) => Err(words),
        }
    }

    fn drive_for(&mut self, time: Duration, each: impl FnMut(&mut Self) -> Request) -> Result<(), String> {
        let start = Instant::now();
        // A guard that ends is found by its next start.
        self.drive(each, |_, _| start.elapsed() >= time);
        Ok(())
    }

    /// Sends requests that must stop the arm, until it rests.
    fn comes_to_rest(&mut self, each: impl FnMut(&mut Self) -> Request) -> Result<(), String> {
        let mut rest = Rest::default();
        let status = self.drive(each, |case, status| rest.is_reached(&case.firmware) && status.stop.is_some());
        status.map(drop).ok_or_else(|| "the arm does not come to rest".to_owned())
    }

    /// Waits until the arm rests, without a request.
    fn comes_to_rest_alone(&self) -> Result<(), String> {
        let mut rest = Rest::default();
        let rests = self.wait_until(|case| rest.is_reached(&case.firmware));
        if rests { Ok(()) } else { Err("the arm does not come to rest".to_owned()) }
    }

    fn signal(&self, signal: Signal) {
        let id = self.guard.as_ref().and_then(|guard| i32::try_from(guard.process_id()).ok()).and_then(Pid::from_raw);
        if let Some(id) = id {
            // A process that has ended takes no signal.
            let _ = kill_process(id, signal);
        }
    }

    /// Whether the next start of the guard forgets the stop, or lets the arm move without a reset.
    fn forgets(&mut self) -> Result<bool, String> {
        (self.guard, self.host) = (None, None);
        let sound = Behaviour { watchdog_ms: 500, ..Behaviour::default() };
        if self.harm == Harm::Unplugged {
            // The pseudo-terminal is gone with its cable: the same device under a new one.
            self.firmware = Firmware::plug_in(&serial(self.seed), sound).map_err(|error| error.to_string())?;
        }
        self.firmware.set(|behaviour| *behaviour = sound);
        self.start()?;
        let count = |case: &Self| case.firmware.inspect(|log| log.set_points.len());
        let (before, start) = (count(self), Instant::now());
        let status = self.drive(|case| case.request(), |_, _| start.elapsed() > Duration::from_millis(60));
        let status = status.ok_or("the guard does not run")?;
        let known = status.stop.filter(|cause| *cause != Cause::AwaitsOperator);
        Ok(!status.latched || known.is_none() || count(self) > before)
    }
}

/// Waits for an arm to rest.
#[derive(Default)]
struct Rest {
    since: Option<(Instant, JointVector)>,
}

impl Rest {
    /// Whether the arm has braked and rested for [`REST`] by now.
    fn is_reached(&mut self, firmware: &Firmware) -> bool {
        let angles = firmware.angles();
        let has_braked = firmware.inspect(judge::braked_at).is_some();
        match &self.since {
            Some((since, at)) if has_braked && (angles - at).amax() < REST_RAD => since.elapsed() > REST,
            _ => {
                self.since = Some((Instant::now(), angles));
                false
            }
        }
    }
}

/// Whether a start failed for a reason that passes: an earlier guard is still braking, or a loaded machine held the
/// simulated arm or the guard up.
fn passes(words: &str) -> bool {
    ["another program", "no arm answered", "did not report within"].iter().any(|reason| words.contains(reason))
}

fn serial(seed: u64) -> String {
    format!("CASE-{seed}")
}

impl Drop for Case {
    fn drop(&mut self) {
        // A stopped guard does not end by itself.
        self.signal(Signal::CONT);
        (self.guard, self.host) = (None, None);
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
