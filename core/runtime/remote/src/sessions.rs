//! What a server and the groups that it serves share.

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

/// How a server is to be.
#[derive(Clone, Debug)]
pub struct Options {
    /// Name of this machine in graphs.
    pub name: String,
    /// Where to listen.
    pub address: String,
    /// Whether an address without encryption may be one that other machines reach.
    pub plaintext: bool,
    /// The keys of this machine.
    pub identity: Option<Identity>,
    /// Hosts that may use it, by the names in their certificates.
    pub hosts: Vec<String>,
    /// The folder here that stands for the folder of a host's graph.
    pub graph_dir: PathBuf,
    /// Folders of plugins besides those of the installation.
    pub plugins: Vec<PathBuf>,
}

/// A line for the log.
pub type LogFn = dyn Fn(&str) + Send + Sync;

/// What all groups share.
pub(crate) struct Shared {
    pub options: Options,
    pub session: Session,
    pub hashes: Hashes,
    pub log: Box<LogFn>,
    pub open: Mutex<HashMap<(String, String), Open>>,
}

/// A group that is served.
pub(crate) struct Open {
    pub deliver: Sender<Delivered>,
    pub heard_ns: Arc<AtomicI64>,
    /// Its name, as the host gave it.
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

    /// The key of a session, for what goes to its host.
    pub fn key(&self, host: &str, id: &str, what: &str) -> String {
        format!("{}/{what}", network::prefix(&self.options.name, host, id))
    }

    /// A session has ended.
    pub fn end(&self, host: &str, id: &str) {
        lock(&self.open).remove(&(host.to_owned(), id.to_owned()));
    }
}
