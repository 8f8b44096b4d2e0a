//! Opens the theatre: checks the graph and compares it with its lock.

use std::path::{Path, PathBuf};

use panoscope_graph::{Diagnostics, GraphText, check};
use panoscope_loader::lock::{ALWAYS_LOCKED, Difference, Lock, LockError};
use panoscope_loader::{self as loader, Loader};

use super::Plan;
use panoscope_editor_widgets::Shot;

/// Options of the theatre.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder for stills and clips.
    pub folder: PathBuf,
    /// Prefix of the names of stills and clips.
    pub label: Option<String>,
    /// Whether to open the graph even if it differs from its lock.
    pub unlocked: bool,
    /// Maximum number of ticks of each source.
    pub frames: Option<u64>,
    /// Scale in addition to the one that follows the screen.
    pub scale: f32,
    /// Screenshots of the window, for `cargo xtask screens`.
    pub shot: Shot,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            folder: PathBuf::from("out"),
            label: None,
            unlocked: false,
            frames: None,
            scale: 1.0,
            shot: Shot::default(),
        }
    }
}

/// Why the theatre could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The graph has mistakes.
    #[error("{}", .0.render(false).trim_end())]
    Graph(Diagnostics),
    /// The graph differs from its lock.
    #[error("the graph differs from its lock:\n{}\n  help: restore the files, lock the graph again with `panoscope lock`, or open it with --unlocked",
        .0.iter().map(|d| format!("  {d}")).collect::<Vec<_>>().join("\n"))]
    Locked(Vec<Difference>),
    /// The lock cannot be read.
    #[error("{0}\n  help: or open it with --unlocked")]
    Lock(#[from] LockError),
    /// The graph has no image.
    #[error("the graph has no image that the theatre can show")]
    NoPicture,
    /// A thread cannot be started.
    #[error("a thread could not be started: {0}")]
    Thread(#[from] std::io::Error),
}

impl OpenError {
    /// The error as shown on a terminal.
    pub fn terminal_text(&self) -> String {
        match self {
            Self::Graph(diagnostics) => diagnostics.render(false).trim_end().to_owned(),
            other => format!("error: {other}"),
        }
    }
}

/// Whether the running graph was verified.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verified {
    /// All files are as they were locked.
    AsLocked,
    /// The graph was never locked.
    Never,
    /// It was opened although it differs from its lock; with the first difference.
    Differs(String),
}

impl Verified {
    /// The mark that is shown as long as an unverified graph runs: heading and line. `None` when the graph is as locked.
    pub fn mark(&self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::AsLocked => None,
            Self::Never => Some(("NOT LOCKED", "this graph was not verified")),
            Self::Differs(_) => Some(("UNLOCKED", "changed since it was verified")),
        }
    }
}

/// The differences between the lock and the current files; `None` when the graph was never locked.
fn compare(path: &Path, now: &Lock) -> Result<Option<Vec<Difference>>, LockError> {
    Ok(Lock::read(path)?.map(|was| was.differences(now)))
}

/// A graph that was checked and can be opened in the theatre.
pub struct Ready {
    pub(super) plan: Plan,
    pub(super) verified: Verified,
    /// One text of the graph file with its parts, overlays and arguments: what runs.
    pub(super) text: String,
    pub(super) plugin_paths: Vec<PathBuf>,
}

impl Ready {
    /// Checks a graph's text, and compares it with its lock, with its plugins, models and calibration.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn check(path: &Path, text: &str, unlocked: bool) -> Result<Self, OpenError> {
        Self::of(&GraphText::parse(path, text), unlocked)
    }

    /// As [`Self::check`], of a graph that was read with its parts, overlays and arguments.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn of(parsed: &GraphText, unlocked: bool) -> Result<Self, OpenError> {
        let path = parsed.path();
        let loader = Loader::search(&loader::search_path(&parsed.plugin_paths()));
        let catalog = loader.catalog(&parsed.plugins());
        let (graph, _) = check(parsed, &catalog).into_result().map_err(OpenError::Graph)?;
        let now = Lock::of(&graph, &catalog, &loader, parsed, &ALWAYS_LOCKED);
        let verified = match compare(path, &now) {
            Ok(None) => Verified::Never,
            Ok(Some(differences)) => match differences.first() {
                None => Verified::AsLocked,
                Some(first) if unlocked => Verified::Differs(first.to_string()),
                Some(_) => return Err(OpenError::Locked(differences)),
            },
            Err(error) if unlocked => Verified::Differs(error.to_string()),
            Err(error) => return Err(error.into()),
        };
        let plan = Plan::of(&graph, &catalog);
        if plan.views.is_empty() {
            return Err(OpenError::NoPicture);
        }
        let text = parsed.flattened(&catalog).into_owned();
        Ok(Self { plan, verified, text, plugin_paths: parsed.plugin_paths() })
    }
}
