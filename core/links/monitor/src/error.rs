//! Errors.

use std::io;
use std::net::SocketAddr;

/// Why a graph cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum MonitorError {
    /// The address cannot be listened on.
    #[error(
        "cannot listen on {address}: {cause}; another program may use the port: choose another, or 0 for a free one"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        cause: io::Error,
    },
    /// There is no thread for the server.
    #[error("cannot start the thread that serves {address}: {cause}")]
    Thread {
        /// The address.
        address: SocketAddr,
        /// Why.
        cause: io::Error,
    },
}
