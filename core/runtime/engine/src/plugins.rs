//! Source of the code of node types.

use std::path::PathBuf;
use std::sync::Arc;

use panoscope_abi as abi;

use crate::isolation::Isolator;
use crate::vet::Vet;

/// Loaded plugins.
pub trait Plugins {
    /// The entry of a node type of a plugin.
    fn entry(&self, plugin: &str, node_type: &str) -> Option<&'static abi::NodeType>;

    /// Makes the processes of isolated nodes; `None` if isolation is not available.
    fn isolator(&self) -> Option<Arc<dyn Isolator>> {
        None
    }

    /// Decides which nodes are opened on trial in a separate process first; `None` for no trials.
    fn vet(&self) -> Option<Arc<dyn Vet>> {
        None
    }

    /// Names and files of those given plugins that were found.
    fn files(&self, plugins: &[String]) -> Vec<(String, PathBuf)>;
}

impl<P: Plugins + ?Sized> Plugins for Arc<P> {
    fn entry(&self, plugin: &str, node_type: &str) -> Option<&'static abi::NodeType> {
        (**self).entry(plugin, node_type)
    }

    fn isolator(&self) -> Option<Arc<dyn Isolator>> {
        (**self).isolator()
    }

    fn vet(&self) -> Option<Arc<dyn Vet>> {
        (**self).vet()
    }

    fn files(&self, plugins: &[String]) -> Vec<(String, PathBuf)> {
        (**self).files(plugins)
    }
}
