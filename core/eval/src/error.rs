//! Errors of evaluations and benches.

use std::error::Error;
use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

use panoscope_graph::Diagnostics;

/// A cause of any type.
pub type Cause = Box<dyn Error + Send + Sync>;

/// Result of evaluation code.
pub type Result<T, E = EvalError> = std::result::Result<T, E>;

/// Action on a file, a folder or a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileAction {
    /// Reading a file.
    Read,
    /// Writing a file.
    Write,
    /// Creating a folder.
    Create,
    /// Starting a program.
    Start,
}

impl fmt::Display for FileAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Read => "read",
            Self::Write => "write",
            Self::Create => "make",
            Self::Start => "start",
        })
    }
}

/// An evaluation or a bench without a result.
///
/// `Display` gives one line without the cause; [`chain`] appends the causes.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvalError {
    /// [`Session::is_cancelled`](crate::Session::is_cancelled) returned true.
    #[error("interrupted")]
    Cancelled,
    /// The options contradict each other, are out of range, or name something that does not exist. Nothing ran.
    #[error("{reason}")]
    Options {
        /// The problem and its correction.
        reason: String,
    },
    /// The user's graph has mistakes. Nothing ran.
    #[error("{}", diagnostics.render(false))]
    Check {
        /// The mistakes with their lines.
        diagnostics: Diagnostics,
    },
    /// A graph that the evaluation made does not pass the check.
    #[error("{diagnostics}")]
    Graph {
        /// The mistakes with their lines, rendered without colour, without a line break at the end.
        diagnostics: String,
    },
    /// A graph does not have what the evaluation needs.
    #[error("{reason}")]
    Wiring {
        /// What is missing.
        reason: String,
    },
    /// A run of a graph failed as a whole.
    #[error("{reason}")]
    Run {
        /// The engine's reason.
        reason: String,
    },
    /// A node failed in every call.
    #[error("node `{node}` failed: {reason}")]
    Node {
        /// Its name in the graph.
        node: String,
        /// Its last message.
        reason: String,
    },
    /// The graph does not have the output.
    #[error("there is no output {node}.{port}")]
    Output {
        /// Name of the node.
        node: String,
        /// Name of the output.
        port: String,
    },
    /// A run ended without data that the evaluation needs.
    #[error("{what}")]
    Incomplete {
        /// What is missing.
        what: String,
    },
    /// A table does not have the column.
    #[error("{table} has no column {column}")]
    Column {
        /// Whose table.
        table: &'static str,
        /// Name of the column.
        column: String,
    },
    /// A file, a folder or a program could not be used.
    #[error("cannot {action} {}", path.display())]
    File {
        /// Attempted action.
        action: FileAction,
        /// The file, folder or program.
        path: PathBuf,
        /// Why it failed.
        source: Cause,
    },
    /// An input file has the wrong content.
    #[error("{reason}")]
    Input {
        /// The file, the place in it, what was expected.
        reason: String,
    },
    /// Another program, run for comparison, failed or disagrees.
    #[error("{reason}")]
    Peer {
        /// The problem and its correction.
        reason: String,
    },
    /// Something failed at a known position.
    #[error("{place}")]
    At {
        /// Location: a file, a line, a step.
        place: String,
        /// Reason.
        source: Cause,
    },
    /// The engine did not start.
    #[error(transparent)]
    Start(#[from] panoscope_host::loader::graph_file::RunError),
    /// An operation of the system failed.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// JSON could not be read or written.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// Text is not TOML.
    #[error(transparent)]
    TomlRead(#[from] toml::de::Error),
    /// A table cannot be written as TOML.
    #[error(transparent)]
    TomlWrite(#[from] toml::ser::Error),
    /// A stereo algorithm refused its input.
    #[error(transparent)]
    Stereo(#[from] panoscope_imaging::stereo::StereoError),
    /// Views could not be put together.
    #[error(transparent)]
    Composite(#[from] panoscope_imaging::stitch::CompositeError),
    /// A calibration file could not be read or written.
    #[error(transparent)]
    Calibration(#[from] panoscope_data::calibration::FileError),
    /// A text describes no calibration board.
    #[error(transparent)]
    Board(#[from] panoscope_data::calibration::BoardError),
    /// A text of boxes cannot be read.
    #[error(transparent)]
    Labels(#[from] panoscope_data::truth::labels::LabelError),
    /// A map of true disparity or depth cannot be read.
    #[error(transparent)]
    Map(#[from] panoscope_data::truth::maps::MapError),
    /// An arm's description cannot be used.
    #[error(transparent)]
    Arm(#[from] panoscope_arm_core::ArmError),
    /// The arm's controller could not be tuned.
    #[error(transparent)]
    Tune(#[from] panoscope_arm_core::tuning::TuneError),
}

impl EvalError {
    /// An error of a file, folder or program.
    pub(crate) fn file(action: FileAction, path: impl AsRef<Path>, source: impl Into<Cause>) -> Self {
        Self::File { action, path: path.as_ref().to_owned(), source: source.into() }
    }
}

/// An error and all its causes in one line, separated by colons.
pub fn chain(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let _ = write!(text, ": {error}");
        cause = error.source();
    }
    text
}

/// Adds a location to an error, or makes an error from `None`.
pub(crate) trait Context<T> {
    /// Adds a fixed text.
    fn context(self, text: &str) -> Result<T>;
    /// Adds a text that is computed on error.
    fn with_context(self, text: impl FnOnce() -> String) -> Result<T>;
}

impl<T> Context<T> for Option<T> {
    fn context(self, text: &str) -> Result<T> {
        self.ok_or_else(|| EvalError::Incomplete { what: text.to_owned() })
    }

    fn with_context(self, text: impl FnOnce() -> String) -> Result<T> {
        self.ok_or_else(|| EvalError::Incomplete { what: text() })
    }
}

impl<T, E: Into<Cause>> Context<T> for std::result::Result<T, E> {
    fn context(self, text: &str) -> Result<T> {
        self.map_err(|source| EvalError::At { place: text.to_owned(), source: source.into() })
    }

    fn with_context(self, text: impl FnOnce() -> String) -> Result<T> {
        self.map_err(|source| EvalError::At { place: text(), source: source.into() })
    }
}

/// Names the file of an operation that failed.
pub(crate) trait OnFile<T> {
    /// `action` failed on `path`.
    fn on_file(self, action: FileAction, path: impl AsRef<Path>) -> Result<T>;
}

impl<T, E: Into<Cause>> OnFile<T> for std::result::Result<T, E> {
    fn on_file(self, action: FileAction, path: impl AsRef<Path>) -> Result<T> {
        self.map_err(|source| EvalError::file(action, path, source))
    }
}

/// Returns with an error about an input file.
macro_rules! bail {
    ($($argument:tt)*) => {
        return Err($crate::error::EvalError::Input { reason: format!($($argument)*) })
    };
}

/// Returns with an error about an input file unless a condition holds.
macro_rules! ensure {
    ($condition:expr, $($argument:tt)*) => {
        if $condition {
        } else {
            $crate::error::bail!($($argument)*);
        }
    };
}

pub(crate) use {bail, ensure};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_names_the_file_and_the_cause() {
        let missing = std::fs::read("/nonexistent/truth.json").on_file(FileAction::Read, "/nonexistent/truth.json");
        let error = missing.expect_err("there is no such file");
        assert_eq!(error.to_string(), "cannot read /nonexistent/truth.json");
        let text = chain(&error);
        assert!(text.starts_with("cannot read /nonexistent/truth.json: No such file"), "{text}");
        assert_eq!(chain(&EvalError::Cancelled), "interrupted");
    }
}
