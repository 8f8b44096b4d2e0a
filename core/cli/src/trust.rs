//! Trust settings of a command: keys that sign locks, and folders with plugins.

use std::path::PathBuf;

use anyhow::Result;
use panoscope_graph::{Deny, Diagnostics, GraphOptions, GraphText};
use panoscope_host::loader::graph_file::{self, Ready};
use panoscope_host::loader::keys::{PublicKey, Trust};
use panoscope_host::loader::{self as loader, Loader};

/// Keys that a command line adds to those of the installation.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Keys {
    /// Accepts locks signed by this public key, in addition to those in the folders of trusted keys; repeatable.
    #[arg(long, value_name = "FILE")]
    trust: Vec<PathBuf>,
}

impl Keys {
    /// All keys whose locks are accepted.
    pub fn trusted(&self) -> Result<Trust> {
        let mut trust = Trust::installed()?;
        for file in &self.trust {
            trust.add(PublicKey::read(file)?);
        }
        Ok(trust)
    }
}

/// Whether a command that only reads a graph may run code that the graph brings.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub struct OwnPlugins {
    /// Loads plugins from the folders that the graph itself names, which runs their code. By default only plugins of
    /// the installation and of PANOSCOPE_PLUGIN_PATH are loaded.
    #[arg(long)]
    trust_plugins: bool,
    #[command(flatten)]
    isolated: IsolatedPlugins,
}

/// Whether plugins that a graph brings may run in its process.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub struct IsolatedPlugins {
    /// Loads plugins from the folders that the graph itself names only in separate processes, which cannot open sockets
    /// or write files: none of their code runs in this one.
    #[arg(long)]
    isolate_plugins: bool,
}

impl IsolatedPlugins {
    /// Whether plugins that a graph brings are isolated.
    pub fn is_on(self) -> bool {
        self.isolate_plugins
    }

    /// The plugins for a graph that names the folders `own`.
    pub fn loader(self, own: &[PathBuf]) -> Loader {
        let loader = Loader::search(&loader::search_path(own));
        if self.isolate_plugins { loader.isolating(own) } else { loader }
    }

    /// Checks a graph that was read, with the plugins of [`Self::loader`], and isolates its own plugins, if requested.
    pub fn ready(self, text: &GraphText, loader: Loader) -> Result<Ready, Diagnostics> {
        let own = if self.isolate_plugins { loader.brought_by(&text.plugin_paths()) } else { Vec::new() };
        let mut ready = graph_file::ready_with(text, loader)?;
        ready.graph.isolate_plugins(&own, "foreign", Deny { network: true, new_files: true });
        Ok(ready)
    }
}

impl OwnPlugins {
    /// Whether code that a graph brings may run in this process.
    pub fn is_trusted(self) -> bool {
        self.trust_plugins
    }

    /// The plugins for a graph that names the folders `own`.
    pub fn loader(self, own: &[PathBuf]) -> Loader {
        match self.trust_plugins || self.isolated.isolate_plugins {
            true => self.isolated.loader(own),
            false => Loader::search_without_loading(own),
        }
    }

    /// Checks a graph that was read.
    pub fn ready(self, text: &GraphText) -> Result<Ready, Diagnostics> {
        self.isolated.ready(text, self.loader(&text.plugin_paths()))
    }

    /// Reads and checks a graph file.
    pub fn open(self, path: &std::path::Path, options: &GraphOptions) -> Result<Ready, Diagnostics> {
        self.ready(&GraphText::load_with(path, options)?)
    }
}
