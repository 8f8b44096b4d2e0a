//! Accepts connections of programs.

use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use super::{LinkError, MAX_PEERS, Shared, connected, lock};

/// Interval at which new connections are accepted.
const STEP: Duration = Duration::from_millis(20);

fn refused(at: SocketAddr, error: &std::io::Error) -> LinkError {
    let help = match error.kind() {
        std::io::ErrorKind::AddrInUse => "another program uses this port: give another `port`, or end that program",
        std::io::ErrorKind::AddrNotAvailable => "this machine has no such address: see `ip address`",
        std::io::ErrorKind::PermissionDenied => "ports below 1024 need root: choose a higher `port`",
        _ => "give another `address` or `port`",
    };
    LinkError::Listen { at, reason: error.to_string(), help }
}

/// Listens, and starts the thread that accepts connections. Returns the thread and the address.
pub fn start(shared: &Arc<Shared>) -> Result<(JoinHandle<()>, SocketAddr), LinkError> {
    let address = &shared.endpoint.address;
    let ip: IpAddr = address.parse().map_err(|_| LinkError::Address { address: address.clone() })?;
    let at = SocketAddr::new(ip, shared.endpoint.port);
    let listener = TcpListener::bind(at).map_err(|error| refused(at, &error))?;
    let bound = listener.local_addr().map_err(|error| refused(at, &error))?;
    // Accepting must end when the link does.
    listener.set_nonblocking(true).map_err(|error| refused(at, &error))?;
    let own = Arc::clone(shared);
    let spawned = std::thread::Builder::new().name("igtl-server".to_owned()).spawn(move || accept(&own, &listener));
    Ok((spawned.map_err(LinkError::Thread)?, bound))
}

fn accept(shared: &Arc<Shared>, listener: &TcpListener) {
    let mut threads: Vec<JoinHandle<()>> = Vec::new();
    while !shared.is_stopping() {
        threads.retain(|thread| !thread.is_finished());
        let Ok((stream, address)) = listener.accept() else {
            // Nobody, or somebody who has left already.
            shared.pause(STEP);
            continue;
        };
        if lock(&shared.peers).len() >= MAX_PEERS || threads.len() >= MAX_PEERS {
            shared.remark(true, format!("{address} was refused: {MAX_PEERS} programs are already connected"));
            continue;
        }
        // A socket may inherit the listener's mode.
        if stream.set_nonblocking(false).is_err() {
            continue;
        }
        let own = Arc::clone(shared);
        let spawned = std::thread::Builder::new()
            .name("igtl-read".to_owned())
            .spawn(move || connected::serve(&own, stream, false));
        match spawned {
            Ok(thread) => threads.push(thread),
            Err(error) => shared.remark(true, format!("{address} was refused: no thread could be started: {error}")),
        }
    }
    for thread in threads {
        // A panic was printed when it happened.
        let _ = thread.join();
    }
}
