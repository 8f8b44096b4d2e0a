//! Programs next to this one, which replace it for some commands, so that it needs neither a window system nor the
//! crates that only they use.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result};

use crate::End;
use crate::terminal::log;

/// Name of the program that runs graphs.
pub const PROGRAM: &str = "panoscope";
/// Names of the programs of the windows.
pub const EDITOR: &str = "panoscope-editor";
/// Name of the program of the surgeon's window.
pub const THEATRE: &str = "panoscope-theatre";
/// Name of the program with the commands that evaluate, convert and generate.
pub const LAB: &str = "panoscope-lab";
/// Id of the argument that [`Words`] has and no other command.
pub const WORDS: &str = "words-of-the-lab";

/// Arguments of a command of the program [`LAB`], which parses them.
#[derive(clap::Args)]
#[command(disable_help_flag = true)]
pub struct Words {
    #[arg(id = WORDS, trailing_var_arg = true, allow_hyphen_values = true)]
    _words: Vec<OsString>,
}

/// File of a program of this installation.
///
/// # Errors
/// The system does not report which file runs.
pub fn file(program: &str) -> std::io::Result<PathBuf> {
    std::env::current_exe().map(|this| this.with_file_name(program))
}

/// Replaces this process by the program [`LAB`] with the same command line. Returns only on failure.
pub(crate) fn lab() -> Result<End> {
    start(LAB, |command| {
        let mut words = std::env::args_os();
        // Its help and errors name the program that was called.
        if let Some(name) = words.next() {
            command.arg0(name);
        }
        command.args(words);
    })
}

/// Replaces this process by another program with the arguments that `arrange` adds. Returns only on failure.
pub(crate) fn start(program: &str, arrange: impl FnOnce(&mut Command)) -> Result<End> {
    let file = file(program).context("the path of this program is unknown")?;
    if !file.is_file() {
        log!(
            "error: the program of this command is missing: {} does not exist\n  help: `cargo xtask build` builds it",
            file.display()
        );
        return Ok(End::Failed);
    }
    let mut command = Command::new(&file);
    arrange(&mut command);
    Err(command.exec()).with_context(|| format!("{} does not start", file.display()))
}
