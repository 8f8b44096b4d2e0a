//! The error of loading a plugin.

use std::path::{Path, PathBuf};

use crate::isolate::DescribeError;
use panoscope_graph::PluginProblem;

use crate::loader::elf::ElfError;
use crate::loader::file_name::is_python;

/// A Python plugin that cannot run.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoPython {
    /// There is no such interpreter.
    #[error("its interpreter {interpreter} does not exist", interpreter = interpreter.display())]
    Interpreter {
        /// Its file.
        interpreter: PathBuf,
    },
    /// The installation has no Python package.
    #[error("the Python package `panoscope` is missing in {folder}", folder = folder.display())]
    Package {
        /// Expected path.
        folder: PathBuf,
    },
    /// The metadata in the file's head are not TOML.
    #[error("its `# /// script` block is not valid: {reason}")]
    Metadata {
        /// The parser's message.
        reason: String,
    },
}

/// A plugin that was not loaded.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The file cannot be read.
    #[error("{file} cannot be read: {cause}", file = file.display())]
    Unreadable {
        /// The plugin's file.
        file: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The file is damaged or is not a plugin.
    #[error("{file} is not used: {cause}", file = file.display())]
    BadFile {
        /// The plugin's file.
        file: PathBuf,
        /// Description of the problem.
        cause: ElfError,
    },
    /// Built for another ABI.
    #[error("{file} was built for plugin ABI {found}, this host has ABI {expected}", file = file.display())]
    AbiMismatch {
        /// The plugin's file.
        file: PathBuf,
        /// Major number in the plugin's note.
        found: u32,
        /// Major number of this host.
        expected: u32,
    },
    /// Its sealed copy could not be made or read.
    #[error("{file} cannot be loaded: a copy in memory could not be made: {cause}", file = file.display())]
    Copy {
        /// The plugin's file.
        file: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The dynamic linker cannot load it.
    #[error("{file} cannot be loaded: {cause}", file = file.display())]
    Link {
        /// The plugin's file.
        file: PathBuf,
        /// The dynamic linker's message.
        cause: String,
    },
    /// It differs from the locked file.
    #[error("{file} was not loaded: it has changed since the graph was locked", file = file.display())]
    NotLocked {
        /// The plugin's file.
        file: PathBuf,
    },
    /// Its nodes run in separate processes, and it could not be described.
    #[error("{file} cannot be used: {cause}", file = file.display())]
    Undescribed {
        /// The plugin's file.
        file: PathBuf,
        /// Description of the process's end.
        cause: DescribeError,
    },
    /// A Python file without node classes.
    #[error("{file} is not used: it declares no node, as `@panoscope.node(...)` in front of a class does", file = file.display())]
    NoNodes {
        /// The file.
        file: PathBuf,
    },
    /// A Python file that cannot run.
    #[error("{file} cannot be used: {cause}", file = file.display())]
    NoPython {
        /// The file.
        file: PathBuf,
        /// What is missing.
        cause: NoPython,
    },
    /// Its descriptor is invalid.
    #[error("the descriptor of {file} is invalid: {cause}", file = file.display())]
    BadDescriptor {
        /// The plugin's file.
        file: PathBuf,
        /// Description of the problem.
        cause: String,
    },
}

impl LoadError {
    fn file(&self) -> &Path {
        match self {
            Self::Unreadable { file, .. }
            | Self::BadFile { file, .. }
            | Self::AbiMismatch { file, .. }
            | Self::Copy { file, .. }
            | Self::Link { file, .. }
            | Self::NotLocked { file }
            | Self::Undescribed { file, .. }
            | Self::NoNodes { file }
            | Self::NoPython { file, .. }
            | Self::BadDescriptor { file, .. } => file,
        }
    }

    fn help(&self) -> String {
        match self {
            Self::AbiMismatch { .. } => "rebuild the plugin against this version of panoscope".to_owned(),
            Self::BadFile { .. } | Self::BadDescriptor { .. } => "build or copy the plugin again".to_owned(),
            Self::NotLocked { .. } => "restore the file, or lock the graph again with `panoscope lock`".to_owned(),
            Self::Undescribed { cause, .. } if cause.to_string().contains("NumPy is missing") => {
                "install NumPy there, or name another interpreter: `python` of [tool.panoscope] in the file's `# /// script` block, or PANOSCOPE_PYTHON"
                    .to_owned()
            }
            Self::Undescribed { file, .. } if is_python(file) => {
                "correct the file; nothing of it has run in this process".to_owned()
            }
            Self::Undescribed { .. } => {
                "repair or replace the plugin; nothing of it has run in this process".to_owned()
            }
            Self::NoNodes { .. } => "declare a node in it, or move it out of the plugin folder".to_owned(),
            Self::NoPython { cause: NoPython::Interpreter { .. }, .. } => {
                "name one that exists as `python` of [tool.panoscope] in the file's `# /// script` block".to_owned()
            }
            Self::NoPython { cause: NoPython::Package { .. }, .. } => "install panoscope again".to_owned(),
            Self::NoPython { cause: NoPython::Metadata { .. }, .. } => "write the block as PEP 723 has it".to_owned(),
            Self::Link { cause, .. } => match packages_of(cause) {
                Some(packages) => format!("install the library: on Debian and Ubuntu `apt install {packages}`"),
                None => "install the library named above, or rebuild the plugin".to_owned(),
            },
            Self::Copy { cause, .. } | Self::Unreadable { cause, .. } if is_out_of_descriptors(cause) => {
                "all file descriptors of the process are in use; raise their number, as `ulimit -n` does".to_owned()
            }
            Self::Copy { .. } => "free memory; the copy has the size of the file".to_owned(),
            Self::Unreadable { .. } => "check the path and its permissions".to_owned(),
        }
    }

    /// The problem of `plugin` in the form of the graph checker, with help.
    pub fn problem(&self, plugin: &str) -> PluginProblem {
        PluginProblem {
            plugin: plugin.to_owned(),
            file: self.file().display().to_string(),
            message: self.to_string(),
            help: self.help(),
        }
    }
}

/// Whether this process, or the system, has run out of file descriptors.
fn is_out_of_descriptors(error: &std::io::Error) -> bool {
    matches!(error.raw_os_error(), Some(libc::EMFILE | libc::ENFILE))
}

/// Known Debian packages with the library that the dynamic linker did not find.
fn packages_of(message: &str) -> Option<&'static str> {
    let library = message.split([' ', ':', '`']).find(|word| word.starts_with("lib") && word.contains(".so"))?;
    let packages = if library.starts_with("libopencv") {
        "libopencv-dev libopencv-contrib-dev"
    } else if library.starts_with("libgst") {
        "libgstreamer1.0-0 libgstreamer-plugins-base1.0-0 libgstreamer-plugins-bad1.0-0 libgstrtspserver-1.0-0"
    } else {
        return None;
    };
    message.contains("cannot open shared object").then_some(packages)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_library_is_named_with_its_package() {
        let help = |library: &str| {
            let cause = format!("{library}: cannot open shared object file: No such file or directory");
            LoadError::Link { file: "x.so".into(), cause }.help()
        };
        assert!(
            help("libopencv_core.so.406").contains("`apt install libopencv-dev"),
            "{}",
            help("libopencv_core.so.406")
        );
        assert!(help("libgstrtspserver-1.0.so.0").contains("libgstrtspserver-1.0-0`"));
        assert_eq!(help("libother.so"), "install the library named above, or rebuild the plugin");
    }
}
