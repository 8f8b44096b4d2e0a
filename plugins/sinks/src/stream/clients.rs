//! Clients of an RTSP server, each closed by the thread that serves it.

use std::collections::HashMap;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use gstreamer::glib::{ControlFlow, MainContext, Priority, idle_source_new, main_current_source};
use gstreamer_rtsp_server::prelude::*;
use gstreamer_rtsp_server::{RTSPClient, RTSPContext, RTSPServer};

/// Maximum time to wait until all clients are closed. One that waits for its first picture takes longer.
const MAX_CLOSE: Duration = Duration::from_secs(1);

/// The context of each client's thread; `None` once the server has ended. If a client is closed elsewhere while its thread reads from the
/// connection, that thread crashes or never ends.
pub struct Clients(Mutex<Option<HashMap<RTSPClient, MainContext>>>);

impl Clients {
    /// Follows the clients that connect to `server`.
    pub fn of(server: &RTSPServer) -> Arc<Self> {
        let clients = Arc::new(Self(Mutex::new(Some(HashMap::new()))));
        let all = Arc::clone(&clients);
        server.connect_client_connected(move |_, client| {
            // A client begins with one of these.
            let found = Arc::clone(&all);
            let find = move |client: &RTSPClient, _: &RTSPContext| found.find(client);
            client.connect_options_request(find.clone());
            client.connect_describe_request(find.clone());
            client.connect_setup_request(find);
            let closed = Arc::clone(&all);
            client.connect_closed(move |client| drop(closed.lock().as_mut().and_then(|all| all.remove(client))));
        });
        clients
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Option<HashMap<RTSPClient, MainContext>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Called in the client's thread.
    fn find(&self, client: &RTSPClient) {
        let Some(context) = main_current_source().and_then(|source| source.context()) else { return };
        match &mut *self.lock() {
            Some(all) => drop(all.insert(client.clone(), context)),
            // After the request: its connection is still in use.
            None => {
                let client = client.clone();
                let close = move || {
                    client.close();
                    ControlFlow::Break
                };
                idle_source_new(None, Priority::DEFAULT, close).attach(Some(&context));
            }
        }
    }

    /// Closes all clients of a server that accepts no more. One that has made no request yet is closed when it does.
    pub fn close(&self) {
        let (closed, all_closed) = channel::<()>();
        let clients = self.lock().take();
        for (client, context) in clients.into_iter().flatten() {
            let closed = closed.clone();
            context.invoke(move || {
                client.close();
                drop(closed);
            });
        }
        drop(closed);
        // Ends when the last client has dropped its end of the channel.
        let _ = all_closed.recv_timeout(MAX_CLOSE);
    }
}
