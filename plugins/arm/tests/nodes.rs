//! `arm_pid` and `arm_sim` as nodes: defaults, wiring, stops, replacement.

use panoscope_arm::arm_pid::ArmPid;
use panoscope_arm::arm_sim::ArmSim;
use panoscope_arm_core::rehearsal::shipped_goals;
use panoscope_node::abi::{Joints, LINK_COLUMNS, MAX_JOINTS, Pose, Tip};
use panoscope_node::harness::{Harness, HarnessError, Level};

fn tip(x_mm: f64, score: f64) -> Tip {
    Tip { u_px: 400.0, v_px: 240.0, xyz_mm: [x_mm, 0.0, 65.57], score, class_index: 0, xyz_valid: 1, track_id: 1 }
}

fn still() -> Joints {
    Joints { position_rad: [0.0; MAX_JOINTS], velocity_rad_s: [0.0; MAX_JOINTS], count: 6, reserved: 0 }
}

/// A controller and an arm in a loop, wired as in a graph.
struct Pair {
    control: Harness<ArmPid>,
    arm: Harness<ArmSim>,
    back: Option<(Joints, Joints)>,
    tick: u64,
}

impl Pair {
    fn open(params: &str) -> Result<Self, HarnessError> {
        Ok(Self { control: Harness::from_toml("")?, arm: Harness::from_toml(params)?, back: None, tick: 0 })
    }

    /// Runs one tick. Returns the camera's position and the arm's state as text.
    fn tick(&mut self, tip: Option<Tip>) -> Result<([f64; 3], String), HarnessError> {
        let capture_ns = self.tick as i64 * 33_333_333;
        self.control.at_tick(self.tick, capture_ns);
        self.arm.at_tick(self.tick, capture_ns);
        self.tick += 1;
        if let Some(tip) = tip {
            self.control.input_value("tip", tip);
            self.arm.input_value("tip", tip);
        }
        if let Some((joints, set_point)) = self.back {
            self.control.input_value("joints", joints).input_value("setpoint", set_point);
        }
        let asked = self.control.process()?;
        if !asked.is_empty("joints")? {
            self.arm.input_value("joints", asked.value::<Joints>("joints")?);
        }
        let out = self.arm.process()?;
        self.back = Some((out.value("joints")?, out.value("setpoint")?));
        Ok((out.value::<Pose>("camera_pose")?.a_from_b_mm, out.text("text")?.to_owned()))
    }
}

#[test]
fn defaults_are_the_goals_that_were_tuned() -> Result<(), HarnessError> {
    let node = Harness::<ArmPid>::from_toml("")?;
    let default = |name: &str| {
        let param = node.node_type().params.iter().find(|p| p.name == name).expect(name);
        match param.kind {
            panoscope_graph::ParamKind::Float { default, .. } => default,
            ref other => panic!("{name}: {other:?}"),
        }
    };
    let goals = shipped_goals();
    for (name, value) in [
        ("distance_mm", goals.distance_mm),
        ("picture_p", goals.picture.proportional),
        ("picture_i", goals.picture.integral),
        ("picture_d", goals.picture.derivative),
        ("distance_p", goals.distance.proportional),
        ("distance_i", goals.distance.integral),
        ("distance_d", goals.distance.derivative),
        ("filter_s", goals.picture.filter_s),
        ("feed_forward", goals.feed_forward),
        ("dead_zone_px", goals.picture.dead_zone),
        ("dead_zone_mm", goals.distance.dead_zone),
        ("latency_s", goals.latency_s),
        ("tip_acceleration", goals.acceleration_mm_s2),
        ("min_score", goals.min_score),
    ] {
        assert_eq!(default(name), value, "{name}");
    }
    Ok(())
}

