//! Errors of the page.

use std::io;
use std::net::SocketAddr;

/// A graph that cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum MonitorError {
    /// The address cannot be listened on.
    #[error(
        "cannot listen on {address}: {cause}; another program may use the port: choose another, or 0 for a free one"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Reason.
        cause: io::Error,
    },
    /// The server's thread could not be started.
    #[error("cannot start the thread that serves {address}: {cause}")]
    Thread {
        /// The address.
        address: SocketAddr,
        /// Reason.
        cause: io::Error,
    },
}
