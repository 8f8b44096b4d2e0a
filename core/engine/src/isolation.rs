//! Nodes in processes of their own, as the engine sees them: who makes the processes attaches through [`Isolator`].

use std::collections::BTreeMap;
use std::ffi::c_void;
use std::sync::{Arc, Mutex, Weak};

use panoscope_abi as abi;
use panoscope_graph::Node;

use crate::sync::lock;

/// A call of a node that ended because the node's process did. The words come through [`abi::Host::fail`]. No plugin returns this status.
pub const STATUS_DIED: abi::Status = abi::Status::MIN;

/// Makes the processes of isolated nodes.
pub trait Isolator: Send + Sync {
    /// A group of nodes that share a process. The process starts when the first of them opens.
    ///
    /// # Errors
    /// Why there can be no such group on this machine.
    fn group(&self, settings: &GroupSettings) -> Result<Arc<dyn Group>, String>;
}

/// What a group is to be like.
#[derive(Clone, Debug)]
pub struct GroupSettings {
    /// Name in the graph.
    pub name: String,
    /// Threads of the run's pool; the process has as many for its parallel loops.
    pub threads: usize,
    /// Most bytes of private memory that the process may have.
    pub memory_bytes: u64,
}

/// The nodes of one name of `isolate`: they run in one process, which is started again after it died.
pub trait Group: Send + Sync {
    /// The functions of a node type as they are called for an instance that [`Self::open`] opened. The same for each call with one `entry`.
    fn proxy(&self, entry: &'static abi::NodeType) -> &'static abi::NodeType;

    /// [`abi::NodeType::open`] in the process.
    ///
    /// # Safety
    /// As for `open` of the contract: everything that the call points to outlives it, the host's functions outlive the instance.
    unsafe fn open(
        &self,
        entry: &'static abi::NodeType,
        call: *mut abi::OpenCall,
        instance: *mut *mut c_void,
    ) -> abi::Status;

    /// Number of the domain in which its nodes make frames, see [`crate::memory::Domain`].
    fn domain(&self) -> u32;

    /// Ends the process, with the reason for the faults of its nodes. Calls that run in it return [`STATUS_DIED`].
    fn kill(&self, reason: &str);
}

/// The groups of a run.
pub(crate) struct Groups {
    isolator: Mutex<Option<Arc<dyn Isolator>>>,
    known: Mutex<BTreeMap<String, Weak<dyn Group>>>,
    threads: usize,
    memory_bytes: u64,
}

/// Why a node cannot be isolated.
#[derive(Debug, thiserror::Error)]
#[error("node `{node}` cannot run in the process of group `{group}`: {reason}")]
pub(crate) struct NotIsolated {
    node: String,
    group: String,
    reason: String,
}

impl Groups {
    pub fn new(isolator: Option<Arc<dyn Isolator>>, threads: usize, memory_bytes: u64) -> Self {
        Self { isolator: Mutex::new(isolator), known: Mutex::default(), threads, memory_bytes }
    }

    /// New groups are made by this one from now on.
    pub fn set_isolator(&self, isolator: Option<Arc<dyn Isolator>>) {
        if isolator.is_some() {
            *lock(&self.isolator) = isolator;
        }
    }

    /// A group for one node that is tried in a process of its own.
    pub fn for_trial(&self, node: &str, memory_bytes: u64) -> Result<Arc<dyn Group>, String> {
        let settings = GroupSettings { name: format!("trial of {node}"), threads: self.threads, memory_bytes };
        match &*lock(&self.isolator) {
            Some(isolator) => isolator.group(&settings),
            None => Err("this program runs no processes for nodes".to_owned()),
        }
    }

    /// The group that a node runs in, if it is isolated. It exists as long as one of its nodes does.
    pub fn of(&self, node: &Node) -> Result<Option<Arc<dyn Group>>, NotIsolated> {
        let Some(name) = &node.isolate else { return Ok(None) };
        let mut known = lock(&self.known);
        if let Some(group) = known.get(name).and_then(Weak::upgrade) {
            return Ok(Some(group));
        }
        let settings = GroupSettings { name: name.clone(), threads: self.threads, memory_bytes: self.memory_bytes };
        let made = match &*lock(&self.isolator) {
            Some(isolator) => isolator.group(&settings),
            None => Err("this program runs no processes for nodes".to_owned()),
        };
        let group = made.map_err(|reason| NotIsolated { node: node.id.clone(), group: name.clone(), reason })?;
        known.insert(name.clone(), Arc::downgrade(&group));
        Ok(Some(group))
    }
}
