//! `panoscope edit` and `panoscope theatre`: start the editor, a program of its own beside this one, so that the command needs no window system.

use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result};

use crate::End;
use crate::terminal::log;

/// The programs of the windows, each beside this one.
const EDITOR: &str = "panoscope-editor";
const THEATRE: &str = "panoscope-theatre";

/// Arguments of `edit` and `theatre`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file.
    graph: PathBuf,
    /// Further arguments of the editor; `panoscope-editor --help` and `panoscope-theatre --help` show them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    rest: Vec<String>,
}

/// Becomes the editor, or with `theatre` the surgeon's window.
pub fn run(arguments: &Arguments, theatre: bool) -> Result<End> {
    // The editor offers templates for a file that is to be; it looks after the rest.
    let new = !theatre && !arguments.graph.exists() && arguments.graph.extension().is_some_and(|e| e == "toml");
    if !arguments.graph.is_file() && !new {
        log!("error: there is no graph file {}", arguments.graph.display());
        return Ok(End::Wrong);
    }
    let this = std::env::current_exe().context("this program's own place is not known")?;
    let beside = this.with_file_name(if theatre { THEATRE } else { EDITOR });
    if !beside.is_file() {
        log!(
            "error: the window's program is missing: {} does not exist\n  help: `cargo xtask build` builds it",
            beside.display()
        );
        return Ok(End::Failed);
    }
    let error = Command::new(&beside).arg(&arguments.graph).args(&arguments.rest).exec();
    Err(error).with_context(|| format!("{} does not start", beside.display()))
}
