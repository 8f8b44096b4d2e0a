//! A TCP connection that is read and written without waiting.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use crate::port::PortError;

/// Time limit of a connection.
const CONNECT_WITHIN: Duration = Duration::from_secs(1);

/// Connects to `host:port` and sends every package at once.
///
/// # Errors
/// The host has no address, or does not answer there.
pub fn connect(host: &str, port: u16) -> Result<TcpStream, PortError> {
    let failed = |cause: std::io::Error| PortError::NotReached { place: format!("{host}:{port}"), cause };
    let mut last = std::io::Error::new(ErrorKind::NotFound, "this name has no address");
    for address in (host, port).to_socket_addrs().map_err(failed)? {
        match TcpStream::connect_timeout(&address, CONNECT_WITHIN) {
            Ok(stream) => {
                stream.set_nodelay(true).map_err(failed)?;
                return Ok(stream);
            }
            Err(cause) => last = cause,
        }
    }
    Err(failed(last))
}

/// An open connection.
#[derive(Debug)]
pub struct TcpPort {
    stream: TcpStream,
    /// Bytes not accepted by the system yet; they must be sent before another package.
    held: Vec<u8>,
}

impl TcpPort {
    /// Connects to `host:port`; `longest` is the length of the longest package that is written.
    ///
    /// # Errors
    /// The host does not answer.
    pub fn open(host: &str, port: u16, longest: usize) -> Result<Self, PortError> {
        let stream = connect(host, port)?;
        stream
            .set_nonblocking(true)
            .map_err(|cause| PortError::NotReached { place: format!("{host}:{port}"), cause })?;
        Ok(Self { stream, held: Vec::with_capacity(longest) })
    }

    /// Reads what has arrived, up to the buffer's length. Returns the number of bytes, 0 for none.
    ///
    /// # Errors
    /// The connection was lost.
    pub fn read(&mut self, buffer: &mut [u8]) -> Result<usize, PortError> {
        match self.stream.read(buffer) {
            Ok(0) => Err(PortError::Gone(ErrorKind::UnexpectedEof.into())),
            Ok(count) => Ok(count),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
            Err(error) => Err(PortError::Gone(error)),
        }
    }

    /// Sends a package. Returns whether it was sent or will be: while the rest of an earlier package waits, it is
    /// dropped, and the arm's heartbeat stops.
    ///
    /// # Errors
    /// The connection was lost.
    pub fn write(&mut self, package: &[u8]) -> Result<bool, PortError> {
        if !self.held.is_empty() {
            let sent = Self::send(&mut self.stream, &self.held)?;
            self.held.drain(..sent);
            if !self.held.is_empty() {
                return Ok(false);
            }
        }
        let sent = Self::send(&mut self.stream, package)?;
        // Nothing of a package has left: it can be dropped whole.
        if sent == 0 {
            return Ok(false);
        }
        self.held.extend_from_slice(&package[sent..]);
        Ok(true)
    }

    fn send(stream: &mut TcpStream, bytes: &[u8]) -> Result<usize, PortError> {
        match stream.write(bytes) {
            Ok(count) => Ok(count),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
            Err(error) => Err(PortError::Gone(error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn a_full_connection_drops_whole_packages_only() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("bound").port();
        let mut ours = TcpPort::open("127.0.0.1", port, 5000).expect("connected");
        let (mut theirs, _) = listener.accept().expect("accepted");
        let package = |number: u32| {
            let mut bytes = vec![number as u8; 5000];
            bytes[..4].copy_from_slice(&number.to_be_bytes());
            bytes
        };
        // Nobody reads until packages are dropped.
        let (mut sent, mut number, mut dropped) = (Vec::new(), 0_u32, 0);
        while dropped < 3 {
            if ours.write(&package(number)).expect("connected") {
                sent.push(number);
            } else {
                dropped += 1;
            }
            number += 1;
        }
        let reader = std::thread::spawn(move || {
            let mut all = Vec::new();
            theirs.read_to_end(&mut all).map(|_| all)
        });
        // Goes out as soon as there is room.
        while !ours.held.is_empty() || !sent.contains(&number) {
            if ours.write(&package(number)).expect("connected") {
                sent.push(number);
            }
            std::thread::yield_now();
        }
        while !ours.held.is_empty() {
            let count = TcpPort::send(&mut ours.stream, &ours.held).expect("connected");
            ours.held.drain(..count);
            std::thread::yield_now();
        }
        drop(ours);
        let all = reader.join().expect("ended").expect("read");
        let expected: Vec<u8> = sent.iter().flat_map(|number| package(*number)).collect();
        assert_eq!(all.len(), expected.len());
        assert!(all == expected, "packages are whole and in order");
    }

    #[test]
    fn a_host_that_is_not_there_is_named() {
        let port = {
            let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
            listener.local_addr().expect("bound").port()
        };
        let error = connect("127.0.0.1", port).expect_err("nobody listens").to_string();
        assert!(error.contains(&format!("127.0.0.1:{port} cannot be reached")), "{error}");
    }
}
