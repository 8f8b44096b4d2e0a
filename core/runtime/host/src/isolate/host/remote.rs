//! An instance that lives in a child process: each function of the contract is a round trip.

use std::ffi::c_void;
use std::io::ErrorKind;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use panoscope_abi::{self as abi, BufferId, Frame, Host, NodeType, Status};
use panoscope_engine::host;
use panoscope_engine::isolation::STATUS_DIED;
use panoscope_engine::memory::{FrameRef, Memory, memory};

use super::PluginImage;
use super::answer::{Answerer, Habits, Spent, Target};
use super::process::{NodeLane, Process};
use super::stock::Stock;
use crate::isolate::lane::{Lost, MAX_MESSAGE_BYTES, Side};
use crate::isolate::wire::lane::{Kind, Open, TickDone, TickRequest, after_deferred};
use crate::isolate::wire::{BadMessage, Params, Reader, Wire, plain_status, put_bytes};

/// The instance as the engine holds it.
struct Remote {
    process: Arc<Process>,
    lane: Arc<NodeLane>,
    host: Host,
    /// Buffer of the message to post.
    out: Vec<u8>,
    /// The message received last.
    message: Vec<u8>,
    /// Version of the parameters that the child knows.
    params_version: Option<u64>,
    /// The tick's request and result; their memory is used again.
    tick: TickRequest,
    done: TickDone,
    /// Copies of inputs that the child cannot map.
    copies: Vec<FrameRef>,
    stock: Stock,
    habits: Habits,
    spent: Spent,
}

/// An input that the child does not receive.
enum NotShared {
    /// No memory for a copy that it can map.
    Exhausted,
    /// The process accepts no files, because it has ended or is ending.
    Gone,
}

/// A node type's functions for instances in a child process.
pub(super) fn proxy_of(entry: &'static NodeType) -> NodeType {
    NodeType {
        struct_size: size_of::<NodeType>() as u32,
        kind: entry.kind,
        flags: entry.flags,
        reserved: entry.reserved,
        name: entry.name,
        family: entry.family,
        doc: entry.doc,
        inputs: entry.inputs,
        inputs_len: entry.inputs_len,
        outputs: entry.outputs,
        outputs_len: entry.outputs_len,
        params: entry.params,
        params_len: entry.params_len,
        // Instances are opened through the group.
        open: None,
        process: Some(process),
        close: Some(close),
        save_state: entry.save_state.map(|_| save_state as _),
        load_state: entry.load_state.map(|_| load_state as _),
        validate: None,
        finish: entry.finish_function().map(|_| finish as _),
    }
}

/// Opens an instance in a process.
///
/// # Safety
/// As for [`NodeType::open`].
pub(super) unsafe fn open(
    process: Arc<Process>,
    image: &PluginImage,
    entry: Option<&NodeType>,
    index: u32,
    call: *mut abi::OpenCall,
    instance: *mut *mut c_void,
) -> Status {
    // SAFETY: the caller's promise: the call lives, and what it points to.
    let (open, node) = unsafe { (&*call, (*call).node_id.text().unwrap_or("?")) };
    // SAFETY: the call has the host's table.
    let target = Target::new(open.host, open.call);
    let lane = process.give_plugin(image).and_then(|()| process.lane(node, format!("node `{node}`")));
    let lane = match lane {
        Ok(lane) => lane,
        Err(_) if process.is_ending() => {
            // SAFETY: the call lives.
            return unsafe { died(target, &process.death()) };
        }
        Err(cause) => {
            // SAFETY: the call lives.
            unsafe { target.fail(&format!("its process could not be reached: {cause}")) };
            return abi::STATUS_ERROR;
        }
    };
    // SAFETY: the call has the host's table, of plain pointers.
    let host = unsafe { std::ptr::read(open.host) };
    // A link translates times, for which it needs the clock.
    let habits = if process.is_link() { Habits::of_link() } else { Habits::default() };
    let mut remote = Remote {
        process,
        lane,
        host,
        out: Vec::new(),
        message: Vec::new(),
        params_version: None,
        tick: TickRequest::default(),
        done: TickDone::default(),
        copies: Vec::new(),
        stock: Stock::default(),
        habits,
        spent: Spent::default(),
    };
    let params_len = |entry: &NodeType| entry.params_len.min(open.params_len) as u32;
    let reads = |entry| (0..params_len(entry)).filter(|at| is_read(entry, *at)).collect();
    let request = Open {
        plugin: image.id,
        index,
        flags: open.flags,
        threads: remote.host.threads,
        outputs_read: open.outputs_read,
        node: node.to_owned(),
        // SAFETY: the text of the call lives.
        graph_dir: unsafe { open.graph_dir.text() }.unwrap_or_default().to_owned(),
        // SAFETY: the values of the call live.
        params: unsafe { Params::copy(open.params, open.params_len) },
        reads: entry.filter(|_| remote.process.is_link()).map(reads).unwrap_or_default(),
    };
    request.put(&mut remote.out);
    // SAFETY: the caller's promise.
    let status = unsafe { remote.request(Kind::Open, target) };
    if status == abi::STATUS_OK {
        // SAFETY: the caller gives a place for the instance.
        unsafe { *instance = Box::into_raw(Box::new(remote)).cast() };
    }
    status
}

