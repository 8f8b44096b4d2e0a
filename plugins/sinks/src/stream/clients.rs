//! Clients of an RTSP server, each closed by the thread that serves it.

use std::collections::HashMap;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use gstreamer::glib::{MainContext, main_current_source};
use gstreamer_rtsp_server::prelude::*;
use gstreamer_rtsp_server::{RTSPClient, RTSPContext, RTSPFilterResult, RTSPServer};

/// Maximum time to wait until all clients are closed. One that waits for its first picture takes longer.
const MAX_CLOSE: Duration = Duration::from_secs(1);

/// The context of each client's thread. GStreamer crashes if a client is closed elsewhere while its thread reads from the connection.
#[derive(Default)]
pub struct Clients(Mutex<HashMap<RTSPClient, MainContext>>);

impl Clients {
    /// Follows the clients that connect to `server`.
    pub fn of(server: &RTSPServer) -> Arc<Self> {
        let clients = Arc::new(Self::default());
        let all = Arc::clone(&clients);
        server.connect_client_connected(move |_, client| {
            // A client begins with one of these.
            let found = Arc::clone(&all);
            let find = move |client: &RTSPClient, _: &RTSPContext| found.find(client);
            client.connect_options_request(find.clone());
            client.connect_describe_request(find.clone());
            client.connect_setup_request(find);
            let closed = Arc::clone(&all);
            client.connect_closed(move |client| drop(closed.lock().remove(client)));
        });
        clients
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, HashMap<RTSPClient, MainContext>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Called in the client's thread.
    fn find(&self, client: &RTSPClient) {
        if let Some(context) = main_current_source().and_then(|source| source.context()) {
            self.lock().insert(client.clone(), context);
        }
    }

    /// Closes all clients of `server`, which accepts no more.
    pub fn close(&self, server: &RTSPServer) {
        let (closed, all_closed) = channel::<()>();
        for client in server.client_filter(Some(&mut |_, _| RTSPFilterResult::Ref)) {
            let context = self.lock().get(&client).cloned();
            let closed = closed.clone();
            let close = move || {
                client.close();
                drop(closed);
            };
            match context {
                Some(context) => context.invoke(close),
                // It has made no request yet.
                None => close(),
            }
        }
        drop(closed);
        // Ends when the last client has dropped its end of the channel.
        let _ = all_closed.recv_timeout(MAX_CLOSE);
    }
}
