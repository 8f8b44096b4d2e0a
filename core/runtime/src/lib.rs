//! The Panoscope runtime: it loads plugins, runs checked graphs and tells how they do.
//!
//! [`Loader`] finds plugins and fills the graph crate's catalogue; [`Engine`] opens the nodes of a checked graph and walks ticks through
//! them. Nothing here knows what a node does.

mod apply;
mod cell;
mod claims;
pub mod clock;
mod convert;
pub mod elf;
pub mod ending;
mod engine;
mod exec;
mod failures;
pub mod fault;
mod finish;
mod guard;
mod host;
mod join;
mod keep;
pub mod live;
pub mod loader;
pub mod lock;
pub mod log;
pub mod memory;
pub mod numbers;
mod outbox;
mod outputs;
pub mod params;
mod plan;
pub mod pool;
mod preview;
pub mod record;
mod region;
mod report;
mod schedule;
pub mod stats;
pub mod sweep;
mod threads;
mod watch;

pub use apply::{Applied, ApplyError};
pub use engine::{Engine, Options, Outcome, SetError, StartError};
pub use live::Live;
pub use loader::Loader;
pub use preview::{HearFn, HearNumberFn, Listener, NumberListener, Preview};
pub use report::{Machine, NodeReport, NodeWindow, PathReport, QueueWindow, Report, Window, WireDrops};
