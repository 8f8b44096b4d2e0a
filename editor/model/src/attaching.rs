//! Attaches a window to the graph of another machine when it starts.

use std::path::PathBuf;
use std::time::Duration;

use panoscope_host::attach::{Attachment, Target};

use crate::arguments;

/// How long a machine may take to be reached at first.
pub const REACH: Duration = Duration::from_secs(10);

/// Begins to attach to a machine: `NAME@ADDRESS`, or a name of `machines.toml` in the user's folder. `keys` is the folder with this machine's keys.
///
/// # Errors
/// The machine is not known, or a thread cannot be started; in words.
pub fn open(name: &str, keys: Option<PathBuf>) -> Result<Attachment, String> {
    let target = Target::find(name, arguments::config_folder().as_deref()).map_err(|error| error.to_string())?;
    Attachment::open(Target { keys, ..target }).map_err(|error| error.to_string())
}

/// Waits until the machine is reached: without a window nobody would see why it takes time.
///
/// # Errors
/// It is not reached within [`REACH`], in words.
pub fn wait(attachment: &Attachment) -> Result<(), String> {
    match attachment.wait_opened(REACH) {
        true => Ok(()),
        false => Err(format!("`{}` is not reached: {}", attachment.target().name, attachment.state().problem)),
    }
}
