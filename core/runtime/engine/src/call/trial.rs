//! Opening a node in a separate process on trial, before it opens where it runs.

use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, channel};

use panoscope_abi as abi;

use super::open::NotOpened;
use crate::node::NodeRuntime;
use crate::params::Snapshot;
use crate::run_context::RunContext;
use crate::vet::{Opening, TrialError, TrialLimits, Vet};

impl NodeRuntime {
    /// Asks `vet` whether the node may open with these values.
    pub(super) fn pass(&self, vet: &dyn Vet, context: &RunContext, snapshot: &Snapshot) -> Result<(), NotOpened> {
        let declared = match self.declared.params_len {
            0 => &[][..],
            // SAFETY: a validated descriptor of a plugin that stays mapped.
            len => unsafe { std::slice::from_raw_parts(self.declared.params, len) },
        };
        // SAFETY: as for the descriptor itself.
        let names = declared.iter().map(|param: &abi::Param| unsafe { param.name.text() }.unwrap_or("?"));
        let params = names.zip(snapshot.owned()).collect();
        let opening = Opening { node: &self.id, plugin_file: &self.who.file, params };
        vet.vet(&opening, &mut |limits| self.try_open(context, snapshot, limits))
            .map_err(|error| NotOpened { message: error.to_string() })
    }

    /// Opens the node in a new process and closes it again.
    fn try_open(&self, context: &RunContext, snapshot: &Snapshot, limits: &TrialLimits) -> Result<(), TrialError> {
        let group = context.groups.for_trial(&self.id, limits.memory_bytes)?;
        let (finished, is_finished) = channel::<()>();
        let (watched, time) = (Arc::clone(&group), limits.time);
        let watch = move || {
            if is_finished.recv_timeout(time) == Err(RecvTimeoutError::Timeout) {
                watched.kill(&format!("opening takes more than {} s", time.as_secs()));
            }
        };
        let watch = std::thread::Builder::new().name("trial".to_owned()).spawn(watch);
        let watch = watch.map_err(|cause| TrialError::Thread { cause })?;
        // Closed on drop, within the same limit.
        let opened = self.open_in(context, snapshot, Some(&group), true).map(drop);
        drop(finished);
        // Holds the group: its process and memory must be gone before the node opens here.
        let _ = watch.join();
        opened.map_err(|NotOpened { message }| TrialError::Node { message })
    }
}
