//! The Panoscope engine: it runs checked graphs and reports their times, drops and faults.
//!
//! [`Engine`] opens the nodes of a checked graph and runs ticks through them. It does not know what a node does, where
//! its code comes from ([`Plugins`]), who records the run ([`observe::Observer`]) or who replaces the clock in a replay
//! ([`decide::Decider`]).

mod applied;
mod apply;
mod busy;
mod call;
mod change_lock;
mod claims;
pub mod clock;
mod convert;
mod current_node;
pub mod decide;
pub mod ending;
mod engine;
mod exec;
pub mod fault;
pub mod files;
mod guard;
pub mod heap;
pub mod host;
pub mod inbox;
mod instance;
pub mod isolation;
mod join;
mod leave;
mod light;
pub mod loading;
pub mod log;
pub mod memory;
mod node;
pub mod observe;
mod outbox;
mod outputs;
mod own_thread;
pub mod params;
mod plan;
mod play;
mod plugins;
pub mod pool;
mod preview;
mod rate;
mod region;
mod report;
mod retained;
mod run_context;
mod schedule;
mod scratch;
mod sleeps;
pub mod stats;
pub mod sync;
pub mod text_table;
mod thread_id;
mod threads;
pub mod trace;
pub mod vet;
mod watch;

pub use applied::{Applied, ApplyError};
pub use engine::{Engine, Options, Outcome, SetError, StartError};
pub use host::random_seed;
pub use outbox::panic_words;
pub use plan::TICKS_LIVE;
pub use plugins::Plugins;
pub use preview::{HearFn, HearNumberFn, Listener, NumberListener, Preview};
pub use report::{Machine, NodeReport, NodeWindow, PathReport, QueueWindow, Report, Window, WireDrops, WireTooOld};
