//! A planned stop is the sum of its steps, within the limits, and as short as they allow.

use super::*;
use crate::campaign::Random;

/// Shortest time from a speed to rest with bounded acceleration and jerk, in steps.
fn min_steps(speed: f64) -> f64 {
    let (a, j) = (caps::ACCELERATION_RAD_S2, caps::JERK_RAD_S3);
    let seconds = if speed >= a * a / j { speed / a + a / j } else { 2.0 * (speed / j).sqrt() };
    seconds / STEP_S
}

/// Checks a stop from a state, step by step.
fn check(from: SetPoint) -> Brake {
    let limits = Caps::of(&shipped());
    let brake = Brake::plan(from, &limits);
    assert_eq!(brake.at(0), from);
    let mut last = from;
    for step in 1..=brake.steps() {
        let point = brake.at(step);
        // Each step is the one before it, continued with the new acceleration and then the new speed.
        assert!((point.velocity - last.velocity - point.acceleration * STEP_S).amax() < 1e-12, "{step}: {from:?}");
        assert!((point.position - last.position - point.velocity * STEP_S).amax() < 1e-12, "{step}: {from:?}");
        let jerk = (point.acceleration - last.acceleration) / STEP_S;
        assert!(share(&jerk, &limits.jerk) < 1.0 + 1e-9, "{step}: {jerk:?} from {from:?}");
        assert!(share(&point.acceleration, &limits.acceleration) < 1.0 + 1e-9, "{step}: {from:?}");
        last = point;
    }
    let end = brake.at(brake.steps());
    assert!(end.is_at_rest(), "{from:?}");
    assert_eq!(brake.at(brake.steps() + 1), end);
    assert_eq!(brake.at(u32::MAX), end);
    assert!(brake.at(brake.release_steps()).acceleration.amax() < 1e-12 || brake.release_steps() == 0);
    brake
}

#[test]
fn a_stop_from_any_state_is_the_sum_of_its_steps_within_the_limits() {
    let mut random = Random::new(21);
    for _ in 0..3000 {
        let mut any = |largest: f64| JointVector::from_fn(|_, _| (random.unit() - 0.5) * 2.0 * largest);
        check(SetPoint { position: any(1.0), velocity: any(caps::SPEED_RAD_S), acceleration: any(2.0) });
    }
}

#[test]
fn a_stop_from_steady_speed_takes_the_shortest_time_and_keeps_its_direction() {
    let mut random = Random::new(22);
    for _ in 0..500 {
        let velocity = JointVector::from_fn(|_, _| (random.unit() - 0.5) * 2.0 * caps::SPEED_RAD_S);
        let from = SetPoint { position: JointVector::zeros(), velocity, acceleration: JointVector::zeros() };
        let brake = check(from);
        assert_eq!(brake.release_steps(), 0);
        let (steps, shortest) = (f64::from(brake.steps()), min_steps(velocity.amax()));
        assert!(steps >= shortest - 1.0 && steps <= shortest + 3.0, "{steps} steps, {shortest} at least");
        for step in 0..brake.steps() {
            let point = brake.at(step);
            assert!((point.velocity.normalize() - velocity.normalize()).amax() < 1e-6 || point.velocity.amax() < 1e-9);
        }
    }
}

#[test]
fn the_acceleration_falls_first_as_fast_as_jerk_allows() {
    for (acceleration, release) in [(0.0, 0), (0.03, 1), (0.031, 2), (2.0, 67), (-2.0, 67)] {
        let from =
            SetPoint { position: JointVector::zeros(), velocity: joint(1, 0.2), acceleration: joint(1, acceleration) };
        assert_eq!(check(from).release_steps(), release, "{acceleration}");
    }
}

#[test]
fn a_stop_can_end_with_its_acceleration() {
    // The speed that is left when the acceleration has fallen to 0 is 0: nothing remains to be braked.
    let acceleration = joint(2, -1.5);
    let released = Brake::plan(
        SetPoint { position: JointVector::zeros(), velocity: JointVector::zeros(), acceleration },
        &Caps::of(&shipped()),
    );
    let steps = released.release_steps();
    let gained = released.at(steps).velocity;
    let from = SetPoint { position: JointVector::zeros(), velocity: -gained, acceleration };
    let brake = check(from);
    assert_eq!((brake.steps(), brake.release_steps()), (steps, steps));
}

#[test]
fn speeds_that_no_encoder_sees_are_dropped() {
    let at = |rad_s: f64| SetPoint {
        position: joint(0, 0.3),
        velocity: joint(0, rad_s),
        acceleration: JointVector::zeros(),
    };
    let limits = Caps::of(&shipped());
    assert_eq!(Brake::plan(at(2.9e-14), &limits).steps(), 0);
    assert!(Brake::plan(at(2.9e-14), &limits).at(1).is_at_rest());
    assert_eq!(Brake::plan(at(3.1e-14), &limits).steps(), 2);
    assert_eq!(Brake::plan(SetPoint::at_rest(joint(0, 0.3)), &limits).at(5), SetPoint::at_rest(joint(0, 0.3)));
}

#[test]
fn rest_is_no_speed_and_no_acceleration() {
    let rest = SetPoint::at_rest(joint(0, 0.3));
    assert!(rest.is_at_rest() && rest.position == joint(0, 0.3));
    assert!(!SetPoint { velocity: joint(3, 1e-9), ..rest }.is_at_rest());
    assert!(!SetPoint { acceleration: joint(3, 1e-9), ..rest }.is_at_rest());
    assert!(SetPoint { velocity: joint(3, -1e-13), acceleration: joint(3, 1e-13), ..rest }.is_at_rest());
    assert!(!SetPoint { velocity: joint(3, f64::NAN), ..rest }.is_at_rest());
}
