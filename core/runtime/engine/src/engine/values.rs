//! Values of parameters: reading them, and setting them while the graph runs.

use std::sync::Arc;

use panoscope_graph::{NodeSetup, ParamValue};

use super::{Current, Engine, SetError};
use crate::node::NodeRuntime;
use crate::observe::Event;
use crate::params::Snapshot;

impl Engine {
    /// Changes one parameter between two ticks. A `reopen` parameter first opens a new instance next to the running
    /// one.
    pub fn set_param(&self, node: &str, param: &str, value: ParamValue) -> Result<(), SetError> {
        let _change = self.change.lock();
        let current = self.current.load_full();
        let index = current.graph.node(node).ok_or_else(|| SetError::NoNode { node: node.to_owned() })?;
        let declared = &current.params[index];
        let position = declared
            .iter()
            .position(|p| p.name == param)
            .ok_or_else(|| SetError::NoParam { node: node.to_owned(), param: param.to_owned() })?;
        declared[position].kind.accepts(&value).map_err(|reason| SetError::BadValue {
            node: node.to_owned(),
            param: param.to_owned(),
            reason: reason.to_string(),
        })?;
        let runtime = Arc::clone(&self.shared.plan.load().runtimes[current.slots[index]]);
        let old = runtime.newest_snapshot();
        let mut values = old.owned().to_vec();
        values[position] = value;
        if let Some(validator) = &current.validators[index] {
            let wiring = current.graph.wiring(index, runtime.node_type.inputs_len);
            let setup = NodeSetup {
                node_id: node,
                params: &values,
                graph_dir: self.shared.context.graph_dir.as_ref(),
                batch: self.shared.context.batch,
                wiring: Some(&wiring),
            };
            if let Some(reason) = validator.refusal(&setup, old.owned()) {
                return Err(SetError::BadValue { node: node.to_owned(), param: param.to_owned(), reason });
            }
        }
        let snapshot = Snapshot::new(values.clone());
        if declared[position].reopen {
            let instance = self
                .shared
                .open_guarded(&runtime, &snapshot)
                .map_err(|reason| SetError::Reopen { node: node.to_owned(), reason: reason.to_string() })?;
            runtime.recovery.begin_restart();
            let unused = runtime.replace_instance(instance, Some(snapshot));
            self.shared.close_guarded(&runtime, unused.into_iter().collect());
        } else {
            runtime.set_snapshot(snapshot);
        }
        if let Some(observer) = &self.shared.context.observer {
            observer.event(Event::Set { node: node.to_owned(), values: values.clone() });
        }
        self.know_values(&current, index, values);
        Ok(())
    }

    /// Sets a bool parameter from the next tick on without waiting for a change of the graph in progress: for an
    /// emergency stop. Such a change may restore the old value when it replaces the node, so call [`Self::set_param`]
    /// as well.
    ///
    /// # Errors
    /// The node or parameter does not exist, is not a bool, or reopens its node.
    pub fn set_bool_at_once(&self, node: &str, param: &str, on: bool) -> Result<(), SetError> {
        let current = self.current.load_full();
        let index = current.graph.node(node).ok_or_else(|| SetError::NoNode { node: node.to_owned() })?;
        let position = current.params[index]
            .iter()
            .position(|p| p.name == param)
            .ok_or_else(|| SetError::NoParam { node: node.to_owned(), param: param.to_owned() })?;
        let bad = |reason: String| SetError::BadValue { node: node.to_owned(), param: param.to_owned(), reason };
        let declared = &current.params[index][position];
        declared.kind.accepts(&ParamValue::Bool(on)).map_err(|e| bad(e.to_string()))?;
        if declared.reopen {
            return Err(bad("it reopens its node, which takes time".to_owned()));
        }
        let plan = self.shared.plan.load();
        let runtime = plan.runtimes.get(current.slots[index]).filter(|c| c.id == node);
        let runtime = runtime.ok_or_else(|| SetError::NoNode { node: node.to_owned() })?;
        let mut values = runtime.newest_snapshot().owned().to_vec();
        values[position] = ParamValue::Bool(on);
        runtime.set_snapshot(Snapshot::new(values));
        Ok(())
    }

    /// Sets a node's values as known from an earlier run; the decider makes them take effect at their tick.
    pub fn know(&self, node: &str, values: &[ParamValue]) {
        let _change = self.change.lock();
        let current = self.current.load_full();
        if let Some(index) = current.graph.node(node) {
            self.know_values(&current, index, values.to_vec());
        }
    }

    /// Writes new values of a node into the current graph.
    fn know_values(&self, current: &Current, index: usize, values: Vec<ParamValue>) {
        let mut graph = current.graph.clone();
        graph.nodes[index].params = values;
        let (params, outputs) = (current.params.clone(), current.outputs.clone());
        let (validators, slots) = (current.validators.clone(), current.slots.clone());
        self.current.store(Arc::new(Current { graph, params, validators, outputs, slots }));
    }

    pub(super) fn runtime(&self, current: &Current, node: &str) -> Option<(usize, Arc<NodeRuntime>)> {
        let index = current.graph.node(node)?;
        Some((index, Arc::clone(&self.shared.plan.load().runtimes[current.slots[index]])))
    }

    /// The values of a node's parameters now, in declaration order.
    pub fn param_values(&self, node: &str) -> Option<Vec<ParamValue>> {
        let (_, runtime) = self.runtime(&self.current.load(), node)?;
        Some(runtime.snapshot().owned().to_vec())
    }
}
