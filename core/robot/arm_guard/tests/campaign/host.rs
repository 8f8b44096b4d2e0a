//! The program that steers the arm, as a process of its own that can be killed.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};

/// A running program.
pub struct Host {
    child: Child,
    lines: BufReader<ChildStdout>,
}

impl Host {
    /// Starts it. Waits until its guard runs.
    ///
    /// # Errors
    /// The program cannot be started, or does not get the arm: its reason.
    pub fn start(device: &str, latches: &Path, rad_s: f64) -> Result<Self, String> {
        let mut command = Command::new(env!("CARGO_BIN_EXE_panoscope-arm-host"));
        command
            .arg(device)
            .arg(latches)
            .arg(rad_s.to_string())
            .env("PANOSCOPE_ARM", env!("CARGO_BIN_EXE_panoscope-arm"));
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().map_err(|error| error.to_string())?;
        let lines = BufReader::new(child.stdout.take().ok_or("no output")?);
        let mut host = Self { child, lines };
        match host.line() {
            line if line.starts_with("guard ") => Ok(host),
            line => Err(line),
        }
    }

    /// The next line that it writes; empty after its end.
    pub fn line(&mut self) -> String {
        let mut line = String::new();
        let _ = self.lines.read_line(&mut line);
        line.trim_end().to_owned()
    }

    /// Gives it a command. One that has ended takes none.
    pub fn command(&mut self, words: &str) {
        if let Some(input) = &mut self.child.stdin {
            let _ = writeln!(input, "{words}").and_then(|()| input.flush());
        }
    }

    /// Sends it a signal. One that has ended takes none.
    pub fn signal(&self, signal: Signal) {
        if let Some(id) = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw) {
            let _ = kill_process(id, signal);
        }
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
