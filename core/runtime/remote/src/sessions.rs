//! State shared by a server and its groups.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::AtomicI64;
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex};

use panoscope_engine::sync::lock;
use panoscope_host::isolate::relay::messages::Message;
use zenoh::Session;
use zenoh::bytes::ZBytes;

use crate::files::Hashes;
use crate::keys::Identity;
use crate::network;

/// Settings of a server.
#[derive(Clone, Debug)]
pub struct Options {
    /// Name of this machine in graphs.
    pub name: String,
    /// Address to listen on.
    pub address: String,
    /// Whether an address without encryption may be reachable from other machines.
    pub plaintext: bool,
    /// The keys of this machine.
    pub identity: Option<Identity>,
    /// Hosts that may use it, by the names in their certificates.
    pub hosts: Vec<String>,
    /// The local folder that replaces the folder of a host's graph.
    pub graph_dir: PathBuf,
    /// Folders of plugins besides those of the installation.
    pub plugins: Vec<PathBuf>,
}

/// Receives a line of the log.
pub type LogFn = dyn Fn(&str) + Send + Sync;

/// State shared by all groups.
pub(crate) struct Shared {
    pub options: Options,
    pub session: Session,
    pub hashes: Hashes,
    pub log: Box<LogFn>,
    pub open: Mutex<HashMap<(String, String), Open>>,
}

/// A group in service.
pub(crate) struct Open {
    pub deliver: Sender<Delivered>,
    pub heard_ns: Arc<AtomicI64>,
    /// Name given by the host.
    pub group: String,
}

/// A message of the host; the bytes of its frames begin at `begin`.
pub(crate) struct Delivered {
    pub message: Message,
    pub payload: ZBytes,
    pub begin: u64,
}

impl Shared {
    /// Writes a line to the log.
    pub fn log(&self, words: &str) {
        (self.log)(words);
    }

    /// The key of a session for messages to its host.
    pub fn key(&self, host: &str, id: &str, what: &str) -> String {
        format!("{}/{what}", network::prefix(&self.options.name, host, id))
    }

    /// Removes a session that has ended.
    pub fn end(&self, host: &str, id: &str) {
        lock(&self.open).remove(&(host.to_owned(), id.to_owned()));
    }
}
