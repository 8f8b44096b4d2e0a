//! Connects to a server, and reconnects whenever the connection is lost.

use std::io;
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use super::{LinkError, Remark, Shared, connected};

/// Time limit of a connection attempt.
const CONNECT_LIMIT: Duration = Duration::from_secs(2);
/// Pause between two attempts.
const RETRY: Duration = Duration::from_millis(500);

/// Starts the connecting thread.
pub fn start(shared: &Arc<Shared>) -> Result<JoinHandle<()>, LinkError> {
    let own = Arc::clone(shared);
    std::thread::Builder::new().name("igtl-client".to_owned()).spawn(move || run(&own)).map_err(LinkError::Thread)
}

fn run(shared: &Arc<Shared>) {
    let mut said = String::new();
    while !shared.is_stopping() {
        match connect(shared) {
            Ok(stream) => {
                said.clear();
                connected::serve(shared, stream, true);
            }
            Err(error) => {
                let words = error.to_string();
                if words != said {
                    let at = shared.endpoint.words();
                    let message = format!("cannot connect to {at}: {words}; retrying every 0.5 s");
                    shared.add_remark(Remark { is_fault: true, is_end: false, is_apart: true, words: message });
                    said = words;
                }
            }
        }
        shared.pause(RETRY);
    }
}

fn connect(shared: &Shared) -> io::Result<TcpStream> {
    let endpoint = &shared.endpoint;
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the name cannot be resolved to an address");
    for address in (endpoint.address.as_str(), endpoint.port).to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_LIMIT) {
            // On one machine a connection can meet itself where nobody listens.
            Ok(stream) if stream.local_addr()? == address => {
                last = io::Error::from(io::ErrorKind::ConnectionRefused);
            }
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}