#[test]
fn links_lead_from_the_foot_to_the_camera() -> Result<(), HarnessError> {
    let mut arm = Harness::<ArmSim>::from_toml("")?;
    let out = arm.process()?;
    let (links, camera) = (out.table("links")?, out.value::<Pose>("camera_pose")?.a_from_b_mm);
    assert!(links.names().eq(LINK_COLUMNS));
    let rows: Vec<&[f64]> = links.rows().collect();
    // At home the camera is the frame's origin and looks down: the foot stands 100 mm farther down, 412.5 mm away.
    let foot = rows[0];
    assert!((foot[2] - 100.0).abs() < 1e-6 && (foot[0].hypot(foot[1]) - 412.5).abs() < 1e-6, "{foot:?}");
    assert!(rows[rows.len() - 1].iter().zip(camera).all(|(a, b)| (a - b).abs() < 1e-9), "{rows:?}");
    Ok(())
}

#[test]
fn the_camera_goes_where_the_tip_is() -> Result<(), HarnessError> {
    let mut pair = Pair::open("")?;
    let mut camera = [0.0; 3];
    for _ in 0..60 {
        // The tip rests 6 mm to the right of the middle in the room; the camera turns little on its way there.
        camera = pair.tick(Some(tip(13.5 - camera[0] * 1.6, 1.0)))?.0;
    }
    assert!(camera[0] > 2.0 && camera[1].abs() < 0.5, "{camera:?}");
    Ok(())
}

#[test]
fn without_a_tip_at_its_own_input_the_arm_does_not_move() -> Result<(), HarnessError> {
    let mut arm = Harness::<ArmSim>::from_toml("")?;
    for _ in 0..60 {
        let mut asked = still();
        asked.velocity_rad_s[5] = 0.2;
        arm.input_value("joints", asked);
        let out = arm.process()?;
        assert!(out.value::<Pose>("camera_pose")?.a_from_b_mm.iter().all(|v| v.abs() < 1e-9));
        assert_eq!(out.text("text")?, "arm waits: no tip is seen");
    }
    Ok(())
}

#[test]
fn doubtful_and_vanished_tips_stop_the_arm_and_say_so() -> Result<(), HarnessError> {
    for (then, words) in [(Some(tip(20.0, 0.1)), "doubtful"), (None, "tip is too old")] {
        let mut pair = Pair::open("")?;
        for _ in 0..30 {
            pair.tick(Some(tip(20.0, 1.0)))?;
        }
        let mut last = (pair.tick(then)?.0, [0.0; 3]);
        for _ in 0..30 {
            last = (pair.tick(then)?.0, last.0);
        }
        assert!(last.0.iter().zip(last.1).all(|(a, b)| (a - b).abs() < 1e-9), "{last:?}");
        let lines: Vec<&str> =
            pair.arm.logs().iter().filter(|l| l.level == Level::Warn).map(|l| l.message.as_str()).collect();
        // The controller is silent first: that is the cause that is found first where the tip is gone.
        assert!(lines.len() == 1 && (lines[0].contains(words) || lines[0].contains("control loop")), "{lines:?}");
    }
    Ok(())
}

#[test]
fn an_emergency_stop_latches_through_a_replacement() -> Result<(), HarnessError> {
    let mut pair = Pair::open("")?;
    for _ in 0..30 {
        pair.tick(Some(tip(20.0, 1.0)))?;
    }
    pair.arm.set_params("params = { emergency_stop = true }")?;
    pair.tick(Some(tip(20.0, 1.0)))?;
    pair.arm.set_params("")?;
    let mut at = [0.0; 3];
    for _ in 0..40 {
        let (camera, words) = pair.tick(Some(tip(20.0, 1.0)))?;
        assert_eq!(words, "ARM STOPPED: emergency stop");
        at = camera;
    }
    assert_eq!(pair.tick(Some(tip(20.0, 1.0)))?.0, at);
    pair.arm.set_params("params = { reset = 1 }")?;
    let mut moved = false;
    for _ in 0..40 {
        moved |= pair.tick(Some(tip(20.0, 1.0)))?.0 != at;
    }
    assert!(moved);
    Ok(())
}

