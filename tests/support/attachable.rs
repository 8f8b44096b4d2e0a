//! A `panoscope run` to which windows attach, for tests of windows. Tests include this file as a module.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::channel;
use std::time::Duration;

/// A running graph; killed when dropped.
pub struct Attachable {
    child: Child,
}

/// The program `panoscope` next to a program of the same build, or the one that tests name.
fn program(beside: &str) -> Option<PathBuf> {
    let given = std::env::var_os("PANOSCOPE_BIN").map(PathBuf::from);
    given
        .or_else(|| Some(Path::new(beside).with_file_name("panoscope")))
        .filter(|program| program.is_file() && program.with_file_name("panoscope-machine").is_file())
}

/// An unused address of this machine.
pub fn free_address() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    format!("tcp/{}", listener.local_addr().expect("an address"))
}

impl Attachable {
    /// Runs a graph file at an address with more options; `None` where there is no program.
    pub fn start(beside: &str, graph: &Path, address: &str, options: &[&str]) -> Option<Self> {
        let mut command = Command::new(program(beside)?);
        command.args(["run", "--headless", "--attachable", address]).args(options).arg(graph);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("the program starts");
        let lines = BufReader::new(child.stderr.take().expect("standard error")).lines();
        let (listens, heard) = channel();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let _ = listens.send(line);
            }
        });
        let this = Self { child };
        let mut log = Vec::new();
        while let Ok(line) = heard.recv_timeout(Duration::from_secs(30)) {
            if line.contains("windows attach to") {
                return Some(this);
            }
            log.push(line);
        }
        panic!("it does not listen: {log:?}")
    }
}

impl Drop for Attachable {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
