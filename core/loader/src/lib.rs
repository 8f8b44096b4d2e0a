//! Finds, verifies and maps plugins.
//!
//! [`Loader`] reads the notes of the plugins in some folders and fills the graph crate's catalogue; it maps those that a graph lists.
//! [`Live`] changes a running graph by its text, with plugins that were built again. [`lock`] compares files with fingerprints.

pub mod elf;
mod error;
pub mod live;
pub mod lock;
mod map;
mod search;

pub use error::LoadError;
pub use live::Live;
pub use map::{Found, Loaded, inspect, load};
pub use search::{Loader, PLUGIN_PATH_VARIABLE, Stamp, search_path};
