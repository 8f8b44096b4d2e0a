//! The gate in front of a WebSocket server, which filters requests.
//!
//!
//!
//! A browser lets every page open a WebSocket to this machine, so the server must look at `Origin`. Foxglove's server
//! does not. The gate listens on the public address, reads the head of each request, and connects accepted clients to
//! the server, which listens on a random loopback address (127.A.B.C, a free port), so that a page cannot guess it.

use std::collections::VecDeque;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use panoscope_base::web::is_own_host;
use panoscope_engine::sync::lock;
use socket2::{SockRef, TcpKeepalive};
use tokio::io::{AsyncReadExt, AsyncWriteExt, copy_bidirectional};
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, oneshot};

/// Maximum length of a request's head, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;
/// Maximum number of fields of a head.
const MAX_FIELDS: usize = 64;
/// Time limit for a client to send the head.
const MAX_HEAD_TIME: Duration = Duration::from_secs(5);
/// TCP keep-alive: silence before the first probe, and time between further probes.
const KEEPALIVE: Duration = Duration::from_secs(15);
/// Maximum number of clients at a time.
pub const MAX_CLIENTS: usize = 16;
/// Maximum number of connections without a complete head; a further one ends the oldest of them.
const MAX_WAITING: usize = 64;
/// The page of Foxglove that may connect from a browser.
const FOXGLOVE_ORIGIN: &str = "https://app.foxglove.dev";

/// A request that is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Not the head of an HTTP request.
    #[error("this is not a WebSocket request")]
    Malformed,
    /// The head did not arrive in time.
    #[error("no complete request arrived within {} s", MAX_HEAD_TIME.as_secs())]
    Silent,
    /// The maximum number of clients is reached.
    #[error("{MAX_CLIENTS} clients are connected, which is the limit; close one of them")]
    Full,
    /// `Host` is a name, which could belong to another page.
    #[error("ask with an IP address or `localhost` as the host: a name could belong to another page")]
    Host,
    /// A page of another origin sent the request.
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
            Self::Silent => "408 Request Timeout",
            Self::Full => "503 Service Unavailable",
            Self::Host | Self::Origin { .. } => "403 Forbidden",
        }
    }
}

/// Checks the head of a request, up to and including the empty line.
///
/// Programs send no `Origin`, and Foxglove's desktop application sends one that is not of a web page. Web pages have
/// `http` or `https`; only pages of this machine and Foxglove's own may pass.
///
/// # Errors The reason of the refusal.
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

/// Connections that were refused since the last report.
#[derive(Debug, Default)]
pub struct Refused(Mutex<Option<(u64, IpAddr, Refusal)>>);

impl Refused {
    fn add(&self, from: IpAddr, why: Refusal) {
        let mut refused = lock(&self.0);
        let count = refused.as_ref().map_or(0, |(count, ..)| *count);
        *refused = Some((count + 1, from, why));
    }

    /// A line about them, if there are any; resets the count.
    pub fn take(&self) -> Option<String> {
        let (count, from, why) = lock(&self.0).take()?;
        Some(match count {
            1 => format!("a connection from {from} was refused: {why}"),
            count => format!("{count} connections were refused, the last one from {from}: {why}"),
        })
    }
}

/// Accepts clients until the runtime ends. A connection counts as a client once its request has arrived, so that silent
/// ones block no one.
pub async fn accept(listener: TcpListener, server: SocketAddr, refused: Arc<Refused>) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let clients = Arc::new(Semaphore::new(MAX_CLIENTS));
    // Dropping one ends the wait for a head.
    let mut waiting: VecDeque<oneshot::Sender<()>> = VecDeque::new();
    loop {
        match listener.accept().await {
            Ok((client, from)) => {
                let (patience, ended) = oneshot::channel();
                waiting.retain(|waiting| !waiting.is_closed());
                waiting.push_back(patience);
                if waiting.len() > MAX_WAITING {
                    waiting.pop_front();
                }
                let (clients, refused) = (Arc::clone(&clients), Arc::clone(&refused));
                tokio::spawn(async move {
                    // A client that leaves is no error of the server.
                    if let Ok(Some(why)) = serve(client, server, &clients, ended).await {
                        refused.add(from.ip(), why);
                    }
                });
            }
            // Out of file descriptors, for example.
            Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    }
}

