//! The guard's process against a simulated Universal Robots controller: it moves only when a person released it, every
//! fault stops it, the robot's own deadman holds it when the guard is gone, and stops survive.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use panoscope_arm_core::interlock::{Evidence, Settings};
use panoscope_arm_core::{Cause, JointVector};
use panoscope_arm_guard::client::{Guard, GuardError};
use panoscope_arm_guard::clock;
use panoscope_arm_guard::message::{Request, Status};
use panoscope_arm_guard::ur::{PROGRAM, UrConnection};
use panoscope_firmware::ur::{Braking, UrBehaviour, UrLog, UrSimulator, with_silent_s};
use rustix::process::{Pid, Signal, kill_process};

/// A loaded machine may hold every thread up.
const LIMIT: Duration = Duration::from_secs(8);
const URDF: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../arm/description/panoscope_arm6.urdf");
/// The robot's angles where those of the arm's file are 0.
const HOME: [f64; 6] = [0.3, -1.2, 1.5, -1.9, -1.57, 0.4];
/// Time limit of the true deadman, ms.
const DEADMAN_MS: f64 = 30.0;
/// Length of a control cycle, ms.
const CYCLE_MS: f64 = 2.0;

/// A folder for latches that is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("panoscope-ur-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        Self(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn home() -> JointVector {
    JointVector::from(HOME)
}

/// An arm with the true deadman.
fn strict(serial: &str) -> UrSimulator {
    UrSimulator::plug_in(serial, PROGRAM, home(), UrBehaviour::default()).expect("a simulated robot")
}

/// An arm whose deadman tolerates a loaded machine.
fn patient_with(serial: &str, behaviour: UrBehaviour) -> UrSimulator {
    let program = with_silent_s(PROGRAM, 0.4).expect("the program's constant");
    UrSimulator::plug_in(serial, &program, home(), behaviour).expect("a simulated robot")
}

fn patient(serial: &str) -> UrSimulator {
    patient_with(serial, UrBehaviour::default())
}

fn connection(robot: &UrSimulator) -> UrConnection {
    let (rtde_port, dashboard_port) = robot.ports();
    // Late answers of a loaded machine are no fault of the guard.
    let answer_within = Duration::from_millis(240);
    UrConnection { host: "127.0.0.1".to_owned(), rtde_port, dashboard_port, home: home(), answer_within }
}

fn start(robot: &UrSimulator, folder: &Folder) -> Result<Guard, GuardError> {
    Guard::start(&connection(robot), Path::new(URDF), Some(&folder.0))
}

