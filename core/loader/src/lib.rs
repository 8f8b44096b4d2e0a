//! Finds, verifies and maps plugins.
//!
//! [`Loader`] reads the notes of the plugins in some folders, fills the graph crate's catalogue and maps the plugins that a graph lists.
//! [`Live`] changes a running graph by editing its text, and swaps rebuilt plugins. [`lock`] compares files with recorded fingerprints.

pub mod elf;
mod error;
pub mod isolated;
pub mod live;
pub mod lock;
mod map;
mod search;

pub use error::LoadError;
pub use live::Live;
pub use map::{Loaded, PluginFile, inspect, load};
pub use search::{Loader, PLUGIN_PATH_VARIABLE, Stamp, search_path};
