//! The peer of nodes in Python: a Python node of dora (`pip install dora-rs dora-rs-cli pyarrow`), on the same machine
//! in the same run.

use std::path::Path;
use std::process::Command;

use crate::error::{FileAction, OnFile, Result};

const PEER: &str = include_str!("dora_peer.py");
/// Maximum number of seconds that a run may take.
const MAX_RUN_S: &str = "60";

/// Whether dora is installed: its program, and its module for Python.
pub fn is_there() -> bool {
    let works = |command: &mut Command| command.output().is_ok_and(|output| output.status.success());
    works(Command::new("dora").arg("--version")) && works(Command::new("python3").args(["-c", "import dora, pyarrow"]))
}

/// Median round-trip time of an image to a Python node, ns, including the sender's Python. `None` if dora did not run.
///
/// # Errors
/// The folder cannot be written.
pub fn round_trip_ns(folder: &Path, width: u32, height: u32, frames: u64) -> Result<Option<f64>> {
    let (peer, flow, result) = (folder.join("dora_peer.py"), folder.join("flow.yml"), folder.join("dora.txt"));
    std::fs::write(&peer, PEER).on_file(FileAction::Write, &peer)?;
    let text = format!(
        "nodes:\n  - id: sender\n    path: dora_peer.py\n    args: send {width} {height} {frames} {}\n    inputs:\n      image: echo/image\n    \
         outputs: [image]\n  - id: echo\n    path: dora_peer.py\n    args: echo\n    inputs:\n      image: sender/image\n    outputs: [image]\n",
        result.display()
    );
    std::fs::write(&flow, text).on_file(FileAction::Write, &flow)?;
    let _ = std::fs::remove_file(&result);
    let mut run = Command::new("timeout");
    // What it says is of no interest; what it measured is in the file.
    let _ = run.args([MAX_RUN_S, "dora", "run", "flow.yml"]).current_dir(folder).output();
    Ok(std::fs::read_to_string(&result).ok().and_then(|text| text.trim().parse().ok()))
}
