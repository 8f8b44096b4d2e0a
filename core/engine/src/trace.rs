//! Who follows ticks through a run, with the times of each call.

use panoscope_abi::Tick;

/// Receives every call of a node and every dropped tick. The engine's threads call it between two nodes: it must be quick and must not wait.
///
/// Times are ns of [`crate::clock::now_ns`].
pub trait Tracer: Send + Sync {
    /// A node was called for a tick. `made` is false where it was skipped or failed; then its outputs are empty.
    fn call(&self, node: &str, tick: &Tick, start_ns: u64, end_ns: u64, made: bool);

    /// A live source's tick was dropped at the head of its region, because a newer one came before there was room.
    fn dropped(&self, node: &str, seq: u64, at_ns: u64);
}
