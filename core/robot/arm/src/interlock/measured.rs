//! Limits checked on encoder angles instead of set-points.
//!
//! Set-points stay within [`caps`](super::caps); the arm follows them with lag, backlash and noise, so measured limits
//! have a margin. A measured violation latches: the arm does not do what was commanded.

use nalgebra::Vector3;

use super::caps::{Caps, DEPTH_MM, PIVOT_MM, SPEED_RAD_S, TILT_RAD, TubePose};
use super::cause::Cause;
use crate::chain::{Chain, JOINTS, JointVector};

/// Highest measured speed of a joint, as a share of its limit.
pub const SPEED_SHARE: f64 = 1.25;
/// Allowance for encoder noise in a measured speed, rad/s.
const SPEED_NOISE_RAD_S: f64 = 0.02;
/// Shortest time over which a speed is measured, ns.
const SPEED_WINDOW_NS: i64 = 60_000_000;
/// Margin of joint angles beyond their limits, rad.
pub const ANGLE_MARGIN_RAD: f64 = 0.01;
/// Margin of the distance of the tube from the trocar, mm: what gears and encoders add to [`PIVOT_MM`].
pub const PIVOT_MARGIN_MM: f64 = 0.5;
/// Margin of the tube's depth, mm.
pub const DEPTH_MARGIN_MM: f64 = 1.0;
/// Margin of the tube's tilt, rad.
pub const TILT_MARGIN_RAD: f64 = 0.01;
/// Answers that are kept to measure speed.
const KEPT: usize = 16;

/// Checks the newest encoder angles.
#[derive(Clone, Debug)]
pub struct Measured {
    caps: Caps,
    home: Vector3<f64>,
    /// Newest last; times in ns.
    answers: [(i64, JointVector); KEPT],
    len: usize,
}

impl Measured {
    /// The state for one arm.
    pub fn new(chain: &Chain) -> Self {
        let home = chain.stance(&JointVector::zeros()).base_from_tip * Vector3::z();
        Self { caps: Caps::of(chain), home, answers: [(0, JointVector::zeros()); KEPT], len: 0 }
    }

    /// Checks an answer: encoder angles, rad, and the time for which they hold, ns. Returns the violated limit. NaN
    /// violates.
    pub fn check(&mut self, chain: &Chain, at_ns: i64, angles_rad: &JointVector) -> Option<Cause> {
        if self.len > 0 && self.answers[self.len - 1].0 == at_ns {
            return None;
        }
        if self.len == KEPT {
            self.answers.rotate_left(1);
            self.len -= 1;
        }
        self.answers[self.len] = (at_ns, *angles_rad);
        self.len += 1;
        let inside = (0..JOINTS).all(|k| {
            angles_rad[k] >= self.caps.lower_rad[k] - ANGLE_MARGIN_RAD
                && angles_rad[k] <= self.caps.upper_rad[k] + ANGLE_MARGIN_RAD
        });
        if !inside || !self.is_pose_allowed(chain, angles_rad) {
            return Some(Cause::MeasuredWorkspace);
        }
        // Over the shortest stretch that is long enough.
        let before = self.answers[..self.len].iter().rev().find(|(then, _)| at_ns - then >= SPEED_WINDOW_NS)?;
        let seconds = (at_ns - before.0) as f64 * 1e-9;
        let is_slow = (0..JOINTS).all(|k| {
            let limit = self.caps.speed[k].min(SPEED_RAD_S) * SPEED_SHARE + SPEED_NOISE_RAD_S;
            ((angles_rad[k] - before.1[k]) / seconds).abs() <= limit
        });
        (!is_slow).then_some(Cause::MeasuredSpeed)
    }

    fn is_pose_allowed(&self, chain: &Chain, angles_rad: &JointVector) -> bool {
        let tube = TubePose::of(chain, &chain.stance(angles_rad), &self.home);
        tube.pivot_mm <= PIVOT_MM + PIVOT_MARGIN_MM
            && tube.tilt_rad <= TILT_RAD + TILT_MARGIN_RAD
            && tube.depth_mm >= DEPTH_MM.0 - DEPTH_MARGIN_MM
            && tube.depth_mm <= DEPTH_MM.1 + DEPTH_MARGIN_MM
    }

    /// Drops earlier answers, which say nothing about the speed after a pause.
    pub fn restart(&mut self) {
        self.len = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_NS: i64 = 10_000_000;

    fn run(each: impl Fn(i64) -> JointVector) -> Option<Cause> {
        let chain = Chain::shipped().expect("the shipped arm");
        let mut measured = Measured::new(&chain);
        (0..60).find_map(|k| measured.check(&chain, k * STEP_NS, &each(k)))
    }

    /// A turn of the last joint, which moves the tube about its own axis.
    fn turning(rad_s: f64) -> impl Fn(i64) -> JointVector {
        move |k| {
            let mut angles = JointVector::zeros();
            angles[5] = (k * STEP_NS) as f64 * 1e-9 * rad_s;
            angles
        }
    }

    #[test]
    fn speed_is_judged_on_encoders() {
        assert_eq!(run(turning(0.4)), None, "at the limit");
        assert_eq!(run(turning(-0.4)), None);
        assert_eq!(run(turning(0.6)), Some(Cause::MeasuredSpeed));
        assert_eq!(run(turning(-0.6)), Some(Cause::MeasuredSpeed));
    }

    #[test]
    fn noise_is_no_speed() {
        let noise = |k: i64| JointVector::from_element(if k % 2 == 0 { 2e-4 } else { -2e-4 });
        assert_eq!(run(noise), None);
    }

    #[test]
    fn workspace_and_angles_are_judged_on_encoders() {
        let chain = Chain::shipped().expect("the shipped arm");
        let caps = Caps::of(&chain);
        let mut beyond = JointVector::zeros();
        beyond[5] = caps.upper_rad[5] + 2.0 * ANGLE_MARGIN_RAD;
        assert_eq!(Measured::new(&chain).check(&chain, 0, &beyond), Some(Cause::MeasuredWorkspace));
        // One joint alone moves the tube away from the trocar.
        let mut off = JointVector::zeros();
        off[0] = 0.05;
        assert_eq!(Measured::new(&chain).check(&chain, 0, &off), Some(Cause::MeasuredWorkspace));
        let nan = JointVector::from_element(f64::NAN);
        assert_eq!(Measured::new(&chain).check(&chain, 0, &nan), Some(Cause::MeasuredWorkspace));
        assert_eq!(Measured::new(&chain).check(&chain, 0, &JointVector::zeros()), None);
    }

    #[test]
    fn a_restart_forgets_where_the_arm_was() {
        let chain = Chain::shipped().expect("the shipped arm");
        let mut measured = Measured::new(&chain);
        assert_eq!(measured.check(&chain, 0, &JointVector::zeros()), None);
        let mut moved = JointVector::zeros();
        moved[5] = 0.5;
        measured.restart();
        assert_eq!(measured.check(&chain, 100_000_000, &moved), None);
    }
}
