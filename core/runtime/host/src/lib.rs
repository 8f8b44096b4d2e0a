//! Services around the engine for a program that runs graphs of plugins.
//!
//! - [`loader`]: finds, verifies and maps plugins; opens graph files; locks and signatures.
//! - [`isolate`]: runs nodes in separate processes, also on other machines.
//! - [`attach`]: serves windows of other machines on a running graph, and implements the window's end.
//! - [`audit`]: the audit log of the theatre.

pub mod attach;
pub mod audit;
pub mod isolate;
pub mod loader;