/// Whether a parameter names a file that the node reads.
fn is_read(entry: &NodeType, param: u32) -> bool {
    // SAFETY: a validated descriptor, with `params_len` parameters.
    let param = unsafe { &*entry.params.add(param as usize) };
    let reads = param.flags & (abi::PARAM_MUST_EXIST | abi::PARAM_SHIPPED) != 0;
    param.kind == abi::PARAM_PATH && reads && param.flags & abi::PARAM_WRITES == 0
}

/// Reports that the process of a call died.
///
/// # Safety
/// Table and call of `target` are valid.
unsafe fn died(target: Target, words: &str) -> Status {
    // SAFETY: the caller's promise.
    unsafe { target.fail(words) };
    STATUS_DIED
}

impl Drop for Remote {
    fn drop(&mut self) {
        self.process.drop_lane(&self.lane);
    }
}

impl Remote {
    /// Makes a request without content.
    ///
    /// # Safety
    /// As [`Self::request`].
    unsafe fn ask(&mut self, kind: Kind, target: Target) -> Status {
        self.out.clear();
        // SAFETY: the caller's promise.
        unsafe { self.request(kind, target) }
    }

    /// Posts the message, answers the child until it is done, and returns the status. The child's last message is in
    /// `message`.
    ///
    /// # Safety
    /// Table, call and outputs of `target` are valid.
    unsafe fn request(&mut self, kind: Kind, target: Target) -> Status {
        if self.out.len() > MAX_MESSAGE_BYTES {
            self.message.clear();
            let most = MAX_MESSAGE_BYTES >> 10;
            // SAFETY: the caller's promise.
            unsafe {
                target.fail(&format!("its parameters take more than the {most} KiB of a message to its process"))
            };
            return abi::STATUS_ERROR;
        }
        // SAFETY: the caller's promise.
        match unsafe { self.exchange(kind, target) } {
            Ok(status) => status,
            Err(lost) => {
                if lost == Lost::Bad {
                    let objection = self.spent.objection.unwrap_or("sent a malformed message");
                    self.process.kill(&format!("node `{}` {objection}", self.lane.node));
                }
                let words = self.process.death();
                // SAFETY: the caller's promise.
                unsafe { died(target, &words) }
            }
        }
    }

    unsafe fn exchange(&mut self, kind: Kind, target: Target) -> Result<Status, Lost> {
        if self.process.is_dead() {
            return Err(Lost::Gone);
        }
        self.lane.in_call.store(true, Ordering::Relaxed);
        self.spent = Spent::default();
        let mut kind = kind;
        loop {
            self.lane.lane.post(Side::Host, kind, &self.out);
            // The end of the process closes lanes after it is recorded: whoever posts later sees it here.
            if self.process.is_dead() {
                return Err(Lost::Gone);
            }
            let asked = self.lane.lane.receive(Side::Host, &mut self.message)?;
            let mut message = Reader(&self.message);
            let (host, process) = (&self.host, &*self.process);
            let (stock, habits, spent) = (&mut self.stock, &mut self.habits, &mut self.spent);
            let mut answerer = Answerer { host, target, process, stock, habits, spent };
            // SAFETY: the caller's promise.
            unsafe { answerer.run_deferred(message.bytes()?)? };
            if asked == Kind::Done {
                break;
            }
            // SAFETY: the caller's promise.
            unsafe { answerer.answer(asked, message.0, &mut self.out)? };
            kind = Kind::Answer;
        }
        self.lane.in_call.store(false, Ordering::Relaxed);
        Ok(plain_status(after_deferred(&self.message)?.take()?))
    }

