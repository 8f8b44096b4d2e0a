//! Opens the theatre: checks the graph and compares it with its lock.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use panoscope_editor_model::texts::{Phrase, phrase, text};
use panoscope_graph::{Diagnostics, GraphText};
use panoscope_host::audit::LockFacts;
use panoscope_host::loader::keys::Trust;
use panoscope_host::loader::lock::{ALWAYS_LOCKED, Difference, Lock, LockError, lock_path};
use panoscope_host::loader::verify::{self, Seal, VerifyError};
use panoscope_host::loader::{Loader, graph_file};

use panoscope_monitor::Address;
use serde::{Deserialize, Serialize};

use super::audit;
use super::plan::Listens;
use super::refusal;
use super::{Plan, Refusal};
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
    /// Keys whose locks are accepted; with none, locks need no signature.
    pub trust: Trust,
    /// Folder of the audit log; `None` for no log.
    pub audit: Option<PathBuf>,
    /// Maximum number of ticks of each source.
    pub frames: Option<u64>,
    /// Where the process that runs the graph serves a page for reading; `None` for none.
    pub web: Option<Address>,
    /// Scale in addition to the one that follows the screen.
    pub scale: f32,
    /// Settings file of the foot pedal; without one it has the usual keys.
    pub pedal: Option<PathBuf>,
    /// Screenshots of the window, for `cargo xtask screens`.
    pub shot: Shot,
}

impl Options {
    /// Writes into the audit log that a graph was not opened.
    pub fn log_refusal(&self, path: &Path, refusal: &Refusal) {
        if let Some(folder) = &self.audit {
            audit::refused(folder, path, &refusal.reason);
        }
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            folder: PathBuf::from("out"),
            label: None,
            unlocked: false,
            trust: Trust::default(),
            audit: None,
            frames: None,
            web: None,
            scale: 1.0,
            pedal: None,
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
    /// The lock cannot be read, or is not to be believed.
    #[error("{0}\n  help: or open it with --unlocked")]
    Lock(#[from] LockError),
    /// ONNX Runtime cannot be loaded.
    #[error("ONNX Runtime is as it was locked, but cannot be loaded: {0}")]
    Runtime(String),
    /// The graph has no image.
    #[error("the graph has no image that the theatre can show")]
    NoPicture,
    /// A thread cannot be started.
    #[error("a thread could not be started: {0}")]
    Thread(#[from] std::io::Error),
    /// The machine that runs the graph is not reached.
    #[error("`{name}` is not reached: {problem}")]
    Machine {
        /// The machine.
        name: String,
        /// Why.
        problem: String,
    },
    /// The process that runs the graph ended before the graph was opened.
    #[error("the process that runs the graph {}", .0.english())]
    Worker(Phrase),
}

/// Whether the running graph was verified.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Verified {
    /// All files are as they were locked, and this key signed that.
    Signed(String),
    /// All files are as they were locked. The lock has no signature.
    AsLocked,
    /// The graph was never locked.
    Never,
    /// It was opened although it differs from its lock; with the first difference.
    Differs(String),
}

impl Verified {
    /// The mark that is shown as long as an unverified graph runs: heading, line, and both for a screen reader. `None` when the graph is as locked.
    pub fn mark(&self) -> Option<[&'static str; 3]> {
        match self {
            Self::AsLocked | Self::Signed(_) => None,
            Self::Never => Some([text!("mark-never"), text!("mark-never.line"), text!("mark-never.name")]),
            Self::Differs(_) => Some([text!("mark-differs"), text!("mark-differs.line"), text!("mark-differs.name")]),
        }
    }
}

/// What the window needs to know of a graph that was checked. It can be sent to another process.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Opened {
    pub(super) plan: Plan,
    pub(super) verified: Verified,
    /// One text of the graph file with its parts, overlays and arguments: what runs.
    pub(super) text: String,
    /// The lock that it agrees with, for the audit log.
    pub(super) lock: Option<LockFacts>,
    /// Why it would not have opened without `--unlocked`, for the audit log.
    pub(super) overridden: Option<String>,
    /// Whether it may read only the files of its lock.
    pub(super) sealed: bool,
}

/// A graph that was checked and can be run in this process.
pub struct Ready {
    pub(super) opened: Opened,
    pub(super) loader: Arc<Loader>,
    /// The files that the graph may read, where it runs under its lock.
    pub(super) seal: Option<Arc<Seal>>,
}

impl From<VerifyError> for OpenError {
    fn from(error: VerifyError) -> Self {
        match error {
            VerifyError::Differs(differences) => Self::Locked(differences),
            VerifyError::Check(diagnostics) => Self::Graph(diagnostics),
            VerifyError::Runtime(reason) => Self::Runtime(reason),
        }
    }
}

/// The lock of a graph, if it may be believed; `None` when the graph was never locked and need not be.
fn trusted_lock(path: &Path, trust: &Trust) -> Result<Option<(Lock, LockFacts)>, OpenError> {
    let Some(lock) = Lock::read(path)? else {
        // Who trusts keys accepts only what they signed.
        return match trust.is_empty() {
            true => Ok(None),
            false => Err(LockError::Never { graph: path.to_owned(), file: lock_path(path) }.into()),
        };
    };
    let facts = LockFacts { sha256: lock.digest(), signed_by: lock.check_signature(path, trust)? };
    Ok(Some((lock, facts)))
}

/// Opens a graph under its lock; `None` as for [`trusted_lock`]. Nothing of it has run where this is an error of the lock.
fn under_lock(parsed: &GraphText, trust: &Trust) -> Result<Option<(graph_file::Ready, LockFacts)>, OpenError> {
    let Some((lock, facts)) = trusted_lock(parsed.path(), trust)? else { return Ok(None) };
    Ok(Some((verify::open(parsed, &lock, &ALWAYS_LOCKED)?, facts)))
}

/// Loads what a graph needs that an earlier process opened under the lock `known`. Files that are not as they were locked are withheld: what does not
/// need them can run. `None` where the graph has another lock by now.
pub(super) fn reopen(
    parsed: &GraphText,
    trust: &Trust,
    known: Option<&LockFacts>,
) -> Result<Option<(Loader, Arc<Seal>)>, OpenError> {
    match trusted_lock(parsed.path(), trust)? {
        Some((lock, facts)) if Some(&facts) == known => Ok(Some(verify::reopen(parsed, &lock, &ALWAYS_LOCKED)?)),
        _ => Ok(None),
    }
}

impl Ready {
    /// Checks a graph's text, and compares it with its lock, with its plugins, models and calibration.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn check(path: &Path, text: &str, options: &Options) -> Result<Self, OpenError> {
        Self::of(&GraphText::parse(path, text), options)
    }

