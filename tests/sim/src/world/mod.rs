//! A simulated operating system for code written for the standard library: threads, locks, condition variables, atomics, clocks and a disk, with the
//! same names and signatures as in `std`.
//!
//! The threads of a [world](run) are real threads, of which one runs at a time. Wherever a thread locks, waits, reads a clock or accesses an atomic,
//! the world may let another thread run instead; a generator with the world's seed decides which. Time passes only when no thread can run: then it
//! jumps to the next deadline. A run is therefore repeated exactly by its seed, and seconds of waiting cost nothing.
//!
//! Not simulated: the memory model (all atomics are sequentially consistent), and preemption between two operations of this crate.

pub mod collections;
pub mod disk;
pub mod hint;
mod mutations;
mod random;
mod scheduler;
pub mod sync;
pub mod thread;
pub mod time;

pub use mutations::{is_mutated, mutate};
pub use random::Dice;
pub use scheduler::{Ended, Left, Settings, Trouble, is_inside, note, point, run};
