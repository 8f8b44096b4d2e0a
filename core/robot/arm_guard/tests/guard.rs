//! The guard's process against a simulated arm on a pseudo-terminal: it moves only when a person released it, every
//! fault stops it, and stops survive.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use panoscope_arm_core::interlock::{Brake, Caps, Event, Evidence, Settings, caps};
use panoscope_arm_core::{Cause, Chain, JointVector, SetPoint};
use panoscope_arm_guard::client::{Guard, GuardError};
use panoscope_arm_guard::clock;
use panoscope_arm_guard::link::Connection;
use panoscope_arm_guard::message::{Request, Status};
use panoscope_firmware::{Behaviour, Firmware};

/// A loaded machine may hold every thread up.
const LIMIT: Duration = Duration::from_secs(8);

/// A folder for latches that is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("panoscope-guard-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        Self(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn connection(firmware: &Firmware) -> Connection {
    // Late answers of a loaded machine are no fault of the guard.
    Connection { path: firmware.path().into(), baud: 921_600, answer_within: Duration::from_millis(200) }
}

/// Starts a guard. An arm whose thread a loaded machine holds up too long is asked again.
fn start(firmware: &Firmware, folder: &Folder) -> Result<Guard, GuardError> {
    let begin = Instant::now();
    loop {
        match Guard::start(&connection(firmware), Path::new(""), Some(&folder.0)) {
            Err(GuardError::Refused(words)) if words.contains("no arm answered") && begin.elapsed() < LIMIT => {}
            ended => return ended,
        }
    }
}

/// A patient arm: its watchdog tolerates a loaded machine.
fn patient() -> Behaviour {
    Behaviour { watchdog_ms: 400, ..Behaviour::default() }
}

fn request(reset: u64) -> Request {
    let now_ns = clock::now_ns();
    Request {
        sent_ns: now_ns,
        tip: Some((now_ns, Evidence { score: 0.9, in_space: true })),
        demand: Some((now_ns, [0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0], 6)),
        settings: Settings::default(),
        emergency_stop: false,
        reset,
    }
}

