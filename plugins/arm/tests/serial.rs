//! The serial driver with its guard against a simulated arm on a pseudo-terminal: it moves after a reset, reports every stop, and outlives its guard.

use std::time::{Duration, Instant};

use panoscope_arm::serial::ArmSerial;
use panoscope_arm_core::{Cause, JointVector};
use panoscope_firmware::{Behaviour, Firmware};
use panoscope_node::abi::{Joints, MAX_JOINTS, Tip};
use panoscope_node::harness::{Harness, HarnessError, Level};

/// Sets one folder of latches for all tests here; each arm has its own serial number.
fn with_latches() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        let folder = std::env::temp_dir().join(format!("panoscope-arm-serial-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        // SAFETY: `Once` runs this before any test of this process reads the environment or starts a guard.
        unsafe { std::env::set_var(panoscope_arm_guard::latch::FOLDER_VARIABLE, &folder) };
    });
}

fn plug_in(serial: &str) -> Firmware {
    with_latches();
    // A loaded machine may hold the guard up: only a long silence is taken for its death here.
    let behaviour = Behaviour { watchdog_ms: 400, ..Behaviour::default() };
    Firmware::plug_in(serial, behaviour).expect("a pseudo-terminal")
}

fn params(path: &str, more: &str) -> String {
    format!("params = {{ port = \"{path}\", baud = 115200, enabled = true, answer_ms = 250{more} }}")
}

fn tip() -> Tip {
    Tip { u_px: 400.0, v_px: 240.0, xyz_mm: [7.5, 0.0, 65.0], score: 0.9, class_index: 0, xyz_valid: 1, track_id: 1 }
}

fn demand() -> Joints {
    let mut velocity_rad_s = [0.0; MAX_JOINTS];
    velocity_rad_s[5] = 0.1;
    Joints { position_rad: [0.0; MAX_JOINTS], velocity_rad_s, count: 6, reserved: 0 }
}

