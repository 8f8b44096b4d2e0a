//! Tests of following: fast, in the demand's direction, and not beyond where it can still stop.

use super::*;
use crate::campaign;

/// The largest shares of acceleration and jerk in set-points, by their differences.
fn shares(points: &[SetPoint]) -> (f64, f64) {
    let limits = Caps::of(&shipped());
    let acceleration = points.iter().map(|point| share(&point.acceleration, &limits.acceleration)).fold(0.0, f64::max);
    let jerks = points.windows(2).map(|two| (two[1].acceleration - two[0].acceleration) / STEP_S);
    (acceleration, jerks.map(|jerk| share(&jerk, &limits.jerk)).fold(0.0, f64::max))
}

#[test]
fn it_starts_where_the_arm_is_as_far_as_that_is_possible() {
    let start = JointVector::from_column_slice(&[0.1, -0.2, 5.0, -9.0, f64::NAN, f64::INFINITY]);
    let lock = Interlock::new(shipped(), start, 0);
    assert_eq!(lock.set_point().position.as_slice(), [0.1, -0.2, 1.4, -2.8, 0.0, 0.0]);
    assert!(lock.set_point().is_at_rest());
    assert_eq!(lock.caps().upper_rad[2], 1.4);
    assert_eq!(lock.chain().joints()[2].upper_rad, 1.4);
    let tube = lock.tube();
    let home = shipped().stance(&JointVector::zeros()).base_from_tip * Vector3::z();
    assert_eq!(tube, TubePose::of(&shipped(), &shipped().stance(&lock.set_point().position), &home));
}

#[test]
fn set_points_are_the_sum_of_their_steps_one_per_ms() {
    let mut lock = lock();
    let mut points = drive(&mut lock, 0, 400, 0.25);
    points.extend(drive(&mut lock, 400, 700, -0.1));
    points.extend(drive(&mut lock, 700, 1000, 0.0));
    assert_eq!(points.len(), 1000);
    assert_eq!(points.last(), Some(lock.set_point()));
    for (step, two) in points.windows(2).enumerate() {
        let [last, point] = two else { unreachable!("windows of two") };
        assert!((point.velocity - last.velocity - point.acceleration * STEP_S).amax() < 1e-12, "step {step}");
        assert!((point.position - last.position - point.velocity * STEP_S).amax() < 1e-12, "step {step}");
    }
    let (acceleration, jerk) = shares(&points);
    assert!(acceleration <= 1.0 && jerk <= 1.0 + 1e-9, "{acceleration} {jerk}");
}

#[test]
fn a_demand_is_reached_about_as_fast_as_the_limits_allow() {
    // Shortest times to a speed: 2 sqrt(v / jerk), and v / acceleration + acceleration / jerk for fast ones.
    for (rad_s, min_ms, jerk) in [(0.02, 51.6, 0.7), (0.1, 115.5, 0.9), (0.35, 241.7, 0.99)] {
        let mut lock = lock();
        let points = drive(&mut lock, 0, 600, rad_s);
        let reached = points.iter().position(|point| point.velocity[5] > 0.99 * rad_s).expect("reached");
        assert!(reached as f64 > 0.9 * min_ms, "{rad_s} rad/s after {reached} ms");
        assert!((reached as f64) < 1.35 * min_ms, "{rad_s} rad/s after {reached} ms");
        assert!(points.iter().all(|point| point.velocity[5] < rad_s + 1e-6), "it does not overshoot");
        assert!((lock.set_point().velocity[5] - rad_s).abs() < 1e-6);
        assert!(shares(&points).1 > jerk, "{rad_s} rad/s: {:?}", shares(&points));
    }
    let mut lock = lock();
    assert!(shares(&drive(&mut lock, 0, 600, 0.35)).0 > 0.95, "the acceleration is used");
}

