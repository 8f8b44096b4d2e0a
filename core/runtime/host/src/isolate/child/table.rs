//! The functions of the host as plugins in the child call them.
//!
//! Calls without a result are deferred and sent in front of the next message of the lane. Calls whose answer came with
//! the request (buffers, ages, the clock) are answered here. All others take a round trip to the host.

use std::cell::Cell;
use std::ffi::c_void;
use std::sync::{Mutex, PoisonError};

use panoscope_abi::{self as abi, BufferId, ChunkFn, Frame, Host, Status, Str, Tick};
use panoscope_base::random::SplitMix64;
use panoscope_engine::isolation::fits;
use panoscope_engine::memory::device_table;
use panoscope_engine::{pool, random_seed};

use super::{on_device, pools};
use crate::isolate::lane::{Lane, Side};
use crate::isolate::wire::lane::{Age, Clock, CopyWanted, Forwarded, Kind, Made, Reserved, TickRequest, Wanted};
use crate::isolate::wire::{MAX_TEXT_BYTES, Reader, Wire, put_bytes};

/// Maximum number of bytes of a saved state in one message.
const STATE_PART_BYTES: usize = 512 << 10;
/// Maximum number of deferred bytes; more are sent at once.
const MAX_DEFERRED_BYTES: usize = 64 << 10;

/// A lane in the child. Several threads of one call may use it, one after the other.
pub(super) struct ChildLane {
    pub lane: Lane,
    buffers: Mutex<Buffers>,
}

#[derive(Default)]
struct Buffers {
    out: Vec<u8>,
    message: Vec<u8>,
    /// Calls that the host runs before the next message.
    deferred: Vec<u8>,
    sent: Sent,
    /// Buffers of this call's outputs that are not shared.
    unshared: Vec<BufferId>,
}

/// Data that the host sent with a call because the node is likely to ask for it.
#[derive(Default)]
struct Sent {
    /// For each output. A buffer that was taken has length 0.
    stock: Vec<Reserved>,
    clock: Option<Clock>,
    ages: Vec<Age>,
}

/// The target of a `call` handle.
pub(super) struct CallFrame<'l> {
    pub lane: &'l ChildLane,
    pub node: String,
    pub tick: Tick,
    pub outputs: *mut Frame,
    pub outputs_len: usize,
    /// Formats of each output, one bit each; 0 for any.
    pub formats: &'l [u32],
    pub random: Option<SplitMix64>,
    /// The host's answer to the last claim of a file.
    pub file: String,
}

/// Retains and releases outside every call, which the next call passes on: buffer, and whether it is retained.
static LATER: Mutex<Vec<(BufferId, bool)>> = Mutex::new(Vec::new());

thread_local! {
    /// The lane of the call that runs on this thread. A constant without destructor: a signal handler may read it.
    static LANE: Cell<*const ChildLane> = const { Cell::new(std::ptr::null()) };
}

/// The lane of the call that runs on this thread; null outside of calls. May be called in a signal handler.
pub(super) fn current_lane() -> *const ChildLane {
    LANE.with(Cell::get)
}

