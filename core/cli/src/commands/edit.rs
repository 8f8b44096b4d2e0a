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
    #[arg(required_unless_present = "attach", allow_hyphen_values = true)]
    graph: Option<PathBuf>,
    /// Shows the graph that runs on another machine with `panoscope run --attachable`: NAME@ADDRESS as in rack@tls/10.0.0.2:7448, or a NAME of
    /// machines.toml in the folder panoscope of the user's configuration.
    #[arg(long, value_name = "NAME[@ADDRESS]")]
    attach: Option<String>,
    /// Further arguments of the editor; `panoscope-editor --help` and `panoscope-theatre --help` show them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    rest: Vec<String>,
}

/// Becomes the editor, or with `theatre` the surgeon's window.
pub fn run(arguments: &Arguments, theatre: bool) -> Result<End> {
    // The editor offers templates for a file that is to be; it looks after the rest.
    // With --attach the first word may be an option of the window.
    if let Some(graph) = arguments.graph.as_ref().filter(|_| arguments.attach.is_none()) {
        let new = !theatre && !graph.exists() && graph.extension().is_some_and(|e| e == "toml");
        if !graph.is_file() && !new {
            log!("error: there is no graph file {}", graph.display());
            return Ok(End::Wrong);
        }
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
    let mut command = Command::new(&beside);
    if let Some(name) = &arguments.attach {
        command.args(["--attach", name]);
    }
    let error = command.args(&arguments.graph).args(&arguments.rest).exec();
    Err(error).with_context(|| format!("{} does not start", beside.display()))
}
