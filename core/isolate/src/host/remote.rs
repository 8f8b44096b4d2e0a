//! An instance that lives in a child process: the functions of the contract, each a message there and back.

use std::ffi::c_void;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use panoscope_abi::{self as abi, Frame, Host, NodeType, Status, Str, Tick};
use panoscope_engine::isolation::STATUS_DIED;
use panoscope_engine::memory::{FrameRef, Memory, memory};

use super::PluginImage;
use super::process::{NodeLane, Process};
use crate::lane::{Lost, MOST_BYTES, Side};
use crate::wire::{BadMessage, Kind, Reader, Writer, plain_status};

/// What the functions of the host need while a request is in the child.
#[derive(Clone, Copy)]
struct Place {
    host: *const Host,
    call: *mut c_void,
    /// Target of `save`.
    sink: *mut c_void,
    /// The outputs as the node sees them.
    outputs: *mut Frame,
    outputs_len: usize,
}

/// The instance as the engine holds it.
struct Remote {
    process: Arc<Process>,
    lane: Arc<NodeLane>,
    host: Host,
    /// The message to post.
    out: Vec<u8>,
    /// The message received last.
    message: Vec<u8>,
    /// Version of the parameters that the child knows.
    params_version: Option<u64>,
    /// Copies of inputs that the child could not map.
    copies: Vec<FrameRef>,
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
    index: u32,
    call: *mut abi::OpenCall,
    instance: *mut *mut c_void,
) -> Status {
    // SAFETY: the caller's promise: the call lives, and what it points to.
    let (open, node) = unsafe { (&*call, (*call).node_id.text().unwrap_or("?")) };
    // SAFETY: the call has the host's table.
    let place = Place::without_outputs(open.host, open.call);
    let lane = process.give_plugin(image).and_then(|()| process.lane(node));
    let lane = match lane {
        Ok(lane) => lane,
        Err(_) if process.is_ending() => {
            // SAFETY: the call lives.
            return unsafe { place.died(&process.death()) };
        }
        Err(cause) => {
            // SAFETY: the call lives.
            unsafe { place.fail(&format!("its process could not be reached: {cause}")) };
            return abi::STATUS_ERROR;
        }
    };
    // SAFETY: the call has the host's table, of plain pointers.
    let host = unsafe { std::ptr::read(open.host) };
    let (out, message, copies) = (Vec::new(), Vec::new(), Vec::new());
    let mut remote = Remote { process, lane, host, out, message, params_version: None, copies };
    let threads = remote.host.threads;
    remote.begin().u32(image.id).u32(index).u32(open.flags).u32(threads).u64(open.outputs_read);
    // SAFETY: texts and values of the call live.
    unsafe {
        Writer(&mut remote.out).bytes(open.node_id.bytes()).bytes(open.graph_dir.bytes());
        Writer(&mut remote.out).params(open.params, open.params_len);
    }
    // SAFETY: the caller's promise.
    let status = unsafe { remote.request(Kind::Open, place) };
    if status == abi::STATUS_OK {
        // SAFETY: the caller gives a place for the instance.
        unsafe { *instance = Box::into_raw(Box::new(remote)).cast() };
    }
    status
}

impl Place {
    fn without_outputs(host: *const Host, call: *mut c_void) -> Self {
        Self { host, call, sink: std::ptr::null_mut(), outputs: std::ptr::null_mut(), outputs_len: 0 }
    }

    /// Gives the words of a failure, where there is a call to give them to.
    unsafe fn fail(&self, words: &str) {
        if self.call.is_null() {
            return;
        }
        // SAFETY: the caller's promise: table and call live.
        unsafe {
            if let Some(fail) = (*self.host).fail {
                fail(self.call, Str::borrow(words));
            }
        }
    }

    unsafe fn died(&self, words: &str) -> Status {
        // SAFETY: the caller's promise: table and call live.
        unsafe { self.fail(words) };
        STATUS_DIED
    }

    /// An output as the node sees it.
    fn output(&self, index: u32) -> Option<*mut Frame> {
        // SAFETY: `outputs` holds `outputs_len` frames.
        ((index as usize) < self.outputs_len).then(|| unsafe { self.outputs.add(index as usize) })
    }
}

impl Drop for Remote {
    fn drop(&mut self) {
        self.process.drop_lane(&self.lane);
    }
}