#[test]
fn a_demand_beyond_the_speeds_keeps_its_direction() {
    let mut lock = Interlock::new(about_trocar(), JointVector::zeros(), 0);
    let push = |lock: &mut Interlock, pitch: f64, roll: f64, from_ms: i64| {
        for ms in (from_ms..from_ms + 800).step_by(10) {
            lock.advance(ms * MS, &mut |point| {
                let (pitch_now, roll_now) = (point.velocity[4], point.velocity[5]);
                assert!((pitch_now * roll - roll_now * pitch).abs() < 1e-6 * roll.abs(), "{point:?}");
            });
            lock.tip(ms * MS, SEEN);
            lock.demand(ms * MS, (joint(4, pitch) + joint(5, roll)).as_slice());
        }
        lock.advance((from_ms + 800) * MS, &mut |_| {});
        lock.set_point().velocity
    };
    // 95 % of the speed of the fastest joint.
    let velocity = push(&mut lock, 0.6, 1.8, 0);
    assert!((velocity - joint(4, 0.38 / 3.0) - joint(5, 0.38)).amax() < 1e-6, "{velocity}");
    let mut lock = Interlock::new(about_trocar(), JointVector::zeros(), 0);
    let velocity = push(&mut lock, 0.1, 0.3, 0);
    assert!((velocity - joint(4, 0.1) - joint(5, 0.3)).amax() < 1e-6, "as asked: {velocity}");
    let mut lock = Interlock::new(about_trocar(), JointVector::zeros(), 0);
    let velocity = push(&mut lock, 0.0, 1e100, 0);
    assert!((velocity - joint(5, 0.38)).amax() < 1e-6, "{velocity}");
}

#[test]
fn a_demand_beyond_the_cameras_speed_is_slowed() {
    // The camera is 180 mm in front of the joint about which it turns, 7.5 mm beside the tube.
    let chain = changed(&[("0.42 0 0.21", "0.42 0 0.48"), ("0 0 -0.3\"", "0 0 -0.1\"")]);
    let mut lock = Interlock::new(chain.clone(), JointVector::zeros(), 0);
    for ms in (0..700).step_by(10) {
        lock.advance(ms * MS, &mut |_| {});
        lock.tip(ms * MS, SEEN);
        lock.demand(ms * MS, joint(4, 0.38).as_slice());
    }
    let rad_s = lock.set_point().velocity[4];
    let expected = 0.85 * 60.0 / 180.0_f64.hypot(7.5);
    assert!((rad_s - expected).abs() < 1e-3 * expected, "{rad_s} rad/s, {expected} expected");
}

#[test]
fn an_arm_at_its_limit_stops_near_it_and_turns_back() {
    let mut lock = Interlock::new(about_trocar(), JointVector::zeros(), 0);
    let mut largest = 0.0_f64;
    let mut push = |lock: &mut Interlock, pitch: f64, from_ms: i64, until_ms: i64| {
        for ms in (from_ms..until_ms).step_by(10) {
            lock.advance(ms * MS, &mut |point| largest = largest.max(point.position[4]));
            lock.tip(ms * MS, SEEN);
            lock.demand(ms * MS, joint(4, pitch).as_slice());
        }
        lock.advance(until_ms * MS, &mut |point| largest = largest.max(point.position[4]));
        largest
    };
    let largest = push(&mut lock, 0.3, 0, 4000);
    // The tilt's limit of 0.6 rad, less the margin of plans.
    assert!(largest <= 0.59 && largest > 0.589, "{largest} rad");
    assert_eq!((lock.stop(), lock.stopped()), (Some(Cause::Limit), Some(Cause::Limit)));
    assert!(lock.set_point().velocity.amax() < 0.02);
    push(&mut lock, -0.3, 4000, 4400);
    assert_eq!(lock.stop(), None);
    assert!(lock.set_point().velocity[4] < -0.25);
}

#[test]
fn angles_stop_inside_their_limits_too() {
    // The last joint's limit of 3 rad, less the margin of plans.
    let mut lock = lock();
    let points = drive(&mut lock, 0, 12_000, 0.38);
    let largest = points.iter().map(|point| point.position[5]).fold(0.0, f64::max);
    assert!(largest <= 3.0 - 0.012 && largest > 3.0 - 0.0135, "{largest} rad");
    let mut slow = Interlock::new(changed(&[("velocity=\"0.4\"", "velocity=\"0.1\"")]), JointVector::zeros(), 0);
    let points = drive(&mut slow, 0, 1000, 0.38);
    let fastest = points.iter().map(|point| point.velocity[5]).fold(0.0, f64::max);
    assert!(fastest <= 0.1 && fastest > 0.094, "{fastest} rad/s");
}

#[test]
fn an_arm_that_starts_in_the_margin_does_not_move() {
    let mut lock = Interlock::new(shipped(), joint(5, 3.0 - 0.006), 0);
    drive(&mut lock, 0, 500, 0.1);
    assert_eq!((lock.set_point().position, lock.stop()), (joint(5, 3.0 - 0.006), Some(Cause::Limit)));
}

