//! Why a plugin could not be used.

use std::path::{Path, PathBuf};

use panoscope_graph::PluginProblem;

use crate::elf::ElfError;

/// Why a plugin could not be used.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The file cannot be read.
    #[error("{file} cannot be read: {cause}", file = file.display())]
    Unreadable {
        /// The plugin's file.
        file: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// The file is no whole plugin.
    #[error("{file} is not used: {cause}", file = file.display())]
    BadFile {
        /// The plugin's file.
        file: PathBuf,
        /// What is wrong with it.
        cause: ElfError,
    },
    /// Built for another host.
    #[error("{file} was built for plugin ABI {found}, this host speaks {expected}", file = file.display())]
    AbiMismatch {
        /// The plugin's file.
        file: PathBuf,
        /// Major number in the plugin's note.
        found: u32,
        /// Major number of this host.
        expected: u32,
    },
    /// The dynamic linker refused it.
    #[error("{file} does not load: {cause}", file = file.display())]
    Link {
        /// The plugin's file.
        file: PathBuf,
        /// What the dynamic linker says.
        cause: String,
    },
    /// It loaded, but what it says of itself makes no sense.
    #[error("{file} describes itself wrongly: {cause}", file = file.display())]
    BadDescriptor {
        /// The plugin's file.
        file: PathBuf,
        /// What is wrong.
        cause: String,
    },
}

impl LoadError {
    fn file(&self) -> &Path {
        match self {
            Self::Unreadable { file, .. }
            | Self::BadFile { file, .. }
            | Self::AbiMismatch { file, .. }
            | Self::Link { file, .. }
            | Self::BadDescriptor { file, .. } => file,
        }
    }

    fn help(&self) -> String {
        match self {
            Self::AbiMismatch { .. } => "rebuild the plugin against this version of panoscope".to_owned(),
            Self::BadFile { .. } | Self::BadDescriptor { .. } => "build or copy the plugin again".to_owned(),
            Self::Link { .. } => "install the library that is named, or rebuild the plugin".to_owned(),
            Self::Unreadable { .. } => "check the path and its permissions".to_owned(),
        }
    }

    /// For the graph checker.
    pub fn problem(&self, plugin: &str) -> PluginProblem {
        PluginProblem {
            plugin: plugin.to_owned(),
            file: self.file().display().to_string(),
            message: self.to_string(),
            help: self.help(),
        }
    }
}
