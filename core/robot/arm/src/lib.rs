//! A camera arm as plain mathematics, without any framework type.
//!
//! [`chain`] reads an arm from URDF; [`control`] computes joint velocities from the tip's position; [`interlock`] sits
//! between any controller and any arm; [`dynamics`] simulates an arm, and [`tuning`] finds gains on it. [`tracking`]
//! follows instrument tips and knows nothing of the rest. Lengths in mm,
//! angles in rad, times in ns on one clock that the caller owns. Source of the task: thesis, chapter 6 (figs 6.2, 6.3).

#![forbid(unsafe_code)]

pub mod campaign;
pub mod chain;
pub mod control;
pub mod dynamics;
mod error;
pub mod interlock;
pub mod line;
pub mod pid;
pub mod rehearsal;
pub mod task;
pub mod tracking;
pub mod tuning;

pub use chain::{Chain, JOINTS, JointVector, Stance};
pub use error::ArmError;
pub use interlock::{Cause, Event, Interlock, SetPoint};