/// Runs `work` for a lane on this thread.
pub(super) fn within<R>(lane: *const ChildLane, work: impl FnOnce() -> R) -> R {
    struct Restore(*const ChildLane);
    impl Drop for Restore {
        fn drop(&mut self) {
            LANE.with(|lane| lane.set(self.0));
        }
    }
    let _restore = Restore(LANE.with(|current| current.replace(lane)));
    work()
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl ChildLane {
    pub fn new(lane: Lane) -> Self {
        Self { lane, buffers: Mutex::default() }
    }

    /// Lets the host run a function; `read` decodes its result.
    fn ask<R>(&self, kind: Kind, write: impl FnOnce(&mut Vec<u8>), read: impl FnOnce(&mut Reader<'_>) -> R) -> R {
        let mut buffers = lock(&self.buffers);
        let Buffers { out, message, deferred, .. } = &mut *buffers;
        out.clear();
        put_bytes(deferred, out);
        deferred.clear();
        write(out);
        self.lane.post(Side::Child, kind, out);
        match self.lane.receive(Side::Child, message) {
            Ok(Kind::Answer) => read(&mut Reader(message)),
            // The host never does this; without its answer nothing here is right.
            _ => super::leave(super::EXIT_PROTOCOL),
        }
    }

    fn tell(&self, kind: Kind, write: impl FnOnce(&mut Vec<u8>)) {
        self.ask(kind, write, |_| ());
    }

    /// Defers a function that the host runs before the next message.
    fn defer(&self, kind: Kind, write: impl FnOnce(&mut Vec<u8>)) {
        let mut buffers = lock(&self.buffers);
        (kind as u32).put(&mut buffers.deferred);
        write(&mut buffers.deferred);
        let is_full = buffers.deferred.len() > MAX_DEFERRED_BYTES;
        drop(buffers);
        if is_full {
            self.tell(Kind::Flush, |_| ());
        }
    }

    /// Begins a message of the lane with the deferred functions and the retains and releases outside every call.
    pub fn begin(&self, out: &mut Vec<u8>) {
        for (buffer, is_retained) in std::mem::take(&mut *lock(&LATER)) {
            count_now(self, buffer, is_retained);
        }
        out.clear();
        let deferred = &mut lock(&self.buffers).deferred;
        put_bytes(deferred, out);
        deferred.clear();
    }

    /// Takes the data that the host sent with a call, in exchange for the memory of the last one's.
    pub fn receive_sent(&self, request: &mut TickRequest) {
        let mut buffers = lock(&self.buffers);
        let Buffers { unshared, sent, .. } = &mut *buffers;
        unshared.clear();
        sent.clock = request.clock;
        std::mem::swap(&mut sent.stock, &mut request.stock);
        std::mem::swap(&mut sent.ages, &mut request.ages);
    }

    /// Clears that data, for a call without inputs and outputs.
    pub fn forget_sent(&self) {
        let mut buffers = lock(&self.buffers);
        buffers.unshared.clear();
        buffers.sent = Sent::default();
    }

    /// The reserved buffer for an output of this size; each can be taken once.
    fn take_from_stock(&self, output: u32, len: usize) -> Option<(BufferId, *mut u8)> {
        let mut buffers = lock(&self.buffers);
        let reserved = buffers.sent.stock.get_mut(output as usize)?;
        if reserved.len == 0 || len as u64 > reserved.len {
            return None;
        }
        reserved.len = 0;
        let buffer = reserved.buffer;
        let data = pools::resolve(buffer);
        buffers.unshared.push(buffer);
        (!data.is_null()).then_some((buffer, data))
    }

    fn is_unshared(&self, buffer: BufferId) -> bool {
        lock(&self.buffers).unshared.contains(&buffer)
    }

    fn set_unshared(&self, buffer: BufferId, is_unshared: bool) {
        let unshared = &mut lock(&self.buffers).unshared;
        unshared.retain(|known| *known != buffer);
        if is_unshared {
            unshared.push(buffer);
        }
    }
}

unsafe fn frame<'c>(call: *mut c_void) -> Option<&'c mut CallFrame<'c>> {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    unsafe { call.cast::<CallFrame<'c>>().as_mut() }
}

unsafe fn bytes<'t>(text: Str) -> &'t [u8] {
    // SAFETY: the plugin lends the text for the length of the call.
    let bytes = unsafe { text.bytes() };
    &bytes[..bytes.len().min(MAX_TEXT_BYTES)]
}

impl CallFrame<'_> {
    /// An output as the node sees it.
    fn shown(&self, index: u32) -> Option<Frame> {
        // SAFETY: `outputs` holds `outputs_len` frames for the length of the call.
        ((index as usize) < self.outputs_len).then(|| unsafe { self.outputs.add(index as usize).read() })
    }

    pub(super) fn show(&mut self, index: u32, frame: Frame) {
        let Some(before) = self.shown(index) else { return };
        // SAFETY: as in `shown`; one thread at a time makes outputs (the contract).
        unsafe { self.outputs.add(index as usize).write(frame) };
        let is_shown = |at: u32| self.shown(at).is_some_and(|shown| shown.data == before.data);
        if before.buffer.home == abi::HOME_DEVICE && !(0..self.outputs_len as u32).any(is_shown) {
            on_device::forget(std::ptr::from_ref(self.lane) as usize, before.data);
        }
    }

    /// Whether output `index` may be a frame of this description; the host reports why not.
    fn accepts(&self, index: u32, frame: &Frame) -> bool {
        self.formats.get(index as usize).is_some_and(|formats| fits(*formats, frame))
    }

    /// Asks for an output and puts it into the node's list.
    fn made(&mut self, kind: Kind, output: u32, write: impl FnOnce(&mut Vec<u8>)) -> Status {
        let none = Made { status: abi::STATUS_ERROR, frame: Frame::EMPTY };
        let Made { status, frame: made } = self.lane.ask(kind, write, |reader| reader.take().unwrap_or(none));
        if status != abi::STATUS_OK {
            return status;
        }
        let data = pools::resolve(made.buffer);
        if data.is_null() {
            return abi::STATUS_EXHAUSTED;
        }
        self.show(output, Frame { data, ..made });
        // Only buffers of this group can be written.
        self.lane.set_unshared(made.buffer, kind != Kind::Forward);
        status
    }
}

