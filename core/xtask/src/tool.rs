//! Cargo subcommands that are built once, in the target folder.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result};

use crate::process;
use crate::workspace::Workspace;

/// A cargo subcommand.
#[derive(Debug)]
pub struct Tool {
    /// The folder of a program that was built here; `None` if it is in PATH.
    folder: Option<PathBuf>,
}

impl Tool {
    /// Adds the program's folder to the command's PATH. PATH stays unchanged if possible, because build scripts that
    /// depend on it would run again.
    ///
    /// # Errors
    /// The path of the folder contains a colon.
    pub fn put_into(&self, command: &mut Command) -> Result<()> {
        if let Some(folder) = &self.folder {
            // Last, so that compilers are found where they were.
            let old = std::env::var_os("PATH").unwrap_or_default();
            let folders = std::env::split_paths(&old).chain([folder.clone()]);
            command.env("PATH", std::env::join_paths(folders)?);
        }
        Ok(())
    }
}

/// Builds a program unless it is in PATH or was built before.
///
/// # Errors
/// It cannot be built.
pub fn ensure(workspace: &Workspace, name: &str) -> Result<Tool> {
    if process::find_program(name).is_some() {
        return Ok(Tool { folder: None });
    }
    let root = workspace.target.join("tools");
    let folder = root.join("bin");
    if !folder.join(name).is_file() {
        println!("Building {name} (once, some minutes)");
        let mut cargo = workspace.cargo();
        cargo.args(["install", "--locked", "--root"]).arg(&root).arg(name);
        process::run(&mut cargo).with_context(|| format!("`{name}` was not installed"))?;
    }
    Ok(Tool { folder: Some(folder) })
}