#[test]
fn hostile_packets_are_survived() -> Result<(), HarnessError> {
    let mut arm = Harness::<ArmSim>::from_toml("")?;
    let mut control = Harness::<ArmPid>::from_toml("")?;
    for count in [0, 5, 6, 8, 9, u32::MAX] {
        for bad in [f64::NAN, f64::INFINITY, 1e300, -0.0] {
            let joints = Joints { position_rad: [bad; 8], velocity_rad_s: [bad; 8], count, reserved: 0 };
            let tip =
                Tip { u_px: bad, v_px: bad, xyz_mm: [bad; 3], score: bad, class_index: 9, xyz_valid: 1, track_id: 1 };
            arm.input_value("joints", joints).input_value("tip", tip);
            let pose: Pose = arm.process()?.value("camera_pose")?;
            assert!(pose.a_from_b_mm.iter().chain(&pose.a_from_b_wxyz).all(|v| v.is_finite()));
            control.input_value("tip", tip).input_value("joints", joints);
            if let Ok(out) = control.process() {
                assert!(out.is_empty("joints")?);
            } else {
                assert!(count != 6, "only another number of axes is a mistake");
            }
        }
    }
    let refused = Harness::<ArmSim>::from_toml("params = { arm = \"no.urdf\" }").err().map(|e| e.to_string());
    assert!(refused.is_some_and(|words| words.contains("no.urdf")));
    Ok(())
}

/// Media time per tick of a camera that claims 30 frames per second and delivers 10.
const CLAIMED_NS: i64 = 33_333_333;
const TRUE_NS: i64 = 100_000_000;

#[test]
fn the_largest_age_is_real_time_whatever_the_camera_says() -> Result<(), HarnessError> {
    let mut arm = Harness::<ArmSim>::from_toml("params = { max_age_ms = 150.0 }")?;
    let cause = |arm: &mut Harness<ArmSim>, n: i64, tip: Option<Tip>| {
        arm.at_tick(n as u64, n * CLAIMED_NS).at_clock(n * TRUE_NS);
        if let Some(tip) = tip {
            arm.input_value("tip", tip);
        }
        let mut asked = still();
        asked.velocity_rad_s[5] = 0.1;
        let out = arm.input_value("joints", asked).process()?;
        let cause = out.table("table")?.rows().next().map_or(f64::NAN, |row| row[1]);
        Ok::<f64, HarnessError>(cause)
    };
    for n in 0..30 {
        cause(&mut arm, n, Some(tip(7.5, 1.0)))?;
    }
    assert_eq!(cause(&mut arm, 30, Some(tip(7.5, 1.0)))?, 0.0, "it follows");
    // 200 ms after the last tip, which are 67 ms of the camera's.
    cause(&mut arm, 31, None)?;
    assert_eq!(cause(&mut arm, 32, None)?, 9.0, "the tip is too old");
    // Fresh by the camera's time, old by the clock: pictures that were held back.
    cause(&mut arm, 33, Some(tip(7.5, 1.0)))?;
    cause(&mut arm, 34, Some(tip(7.5, 1.0)))?;
    assert_eq!(cause(&mut arm, 35, Some(tip(7.5, 1.0)))?, 0.0, "it follows again");
    arm.input_age("tip", std::time::Duration::from_millis(200));
    cause(&mut arm, 36, Some(tip(7.5, 1.0)))?;
    arm.input_age("tip", std::time::Duration::from_millis(200));
    assert_eq!(cause(&mut arm, 37, Some(tip(7.5, 1.0)))?, 9.0, "a tip of 200 ms ago");
    arm.input_age("joints", std::time::Duration::from_millis(200));
    cause(&mut arm, 38, Some(tip(7.5, 1.0)))?;
    arm.input_age("joints", std::time::Duration::from_millis(200));
    assert_eq!(cause(&mut arm, 39, Some(tip(7.5, 1.0)))?, 9.0, "a demand from light of 200 ms ago");
    Ok(())
}