impl Remote {
    /// Begins a message.
    fn begin(&mut self) -> Writer<'_> {
        self.out.clear();
        Writer(&mut self.out)
    }

    /// Posts the message, serves the child until it is done, and returns the status. The rest of the child's message is in `message`, behind
    /// the status.
    ///
    /// # Safety
    /// Table and call of `place` live, and its outputs.
    unsafe fn request(&mut self, kind: Kind, place: Place) -> Status {
        if self.out.len() > MOST_BYTES {
            self.message.clear();
            let most = MOST_BYTES >> 10;
            // SAFETY: the caller's promise.
            unsafe { place.fail(&format!("its parameters take more than the {most} KiB of a message to its process")) };
            return abi::STATUS_ERROR;
        }
        // SAFETY: the caller's promise.
        match unsafe { self.exchange(kind, place) } {
            Ok(status) => status,
            Err(lost) => {
                if lost == Lost::Bad {
                    let node = &self.lane.node;
                    self.process.kill(&format!("node `{node}` sent a message that makes no sense"));
                }
                let words = self.process.death();
                // SAFETY: the caller's promise.
                unsafe { place.died(&words) }
            }
        }
    }

    unsafe fn exchange(&mut self, kind: Kind, place: Place) -> Result<Status, Lost> {
        let (process, lane) = (Arc::clone(&self.process), Arc::clone(&self.lane));
        if process.is_dead() {
            return Err(Lost::Gone);
        }
        lane.in_call.store(true, Ordering::Relaxed);
        let mut kind = kind;
        loop {
            lane.lane.post(Side::Host, kind, &self.out);
            // The end of the process closes lanes after it is recorded: whoever posts later sees it here.
            if process.is_dead() {
                return Err(Lost::Gone);
            }
            let asked = lane.lane.receive(Side::Host, &mut self.message)?;
            if asked == Kind::Done {
                break;
            }
            let message = std::mem::take(&mut self.message);
            // SAFETY: the caller's promise.
            let answered = unsafe { self.answer(asked, &message, place) };
            self.message = message;
            answered?;
            kind = Kind::Answer;
        }
        lane.in_call.store(false, Ordering::Relaxed);
        Ok(plain_status(Reader(&self.message).i32()?))
    }

    /// Runs a function of the host for the child and writes its result.
    ///
    /// # Safety
    /// Table and call of `place` live, and its outputs.
    unsafe fn answer(&mut self, asked: Kind, message: &[u8], place: Place) -> Result<(), BadMessage> {
        self.out.clear();
        let mut out = Writer(&mut self.out);
        let mut reader = Reader(message);
        let (call, host) = (place.call, &self.host);
        if asked == Kind::Retain || asked == Kind::Release {
            let function = if asked == Kind::Retain { host.retain } else { host.release };
            let buffer = reader.buffer()?;
            if let Some(function) = function {
                // SAFETY: the host checks the buffer.
                unsafe { function(host.ctx, buffer) };
            }
            return Ok(());
        }
        if asked == Kind::Save {
            let bytes = reader.bytes()?;
            // SAFETY: the table that came with the sink takes bytes for it.
            if let Some(save) = unsafe { (*place.host).save }.filter(|_| !place.sink.is_null()) {
                // SAFETY: the bytes live until the call returns.
                unsafe { save(place.sink, bytes.as_ptr(), bytes.len()) };
            }
            return Ok(());
        }
        if call.is_null() {
            return Err(BadMessage);
        }
        match asked {
            Kind::Alloc => {
                let output = reader.u32()?;
                let (format, width, height, stride) = (reader.u32()?, reader.u32()?, reader.u32()?, reader.u32()?);
                let len = usize::try_from(reader.u64()?).map_err(|_| BadMessage)?;
                // SAFETY: the running call; the host checks all numbers.
                let status = host.alloc.map_or(abi::STATUS_INVALID, |alloc| unsafe {
                    alloc(call, output, format, width, height, stride, len)
                });
                // SAFETY: the outputs live.
                unsafe { self.made(status, output, place) }
            }
            Kind::Forward => {
                let (output, is_buffer) = (reader.u32()?, reader.u32()? == 1);
                let mut frame = reader.frame()?;
                if is_buffer {
                    frame.data = memory().resolve(frame.buffer);
                }
                // SAFETY: the running call; the host checks the frame.
                let status = host
                    .forward
                    .map_or(abi::STATUS_INVALID, |forward| unsafe { forward(call, output, &raw const frame) });
                // SAFETY: the outputs live.
                unsafe { self.made(status, output, place) }
            }
            Kind::MakeMut => {
                let output = reader.u32()?;
                // SAFETY: the running call; the host checks the number.
                let status = host.make_mut.map_or(abi::STATUS_INVALID, |make_mut| unsafe { make_mut(call, output) });
                // SAFETY: the outputs live.
                unsafe { self.made(status, output, place) }
            }
            Kind::Log => {
                let (level, words) = (reader.u32()?, reader.bytes()?);
                if let Some(log) = host.log {
                    // SAFETY: the running call; the words live until the call returns.
                    unsafe { log(call, level, Str { ptr: words.as_ptr(), len: words.len() }) };
                }
                Ok(())
            }
            Kind::Fail => {
                let words = reader.bytes()?;
                if let Some(fail) = host.fail {
                    // SAFETY: the running call; the words live until the call returns.
                    unsafe { fail(call, Str { ptr: words.as_ptr(), len: words.len() }) };
                }
                Ok(())
            }
            Kind::Metric => {
                let (name, value) = (reader.bytes()?, reader.f64()?);
                if let Some(metric) = host.metric {
                    // SAFETY: the running call; the name lives until the call returns.
                    unsafe { metric(call, Str { ptr: name.as_ptr(), len: name.len() }, value) };
                }
                Ok(())
            }
            Kind::ClaimFile => {
                let (action, path) = (reader.u32()?, reader.text()?);
                let mut file = Str::EMPTY;
                // SAFETY: the running call; path and place for the answer live until the call returns.
                let status = host.claim_file.map_or(abi::STATUS_INVALID, |claim| unsafe {
                    claim(call, Str::borrow(path), action, &raw mut file)
                });
                // SAFETY: the host's answer stays as it is until the next claim.
                out.i32(status).bytes(unsafe { file.bytes() });
                Ok(())
            }
            Kind::Clock => {
                // SAFETY: the running call.
                out.i64(host.clock_ns.map_or(0, |clock| unsafe { clock(call) }));
                Ok(())
            }
            Kind::SetArrived | Kind::SetLag => {
                let ns = reader.i64()?;
                let set = if asked == Kind::SetLag { host.set_lag_ns } else { host.set_arrived_ns };
                if let Some(set) = set {
                    // SAFETY: the running call.
                    unsafe { set(call, ns) };
                }
                Ok(())
            }
            Kind::Arrived | Kind::Age => {
                let input = reader.u32()?;
                let ask = if asked == Kind::Age { host.age_ns } else { host.arrived_ns };
                // SAFETY: the running call; the host checks the number.
                out.i64(ask.map_or(i64::MIN, |ask| unsafe { ask(call, input) }));
                Ok(())
            }
            _ => Err(BadMessage),
        }
    }

    /// Writes the status of a function that makes an output, and the output.
    ///
    /// # Safety
    /// The outputs of `place` live.
    unsafe fn made(&mut self, status: Status, output: u32, place: Place) -> Result<(), BadMessage> {
        let mut out = Writer(&mut self.out);
        match place.output(output).filter(|_| status == abi::STATUS_OK) {
            Some(frame) => {
                // SAFETY: the caller's promise.
                let frame = unsafe { &*frame };
                match self.process.give_pool(frame.buffer) {
                    Ok(()) => _ = out.i32(status).frame(frame),
                    // Private memory of the host, which a retained frame may still be in.
                    Err(_) => _ = out.i32(abi::STATUS_EXHAUSTED).frame(&Frame::EMPTY),
                }
            }
            None => {
                _ = out.i32(if status == abi::STATUS_OK { abi::STATUS_INVALID } else { status }).frame(&Frame::EMPTY)
            }
        }
        Ok(())
    }

    /// An input as the child can map it.
    fn shared(&mut self, input: &Frame) -> Option<Frame> {
        if input.is_empty() {
            return Some(*input);
        }
        let mut frame = *input;
        if self.process.give_pool(frame.buffer).is_err() {
            // Made before there were isolated nodes.
            let (buffer, data) = memory().allocate(frame.len).ok()?;
            // SAFETY: two buffers of at least `len` bytes; the new one is known only here.
            unsafe { std::ptr::copy_nonoverlapping(frame.data, data, frame.len) };
            frame = Frame { buffer, data, ..frame };
            // SAFETY: the one reference of the new buffer.
            self.copies.push(unsafe { FrameRef::adopt(frame) });
            if Memory::domain_of(buffer) == 0 || self.process.give_pool(buffer).is_err() {
                return None;
            }
        }
        Some(frame)
    }

    /// Writes the request of a tick; `false` when an input cannot be shared.
    ///
    /// # Safety
    /// Everything that the call points to lives.
    unsafe fn write_tick(&mut self, call: &abi::Call) -> bool {
        let sends_params = self.params_version != Some(call.params_version);
        self.begin().u32(call.flags).tick(&call.tick).u64(call.outputs_read).u64(call.params_version);
        Writer(&mut self.out).u32(u32::from(sends_params));
        if sends_params {
            // SAFETY: the caller's promise.
            unsafe { Writer(&mut self.out).params(call.params, call.params_len) };
        }
        Writer(&mut self.out).u64(call.input_ranges_len as u64);
        for at in 0..call.input_ranges_len {
            // SAFETY: the caller's promise.
            let range = unsafe { *call.input_ranges.add(at) };
            Writer(&mut self.out).u32(range.first).u32(range.count);
        }
        Writer(&mut self.out).u64(call.inputs_len as u64);
        for at in 0..call.inputs_len {
            // SAFETY: the caller's promise.
            let input = unsafe { *call.inputs.add(at) };
            let Some(frame) = self.shared(&input) else { return false };
            Writer(&mut self.out).frame(&frame);
        }
        Writer(&mut self.out).u64(call.outputs_len as u64);
        true
    }

    /// Reads what the child says of a tick that succeeded: the tick, and the outputs as the node left them.
    ///
    /// # Safety
    /// The call and its outputs live.
    unsafe fn read_tick(&self, call: &mut abi::Call) -> Result<(), BadMessage> {
        let mut reader = Reader(&self.message);
        reader.i32()?;
        let Tick { capture_ns, .. } = reader.tick()?;
        call.tick.capture_ns = capture_ns;
        if reader.count(1)? != call.outputs_len {
            return Err(BadMessage);
        }
        for at in 0..call.outputs_len {
            // SAFETY: the caller's promise.
            let shown = unsafe { &mut *call.outputs.add(at) };
            let Frame { buffer, len, format, width, height, stride_bytes, .. } = reader.frame()?;
            // The engine compares them with its own.
            *shown = Frame { buffer, len, format, width, height, stride_bytes, ..*shown };
        }
        Ok(())
    }
}

