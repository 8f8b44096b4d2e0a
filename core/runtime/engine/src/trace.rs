//! Tracing of ticks through a run, with the times of each call.

use panoscope_abi::Tick;

/// A call of a node for a tick. Times are ns of [`crate::clock::now_ns`].
#[derive(Clone, Copy, Debug)]
pub struct Call<'a> {
    /// The node.
    pub node: &'a str,
    /// The tick.
    pub tick: &'a Tick,
    /// Begin of the call.
    pub start_ns: u64,
    /// End of the call.
    pub end_ns: u64,
    /// False if the node was skipped or failed, so that its outputs are empty.
    pub made: bool,
    /// Bytes of its inputs.
    pub read_bytes: u64,
    /// Bytes of its outputs.
    pub made_bytes: u64,
}

/// Receives every call of a node and every dropped tick. The engine's threads call it between two nodes: it must be
/// quick and must not wait.
pub trait Tracer: Send + Sync {
    /// A node was called, or skipped for a tick, on the calling thread.
    fn call(&self, call: &Call<'_>);

    /// A live source's tick was dropped at the head of its region, because a newer one arrived before there was room.
    fn dropped(&self, node: &str, seq: u64, at_ns: u64);
}
