//! The HTTP server: a thread with a separate runtime.

use std::convert::Infallible;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use panoscope_base::web::is_own_host;
use percent_encoding::percent_decode_str;
use tokio::net::TcpStream;
use tokio::sync::oneshot;

use crate::address::Address;
use crate::error::MonitorError;
use crate::state::Shared;
use crate::{metrics, page};

/// Time limit of a request, so that a slow client does not hold resources.
const MAX_REQUEST: Duration = Duration::from_secs(10);
/// Pause after a failed accept, such as with too many open files.
const RETRY: Duration = Duration::from_millis(100);

const TEXT: &str = "text/plain; charset=utf-8";

type Answer = Response<Full<Bytes>>;

/// A server that stops when it is dropped.
pub struct Server {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens and serves `shared`.
    ///
    /// # Errors
    /// The address cannot be used, or the thread does not start.
    pub fn start(wanted: Address, shared: Arc<Shared>) -> Result<Self, MonitorError> {
        let socket = wanted.socket();
        let listen = |cause| MonitorError::Listen { address: socket, cause };
        let listener = TcpListener::bind(socket).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        let address = listener.local_addr().map_err(listen)?;
        let refuse = |cause| MonitorError::Thread { address, cause };
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().map_err(refuse)?;
        let (stop, stopped) = oneshot::channel();
        let work = move || {
            runtime.block_on(async move {
                let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
                // `stopped` also ends when the sender is gone.
                tokio::select! {
                    () = accept(listener, shared) => {}
                    _ = stopped => {}
                }
            });
            runtime.shutdown_timeout(Duration::from_millis(100));
        };
        let thread = std::thread::Builder::new().name("monitor".to_owned()).spawn(work).map_err(refuse)?;
        Ok(Self { address, stop: Some(stop), thread: Some(thread) })
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        // A client with an open connection does not keep the program.
        if let Some(thread) = self.thread.take().filter(JoinHandle::is_finished) {
            let _ = thread.join();
        }
    }
}

async fn accept(listener: tokio::net::TcpListener, shared: Arc<Shared>) {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => drop(tokio::spawn(serve(stream, Arc::clone(&shared)))),
            Err(_) => tokio::time::sleep(RETRY).await,
        }
    }
}

async fn serve(stream: TcpStream, shared: Arc<Shared>) {
    let service = service_fn(move |request| {
        let shared = Arc::clone(&shared);
        async move { Ok::<_, Infallible>(guarded(request, shared).await) }
    });
    let mut server = http1::Builder::new();
    server.timer(TokioTimer::new()).header_read_timeout(MAX_REQUEST);
    // A client that breaks off is not answered.
    let _ = server.serve_connection(TokioIo::new(stream), service).await;
}

/// Refuses writes and requests from pages of other origins; limits the time of a request.
async fn guarded(request: Request<Incoming>, shared: Arc<Shared>) -> Answer {
    let (request, _) = request.into_parts();
    if !matches!(request.method, Method::GET | Method::HEAD) {
        return refuse(StatusCode::METHOD_NOT_ALLOWED, "this page can only be read");
    }
    let host = request.headers.get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or("");
    if !is_own_host(host) {
        let message = "ask with an IP address or `localhost` as the host: a name could belong to another page";
        return refuse(StatusCode::FORBIDDEN, message);
    }
    let mut answer = match tokio::time::timeout(MAX_REQUEST, answer(request.uri.path(), shared)).await {
        Ok(answer) => answer,
        Err(_) => refuse(StatusCode::REQUEST_TIMEOUT, "the response took too long"),
    };
    let headers = answer.headers_mut();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(page::POLICY));
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
    answer
}

async fn answer(path: &str, shared: Arc<Shared>) -> Answer {
    match path {
        "/" => reply(StatusCode::OK, "text/html; charset=utf-8", page::HTML),
        "/state" => state(&shared),
        "/metrics" => metrics(&shared),
        _ => match path.strip_prefix("/pictures/").map(|name| percent_decode_str(name).decode_utf8()) {
            Some(Ok(name)) => picture(shared, name.into_owned()).await,
            _ => refuse(StatusCode::NOT_FOUND, "there are /, /state, /pictures/NODE.OUTPUT and /metrics"),
        },
    }
}

fn reply(status: StatusCode, kind: &'static str, body: impl Into<Bytes>) -> Answer {
    let mut answer = Response::new(Full::new(body.into()));
    *answer.status_mut() = status;
    answer.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    answer
}

fn refuse(status: StatusCode, message: &str) -> Answer {
    reply(status, TEXT, format!("{message}\n"))
}

fn state(shared: &Shared) -> Answer {
    match shared.state().map(|state| serde_json::to_string(&state)) {
        Some(Ok(text)) => reply(StatusCode::OK, "application/json", text),
        Some(Err(error)) => refuse(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
        None => refuse(StatusCode::SERVICE_UNAVAILABLE, "the graph has not started"),
    }
}

fn metrics(shared: &Shared) -> Answer {
    match shared.report() {
        Some(report) => reply(StatusCode::OK, metrics::CONTENT_TYPE, metrics::text(&report)),
        None => refuse(StatusCode::SERVICE_UNAVAILABLE, "the graph has not started"),
    }
}

async fn picture(shared: Arc<Shared>, name: String) -> Answer {
    // Encoding takes milliseconds, which other requests do not wait for.
    let encoded = tokio::task::spawn_blocking(move || shared.picture(&name)).await;
    match encoded {
        Ok(Some(Ok(picture))) => {
            let mut answer = reply(StatusCode::OK, "image/jpeg", picture.jpeg);
            let headers = answer.headers_mut();
            headers.insert("x-tick", HeaderValue::from(picture.tick));
            if let Some(age) = picture.age_ms.and_then(|ms| HeaderValue::from_str(&format!("{ms:.1}")).ok()) {
                headers.insert("x-age-ms", age);
            }
            answer
        }
        Ok(Some(Err(error))) => refuse(StatusCode::SERVICE_UNAVAILABLE, &error.to_string()),
        Ok(None) => refuse(StatusCode::NOT_FOUND, "no image has this name; `/state` lists them"),
        Err(error) => refuse(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
    }
}