unsafe extern "C" fn process(instance: *mut c_void, call: *mut abi::Call) -> Status {
    // SAFETY: an instance of `open` that no other thread uses, and a call that lives until this returns.
    let (remote, call) = unsafe { (&mut *instance.cast::<Remote>(), &mut *call) };
    let (outputs, outputs_len) = (call.outputs, call.outputs_len);
    let place = Place { outputs, outputs_len, ..Place::without_outputs(call.host, call.call) };
    // SAFETY: everything that the call points to lives until this returns.
    unsafe {
        if !remote.write_tick(call) {
            remote.copies.clear();
            return abi::STATUS_EXHAUSTED;
        }
        let status = remote.request(Kind::Process, place);
        remote.copies.clear();
        if status == STATUS_DIED || remote.message.is_empty() {
            return status;
        }
        remote.params_version = Some(call.params_version);
        match remote.read_tick(call) {
            Ok(()) => status,
            Err(BadMessage) => {
                let node = &remote.lane.node;
                remote.process.kill(&format!("node `{node}` sent a message that makes no sense"));
                let words = remote.process.death();
                place.died(&words)
            }
        }
    }
}

unsafe extern "C" fn close(instance: *mut c_void) {
    // SAFETY: an instance of `open`, closed once.
    let mut remote = unsafe { Box::from_raw(instance.cast::<Remote>()) };
    remote.begin();
    let place = Place::without_outputs(&raw const remote.host, std::ptr::null_mut());
    // SAFETY: the table lives in `remote`, and there is no call.
    unsafe { remote.request(Kind::Close, place) };
}

