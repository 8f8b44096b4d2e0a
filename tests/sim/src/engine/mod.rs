//! The engine in a simulated world: the sources of `core/runtime/engine` as `build.rs` prepares them, under this module.
#![allow(warnings, clippy::all, clippy::undocumented_unsafe_blocks, missing_docs)]

include!(concat!(env!("OUT_DIR"), "/engine/lib.rs"));

#[path = "mutations.rs"]
mod mutations_of_sources;

/// Names of the defects that [`crate::world::mutate`] enables.
pub fn mutations() -> Vec<&'static str> {
    mutations_of_sources::MUTATIONS.iter().map(|(name, _)| *name).collect()
}

/// Makes the next run start like the first one of the process.
pub fn forget() {
    node::runner::forget_pause();
}

/// Value of memory that has not been written since it was allocated or released.
pub const POISON: u8 = 0xDB;
/// Maximum size of a simulated frame, bytes.
const POISONED_BYTES: usize = 1 << 16;

/// Overwrites an unused buffer.
pub(crate) unsafe fn poison(data: *mut u8, len: usize) {
    unsafe { data.write_bytes(POISON, len.min(POISONED_BYTES)) };
}
