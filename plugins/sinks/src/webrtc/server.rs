//! WHEP over HTTP: one server per address and port of the process, with a path per node.
//!
//! `POST /PATH` accepts an SDP offer and returns the answer, `DELETE` of the `Location` ends the connection, `GET /PATH` is a page that shows the
//! stream. Source: draft-ietf-wish-whep.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderMap, HeaderName, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use panoscope_media::offer::MAX_OFFER_BYTES;
use tokio::runtime::Runtime;
use tokio::sync::Semaphore;

use super::host;
use super::room::{JoinError, Room};
use crate::serving::{ServeError, refused};

/// Time limit of a request, so that a slow client does not hold a connection.
const MAX_REQUEST: Duration = Duration::from_secs(10);
/// Maximum number of requests at a time; others wait.
const MAX_REQUESTS: usize = 32;
/// Maximum length of a request's head, bytes.
const MAX_HEAD_BYTES: usize = 16 << 10;
/// Interval at which viewers that have left are removed.
const CLEAN_UP_EVERY: Duration = Duration::from_millis(500);
/// Time limit for running requests when the server ends.
const MAX_END: Duration = Duration::from_secs(1);

const PAGE: &str = include_str!("page.html");
/// Content security policy: the page loads nothing from elsewhere, and no other page may embed it.
const POLICY: &str = "default-src 'none'; connect-src 'self'; media-src 'self' blob: mediastream:; script-src 'unsafe-inline'; style-src 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";

const TEXT: &str = "text/plain; charset=utf-8";
const SDP: &str = "application/sdp";

type Answer = Response<Full<Bytes>>;
type Rooms = Mutex<BTreeMap<String, Arc<Room>>>;

fn lock(rooms: &Rooms) -> MutexGuard<'_, BTreeMap<String, Arc<Room>>> {
    rooms.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Server {
    bound: SocketAddr,
    rooms: Arc<Rooms>,
    runtime: Option<Runtime>,
}

static SERVERS: Mutex<Vec<Weak<Server>>> = Mutex::new(Vec::new());

impl Server {
    fn start(asked: SocketAddr) -> Result<Self, ServeError> {
        let failed = |error: std::io::Error| refused(asked, &error);
        let listener = TcpListener::bind(asked).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("webrtc-server")
            .enable_all()
            .build()
            .map_err(failed)?;
        let rooms = Arc::new(Rooms::default());
        let entered = runtime.enter();
        let listener = tokio::net::TcpListener::from_std(listener).map_err(failed)?;
        drop(entered);
        runtime.spawn(accept(listener, Arc::clone(&rooms)));
        runtime.spawn(clean_up(Arc::clone(&rooms)));
        Ok(Self { bound, rooms, runtime: Some(runtime) })
    }

    /// The running server of an address, or a new one. Port 0 always makes a new one.
    fn get(asked: SocketAddr) -> Result<Arc<Self>, ServeError> {
        let mut servers = SERVERS.lock().unwrap_or_else(PoisonError::into_inner);
        servers.retain(|server| server.strong_count() > 0);
        if let Some(server) = servers.iter().filter_map(Weak::upgrade).find(|server| server.bound == asked) {
            return Ok(server);
        }
        let server = Arc::new(Self::start(asked)?);
        servers.push(Arc::downgrade(&server));
        Ok(server)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(MAX_END);
        }
    }
}

/// A served path; removed when dropped.
pub struct Mount {
    server: Arc<Server>,
    path: String,
    room: Arc<Room>,
}

impl Mount {
    /// Serves a room at `path`.
    ///
    /// # Errors
    /// The system does not allow listening on the address, or another node serves the path.
    pub fn new(address: IpAddr, port: u16, path: &str, room: Room) -> Result<Self, ServeError> {
        let server = Server::get(SocketAddr::new(address, port))?;
        let path = format!("/{}", path.trim_matches('/'));
        let room = Arc::new(room);
        {
            let mut rooms = lock(&server.rooms);
            if let Some(other) = rooms.get(&path) {
                return Err(ServeError::Taken { node: other.node.clone(), path, at: server.bound });
            }
            rooms.insert(path.clone(), Arc::clone(&room));
        }
        Ok(Self { server, path, room })
    }

    /// The port that the server listens on.
    pub fn port(&self) -> u16 {
        self.server.bound.port()
    }

    /// Address of the page and of the stream.
    pub fn url(&self) -> String {
        format!("http://{}{}", self.server.bound, self.path)
    }
}

impl Drop for Mount {
    fn drop(&mut self) {
        lock(&self.server.rooms).remove(&self.path);
        self.room.end();
    }
}