unsafe extern "C" fn alloc(
    call: *mut c_void,
    output: u32,
    format: u32,
    width: u32,
    height: u32,
    stride_bytes: u32,
    len: usize,
) -> Status {
    // SAFETY: see `frame`.
    let Some(call) = (unsafe { frame(call) }) else { return abi::STATUS_INVALID };
    let frame = Frame { len, format, width, height, stride_bytes, tick: call.tick, ..Frame::EMPTY };
    let wanted = Wanted { output, format, width, height, stride_bytes, len: len as u64 };
    if call.accepts(output, &frame)
        && let Some((buffer, data)) = call.lane.take_from_stock(output, len)
    {
        call.show(output, Frame { buffer, data, ..frame });
        call.lane.defer(Kind::Placed, |out| wanted.put(out));
        return abi::STATUS_OK;
    }
    call.made(Kind::Alloc, output, |out| wanted.put(out))
}

unsafe extern "C" fn forward(call: *mut c_void, output: u32, given: *const Frame) -> Status {
    // SAFETY: see `frame`; the frame is read for the length of this function.
    let (Some(call), Some(given)) = (unsafe { (frame(call), given.as_ref()) }) else { return abi::STATUS_INVALID };
    let is_buffer = !given.data.is_null() && pools::resolve(given.buffer) == given.data;
    let write = |out: &mut Vec<u8>| Forwarded { output, is_buffer, frame: *given }.put(out);
    if is_buffer && call.accepts(output, given) {
        call.show(output, Frame { tick: call.tick, ..*given });
        call.lane.set_unshared(given.buffer, false);
        call.lane.defer(Kind::Forward, write);
        return abi::STATUS_OK;
    }
    call.made(Kind::Forward, output, write)
}

unsafe extern "C" fn make_mut(call: *mut c_void, output: u32) -> Status {
    // SAFETY: see `frame`.
    let Some(call) = (unsafe { frame(call) }) else { return abi::STATUS_INVALID };
    let Some(shown) = call.shown(output).filter(|shown| !shown.is_empty()) else { return abi::STATUS_INVALID };
    on_device::bring(current_lane() as usize);
    if call.lane.is_unshared(shown.buffer) {
        return abi::STATUS_OK;
    }
    if let Some((buffer, data)) = call.lane.take_from_stock(output, shown.len) {
        // SAFETY: `shown` describes a mapped buffer, unless the node changed it, which only harms its own process; the other buffer has at
        // least as many bytes and no other owner.
        unsafe { std::ptr::copy_nonoverlapping(shown.data, data, shown.len) };
        call.show(output, Frame { buffer, data, ..shown });
        call.lane.defer(Kind::Copied, |out| output.put(out));
        return abi::STATUS_OK;
    }
    call.made(Kind::MakeMut, output, |out| CopyWanted { output, frame: shown }.put(out))
}

fn count_now(lane: &ChildLane, buffer: BufferId, is_retained: bool) {
    lane.set_unshared(buffer, false);
    lane.defer(if is_retained { Kind::Retain } else { Kind::Release }, |out| buffer.put(out));
}

fn count(buffer: BufferId, is_retained: bool) {
    // SAFETY: set by `within` for no longer than the lane lives.
    match unsafe { current_lane().as_ref() } {
        Some(lane) => count_now(lane, buffer, is_retained),
        None => lock(&LATER).push((buffer, is_retained)),
    }
}

unsafe extern "C" fn retain(_: *mut c_void, buffer: BufferId) {
    count(buffer, true);
}

unsafe extern "C" fn release(_: *mut c_void, buffer: BufferId) {
    count(buffer, false);
}

unsafe extern "C" fn resolve(_: *mut c_void, buffer: BufferId) -> *mut u8 {
    pools::resolve(buffer)
}

/// A loop whose chunks run for the lane of its caller.
struct Loop {
    body: unsafe extern "C" fn(*mut c_void, usize),
    data: *mut c_void,
    lane: *const ChildLane,
}

unsafe extern "C" fn chunk(data: *mut c_void, index: usize) {
    // SAFETY: `data` is the loop of `parallel_for`, which lives until all chunks are done; the plugin promises the rest.
    unsafe {
        let this = &*data.cast::<Loop>();
        within(this.lane, || (this.body)(this.data, index));
    }
}

