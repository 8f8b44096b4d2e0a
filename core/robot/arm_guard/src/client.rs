//! The program's side: starts the guard, sends requests, reads its state.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use panoscope_arm_core::Cause;
use panoscope_arm_core::interlock::Event;
use panoscope_arm_core::line::Serial;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, Shutdown, SocketFlags, SocketType, recv, send, shutdown, socketpair,
};
use thiserror::Error;

use crate::clock;
use crate::message::{MAX_LEN, Report, Request, Status};
use crate::target::Target;

/// Name of the guard's program.
pub const PROGRAM: &str = "panoscope-arm";
/// Variable that names the guard's program.
pub const PROGRAM_VARIABLE: &str = "PANOSCOPE_ARM";
/// Time limit of the guard's start.
const START_WITHIN: Duration = Duration::from_secs(5);
/// Silence after which a guard that followed counts as gone, ns. It reports every 10 ms.
const SILENT_NS: i64 = 250_000_000;
/// Time limit of its end, which includes braking the arm.
const END_WITHIN: Duration = Duration::from_secs(3);

/// Error of the client.
#[derive(Debug, Error)]
pub enum GuardError {
    /// The guard's program is not installed.
    #[error(
        "`{PROGRAM}` is not next to the program ({looked}); install Panoscope completely, or set {PROGRAM_VARIABLE} to its path"
    )]
    NoProgram {
        /// Locations that were searched.
        looked: String,
    },
    /// The program cannot be started.
    #[error("{path} cannot be started: {cause}", path = path.display())]
    Start {
        /// The program.
        path: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// The guard refuses because the arm is absent or in use.
    #[error("{0}")]
    Refused(String),
    /// The guard does not report.
    #[error("the arm's guard did not report within {} s", START_WITHIN.as_secs())]
    Silent,
    /// Standard input is not a socket.
    #[error("standard input is not a socket: {0}")]
    NoSocket(io::Error),
}

/// The guard's socket, handed over as standard input.
///
/// # Errors
/// Standard input is not a socket.
pub fn inherited_socket() -> Result<OwnedFd, GuardError> {
    let stdin = io::stdin().as_fd().try_clone_to_owned().map_err(GuardError::NoSocket)?;
    rustix::net::sockopt::socket_type(&stdin).map_err(|error| GuardError::NoSocket(error.into()))?;
    Ok(stdin)
}

/// The program: [`PROGRAM_VARIABLE`], else next to the running program or one folder above it.
///
/// # Errors
/// It does not exist.
pub fn program() -> Result<PathBuf, GuardError> {
    if let Some(path) = std::env::var_os(PROGRAM_VARIABLE).filter(|value| !value.is_empty()) {
        return Ok(path.into());
    }
    let own = panoscope_base::program::file().unwrap_or_default();
    let candidates: Vec<PathBuf> = own.ancestors().skip(1).take(2).map(|folder| folder.join(PROGRAM)).collect();
    candidates.iter().find(|path| path.is_file()).cloned().ok_or_else(|| GuardError::NoProgram {
        looked: candidates.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", "),
    })
}

/// A running guard.
pub struct Guard {
    child: Child,
    socket: OwnedFd,
    status: Status,
    serial: Serial,
    watchdog_ms: u32,
    granted: (bool, bool),
    has_ended: bool,
}

