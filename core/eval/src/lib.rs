//! Evaluation: how good results are beside truth and peers, what the runtime costs, and what a change of a parameter does.
//!
//! Everything is a function with options in and figures out; no function writes to a terminal or ends the process. Progress, tables
//! and the wish to stop go through a [`Session`]. [`eval`] judges results, [`bench`] measures costs; neither sees the other, and what
//! both need lies in the other modules.

#![deny(unsafe_code)]

pub mod bench;
pub mod calibration;
mod error;
pub mod eval;
pub mod figures;
pub mod inputs;
pub mod packets;
pub mod plot;
pub mod registration;
pub mod report;
pub mod ruler;
pub mod run;
mod session;
pub mod soak;
pub mod statistics;
mod svg;
pub mod sweep;
mod system;
pub mod tune;

pub use error::{Cause, EvalError, FileAction, Result, chain};
pub use session::{AllocationCounters, Session, Silent};
