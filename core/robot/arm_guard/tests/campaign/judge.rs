//! Judges the arm's true angles and the set-points that reached it.

use std::time::{Duration, Instant};

use panoscope_arm_core::interlock::caps::{self, TubePose};
use panoscope_arm_core::interlock::measured;
use panoscope_arm_core::{Chain, JointVector};
use panoscope_firmware::Log;

/// Time over which a speed is measured: set-points that a loaded machine held up arrive together.
const SPEED_WINDOW: Duration = Duration::from_millis(60);
/// Allowance for a measured speed, rad/s.
const SPEED_NOISE_RAD_S: f64 = 0.02;

/// How the arm left its limits, by its true angles; `None` when it kept them. The limits are those of encoders, with
/// their margin.
pub fn escape(log: &Log, chain: &Chain) -> Option<String> {
    let home = chain.stance(&JointVector::zeros()).base_from_tip * nalgebra::Vector3::z();
    let mut first = 0;
    for (at, angles) in &log.angles {
        if angles.iter().any(|v| !v.is_finite()) {
            return Some(format!("angles {angles:?}"));
        }
        let tube = TubePose::of(chain, &chain.stance(angles), &home);
        let is_inside = tube.pivot_mm <= caps::PIVOT_MM + measured::PIVOT_MARGIN_MM
            && tube.tilt_rad <= caps::TILT_RAD + measured::TILT_MARGIN_RAD
            && tube.depth_mm >= caps::DEPTH_MM.0 - measured::DEPTH_MARGIN_MM
            && tube.depth_mm <= caps::DEPTH_MM.1 + measured::DEPTH_MARGIN_MM;
        if !is_inside {
            return Some(format!("outside the workspace: {tube:?}"));
        }
        // The shortest stretch that is long enough.
        while log.angles.get(first + 1).is_some_and(|(then, _)| *at >= *then + SPEED_WINDOW) {
            first += 1;
        }
        let (then, before) = &log.angles[first];
        if *at >= *then + SPEED_WINDOW {
            let speed = (angles - before).amax() / (*at - *then).as_secs_f64();
            if speed > caps::SPEED_RAD_S * measured::SPEED_SHARE + SPEED_NOISE_RAD_S {
                return Some(format!("{speed:.3} rad/s over {:?}", *at - *then));
            }
        }
    }
    None
}

/// When the last braking to rest began: its first set-point, or the moment at which the arm's own watchdog stopped it.
/// `None` while it moves.
pub fn braked_at(log: &Log) -> Option<Instant> {
    let speed = |index: usize| log.set_points.get(index).map_or(0.0, |(_, _, velocity)| velocity.amax());
    // It holds the arm until it is cleared, whatever set-points still arrive.
    if let Some(at) = log.watchdog_at.filter(|at| log.cleared_at.is_none_or(|cleared| cleared < *at)) {
        return Some(at);
    }
    let rest = log.set_points.iter().rposition(|(_, _, velocity)| velocity.amax() > 0.0)? + 1;
    let mut start = rest;
    while start > 0 && start < log.set_points.len() && (start == rest || speed(start) < speed(start - 1)) {
        start -= 1;
    }
    // `start` is the last set-point that does not brake.
    log.set_points.get(start + 1).map(|(at, ..)| *at)
}

/// Whether the arm follows at a steady speed, rad/s.
pub fn is_steady(log: &Log, rad_s: f64) -> bool {
    log.set_points.last().is_some_and(|(_, _, velocity)| velocity.amax() > 0.98 * rad_s.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(rad: f64) -> JointVector {
        JointVector::from_fn(|k, _| if k == 5 { rad } else { 0.0 })
    }

    fn log(speeds: &[f64]) -> (Instant, Log) {
        let start = Instant::now();
        let set_points = speeds
            .iter()
            .enumerate()
            .map(|(k, speed)| (start + Duration::from_millis(10 * k as u64), JointVector::zeros(), joint(*speed)));
        (start, Log { set_points: set_points.collect(), ..Log::default() })
    }

    #[test]
    fn braking_begins_at_the_first_slower_set_point() {
        for (speeds, index) in [
            (&[0.0, 0.1, 0.1, 0.1, 0.08, 0.05, 0.0][..], Some(4)),
            (&[0.1, 0.1, 0.09, 0.1, 0.1, 0.05, 0.0, 0.0], Some(5)),
            (&[0.1, 0.0], Some(1)),
            (&[0.1, 0.1, 0.09], None),
            (&[0.0, 0.0], None),
        ] {
            let (start, log) = log(speeds);
            let expected = index.map(|k: u64| start + Duration::from_millis(10 * k));
            assert_eq!(braked_at(&log), expected, "{speeds:?}");
        }
        let (start, mut log) = log(&[0.1, 0.1]);
        let at = start + Duration::from_millis(40);
        log.watchdog_at = Some(at);
        assert_eq!(braked_at(&log), Some(at), "the arm's own watchdog");
        log.cleared_at = Some(at);
        assert_eq!(braked_at(&log), None, "it was cleared, and moves");
    }

    #[test]
    fn an_arm_beyond_its_limits_is_found() {
        let chain = Chain::shipped().expect("the shipped arm");
        let start = Instant::now();
        let turning = |rad_s: f64| Log {
            angles: (0..200_u64)
                .map(|ms| (start + Duration::from_millis(ms), joint(rad_s * ms as f64 * 1e-3)))
                .collect(),
            ..Log::default()
        };
        assert_eq!(escape(&turning(0.5), &chain), None);
        assert!(escape(&turning(0.6), &chain).is_some_and(|words| words.contains("rad/s")));
        let off = Log { angles: vec![(start, JointVector::from_element(0.05))], ..Log::default() };
        assert!(escape(&off, &chain).is_some_and(|words| words.contains("workspace")));
        // Not a number.
        let none = Log { angles: vec![(start, joint(f64::NAN))], ..Log::default() };
        assert!(escape(&none, &chain).is_some());
    }
}