    /// An input in memory that the child can map.
    fn shared(&mut self, input: &Frame) -> Result<Frame, NotShared> {
        // Its process has another GPU, or none.
        memory().fetch(input);
        let input = &Frame { buffer: BufferId { home: abi::HOME_HOST, ..input.buffer }, ..*input };
        if input.is_empty() || self.gives(input)? {
            return Ok(*input);
        }
        // Made before there were isolated nodes.
        let (buffer, data) = memory().allocate(input.len).map_err(|_| NotShared::Exhausted)?;
        // SAFETY: two buffers of at least `len` bytes; the new one is known only here.
        unsafe { std::ptr::copy_nonoverlapping(input.data, data, input.len) };
        let frame = Frame { buffer, data, ..*input };
        // SAFETY: the one reference of the new buffer.
        self.copies.push(unsafe { FrameRef::adopt(frame) });
        if self.gives(&frame)? { Ok(frame) } else { Err(NotShared::Exhausted) }
    }

    /// Makes sure that the child can map the pool of a frame; `false` for private memory.
    fn gives(&self, frame: &Frame) -> Result<bool, NotShared> {
        if Memory::domain_of(frame.buffer) == 0 {
            return Ok(false);
        }
        match self.process.give_pool(frame.buffer) {
            Ok(()) => Ok(true),
            Err(cause) if cause.kind() == ErrorKind::NotFound => Ok(false),
            Err(_) => Err(NotShared::Gone),
        }
    }

    /// Writes the request of a tick.
    ///
    /// # Safety
    /// Everything that the call points to is valid.
    unsafe fn write_tick(&mut self, call: &abi::Call) -> Result<(), NotShared> {
        let sends_params = self.params_version != Some(call.params_version);
        // SAFETY: the caller's promise.
        let params = sends_params.then(|| unsafe { Params::copy(call.params, call.params_len) });
        let mut tick = std::mem::take(&mut self.tick);
        (tick.flags, tick.tick, tick.params) = (call.flags, call.tick, params);
        (tick.outputs_read, tick.params_version) = (call.outputs_read, call.params_version);
        tick.ranges.clear();
        // SAFETY: the caller's promise.
        tick.ranges.extend((0..call.input_ranges_len).map(|at| unsafe { *call.input_ranges.add(at) }));
        tick.inputs.clear();
        tick.uses.clear();
        for at in 0..call.inputs_len {
            // SAFETY: the caller's promise.
            let input = unsafe { *call.inputs.add(at) };
            let frame = self.shared(&input)?;
            tick.inputs.push(frame);
            if self.process.is_link() {
                tick.uses.push(memory().uses(frame.buffer));
            }
        }
        self.stock.list(call.outputs_len, &self.process, &mut tick.stock);
        // SAFETY: the call is running.
        unsafe { self.habits.fill(&self.host, call.call, &mut tick) };
        self.out.clear();
        tick.put(&mut self.out);
        self.tick = tick;
        Ok(())
    }

    /// Decodes the result of a tick: the tick, the outputs as changed by the node, and the position of a source.
    ///
    /// # Safety
    /// The call and its outputs are valid.
    unsafe fn read_tick(&mut self, call: &mut abi::Call) -> Result<(), BadMessage> {
        let mut reader = after_deferred(&self.message)?;
        reader.take::<Status>()?;
        self.done.refill(&mut reader)?;
        call.tick.capture_ns = self.done.tick.capture_ns;
        if self.done.outputs.len() != call.outputs_len {
            return Err(BadMessage);
        }
        for (at, made) in self.done.outputs.iter().enumerate() {
            // SAFETY: the caller's promise.
            let shown = unsafe { &mut *call.outputs.add(at) };
            // The engine compares them with its own.
            *shown = Frame { data: shown.data, tick: shown.tick, ..*made };
        }
        if !self.done.position.is_empty() {
            // SAFETY: the call is running.
            unsafe { host::keep_position(call.call, &self.done.position) };
        }
        Ok(())
    }
}

