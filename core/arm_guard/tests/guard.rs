//! The guard's process against a simulated arm on a pseudo-terminal: it moves only when a person released it, every fault stops it, and stops survive.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use panoscope_arm_core::interlock::{Event, Evidence, Settings};
use panoscope_arm_core::{Cause, JointVector};
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

fn start(firmware: &Firmware, folder: &Folder) -> Result<Guard, GuardError> {
    Guard::start(&connection(firmware), Path::new(""), Some(&folder.0))
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

/// Sends `each` every 10 ms until `done`. Returns the last state, `None` after the time limit or when the guard has ended.
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
    // The guard is killed while the arm moves: the arm's own watchdog holds it, and the next start is stopped.
    let process = rustix_kill(&guard);
    assert!(process, "killed");
    assert!(firmware.wait(LIMIT, |log| log.watchdog == 1), "the arm's watchdog");
    assert!(drive(&mut guard, &mut Vec::new(), || request(reset), |_| false).is_none(), "the program sees the end");
    drop(guard);
    let mut guard = start(&firmware, &folder).expect("started");
    let status = drive(&mut guard, &mut Vec::new(), || request(0), |_| true).expect("it runs");
    assert_eq!(status.stop, Some(Cause::Interrupted));
    assert_eq!(firmware.log().clears, 2, "the start does not clear the arm's stop");
    moving(&mut guard, &firmware, &mut 0);
}

/// Kills the guard's process.
fn rustix_kill(guard: &Guard) -> bool {
    let id = i32::try_from(guard.process_id()).ok().and_then(rustix::process::Pid::from_raw);
    id.is_some_and(|id| rustix::process::kill_process(id, rustix::process::Signal::KILL).is_ok())
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
    let other = Firmware::plug_in("CAM6-7", patient()).expect("an arm");
    let error = start(&other, &folder).err().map(|error| error.to_string()).unwrap_or_default();
    assert!(error.contains("another program drives the arm CAM6-7"), "{error}");
    let old = Firmware::plug_in("CAM6-8", Behaviour { is_version_1: true, ..patient() }).expect("an arm");
    let error = start(&old, &folder).err().map(|error| error.to_string()).unwrap_or_default();
    assert!(error.contains("speaks version 1") && error.contains("update the arm's firmware"), "{error}");
    let silent = Firmware::plug_in("CAM6-9", Behaviour { is_silent: true, ..patient() }).expect("an arm");
    let error = start(&silent, &folder).err().map(|error| error.to_string()).unwrap_or_default();
    assert!(error.contains("no arm answered"), "{error}");
    for (path, words) in [("/dev/no_such_line", "cannot be opened"), ("/dev/null", "is no serial line")] {
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
