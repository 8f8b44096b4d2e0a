//! A running graph over HTTP, for reading only.
//!
//! [`Monitor`] serves, at an address that the user names:
//!
//! | path | content |
//! |---|---|
//! | `/` | a page with the images of the graph, their ages, and the state of its nodes |
//! | `/state` | the same as JSON |
//! | `/pictures/NODE.OUTPUT` | the newest image of an output, JPEG: maps in colours, clouds as the camera saw them |
//! | `/metrics` | counters and times in the text format of Prometheus |
//!
//! Nothing can be changed through it. It never holds a frame back: images come from previews, which exist only while a
//! client requests them. Requests are served on a separate thread from the state that [`Monitor::update`] published.

mod address;
mod error;
mod metrics;
mod page;
mod paint;
mod pictures;
mod server;
mod state;

use std::net::SocketAddr;
use std::sync::Arc;

use panoscope_engine::Engine;
use panoscope_graph::{Catalog, Graph};

pub use address::{Address, AddressError};
pub use error::MonitorError;

use server::Server;
use state::Shared;

/// Serves a running graph until it is dropped.
pub struct Monitor {
    shared: Arc<Shared>,
    server: Server,
}

impl Monitor {
    /// Begins to listen. The page is empty until the first [`Self::update`].
    ///
    /// # Errors
    /// The address cannot be used.
    pub fn start(address: Address) -> Result<Self, MonitorError> {
        let shared = Arc::new(Shared::default());
        let server = Server::start(address, Arc::clone(&shared))?;
        Ok(Self { shared, server })
    }

    /// The address that it listens on; port 0 is replaced by the one that the system chose.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Publishes the current state. Call it several times a second. `catalog` returns the node types of the running
    /// graph; it is called when the graph has changed.
    pub fn update(&self, engine: &Engine, catalog: impl FnOnce(&Graph) -> Catalog) {
        self.shared.update(engine, catalog);
    }
}
