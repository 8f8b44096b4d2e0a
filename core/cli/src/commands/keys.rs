//! `panoscope keys`: certificates with which machines authenticate each other.

use std::path::PathBuf;

use anyhow::Result;

use super::serve::machine_program;
use crate::End;

/// Arguments of `keys`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder for the authority's certificate and key, and a folder for each machine.
    folder: PathBuf,
    /// Machines, each with the addresses under which others reach it, as in `theatre rack=10.0.0.2`.
    #[arg(required = true, value_name = "NAME[=ADDRESS,...]")]
    machines: Vec<String>,
}

/// Makes the keys.
pub fn run(arguments: &Arguments) -> Result<End> {
    let mut command = machine_program()?;
    command.arg("keys").arg(&arguments.folder).args(&arguments.machines);
    Ok(if command.status()?.success() { End::Done } else { End::Wrong })
}