/// Speed of a tip, mm/s, and the requested speed, rad/s, after some ticks of a camera whose ticks are `claimed_ns` apart by its timestamps and
/// `true_ns` by the clock. The tip moves at 10 mm/s.
fn measured(claimed_ns: i64, true_ns: i64, age_ms: u64) -> Result<(f64, f64), HarnessError> {
    let mut control =
        Harness::<ArmPid>::from_toml("params = { picture_d = 0.0, picture_i = 0.0, dead_zone_px = 0.0 }")?;
    let mut last = (f64::NAN, f64::NAN);
    for n in 0..60 {
        let at_mm = 7.5 + 10.0 * (n - 60) as f64 * true_ns as f64 * 1e-9;
        control.at_tick(n as u64, n * claimed_ns).at_clock(n * true_ns);
        control.input_value("tip", tip(at_mm, 1.0)).input_value("joints", still());
        let out = control.tick_age(std::time::Duration::from_millis(age_ms)).process()?;
        if !out.is_empty("table")? {
            last = out.table("table")?.rows().next().map_or(last, |row| (row[5], row[6]));
        }
    }
    Ok(last)
}

#[test]
fn speeds_are_those_of_the_clock_whatever_the_camera_says() -> Result<(), HarnessError> {
    for (claimed_ns, true_ns) in [(CLAIMED_NS, CLAIMED_NS), (TRUE_NS, TRUE_NS), (CLAIMED_NS, TRUE_NS)] {
        let (mm_s, _) = measured(claimed_ns, true_ns, 0)?;
        assert!((mm_s - 10.0).abs() < 1.0, "{claimed_ns} {true_ns}: {mm_s} mm/s");
    }
    Ok(())
}

#[test]
fn a_late_tip_is_predicted_by_its_age() -> Result<(), HarnessError> {
    // The tip arrives at the middle from the left at 10 mm/s: 100 ms later it is 1 mm to the right.
    let (fresh, late) = (measured(CLAIMED_NS, CLAIMED_NS, 0)?.1, measured(CLAIMED_NS, CLAIMED_NS, 100)?.1);
    assert!(late > 1.2 * fresh, "{late} rad/s for a late tip, {fresh} for a fresh one");
    // No further than the oldest tip that the interlock follows.
    let (oldest, beyond) = (measured(CLAIMED_NS, CLAIMED_NS, 300)?.1, measured(CLAIMED_NS, CLAIMED_NS, 5000)?.1);
    assert!((oldest - beyond).abs() < 1e-9, "{oldest} {beyond}");
    Ok(())
}

#[test]
fn a_tip_that_was_carried_to_its_tick_is_predicted_by_the_age_of_the_tick_alone() -> Result<(), HarnessError> {
    // The tracker moves an old tip to the tick and says how old its light is, for the interlock. Only what has passed since the tick is left to predict.
    let demand = |tip_age_ms: u64, tick_age_ms: u64| -> Result<Joints, HarnessError> {
        let mut control = Harness::<ArmPid>::from_toml("params = { dead_zone_px = 0.0 }")?;
        let mut last = None;
        for n in 0..60 {
            control.at_tick(n as u64, n * CLAIMED_NS).tick_age(std::time::Duration::from_millis(tick_age_ms));
            control.input_value("tip", tip(7.5 + 10.0 * (n - 60) as f64 * CLAIMED_NS as f64 * 1e-9, 1.0));
            control.input_age("tip", std::time::Duration::from_millis(tick_age_ms + tip_age_ms));
            last = Some(control.input_value("joints", still()).process()?.value("joints")?);
        }
        Ok(last.expect("60 ticks"))
    };
    let speeds = |joints: Joints| joints.velocity_rad_s;
    let (fresh, carried) = (speeds(demand(0, 20)?), speeds(demand(150, 20)?));
    assert_eq!(fresh, carried, "150 ms were predicted twice");
    assert_ne!(fresh, speeds(demand(0, 170)?), "the age of the tick is predicted");
    Ok(())
}
