//! The host's end of a connection: a process that the host treats as the process of a group.

use std::ffi::OsString;
use std::fs::File;
use std::io;
use std::os::fd::{AsFd, AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::ffi::OsStringExt;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use super::RelayError;
use crate::isolate::lane::{Lane, Side};
use crate::isolate::socket;
use crate::isolate::wire::lane::{Kind, Settings, ToChild, hello};
use crate::isolate::wire::whole;

/// The connection to the host.
pub struct Link {
    socket: OwnedFd,
    /// Settings of the group.
    pub settings: Settings,
}

/// Resource that the host sends.
pub enum Given {
    /// A pool of frames, to map.
    Pool {
        /// Its number.
        number: u32,
        /// Its size in bytes, which is sealed.
        len: usize,
        /// Whether the group writes it; other pools are read-only.
        is_own: bool,
        /// File with its bytes.
        file: File,
    },
    /// A plugin.
    Plugin {
        /// Its number.
        id: u32,
        /// Path of the plugin's file on the host.
        path: PathBuf,
        /// A copy of its bytes.
        image: File,
    },
    /// A lane of a new instance.
    Lane(LinkLane),
}

impl Link {
    /// Takes the socket that is this process's standard input, and the host's first message.
    ///
    /// # Errors
    /// Standard input is not the socket of a host, or the host is of another version.
    pub fn take() -> io::Result<Self> {
        // SAFETY: plain system calls; standard input is the socket that the host gave, and nothing else in this process uses it.
        let socket = unsafe {
            let socket = libc::fcntl(0, libc::F_DUPFD_CLOEXEC, 3);
            if socket < 0 {
                return Err(io::Error::last_os_error());
            }
            let nothing = File::open("/dev/null")?;
            libc::dup2(nothing.as_raw_fd(), 0);
            // A terminal's Ctrl-C goes to all processes of the command; the host ends this one when it is done.
            for signal in [libc::SIGINT, libc::SIGHUP, libc::SIGTERM, libc::SIGPIPE] {
                libc::signal(signal, libc::SIG_IGN);
            }
            OwnedFd::from_raw_fd(socket)
        };
        let (message, _) = socket::receive(socket.as_fd())?;
        Ok(Self { socket, settings: hello(&message)? })
    }

    /// Waits for the next resource from the host; `None` when the host has closed the socket.
    ///
    /// # Errors
    /// The host is of another build, or memory cannot be mapped.
    pub fn next(&self) -> io::Result<Option<Given>> {
        let (message, file) = socket::receive(self.socket.as_fd())?;
        if message.is_empty() {
            return Ok(None);
        }
        read(&message, file).map(Some)
    }
}

fn read(message: &[u8], file: Option<OwnedFd>) -> io::Result<Given> {
    let bad = || io::Error::other(RelayError::Bad);
    let file = File::from(file.ok_or_else(bad)?);
    match whole(message).map_err(|_| bad())? {
        ToChild::Pool { number, len, is_own } => {
            Ok(Given::Pool { number, len: usize::try_from(len).map_err(|_| bad())?, is_own, file })
        }
        ToChild::Plugin { id, path } => {
            Ok(Given::Plugin { id, path: PathBuf::from(OsString::from_vec(path)), image: file })
        }
        ToChild::Lane => Ok(Given::Lane(LinkLane(Lane::map(&file)?))),
        ToChild::Hello { .. } => Err(bad()),
    }
}

/// State of a link's connection.
#[derive(Clone, Copy, Debug, Default)]
pub struct LinkNumbers {
    /// The other machine's clock minus this one's, ns, and its maximum error; `None` while it is unknown.
    pub clock: Option<(i64, u64)>,
    /// Round-trip time of the last probe, ns.
    pub round_trip_ns: u64,
    /// Bytes sent.
    pub sent_bytes: u64,
    /// Bytes received.
    pub received_bytes: u64,
}

/// The process's side of a lane.
pub struct LinkLane(Lane);

impl LinkLane {
    /// Waits for a message of the host; returns its kind.
    ///
    /// # Errors
    /// The host has ended or is of another build.
    pub fn receive(&self, message: &mut Vec<u8>) -> Result<u32, RelayError> {
        Ok(self.0.receive(Side::Child, message)? as u32)
    }

    /// Passes a message on to the host.
    ///
    /// # Errors
    /// `kind` is unknown.
    pub fn post(&self, kind: u32, message: &[u8]) -> Result<(), RelayError> {
        let kind = Kind::of(kind).ok_or(RelayError::Bad)?;
        self.0.post(Side::Child, kind, message);
        Ok(())
    }

    /// Publishes the state of the connection to the host.
    pub fn show(&self, numbers: &LinkNumbers) {
        let link = self.0.link();
        let (offset_ns, uncertainty_ns) = numbers.clock.unwrap_or_default();
        link.clock_offset_ns.store(offset_ns, Ordering::Relaxed);
        link.clock_uncertainty_ns.store(uncertainty_ns, Ordering::Relaxed);
        link.round_trip_ns.store(numbers.round_trip_ns, Ordering::Relaxed);
        link.sent_bytes.store(numbers.sent_bytes, Ordering::Relaxed);
        link.received_bytes.store(numbers.received_bytes, Ordering::Relaxed);
    }
}
