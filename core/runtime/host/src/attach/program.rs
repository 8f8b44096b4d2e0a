//! The program that carries frames to another machine.

use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use crate::isolate::MACHINE_PROGRAM;
use panoscope_graph::Listener;

/// Environment variable that names the folder with the keys of this machine.
pub const KEYS_VARIABLE: &str = "PANOSCOPE_KEYS";

/// Ways of listening, off by default.
pub const LISTENERS: &[Listener] = &[Listener {
    option: "run --attachable ADDRESS",
    what: "zenoh, windows of other machines",
    default_address: "tls/ or tcp/127.0.0.1, as given",
    access: "machines of --allow-read and --allow-edit read outputs and parameters; those of --allow-edit change the graph",
}];

/// The file of the program, next to this one; test programs are in a folder below.
fn file() -> io::Result<PathBuf> {
    let me = panoscope_base::program::file();
    let beside = me.as_ref().map(|me| me.with_file_name(MACHINE_PROGRAM));
    let above = me.as_ref().and_then(|me| Some(me.parent()?.parent()?.join(MACHINE_PROGRAM)));
    let found = [beside, above].into_iter().flatten().find(|file| file.is_file());
    found.ok_or_else(|| {
        let words =
            format!("the program `{MACHINE_PROGRAM}`, which links machines, is missing; install Panoscope again");
        io::Error::new(io::ErrorKind::NotFound, words)
    })
}

/// Starts the program with a socket as its standard input, and with the keys in a folder.
pub fn start(arguments: &[String], keys: Option<&Path>) -> io::Result<(Child, UnixStream)> {
    let (ours, theirs) = UnixStream::pair()?;
    let mut command = Command::new(file()?);
    if let Some(keys) = keys {
        command.env(KEYS_VARIABLE, keys);
    }
    command.args(arguments).stdin(Stdio::from(OwnedFd::from(theirs))).stdout(Stdio::null()).stderr(Stdio::piped());
    Ok((command.spawn()?, ours))
}

/// The last line of a process's standard error.
pub fn last_words(child: &mut Child) -> Option<String> {
    let mut text = String::new();
    // The process has ended, or is about to; what it wrote is short.
    let from = io::Read::take(child.stderr.take()?, 64 << 10);
    io::Read::read_to_string(&mut { from }, &mut text).ok()?;
    let line = text.lines().rev().find(|line| !line.trim().is_empty())?;
    Some(line.strip_prefix("error: ").unwrap_or(line).to_owned())
}
