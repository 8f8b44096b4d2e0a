//! Nodes in separate processes, as the engine sees them. The code that makes the processes attaches through
//! [`Isolator`].

use std::collections::BTreeMap;
use std::ffi::c_void;
use std::sync::{Arc, Mutex, Weak};

use panoscope_abi as abi;
use panoscope_graph::Node;
pub use panoscope_graph::{Deny, Machine, Pixels};
use serde::Serialize;

use crate::memory::DomainError;
pub use crate::outputs::fits;
use crate::sync::lock;

/// A call of a node that ended because the node's process did. The message comes through [`abi::Host::fail`]. No plugin
/// returns this status.
pub const STATUS_DIED: abi::Status = abi::Status::MIN;

/// A group of isolated nodes cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum GroupError {
    /// The program that runs the graph has no [`Isolator`].
    #[error("this program cannot start processes for nodes")]
    NoIsolator,
    /// No memory that it could share with its process.
    #[error(transparent)]
    Memory(#[from] DomainError),
}

/// Makes the processes of isolated nodes.
pub trait Isolator: Send + Sync {
    /// A group of nodes that share a process. The process starts when the first of them opens.
    ///
    /// # Errors
    /// There can be no such group on this machine.
    fn group(&self, settings: &GroupSettings) -> Result<Arc<dyn Group>, GroupError>;
}

/// Settings of a group of isolated nodes.
#[derive(Clone, Debug)]
pub struct GroupSettings {
    /// Name in the graph.
    pub name: String,
    /// Threads of the run's pool; the process has as many for its parallel loops.
    pub threads: usize,
    /// Maximum number of bytes of private memory that the process may have.
    pub memory_bytes: u64,
    /// Denied permissions of its nodes.
    pub deny: Deny,
    /// Whether the standard error of the process goes into the message about its end instead of to this process's
    /// standard error.
    pub keeps_stderr: bool,
    /// The machine that it runs on, if it is another one.
    pub machine: Option<Machine>,
}

/// The nodes of one name of `isolate`: they run in one process, which is started again after it died.
pub trait Group: Send + Sync {
    /// The functions of a node type for instances that [`Self::open`] opened. The same for each call with one `entry`.
    fn proxy(&self, entry: &'static abi::NodeType) -> &'static abi::NodeType;

    /// [`abi::NodeType::open`] in the process.
    ///
    /// # Safety
    /// As for `open` of the contract: everything that the call points to outlives it, the host's functions outlive the
    /// instance.
    unsafe fn open(
        &self,
        entry: &'static abi::NodeType,
        call: *mut abi::OpenCall,
        instance: *mut *mut c_void,
    ) -> abi::Status;

    /// Maximum pause before a failed node is reopened, ms; short where only a connection has to recover.
    fn max_pause_ms(&self) -> u64 {
        u64::MAX
    }

    /// Parts of [`GroupSettings::deny`] that this kernel cannot enforce, as named in a graph file.
    fn not_enforced(&self) -> Vec<&'static str>;

    /// Cost of the calls of its nodes so far.
    fn counts(&self) -> GroupReport;

    /// Number of the domain in which its nodes make frames, see [`crate::memory::Domain`].
    fn domain(&self) -> u32;

    /// Ends the process, with the reason for the faults of its nodes. Calls that run in it return [`STATUS_DIED`].
    fn kill(&self, reason: &str);
}

/// Cost of a group of isolated nodes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct GroupReport {
    /// Number of the process that runs its nodes now; null while none does, or one starts.
    pub process_id: Option<u32>,
    /// Processes started: one, and another after each that died.
    pub processes: u64,
    /// Ticks that its nodes processed.
    pub calls: u64,
    /// Messages to the process and back for these ticks; one each if no further question is asked.
    pub round_trips: u64,
    /// Times the host slept until a message came.
    pub sleeps: u64,
    /// Denials of the graph that this kernel cannot enforce.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub not_enforced: Vec<&'static str>,
    /// The connection to the machine that it runs on, if it is another one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub link: Option<LinkReport>,
}

