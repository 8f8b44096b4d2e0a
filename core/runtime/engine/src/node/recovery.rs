//! The failures of a node and its restarts.
//!
//! The running call reports a failure; the restart thread takes the failed instances and opens a new one; the watchdog
//! counts calls that it abandoned. The fields are private, so that each writer goes through an operation with a name.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use crate::exec::Exec;
use crate::instance::Instance;
use crate::sync::lock;

/// Failures and restarts of a node; see the module.
#[derive(Default)]
pub(crate) struct Recovery {
    /// Failed instances, closed off the hot path.
    broken: Mutex<Vec<Instance>>,
    /// Saved state of a failed source: its next instance continues there.
    position: Mutex<Option<Vec<u8>>>,
    /// Position of an isolated source after its last tick: a process that died cannot be asked.
    kept_position: Mutex<Option<Vec<u8>>>,
    restart_requested: AtomicBool,
    /// A restart would not cure the last error.
    permanent: AtomicBool,
    /// Incremented by every restart and every change; only the newest may install its instance.
    restart_epoch: AtomicU64,
    /// Failures in a row.
    failures: AtomicU32,
    /// Abandoned calls that have not returned.
    stuck: AtomicU32,
}

impl Recovery {
    /// Counts a failed call. Only the thread that runs the node has its `Exec`.
    pub fn count_failure(&self, exec: &mut Exec) {
        exec.failures_in_a_row += 1;
        self.failures.store(exec.failures_in_a_row, Ordering::Relaxed);
    }

    /// Hands over the instance of a failed call and asks for a restart.
    pub fn request_restart(&self, _exec: &mut Exec, broken: Instance) {
        lock(&self.broken).push(broken);
        self.restart_requested.store(true, Ordering::Release);
    }

    /// Resets the failure count after a call that succeeded.
    pub fn report_success(&self, exec: &mut Exec) {
        exec.failures_in_a_row = 0;
        self.failures.store(0, Ordering::Relaxed);
    }

    /// Whether a failed call asked for a restart since the last time.
    pub fn take_restart_request(&self) -> bool {
        self.restart_requested.swap(false, Ordering::Acquire)
    }

    /// The failed instances, for the caller to close.
    pub fn take_broken(&self) -> Vec<Instance> {
        std::mem::take(&mut *lock(&self.broken))
    }

    /// Failures in a row.
    pub fn failures(&self) -> u32 {
        self.failures.load(Ordering::Relaxed)
    }

    /// Counts a failure outside a call: an abandoned call or a restart that failed. Returns the new count.
    pub fn add_failure(&self) -> u32 {
        self.failures.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// Sets whether a restart would not cure the last error.
    pub fn set_permanent(&self, permanent: bool) {
        self.permanent.store(permanent, Ordering::Release);
    }

    /// Whether a restart would not cure the last error.
    pub fn is_permanent(&self) -> bool {
        self.permanent.load(Ordering::Acquire)
    }

    /// Begins a restart or a change of the instance; restarts that began before are outdated. Returns the new epoch.
    pub fn begin_restart(&self) -> u64 {
        self.restart_epoch.fetch_add(1, Ordering::AcqRel) + 1
    }

    /// Whether a newer restart or change began after this one.
    pub fn is_outdated(&self, epoch: u64) -> bool {
        self.restart_epoch.load(Ordering::Acquire) != epoch
    }

    /// Counts an abandoned call; returns how many have not returned.
    pub fn add_stuck(&self) -> u32 {
        self.stuck.fetch_add(1, Ordering::Relaxed) + 1
    }

    /// Counts an abandoned call that returned.
    pub fn remove_stuck(&self) {
        self.stuck.fetch_sub(1, Ordering::Relaxed);
    }

    /// Abandoned calls that have not returned.
    pub fn stuck(&self) -> u32 {
        self.stuck.load(Ordering::Relaxed)
    }

    /// Saves the position of a failed source.
    pub fn save_position(&self, _exec: &mut Exec, state: Vec<u8>) {
        *lock(&self.position) = Some(state);
    }

    /// Keeps the position of an isolated source.
    pub fn keep_position(&self, state: &[u8]) {
        let mut kept = lock(&self.kept_position);
        let kept = kept.get_or_insert_default();
        kept.clear();
        kept.extend_from_slice(state);
    }

    /// The next instance continues where the last one was kept, if it was.
    pub fn save_kept_position(&self) {
        if let Some(kept) = lock(&self.kept_position).take() {
            *lock(&self.position) = Some(kept);
        }
    }

    /// Drops the kept position, because the node has another instance with other positions.
    pub fn forget_kept_position(&self) {
        *lock(&self.kept_position) = None;
    }

    /// Position of a failed source. The caller puts back only what an instance understood, so that an instance that
    /// hangs on it does not get it twice.
    pub fn take_position(&self) -> Option<Vec<u8>> {
        lock(&self.position).take()
    }

    /// Puts a position back, unless a newer one was saved meanwhile.
    pub fn restore_position(&self, state: Vec<u8>) {
        lock(&self.position).get_or_insert(state);
    }
}
