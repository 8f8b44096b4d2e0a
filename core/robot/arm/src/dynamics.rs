//! A simulated arm in virtual time: set-points arrive late, motors lag, gears have backlash, encoders are noisy.

use crate::chain::{JOINTS, JointVector};
use crate::interlock::SetPoint;
use crate::interlock::caps::STEP_S;

/// Imperfections of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Time from a set-point until the motors receive it, ms.
    pub latency_ms: f64,
    /// Time constant of the motors' position loop, ms.
    pub lag_ms: f64,
    /// Backlash of each gear, full width, rad.
    pub backlash_rad: f64,
    /// Standard deviation of each encoder's noise, rad.
    pub encoder_noise_rad: f64,
}

impl Default for Quality {
    fn default() -> Self {
        Self { latency_ms: 50.0, lag_ms: 15.0, backlash_rad: 2e-4, encoder_noise_rad: 2e-5 }
    }
}

/// Longest latency, in steps of 1 ms.
pub const MAX_LATENCY_STEPS: usize = 500;

/// Six joints that follow set-points.
#[derive(Clone)]
pub struct SimArm {
    quality: Quality,
    /// Set-points that the motors have not received yet; a ring.
    in_flight: Vec<(JointVector, JointVector)>,
    next: usize,
    motor: JointVector,
    motor_velocity: JointVector,
    link: JointVector,
}

impl SimArm {
    /// An arm at rest at these angles.
    pub fn new(quality: Quality, angles_rad: JointVector) -> Self {
        let steps = ((quality.latency_ms / (1e3 * STEP_S)).round() as usize).clamp(1, MAX_LATENCY_STEPS);
        let in_flight = vec![(angles_rad, JointVector::zeros()); steps];
        Self { quality, in_flight, next: 0, motor: angles_rad, motor_velocity: JointVector::zeros(), link: angles_rad }
    }

    /// Advances by 1 ms.
    pub fn step(&mut self, set_point: &SetPoint) {
        let (position, velocity) =
            std::mem::replace(&mut self.in_flight[self.next], (set_point.position, set_point.velocity));
        self.next = (self.next + 1) % self.in_flight.len();
        // The motors' loop feeds the speed forward: only a lag of the position remains.
        let rate = 1.0 / (self.quality.lag_ms.max(1.0) * 1e-3);
        self.motor_velocity = velocity + (position - self.motor) * rate;
        self.motor += self.motor_velocity * STEP_S;
        let half = self.quality.backlash_rad / 2.0;
        for k in 0..JOINTS {
            // Within the backlash the link does not move.
            self.link[k] = self.link[k].clamp(self.motor[k] - half, self.motor[k] + half);
        }
    }

    /// True angles of the links, rad.
    pub fn links(&self) -> &JointVector {
        &self.link
    }

    /// Speeds of the motors, rad/s.
    pub fn velocities(&self) -> &JointVector {
        &self.motor_velocity
    }

    /// Angles that the encoders (on the motors) read, rad; `random` returns 64 random bits per call.
    pub fn encoders(&self, mut random: impl FnMut() -> u64) -> JointVector {
        let mut noise = || {
            // The sum of 12 uniform numbers approximates a normal distribution.
            let unit = |bits: u64| (bits >> 48) as f64 / 65536.0;
            let mut sum = 0.0;
            for _ in 0..3 {
                let bits = random();
                sum += (0..4).map(|k| unit(bits << (16 * k))).sum::<f64>();
            }
            (sum - 6.0) * self.quality.encoder_noise_rad
        };
        self.motor.map(|angle| angle + noise())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_points_arrive_late_and_the_gear_has_play() {
        let quality = Quality { encoder_noise_rad: 0.0, ..Quality::default() };
        let mut arm = SimArm::new(quality, JointVector::zeros());
        let there = SetPoint::at_rest(JointVector::from_element(0.01));
        (0..50).for_each(|_| arm.step(&there));
        assert_eq!(arm.links(), &JointVector::zeros(), "nothing for 50 ms");
        (0..500).for_each(|_| arm.step(&there));
        let read = arm.encoders(|| 0);
        assert!((read[0] - 0.01).abs() < 1e-9);
        assert!((arm.links()[0] - (0.01 - quality.backlash_rad / 2.0)).abs() < 1e-9, "{}", arm.links()[0]);
    }

    #[test]
    fn encoders_are_as_noisy_as_they_are_said_to_be() {
        let arm = SimArm::new(Quality { encoder_noise_rad: 1e-3, ..Quality::default() }, JointVector::zeros());
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            state ^ (state >> 29)
        };
        let reads: Vec<f64> =
            (0..2000).flat_map(|_| arm.encoders(&mut random).iter().copied().collect::<Vec<_>>()).collect();
        let mean = reads.iter().sum::<f64>() / reads.len() as f64;
        let deviation = (reads.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / reads.len() as f64).sqrt();
        assert!(mean.abs() < 1e-4 && (deviation / 1e-3 - 1.0).abs() < 0.05, "{mean} {deviation}");
    }
}