/// Ticks every 10 ms until `done` accepts the node's text. Returns false after the time limit.
fn drive(
    node: &mut Harness<ArmSerial>,
    ask: bool,
    seconds: f64,
    mut done: impl FnMut(&str) -> bool,
) -> Result<bool, HarnessError> {
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < seconds {
        if ask {
            node.input_value("tip", tip()).input_value("joints", demand());
        }
        if done(node.process()?.text("text")?) {
            return Ok(true);
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(false)
}

/// Releases the arm until it moves. On a loaded machine a late answer latches the arm; that latch is released here.
fn moving(arm: &Firmware, node: &mut Harness<ArmSerial>, reset: &mut u64) -> Result<(), HarnessError> {
    for _ in 0..8 {
        let before = arm.angles()[5];
        drive(node, false, 0.1, |_| true)?;
        *reset += 1;
        node.set_params(&params(arm.path(), &format!(", reset = {reset}")))?;
        let mut ticks = 0;
        let moved = drive(node, true, 6.0, |words| {
            ticks += 1;
            let follows = words == "arm follows" && (arm.angles()[5] - before).abs() > 0.01;
            follows || (ticks > 120 && words.contains("STOPPED"))
        })?;
        if moved && (arm.angles()[5] - before).abs() > 0.01 {
            return Ok(());
        }
    }
    panic!("the arm never moved: {:?}", node.logs());
}

fn is_logged(node: &Harness<ArmSerial>, words: &str) -> bool {
    node.logs().iter().any(|line| line.level == Level::Warn && line.message.contains(words))
}

#[test]
fn an_enabled_arm_waits_for_a_reset_and_stops_when_the_graph_stalls() -> Result<(), HarnessError> {
    let arm = plug_in("NODE-1");
    let mut node = Harness::<ArmSerial>::from_toml(&params(arm.path(), ", reset = 5"))?;
    assert!(!drive(&mut node, true, 0.4, |words| words == "arm follows")?, "nobody has released it");
    assert_eq!(arm.angles(), JointVector::zeros());
    moving(&arm, &mut node, &mut 5)?;
    // The graph does not call any more.
    std::thread::sleep(Duration::from_millis(700));
    let count = arm.log().set_points.len();
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(arm.log().set_points.len(), count, "no set-point any more");
    drive(&mut node, false, 1.0, |_| true)?;
    let causes = [Cause::LoopStalled, Cause::OldTip, Cause::Stalled];
    assert!(causes.iter().any(|cause| is_logged(&node, cause.words())), "{:?}", node.logs());
    Ok(())
}

#[test]
fn stops_are_reported_latch_and_outlive_the_node() -> Result<(), HarnessError> {
    let arm = plug_in("NODE-2");
    let mut node = Harness::<ArmSerial>::from_toml(&params(arm.path(), ""))?;
    let mut reset = 0;
    moving(&arm, &mut node, &mut reset)?;
    node.set_params(&params(arm.path(), &format!(", reset = {reset}, emergency_stop = true")))?;
    assert!(drive(&mut node, true, 6.0, |words| words.contains("emergency stop"))?);
    drop(node);
    // As after a fault or an edit of the graph.
    let mut node = Harness::<ArmSerial>::from_toml(&params(arm.path(), ""))?;
    assert!(drive(&mut node, true, 6.0, |words| words.contains("ARM STOPPED: emergency stop"))?);
    let before = arm.angles();
    drive(&mut node, true, 0.5, |_| false)?;
    // Motors come to rest exponentially.
    assert!((arm.angles() - before).amax() < 1e-3);
    moving(&arm, &mut node, &mut 0)?;
    arm.set(|behaviour| behaviour.is_stuck = true);
    assert!(drive(&mut node, true, 6.0, |words| words.contains("STOPPED"))?, "{:?}", node.logs());
    let causes = [Cause::NotFollowing, Cause::Stalled];
    assert!(causes.iter().any(|cause| is_logged(&node, cause.words())), "{:?}", node.logs());
    Ok(())
}

#[test]
fn a_dead_guard_is_reported_and_started_again_by_a_reset() -> Result<(), HarnessError> {
    let arm = plug_in("NODE-3");
    let mut node = Harness::<ArmSerial>::from_toml(&params(arm.path(), ""))?;
    let mut reset = 0;
    moving(&arm, &mut node, &mut reset)?;
    // The guard of this arm, among those of other tests.
    let is_ours = |id: &i32| {
        let line = std::fs::read(format!("/proc/{id}/cmdline")).unwrap_or_default();
        line.split(|byte| *byte == 0).any(|word| word == arm.path().as_bytes())
    };
    let processes = std::fs::read_dir("/proc").expect("a list of processes");
    let ids = processes.flatten().filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    let own = i32::try_from(std::process::id()).unwrap_or_default();
    let guard = ids.filter(|id| *id != own).find(is_ours).expect("the guard's process");
    let id = rustix::process::Pid::from_raw(guard).expect("a process");
    rustix::process::kill_process(id, rustix::process::Signal::KILL).expect("killed");
    assert!(drive(&mut node, true, 6.0, |words| words.contains(Cause::GuardGone.words()))?, "{:?}", node.logs());
    assert!(arm.wait(Duration::from_secs(6), |log| log.watchdog == 1), "the arm's own watchdog");
    reset += 1;
    node.set_params(&params(arm.path(), &format!(", reset = {reset}")))?;
    assert!(drive(&mut node, true, 6.0, |words| words.contains(Cause::Interrupted.words()))?, "{:?}", node.logs());
    moving(&arm, &mut node, &mut reset)
}

#[test]
fn a_line_without_an_arm_is_refused_with_its_name() {
    let refused = |port: &str| {
        let made = Harness::<ArmSerial>::from_toml(&params(port, ""));
        made.err().map(|error| error.to_string()).unwrap_or_default()
    };
    with_latches();
    assert!(refused("/dev/no_such_line").contains("/dev/no_such_line cannot be opened"));
    assert!(refused("/dev/null").contains("/dev/null is not a serial line"), "{}", refused("/dev/null"));
    let arm = plug_in("NODE-4");
    arm.set(|behaviour| behaviour.is_silent = true);
    assert!(refused(arm.path()).contains("no arm answered"), "{}", refused(arm.path()));
}
