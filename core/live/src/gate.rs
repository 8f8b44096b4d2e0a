//! The door in front of a WebSocket server: which requests reach it.
//!
//! A browser lets every page open a WebSocket to this machine, so the server must look at `Origin`. Foxglove's server does not. The gate listens on
//! the public address, reads the head of each request, and connects what may pass to the server, which listens on a loopback address that is
//! drawn at random (127.A.B.C, a free port), so that a page cannot guess it.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;

use panoscope_monitor::is_own_host;
use tokio::io::{AsyncReadExt, AsyncWriteExt, copy_bidirectional};
use tokio::net::TcpStream;
use tokio::sync::Semaphore;

/// Longest head of a request.
const MAX_HEAD_BYTES: usize = 16 << 10;
/// Most fields of a head.
const MAX_FIELDS: usize = 64;
/// How long a client may take for the head.
const MAX_HEAD_TIME: Duration = Duration::from_secs(5);
/// Clients at a time.
const MAX_CLIENTS: usize = 16;
/// The page of Foxglove that may connect from a browser.
const FOXGLOVE_ORIGIN: &str = "https://app.foxglove.dev";

/// Why a request does not pass.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Not the head of an HTTP request.
    #[error("this is no request for a WebSocket")]
    Malformed,
    /// `Host` is a name, which could belong to another page.
    #[error("ask with an IP address or `localhost` as the host: a name could belong to another page")]
    Host,
    /// A page of another origin asked.
    #[error("pages of `{origin}` may not connect; Foxglove's application and pages of this machine may")]
    Origin {
        /// The origin.
        origin: String,
    },
}

impl Refusal {
    fn status(&self) -> &'static str {
        match self {
            Self::Malformed => "400 Bad Request",
            Self::Host | Self::Origin { .. } => "403 Forbidden",
        }
    }
}

/// Checks the head of a request, up to and with the empty line.
///
/// Programs send no `Origin`, and Foxglove's desktop application one that is no web page's. Pages of the web have `http` or `https`; of these
/// only pages of this machine and Foxglove's own may pass.
///
/// # Errors
/// Why it does not pass.
pub fn check_head(head: &[u8]) -> Result<(), Refusal> {
    let mut fields = [httparse::EMPTY_HEADER; MAX_FIELDS];
    let mut request = httparse::Request::new(&mut fields);
    if !matches!(request.parse(head), Ok(httparse::Status::Complete(_))) || request.method != Some("GET") {
        return Err(Refusal::Malformed);
    }
    let values = |name: &str| -> Result<Vec<&str>, Refusal> {
        let named = request.headers.iter().filter(|field| field.name.eq_ignore_ascii_case(name));
        named.map(|field| std::str::from_utf8(field.value).map_err(|_| Refusal::Malformed)).collect()
    };
    match values("host")?[..] {
        [host] if is_own_host(host) => {}
        [_] => return Err(Refusal::Host),
        _ => return Err(Refusal::Malformed),
    }
    match values("origin")?[..] {
        [] => Ok(()),
        [origin] if is_own_origin(origin) => Ok(()),
        [origin] => Err(Refusal::Origin { origin: origin.chars().take(100).collect() }),
        _ => Err(Refusal::Malformed),
    }
}

