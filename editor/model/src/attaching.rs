//! Attaches a window to the graph of another machine when it starts.

use std::path::PathBuf;
use std::time::Duration;

use panoscope_host::attach::{Attachment, Target, TargetError};

use crate::arguments;

/// Why a window is not attached.
#[derive(Debug, thiserror::Error)]
pub enum AttachError {
    /// The machine is not known.
    #[error(transparent)]
    Target(#[from] TargetError),
    /// A thread cannot be started.
    #[error(transparent)]
    Thread(#[from] std::io::Error),
    /// The machine does not answer.
    #[error("`{name}` is not reached: {problem}")]
    NotReached {
        /// Its name.
        name: String,
        /// The last problem.
        problem: String,
    },
}

/// How long a machine may take to be reached at first.
pub const REACH: Duration = Duration::from_secs(10);

/// Begins to attach to a machine: `NAME@ADDRESS`, or a name of `machines.toml` in the user's folder. `keys` is the folder with this machine's keys.
///
/// # Errors
/// The machine is not known, or a thread cannot be started.
pub fn open(name: &str, keys: Option<PathBuf>) -> Result<Attachment, AttachError> {
    let target = Target::find(name, arguments::config_folder().as_deref())?;
    Ok(Attachment::open(Target { keys, ..target })?)
}

/// Waits until the machine is reached: without a window nobody would see why it takes time.
///
/// # Errors
/// It is not reached within [`REACH`].
pub fn wait(attachment: &Attachment) -> Result<(), AttachError> {
    if attachment.wait_opened(REACH) {
        return Ok(());
    }
    Err(AttachError::NotReached {
        name: attachment.target().name.clone(),
        problem: attachment.state().problem.to_string(),
    })
}
