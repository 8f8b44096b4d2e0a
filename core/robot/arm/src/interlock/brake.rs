//! Stops that are planned in advance.
//!
//! First the acceleration falls linearly to 0, then the speed is reduced along its own direction with bounded
//! acceleration and jerk. All joints keep their proportions, so that a movement about the trocar stays one. Both parts
//! have closed forms in whole steps: the stop that is checked is exactly the one that would be driven.

use super::caps::{Caps, STEP_S, share};
use crate::chain::JointVector;

/// Speeds in rad/s and accelerations in rad/s^2 below which a joint is at rest.
const REST: f64 = 1e-12;

/// Angles, speeds and accelerations of the joints: one set-point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetPoint {
    /// Joint angles, rad.
    pub position: JointVector,
    /// Joint velocities, rad/s.
    pub velocity: JointVector,
    /// Joint accelerations, rad/s^2.
    pub acceleration: JointVector,
}

impl SetPoint {
    /// At rest at these angles.
    pub fn at_rest(position: JointVector) -> Self {
        Self { position, velocity: JointVector::zeros(), acceleration: JointVector::zeros() }
    }

    /// Whether speeds and accelerations are 0, up to rounding, because a demand of 0 is approached asymptotically.
    pub fn is_at_rest(&self) -> bool {
        self.velocity.iter().chain(&self.acceleration).all(|value| value.abs() < REST)
    }
}

/// A planned stop.
#[derive(Clone, Copy, Debug)]
pub struct Brake {
    from: SetPoint,
    /// Steps in which the acceleration falls to 0.
    release: u32,
    /// Set-point after these steps; its velocity is the direction of braking.
    then: SetPoint,
    /// Steps in which braking increases, and in which it decreases again.
    ramp: u32,
    /// Steps of full braking between them.
    hold: u32,
    /// Jerk along the direction, 1/s^3.
    jerk: f64,
}

impl Brake {
    /// Plans the stop from a set-point.
    pub fn plan(from: SetPoint, caps: &Caps) -> Self {
        let release = (share(&from.acceleration, &caps.jerk) / STEP_S).ceil() as u32;
        let mut brake = Self { from, release, then: from, ramp: 0, hold: 0, jerk: 0.0 };
        if release > 0 {
            brake.then = brake.releasing(release);
            brake.then.acceleration = JointVector::zeros();
        }
        let max_acceleration = share(&brake.then.velocity, &caps.acceleration);
        let max_jerk = share(&brake.then.velocity, &caps.jerk);
        // Speeds below an encoder's resolution are dropped, so that the last step does not divide by 0.
        if max_jerk <= 1e-15 {
            return brake;
        }
        let (acceleration, jerk) = (1.0 / max_acceleration, 1.0 / max_jerk);
        (brake.ramp, brake.hold) = if acceleration * acceleration >= jerk {
            ((1.0 / (jerk * STEP_S * STEP_S)).sqrt().ceil() as u32, 0)
        } else {
            let ramp = (acceleration / (jerk * STEP_S)).ceil() as u32;
            (ramp, ((1.0 / (acceleration * STEP_S)).ceil() as u32).saturating_sub(ramp))
        };
        let ramp = f64::from(brake.ramp);
        brake.jerk = 1.0 / (STEP_S * STEP_S * ramp * (ramp + f64::from(brake.hold)));
        brake
    }

    /// Steps until the arm is at rest.
    pub fn steps(&self) -> u32 {
        self.release + 2 * self.ramp + self.hold
    }

    /// Steps after which the initial acceleration is 0.
    pub fn release_steps(&self) -> u32 {
        self.release
    }

    /// The set-point after `step` steps; at rest from [`Brake::steps`] on.
    pub fn at(&self, step: u32) -> SetPoint {
        if step == 0 {
            return self.from;
        }
        if step < self.release {
            return self.releasing(step);
        }
        let (distance, speed, braking) = self.straight((step - self.release).min(2 * self.ramp + self.hold));
        let direction = self.then.velocity;
        let position = self.then.position + direction * distance;
        if step >= self.steps() {
            return SetPoint::at_rest(position);
        }
        SetPoint { position, velocity: direction * speed, acceleration: direction * braking }
    }

    /// The set-point while the acceleration falls.
    fn releasing(&self, step: u32) -> SetPoint {
        let (h, k, n, start) = (STEP_S, f64::from(step), f64::from(self.release), &self.from);
        let velocity = start.velocity + start.acceleration * (h * (k - k * (k + 1.0) / (2.0 * n)));
        let lift = k * (k + 1.0) / 2.0 - k * (k + 1.0) * (k + 2.0) / (6.0 * n);
        let position = start.position + start.velocity * (h * k) + start.acceleration * (h * h * lift);
        SetPoint { position, velocity, acceleration: start.acceleration * (1.0 - k / n) }
    }

    /// Distance in units of the initial speed (s), share of that speed, and braking (1/s) after `step` steps of the
    /// second part.
    fn straight(&self, step: u32) -> (f64, f64, f64) {
        let (h, j, n) = (STEP_S, self.jerk, f64::from(self.ramp));
        let setting_in = |k: f64| {
            (h * (k - j * h * h * k * (k + 1.0) * (k + 2.0) / 6.0), 1.0 - j * h * h * k * (k + 1.0) / 2.0, -j * h * k)
        };
        if step <= self.ramp {
            return setting_in(f64::from(step));
        }
        let (distance, speed, peak) = setting_in(n);
        let full = |m: f64| (distance + h * (m * speed + peak * h * m * (m + 1.0) / 2.0), speed + peak * h * m, peak);
        if step <= self.ramp + self.hold {
            return full(f64::from(step - self.ramp));
        }
        let (distance, speed, _) = full(f64::from(self.hold));
        let m = f64::from(step - self.ramp - self.hold);
        let fall = j * h * h;
        (
            distance + h * (m * speed - fall * (n * m * (m + 1.0) / 2.0 - m * (m + 1.0) * (m + 2.0) / 6.0)),
            speed - fall * (m * n - m * (m + 1.0) / 2.0),
            -j * h * (n - m),
        )
    }
}
