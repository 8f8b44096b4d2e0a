//! Evaluation: quality of results compared with ground truth and peers, cost of the runtime, and effect of parameters.
//!
//! Each evaluation is a function from options to figures; no function writes to a terminal or ends the process.
//! Progress, tables and cancellation go through a [`Session`]. [`eval`] measures quality, [`bench`] measures costs;
//! neither uses the other, and the other modules are shared.

#![deny(unsafe_code)]

pub mod bench;
pub mod calibration;
mod canvas;
mod embedded;
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
