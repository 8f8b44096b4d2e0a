//! Finds, verifies and maps plugins.
//!
//! [`Loader`] reads the notes of the plugins in some folders, fills the graph crate's catalogue and maps the plugins
//! that a graph lists. [`graph_file`] checks a graph and starts it. [`Live`] is the running graph: it changes it by
//! editing its text, and swaps rebuilt plugins. [`lock`] records the fingerprints of all files that a run depends on,
//! [`keys`] signs them, and [`verify`] opens a graph only as it was locked.

mod copies;
pub mod depends;
pub mod elf;
mod error;
mod file_name;
mod foreign_models;
pub mod graph_file;
pub mod isolated;
pub mod keys;
pub mod live;
pub mod lock;
mod locked_file;
mod map;
pub mod needed;
mod plugin_file;
mod python;
mod seal;
pub mod sealed;
mod search;
mod stamp;
pub mod trial;
pub mod verify;

pub use error::{LoadError, NoPython};
pub use live::Live;
pub use locked_file::{Kind, LockedFile};
pub use map::{describe_verified, inspect, load, load_verified};
pub use plugin_file::{Loaded, PluginFile};
pub use python::{Python, cache_folder, module as python_module, package as python_package};
pub use search::{Loader, PLUGIN_PATH_VARIABLE, search_path};
pub use stamp::Stamp;
