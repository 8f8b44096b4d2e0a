//! `panoscope edit` and `panoscope theatre`: start the editor, a separate program next to this one, so that the command
//! needs no window system.

use std::path::PathBuf;

use anyhow::Result;

use crate::terminal::log;
use crate::{End, beside};

/// Arguments of `edit` and `theatre`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Graph file.
    #[arg(required_unless_present = "attach", allow_hyphen_values = true)]
    graph: Option<PathBuf>,
    /// Shows the graph that runs on another machine with `panoscope run --attachable`: NAME@ADDRESS as in
    /// rack@tls/10.0.0.2:7448, or a NAME of machines.toml in the folder panoscope of the user's configuration.
    #[arg(long, value_name = "NAME[@ADDRESS]")]
    attach: Option<String>,
    /// Further arguments of the editor; `panoscope-editor --help` and `panoscope-theatre --help` show them.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    rest: Vec<String>,
}

/// Replaces this process by the editor, or with `theatre` the surgeon's window.
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
    beside::start(if theatre { beside::THEATRE } else { beside::EDITOR }, |command| {
        if let Some(name) = &arguments.attach {
            command.args(["--attach", name]);
        }
        command.args(&arguments.graph).args(&arguments.rest);
    })
}