/// Sends `each` every 10 ms until `done`. Returns the last state, `None` after the time limit or when the guard has
/// ended.
fn drive(
    guard: &mut Guard,
    events: &mut Vec<Event>,
    mut each: impl FnMut() -> Request,
    mut done: impl FnMut(&Status) -> bool,
) -> Option<Status> {
    let start = Instant::now();
    while start.elapsed() < LIMIT {
        guard.request(&each());
        let status = guard.status(|event| events.push(event))?;
        if done(&status) {
            return Some(status);
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    None
}

/// Releases the arm and gets it moving. On a loaded machine a late answer may latch: then again.
fn moving(guard: &mut Guard, firmware: &Firmware, reset: &mut u64) {
    let mut events = Vec::new();
    let mut stops = Vec::new();
    for _ in 0..8 {
        let from = firmware.angles()[5];
        // The first request sets the number that later ones are compared with.
        let known = drive(guard, &mut events, || request(*reset), |_| true).expect("it runs");
        *reset += 1;
        // A release takes up to 0.85 s.
        let patience_ns = known.at_ns + 1_200_000_000;
        let moved = drive(
            guard,
            &mut events,
            || request(*reset),
            |status| {
                let has_moved = status.stop.is_none() && (firmware.angles()[5] - from).abs() > 0.01;
                has_moved || (status.latched && status.at_ns > patience_ns)
            },
        );
        if moved.is_some_and(|status| status.stop.is_none()) {
            return;
        }
        stops.push(moved.and_then(|status| status.stop));
    }
    panic!("the arm never moved: {stops:?} {events:?}");
}

/// Whether a stop latches for another reason than that nobody has released the arm.
fn stays(cause: Cause) -> bool {
    cause.latches() && cause != Cause::AwaitsOperator
}

#[test]
fn an_arm_that_has_come_up_waits_for_a_person() {
    let folder = Folder::new("waits");
    let firmware = Firmware::plug_in("CAM6-1", patient()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    assert_eq!((guard.serial(), guard.watchdog_ms()), ("CAM6-1", 400));
    // However long requests arrive, and whatever number `reset` has.
    let since = Instant::now();
    let status = drive(&mut guard, &mut Vec::new(), || request(41), |_| since.elapsed() > Duration::from_millis(400));
    let status = status.expect("it runs");
    assert_eq!((status.stop, status.latched), (Some(Cause::AwaitsOperator), true));
    assert_eq!(firmware.angles(), JointVector::zeros());
    assert_eq!(firmware.log().clears, 0, "the start clears nothing");
    moving(&mut guard, &firmware, &mut 41);
    drop(guard);
    // Left at rest: the next start waits again.
    let mut guard = start(&firmware, &folder).expect("started");
    let status = drive(&mut guard, &mut Vec::new(), || request(0), |_| true).expect("it runs");
    assert!(status.latched);
}

#[test]
fn an_arm_stops_when_requests_stop() {
    let folder = Folder::new("silence");
    let firmware = Firmware::plug_in("CAM6-2", patient()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    moving(&mut guard, &firmware, &mut 0);
    // No request and no end of the connection: as when the program hangs or was stopped.
    std::thread::sleep(Duration::from_millis(700));
    let (count, at) = (firmware.log().set_points.len(), firmware.angles());
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(firmware.log().set_points.len(), count, "no set-point any more");
    assert!((firmware.angles() - at).amax() < 1e-9);
    let mut events = Vec::new();
    let status = guard.status(|event| events.push(event)).expect("it runs");
    assert!(matches!(status.stop, Some(Cause::LoopStalled | Cause::OldTip)), "{:?}", status.stop);
    assert!(!status.latched, "requests that go on move the arm again");
}

/// The angle of the last joint at which the arm rests when requests stop at `sent_ns`: it goes on until its demand
/// expires, then brakes. From a state of steady speed.
fn rests_at(status: &Status, sent_ns: i64) -> f64 {
    let chain = Chain::shipped().expect("the shipped arm");
    let (position, velocity) = status.set_point;
    let left_s = (sent_ns + caps::DEMAND_AGE.as_nanos() as i64 - status.at_ns) as f64 * 1e-9;
    let start = SetPoint { position: position + velocity * left_s, velocity, acceleration: JointVector::zeros() };
    let brake = Brake::plan(start, &Caps::of(&chain));
    brake.at(brake.steps()).position[5]
}

#[test]
fn set_points_brake_when_the_last_request_expires_however_loaded_the_machine_is() {
    let folder = Folder::new("hold");
    // Its own watchdog would stop the arm after 400 ms only: what holds it here is the guard. Set-points are a function of the clock that stamps
    // requests, so the angle at which they end gives the time at which they began to brake, however late the machine ran each process.
    let firmware = Firmware::plug_in("CAM6-11", patient()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    let mut reset = 0;
    let mut differences_rad = Vec::new();
    for _ in 0..20 {
        moving(&mut guard, &firmware, &mut reset);
        let mut last_ns = 0;
        let mut steady = 0;
        let status = drive(
            &mut guard,
            &mut Vec::new(),
            || {
                let asked = request(reset);
                last_ns = asked.sent_ns;
                asked
            },
            |status| {
                let is_steady = status.stop.is_none() && (status.set_point.1[5] - 0.1).abs() < 1e-4;
                steady = if is_steady { steady + 1 } else { 0 };
                // A late request would have made it brake before.
                steady == 5 && clock::now_ns() - status.at_ns < 15_000_000
            },
        );
        let Some(known) = status else { continue };
        let expected = rests_at(&known, last_ns);
        let start = Instant::now();
        let rested = loop {
            let status = guard.status(|_| ()).expect("it runs");
            if status.set_point.1.amax() == 0.0 || start.elapsed() > LIMIT {
                break status;
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        assert_eq!(rested.set_point.1, JointVector::zeros(), "it comes to rest");
        differences_rad.push(rested.set_point.0[5] - expected);
        // A latched stop, of a late answer, brakes earlier, and so does a guard that did not run for a while. The watchdog of the arm did nothing.
        let is_stale = matches!(rested.stop, Some(Cause::LoopStalled | Cause::OldTip | Cause::Clock));
        assert!(rested.latched || is_stale, "{:?}", rested.stop);
        if differences_rad.iter().filter(|off| off.abs() < 0.25e-3).count() >= 3 {
            break;
        }
    }
    println!("{differences_rad:?}");
    // 1 ms at 0.1 rad/s is 0.1 mrad: the state and the braking begin at whole steps of 1 ms. Braking earlier is allowed, later is not.
    assert!(differences_rad.iter().all(|off| *off < 0.25e-3), "it goes on for too long: {differences_rad:?}");
    assert!(differences_rad.iter().any(|off| off.abs() < 0.25e-3), "it never went on until then: {differences_rad:?}");
}

#[test]
fn the_arms_own_watchdog_holds_it_30_ms_after_the_guard_died() {
    let folder = Folder::new("own");
    // The true limit of 30 ms. A loaded machine may trip it before the guard dies: then once more.
    let firmware = Firmware::plug_in("CAM6-12", Behaviour::default()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    assert_eq!(guard.watchdog_ms(), 30);
    moving(&mut guard, &firmware, &mut 0);
    let before = firmware.log().watchdog;
    assert!(rustix_kill(&guard), "killed");
    assert!(firmware.wait(LIMIT, |log| log.watchdog > before), "the arm's watchdog");
    let log = firmware.log();
    let (fed, at) = (log.set_points.last().expect("set-points").0, log.watchdog_at.expect("it stopped"));
    assert!(at - fed > Duration::from_millis(30), "not before its time: {:?}", at - fed);
    // True angles: 30 ms at 0.1 rad/s, the lag of the motors, braking at 4 rad/s^2, all with room for the turns of the simulated controller.
    let from = log.angles.iter().rfind(|(when, _)| *when <= fed).expect("it moved").1[5];
    assert!(firmware.wait(LIMIT, |log| log.angles.last().is_some_and(|(when, _)| when.elapsed().as_millis() > 60)));
    let went = firmware.angles()[5] - from;
    assert!(went < 0.1 * 0.03 + 0.005, "{went} rad");
}

#[test]
fn a_guard_that_does_not_report_is_noticed() {
    let folder = Folder::new("hangs");
    let firmware = Firmware::plug_in("CAM6-13", patient()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    let mut reset = 0;
    moving(&mut guard, &firmware, &mut reset);
    signal(&guard, rustix::process::Signal::STOP);
    let status = drive(&mut guard, &mut Vec::new(), || request(reset), |status| status.stop == Some(Cause::GuardGone));
    assert!(status.is_some_and(|status| status.latched), "the program does not see that its guard is stopped");
    assert!(firmware.wait(LIMIT, |log| log.watchdog == 1), "the arm's own watchdog holds it");
    signal(&guard, rustix::process::Signal::CONT);
    // It finds what happened meanwhile, and does not go on.
    let status = drive(&mut guard, &mut Vec::new(), || request(reset), |status| status.stop != Some(Cause::GuardGone));
    let stop = status.and_then(|status| status.stop);
    assert!(matches!(stop, Some(Cause::Stalled | Cause::DeviceStopped)), "{stop:?}");
    moving(&mut guard, &firmware, &mut reset);
}

#[test]
fn a_reset_releases_only_what_stopped_before_it() {
    let folder = Folder::new("order");
    let firmware = Firmware::plug_in("CAM6-14", patient()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    drive(&mut guard, &mut Vec::new(), || request(0), |status| status.latched).expect("it waits");
    // Read in one turn: a reset, then an emergency stop that is let go again.
    signal(&guard, rustix::process::Signal::STOP);
    guard.request(&request(1));
    guard.request(&Request { emergency_stop: true, ..request(1) });
    guard.request(&request(1));
    signal(&guard, rustix::process::Signal::CONT);
    let sent_ns = clock::now_ns();
    let status = drive(&mut guard, &mut Vec::new(), || request(1), |status| status.at_ns > sent_ns + 300_000_000);
    assert!(status.is_some_and(|status| status.latched), "{status:?}");
    assert_eq!(firmware.log().clears, 0, "nothing was released");
    moving(&mut guard, &firmware, &mut 1);
}

#[test]
fn an_arm_left_at_rest_is_remembered_as_such() {
    let folder = Folder::new("rest");
    let firmware = Firmware::plug_in("CAM6-15", patient()).expect("an arm");
    // A late answer of a loaded machine may stop it while it rests: then once more.
    let causes: Vec<Option<Cause>> = (0..4)
        .map(|_| {
            let mut guard = start(&firmware, &folder).expect("started");
            let mut reset = 0;
            moving(&mut guard, &firmware, &mut reset);
            let still = || Request { demand: Some((clock::now_ns(), [0.0; 8], 6)), ..request(reset) };
            let rested = drive(&mut guard, &mut Vec::new(), still, |status| status.set_point.1.amax() < 1e-15);
            assert!(rested.is_some(), "it comes to rest");
            drop(guard);
            let mut guard = start(&firmware, &folder).expect("started");
            drive(&mut guard, &mut Vec::new(), || request(0), |_| true).expect("it runs").stop
        })
        .collect();
    assert!(causes.contains(&Some(Cause::AwaitsOperator)), "{causes:?}");
}

#[test]
fn the_guard_fits_into_the_memory_that_the_doctor_asks_for() {
    let folder = Folder::new("memory");
    let firmware = Firmware::plug_in("CAM6-16", patient()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    moving(&mut guard, &firmware, &mut 0);
    let status = std::fs::read_to_string(format!("/proc/{}/status", guard.process_id())).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmPeak:")).expect("its largest size");
    let kib: u64 = line.split_whitespace().next().and_then(|word| word.parse().ok()).expect("a number of KiB");
    assert!(kib < panoscope_arm_guard::realtime::MEMORY_KIB, "{kib} KiB");
}

#[test]
fn stale_future_and_disordered_requests_move_nothing() {
    let folder = Folder::new("stale");
    let firmware = Firmware::plug_in("CAM6-3", patient()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    let mut reset = 0;
    moving(&mut guard, &firmware, &mut reset);
    let second = 1_000_000_000;
    // Ticks that were kept and are played back: sent now, their light is seconds old.
    let old_light = |mut asked: Request| {
        asked.tip = asked.tip.map(|(light_ns, tip)| (light_ns - 2 * second, tip));
        asked
    };
    let status = drive(&mut guard, &mut Vec::new(), || old_light(request(reset)), |s| s.stop == Some(Cause::OldTip));
    assert!(status.is_some(), "an old tip");
    moving(&mut guard, &firmware, &mut reset);
    // A new tip beside a demand that was made of old light.
    let old_demand = |mut asked: Request| {
        asked.demand = asked.demand.map(|(light_ns, values, count)| (light_ns - 2 * second, values, count));
        asked
    };
    let status = drive(&mut guard, &mut Vec::new(), || old_demand(request(reset)), |s| s.stop == Some(Cause::OldTip));
    assert!(status.is_some(), "an old demand");
    moving(&mut guard, &firmware, &mut reset);
    // Stamps from the future, and the same stamp again and again.
    let refused = guard.last_status().refused;
    let future = || Request { sent_ns: clock::now_ns() + second, ..request(reset) };
    let status = drive(&mut guard, &mut Vec::new(), future, |s| s.stop.is_some() && s.refused > refused + 10);
    assert!(status.is_some(), "from the future");
    moving(&mut guard, &firmware, &mut reset);
    let repeated = request(reset);
    let status = drive(&mut guard, &mut Vec::new(), || repeated, |s| s.stop.is_some());
    assert!(status.is_some(), "the same request for ever");
}

#[test]
fn every_fault_of_arm_and_line_stops_the_arm() {
    type Fault = fn(&mut Behaviour);
    let faults: [(&str, Fault, Cause); 9] = [
        ("silent", |b| b.is_silent = true, Cause::Stalled),
        ("garbage", |b| b.is_garbage = true, Cause::Garbage),
        ("numbers", |b| b.has_wrong_numbers = true, Cause::Garbage),
        ("late", |b| b.delay = Duration::from_millis(350), Cause::Stalled),
        ("unplugged", |b| b.is_unplugged = true, Cause::Unplugged),
        ("stuck", |b| b.is_stuck = true, Cause::NotFollowing),
        ("stop", |b| b.is_stopped = true, Cause::HardwareStop),
        ("fault", |b| b.has_fault = true, Cause::HardwareFault),
        ("runaway", |b| b.runaway_rad_s = 0.9, Cause::MeasuredSpeed),
    ];
    for (name, fault, cause) in faults {
        let folder = Folder::new(name);
        // A late answer of a loaded machine may come first: then once more.
        let found = (0..4).any(|_| {
            let firmware = Firmware::plug_in("CAM6-4", patient()).expect("an arm");
            let mut guard = start(&firmware, &folder).expect("started");
            moving(&mut guard, &firmware, &mut 0);
            firmware.set(fault);
            let status = drive(&mut guard, &mut Vec::new(), || request(1), |s| s.stop.is_some_and(stays));
            let stop = status.unwrap_or_else(|| panic!("{name}: {:?}", guard.last_status())).stop;
            // Latched: to ask again does not help.
            let since = Instant::now();
            let later = drive(&mut guard, &mut Vec::new(), || request(1), |_| since.elapsed().as_millis() > 300);
            assert_eq!(later.expect("it runs").stop, stop, "{name} does not latch");
            stop == Some(cause)
        });
        assert!(found, "{name}: {cause:?}");
    }
}

#[test]
fn a_stop_survives_restart_crash_and_another_path() {
    let folder = Folder::new("survives");
    let firmware = Firmware::plug_in("CAM6-5", patient()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    let mut reset = 0;
    moving(&mut guard, &firmware, &mut reset);
    let at = reset;
    let stopped = || Request { emergency_stop: true, ..request(at) };
    let status = drive(&mut guard, &mut Vec::new(), stopped, |s| s.latched && s.set_point.1.amax() == 0.0);
    assert_eq!(status.expect("it stops").stop, Some(Cause::EmergencyStop));
    drop(guard);
    // The same device under another name.
    let link = folder.0.join("arm");
    std::os::unix::fs::symlink(firmware.path(), &link).expect("linked");
    let other = Connection { path: link, ..connection(&firmware) };
    let mut guard = Guard::start(&other, Path::new(""), Some(&folder.0)).expect("started");
    let status = drive(&mut guard, &mut Vec::new(), || request(reset), |_| true);
    assert_eq!(status.expect("it runs").stop, Some(Cause::EmergencyStop));
    moving(&mut guard, &firmware, &mut reset);
    let clears = firmware.log().clears;
    // The guard is killed while the arm moves: the arm's own watchdog holds it, and the next start is stopped.
    assert!(rustix_kill(&guard), "killed");
    assert!(firmware.wait(LIMIT, |log| log.watchdog == 1), "the arm's watchdog");
    assert!(drive(&mut guard, &mut Vec::new(), || request(reset), |_| false).is_none(), "the program sees the end");
    drop(guard);
    let mut guard = start(&firmware, &folder).expect("started");
    let status = drive(&mut guard, &mut Vec::new(), || request(0), |_| true).expect("it runs");
    assert_eq!(status.stop, Some(Cause::Interrupted));
    assert_eq!(firmware.log().clears, clears, "the start does not clear the arm's stop");
    moving(&mut guard, &firmware, &mut 0);
}

/// Kills the guard's process.
fn rustix_kill(guard: &Guard) -> bool {
    signal(guard, rustix::process::Signal::KILL)
}

/// Sends the guard's process a signal.
fn signal(guard: &Guard, signal: rustix::process::Signal) -> bool {
    let id = i32::try_from(guard.process_id()).ok().and_then(rustix::process::Pid::from_raw);
    let is_sent = id.is_some_and(|id| rustix::process::kill_process(id, signal).is_ok());
    // It takes effect a moment later.
    let start = Instant::now();
    while signal == rustix::process::Signal::STOP && start.elapsed() < LIMIT {
        let line = std::fs::read_to_string(format!("/proc/{}/stat", guard.process_id())).unwrap_or_default();
        if line.contains(") T ") {
            break;
        }
        std::thread::yield_now();
    }
    is_sent
}

#[test]
fn a_release_that_cannot_be_recorded_does_not_happen() {
    let folder = Folder::new("norecord");
    let firmware = Firmware::plug_in("CAM6-6", patient()).expect("an arm");
    // A folder in place of the temporary file: every write fails, also for an administrator.
    std::fs::create_dir_all(folder.0.join("CAM6-6.new")).expect("made");
    let mut guard = start(&firmware, &folder).expect("started");
    drive(&mut guard, &mut Vec::new(), || request(0), |_| true);
    let status = drive(&mut guard, &mut Vec::new(), || request(1), |s| s.stop != Some(Cause::AwaitsOperator));
    assert_eq!(status.expect("it answers").stop, Some(Cause::CannotRecord));
    assert_eq!(firmware.angles(), JointVector::zeros());
}

#[test]
fn a_second_program_and_older_firmware_are_refused() {
    let folder = Folder::new("refused");
    let firmware = Firmware::plug_in("CAM6-7", patient()).expect("an arm");
    let _first = start(&firmware, &folder).expect("started");
    let error = start(&firmware, &folder).err().map(|error| error.to_string()).unwrap_or_default();
    assert!(error.contains("another program drives this arm"), "{error}");
    // The same device under another name, as in /dev/serial/by-id.
    let link = folder.0.join("by-id");
    std::os::unix::fs::symlink(firmware.path(), &link).expect("linked");
    let other_path = Connection { path: link, ..connection(&firmware) };
    let error = Guard::start(&other_path, Path::new(""), Some(&folder.0)).err().map(|error| error.to_string());
    assert!(error.as_ref().is_some_and(|words| words.contains("another program drives this arm")), "{error:?}");
    let other = Firmware::plug_in("CAM6-7", patient()).expect("an arm");
    let error = start(&other, &folder).err().map(|error| error.to_string()).unwrap_or_default();
    assert!(error.contains("another program drives the arm CAM6-7"), "{error}");
    let old = Firmware::plug_in("CAM6-8", Behaviour { is_version_1: true, ..patient() }).expect("an arm");
    let error = start(&old, &folder).err().map(|error| error.to_string()).unwrap_or_default();
    assert!(error.contains("speaks version 1") && error.contains("update the arm's firmware"), "{error}");
    let silent = Firmware::plug_in("CAM6-9", Behaviour { is_silent: true, ..patient() }).expect("an arm");
    let error = Guard::start(&connection(&silent), Path::new(""), Some(&folder.0)).err();
    let error = error.map(|error| error.to_string()).unwrap_or_default();
    assert!(error.contains("no arm answered"), "{error}");
    for (path, words) in [("/dev/no_such_line", "cannot be opened"), ("/dev/null", "is not a serial line")] {
        let connection = Connection { path: path.into(), baud: 9600, answer_within: Duration::from_millis(30) };
        let error = Guard::start(&connection, Path::new(""), Some(&folder.0)).err().map(|e| e.to_string());
        assert!(error.as_ref().is_some_and(|e| e.contains(words) && e.contains(path)), "{error:?}");
    }
}

#[test]
fn a_damaged_line_moves_nothing_wrongly() {
    let folder = Folder::new("damaged");
    let firmware = Firmware::plug_in("CAM6-10", patient()).expect("an arm");
    let mut guard = start(&firmware, &folder).expect("started");
    let mut reset = 0;
    moving(&mut guard, &firmware, &mut reset);
    firmware.set(|b| b.damaged_bytes = 0.003);
    let since = Instant::now();
    while since.elapsed() < Duration::from_millis(1500) {
        let status = drive(&mut guard, &mut Vec::new(), || request(reset), |_| true).expect("it runs");
        // Stops for damage are released, as a person would.
        reset += u64::from(status.latched);
        std::thread::sleep(Duration::from_millis(8));
    }
    let log = firmware.log();
    assert!(log.damaged > 3, "{} damaged of {}", log.damaged, log.lines);
    for two in log.set_points.windows(2) {
        let seconds = (two[1].0 - two[0].0).as_secs_f64();
        let step = (two[1].1 - two[0].1).amax();
        assert!(step <= 0.4 * (seconds + 0.3), "a step of {step} rad");
        assert!((0..5).all(|k| two[1].1[k].abs() < 1e-4), "only the last joint was asked to move");
    }
}
