//! The engine in a simulated world: the sources of `core/runtime/engine` as `build.rs` lays them out.
#![allow(warnings, clippy::all, clippy::undocumented_unsafe_blocks, missing_docs)]

include!(concat!(env!("OUT_DIR"), "/engine/lib.rs"));

#[path = "../mutations.rs"]
mod mutations_of_sources;

/// Names of the mistakes that [`panoscope_sim_world::mutate`] switches on.
pub fn mutations() -> Vec<&'static str> {
    mutations_of_sources::MUTATIONS.iter().map(|(name, _)| *name).collect()
}

/// Makes the next run begin like the first of the process.
pub fn forget() {
    node::runner::forget_pause();
}

/// Byte of memory that nobody has written since it was handed out or given back.
pub const POISON: u8 = 0xDB;
/// No simulated frame is larger.
const POISONED_BYTES: usize = 1 << 16;

/// Overwrites a buffer that nobody uses.
pub(crate) unsafe fn poison(data: *mut u8, len: usize) {
    unsafe { data.write_bytes(POISON, len.min(POISONED_BYTES)) };
}
