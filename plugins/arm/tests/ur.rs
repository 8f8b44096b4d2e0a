//! `arm_ur` with its guard against a simulated Universal Robots controller: it moves after a reset, reports stops by their names, and refuses to start
//! without a description of the robot.

use std::time::{Duration, Instant};

use panoscope_arm::ur::ArmUr;
use panoscope_arm_core::{Cause, JointVector};
use panoscope_arm_guard::ur::PROGRAM;
use panoscope_firmware::ur::{UrBehaviour, UrSimulator, with_silent_s};
use panoscope_node::abi::{Joints, MAX_JOINTS, Tip};
use panoscope_node::harness::{Harness, HarnessError, Level};

const URDF: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../core/robot/arm/description/panoscope_arm6.urdf");

/// Sets one folder of latches for all tests here; each arm has its own serial number.
fn with_latches() {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        let folder = std::env::temp_dir().join(format!("panoscope-arm-ur-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        // SAFETY: `Once` runs this before any test of this process reads the environment or starts a guard.
        unsafe { std::env::set_var(panoscope_arm_guard::latch::FOLDER_VARIABLE, &folder) };
    });
}

fn home() -> JointVector {
    JointVector::from([0.0, -90.0, 90.0, -90.0, -90.0, 0.0]).map(f64::to_radians)
}

fn plug_in(serial: &str) -> UrSimulator {
    with_latches();
    // A loaded machine may hold the guard up: only a long silence is taken for its death here.
    let program = with_silent_s(PROGRAM, 0.4).expect("the program's constant");
    UrSimulator::plug_in(serial, &program, home(), UrBehaviour::default()).expect("a simulated robot")
}

fn params(robot: &UrSimulator, more: &str) -> String {
    let (rtde, dashboard) = robot.ports();
    format!(
        "params = {{ host = \"127.0.0.1\", port = {rtde}, dashboard_port = {dashboard}, arm = \"{URDF}\", \
         home_deg = \"0, -90, 90, -90, -90, 0\", enabled = true, answer_ms = 250{more} }}"
    )
}

/// Ticks every 10 ms until `done` accepts the node's text. Returns false after the time limit.
fn drive(
    node: &mut Harness<ArmUr>,
    ask: bool,
    seconds: f64,
    mut done: impl FnMut(&str) -> bool,
) -> Result<bool, HarnessError> {
    let tip = Tip {
        u_px: 400.0,
        v_px: 240.0,
        xyz_mm: [7.5, 0.0, 65.0],
        score: 0.9,
        class_index: 0,
        xyz_valid: 1,
        track_id: 1,
    };
    let mut velocity_rad_s = [0.0; MAX_JOINTS];
    velocity_rad_s[5] = 0.1;
    let demand = Joints { position_rad: [0.0; MAX_JOINTS], velocity_rad_s, count: 6, reserved: 0 };
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < seconds {
        if ask {
            node.input_value("tip", tip).input_value("joints", demand);
        }
        if done(node.process()?.text("text")?) {
            return Ok(true);
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(false)
}

/// Releases the arm until it moves. On a loaded machine a late answer latches the arm; that latch is released here.
fn moving(robot: &UrSimulator, node: &mut Harness<ArmUr>, reset: &mut u64) -> Result<(), HarnessError> {
    for _ in 0..8 {
        let before = robot.angles()[5];
        drive(node, false, 0.1, |_| true)?;
        *reset += 1;
        node.set_params(&params(robot, &format!(", reset = {reset}")))?;
        let mut ticks = 0;
        drive(node, true, 6.0, |words| {
            ticks += 1;
            let follows = words == "arm follows" && (robot.angles()[5] - before).abs() > 0.01;
            follows || (ticks > 120 && words.contains("STOPPED"))
        })?;
        if (robot.angles()[5] - before).abs() > 0.01 {
            return Ok(());
        }
    }
    panic!("the arm never moved: {:?}", node.logs());
}

#[test]
fn a_robot_moves_after_a_reset_and_reports_its_stops() -> Result<(), HarnessError> {
    let robot = plug_in("20201000001");
    let mut node = Harness::<ArmUr>::from_toml(&params(&robot, ", reset = 5"))?;
    assert!(!drive(&mut node, true, 0.4, |words| words == "arm follows")?, "nobody has released it");
    assert_eq!(robot.angles(), home());
    moving(&robot, &mut node, &mut 5)?;
    assert!((0..5).all(|k| (robot.angles()[k] - home()[k]).abs() < 1e-4));
    robot.set(|behaviour| behaviour.is_protective = true);
    assert!(drive(&mut node, true, 6.0, |words| words.contains("STOPPED"))?, "{:?}", node.logs());
    let causes = [Cause::ProtectiveStop, Cause::Stalled];
    let is_logged = |cause: &Cause| {
        node.logs().iter().any(|line| line.level == Level::Warn && line.message.contains(cause.words()))
    };
    assert!(causes.iter().any(is_logged), "{:?}", node.logs());
    Ok(())
}

#[test]
fn a_robot_without_a_description_is_refused() {
    with_latches();
    let robot = plug_in("20201000002");
    let refused = |text: String| Harness::<ArmUr>::from_toml(&text).err().map(|e| e.to_string()).unwrap_or_default();
    let none = params(&robot, "").replace(URDF, "");
    assert!(
        refused(none.clone()).contains("no description") || refused(none.clone()).contains("not a URDF"),
        "{}",
        refused(none)
    );
    let short = params(&robot, "").replace("0, -90, 90", "0, -90");
    assert!(refused(short.clone()).contains("is not 6 angles"), "{}", refused(short));
    let far = params(&robot, "").replace("-90, 90", "-90, 900");
    assert!(refused(far.clone()).contains("is not 6 angles"), "{}", refused(far));
    robot.set(|behaviour| behaviour.is_program_stopped = true);
    let stopped = refused(params(&robot, ""));
    assert!(stopped.contains("the arm's program does not run on the robot"), "{stopped}");
}
