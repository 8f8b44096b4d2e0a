//! `panoscope generate`: manual pages and shell completions, for packages.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Command;
use clap_complete::{Shell, generate_to};

use panoscope_cli::End;

/// Arguments of `panoscope generate`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Folder to write `man/` and `completions/` into.
    dir: PathBuf,
}

/// Writes the manual page of each command and completions for bash, zsh and fish.
pub fn run(arguments: &Arguments, command: Command) -> Result<End> {
    let man = folder(&arguments.dir, "man")?;
    clap_mangen::generate_to(command.clone(), &man).with_context(|| format!("cannot write {}", man.display()))?;
    let completions = folder(&arguments.dir, "completions")?;
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        generate_to(shell, &mut command.clone(), "panoscope", &completions)
            .with_context(|| format!("cannot write {}", completions.display()))?;
    }
    Ok(End::Done)
}

fn folder(dir: &Path, name: &str) -> Result<PathBuf> {
    let folder = dir.join(name);
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    Ok(folder)
}