impl Guard {
    /// Starts the guard of an arm; an empty `urdf` is the shipped arm. `latches` is the folder of latched stops; `None`
    /// for the default. Waits until the guard has found the arm.
    ///
    /// # Errors
    /// The guard is not installed, or does not find the arm: the error gives its reason.
    pub fn start(target: impl Into<Target>, urdf: &Path, latches: Option<&Path>) -> Result<Self, GuardError> {
        let path = program()?;
        let failed = |cause: io::Error| GuardError::Start { path: path.clone(), cause };
        let (ours, theirs) = socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)
            .map_err(|error| failed(error.into()))?;
        let mut command = Command::new(&path);
        command.args(target.into().arguments());
        if !urdf.as_os_str().is_empty() {
            command.arg("--arm").arg(urdf);
        }
        if let Some(folder) = latches {
            command.arg("--latches").arg(folder);
        }
        // In a process group of its own: Ctrl-C in a terminal ends the program, and the guard then brakes the arm.
        command.stdin(Stdio::from(theirs)).stdout(Stdio::null()).stderr(Stdio::null()).process_group(0);
        let child = command.spawn().map_err(failed)?;
        // The command holds the guard's end of the socket; without it the end of the guard is seen.
        drop(command);
        let mut guard = Self {
            child,
            socket: ours,
            status: Status::default(),
            serial: Serial::default(),
            watchdog_ms: 0,
            granted: (false, false),
            has_ended: false,
        };
        guard.wait_for_start()?;
        Ok(guard)
    }

    fn wait_for_start(&mut self) -> Result<(), GuardError> {
        let deadline = Instant::now() + START_WITHIN;
        let mut is_ready = false;
        loop {
            match self.receive() {
                Some(Report::Ready { serial, watchdog_ms, granted }) => {
                    (self.serial, self.watchdog_ms, self.granted) = (serial, watchdog_ms, granted);
                    is_ready = true;
                }
                Some(Report::Failed(reason)) => return Err(GuardError::Refused(reason)),
                Some(Report::Status(status)) => {
                    self.status = *status;
                    if is_ready {
                        return Ok(());
                    }
                }
                Some(Report::Event(_)) => {}
                None if self.has_ended => {
                    return Err(GuardError::Refused("the arm's guard ended at its start".to_owned()));
                }
                None => {
                    let left = deadline.saturating_duration_since(Instant::now());
                    if left.is_zero() {
                        return Err(GuardError::Silent);
                    }
                    let timeout = Timespec { tv_sec: 0, tv_nsec: left.subsec_nanos().clamp(1, 100_000_000).into() };
                    let _ = poll(&mut [PollFd::new(&self.socket, PollFlags::IN)], Some(&timeout));
                }
            }
        }
    }

    /// The next record; `None` when there is none, or the guard has ended.
    fn receive(&mut self) -> Option<Report> {
        let mut buffer = [0; MAX_LEN];
        loop {
            match recv(self.socket.as_fd(), &mut buffer, RecvFlags::DONTWAIT) {
                Ok((_, 0)) => {
                    self.has_ended = true;
                    return None;
                }
                Ok((_, length)) => {
                    if let Some(report) = Report::decode(&buffer[..length.min(MAX_LEN)]) {
                        return Some(report);
                    }
                }
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return None,
                Err(_) => {
                    self.has_ended = true;
                    return None;
                }
            }
        }
    }

    /// Sends a request. Never waits: when the guard does not read, the request is lost, and the arm stops.
    pub fn request(&mut self, request: &Request) {
        let mut out = [0; MAX_LEN];
        let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
        if matches!(send(self.socket.as_fd(), request.encode(&mut out), flags), Err(Errno::PIPE | Errno::CONNRESET)) {
            self.has_ended = true;
        }
    }

    /// The newest state. Calls `event` once for each new event. `None` when the guard has ended. If a guard stops
    /// reporting while it followed, the arm's own watchdog holds the arm and the state is [`Cause::GuardGone`].
    pub fn status(&mut self, mut event: impl FnMut(Event)) -> Option<Status> {
        let mut has_reported = false;
        while let Some(report) = self.receive() {
            has_reported = true;
            match report {
                Report::Status(status) => self.status = *status,
                Report::Event(next) => event(next),
                Report::Ready { .. } | Report::Failed(_) => {}
            }
        }
        if self.has_ended {
            return None;
        }
        // A release takes time, but the guard is stopped then. Old records that waited here are followed by new ones.
        let is_old = clock::now_ns().saturating_sub(self.status.at_ns) > SILENT_NS;
        if is_old && !has_reported && self.status.stop.is_none() {
            return Some(Status { stop: Some(Cause::GuardGone), latched: true, ..self.status });
        }
        Some(self.status)
    }

    /// The newest state that was received, also after the guard's end.
    pub fn last_status(&self) -> &Status {
        &self.status
    }

    /// Serial number of the arm.
    pub fn serial(&self) -> &str {
        self.serial.as_str()
    }

    /// Time limit of the arm's own watchdog, ms.
    pub fn watchdog_ms(&self) -> u32 {
        self.watchdog_ms
    }

    /// Whether the guard's memory is locked, and whether it has real-time priority.
    pub fn granted(&self) -> (bool, bool) {
        self.granted
    }

    /// Process number of the guard.
    pub fn process_id(&self) -> u32 {
        self.child.id()
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        // The guard sees the end of the connection, brakes the arm and ends.
        let _ = shutdown(&self.socket, Shutdown::Write);
        let deadline = Instant::now() + END_WITHIN;
        while Instant::now() < deadline {
            if !matches!(self.child.try_wait(), Ok(None)) {
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        // It hangs: the arm's own watchdog holds the arm.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
