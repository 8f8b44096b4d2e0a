//! The HTTP server: a thread with a runtime of its own.

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tokio::sync::oneshot;

use crate::address::Address;
use crate::error::MonitorError;
use crate::host::is_own_host;
use crate::state::Shared;
use crate::{metrics, page};

/// A request that takes longer is given up, so that a slow client holds nothing for long.
const MAX_REQUEST: Duration = Duration::from_secs(10);

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
    /// The address cannot be listened on, or there is no thread.
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
                let served = axum::serve(listener, routes(shared)).with_graceful_shutdown(async move {
                    // Also when the sender is gone.
                    let _ = stopped.await;
                });
                let _ = served.await;
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

fn routes(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/", get(html))
        .route("/state", get(state))
        .route("/metrics", get(metrics))
        .route("/pictures/{*name}", get(picture))
        .fallback(unknown)
        .layer(middleware::from_fn(guard))
        .with_state(shared)
}

/// Refuses what is no reading, and requests that a page of another origin had a browser make; limits the time of a request.
async fn guard(request: Request, next: Next) -> Response {
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        return refuse(StatusCode::METHOD_NOT_ALLOWED, "this page can only be read");
    }
    let host = request.headers().get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or("");
    if !is_own_host(host) {
        let words = "ask with an IP address or `localhost` as the host: a name could belong to another page";
        return refuse(StatusCode::FORBIDDEN, words);
    }
    let mut response = match tokio::time::timeout(MAX_REQUEST, next.run(request)).await {
        Ok(response) => response,
        Err(_) => refuse(StatusCode::REQUEST_TIMEOUT, "the answer took too long"),
    };
    let headers = response.headers_mut();
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(page::POLICY));
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
    response
}

fn refuse(status: StatusCode, words: &str) -> Response {
    (status, [(header::CONTENT_TYPE, "text/plain; charset=utf-8")], format!("{words}\n")).into_response()
}

async fn html() -> Response {
    ([(header::CONTENT_TYPE, "text/html; charset=utf-8")], page::HTML).into_response()
}

async fn state(State(shared): State<Arc<Shared>>) -> Response {
    match shared.state().map(|state| serde_json::to_string(&state)) {
        Some(Ok(text)) => ([(header::CONTENT_TYPE, "application/json")], text).into_response(),
        Some(Err(error)) => refuse(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
        None => refuse(StatusCode::SERVICE_UNAVAILABLE, "the graph has not started"),
    }
}

async fn metrics(State(shared): State<Arc<Shared>>) -> Response {
    match shared.report() {
        Some(report) => ([(header::CONTENT_TYPE, metrics::CONTENT_TYPE)], metrics::text(&report)).into_response(),
        None => refuse(StatusCode::SERVICE_UNAVAILABLE, "the graph has not started"),
    }
}

async fn picture(State(shared): State<Arc<Shared>>, Path(name): Path<String>) -> Response {
    // Encoding takes milliseconds, which other requests do not wait for.
    let encoded = tokio::task::spawn_blocking(move || shared.picture(&name)).await;
    match encoded {
        Ok(Some(Ok(picture))) => {
            let mut headers = HeaderMap::new();
            headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("image/jpeg"));
            headers.insert("x-tick", HeaderValue::from(picture.tick));
            if let Some(age) = picture.age_ms.and_then(|ms| HeaderValue::from_str(&format!("{ms:.1}")).ok()) {
                headers.insert("x-age-ms", age);
            }
            (headers, picture.jpeg).into_response()
        }
        Ok(Some(Err(words))) => refuse(StatusCode::SERVICE_UNAVAILABLE, &words),
        Ok(None) => refuse(StatusCode::NOT_FOUND, "no picture has this name; `/state` lists them"),
        Err(error) => refuse(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
    }
}

async fn unknown() -> Response {
    refuse(StatusCode::NOT_FOUND, "there are /, /state, /pictures/NODE.OUTPUT and /metrics")
}