    /// As [`Self::check`], of a graph that was read with its parts, overlays and arguments.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn of(parsed: &GraphText, options: &Options) -> Result<Self, OpenError> {
        let mut overridden = None;
        let mut lock = None;
        let without_lock = || graph_file::ready(parsed).map_err(OpenError::Graph);
        let (checked, verified) = match under_lock(parsed, &options.trust) {
            Ok(Some((checked, facts))) => {
                let signed_by = lock.insert(facts).signed_by.clone();
                (checked, signed_by.map_or(Verified::AsLocked, Verified::Signed))
            }
            Ok(None) => (without_lock()?, Verified::Never),
            // Mistakes of the graph are no difference that can be overridden.
            Err(error @ OpenError::Graph(_)) => return Err(error),
            Err(error) if options.unlocked => {
                overridden = Some(refusal::reason(&error));
                let first = match &error {
                    OpenError::Locked(differences) => differences.first().map(ToString::to_string),
                    _ => None,
                };
                (without_lock()?, Verified::Differs(first.unwrap_or_else(|| error.to_string())))
            }
            Err(error) => return Err(error),
        };
        let graph_file::Ready { graph, catalog, loader, seal, .. } = checked;
        let mut plan = Plan::of(&graph, &catalog);
        if let Some(address) = options.web {
            let what = phrase!("listens-page", address = address.socket().to_string());
            plan.listening.push(Listens { what, is_public: address.is_public() });
        }
        if plan.views.is_empty() {
            return Err(OpenError::NoPicture);
        }
        let text = parsed.flattened(&catalog).into_owned();
        let opened = Opened { plan, verified, text, lock, overridden, sealed: seal.is_some() };
        Ok(Self { opened, loader, seal })
    }
}