fn refusal(robot: &UrSimulator, folder: &Folder) -> String {
    start(robot, folder).err().map(|error| error.to_string()).unwrap_or_default()
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
    mut each: impl FnMut() -> Request,
    mut done: impl FnMut(&Status) -> bool,
) -> Option<Status> {
    let start = Instant::now();
    while start.elapsed() < LIMIT {
        guard.request(&each());
        let status = guard.status(|_| ())?;
        if done(&status) {
            return Some(status);
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    None
}

/// Releases the arm and gets it moving. On a loaded machine a late answer may latch: then again.
fn moving(guard: &mut Guard, robot: &UrSimulator, reset: &mut u64) {
    let mut stops = Vec::new();
    for _ in 0..8 {
        let from = robot.angles()[5];
        // The first request sets the number that later ones are compared with.
        let known = drive(guard, || request(*reset), |_| true).expect("it runs");
        *reset += 1;
        // A release takes up to 0.85 s.
        let patience_ns = known.at_ns + 1_200_000_000;
        let moved = drive(
            guard,
            || request(*reset),
            |status| {
                let has_moved = status.stop.is_none() && (robot.angles()[5] - from).abs() > 0.01;
                has_moved || (status.latched && status.at_ns > patience_ns)
            },
        );
        if moved.is_some_and(|status| status.stop.is_none()) {
            return;
        }
        stops.push(moved.and_then(|status| status.stop));
    }
    panic!("the arm never moved: {stops:?} {:?}", robot.log().program_error);
}

fn signal(guard: &Guard, signal: Signal) {
    let id = i32::try_from(guard.process_id()).ok().and_then(Pid::from_raw).expect("a process");
    kill_process(id, signal).expect("signalled");
}

/// The robot moved in its last joint only, and not faster than its limits.
fn assert_within_limits(log: &UrLog) {
    for (index, (at_s, angles)) in log.angles.iter().enumerate() {
        let off = angles - home();
        assert!((0..5).all(|k| off[k].abs() < 1e-4), "only the last joint was asked to move: {off:?}");
        // Over at least 60 ms: targets that a loaded machine held up arrive together.
        let before = log.angles[..index].iter().rev().find(|(then_s, _)| at_s - then_s >= 0.06);
        if let Some((then_s, then)) = before {
            let rad_s = (angles - then).amax() / (at_s - then_s);
            assert!(rad_s <= 0.4 * 1.25 + 0.02, "{rad_s} rad/s at {at_s} s");
        }
    }
}

#[test]
fn a_robot_waits_for_a_person_and_follows_within_its_limits() {
    for software in [[5, 12, 4, 0], [3, 15, 8, 0]] {
        let folder = Folder::new(&format!("follows-{}", software[0]));
        let robot = patient_with("20195500001", UrBehaviour { software, ..UrBehaviour::default() });
        let mut guard = start(&robot, &folder).expect("started");
        assert_eq!((guard.serial(), guard.watchdog_ms()), ("UR-20195500001", 400));
        // However long requests arrive, and whatever number `reset` has.
        let since = Instant::now();
        let status =
            drive(&mut guard, || request(41), |_| since.elapsed() > Duration::from_millis(300)).expect("it runs");
        assert_eq!((status.stop, status.latched), (Some(Cause::AwaitsOperator), true));
        assert!(status.encoders.amax() < 1e-3, "the arm's angles are the robot's from its home");
        assert_eq!((robot.angles(), robot.log().releases), (home(), 0));
        let mut reset = 41;
        moving(&mut guard, &robot, &mut reset);
        let since = Instant::now();
        drive(&mut guard, || request(reset), |_| since.elapsed() > Duration::from_millis(600)).expect("it runs");
        let log = robot.log();
        assert!(log.targets.len() > 20 && log.packages > 50, "{} targets", log.targets.len());
        assert_within_limits(&log);
        drop(guard);
        // Left at rest: the next start waits again.
        let mut guard = start(&robot, &folder).expect("started");
        assert!(drive(&mut guard, || request(0), |_| true).expect("it runs").latched);
    }
}

/// Gets a robot with the true deadman moving, does `harm` to the guard, and returns how the arm then braked. On a
/// loaded machine the deadman may come first: then once more.
fn braking_after(name: &str, harm: impl Fn(&Guard)) -> (Folder, UrSimulator, Guard, u64, Braking) {
    for attempt in 0..12 {
        let folder = Folder::new(&format!("{name}-{attempt}"));
        let robot = strict("20195500002");
        let mut guard = start(&robot, &folder).expect("started");
        assert_eq!(guard.watchdog_ms(), 30);
        let (mut reset, mut has_moved) = (0, false);
        for _ in 0..10 {
            drive(&mut guard, || request(reset), |_| true).expect("it runs");
            reset += 1;
            let since = Instant::now();
            let moved = drive(
                &mut guard,
                || request(reset),
                |status| {
                    let is_fast = status.stop.is_none() && status.set_point.1[5] > 0.09;
                    is_fast || (status.latched && since.elapsed() > Duration::from_secs(1))
                },
            );
            has_moved = moved.is_some_and(|status| status.stop.is_none());
            if has_moved {
                break;
            }
        }
        let before = robot.log().braking.len();
        if !has_moved || robot.log().targets.is_empty() {
            continue;
        }
        harm(&guard);
        assert!(robot.wait(LIMIT, |log| log.braking.len() > before), "the robot's own deadman");
        let braking = robot.log().braking[before];
        if robot.log().braking.len() == before + 1 && braking.reason == 2 {
            return (folder, robot, guard, reset, braking);
        }
    }
    panic!("the arm never moved long enough on this machine");
}

/// By the robot's own clock, and by the distance that it moved.
fn assert_braked_in_time(robot: &UrSimulator, braking: Braking) {
    let cycles = braking.cycle - braking.package_cycle;
    let ms = cycles as f64 * CYCLE_MS;
    assert!(ms <= DEADMAN_MS, "it braked {ms} ms after the last package");
    assert_eq!(robot.log().braking.last(), Some(&braking), "it did not move again");
    // Comes to rest, and stays.
    let last = robot.log().cycle + 100;
    assert!(robot.wait(LIMIT, |log| log.cycle > last));
    let at = robot.angles();
    assert!(robot.wait(LIMIT, |log| log.cycle > last + 100));
    assert_eq!(robot.angles(), at, "it stands");
    let target = robot.log().targets.last().map(|(_, target)| *target).expect("targets");
    assert!((at - target).amax() < 0.03, "{:?}", at - target);
    assert_within_limits(&robot.log());
}

#[test]
fn the_robot_stops_by_itself_when_the_guard_is_killed() {
    let (folder, robot, guard, _, braking) = braking_after("killed", |guard| signal(guard, Signal::KILL));
    assert_braked_in_time(&robot, braking);
    let releases = robot.log().releases;
    drop(guard);
    // The stop survives, on both sides.
    let mut guard = start(&robot, &folder).expect("started");
    let status = drive(&mut guard, || request(0), |_| true).expect("it runs");
    assert_eq!((status.stop, status.latched), (Some(Cause::Interrupted), true));
    let since = Instant::now();
    drive(&mut guard, || request(0), |_| since.elapsed() > Duration::from_millis(300)).expect("it runs");
    assert_eq!(robot.log().releases, releases, "the start clears nothing");
    assert_eq!(robot.log().braking.last(), Some(&braking), "nothing moved");
}

#[test]
fn the_robot_stops_by_itself_when_the_guard_is_stopped() {
    let (_folder, robot, mut guard, reset, braking) = braking_after("stopped", |guard| signal(guard, Signal::STOP));
    assert_braked_in_time(&robot, braking);
    signal(&guard, Signal::CONT);
    // It goes on where it was, and learns that the arm has stopped: nothing moves without a person.
    drive(&mut guard, || request(reset), |status| status.latched).expect("it stops");
    let at = robot.angles();
    let since = Instant::now();
    let status =
        drive(&mut guard, || request(reset), |_| since.elapsed() > Duration::from_millis(600)).expect("it runs");
    assert!(status.latched, "{status:?}");
    assert_eq!(robot.angles(), at);
}

#[test]
fn a_program_that_ends_brakes_the_robot() {
    let folder = Folder::new("ends");
    let robot = patient("20195500003");
    let mut guard = start(&robot, &folder).expect("started");
    moving(&mut guard, &robot, &mut 0);
    // The end of the connection is what a killed program leaves.
    drop(guard);
    let at = robot.angles();
    let last = robot.log().cycle + 300;
    assert!(robot.wait(LIMIT, |log| log.cycle > last));
    assert!((robot.angles() - at).amax() < 0.02);
    assert_within_limits(&robot.log());
    let mut guard = start(&robot, &folder).expect("started");
    let status = drive(&mut guard, || request(0), |_| true).expect("it runs");
    assert_eq!((status.stop, status.latched), (Some(Cause::HostGone), true));
}

#[test]
fn an_emergency_stop_survives_a_restart() {
    let folder = Folder::new("survives");
    let robot = patient("20195500004");
    let mut guard = start(&robot, &folder).expect("started");
    let mut reset = 0;
    moving(&mut guard, &robot, &mut reset);
    let stopped = || Request { emergency_stop: true, ..request(reset) };
    let status = drive(&mut guard, stopped, |s| s.latched && s.set_point.1.amax() == 0.0);
    assert_eq!(status.expect("it stops").stop, Some(Cause::EmergencyStop));
    drop(guard);
    let mut guard = start(&robot, &folder).expect("started");
    let status = drive(&mut guard, || request(reset), |_| true);
    assert_eq!(status.expect("it runs").stop, Some(Cause::EmergencyStop));
    moving(&mut guard, &robot, &mut reset);
}

/// Whether a stop latches for another reason than that nobody has released the arm.
fn stays(cause: Cause) -> bool {
    cause.latches() && cause != Cause::AwaitsOperator
}

#[test]
fn every_fault_of_robot_and_network_stops_the_arm_with_its_name() {
    type Fault = fn(&mut UrBehaviour);
    let faults: [(&str, Fault, Cause); 14] = [
        ("protective", |b| b.is_protective = true, Cause::ProtectiveStop),
        ("safeguard", |b| b.is_safeguard = true, Cause::SafeguardStop),
        ("emergency", |b| b.is_emergency = true, Cause::HardwareStop),
        ("fault", |b| b.has_fault = true, Cause::HardwareFault),
        ("off", |b| b.is_off = true, Cause::RobotOff),
        ("program", |b| b.is_program_stopped = true, Cause::ProgramNotRunning),
        ("clock", |b| b.clock_rate = 0.5, Cause::DeviceClock),
        ("silent", |b| b.is_silent = true, Cause::Stalled),
        ("late", |b| b.delay = Duration::from_millis(400), Cause::Stalled),
        ("garbage", |b| b.is_garbage = true, Cause::Garbage),
        ("echo", |b| b.has_wrong_echo = true, Cause::Garbage),
        ("unplugged", |b| b.is_unplugged = true, Cause::Unplugged),
        ("stuck", |b| b.is_stuck = true, Cause::NotFollowing),
        ("runaway", |b| b.runaway_rad_s = 0.9, Cause::MeasuredSpeed),
    ];
    for (name, fault, cause) in faults {
        let folder = Folder::new(name);
        let mut seen = Vec::new();
        // A late answer of a loaded machine may come first: then once more.
        let found = (0..4).any(|_| {
            let robot = patient("20195500005");
            let mut guard = start(&robot, &folder).expect("started");
            let mut reset = 0;
            moving(&mut guard, &robot, &mut reset);
            robot.set(fault);
            let status = drive(&mut guard, || request(reset), |s| s.stop.is_some_and(stays));
            let stop = status.unwrap_or_else(|| panic!("{name}: {:?}", guard.last_status())).stop;
            // Latched: to ask again does not help.
            let since = Instant::now();
            let later = drive(&mut guard, || request(reset), |_| since.elapsed().as_millis() > 300);
            assert_eq!(later.expect("it runs").stop, stop, "{name} does not latch");
            seen.push(stop);
            stop == Some(cause)
        });
        assert!(found, "{name}: {seen:?} and not {cause:?}");
    }
}

#[test]
fn a_reset_clears_no_stop_of_the_robots_safety_system() {
    let folder = Folder::new("protective-stop");
    let robot = patient("20195500006");
    let mut guard = start(&robot, &folder).expect("started");
    let mut reset = 0;
    moving(&mut guard, &robot, &mut reset);
    robot.set(|b| b.is_protective = true);
    let status = drive(&mut guard, || request(reset), |s| s.stop.is_some_and(stays));
    assert!(status.is_some_and(|status| status.latched));
    let targets = robot.log().targets.len();
    for _ in 0..3 {
        reset += 1;
        let since = Instant::now();
        let status =
            drive(&mut guard, || request(reset), |_| since.elapsed() > Duration::from_millis(500)).expect("it runs");
        assert!(status.latched, "a reset does not help while the robot is stopped");
        assert_eq!(status.stop, Some(Cause::ProtectiveStop), "the newest reason counts");
    }
    // A person acknowledges it at the pendant and lets the program go on.
    robot.set(|b| b.is_protective = false);
    let since = Instant::now();
    let status =
        drive(&mut guard, || request(reset), |_| since.elapsed() > Duration::from_millis(500)).expect("it runs");
    assert!(status.latched, "the guard waits for its own reset");
    assert!(robot.log().targets.len() <= targets + 1, "no new target");
    moving(&mut guard, &robot, &mut reset);
}

#[test]
fn a_lost_connection_is_opened_again_by_a_reset_only() {
    let folder = Folder::new("reopened");
    let robot = patient("20195500007");
    let mut guard = start(&robot, &folder).expect("started");
    let mut reset = 0;
    moving(&mut guard, &robot, &mut reset);
    robot.set(|b| b.is_unplugged = true);
    let status = drive(&mut guard, || request(reset), |s| s.stop.is_some_and(stays)).expect("it runs");
    assert!(status.latched);
    robot.set(|b| b.is_unplugged = false);
    let since = Instant::now();
    let status =
        drive(&mut guard, || request(reset), |_| since.elapsed() > Duration::from_millis(400)).expect("it runs");
    assert!(status.latched);
    moving(&mut guard, &robot, &mut reset);
    assert_within_limits(&robot.log());
}

#[test]
fn a_program_that_was_started_again_waits_for_a_reset() {
    let folder = Folder::new("restarted");
    let robot = patient("20195500008");
    let mut guard = start(&robot, &folder).expect("started");
    let mut reset = 0;
    moving(&mut guard, &robot, &mut reset);
    signal(&guard, Signal::STOP);
    // The registers keep a command to follow. The program is started again meanwhile.
    robot.set(|b| b.is_program_stopped = true);
    let cycle = robot.log().cycle;
    assert!(robot.wait(LIMIT, |log| log.cycle > cycle + 100));
    let at = robot.angles();
    let starts = robot.log().starts;
    robot.set(|b| b.is_program_stopped = false);
    assert!(robot.wait(LIMIT, |log| log.starts > starts));
    let cycle = robot.log().cycle;
    assert!(robot.wait(LIMIT, |log| log.cycle > cycle + 200));
    signal(&guard, Signal::CONT);
    let status = drive(&mut guard, || request(reset), |s| s.stop.is_some_and(stays)).expect("it stops");
    assert!(status.latched);
    let since = Instant::now();
    drive(&mut guard, || request(reset), |_| since.elapsed() > Duration::from_millis(300)).expect("it runs");
    assert_eq!(robot.angles(), at);
    moving(&mut guard, &robot, &mut reset);
}

#[test]
fn a_controller_that_is_not_suitable_is_refused_with_the_reason() {
    type Fault = fn(&mut UrBehaviour);
    let faults: [(Fault, &str); 13] = [
        (|b| b.rtde_version = 1, "does not speak version 2 of RTDE"),
        (|b| b.software = [3, 5, 0, 0], "has software 3.5.0"),
        (|b| b.software = [10, 7, 0, 0], "PolyScope X is not supported"),
        (|b| b.unknown_field = "safety_status_bits", "the controller has no `safety_status_bits`"),
        (|b| b.unknown_field = "input_int_register_26", "the controller has no `input_int_register_26`"),
        (|b| b.other_type = "actual_q", "`actual_q` is VECTOR6D in RTDE, but UINT64 here"),
        (|b| b.refuses_start = true, "does not start RTDE"),
        (|b| b.has_no_serial = true, "instead of a serial number"),
        (|b| b.is_silent = true, "sends no data"),
        (|b| b.is_garbage = true, "is malformed"),
        (
            |b| b.is_program_stopped = true,
            "the arm's program does not run on the robot; make the robot ready at its pendant",
        ),
        (|b| b.is_emergency = true, "the hardware stop is pressed; make the robot ready"),
        (|b| b.is_off = true, "the robot is switched off or its brakes are on"),
    ];
    let folder = Folder::new("unsuitable");
    for (fault, words) in faults {
        let robot = patient("20195500009");
        robot.set(fault);
        let error = refusal(&robot, &folder);
        assert!(error.contains(words), "{words}: {error}");
        let (rtde, dashboard) = robot.ports();
        assert!(
            error.contains(&format!("127.0.0.1:{rtde}")) || error.contains(&format!("127.0.0.1:{dashboard}")),
            "{error}"
        );
    }
    for (program, words) in [
        (PROGRAM.replace("VERSION = 1", "VERSION = 2"), "has version 2, this program needs 1"),
        ("def other():\n  while (True):\n    sync()\n  end\nend\n".to_owned(), "is not panoscope_arm.script"),
    ] {
        let robot = UrSimulator::plug_in("20195500010", &program, home(), UrBehaviour::default()).expect("a robot");
        let error = refusal(&robot, &folder);
        assert!(error.contains(words), "{words}: {error}");
    }
    let robot = patient("20195500011");
    let nobody = UrConnection { rtde_port: 1, ..connection(&robot) };
    let error = Guard::start(&nobody, Path::new(URDF), Some(&folder.0)).err().map(|error| error.to_string());
    assert!(error.as_ref().is_some_and(|error| error.contains("127.0.0.1:1 cannot be reached")), "{error:?}");
}

#[test]
fn a_second_master_is_refused() {
    let (folder, other) = (Folder::new("first"), Folder::new("second"));
    let robot = patient("20195500012");
    let mut first = start(&robot, &folder).expect("started");
    // On another machine, as it were: it knows nothing of the first one's locks.
    let error = refusal(&robot, &other);
    assert!(error.contains("another program drives this arm; end it first"), "{error}");
    // The same arm under another address.
    let double = patient("20195500012");
    let error = refusal(&double, &folder);
    assert!(error.contains("another program drives the arm UR-20195500012"), "{error}");
    moving(&mut first, &robot, &mut 0);
    drop(first);
    start(&robot, &other).map(|_| ()).expect("the registers are free again");
}

#[test]
fn packages_in_pieces_are_packages() {
    let folder = Folder::new("pieces");
    let robot = patient_with("20195500013", UrBehaviour { is_cut: true, ..UrBehaviour::default() });
    let mut guard = start(&robot, &folder).expect("started");
    moving(&mut guard, &robot, &mut 0);
    assert_within_limits(&robot.log());
}

#[test]
fn damaged_packages_never_move_the_robot_wrongly() {
    let folder = Folder::new("damaged");
    let robot = patient("20195500014");
    let mut guard = start(&robot, &folder).expect("started");
    let mut reset = 0;
    moving(&mut guard, &robot, &mut reset);
    let (since, mut stops) = (Instant::now(), 0);
    while since.elapsed() < Duration::from_millis(3000) {
        robot.set(|b| b.damaged_bytes = 0.0006);
        let Some(status) = drive(&mut guard, || request(reset), |_| true) else { break };
        // Stops for damage are released, as a person would.
        if status.latched {
            stops += 1;
            reset += 1;
            // What is damaged while a connection is opened is refused, not repaired.
            robot.set(|b| b.damaged_bytes = 0.0);
        }
        std::thread::sleep(Duration::from_millis(8));
    }
    let log = robot.log();
    assert!(stops > 0, "damage is noticed");
    assert_eq!(log.program_error, None);
    assert_within_limits(&log);
    for two in log.targets.windows(2) {
        assert!((0..5).all(|k| (two[1].1[k] - HOME[k]).abs() < 2e-4), "{:?}", two[1]);
        let step = (two[1].1 - two[0].1).amax();
        let seconds = (two[1].0 - two[0].0) as f64 * CYCLE_MS * 1e-3;
        assert!(step <= 0.4 * (seconds + 0.3), "a step of {step} rad in {seconds} s");
    }
}
