//! The ABI calls that the harness makes: open, process, finish, save and load state.

use std::ffi::c_void;

use crate::abi::{self, Frame, PortRange, Str, Tick};

use super::error::HarnessError;
use super::host::{CallState, Reported, Times, bare_call};
use super::inputs::Pending;
use super::outputs::Outputs;
use super::{Harness, memory, on_device};

/// Media time between two ticks: 30 ticks per second.
const TICK_NS: i64 = 33_333_333;

impl<N> Harness<N> {
    fn flags(&self) -> u32 {
        if self.setup.batch { abi::CALL_BATCH } else { 0 }
    }

    /// The seed of the node's random numbers; depends on node and tick only.
    fn seed(&self) -> u64 {
        let tick = self.next_tick;
        let hash = abi::fnv1a(abi::FNV_START, self.setup.node_id.as_bytes());
        abi::fnv1a(abi::fnv1a(hash, &tick.seq.to_le_bytes()), &tick.source.to_le_bytes())
    }

    /// Stores what the node reported during a call. Returns its failure message and the first violation of the
    /// contract.
    fn take_reported(&mut self, reported: Reported) -> (Option<String>, Option<String>) {
        self.reported.logs.extend(reported.logs);
        self.reported.metrics.extend(reported.metrics);
        self.reported.copies += reported.copies;
        self.reported.allocated_bytes += reported.allocated_bytes;
        (reported.failure, reported.problem.or_else(|| memory::take_violation(self.pool)))
    }

    fn function<F>(&self, function: Option<F>, name: &'static str) -> Result<F, HarnessError> {
        function.ok_or(HarnessError::Contract { problem: format!("its function `{name}` is missing") })
    }

    fn descriptor(&self) -> &abi::NodeType {
        // SAFETY: the maker of the harness guarantees a descriptor that is immutable and stays valid until the process ends.
        unsafe { &*self.descriptor }
    }

    /// Closes the node, if it is open.
    pub(super) fn close(&mut self) {
        if let Some(instance) = self.instance.take()
            && let Some(close) = self.descriptor().close
        {
            // SAFETY: the instance came from `open`; `take` made sure that nothing uses it afterwards.
            unsafe { close(instance) };
        }
        self.setup.files.release(&self.setup.node_id);
    }

    /// Lets the node complete its files and closes it, as the runtime does at the end of a run.
    ///
    /// # Errors
    /// The node's own error or panic, a violation of the contract.
    pub fn finish(&mut self) -> Result<(), HarnessError> {
        let mut result = Ok(());
        if let (Some(finish_node), Some(instance)) = (self.descriptor().finish_function(), self.instance) {
            let mut state = CallState::new(self.pool, &mut [], Vec::new(), self.seed()).in_run(&self.setup);
            // SAFETY: the instance is open and used by this thread only; `state` lives until the call returns.
            let status = unsafe { finish_node(instance, &*self.host, (&raw mut state).cast()) };
            let (failure, problem) = self.take_reported(state.into_reported());
            result = finish("finish", status, failure, problem);
        }
        self.close();
        result
    }

    /// Closes the node without `finish`, as the runtime does with an instance that was opened for a change and then not
    /// used.
    pub fn discard(mut self) {
        self.close();
    }

    /// Closes the node and opens it with the current parameters, as the runtime does after a fault.
    pub fn reopen(&mut self) -> Result<(), HarnessError> {
        let _ = self.finish();
        let open = self.function(self.descriptor().open, "open")?;
        let mut state = CallState::new(self.pool, &mut [], Vec::new(), self.seed()).in_run(&self.setup);
        let dir = self.setup.graph_dir.to_string_lossy().into_owned();
        let mut call = abi::OpenCall {
            struct_size: size_of::<abi::OpenCall>() as u32,
            flags: self.flags(),
            host: &*self.host,
            call: (&raw mut state).cast(),
            node_id: Str::borrow(&self.setup.node_id),
            params: self.snapshot.values().as_ptr(),
            params_len: self.snapshot.values().len(),
            graph_dir: Str::borrow(&dir),
            outputs_read: self.outputs_read,
        };
        let mut instance: *mut c_void = std::ptr::null_mut();
        // SAFETY: the call and all that it points to are locals that live until the call returns.
        let status = unsafe { open(&mut call, &mut instance) };
        let (failure, problem) = self.take_reported(state.into_reported());
        if status == abi::STATUS_OK {
            self.instance = Some(instance);
        }
        finish("open", status, failure, problem)
    }

    /// Processes one tick with the inputs given since the last call.
    ///
    /// A required input that is empty skips the node and empties all its outputs, as in a graph.
    ///
    /// # Errors
    /// A mistake in the inputs, a missing required input, the node's own error or panic, a violation of the contract.
    pub fn process(&mut self) -> Result<Outputs, HarnessError> {
        let result = self.process_given();
        self.drop_inputs();
        (self.now_ns, self.ages_ns) = (None, Vec::new());
        self.tick_age_ns = 0;
        let tick = self.next_tick;
        self.next_tick = Tick { seq: tick.seq + 1, capture_ns: tick.capture_ns + TICK_NS, ..tick };
        result
    }

    /// Processes one tick for which the named inputs are empty.
    ///
    /// # Errors
    /// As [`Harness::process`].
    pub fn process_empty(&mut self, inputs: &[&str]) -> Result<Outputs, HarnessError> {
        for name in inputs {
            self.input_empty(name);
        }
        self.process()
    }

