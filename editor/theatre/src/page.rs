//! The page of `--web`: pictures, ages and states of the theatre's graph for a browser, for reading only.
//!
//! The process that runs the graph serves it. After a crash the next process listens at the same address.

use std::time::{Duration, Instant};

use panoscope_engine::Engine;
use panoscope_host::loader::Loader;
use panoscope_monitor::{Address, Monitor};

/// Time between two updates.
const INTERVAL: Duration = Duration::from_millis(200);
/// Time between two attempts to listen: the process before this one may not have ended yet.
const AGAIN: Duration = Duration::from_secs(1);

/// What is served, or will be.
pub(super) struct Page {
    address: Address,
    monitor: Option<Monitor>,
    next: Instant,
    /// Whether the reason why it cannot listen is in the log.
    explained: bool,
}

impl Page {
    pub fn new(address: Address) -> Self {
        Self { address, monitor: None, next: Instant::now(), explained: false }
    }

    /// Takes over what there is to show, at most five times a second. The first call begins to listen.
    pub fn update(&mut self, engine: &Engine, loader: &Loader) {
        if Instant::now() < self.next {
            return;
        }
        self.next = Instant::now() + INTERVAL;
        if self.monitor.is_none() {
            match Monitor::start(self.address) {
                Ok(monitor) => {
                    eprintln!("serves http://{}", monitor.address());
                    self.monitor = Some(monitor);
                }
                Err(error) => {
                    self.next = Instant::now() + AGAIN;
                    if !std::mem::replace(&mut self.explained, true) {
                        eprintln!("error: --web: {error}; it is tried again every second");
                    }
                }
            }
        }
        if let Some(monitor) = &self.monitor {
            monitor.update(engine, |graph| loader.catalog_of_graph(graph));
        }
    }
}