#[test]
fn no_input_leads_beyond_a_limit() {
    for (chain, seed) in [(shipped(), 31), (about_trocar(), 32), (deep(25.0), 33), (deep(185.0), 34)] {
        let out = campaign::run(&chain, seed, 2500);
        assert_eq!(out.escapes, 0, "{:?}", out.first);
        assert!(out.moving > 600, "{out:?}");
    }
}

#[test]
fn the_same_requests_make_the_same_set_points() {
    let mut lock = lock();
    let mut points = drive(&mut lock, 0, 300, 0.3);
    points.extend(drive(&mut lock, 300, 450, -0.2));
    lock.advance(600 * MS, &mut |point| points.push(*point));
    // Positions of the last joint in nanoradians, every 50 ms: a change of the way in which the arm follows changes them.
    let positions: Vec<i64> = points.iter().step_by(50).map(|point| (point.position[5] * 1e9).round() as i64).collect();
    let expected = [
        30, 702_077, 5_055_356, 14_295_749, 27_718_735, 42_667_129, 57_667_098, 71_965_051, 82_611_772, 88_370_489,
        89_500_607, 88_557_592,
    ];
    assert_eq!(positions, expected);
}

/// A stop from a state of the last joint.
fn stop_from(lock: &Interlock, position: f64, velocity: f64, acceleration: f64) -> Brake {
    let from =
        SetPoint { position: joint(5, position), velocity: joint(5, velocity), acceleration: joint(5, acceleration) };
    Brake::plan(from, &lock.caps)
}

#[test]
fn a_stop_that_turns_back_is_judged_where_it_turns() {
    let lock = lock();
    let edge = 3.0 - 0.012;
    // The acceleration falls over 67 steps. The joint moves on, turns in the first or second third of them, and comes to rest further back.
    for (velocity, turns_at) in [(0.03, 22), (0.0586, 44)] {
        let shape = stop_from(&lock, 0.0, velocity, -2.0);
        assert_eq!(shape.release_steps(), 67);
        let there = shape.at(turns_at).position[5];
        let elsewhere = [0, 67, shape.steps()].map(|step| shape.at(step).position[5]);
        assert!(elsewhere.iter().all(|position| *position < there - 2e-5), "{there} {elsewhere:?}");
        assert!(lock.is_safe(&stop_from(&lock, edge - there - 1e-6, velocity, -2.0)), "up to the margin");
        assert!(!lock.is_safe(&stop_from(&lock, edge - there + 1e-5, velocity, -2.0)), "beyond it at step {turns_at}");
    }
}

#[test]
fn a_stop_is_judged_at_its_start_and_its_end() {
    let lock = lock();
    let edge = 3.0 - 0.012;
    let went = stop_from(&lock, 0.0, 0.3, 0.0);
    let went = went.at(went.steps()).position[5];
    assert!(lock.is_safe(&stop_from(&lock, edge - went - 1e-9, 0.3, 0.0)));
    assert!(!lock.is_safe(&stop_from(&lock, edge - went + 1e-9, 0.3, 0.0)), "its end");
    assert!(
        lock.is_safe(&stop_from(&lock, edge, -0.3, 0.0)) && !lock.is_safe(&stop_from(&lock, edge + 1e-9, -0.3, 0.0))
    );
    // Where the acceleration has fallen to 0 the speed is largest.
    assert!(lock.is_safe(&stop_from(&lock, 0.0, 0.4, 0.0)), "at the limit");
    assert!(!lock.is_safe(&stop_from(&lock, 0.0, 0.4 + 1e-9, 0.0)));
    assert!(lock.is_safe(&stop_from(&lock, 0.0, 0.33, 2.0)) && !lock.is_safe(&stop_from(&lock, 0.0, 0.34, 2.0)));
    assert!(!lock.is_safe(&stop_from(&lock, 0.0, f64::NAN, 0.0)));
}

