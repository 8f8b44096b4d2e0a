//! A serial line that is read without waiting.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;
use rustix::termios::{self, OptionalActions};
use thiserror::Error;

/// What is wrong with a serial line.
#[derive(Debug, Error)]
pub enum PortError {
    /// It cannot be opened.
    #[error("{path} cannot be opened: {cause}; is the arm plugged in, and may this user read and write the device?", path = path.display())]
    Open {
        /// The device's file.
        path: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// It is no serial line.
    #[error("{path} is no serial line: {cause}", path = path.display())]
    NoLine {
        /// The device's file.
        path: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// Nobody speaks the protocol there.
    #[error("{path}: no arm answered within {wait_ms} ms ({garbage} lines made no sense)", path = path.display())]
    NoArm {
        /// The device's file.
        path: PathBuf,
        /// How long was waited.
        wait_ms: u128,
        /// Lines that were no answers.
        garbage: u32,
    },
    /// It broke off.
    #[error("the line broke off: {0}")]
    Gone(std::io::Error),
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
    /// No such device, no permission, no terminal, a speed that it does not have.
    pub fn open(path: &Path, baud: u32) -> Result<Self, PortError> {
        let flags = (OFlags::NOCTTY | OFlags::NONBLOCK).bits() as i32;
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(flags)
            .open(path)
            .map_err(|cause| PortError::Open { path: path.to_owned(), cause })?;
        let no_line = |cause: rustix::io::Errno| PortError::NoLine { path: path.to_owned(), cause: cause.into() };
        let mut settings = termios::tcgetattr(&file).map_err(no_line)?;
        settings.make_raw();
        settings.set_speed(baud).map_err(no_line)?;
        termios::tcsetattr(&file, OptionalActions::Flush, &settings).map_err(no_line)?;
        Ok(Self { file })
    }

    /// What has arrived, up to the buffer's length; 0 when nothing has.
    ///
    /// # Errors
    /// The line broke off.
    pub fn read(&mut self, buffer: &mut [u8]) -> Result<usize, PortError> {
        match self.file.read(buffer) {
            // A terminal that was hung up reads as ended.
            Ok(0) => Err(PortError::Gone(ErrorKind::UnexpectedEof.into())),
            Ok(count) => Ok(count),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
            Err(error) => Err(PortError::Gone(error)),
        }
    }

    /// Sends a line. One that does not fit into the system's buffer is dropped whole or in part: its sum will not fit, and the arm's watchdog
    /// counts on.
    ///
    /// # Errors
    /// The line broke off.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        match self.file.write(bytes) {
            Ok(_) => Ok(()),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(()),
            Err(error) => Err(PortError::Gone(error)),
        }
    }
}