fn is_own_origin(origin: &str) -> bool {
    let Some((scheme, rest)) = origin.split_once("://") else { return false };
    if !matches!(scheme, "http" | "https") {
        return !scheme.is_empty();
    }
    if origin == FOXGLOVE_ORIGIN {
        return true;
    }
    let name = match rest.strip_prefix('[') {
        Some(address) => address.split(']').next().unwrap_or(""),
        None => rest.split(':').next().unwrap_or(""),
    };
    name == "localhost" || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// A loopback address that cannot be guessed.
pub fn hidden_loopback() -> Ipv4Addr {
    use std::hash::{BuildHasher, Hasher};
    // Keyed with random numbers of the system.
    let number = std::collections::hash_map::RandomState::new().build_hasher().finish();
    let [a, b, c, ..] = number.to_le_bytes();
    // 127.0.x.x holds the addresses that programs use.
    Ipv4Addr::new(127, a.max(1), b, c.clamp(1, 254))
}

/// Accepts clients until the runtime ends.
pub async fn accept(listener: TcpListener, server: SocketAddr) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let clients = Arc::new(Semaphore::new(MAX_CLIENTS));
    loop {
        let Ok(permit) = Arc::clone(&clients).acquire_owned().await else { return };
        match listener.accept().await {
            Ok((client, _)) => {
                tokio::spawn(async move {
                    // A client that leaves is no error of the server.
                    let _ = serve(client, server).await;
                    drop(permit);
                });
            }
            // Out of file descriptors, for example.
            Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    }
}

async fn serve(mut client: TcpStream, server: SocketAddr) -> std::io::Result<()> {
    client.set_nodelay(true)?;
    let read = tokio::time::timeout(MAX_HEAD_TIME, read_head(&mut client)).await;
    let refusal = match read {
        Ok(Ok((bytes, end))) => match check_head(&bytes[..end]) {
            Ok(()) => {
                let mut server = TcpStream::connect(server).await?;
                server.set_nodelay(true)?;
                server.write_all(&bytes).await?;
                copy_bidirectional(&mut client, &mut server).await?;
                return Ok(());
            }
            Err(refusal) => refusal,
        },
        _ => Refusal::Malformed,
    };
    let (status, words) = (refusal.status(), format!("{refusal}\n"));
    let length = words.len();
    let answer = format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{words}"
    );
    client.write_all(answer.as_bytes()).await?;
    client.shutdown().await
}

/// The bytes so far, and where the head ends in them.
async fn read_head(client: &mut TcpStream) -> std::io::Result<(Vec<u8>, usize)> {
    let mut bytes = Vec::with_capacity(1 << 10);
    loop {
        let from = bytes.len().saturating_sub(3);
        if client.read_buf(&mut bytes).await? == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        if let Some(at) = bytes[from..].windows(4).position(|four| four == b"\r\n\r\n") {
            return Ok((bytes, from + at + 4));
        }
        if bytes.len() > MAX_HEAD_BYTES {
            return Err(std::io::ErrorKind::InvalidData.into());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(fields: &str) -> Result<(), Refusal> {
        check_head(format!("GET / HTTP/1.1\r\n{fields}\r\n").as_bytes())
    }

    #[test]
    fn programs_and_pages_of_this_machine_pass() {
        for fields in [
            "Host: 127.0.0.1:8765\r\n",
            "host: localhost\r\nOrigin: https://app.foxglove.dev\r\n",
            "Host: 10.0.0.2\r\nOrigin: file://\r\n",
            "Host: [::1]:1\r\nOrigin: http://[::1]:8080\r\n",
            "Host: 127.0.0.1\r\nOrigin: http://localhost:8080\r\n",
        ] {
            assert_eq!(check(fields), Ok(()), "{fields}");
        }
    }

    #[test]
    fn pages_of_others_do_not_pass() {
        for origin in [
            "https://evil.example",
            "http://10.0.0.2",
            "null",
            "",
            "://",
            "https://app.foxglove.dev.evil.example",
            "http://localhost.evil.example",
            "http://127.0.0.1.evil.example",
        ] {
            let found = check(&format!("Host: 127.0.0.1\r\nOrigin: {origin}\r\n"));
            assert_eq!(found, Err(Refusal::Origin { origin: origin.to_owned() }));
        }
        assert_eq!(check("Host: evil.example:8765\r\n"), Err(Refusal::Host));
        for fields in ["", "Host: 127.0.0.1\r\nHost: 127.0.0.1\r\n", "Host\r\n"] {
            assert_eq!(check(fields), Err(Refusal::Malformed), "{fields:?}");
        }
        assert_eq!(check_head(b"\x16\x03\x01\r\n\r\n"), Err(Refusal::Malformed));
    }
}
