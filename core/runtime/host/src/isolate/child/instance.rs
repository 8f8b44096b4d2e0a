//! One instance in the child: serves the requests of its lane in order.

use std::cell::Cell;
use std::ffi::c_void;
use std::time::{Duration, Instant};

use panoscope_abi::{self as abi, Frame, NodeType, Status, Str};
use panoscope_engine::isolation::STATUS_DIED;

use super::table::{self, CallFrame, ChildLane};
use super::{Child, EXIT_PROTOCOL, describe, leave, on_device, pools};
use crate::isolate::lane::{Lost, Side};
use crate::isolate::wire::lane::{Kind, Open, TickDone, TickRequest};
use crate::isolate::wire::{BadMessage, Params, Reader, Wire, whole};

/// Maximum wait of a describing process for the next question.
const MAX_IDLE: Duration = Duration::from_secs(10);
/// Maximum length of a position of a source, bytes, that is sent with every tick.
const MAX_POSITION_BYTES: usize = 16 << 10;

thread_local! {
    /// The node type whose `open` runs on this thread.
    static OPENING: Cell<Option<&'static NodeType>> = const { Cell::new(None) };
}

/// The node type whose `open` runs on this thread: for node types that share their functions.
pub fn opening() -> Option<&'static NodeType> {
    OPENING.get()
}

/// The instance of a lane.
struct Instance<'c> {
    child: &'c Child,
    lane: &'c ChildLane,
    /// The node type of the instance; `None` before it is open.
    node_type: Option<&'static NodeType>,
    raw: *mut c_void,
    host: abi::Host,
    node: String,
    params: Params,
    /// The values as the plugin takes them; they point into `params`.
    lent: Vec<abi::ParamValue>,
    state: Vec<u8>,
    /// The last request, whose frames have their addresses here, and its result.
    tick: TickRequest,
    done: TickDone,
    /// Formats of each output, one bit each.
    formats: Vec<u32>,
}

/// Serves the requests of a lane until its instance is closed.
pub(super) fn serve(child: &Child, lane: &ChildLane) {
    let _visit = child.pool.visit();
    let mut this = Instance {
        child,
        lane,
        node_type: None,
        raw: std::ptr::null_mut(),
        host: abi::Host { ..*child.host },
        node: String::new(),
        params: Params::default(),
        lent: Vec::new(),
        state: Vec::new(),
        tick: TickRequest::default(),
        done: TickDone::default(),
        formats: Vec::new(),
    };
    let (mut message, mut out) = (Vec::new(), Vec::new());
    // A process that only describes plugins leaves when it is not needed for a while.
    let mut deadline = None;
    loop {
        let kind = match lane.lane.receive_until(Side::Child, &mut message, deadline) {
            Ok(kind) => kind,
            Err(Lost::Late) => leave(0),
            Err(_) => return,
        };
        if let Kind::Describe | Kind::Validate = kind {
            lane.begin(&mut out);
            let done = table::within(lane, || match kind {
                Kind::Describe => describe::describe(child, &message, &mut out),
                _ => describe::validate(child, &message, &mut out),
            });
            if done.is_err() {
                leave(EXIT_PROTOCOL);
            }
            lane.lane.post(Side::Child, Kind::Done, &out);
            deadline = Some(Instant::now() + MAX_IDLE);
            continue;
        }
        let served = table::within(lane, || this.request(kind, &message));
        let Ok(status) = served else { leave(EXIT_PROTOCOL) };
        lane.begin(&mut out);
        // A plugin's own status of this number would be taken for the end of the process.
        (if status == STATUS_DIED { abi::STATUS_ERROR } else { status }).put(&mut out);
        if kind == Kind::Process {
            this.done.put(&mut out);
        }
        let is_over = kind == Kind::Close || this.node_type.is_none();
        lane.lane.post(Side::Child, Kind::Done, &out);
        if is_over {
            return;
        }
    }
}

impl<'c> Instance<'c> {
    fn request(&mut self, kind: Kind, message: &[u8]) -> Result<Status, BadMessage> {
        if kind == Kind::Open {
            return self.open(whole(message)?);
        }
        let node_type = self.node_type.ok_or(BadMessage)?;
        let (raw, host) = (self.raw, &raw const self.host);
        Ok(match kind {
            Kind::Process => return self.process(node_type, &mut Reader(message)),
            Kind::Close => {
                if let Some(close) = node_type.close {
                    // SAFETY: opened by `open` and closed once.
                    unsafe { close(raw) };
                }
                abi::STATUS_OK
            }
            Kind::SaveState => {
                let mut state = Vec::new();
                let status = table::save_state(node_type, raw, &self.host, &mut state);
                self.lane.send_state(&state);
                status
            }
            Kind::LoadPart => {
                self.state.extend_from_slice(Reader(message).bytes()?);
                abi::STATUS_OK
            }
            Kind::LoadState => {
                let state = std::mem::take(&mut self.state);
                match node_type.load_state {
                    // SAFETY: an open instance that only this thread uses; the bytes live until the call returns.
                    Some(load) => unsafe { load(raw, state.as_ptr(), state.len()) },
                    None => abi::STATUS_INVALID,
                }
            }
            Kind::Finish => match node_type.finish_function() {
                Some(finish) => {
                    let mut call = self.call(abi::Tick::default());
                    // SAFETY: an open instance that only this thread uses; table and handle live until the call returns.
                    unsafe { finish(raw, host, (&raw mut call).cast()) }
                }
                None => abi::STATUS_OK,
            },
            _ => return Err(BadMessage),
        })
    }

