//! A serial line that is read without waiting, and the errors of all connections to arms.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use panoscope_arm_core::Cause;
use rustix::fs::{FlockOperation, OFlags};
use rustix::termios::{self, OptionalActions};
use thiserror::Error;

/// Error of a connection to an arm.
#[derive(Debug, Error)]
pub enum PortError {
    /// The device cannot be opened.
    #[error("{path} cannot be opened: {cause}; is the arm plugged in, and may this user read and write the device?", path = path.display())]
    Open {
        /// The device's file.
        path: PathBuf,
        /// The system's error.
        cause: std::io::Error,
    },
    /// The file is not a serial line.
    #[error("{path} is not a serial line: {cause}", path = path.display())]
    NoLine {
        /// The device's file.
        path: PathBuf,
        /// The system's error.
        cause: std::io::Error,
    },
    /// Another process drives the arm.
    #[error("{path}: another program drives this arm; end it first", path = path.display())]
    InUse {
        /// The device's file.
        path: PathBuf,
    },
    /// The arm speaks another version of the protocol.
    #[error("{path}: the arm speaks version {theirs} of the line protocol, this program needs version {ours}: update the arm's firmware", path = path.display())]
    OtherProtocol {
        /// The device's file.
        path: PathBuf,
        /// The arm's version.
        theirs: u32,
        /// This program's version.
        ours: u32,
    },
    /// The device does not answer in the arm's protocol.
    #[error("{path}: no arm answered within {wait_ms} ms ({garbage} lines were malformed)", path = path.display())]
    NoArm {
        /// The device's file.
        path: PathBuf,
        /// Time waited, ms.
        wait_ms: u128,
        /// Received lines that are not answers.
        garbage: u32,
    },
    /// The connection was lost.
    #[error("the connection to the arm was lost: {0}")]
    Gone(std::io::Error),
    /// Nothing answers at a network address.
    #[error("{place} cannot be reached: {cause}; is the robot switched on and connected, and is this its address?")]
    NotReached {
        /// Host and port.
        place: String,
        /// The system's error.
        cause: std::io::Error,
    },
    /// The robot's controller lacks something that the protocol needs.
    #[error("{place}: {what}; {advice}")]
    Unsuitable {
        /// Host and port.
        place: String,
        /// What it does not do.
        what: String,
        /// What to do.
        advice: &'static str,
    },
    /// The robot cannot follow set-points now.
    #[error("{place}: {cause}; {advice}")]
    NotReady {
        /// Host and port.
        place: String,
        /// Reason.
        cause: Cause,
        /// What to do.
        advice: &'static str,
    },
    /// Received data is not a package of the protocol.
    #[error("the data from {place} is malformed; is this the robot's RTDE port?")]
    Unreadable {
        /// Host and port.
        place: String,
    },
}

impl PortError {
    /// Cause of the arm's stop when its connection fails in this way.
    pub fn cause(&self) -> Cause {
        match self {
            Self::NotReady { cause, .. } => *cause,
            Self::Unreadable { .. } => Cause::Garbage,
            _ => Cause::Unplugged,
        }
    }
}

/// An open serial line.
#[derive(Debug)]
pub struct Port {
    file: File,
}

impl Port {
    /// Opens a device as raw bytes at a speed.
    ///
    /// # Errors
    /// The device does not exist, is not permitted, is not a terminal, or does not support this speed.
    pub fn open(path: &Path, baud: u32) -> Result<Self, PortError> {
        let flags = (OFlags::NOCTTY | OFlags::NONBLOCK).bits() as i32;
        let file = OpenOptions::new().read(true).write(true).custom_flags(flags).open(path).map_err(|cause| {
            match cause.kind() {
                // Held by another program with `TIOCEXCL`.
                ErrorKind::ResourceBusy => PortError::InUse { path: path.to_owned() },
                _ => PortError::Open { path: path.to_owned(), cause },
            }
        })?;
        let no_line = |cause: rustix::io::Errno| PortError::NoLine { path: path.to_owned(), cause: cause.into() };
        let mut settings = termios::tcgetattr(&file).map_err(no_line)?;
        // One program drives an arm, whatever path it opens: the lock belongs to the device's file, not to its name.
        rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive)
            .and_then(|()| termios::ioctl_tiocexcl(&file))
            .map_err(|_| PortError::InUse { path: path.to_owned() })?;
        settings.make_raw();
        settings.set_speed(baud).map_err(no_line)?;
        termios::tcsetattr(&file, OptionalActions::Flush, &settings).map_err(no_line)?;
        Ok(Self { file })
    }

    /// Reads what has arrived, up to the buffer's length. Returns the number of bytes, 0 for none.
    ///
    /// # Errors
    /// The connection was lost.
    pub fn read(&mut self, buffer: &mut [u8]) -> Result<usize, PortError> {
        match self.file.read(buffer) {
            // A terminal that was hung up reads as ended.
            Ok(0) => Err(PortError::Gone(ErrorKind::UnexpectedEof.into())),
            Ok(count) => Ok(count),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
            Err(error) => Err(PortError::Gone(error)),
        }
    }

    /// Sends a line. Bytes that do not fit into the system's buffer are dropped: the arm then sees a wrong checksum and
    /// its watchdog keeps counting.
    ///
    /// # Errors
    /// The connection was lost.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        match self.file.write(bytes) {
            Ok(_) => Ok(()),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(()),
            Err(error) => Err(PortError::Gone(error)),
        }
    }
}
