//! RTSP servers: one per address and port of the process, with a path per node.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::Duration;

use gstreamer::glib::{ControlFlow, MainContext, MainLoop, SourceId};
use gstreamer::prelude::*;
use gstreamer_app::AppSrc;
use gstreamer_rtsp_server::prelude::*;
use gstreamer_rtsp_server::{RTSPMediaFactory, RTSPMountPoints, RTSPServer};

use super::clients::Clients;
use super::fanout::{Fanout, Payload, SOURCE};
use crate::serving::{ServeError, refused};

/// Maximum number of clients of a server at a time.
const MAX_SESSIONS: u32 = 32;

/// Interval at which sessions of clients that left without notice are removed.
const CLEAN_UP_EVERY: Duration = Duration::from_secs(2);

struct Server {
    bound: SocketAddr,
    clients: Arc<Clients>,
    mounts: RTSPMountPoints,
    /// Node that serves each path.
    paths: Mutex<BTreeMap<String, String>>,
    context: MainContext,
    sources: Mutex<Vec<SourceId>>,
    main_loop: MainLoop,
    thread: Option<JoinHandle<()>>,
}

static SERVERS: Mutex<Vec<Weak<Server>>> = Mutex::new(Vec::new());

impl Server {
    fn start(asked: SocketAddr) -> Result<Self, ServeError> {
        // The server itself does not say why it cannot listen.
        TcpListener::bind(asked).map_err(|error| refused(asked, &error))?;
        let failed =
            |reason: String| ServeError::Listen { at: asked, reason, help: "give another `address` or `port`" };
        let rtsp = RTSPServer::new();
        rtsp.set_address(&asked.ip().to_string());
        rtsp.set_service(&asked.port().to_string());
        let mounts = RTSPMountPoints::new();
        rtsp.set_mount_points(Some(&mounts));
        let clients = Clients::of(&rtsp);
        if let Some(threads) = rtsp.thread_pool() {
            // One for each client: a client that waits for the first picture must not hold up others.
            threads.set_max_threads(-1);
        }
        let context = MainContext::new();
        let attached = rtsp.attach(Some(&context)).map_err(|error| failed(error.to_string()))?;
        let port = u16::try_from(rtsp.bound_port()).map_err(|_| failed("it has no port".to_owned()))?;
        let mut sources = vec![attached];
        if let Some(sessions) = rtsp.session_pool() {
            sessions.set_max_sessions(MAX_SESSIONS);
            let clean_up = gstreamer::glib::timeout_source_new(
                CLEAN_UP_EVERY,
                None,
                gstreamer::glib::Priority::DEFAULT,
                move || {
                    sessions.cleanup();
                    ControlFlow::Continue
                },
            );
            sources.push(clean_up.attach(Some(&context)));
        }
        let main_loop = MainLoop::new(Some(&context), false);
        let (own_loop, own_context) = (main_loop.clone(), context.clone());
        let run = move || {
            // Fails only where another thread runs this context.
            let _ = own_context.with_thread_default(|| own_loop.run());
        };
        let thread = std::thread::Builder::new()
            .name("stream-server".to_owned())
            .spawn(run)
            .map_err(|error| failed(error.to_string()))?;
        Ok(Self {
            bound: SocketAddr::new(asked.ip(), port),
            clients,
            mounts,
            paths: Mutex::default(),
            context,
            sources: Mutex::new(sources),
            main_loop,
            thread: Some(thread),
        })
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
        for source in self.sources.get_mut().unwrap_or_else(PoisonError::into_inner).drain(..) {
            if let Some(source) = self.context.find_source_by_id(&source) {
                source.destroy();
            }
        }
        // From inside the loop, so that one that has not begun yet ends too.
        let main_loop = self.main_loop.clone();
        self.context.invoke(move || main_loop.quit());
        if let Some(thread) = self.thread.take() {
            // A panic was printed when it happened.
            let _ = thread.join();
        }
        // No client is being accepted any more.
        self.clients.close();
    }
}

/// A served path; removed when dropped.
pub struct Mount {
    server: Arc<Server>,
    path: String,
}

