//! Parts of the engine for a plugin loader: the host's function table, and names for crash reports.

use std::path::Path;
use std::sync::OnceLock;

use panoscope_abi as abi;
use panoscope_graph::Validator;

use crate::current_node;
use crate::host;

/// The host's function table for a plugin; valid until the process ends.
///
/// `descriptor` is the plugin's own description. It identifies the plugin and is not read.
pub fn plugin_table(descriptor: *const abi::Plugin) -> *const abi::Host {
    match OTHER_TABLE.get() {
        Some(table) => std::ptr::from_ref(*table),
        None => host::plugin_table(descriptor),
    }
}

static OTHER_TABLE: OnceLock<&'static abi::Host> = OnceLock::new();

/// Sets the table for plugins that are loaded later, in a process that runs nodes of another process's graph. Only the
/// first call has an effect.
pub fn use_table(table: &'static abi::Host) {
    let _ = OTHER_TABLE.set(table);
}

/// Runs code of a plugin's file that belongs to no node yet: constructors, its description. A crash report names the
/// file.
pub fn run<T>(file: &Path, work: impl FnOnce() -> T) -> T {
    current_node::loading(file, work)
}

/// A plugin was loaded: a crash report of a node of these types names this file.
pub fn remember(entries: &[&'static abi::NodeType], file: &Path) {
    current_node::loaded(entries, file);
}

/// Wraps a check of parameters so that a crash report names its node type and file.
pub fn guard_check(node_type: &str, file: &Path, validator: Validator) -> Validator {
    current_node::checking(node_type, file, validator)
}
