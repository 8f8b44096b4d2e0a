//! Opening the theatre: what is asked for, and whether the graph is fit for it and as it was locked.

use std::path::{Path, PathBuf};

use panoscope_graph::{Diagnostics, GraphText, check};
use panoscope_loader::lock::{Difference, Lock, LockError, THEATRE_PLUGINS};
use panoscope_loader::{self as loader, Loader};

use super::Plan;
use panoscope_editor_widgets::Shot;

/// How the theatre is opened.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where stills and clips go.
    pub folder: PathBuf,
    /// Begins the names of files, if it is asked for.
    pub label: Option<String>,
    /// Opens although the graph differs from its lock.
    pub unlocked: bool,
    /// Most ticks of each source.
    pub frames: Option<u64>,
    /// Size of everything beside the one that follows the screen.
    pub scale: f32,
    /// Pictures of the window, for `cargo xtask screens`.
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

/// Why the theatre did not open.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The graph is wrong.
    #[error("{}", .0.render(false).trim_end())]
    Graph(Diagnostics),
    /// The graph differs from its lock.
    #[error("this preset is not as it was locked:\n{}\n  help: put it back, lock it anew with `panoscope lock`, or open it with --unlocked",
        .0.iter().map(|d| format!("  {d}")).collect::<Vec<_>>().join("\n"))]
    Locked(Vec<Difference>),
    /// The lock cannot be read.
    #[error("{0}\n  help: or open it with --unlocked")]
    Lock(#[from] LockError),
    /// Nothing of the graph can be shown.
    #[error("this graph makes no picture that the theatre could show")]
    NoPicture,
    /// The system gave no thread.
    #[error("no thread could be started: {0}")]
    Thread(#[from] std::io::Error),
}

impl OpenError {
    /// As it is shown on a terminal.
    pub fn told(&self) -> String {
        match self {
            Self::Graph(diagnostics) => diagnostics.render(false).trim_end().to_owned(),
            other => format!("error: {other}"),
        }
    }
}

/// Whether somebody has verified what runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verified {
    /// All is as it was locked.
    AsLocked,
    /// The graph was never locked.
    Never,
    /// It differs from its lock in this, and was opened all the same.
    Differs(String),
}

impl Verified {
    /// What must be said on the screen for as long as it runs: a heading and a line; nothing where all is as it was locked.
    pub fn words(&self) -> Option<(&'static str, &'static str)> {
        match self {
            Self::AsLocked => None,
            Self::Never => Some(("NOT LOCKED", "nobody verified this graph")),
            Self::Differs(_) => Some(("UNLOCKED", "not as it was verified")),
        }
    }
}

/// What is wrong between a lock and now; `None` when the graph was never locked.
fn compare(path: &Path, now: &Lock) -> Result<Option<Vec<Difference>>, LockError> {
    Ok(Lock::read(path)?.map(|was| was.differences(now)))
}

/// A graph that was looked at and found to be fit for the theatre.
pub struct Ready {
    pub(super) plan: Plan,
    pub(super) verified: Verified,
    /// One text of the graph file with its parts, overlays and arguments: what runs.
    pub(super) text: String,
    pub(super) plugin_paths: Vec<PathBuf>,
}

impl Ready {
    /// Checks a graph file's text and compares it, its plugins, models and calibration with its lock.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn look(path: &Path, text: &str, unlocked: bool) -> Result<Self, OpenError> {
        Self::of(&GraphText::parse(path, text), unlocked)
    }

    /// As [`Self::look`], of a graph that was read with its parts, overlays and arguments.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn of(parsed: &GraphText, unlocked: bool) -> Result<Self, OpenError> {
        let path = parsed.path();
        let loader = Loader::search(&loader::search_path(&parsed.plugin_paths()));
        let catalog = loader.catalog(&parsed.plugins());
        let (graph, _) = check(parsed, &catalog).into_result().map_err(OpenError::Graph)?;
        let now = Lock::of(&graph, &catalog, &loader, parsed, &THEATRE_PLUGINS);
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