impl Mount {
    /// Serves the packets of `fanout` at `path`. Each client gets a separate pipeline, so that a slow one delays no other.
    ///
    /// # Errors
    /// The system does not allow listening on the address, or another node serves the path.
    pub fn new(
        address: IpAddr,
        port: u16,
        path: &str,
        node: &str,
        payload: Payload,
        fanout: &Arc<Fanout>,
    ) -> Result<Self, ServeError> {
        let server = Server::get(SocketAddr::new(address, port))?;
        let path = format!("/{}", path.trim_matches('/'));
        {
            let mut paths = server.paths.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(node) = paths.get(&path) {
                return Err(ServeError::Taken { node: node.clone(), path, at: server.bound });
            }
            paths.insert(path.clone(), node.to_owned());
        }
        let factory = RTSPMediaFactory::new();
        factory.set_launch(&format!("( {SOURCE} ! {} )", payload.text("pay0")));
        let fanout = Arc::downgrade(fanout);
        factory.connect_media_configure(move |_, media| {
            let Some(fanout) = fanout.upgrade() else { return };
            let source = media.element().downcast::<gstreamer::Bin>().ok().and_then(|bin| bin.by_name("source"));
            let Some(source) = source.and_then(|source| source.downcast::<AppSrc>().ok()) else { return };
            let id = fanout.add(source);
            let fanout = Arc::downgrade(&fanout);
            media.connect_unprepared(move |_| {
                if let Some(fanout) = fanout.upgrade() {
                    fanout.remove(id);
                }
            });
        });
        server.mounts.add_factory(&path, factory);
        Ok(Self { server, path })
    }

    /// The port that the server listens on.
    pub fn port(&self) -> u16 {
        self.server.bound.port()
    }

    /// Address of the stream.
    pub fn url(&self) -> String {
        format!("rtsp://{}{}", self.server.bound, self.path)
    }
}

impl Drop for Mount {
    fn drop(&mut self) {
        self.server.mounts.remove_factory(&self.path);
        self.server.paths.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use std::io::{ErrorKind, Read, Write};
    use std::net::{Ipv4Addr, TcpStream};
    use std::sync::mpsc::channel;
    use std::thread::{ThreadId, current};

    use super::*;
    use crate::stream::codec::StreamCodec;

    #[test]
    fn a_client_is_closed_by_its_own_thread() {
        const PATIENCE: Duration = Duration::from_secs(20);
        gstreamer::init().unwrap();
        let fanout = Arc::new(Fanout::default());
        let payload = Payload::of(StreamCodec::Mjpg);
        let mount = Mount::new(Ipv4Addr::LOCALHOST.into(), 0, "/live", "out", payload, &fanout).unwrap();
        let request = format!("OPTIONS {} RTSP/1.0\r\nCSeq: 1\r\n\r\n", mount.url());
        let connect = || {
            let client = TcpStream::connect(("127.0.0.1", mount.port())).unwrap();
            client.set_read_timeout(Some(PATIENCE)).unwrap();
            client
        };
        // Accepted before the other.
        let mut silent = connect();
        let mut client = connect();
        let mut answer = [0; 4096];
        let (served, context) = loop {
            client.write_all(request.as_bytes()).unwrap();
            let bytes = client.read(&mut answer).unwrap();
            assert!(answer[..bytes].starts_with(b"RTSP/1.0 200"));
            // The first request may have come before the server's thread went on.
            if let Some((served, context)) = mount.server.clients.lock().iter().flatten().next() {
                break (served.clone(), context.clone());
            }
        };
        let (threads, thread) = channel::<ThreadId>();
        let own = threads.clone();
        context.invoke(move || own.send(current().id()).unwrap());
        let own = thread.recv_timeout(PATIENCE).unwrap();
        served.connect_closed(move |_| threads.send(current().id()).unwrap());
        drop(mount);
        assert_eq!(thread.recv_timeout(PATIENCE), Ok(own));
        client.read_to_end(&mut Vec::new()).unwrap();
        // No thread but its own may close it, and that one waits for a request.
        silent.set_nonblocking(true).unwrap();
        assert_eq!(silent.read(&mut answer).map_err(|error| error.kind()), Err(ErrorKind::WouldBlock));
        silent.set_nonblocking(false).unwrap();
        silent.write_all(request.as_bytes()).unwrap();
        silent.read_to_end(&mut Vec::new()).unwrap();
    }
}
