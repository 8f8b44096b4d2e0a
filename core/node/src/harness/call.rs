//! The calls of the contract, as the harness makes them.

use std::ffi::c_void;
use std::sync::Mutex;

use panoscope_base::random::SplitMix64;

use crate::abi::{self, Frame, PortRange, Str, Tick};
use crate::output::Slot;
use crate::port::{PortField, RawCall};

use super::error::HarnessError;
use super::host::{CallState, Said};
use super::inputs::Pending;
use super::outputs::Outputs;
use super::{Harness, Setup, memory};

/// Media time between two ticks.
const TICK_NS: i64 = 33_333_333;

impl CallState {
    fn new(pool: u32, outputs: &mut [Frame], formats: Vec<u32>, seed: u64) -> Self {
        Self {
            pool,
            outputs: outputs.as_mut_ptr(),
            outputs_len: outputs.len(),
            formats,
            random: Mutex::new(SplitMix64(seed)),
            said: Mutex::default(),
            files: None,
            answer: Mutex::default(),
        }
    }

    fn in_run(mut self, setup: &Setup) -> Self {
        self.files = Some((setup.files.clone(), setup.node_id.clone()));
        self
    }

    fn into_said(self) -> Said {
        self.said.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

/// A call without frames or parameters.
fn bare_call(host: &abi::Host, state: &mut CallState, tick: Tick) -> abi::Call {
    abi::Call {
        struct_size: size_of::<abi::Call>() as u32,
        flags: 0,
        host,
        call: (&raw mut *state).cast(),
        tick,
        inputs: std::ptr::null(),
        inputs_len: 0,
        input_ranges: std::ptr::null(),
        input_ranges_len: 0,
        outputs: state.outputs,
        outputs_len: state.outputs_len,
        params: std::ptr::null(),
        params_len: 0,
        params_version: 0,
        outputs_read: u64::MAX,
    }
}

/// Makes one frame through an output slot, so that packets with variable length are laid out in one place only.
pub(super) fn make_frame<T>(
    pool: u32,
    host: &abi::Host,
    fill: impl FnOnce(&mut Slot<'_, T>) -> crate::Result<()>,
) -> crate::Result<Frame>
where
    for<'f> Slot<'f, T>: PortField<'f>,
{
    let mut outputs = [Frame::EMPTY];
    let mut state = CallState::new(pool, &mut outputs, vec![0], 0);
    let mut call = bare_call(host, &mut state, Tick::default());
    // SAFETY: the call and all that it points to lives until the end of this function.
    let mut slot = Slot::<T>::bind(unsafe { RawCall::new(&mut call) }, 0, "input")?;
    let result = fill(&mut slot);
    let [frame] = outputs;
    match result {
        Ok(()) => Ok(frame),
        Err(error) => {
            if !frame.is_empty() {
                memory::release(frame.buffer);
            }
            Err(error)
        }
    }
}

impl<N> Harness<N> {
    fn flags(&self) -> u32 {
        if self.setup.batch { abi::CALL_BATCH } else { 0 }
    }

    /// What a node's random numbers begin with: node and tick, nothing else.
    fn seed(&self) -> u64 {
        let tick = self.next_tick;
        let hash = abi::fnv1a(abi::FNV_START, self.setup.node_id.as_bytes());
        abi::fnv1a(abi::fnv1a(hash, &tick.seq.to_le_bytes()), &tick.source.to_le_bytes())
    }

    /// Takes over what the node told the host; answers its words.
    fn take(&mut self, said: Said) -> (Option<String>, Option<String>) {
        self.said.logs.extend(said.logs);
        self.said.metrics.extend(said.metrics);
        self.said.copies += said.copies;
        self.said.allocated_bytes += said.allocated_bytes;
        (said.failure, said.problem.or_else(|| memory::broken(self.pool)))
    }

    fn function<F>(&self, function: Option<F>, name: &'static str) -> Result<F, HarnessError> {
        function.ok_or(HarnessError::Contract { problem: format!("its function `{name}` is missing") })
    }

    fn descriptor(&self) -> &abi::NodeType {
        // SAFETY: descriptors are immutable and outlive the process (checked when the harness was made).
        unsafe { &*self.descriptor }
    }

    /// Closes the node, if it is open.
    pub(super) fn close(&mut self) {
        if let Some(instance) = self.instance.take()
            && let Some(close) = self.descriptor().close
        {
            // SAFETY: the instance came from `open` and is given up here.
            unsafe { close(instance) };
        }
        self.setup.files.release(&self.setup.node_id);
    }

    /// Has the node complete its files and closes it, as the runtime does at the end of a run.
    ///
    /// # Errors
    /// What the node could not complete.
    pub fn finish(&mut self) -> Result<(), HarnessError> {
        let mut result = Ok(());
        if let (Some(finish_node), Some(instance)) = (self.descriptor().finish_function(), self.instance) {
            let mut state = CallState::new(self.pool, &mut [], Vec::new(), self.seed()).in_run(&self.setup);
            // SAFETY: an open instance; the handle lives for the length of the call.
            let status = unsafe { finish_node(instance, &*self.host, (&raw mut state).cast()) };
            let (failure, problem) = self.take(state.into_said());
            result = finish("finish", status, failure, problem);
        }
        self.close();
        result
    }

    /// Closes the node without having it complete anything, as the runtime does with an instance that was opened for a change which was refused.
    pub fn discard(mut self) {
        self.close();
    }

    /// Closes the node and opens it with the parameters in force, as the runtime does after a fault.
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
        // SAFETY: the call and all that it points to lives for the length of the call.
        let status = unsafe { open(&mut call, &mut instance) };
        let (failure, problem) = self.take(state.into_said());
        if status == abi::STATUS_OK {
            self.instance = Some(instance);
        }
        finish("open", status, failure, problem)
    }

    /// Processes one tick with the inputs given since the last call.
    ///
    /// A required input that was said to be empty skips the node and empties all its outputs, as in a graph.
    ///
    /// # Errors
    /// A mistake in the inputs, a required input that was not given, the node's own error or panic, a breach of the contract.
    pub fn process(&mut self) -> Result<Outputs, HarnessError> {
        let result = self.process_given();
        self.drop_inputs();
        let step = self.next_tick;
        self.next_tick = Tick { seq: step.seq + 1, capture_ns: step.capture_ns + TICK_NS, ..step };
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
        for (port, waiting) in self.node_type.inputs.iter().zip(&self.pending) {
            let given: &[Frame] = match waiting {
                Pending::Unconnected if port.optional => &[],
                Pending::Unconnected => {
                    let problem = format!("input `{}` is required: hand it a frame or say `input_empty`", port.name);
                    return Err(HarnessError::port(problem));
                }
                Pending::Frames(frames) => frames,
            };
            skipped |= !port.optional && !port.list && given.iter().any(Frame::is_empty);
            ranges.push(PortRange { first: frames.len() as u32, count: given.len() as u32 });
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
        // SAFETY: an open instance, and a call whose parts live for its length.
        let status = unsafe { process(instance, &mut call) };
        let tick = call.tick;
        let (failure, problem) = self.take(state.into_said());
        let mut made =
            self.collect(tick, if status == abi::STATUS_OK { &outputs } else { &[] }, false, status == abi::STATUS_END);
        outputs.iter().filter(|f| !f.is_empty()).for_each(|f| memory::release(f.buffer));
        if status == abi::STATUS_OK {
            made.set_fault(failure.clone());
        }
        // An end with words is an end that came too early.
        let status = if status == abi::STATUS_END && failure.is_none() { abi::STATUS_OK } else { status };
        finish("process", status, failure, problem).map(|()| made)
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
        // SAFETY: the descriptor was checked when the harness was made.
        let ports = (0..node.outputs_len).map(|index| unsafe { &*node.outputs.add(index) });
        // Plain data declares no format: its frames are bytes.
        ports.map(|p| if p.formats == 0 { abi::format_bit(abi::FORMAT_BYTES) } else { p.formats }).collect()
    }

    /// State that the node would hand to its replacement; `None` when it has none.
    ///
    /// # Errors
    /// What the node answers.
    pub fn save_state(&mut self) -> Result<Option<Vec<u8>>, HarnessError> {
        let (Some(save), Some(instance)) = (self.descriptor().save_state, self.instance) else { return Ok(None) };
        let mut sink: Option<Vec<u8>> = None;
        // SAFETY: an open instance; the sink is what this host's `save` expects.
        let status = unsafe { save(instance, &*self.host, (&raw mut sink).cast()) };
        finish("save_state", status, None, None).map(|()| sink)
    }

    /// Hands the node what an earlier instance saved.
    ///
    /// # Errors
    /// What the node answers.
    pub fn load_state(&mut self, state: &[u8]) -> Result<(), HarnessError> {
        let (Some(load), Some(instance)) = (self.descriptor().load_state, self.instance) else { return Ok(()) };
        // SAFETY: an open instance and a borrowed slice.
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
            let message = failure.unwrap_or_else(|| "the node gave no words".to_owned());
            Err(HarnessError::Node { call, status, message })
        }
    }
}
