//! What is known of a node's failures, and who restarts it.
//!
//! The running call reports a failure (`wants_restart`, `gives_up`, `broken`, `position`); the thread that restarts the node takes these and
//! hands over a new instance. The watchdog counts calls that were left behind (`stuck`).

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64};
use std::sync::{Arc, Mutex};

use crate::instance::Instance;

/// See the module.
#[derive(Default)]
pub(crate) struct Recovery {
    /// Failed instances, to be closed off the hot path.
    pub broken: Mutex<Vec<Instance>>,
    /// Where a failed source was: the instance that replaces it goes on from there.
    pub position: Mutex<Option<Vec<u8>>>,
    /// A failed node is to be opened again.
    pub wants_restart: AtomicBool,
    /// Its last error was one that opening it again would not cure.
    pub gives_up: AtomicBool,
    /// Increases with every attempt to restart; only the newest may hand over.
    pub restarting: AtomicU64,
    pub failures: AtomicU32,
    /// Calls of all kinds that were left behind and have not returned.
    pub stuck: Arc<AtomicU32>,
}
