//! Why the theatre did not open, in words for the window, the terminal and the audit log.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::OpenError;

/// The last remedy for a difference from the lock.
const UNVERIFIED: &str = "Or open it unverified; a mark on the screen will show this:";

/// An [`OpenError`] in words, which can be sent to another process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    pub(super) heading: String,
    /// The causes, each a line or a listing.
    pub(super) causes: Vec<String>,
    /// The remedies, the best one first, each with the command for it.
    pub(super) remedies: Vec<(String, Option<String>)>,
    /// The error in one text.
    pub(super) message: String,
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
                format!("{name} differs from its lock"),
                differences.iter().map(ToString::to_string).collect(),
                vec![
                    ("Restore the changed files.", None),
                    ("Or verify the graph as it is now, and lock it again:", Some(lock)),
                    (UNVERIFIED, Some(unlocked)),
                ],
            ),
            OpenError::Lock(error) => (
                format!("The lock of {name} is not valid"),
                vec![error.to_string()],
                vec![("Verify the graph, and lock it again:", Some(lock)), (UNVERIFIED, Some(unlocked))],
            ),
            OpenError::Graph(diagnostics) => (
                format!("{name} has mistakes"),
                vec![diagnostics.render(false).trim_end().to_owned()],
                vec![("Correct them in the editor:", Some(format!("panoscope edit {file}")))],
            ),
            OpenError::Runtime(_) => (
                format!("{name} could not be started"),
                vec![error.to_string()],
                vec![("Install Panoscope again, then verify the graph and lock it:", Some(lock))],
            ),
            OpenError::NoPicture => (
                format!("{name} has no image"),
                vec![error.to_string()],
                vec![("Name outputs with images in `views` of `[preset]`.", None)],
            ),
            OpenError::Thread(_) => (
                format!("{name} could not be started"),
                vec![error.to_string()],
                vec![("Close other programs, then open it again.", None)],
            ),
            OpenError::Worker(_) => (
                format!("{name} could not be started"),
                vec![error.to_string()],
                vec![("Find the plugin that crashes:", Some(format!("panoscope check {file}")))],
            ),
            OpenError::Machine { name, .. } => (
                format!("`{name}` is not reached"),
                vec![error.to_string()],
                vec![("Start the graph there with --attachable, and name this machine with --allow-read:", None)],
            ),
        };
        let terminal_text = match error {
            OpenError::Graph(diagnostics) => diagnostics.render(false).trim_end().to_owned(),
            other => format!("error: {other}"),
        };
        Self {
            heading,
            causes,
            remedies: remedies.into_iter().map(|(remedy, command)| (remedy.to_owned(), command)).collect(),
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
