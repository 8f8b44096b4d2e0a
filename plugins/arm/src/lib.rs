//! The arm that holds the scope. `arm_pid` requests joint velocities that keep the leading tool's tip at the centre and at its distance (thesis,
//! chapter 6). `arm_sim` is a simulated arm behind the interlock, `arm_serial` a real one on a serial line, `arm_ur` one of Universal Robots.
//!
//! Safety. The interlock ([`panoscope_arm_core::interlock`]) is in the drivers, after the last edge of the graph: no controller, parameter or edit
//! can bypass it, and nothing moves without a fresh tip at the driver's own input.

#![forbid(unsafe_code)]

pub mod arm_pid;
pub mod arm_sim;
pub mod declared;
pub mod evaluate_arm;
pub mod guard;
pub mod joints;
pub mod real;
pub mod serial;
pub mod ur;

use panoscope_node::export_plugin;

export_plugin![arm_pid::ArmPid, arm_sim::ArmSim, serial::ArmSerial, ur::ArmUr, evaluate_arm::EvaluateArm];
