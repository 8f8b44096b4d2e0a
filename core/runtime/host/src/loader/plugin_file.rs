//! A plugin's file, before and after it is loaded.

use std::path::PathBuf;

use panoscope_abi as abi;
use panoscope_graph::NodeType;

use crate::loader::elf::Note;
use crate::loader::python::Python;

/// A plugin's file and its note.
#[derive(Clone, Debug)]
pub struct PluginFile {
    /// The shared library.
    pub file: PathBuf,
    /// The note in the file.
    pub note: Note,
    /// The interpreter that runs it, if it is not a library.
    pub python: Option<Python>,
}

/// A loaded plugin. It stays mapped until the process ends.
#[derive(Clone)]
pub struct Loaded {
    /// The file that it was loaded from.
    pub plugin: PluginFile,
    /// Its node types, for the catalogue.
    pub node_types: Vec<NodeType>,
    /// Its node types in the same order, for the engine.
    pub entries: Vec<&'static abi::NodeType>,
}