unsafe extern "C" fn process(instance: *mut c_void, call: *mut abi::Call) -> Status {
    // SAFETY: an instance of `open` that no other thread uses, and a call that lives until this returns.
    let (remote, call) = unsafe { (&mut *instance.cast::<Remote>(), &mut *call) };
    let (outputs, outputs_len) = (call.outputs, call.outputs_len);
    let target = Target { outputs, outputs_len, ..Target::new(call.host, call.call) };
    // SAFETY: everything that the call points to lives until this returns.
    unsafe {
        if let Err(why) = remote.write_tick(call) {
            remote.copies.clear();
            return match why {
                NotShared::Exhausted => abi::STATUS_EXHAUSTED,
                NotShared::Gone => died(target, &remote.process.death()),
            };
        }
        let before = remote.lane.lane.counts();
        let status = remote.request(Kind::Process, target);
        let after = remote.lane.lane.counts();
        remote.process.totals().add(after.0 - before.0, after.1 - before.1);
        remote.copies.clear();
        if status == STATUS_DIED || remote.message.is_empty() {
            return status;
        }
        remote.params_version = Some(call.params_version);
        match remote.read_tick(call) {
            Ok(()) => status,
            Err(BadMessage) => {
                let node = &remote.lane.node;
                remote.process.kill(&format!("node `{node}` sent a malformed message"));
                let words = remote.process.death();
                died(target, &words)
            }
        }
    }
}

unsafe extern "C" fn close(instance: *mut c_void) {
    // SAFETY: an instance of `open`, closed once.
    let mut remote = unsafe { Box::from_raw(instance.cast::<Remote>()) };
    let target = Target::new(&raw const remote.host, std::ptr::null_mut());
    // SAFETY: the table lives in `remote`, and there is no call.
    unsafe { remote.ask(Kind::Close, target) };
}

unsafe extern "C" fn save_state(instance: *mut c_void, host: *const Host, sink: *mut c_void) -> Status {
    // SAFETY: an instance of `open` that no other thread uses.
    let remote = unsafe { &mut *instance.cast::<Remote>() };
    // SAFETY: table and sink live until this returns.
    unsafe { remote.ask(Kind::SaveState, Target { sink, ..Target::new(host, std::ptr::null_mut()) }) }
}

unsafe extern "C" fn load_state(instance: *mut c_void, bytes: *const u8, len: usize) -> Status {
    // SAFETY: an instance of `open` that no other thread uses; the bytes are lent for the call.
    let (remote, bytes) = unsafe {
        let bytes = if len == 0 { &[] } else { std::slice::from_raw_parts(bytes, len) };
        (&mut *instance.cast::<Remote>(), bytes)
    };
    let target = Target::new(&raw const remote.host, std::ptr::null_mut());
    for part in bytes.chunks(MAX_MESSAGE_BYTES / 2) {
        remote.out.clear();
        put_bytes(part, &mut remote.out);
        // SAFETY: the table lives in the instance, and there is no call.
        let status = unsafe { remote.request(Kind::LoadPart, target) };
        if status != abi::STATUS_OK {
            return status;
        }
    }
    // SAFETY: the table lives in the instance, and there is no call.
    unsafe { remote.ask(Kind::LoadState, target) }
}

unsafe extern "C" fn finish(instance: *mut c_void, host: *const Host, call: *mut c_void) -> Status {
    // SAFETY: an instance of `open` that no other thread uses.
    let remote = unsafe { &mut *instance.cast::<Remote>() };
    // SAFETY: table and call live until this returns.
    unsafe { remote.ask(Kind::Finish, Target::new(host, call)) }
}