    fn process_given(&mut self) -> Result<Outputs, HarnessError> {
        if let Some(problem) = self.problem.take() {
            return Err(problem);
        }
        let tick = self.next_tick;
        let (mut frames, mut ranges, mut skipped) = (Vec::new(), Vec::new(), false);
        let now_ns = self.now_ns.unwrap_or(tick.capture_ns);
        let mut times = Times { now_ns, tick_ns: now_ns.saturating_sub(self.tick_age_ns), ..Times::default() };
        for (index, (port, waiting)) in self.node_type.inputs.iter().zip(&self.pending).enumerate() {
            let given: &[Frame] = match waiting {
                Pending::Unconnected if port.optional => &[],
                Pending::Unconnected => {
                    let problem = format!("input `{}` is required: give it a frame or call `input_empty`", port.name);
                    return Err(HarnessError::port(problem));
                }
                Pending::Frames(frames) => frames,
            };
            skipped |= !port.optional && !port.list && given.iter().any(Frame::is_empty);
            ranges.push(PortRange { first: frames.len() as u32, count: given.len() as u32 });
            let age_ns = self
                .ages_ns
                .iter()
                .rev()
                .find(|(port, _)| *port == index)
                .map_or(self.tick_age_ns, |(_, age_ns)| *age_ns);
            let arrived_ns = times.now_ns.saturating_sub(age_ns);
            times.arrived_ns.extend(given.iter().map(|f| if f.is_empty() { i64::MIN } else { arrived_ns }));
            frames.extend(given.iter().map(|frame| Frame { tick, ..*frame }));
        }
        let mut outputs = vec![Frame::EMPTY; self.node_type.outputs.len()];
        if skipped {
            return Ok(self.collect(tick, &outputs, true, false));
        }
        let process = self.function(self.descriptor().process, "process")?;
        let instance = self.instance.ok_or_else(|| HarnessError::port("the node is not open"))?;
        let formats = self.output_formats();
        let mut state = CallState::new(self.pool, &mut outputs, formats, self.seed()).in_run(&self.setup);
        state.times = times;
        let mut call = abi::Call {
            flags: self.flags(),
            inputs: frames.as_ptr(),
            inputs_len: frames.len(),
            input_ranges: ranges.as_ptr(),
            input_ranges_len: ranges.len(),
            params: self.snapshot.values().as_ptr(),
            params_len: self.snapshot.values().len(),
            params_version: self.params_version,
            outputs_read: self.outputs_read,
            ..bare_call(&self.host, &mut state, tick)
        };
        // SAFETY: the instance is open and used by this thread only; all that the call points to are locals that outlive it.
        let status = unsafe { process(instance, &mut call) };
        on_device::end(self.pool, &mut outputs);
        let (tick, set_times) = (call.tick, state.set_times());
        let (failure, problem) = self.take_reported(state.into_reported());
        let mut result =
            self.collect(tick, if status == abi::STATUS_OK { &outputs } else { &[] }, false, status == abi::STATUS_END);
        outputs.iter().filter(|f| !f.is_empty()).for_each(|f| memory::release(f.buffer));
        if status == abi::STATUS_OK {
            result.set_fault(failure.clone());
            result.set_times(set_times);
        }
        // An end with a message means that the source ended before its data was complete.
        let status = if status == abi::STATUS_END && failure.is_none() { abi::STATUS_OK } else { status };
        finish("process", status, failure, problem).map(|()| result)
    }

    fn collect(&self, tick: Tick, frames: &[Frame], skipped: bool, ended: bool) -> Outputs {
        let mut outputs = Outputs::new(tick, skipped, ended);
        for (index, port) in self.node_type.outputs.iter().enumerate() {
            outputs.push(&port.name, &port.packet.name, frames.get(index).unwrap_or(&Frame::EMPTY));
        }
        outputs
    }

    /// Formats that each output may be made with.
    fn output_formats(&self) -> Vec<u32> {
        let node = self.descriptor();
        // SAFETY: `node_types` checked the pointers and lengths when the harness was made.
        let ports = (0..node.outputs_len).map(|index| unsafe { &*node.outputs.add(index) });
        // Plain data declares no format; its frames are bytes.
        ports.map(|p| if p.formats == 0 { abi::format_bit(abi::FORMAT_BYTES) } else { p.formats }).collect()
    }

    /// The state that the node would hand to its replacement; `None` when it has none.
    ///
    /// # Errors
    /// The node's own error or panic.
    pub fn save_state(&mut self) -> Result<Option<Vec<u8>>, HarnessError> {
        let (Some(save), Some(instance)) = (self.descriptor().save_state, self.instance) else { return Ok(None) };
        let mut sink: Option<Vec<u8>> = None;
        // SAFETY: the instance is open and used by this thread only; the sink has the type that this host's `save` casts to.
        let status = unsafe { save(instance, &*self.host, (&raw mut sink).cast()) };
        finish("save_state", status, None, None).map(|()| sink)
    }

    /// Hands the node the state that an earlier instance saved.
    ///
    /// # Errors
    /// The node's own error or panic.
    pub fn load_state(&mut self, state: &[u8]) -> Result<(), HarnessError> {
        let (Some(load), Some(instance)) = (self.descriptor().load_state, self.instance) else { return Ok(()) };
        // SAFETY: the instance is open and used by this thread only; `state` is a slice of that length.
        finish("load_state", unsafe { load(instance, state.as_ptr(), state.len()) }, None, None)
    }
}

fn finish(
    call: &'static str,
    status: abi::Status,
    failure: Option<String>,
    problem: Option<String>,
) -> Result<(), HarnessError> {
    match (problem, status) {
        (Some(problem), _) => Err(HarnessError::Contract { problem }),
        (None, abi::STATUS_OK) => Ok(()),
        (None, status) => {
            let message = failure.unwrap_or_else(|| "the node failed without an error message".to_owned());
            Err(HarnessError::Node { call, status, message })
        }
    }
}
