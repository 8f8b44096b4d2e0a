//! Completes the files of nodes before their instances close, and records losses for the run's outcome.

use panoscope_abi as abi;
use panoscope_graph::OnFault;

use crate::busy::CallKind;
use crate::current_node;
use crate::fault::{Action, Cause};
use crate::host::CallContext;
use crate::instance::Instance;
use crate::isolation::STATUS_DIED;
use crate::log::Level;
use crate::node::NodeRuntime;
use crate::run_context::RunContext;
use crate::stats::bump;
use crate::sync::lock;

impl NodeRuntime {
    /// Has an instance complete its files. A failure is a fault and fails the run.
    pub fn finish(&self, context: &RunContext, instance: &mut Instance) {
        let Some(finish) = instance.node_type.finish_function().filter(|_| instance.is_open() && instance.begun) else {
            return;
        };
        let mut failure = String::new();
        let mut call_context = CallContext::without_tick(self, context, &instance.holds, &mut failure);
        let (raw, host, call) = (instance.raw, &raw const context.host, (&raw mut call_context).cast());
        let status = current_node::with(&self.who, CallKind::Finish, || {
            // SAFETY: the plugin contract: an open instance that no other thread uses, since the caller owns it; table and handle outlive the call.
            instance.retained.during(|| unsafe { finish(raw, host, call) })
        });
        // The death of a process was reported when it came; a node that writes nothing has nothing to complete.
        if status == abi::STATUS_OK || (status == STATUS_DIED && !self.side_effects) {
            return;
        }
        if failure.is_empty() {
            failure = "it returned no message".to_owned();
        }
        let words = format!("its output could not be completed: {failure}");
        bump(&self.stats.faults);
        context.log.write(Level::Error, &self.id, &words);
        self.lost(context, &words);
        let cause = if status == abi::STATUS_PANIC { Cause::Panic } else { Cause::Error };
        self.report_fault(context, cause, Action::Note, None, None, words);
    }

    /// Completes the files of an instance and closes it.
    pub fn end(&self, context: &RunContext, mut instance: Instance) {
        self.finish(context, &mut instance);
    }

    /// Records that the node lost data irrecoverably: the run has failed.
    #[cold]
    pub fn lost(&self, context: &RunContext, words: &str) {
        lock(&context.stopped).entry(self.id.clone()).or_insert_with(|| words.to_owned());
    }

    /// Records that the node stays bypassed: the run has failed, unless the graph says `on_fault = "bypass"`.
    #[cold]
    pub fn record_bypassed(&self, context: &RunContext, words: &str) {
        if self.on_fault() != OnFault::Bypass {
            self.lost(context, words);
        }
    }

    /// Whether a restart would not cure the last error of the node.
    pub fn has_given_up(&self) -> bool {
        self.recovery.is_permanent()
    }
}
