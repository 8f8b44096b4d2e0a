//! Errors of the server for Foxglove.

use std::io;
use std::net::SocketAddr;

/// A graph that is not served.
#[derive(Debug, thiserror::Error)]
pub enum LiveServerError {
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
    #[error("cannot start the threads that serve {address}: {cause}")]
    Thread {
        /// The address.
        address: SocketAddr,
        /// Reason.
        cause: io::Error,
    },
    /// Foxglove's server did not start.
    #[error("Foxglove's server for {address} did not start: {words}")]
    Foxglove {
        /// The address.
        address: SocketAddr,
        /// Reason.
        words: String,
    },
}