    /// The target of a call's handle, without inputs and outputs.
    fn call(&self, tick: abi::Tick) -> CallFrame<'c> {
        self.lane.forget_sent();
        CallFrame {
            lane: self.lane,
            node: self.node.clone(),
            tick,
            outputs: std::ptr::null_mut(),
            outputs_len: 0,
            formats: &[],
            random: None,
            file: String::new(),
        }
    }

    fn open(&mut self, request: Open) -> Result<Status, BadMessage> {
        let Open { plugin, index, flags, threads, outputs_read, node, graph_dir, params, .. } = request;
        (self.node, self.host.threads) = (node, threads);
        self.set_params(params);
        let found = self.child.node_type(plugin, index);
        let node_type = match found {
            Ok(node_type) => node_type,
            Err(error) => {
                let words = error.to_string();
                let mut call = self.call(abi::Tick::default());
                if let Some(fail) = self.host.fail {
                    // SAFETY: the handle and the words live until the call returns.
                    unsafe { fail((&raw mut call).cast(), Str::borrow(&words)) };
                }
                return Ok(abi::STATUS_ERROR);
            }
        };
        let mut call = self.call(abi::Tick::default());
        let mut open_call = abi::OpenCall {
            struct_size: size_of::<abi::OpenCall>() as u32,
            flags,
            host: &raw const self.host,
            call: (&raw mut call).cast(),
            node_id: Str::borrow(&self.node),
            params: self.lent.as_ptr(),
            params_len: self.lent.len(),
            graph_dir: Str::borrow(&graph_dir),
            outputs_read,
        };
        let mut raw = std::ptr::null_mut();
        OPENING.set(Some(node_type));
        let status = match node_type.open {
            // SAFETY: the plugin contract; everything that the call points to lives until it returns, the table as long as the instance.
            Some(open) => unsafe { open(&raw mut open_call, &raw mut raw) },
            None => abi::STATUS_INVALID,
        };
        OPENING.set(None);
        if status == abi::STATUS_OK {
            // SAFETY: a validated descriptor of a plugin that stays mapped.
            let outputs = (0..node_type.outputs_len).map(|at| unsafe { (*node_type.outputs.add(at)).formats });
            self.formats = outputs.collect();
            (self.raw, self.node_type) = (raw, Some(node_type));
        }
        Ok(status)
    }

    fn set_params(&mut self, params: Params) {
        self.params = params;
        self.lent = self.params.lent();
    }

    fn process(&mut self, node_type: &NodeType, reader: &mut Reader<'_>) -> Result<Status, BadMessage> {
        self.tick.refill(reader)?;
        if let Some(params) = self.tick.params.take() {
            self.set_params(params);
        }
        for frame in self.tick.inputs.iter_mut().filter(|frame| !frame.is_empty()) {
            frame.data = pools::resolve(frame.buffer);
            if frame.data.is_null() {
                return Err(BadMessage);
            }
        }
        let outputs_len = self.formats.len();
        if self.tick.stock.len() != outputs_len {
            return Err(BadMessage);
        }
        self.lane.receive_sent(&mut self.tick);
        let TickRequest { flags, tick, outputs_read, params_version, inputs, ranges, .. } = &self.tick;
        self.done.outputs.clear();
        self.done.outputs.resize(outputs_len, Frame::EMPTY);
        let outputs = self.done.outputs.as_mut_ptr();
        let node = std::mem::take(&mut self.node);
        let (lane, formats, file) = (self.lane, &self.formats[..], String::new());
        let mut frame = CallFrame { lane, node, tick: *tick, outputs, outputs_len, formats, random: None, file };
        let mut call = abi::Call {
            struct_size: size_of::<abi::Call>() as u32,
            flags: *flags,
            host: &raw const self.host,
            call: (&raw mut frame).cast(),
            tick: *tick,
            inputs: inputs.as_ptr(),
            inputs_len: inputs.len(),
            input_ranges: ranges.as_ptr(),
            input_ranges_len: ranges.len(),
            outputs,
            outputs_len,
            params: self.lent.as_ptr(),
            params_len: self.lent.len(),
            params_version: *params_version,
            outputs_read: *outputs_read,
        };
        let status = match node_type.process {
            // SAFETY: the plugin contract: an open instance that only this thread uses, and a call whose parts outlive it.
            Some(process) => unsafe { process(self.raw, &raw mut call) },
            None => abi::STATUS_INVALID,
        };
        let status = if on_device::end(std::ptr::from_ref(self.lane) as usize) { status } else { abi::STATUS_ERROR };
        self.done.tick = call.tick;
        self.node = frame.node;
        let position = &mut self.done.position;
        position.clear();
        if node_type.flags & abi::NODE_SOURCE != 0 && status == abi::STATUS_OK {
            // If the process dies, the next instance goes on here.
            let saved = table::save_state(node_type, self.raw, &self.host, position);
            if saved != abi::STATUS_OK || position.len() > MAX_POSITION_BYTES {
                position.clear();
            }
        }
        Ok(status)
    }
}
