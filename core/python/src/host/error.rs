//! Errors as exceptions of the package.

use panoscope_graph::Diagnostics;
use panoscope_host::loader::live::LiveError;
use panoscope_record::{RecordingError, ReplayError};
use pyo3::prelude::*;

/// Module of the package with the exceptions.
const ERRORS: &str = "panoscope.errors";

/// An error that becomes an exception.
pub enum Problem {
    /// A graph has mistakes.
    Graph(Diagnostics),
    /// A graph cannot be used as requested.
    Use(String),
    /// A run did not start, or failed.
    Run(String),
    /// A change of a running graph was refused.
    Edit(String),
    /// A recording cannot be used.
    Recording(String),
}

impl From<Diagnostics> for Problem {
    fn from(diagnostics: Diagnostics) -> Self {
        Self::Graph(diagnostics)
    }
}

impl From<RecordingError> for Problem {
    fn from(error: RecordingError) -> Self {
        Self::Recording(error.to_string())
    }
}

impl From<LiveError> for Problem {
    fn from(error: LiveError) -> Self {
        match error {
            LiveError::Check(diagnostics) => Self::Graph(diagnostics),
            other => Self::Edit(other.to_string()),
        }
    }
}

impl From<ReplayError> for Problem {
    fn from(error: ReplayError) -> Self {
        match error {
            ReplayError::Check(diagnostics) => Self::Graph(diagnostics),
            ReplayError::Start(error) => Self::Run(error.to_string()),
            other => Self::Recording(other.to_string()),
        }
    }
}

impl Problem {
    /// The exception: an instance of a class of the package.
    pub fn raise(self, py: Python<'_>) -> PyErr {
        let (class, words, diagnostics) = match self {
            Self::Graph(diagnostics) => {
                let list = serde_json::to_string(&diagnostics).unwrap_or_default();
                ("GraphError", diagnostics.render(false).trim_end().to_owned(), list)
            }
            Self::Use(words) => ("GraphError", words, String::new()),
            Self::Run(words) => ("RunError", words, String::new()),
            Self::Edit(words) => ("EditError", words, String::new()),
            Self::Recording(words) => ("RecordingError", words, String::new()),
        };
        let exception = || -> PyResult<PyErr> {
            let class = py.import(ERRORS)?.getattr(class)?;
            let exception =
                if diagnostics.is_empty() { class.call1((words,))? } else { class.call1((words, diagnostics))? };
            Ok(PyErr::from_value(exception))
        };
        exception().unwrap_or_else(|error| error)
    }
}
