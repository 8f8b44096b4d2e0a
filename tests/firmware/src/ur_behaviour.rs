//! Correct and faulty behaviour of a simulated Universal Robots controller.

use std::time::Duration;

/// Behaviour of the controller. Everything may change while it runs.
#[derive(Clone, Copy, Debug)]
pub struct UrBehaviour {
    /// The only version of RTDE that it speaks.
    pub rtde_version: u16,
    /// Software version; 3 is a CB3 controller with cycles of 8 ms, others have 2 ms.
    pub software: [u32; 4],
    /// A field that it does not support.
    pub unknown_field: &'static str,
    /// A field that has another type than documented.
    pub other_type: &'static str,
    /// Answers something other than a serial number.
    pub has_no_serial: bool,
    /// Does not start the exchange.
    pub refuses_start: bool,
    /// Time constant of the joints, s.
    pub lag_s: f64,
    /// Encoder noise, rad, uniformly distributed.
    pub noise_rad: f64,
    /// Delay of outputs.
    pub delay: Duration,
    /// Share of bytes, in both directions, in which a bit is flipped.
    pub damaged_bytes: f64,
    /// Sends packages in two pieces.
    pub is_cut: bool,
    /// Sends nothing.
    pub is_silent: bool,
    /// Sends garbage instead of packages.
    pub is_garbage: bool,
    /// Reports another heartbeat than it received.
    pub has_wrong_echo: bool,
    /// Closes all connections.
    pub is_unplugged: bool,
    /// Rate of its clock and cycles; 1 is correct.
    pub clock_rate: f64,
    /// The joints do not move.
    pub is_stuck: bool,
    /// Speed at which the arm drifts by itself in its last joint, rad/s.
    pub runaway_rad_s: f64,
    /// A protective stop: the program pauses.
    pub is_protective: bool,
    /// A safeguard stop: the program pauses.
    pub is_safeguard: bool,
    /// The emergency stop is pressed: power goes off, the program ends.
    pub is_emergency: bool,
    /// A fault of the safety system.
    pub has_fault: bool,
    /// The arm has no power.
    pub is_off: bool,
    /// The program has not been started, or was stopped.
    pub is_program_stopped: bool,
}

impl Default for UrBehaviour {
    fn default() -> Self {
        Self {
            rtde_version: 2,
            software: [5, 12, 4, 0],
            unknown_field: "",
            other_type: "",
            has_no_serial: false,
            refuses_start: false,
            lag_s: 0.05,
            noise_rad: 1e-5,
            delay: Duration::ZERO,
            damaged_bytes: 0.0,
            is_cut: false,
            is_silent: false,
            is_garbage: false,
            has_wrong_echo: false,
            is_unplugged: false,
            clock_rate: 1.0,
            is_stuck: false,
            runaway_rad_s: 0.0,
            is_protective: false,
            is_safeguard: false,
            is_emergency: false,
            has_fault: false,
            is_off: false,
            is_program_stopped: false,
        }
    }
}

impl UrBehaviour {
    /// Length of a control cycle, s.
    pub fn step_s(&self) -> f64 {
        if self.software[0] == 3 { 0.008 } else { 0.002 }
    }
}