unsafe extern "C" fn parallel_for(_: *mut c_void, chunks: usize, body: ChunkFn, data: *mut c_void) -> Status {
    let Some(body) = body else { return abi::STATUS_INVALID };
    let mut this = Loop { body, data, lane: current_lane() };
    // SAFETY: the plugin's promise to `parallel_for`; `this` lives until it returns.
    let done = unsafe { pool::parallel_for(chunks, Some(chunk), (&raw mut this).cast()) };
    if done { abi::STATUS_OK } else { abi::STATUS_INVALID }
}

unsafe extern "C" fn log(call: *mut c_void, level: u32, message: Str) {
    // SAFETY: see `frame` and `bytes`.
    if let (Some(call), message) = unsafe { (frame(call), bytes(message)) } {
        call.lane.tell(Kind::Log, |out| {
            level.put(out);
            put_bytes(message, out);
        });
    }
}

unsafe extern "C" fn fail(call: *mut c_void, message: Str) {
    // SAFETY: see `frame` and `bytes`.
    if let (Some(call), message) = unsafe { (frame(call), bytes(message)) } {
        call.lane.tell(Kind::Fail, |out| put_bytes(message, out));
    }
}

unsafe extern "C" fn metric(call: *mut c_void, name: Str, value: f64) {
    // SAFETY: see `frame` and `bytes`.
    if let (Some(call), name) = unsafe { (frame(call), bytes(name)) } {
        call.lane.defer(Kind::Metric, |out| {
            put_bytes(name, out);
            value.put(out);
        });
    }
}

unsafe extern "C" fn random(call: *mut c_void) -> u64 {
    // SAFETY: see `frame`.
    match unsafe { frame(call) } {
        // The host's generator: it needs nothing but the names.
        Some(CallFrame { node, tick, random, .. }) => {
            random.get_or_insert_with(|| SplitMix64(random_seed(node, *tick))).bits()
        }
        None => 0,
    }
}

unsafe extern "C" fn save(sink: *mut c_void, bytes: *const u8, len: usize) {
    // SAFETY: the sink is that of `save_state`; the bytes are lent for the call.
    unsafe {
        if let Some(sink) = sink.cast::<Vec<u8>>().as_mut()
            && len > 0
        {
            sink.extend_from_slice(std::slice::from_raw_parts(bytes, len));
        }
    }
}

/// Saves the state of an instance into `state`.
pub(super) fn save_state(node_type: &abi::NodeType, raw: *mut c_void, host: &Host, state: &mut Vec<u8>) -> Status {
    state.clear();
    match node_type.save_state {
        // SAFETY: an open instance that only this thread uses; the sink lives until the call returns, and the table takes bytes for it.
        Some(save) => unsafe { save(raw, host, std::ptr::from_mut(state).cast()) },
        None => abi::STATUS_INVALID,
    }
}

impl ChildLane {
    /// Passes a saved state on to the host.
    pub fn send_state(&self, state: &[u8]) {
        state.chunks(STATE_PART_BYTES).for_each(|part| self.tell(Kind::Save, |out| put_bytes(part, out)));
    }
}

unsafe extern "C" fn claim_file(call: *mut c_void, path: Str, action: u32, file: *mut Str) -> Status {
    // SAFETY: see `frame`; the plugin lends the text for the length of the call.
    let (Some(call), Some(path)) = (unsafe { (frame(call), path.text()) }) else { return abi::STATUS_INVALID };
    let (status, answer) = call.lane.ask(
        Kind::ClaimFile,
        |out| {
            action.put(out);
            put_bytes(path.as_bytes(), out);
        },
        |reader| (reader.take().unwrap_or(abi::STATUS_ERROR), reader.take().unwrap_or(String::new())),
    );
    call.file = answer;
    // SAFETY: null or a place for the answer, which stays as it is until the next claim of this call.
    if let Some(file) = unsafe { file.as_mut() } {
        *file = Str::borrow(&call.file);
    }
    status
}

unsafe extern "C" fn clock_ns(call: *mut c_void) -> i64 {
    // SAFETY: see `frame`.
    let Some(call) = (unsafe { frame(call) }) else { return 0 };
    if let Some(Clock { host_ns, system_ns }) = lock(&call.lane.buffers).sent.clock {
        return host_ns.saturating_add(crate::isolate::system_ns().saturating_sub(system_ns).max(0));
    }
    call.lane.ask(Kind::Clock, |_| (), |reader| reader.take().unwrap_or(0))
}

