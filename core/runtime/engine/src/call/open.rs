//! Opening an instance of a node.

use std::sync::Arc;

use panoscope_abi::{self as abi, Str};

use crate::claims::Holds;
use crate::current_node;
use crate::host::CallContext;
use crate::instance::Instance;
use crate::isolation::Group;
use crate::log::Level;
use crate::node::NodeRuntime;
use crate::params::Snapshot;
use crate::run_context::RunContext;

/// A node did not open.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub(crate) struct NotOpened {
    /// The node's own message.
    pub message: String,
}

impl NodeRuntime {
    /// Opens an instance with the given values.
    pub fn open(&self, context: &RunContext, snapshot: &Snapshot) -> Result<Instance, NotOpened> {
        if context.decider.as_ref().is_some_and(|d| d.closes(self.source, self.side_effects)) {
            return Ok(Instance::none(self.node_type));
        }
        // A trial must neither touch a device nor act.
        if let Some(vet) = context.vet.as_ref().filter(|_| !self.exclusive && !self.side_effects) {
            self.pass(&**vet, context, snapshot)?;
        }
        self.open_in(context, snapshot, self.group.as_ref(), false)
    }

    /// Opens an instance in the process of `group`, or in this one. Log lines of a trial are dropped, because the
    /// instance that opens next writes them.
    pub(super) fn open_in(
        &self,
        context: &RunContext,
        snapshot: &Snapshot,
        group: Option<&Arc<dyn Group>>,
        is_trial: bool,
    ) -> Result<Instance, NotOpened> {
        let node_type = group.map_or(self.declared, |group| group.proxy(self.declared));
        let mut instance = Instance::none(node_type);
        *instance.holds = Holds::new(&context.claims);
        instance.retained.belongs_to(&self.who);
        let mut failure = String::new();
        let mut call_context = CallContext::without_tick(self, context, &instance.holds, &mut failure);
        call_context.is_trial = is_trial;
        let mut call = abi::OpenCall {
            struct_size: size_of::<abi::OpenCall>() as u32,
            flags: if context.batch { abi::CALL_BATCH } else { 0 },
            host: &raw const context.host,
            call: (&raw mut call_context).cast(),
            node_id: Str::borrow(&self.id),
            params: snapshot.values().as_ptr(),
            params_len: snapshot.values().len(),
            graph_dir: Str::borrow(&context.graph_dir),
            outputs_read: self.outputs_read(),
        };
        let mut raw = std::ptr::null_mut();
        let open = || match (group, node_type.open) {
            // SAFETY: the plugin contract; everything the call points to outlives it, and the run outlives its instances.
            (Some(group), _) => unsafe { group.open(self.declared, &raw mut call, &raw mut raw) },
            // SAFETY: the plugin contract; everything the call points to outlives it.
            (None, Some(open)) => unsafe { open(&raw mut call, &raw mut raw) },
            (None, None) => abi::STATUS_INVALID,
        };
        for denied in self.group.iter().flat_map(|group| group.not_enforced()) {
            let words = format!(
                "its group is denied `{denied}`, but this kernel cannot refuse it; `panoscope doctor` has details"
            );
            context.log.write(Level::Warn, &self.id, &words);
        }
        let status = current_node::opening(&self.who, || instance.retained.during(open));
        if status == abi::STATUS_OK {
            (instance.raw, instance.open) = (raw, true);
            return Ok(instance);
        }
        if failure.is_empty() {
            failure = format!("it did not open (status {status})");
        }
        self.recovery.set_permanent(status == abi::STATUS_STOPPED);
        Err(NotOpened { message: failure })
    }
}
