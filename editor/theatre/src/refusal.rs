//! Why the theatre did not open, in words for the window, the terminal and the audit log.

use std::path::Path;

use panoscope_editor_model::session::first_mistake;
use panoscope_editor_model::texts::{Phrase, phrase};
use serde::{Deserialize, Serialize};

use super::OpenError;

/// An [`OpenError`] in words, which can be sent to another process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    pub(super) heading: Phrase,
    /// The causes, each a line or a listing.
    pub(super) causes: Vec<String>,
    /// The remedies, the best one first, each with the command for it.
    pub(super) remedies: Vec<(Phrase, Option<String>)>,
    /// The error in one text.
    pub(super) message: String,
    /// The error on one line: the first of its causes.
    pub(super) line: String,
    /// The error as shown on a terminal.
    pub(super) terminal_text: String,
    /// For the audit log: names no files that a user chose.
    pub(super) reason: String,
    /// Whether the graph has mistakes. Other arguments may fix them.
    pub(super) is_mistake: bool,
}

/// Why a graph was refused or is overridden, for the audit log. The names of files that a user chose are left out.
pub(super) fn reason(error: &OpenError) -> String {
    match error {
        OpenError::Locked(differences) => {
            let kinds: Vec<String> = differences.iter().map(|d| d.kind.to_string()).collect();
            format!("{} files differ from the lock: {}", kinds.len(), kinds.join(", "))
        }
        OpenError::Lock(_) => "the lock is not valid".to_owned(),
        OpenError::Graph(_) => "the graph has mistakes".to_owned(),
        OpenError::NoPicture => "the graph has no image".to_owned(),
        OpenError::Runtime(_) => "ONNX Runtime cannot be loaded".to_owned(),
        OpenError::Thread(_) => "a thread could not be started".to_owned(),
        OpenError::Worker(_) => "the image processing could not be started".to_owned(),
        OpenError::Machine { .. } => "the machine was not reached".to_owned(),
    }
}

impl Refusal {
    /// The words for the error of opening the graph file at `path`.
    pub fn of(path: &Path, error: &OpenError) -> Self {
        let (name, file) = (path.file_name().unwrap_or(path.as_os_str()).to_string_lossy(), path.display());
        let (lock, unlocked) = (format!("panoscope lock {file}"), format!("panoscope theatre {file} --unlocked"));
        let (heading, causes, remedies) = match error {
            OpenError::Locked(differences) => (
                phrase!("refused-differs", file = name),
                differences.iter().map(ToString::to_string).collect(),
                vec![
                    (phrase!("remedy-restore"), None),
                    (phrase!("remedy-lock-again"), Some(lock)),
                    (phrase!("remedy-unlocked"), Some(unlocked)),
                ],
            ),
            OpenError::Lock(error) => (
                phrase!("refused-lock", file = name),
                vec![error.to_string()],
                vec![(phrase!("remedy-lock"), Some(lock)), (phrase!("remedy-unlocked"), Some(unlocked))],
            ),
            OpenError::Graph(diagnostics) => (
                phrase!("refused-mistakes", file = name),
                vec![diagnostics.render(false).trim_end().to_owned()],
                vec![(phrase!("remedy-edit"), Some(format!("panoscope edit {file}")))],
            ),
            OpenError::Runtime(_) => (
                phrase!("refused-start", file = name),
                vec![error.to_string()],
                vec![(phrase!("remedy-install"), Some(lock))],
            ),
            OpenError::NoPicture => (
                phrase!("refused-no-picture", file = name),
                vec![error.to_string()],
                vec![(phrase!("remedy-views"), None)],
            ),
            OpenError::Thread(_) => (
                phrase!("refused-start", file = name),
                vec![error.to_string()],
                vec![(phrase!("remedy-close-programs"), None)],
            ),
            OpenError::Worker(_) => (
                phrase!("refused-start", file = name),
                vec![error.to_string()],
                vec![(phrase!("remedy-check"), Some(format!("panoscope check {file}")))],
            ),
            OpenError::Machine { name, .. } => (
                phrase!("refused-machine", machine = name),
                vec![error.to_string()],
                vec![(phrase!("remedy-attachable"), None)],
            ),
        };
        let terminal_text = match error {
            OpenError::Graph(diagnostics) => diagnostics.render(false).trim_end().to_owned(),
            other => format!("error: {other}"),
        };
        let line = match error {
            OpenError::Locked(differences) => differences.first().map(ToString::to_string),
            OpenError::Graph(diagnostics) => first_mistake(diagnostics),
            other => other.to_string().lines().next().map(str::to_owned),
        };
        Self {
            line: line.unwrap_or_else(|| error.to_string()),
            heading,
            causes,
            remedies,
            message: error.to_string(),
            terminal_text,
            reason: reason(error),
            is_mistake: matches!(error, OpenError::Graph(_)),
        }
    }

    /// The error as shown on a terminal.
    pub fn terminal_text(&self) -> &str {
        &self.terminal_text
    }
}