async fn accept(listener: tokio::net::TcpListener, rooms: Arc<Rooms>) {
    let limit = Arc::new(Semaphore::new(MAX_REQUESTS));
    loop {
        // Never closed.
        let Ok(permit) = Arc::clone(&limit).acquire_owned().await else { return };
        let Ok((stream, _)) = listener.accept().await else {
            // Too many open files, for example: it may pass.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let Ok(local) = stream.local_addr() else { continue };
        let rooms = Arc::clone(&rooms);
        tokio::spawn(async move {
            let service = service_fn(move |request| {
                let rooms = Arc::clone(&rooms);
                async move { Ok::<_, std::convert::Infallible>(answer(&rooms, local.ip().to_canonical(), request).await) }
            });
            let mut server = http1::Builder::new();
            let connection =
                server.keep_alive(false).max_buf_size(MAX_HEAD_BYTES).serve_connection(TokioIo::new(stream), service);
            // A client that breaks off or is too slow is not answered.
            let _ = tokio::time::timeout(MAX_REQUEST, connection).await;
            drop(permit);
        });
    }
}

async fn clean_up(rooms: Arc<Rooms>) {
    let mut ticks = tokio::time::interval(CLEAN_UP_EVERY);
    loop {
        ticks.tick().await;
        let all: Vec<Arc<Room>> = lock(&rooms).values().cloned().collect();
        // Stopping a pipeline waits for its threads.
        let _ = tokio::task::spawn_blocking(move || all.iter().for_each(|room| room.clean_up())).await;
    }
}

fn reply(status: StatusCode, kind: &'static str, text: impl Into<Bytes>) -> Answer {
    let mut answer = Response::new(Full::new(text.into()));
    *answer.status_mut() = status;
    answer.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    answer
}

fn refuse(status: StatusCode, words: &dyn std::fmt::Display) -> Answer {
    reply(status, TEXT, format!("{words}\n"))
}

fn not_allowed(allowed: &'static str) -> Answer {
    let mut answer = refuse(StatusCode::METHOD_NOT_ALLOWED, &format_args!("this address accepts {allowed}"));
    answer.headers_mut().insert(header::ALLOW, HeaderValue::from_static(allowed));
    answer
}

async fn answer(rooms: &Rooms, local: IpAddr, request: Request<Incoming>) -> Answer {
    let mut answer = match host::check(request.headers()) {
        Ok(()) => route(rooms, local, request).await,
        Err(foreign) => refuse(StatusCode::FORBIDDEN, &foreign),
    };
    for (name, value) in [
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        answer.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    answer
}

async fn route(rooms: &Rooms, local: IpAddr, request: Request<Incoming>) -> Answer {
    let path = request.uri().path().trim_end_matches('/').to_owned();
    let find = |path: &str| lock(rooms).get(path).cloned();
    if let Some(room) = find(&path) {
        return match *request.method() {
            Method::GET | Method::HEAD => reply(StatusCode::OK, "text/html; charset=utf-8", PAGE),
            Method::POST => join(room, &path, local, request).await,
            _ => not_allowed("GET, HEAD, POST"),
        };
    }
    if let Some((path, name)) = path.rsplit_once("/viewers/")
        && let Some(room) = find(path)
    {
        if request.method() != Method::DELETE {
            return not_allowed("DELETE");
        }
        let name = name.to_owned();
        let had_left = tokio::task::spawn_blocking(move || room.leave(&name)).await;
        return match had_left {
            Ok(true) => reply(StatusCode::OK, TEXT, "the connection has ended\n"),
            _ => refuse(StatusCode::NOT_FOUND, &"no viewer has this address; it may have left"),
        };
    }
    let paths = lock(rooms).keys().cloned().collect::<Vec<_>>().join(", ");
    refuse(StatusCode::NOT_FOUND, &format_args!("nothing is served at this path; available: {paths}"))
}

fn is_sdp(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or("");
    kind.split(';').next().is_some_and(|kind| kind.trim().eq_ignore_ascii_case(SDP))
}

async fn join(room: Arc<Room>, path: &str, local: IpAddr, request: Request<Incoming>) -> Answer {
    if !is_sdp(request.headers()) {
        let words = "send an SDP offer with `Content-Type: application/sdp`";
        return refuse(StatusCode::UNSUPPORTED_MEDIA_TYPE, &words);
    }
    let body = match Limited::new(request.into_body(), MAX_OFFER_BYTES).collect().await {
        Ok(body) => body.to_bytes(),
        Err(error) if error.is::<http_body_util::LengthLimitError>() => {
            let words = format_args!("the offer exceeds the limit of {MAX_OFFER_BYTES} bytes");
            return refuse(StatusCode::PAYLOAD_TOO_LARGE, &words);
        }
        Err(error) => return refuse(StatusCode::BAD_REQUEST, &error),
    };
    match tokio::task::spawn_blocking(move || room.join(&body, local)).await {
        Ok(Ok((name, answer))) => {
            let mut reply = reply(StatusCode::CREATED, SDP, answer);
            if let Ok(place) = HeaderValue::from_str(&format!("{path}/viewers/{name}")) {
                reply.headers_mut().insert(header::LOCATION, place);
            }
            reply
        }
        Ok(Err(error)) => {
            let status = match error {
                JoinError::Offer(_) => StatusCode::BAD_REQUEST,
                JoinError::Full | JoinError::Ended => StatusCode::SERVICE_UNAVAILABLE,
                JoinError::Viewer(_) => StatusCode::INTERNAL_SERVER_ERROR,
            };
            refuse(status, &error)
        }
        Err(error) => refuse(StatusCode::INTERNAL_SERVER_ERROR, &error),
    }
}