unsafe extern "C" fn save_state(instance: *mut c_void, host: *const Host, sink: *mut c_void) -> Status {
    // SAFETY: an instance of `open` that no other thread uses.
    let remote = unsafe { &mut *instance.cast::<Remote>() };
    remote.begin();
    // SAFETY: table and sink live until this returns.
    unsafe { remote.request(Kind::SaveState, Place { sink, ..Place::without_outputs(host, std::ptr::null_mut()) }) }
}

unsafe extern "C" fn load_state(instance: *mut c_void, bytes: *const u8, len: usize) -> Status {
    // SAFETY: an instance of `open` that no other thread uses; the bytes are lent for the call.
    let (remote, bytes) = unsafe {
        let bytes = if len == 0 { &[] } else { std::slice::from_raw_parts(bytes, len) };
        (&mut *instance.cast::<Remote>(), bytes)
    };
    let place = Place::without_outputs(&raw const remote.host, std::ptr::null_mut());
    for part in bytes.chunks(MOST_BYTES / 2) {
        remote.begin().bytes(part);
        // SAFETY: the table lives in the instance, and there is no call.
        let status = unsafe { remote.request(Kind::LoadPart, place) };
        if status != abi::STATUS_OK {
            return status;
        }
    }
    remote.begin();
    // SAFETY: the table lives in the instance, and there is no call.
    unsafe { remote.request(Kind::LoadState, place) }
}

unsafe extern "C" fn finish(instance: *mut c_void, host: *const Host, call: *mut c_void) -> Status {
    // SAFETY: an instance of `open` that no other thread uses.
    let remote = unsafe { &mut *instance.cast::<Remote>() };
    remote.begin();
    // SAFETY: table and call live until this returns.
    unsafe { remote.request(Kind::Finish, Place::without_outputs(host, call)) }
}
