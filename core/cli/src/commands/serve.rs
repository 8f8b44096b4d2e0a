//! `panoscope serve`: runs nodes of graphs of other machines. The program that links machines does the work.

use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Result, bail};
use panoscope_host::isolate::MACHINE_PROGRAM;

use crate::End;

/// Arguments of `serve`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Name of this machine in graphs: nodes with `on = "NAME"` run here.
    #[arg(long)]
    name: String,
    /// Where to listen: tls/ADDRESS:PORT; tcp/127.0.0.1:PORT for hosts on this machine.
    #[arg(long, value_name = "ADDRESS")]
    listen: String,
    /// Hosts that may run nodes here, by the names in their certificates.
    #[arg(long, value_name = "NAME")]
    allow: Vec<String>,
    /// Folder with the keys of this machine, made by `panoscope keys`; default: PANOSCOPE_KEYS.
    #[arg(long, value_name = "DIR")]
    keys: Option<PathBuf>,
    /// Folder that replaces the folder of a host's graph, for relative paths of nodes.
    #[arg(long, value_name = "DIR", default_value = ".")]
    graph_dir: PathBuf,
    /// Listens without encryption and accepts every host, even if other machines can reach the address.
    #[arg(long)]
    plaintext: bool,
}

/// The program that links machines: it is next to this one.
pub(super) fn machine_program() -> Result<Command> {
    let folder = panoscope_base::program::folder().unwrap_or_default();
    let program = folder.join(MACHINE_PROGRAM);
    if !program.is_file() {
        bail!("the program {}, which links machines, is missing; install Panoscope again", program.display());
    }
    Ok(Command::new(program))
}

/// Replaces this process by the serving program.
pub fn run(arguments: &Arguments) -> Result<End> {
    let Arguments { name, listen, allow, keys, graph_dir, plaintext } = arguments;
    let mut command = machine_program()?;
    command.args(["serve", name, listen]).arg(keys.clone().unwrap_or_default()).arg(graph_dir);
    command.arg(plaintext.to_string()).args(allow);
    Err(command.exec().into())
}