unsafe extern "C" fn set_arrived_ns(call: *mut c_void, arrived_ns: i64) {
    // SAFETY: see `frame`.
    if let Some(call) = unsafe { frame(call) } {
        call.lane.defer(Kind::SetArrived, |out| arrived_ns.put(out));
    }
}

unsafe extern "C" fn arrived_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: see `frame`.
    unsafe { age(call, Kind::Arrived, input, |age| age.arrived_ns, i64::MIN) }
}

unsafe extern "C" fn age_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: see `frame`.
    unsafe { age(call, Kind::Age, input, |age| age.age_ns, i64::MAX) }
}

unsafe fn age(call: *mut c_void, kind: Kind, input: u32, of: fn(Age) -> i64, otherwise: i64) -> i64 {
    // SAFETY: the caller's promise.
    let Some(call) = (unsafe { frame(call) }) else { return otherwise };
    let sent = lock(&call.lane.buffers).sent.ages.iter().find(|age| age.input == input).copied();
    match sent {
        Some(sent) => of(sent),
        None => call.lane.ask(kind, |out| input.put(out), |reader| reader.take().unwrap_or(otherwise)),
    }
}

unsafe extern "C" fn set_lag_ns(call: *mut c_void, lag_ns: i64) {
    // SAFETY: see `frame`.
    if let Some(call) = unsafe { frame(call) } {
        call.lane.defer(Kind::SetLag, |out| lag_ns.put(out));
    }
}

unsafe extern "C" fn device(_: *mut c_void, reason: *mut Str) -> *const abi::Device {
    // SAFETY: null or a place for the reason (the contract).
    unsafe { device_table(reason) }
}

unsafe extern "C" fn device_buffer(_: *mut c_void, given: *const Frame) -> u64 {
    // SAFETY: the frame is read for the length of this function; null gives `None`.
    let Some(given) = (unsafe { given.as_ref() }).filter(|given| pools::resolve(given.buffer) == given.data) else {
        return 0;
    };
    // SAFETY: the node holds the frame, whose pool is mapped.
    unsafe { on_device::upload(current_lane() as usize, given) }.unwrap_or(0)
}

unsafe extern "C" fn alloc_on_device(
    call: *mut c_void,
    output: u32,
    format: u32,
    width: u32,
    height: u32,
    stride_bytes: u32,
    len: usize,
    buffer: *mut u64,
) -> Status {
    // SAFETY: the plugin's promise to `alloc`, which is the same.
    let status = unsafe { alloc(call, output, format, width, height, stride_bytes, len) };
    // SAFETY: see `frame`; null or a place for the buffer.
    let (Some(call), Some(place)) = (unsafe { (frame(call), buffer.as_mut()) }) else { return abi::STATUS_INVALID };
    let Some(made) = call.shown(output).filter(|_| status == abi::STATUS_OK) else { return status };
    let Some(handle) = on_device::make(current_lane() as usize, made) else { return abi::STATUS_ERROR };
    *place = handle;
    let buffer = BufferId { home: abi::HOME_DEVICE, ..made.buffer };
    call.show(output, Frame { buffer, ..made });
    abi::STATUS_OK
}

unsafe extern "C" fn fetch(_: *mut c_void, _: *const Frame) -> Status {
    // What the host sends is in memory. What this call made on the GPU comes when it ends.
    if on_device::bring(current_lane() as usize) { abi::STATUS_OK } else { abi::STATUS_ERROR }
}

/// The function table for plugins in the child.
pub(super) fn table(threads: u32) -> Host {
    Host {
        struct_size: size_of::<Host>() as u32,
        abi_major: abi::ABI_MAJOR,
        abi_minor: abi::ABI_MINOR,
        threads,
        ctx: std::ptr::null_mut(),
        alloc: Some(alloc),
        forward: Some(forward),
        make_mut: Some(make_mut),
        retain: Some(retain),
        release: Some(release),
        resolve: Some(resolve),
        parallel_for: Some(parallel_for),
        log: Some(log),
        fail: Some(fail),
        metric: Some(metric),
        random: Some(random),
        save: Some(save),
        claim_file: Some(claim_file),
        clock_ns: Some(clock_ns),
        set_arrived_ns: Some(set_arrived_ns),
        arrived_ns: Some(arrived_ns),
        age_ns: Some(age_ns),
        set_lag_ns: Some(set_lag_ns),
        device: Some(device),
        device_buffer: Some(device_buffer),
        alloc_on_device: Some(alloc_on_device),
        fetch: Some(fetch),
    }
}
