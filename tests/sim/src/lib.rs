//! One simulator for the whole runtime: graphs with misbehaving nodes, a disk that fails and changes while they run, in a world in which threads,
//! locks, time and disk are derived from a seed.
//!
//! The engine is the real one, built from its sources with the threads, locks and clocks of [`crate::world`]; see `build.rs`. Frames
//! describe themselves ([`content`]), nodes check every byte of their inputs ([`nodes`]), and after a run [`check`] compares everything that was seen
//! with what the runtime guarantees.

pub mod case;
pub mod check;
pub mod content;
pub mod drive;
pub mod engine;
pub mod graphs;
pub mod harm;
pub mod nodes;
pub mod observe;
pub mod plan;
pub mod plugins;
pub mod world;

// The name by which the sources of the engine find the world.
extern crate self as panoscope_sim;