#[test]
fn a_stop_is_judged_by_pose_and_camera_each_alone() {
    let at = |position: JointVector, velocity: JointVector| SetPoint {
        position,
        velocity,
        acceleration: JointVector::zeros(),
    };
    let lock = lock();
    let rest = |angle: f64| Brake::plan(at(joint(4, angle), JointVector::zeros()), &lock.caps);
    assert!(lock.is_safe(&rest((0.849_f64 / 270.0).asin())) && !lock.is_safe(&rest((0.851_f64 / 270.0).asin())));
    // The camera turns about the trocar at 180 mm: 55.8 mm/s are allowed, the pose is.
    let chain = changed(&[("0.42 0 0.21", "0.42 0 0.48"), ("0 0 -0.3\"", "0 0 -0.1\"")]);
    let lock = Interlock::new(chain, JointVector::zeros(), 0);
    let turning = |mm_s: f64| {
        let rad_s = mm_s / 180.0_f64.hypot(7.5);
        Brake::plan(at(JointVector::zeros(), joint(4, rad_s)), &lock.caps)
    };
    assert!(lock.is_safe(&turning(55.79)) && !lock.is_safe(&turning(55.81)));
}

#[test]
fn a_state_beyond_a_limit_is_not_followed_on() {
    // No input leads there; should a state ever be wrong, it is not continued.
    for state in [
        SetPoint { velocity: joint(5, 0.45), ..SetPoint::at_rest(JointVector::zeros()) },
        SetPoint { acceleration: joint(5, 2.5), ..SetPoint::at_rest(JointVector::zeros()) },
    ] {
        let mut lock = lock();
        lock.state = state;
        let mut steps = 0;
        assert!(!lock.try_follow(&JointVector::zeros(), 1, &mut |_| steps += 1));
        assert_eq!((steps, *lock.set_point()), (0, state), "nothing has changed");
    }
}

#[test]
fn a_stop_is_checked_in_both_its_parts() {
    assert_eq!(checked_steps(300, 1100), [0, 100, 200, 300, 500, 700, 900, 1100]);
    assert_eq!(checked_steps(0, 10), [0, 0, 0, 0, 2, 5, 7, 10]);
}

#[test]
fn a_demand_is_lowered_to_the_nearest_limit_in_its_direction() {
    let lock = lock();
    let stance = lock.chain.stance(&lock.state.position);
    let shares = |velocity: &JointVector| {
        let camera = stance.camera_velocity(velocity).norm() / caps::CAMERA_MM_S;
        (share(velocity, &lock.caps.speed) / 0.95, camera / 0.85)
    };
    let (mut by_joint, mut by_camera) = (0, 0);
    for index in 0..6 {
        let wanted = joint(index, 2.0) + joint((index + 1) % 6, -0.5);
        let lowered = lock.tamed(&wanted);
        let (of_joint, of_camera) = shares(&lowered);
        assert!((of_joint.max(of_camera) - 1.0).abs() < 1e-9, "joint {index}: {of_joint} {of_camera}");
        assert!((lowered * (wanted[index] / lowered[index]) - wanted).amax() < 1e-9, "joint {index}");
        if of_joint > of_camera {
            by_joint += 1
        } else {
            by_camera += 1
        }
        let slow = wanted * (0.999 * lowered[index] / wanted[index]);
        assert_eq!(lock.tamed(&slow), slow, "joint {index}");
    }
    assert!(by_joint > 0 && by_camera > 0, "{by_joint} by a joint, {by_camera} by the camera");
}

#[test]
fn no_step_follows_a_demand_that_has_expired() {
    let age = caps::DEMAND_AGE.as_nanos() as i64;
    for (left_ns, steps) in [(age, CHUNK_STEPS), (3 * MS, 3), (3 * MS - 1, 2), (MS / 2, 1)] {
        let mut lock = lock();
        lock.now_ns = 1000 * MS;
        lock.tip(lock.now_ns, SEEN);
        let made_ns = lock.now_ns - age + left_ns;
        lock.demand(made_ns, joint(5, 0.1).as_slice());
        assert_eq!(lock.chunk(CHUNK_STEPS, &mut |_| {}), steps, "{left_ns} ns are left");
        assert_eq!(lock.stop(), None);
    }
}

#[test]
fn near_a_limit_a_part_of_the_demand_is_followed() {
    let mut lock = lock();
    let (mut last_rad_s, mut slower) = (0.0, 0);
    for ms in (0..20_000).step_by(10) {
        ask(&mut lock, ms * MS, 0.3);
        lock.advance((ms + 10) * MS, &mut |_| {});
        let rad_s = lock.set_point().velocity[5];
        slower += usize::from(lock.stop().is_none() && rad_s < last_rad_s - 1e-4);
        last_rad_s = rad_s;
    }
    assert!(slower > 0, "it only brakes");
    assert!(lock.caps().upper_rad[5] - lock.set_point().position[5] < 0.1, "{:?}", lock.set_point());
}