/// Serves a client to its end, or returns why it was refused.
async fn serve(
    mut client: TcpStream,
    server: SocketAddr,
    clients: &Semaphore,
    ended: oneshot::Receiver<()>,
) -> std::io::Result<Option<Refusal>> {
    client.set_nodelay(true)?;
    let read = tokio::select! {
        read = read_head(&mut client) => Some(read),
        () = tokio::time::sleep(MAX_HEAD_TIME) => None,
        _ = ended => None,
    };
    let checked = match read {
        Some(Ok((bytes, end))) => check_head(&bytes[..end]).map(|()| bytes),
        Some(Err(_)) => Err(Refusal::Malformed),
        None => Err(Refusal::Silent),
    };
    let checked = checked.and_then(|bytes| Ok((bytes, clients.try_acquire().map_err(|_| Refusal::Full)?)));
    let refusal = match checked {
        Ok((bytes, _permit)) => {
            // A client whose machine is gone leaves too.
            let keepalive = TcpKeepalive::new().with_time(KEEPALIVE).with_interval(KEEPALIVE);
            SockRef::from(&client).set_tcp_keepalive(&keepalive)?;
            let mut server = TcpStream::connect(server).await?;
            server.set_nodelay(true)?;
            server.write_all(&bytes).await?;
            copy_bidirectional(&mut client, &mut server).await?;
            return Ok(None);
        }
        Err(refusal) => refusal,
    };
    let (status, words) = (refusal.status(), format!("{refusal}\n"));
    let length = words.len();
    let answer = format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{words}"
    );
    // Who does not read it is gone.
    let _ = client.write_all(answer.as_bytes()).await;
    let _ = client.shutdown().await;
    Ok(Some(refusal))
}

/// The received bytes, and the offset of the end of the head.
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

    /// A gate on a free port in front of a server that keeps its clients.
    fn gate() -> (tokio::runtime::Runtime, SocketAddr, Arc<Refused>) {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let listen = || TcpListener::bind("127.0.0.1:0").unwrap();
        let (door, server) = (listen(), listen());
        door.set_nonblocking(true).unwrap();
        let (address, behind) = (door.local_addr().unwrap(), server.local_addr().unwrap());
        std::thread::spawn(move || {
            for mut client in server.incoming().map_while(Result::ok) {
                std::thread::spawn(move || {
                    use std::io::{Read, Write};
                    let _ = client.write_all(b"HTTP/1.1 101 Switching Protocols\r\n\r\n");
                    // Until the client leaves.
                    let _ = client.read_to_end(&mut Vec::new());
                });
            }
        });
        let refused = Arc::new(Refused::default());
        runtime.spawn(accept(door, behind, Arc::clone(&refused)));
        (runtime, address, refused)
    }

    /// Sends a request. Returns the first line of the answer, and the connection.
    fn ask(address: SocketAddr) -> (String, std::net::TcpStream) {
        use std::io::{BufRead, BufReader, Write};
        let mut client = std::net::TcpStream::connect(address).unwrap();
        client.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        write!(client, "GET / HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
        let mut line = String::new();
        BufReader::new(&client).read_line(&mut line).unwrap();
        (line, client)
    }

    #[test]
    fn silent_connections_keep_no_client_out_and_one_client_too_many_gets_a_reason() {
        use std::io::Read;
        let (_runtime, address, refused) = gate();
        let silent: Vec<_> = (0..MAX_WAITING + 40).map(|_| std::net::TcpStream::connect(address).unwrap()).collect();
        let mut clients = Vec::new();
        for number in 0..MAX_CLIENTS {
            let (line, client) = ask(address);
            assert!(line.starts_with("HTTP/1.1 101"), "{number}: {line}");
            clients.push(client);
        }
        let (line, _) = ask(address);
        assert!(line.starts_with("HTTP/1.1 503"), "{line}");
        // A client that leaves makes room.
        drop(clients.pop());
        let end = std::time::Instant::now() + Duration::from_secs(20);
        while !ask(address).0.starts_with("HTTP/1.1 101") {
            assert!(std::time::Instant::now() < end, "nobody can connect");
        }
        // The oldest silent ones were ended for others, and the rest is after its time.
        for mut client in silent {
            client.set_read_timeout(Some(MAX_HEAD_TIME * 4)).unwrap();
            let mut answer = String::new();
            client.read_to_string(&mut answer).unwrap();
            assert!(answer.starts_with("HTTP/1.1 408"), "{answer}");
        }
        let line = refused.take().expect("a line");
        assert!(line.contains("connections were refused") && line.contains("127.0.0.1"), "{line}");
        assert_eq!(refused.take(), None, "said once");
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
