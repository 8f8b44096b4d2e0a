//! Completing what nodes write before their instances are closed, and what the run is told when something is lost.

use panoscope_abi as abi;
use panoscope_graph::OnFault;

use super::{NodeRuntime, RunContext};
use crate::busy::CallKind;
use crate::ending::who;
use crate::fault::{Action, Cause};
use crate::host::CallContext;
use crate::instance::Instance;
use crate::log::Level;
use crate::stats::bump;
use crate::sync::lock;

impl NodeRuntime {
    /// Has an instance complete its files; what it could not is a fault, and fails the run.
    pub fn finish(&self, context: &RunContext, instance: &mut Instance) {
        let Some(finish) = instance.node_type.finish_function().filter(|_| instance.is_open() && instance.begun) else {
            return;
        };
        let mut failure = String::new();
        let mut call_context = CallContext::without_tick(self, context, &instance.holds, &mut failure);
        let (raw, host, call) = (instance.raw, &raw const context.host, (&raw mut call_context).cast());
        // SAFETY: the contract: an open instance that no other thread uses, since the caller owns it; table and handle outlive the call.
        let status =
            who::with(&self.who, CallKind::Finish, || instance.kept.during(|| unsafe { finish(raw, host, call) }));
        if status == abi::STATUS_OK {
            return;
        }
        if failure.is_empty() {
            failure = "it gave no reason".to_owned();
        }
        let words = format!("its output could not be completed: {failure}");
        bump(&self.stats.faults);
        context.log.write(Level::Error, &self.id, &words);
        self.lost(context, &words);
        let cause = if status == abi::STATUS_PANIC { Cause::Panic } else { Cause::Error };
        self.report_fault(context, cause, Action::Note, None, None, words);
    }

    /// Closes an instance of the node; what it has written is completed first.
    pub fn end(&self, context: &RunContext, mut instance: Instance) {
        self.finish(context, &mut instance);
    }

    /// Notes that the node has lost something for good: the run has failed.
    #[cold]
    pub fn lost(&self, context: &RunContext, words: &str) {
        lock(&context.stopped).entry(self.id.clone()).or_insert_with(|| words.to_owned());
    }

    /// Notes that the node does nothing any more: the run has failed, unless the graph says that the node may be left out.
    #[cold]
    pub fn record_bypassed(&self, context: &RunContext, words: &str) {
        if self.on_fault() != OnFault::Bypass {
            self.lost(context, words);
        }
    }

    /// Whether the last error of the node was one that opening it again would not restart.
    pub fn has_given_up(&self) -> bool {
        self.recovery.is_permanent()
    }
}
