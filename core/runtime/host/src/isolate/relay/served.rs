//! The other machine's end of a connection: a process of isolated nodes, for which this process acts as the host.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use panoscope_engine::isolation::GroupSettings;

use super::RelayError;
use crate::isolate::host::{Launch, LaunchError, NodeLane, Process, Totals};
use crate::isolate::lane::{MAX_MESSAGE_BYTES, Side};
use crate::isolate::wire::lane::{Kind, Settings};

/// A process of isolated nodes that did not start.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The program to start is not known.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The program does not start.
    #[error("a process could not be started from {}: {cause}", program.display())]
    Start {
        /// The program.
        program: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
}

/// A process of isolated nodes whose host is on another machine. It ends when this is dropped.
pub struct Served(Arc<Process>);

impl Served {
    /// Starts the process of group `name`.
    ///
    /// # Errors
    /// It could not be started.
    pub fn start(name: &str, settings: Settings) -> Result<Self, ServeError> {
        let launch = Launch::own()?;
        let Settings { threads, memory_bytes, deny } = settings;
        let group = GroupSettings {
            name: name.to_owned(),
            threads: threads as usize,
            memory_bytes,
            deny,
            keeps_stderr: true,
            machine: None,
        };
        let what = format!("the process of group `{name}`");
        let process = Process::start(&launch, &group, what, 0, &Arc::new(Totals::default()));
        process.map(Self).map_err(|cause| ServeError::Start { program: launch.program, cause })
    }

    /// Sends it a pool, writable if the pool is its own.
    ///
    /// # Errors
    /// It has ended.
    pub fn give_pool(&self, number: u32, file: &File, len: usize, is_own: bool) -> io::Result<()> {
        self.0.give_pool_file(number, file, len, is_own)
    }

    /// Sends it a plugin: the bytes, and the file for messages.
    ///
    /// # Errors
    /// It has ended.
    pub fn give_plugin(&self, id: u32, image: &File, path: &Path) -> io::Result<()> {
        self.0.give_plugin_file(id, image, path)
    }

    /// A lane of a new instance. `node` names it in messages.
    ///
    /// # Errors
    /// The process has ended.
    pub fn lane(&self, node: &str) -> io::Result<ServedLane> {
        let lane = self.0.lane(node, format!("node `{node}`"))?;
        Ok(ServedLane { process: Arc::clone(&self.0), lane })
    }

    /// Ends the process.
    pub fn kill(&self, reason: &str) {
        self.0.kill(reason);
    }

    /// Waits for the end of the process and describes it.
    pub fn death(&self) -> String {
        self.0.death()
    }
}

/// The host's side of a lane.
pub struct ServedLane {
    process: Arc<Process>,
    lane: Arc<NodeLane>,
}

impl ServedLane {
    /// Forwards a message of the host and waits for the answer of the process; returns its kind.
    ///
    /// # Errors
    /// The process has ended, or a message is malformed.
    pub fn exchange(&self, kind: u32, message: &[u8], answer: &mut Vec<u8>) -> Result<u32, RelayError> {
        let kind = Kind::of(kind).filter(|_| message.len() <= MAX_MESSAGE_BYTES).ok_or(RelayError::Bad)?;
        let NodeLane { lane, in_call, .. } = &*self.lane;
        in_call.store(true, Ordering::Relaxed);
        lane.post(Side::Host, kind, message);
        // The end of the process closes lanes after it is recorded: a later post sees it here.
        if self.process.is_dead() {
            return Err(RelayError::Gone);
        }
        let answered = lane.receive(Side::Host, answer)?;
        in_call.store(answered != Kind::Done, Ordering::Relaxed);
        Ok(answered as u32)
    }

    /// Waits for the end of the process and describes it.
    pub fn death(&self) -> String {
        self.process.death()
    }
}

impl Drop for ServedLane {
    fn drop(&mut self) {
        self.process.drop_lane(&self.lane);
    }
}
