//! `panoscope serve`: serves groups of nodes for other machines.

use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};

use panoscope_engine::sync::lock;
use panoscope_host::isolate::system_ns;
use zenoh::Wait;
use zenoh::sample::Sample;

use crate::files::Hashes;
use crate::network::{self, Address, NetworkError, UNNAMED};
use crate::served;
use crate::sessions::{Delivered, Open, Shared};
pub use crate::sessions::{LogFn, Options};
use panoscope_host::isolate::relay::messages::{self as message, Message};

/// Maximum number of groups at a time.
const MAX_SESSIONS: usize = 32;

/// A server. It ends when this is dropped.
pub struct Server {
    shared: Arc<Shared>,
    _subscribers: Vec<zenoh::pubsub::Subscriber<()>>,
}

impl Server {
    /// Starts to listen. `log` receives a line when a group begins or ends.
    ///
    /// # Errors
    /// The address cannot be used, or keys are missing.
    pub fn start(options: Options, log: Box<LogFn>) -> Result<Self, NetworkError> {
        let address = Address::parse(&options.address, options.plaintext)?;
        let session = network::listen(&options.name, &address, options.identity.as_ref(), &options.hosts)?;
        let hosts = if address.is_tls { options.hosts.clone() } else { vec![UNNAMED.to_owned()] };
        let prefix = format!("panoscope/{}", options.name);
        let shared = Arc::new(Shared { options, session, hashes: Hashes::default(), log, open: Mutex::default() });
        let mut subscribers = Vec::new();
        for host in hosts {
            for key in ["down", "ping"] {
                let mine = Arc::clone(&shared);
                let name = host.clone();
                let callback = move |sample: Sample| {
                    let Some(id) = network::session_of(&sample) else { return };
                    match key {
                        "down" => mine.receive(&name, id, &sample),
                        _ => mine.answer_probe(&name, id, &sample),
                    }
                };
                let declared = shared.session.declare_subscriber(format!("{prefix}/{host}/*/{key}"));
                let subscriber = declared.callback(callback).wait();
                subscribers.push(subscriber.map_err(|error| NetworkError::Zenoh(error.to_string()))?);
            }
        }
        Ok(Self { shared, _subscribers: subscribers })
    }

    /// Groups that are served now: the host of each, and its name.
    pub fn groups(&self) -> Vec<(String, String)> {
        lock(&self.shared.open).iter().map(|((host, _), open)| (host.clone(), open.group.clone())).collect()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        lock(&self.shared.open).clear();
        let _ = self.shared.session.close().wait();
    }
}

impl Shared {
    fn answer_probe(&self, host: &str, id: String, sample: &Sample) {
        let now_ns = system_ns();
        let key = self.key(host, &id, "pong");
        let makes_sense = network::answer_probe(&self.session, key, sample, now_ns);
        if let Some(open) = lock(&self.open).get(&(host.to_owned(), id)).filter(|_| makes_sense) {
            open.heard_ns.store(now_ns, Ordering::Relaxed);
        }
    }

    fn receive(self: &Arc<Self>, host: &str, id: String, sample: &Sample) {
        let payload = sample.payload();
        let mut reader = payload.reader();
        let Ok(message) = message::read(&mut reader) else {
            self.log(&format!("{host} sends malformed messages: it may be of another version"));
            return;
        };
        let begin = (payload.len() - reader.remaining()) as u64;
        let session = (host.to_owned(), id);
        let mut open = lock(&self.open);
        if let Message::Hello { group, .. } = &message {
            // A link that comes again has lost its predecessor.
            open.retain(|(known, _), old| known != host || old.group != *group);
            if open.len() >= MAX_SESSIONS {
                self.log(&format!("{host} is refused: {MAX_SESSIONS} groups run already"));
                return;
            }
            let (deliver, delivered) = channel();
            let heard_ns = Arc::new(AtomicI64::new(system_ns()));
            let group = group.clone();
            let (mine, heard) = (Arc::clone(self), Arc::clone(&heard_ns));
            let (host, id) = session.clone();
            let work = move || served::run(&mine, &host, &id, &delivered, &heard);
            if std::thread::Builder::new().spawn(work).is_err() {
                return;
            }
            open.insert(session.clone(), Open { deliver, heard_ns, group });
        }
        if let Some(known) = open.get(&session) {
            known.heard_ns.store(system_ns(), Ordering::Relaxed);
            let _ = known.deliver.send(Delivered { message, payload: payload.clone(), begin });
        }
    }
}