/// The connection to another machine.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LinkReport {
    /// Its address.
    pub address: String,
    /// Its clock minus this machine's, both the system's monotonic clocks, ns; null while it is unknown.
    pub clock_offset_ns: Option<i64>,
    /// Largest error of the offset, ns.
    pub clock_uncertainty_ns: u64,
    /// Time there and back of the last probe, ns.
    pub round_trip_ns: u64,
    /// Bytes of messages and pixels sent there, since the connection was made.
    pub sent_bytes: u64,
    /// Bytes received from there.
    pub received_bytes: u64,
}

/// The settings of a group that exists.
type Known = (Deny, Option<Machine>, Weak<dyn Group>);

/// The groups of a run.
pub(crate) struct Groups {
    isolator: Mutex<Option<Arc<dyn Isolator>>>,
    known: Mutex<BTreeMap<String, Known>>,
    threads: usize,
    memory_bytes: u64,
    keeps_stderr: bool,
}

/// A node cannot be isolated.
#[derive(Debug, thiserror::Error)]
#[error("node `{node}` cannot run in the process of group `{group}`: {reason}")]
pub(crate) struct NotIsolated {
    node: String,
    group: String,
    reason: GroupError,
}

impl Groups {
    pub fn new(isolator: Option<Arc<dyn Isolator>>, threads: usize, memory_bytes: u64, keeps_stderr: bool) -> Self {
        Self { isolator: Mutex::new(isolator), known: Mutex::default(), threads, memory_bytes, keeps_stderr }
    }

    /// Sets the maker of further groups.
    pub fn set_isolator(&self, isolator: Option<Arc<dyn Isolator>>) {
        if isolator.is_some() {
            *lock(&self.isolator) = isolator;
        }
    }

    /// A group for one node that is opened on trial in a separate process.
    pub fn for_trial(&self, node: &str, memory_bytes: u64) -> Result<Arc<dyn Group>, GroupError> {
        let settings = GroupSettings {
            name: format!("trial of {node}"),
            threads: self.threads,
            memory_bytes,
            deny: Deny::default(),
            keeps_stderr: true,
            machine: None,
        };
        match &*lock(&self.isolator) {
            Some(isolator) => isolator.group(&settings),
            None => Err(GroupError::NoIsolator),
        }
    }

    /// Counters of the groups that exist.
    pub fn report(&self) -> BTreeMap<String, GroupReport> {
        let known = lock(&self.known);
        known.iter().filter_map(|(name, (.., group))| Some((name.clone(), group.upgrade()?.counts()))).collect()
    }

    /// The group that a node runs in, if it is isolated. It exists as long as one of its nodes does. The denials of a
    /// process are fixed, so another [`Node::deny`] means another group.
    pub fn of(&self, node: &Node) -> Result<Option<Arc<dyn Group>>, NotIsolated> {
        let Some(name) = &node.isolate else { return Ok(None) };
        let mut known = lock(&self.known);
        let deny = node.deny;
        if let Some((denied, machine, group)) = known.get(name)
            && *denied == deny
            && *machine == node.machine
            && let Some(group) = group.upgrade()
        {
            return Ok(Some(group));
        }
        let Self { threads, memory_bytes, keeps_stderr, .. } = *self;
        let settings = GroupSettings {
            name: name.clone(),
            threads,
            memory_bytes,
            deny,
            keeps_stderr,
            machine: node.machine.clone(),
        };
        let made = match &*lock(&self.isolator) {
            Some(isolator) => isolator.group(&settings),
            None => Err(GroupError::NoIsolator),
        };
        let group = made.map_err(|reason| NotIsolated { node: node.id.clone(), group: name.clone(), reason })?;
        known.insert(name.clone(), (deny, node.machine.clone(), Arc::downgrade(&group)));
        Ok(Some(group))
    }
}
