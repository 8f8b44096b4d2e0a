//! The functions of the host as plugins in the child call them: most go to the host through the lane of the running call.

use std::cell::Cell;
use std::ffi::c_void;
use std::sync::{Mutex, PoisonError};

use panoscope_abi::{self as abi, BufferId, ChunkFn, Frame, Host, Status, Str, Tick};
use panoscope_base::random::SplitMix64;
use panoscope_engine::{pool, random_seed};

use super::pools;
use crate::lane::{Lane, Side};
use crate::wire::{Kind, Reader, Writer};

/// Longest text of a log line, a fault or a path that is passed on.
const MOST_TEXT: usize = 64 << 10;
/// Bytes of a saved state that one message takes.
const MOST_STATE: usize = 512 << 10;

/// A lane in the child. Several threads of one call may use it, one after the other.
pub(super) struct ChildLane {
    pub lane: Lane,
    buffers: Mutex<Buffers>,
}

#[derive(Default)]
struct Buffers {
    out: Vec<u8>,
    message: Vec<u8>,
}

/// The target of a `call` handle.
pub(super) struct CallFrame<'l> {
    pub lane: &'l ChildLane,
    pub node: String,
    pub tick: Tick,
    pub outputs: *mut Frame,
    pub outputs_len: usize,
    pub random: Option<SplitMix64>,
    /// The host's answer to the last claim of a file.
    pub file: String,
}

/// Retains and releases outside every call, for the next call to pass on: buffer, and whether it is retained.
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

    /// Has the host run a function; `read` gets its result.
    fn ask<R>(&self, kind: Kind, write: impl FnOnce(&mut Writer<'_>), read: impl FnOnce(&mut Reader<'_>) -> R) -> R {
        let mut buffers = lock(&self.buffers);
        let Buffers { out, message } = &mut *buffers;
        out.clear();
        write(&mut Writer(out));
        self.lane.post(Side::Child, kind, out);
        match self.lane.receive(Side::Child, message) {
            Ok(Kind::Answer) => read(&mut Reader(message)),
            // The host never does this; without its answer nothing here is right.
            _ => super::leave(super::EXIT_PROTOCOL),
        }
    }

    fn tell(&self, kind: Kind, write: impl FnOnce(&mut Writer<'_>)) {
        self.ask(kind, write, |_| ());
    }

    /// Passes on what was retained and released outside every call.
    pub fn pass_on(&self) {
        let later = std::mem::take(&mut *lock(&LATER));
        for (buffer, retained) in later {
            let kind = if retained { Kind::Retain } else { Kind::Release };
            self.tell(kind, |out| _ = out.buffer(buffer));
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
    &bytes[..bytes.len().min(MOST_TEXT)]
}

impl CallFrame<'_> {
    /// Asks for an output and puts it into the node's list.
    fn made(&mut self, kind: Kind, output: u32, write: impl FnOnce(&mut Writer<'_>)) -> Status {
        let (status, made) = self.lane.ask(kind, write, |reader| {
            let status = reader.i32().unwrap_or(abi::STATUS_ERROR);
            (status, reader.frame().unwrap_or(Frame::EMPTY))
        });
        if status != abi::STATUS_OK || output as usize >= self.outputs_len {
            return status;
        }
        let data = pools::resolve(made.buffer);
        if data.is_null() {
            return abi::STATUS_EXHAUSTED;
        }
        // SAFETY: `outputs` holds `outputs_len` frames for the length of the call.
        unsafe { self.outputs.add(output as usize).write(Frame { data, ..made }) };
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
    call.made(Kind::Alloc, output, |out| {
        out.u32(output).u32(format).u32(width).u32(height).u32(stride_bytes).u64(len as u64);
    })
}

unsafe extern "C" fn forward(call: *mut c_void, output: u32, given: *const Frame) -> Status {
    // SAFETY: see `frame`; the frame is read for the length of this function.
    let (Some(call), Some(given)) = (unsafe { (frame(call), given.as_ref()) }) else { return abi::STATUS_INVALID };
    let is_buffer = !given.data.is_null() && pools::resolve(given.buffer) == given.data;
    call.made(Kind::Forward, output, |out| _ = out.u32(output).u32(u32::from(is_buffer)).frame(given))
}

unsafe extern "C" fn make_mut(call: *mut c_void, output: u32) -> Status {
    // SAFETY: see `frame`.
    let Some(call) = (unsafe { frame(call) }) else { return abi::STATUS_INVALID };
    call.made(Kind::MakeMut, output, |out| _ = out.u32(output))
}

fn count(buffer: BufferId, retained: bool) {
    // SAFETY: set by `within` for no longer than the lane lives.
    match unsafe { current_lane().as_ref() } {
        Some(lane) => {
            let kind = if retained { Kind::Retain } else { Kind::Release };
            lane.tell(kind, |out| _ = out.buffer(buffer));
        }
        None => lock(&LATER).push((buffer, retained)),
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
        call.lane.tell(Kind::Log, |out| _ = out.u32(level).bytes(message));
    }
}

unsafe extern "C" fn fail(call: *mut c_void, message: Str) {
    // SAFETY: see `frame` and `bytes`.
    if let (Some(call), message) = unsafe { (frame(call), bytes(message)) } {
        call.lane.tell(Kind::Fail, |out| _ = out.bytes(message));
    }
}

unsafe extern "C" fn metric(call: *mut c_void, name: Str, value: f64) {
    // SAFETY: see `frame` and `bytes`.
    if let (Some(call), name) = unsafe { (frame(call), bytes(name)) } {
        call.lane.tell(Kind::Metric, |out| _ = out.bytes(name).f64(value));
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
    // SAFETY: the sink is the lane, see `save_target`; the bytes are lent for the call.
    let (lane, bytes) = unsafe {
        let bytes = if len == 0 { &[][..] } else { std::slice::from_raw_parts(bytes, len) };
        (sink.cast::<ChildLane>().as_ref(), bytes)
    };
    if let Some(lane) = lane {
        bytes.chunks(MOST_STATE).for_each(|part| lane.tell(Kind::Save, |out| _ = out.bytes(part)));
    }
}

/// The sink for [`Host::save`] in calls of a lane.
pub(super) fn save_target(lane: &ChildLane) -> *mut c_void {
    std::ptr::from_ref(lane).cast_mut().cast()
}

unsafe extern "C" fn claim_file(call: *mut c_void, path: Str, action: u32, file: *mut Str) -> Status {
    // SAFETY: see `frame`; the plugin lends the text for the length of the call.
    let (Some(call), Some(path)) = (unsafe { (frame(call), path.text()) }) else { return abi::STATUS_INVALID };
    let (status, answer) = call.lane.ask(
        Kind::ClaimFile,
        |out| _ = out.u32(action).bytes(path.as_bytes()),
        |reader| {
            let status = reader.i32().unwrap_or(abi::STATUS_ERROR);
            (status, reader.text().unwrap_or("").to_owned())
        },
    );
    call.file = answer;
    // SAFETY: null or a place for the answer, which stays as it is until the next claim of this call.
    if let Some(file) = unsafe { file.as_mut() } {
        *file = Str::borrow(&call.file);
    }
    status
}

unsafe fn number(call: *mut c_void, kind: Kind, write: impl FnOnce(&mut Writer<'_>), otherwise: i64) -> i64 {
    // SAFETY: see `frame`.
    let call = unsafe { frame(call) };
    call.map_or(otherwise, |call| call.lane.ask(kind, write, |reader| reader.i64().unwrap_or(otherwise)))
}

unsafe extern "C" fn clock_ns(call: *mut c_void) -> i64 {
    // SAFETY: see `frame`.
    unsafe { number(call, Kind::Clock, |_| (), 0) }
}

unsafe extern "C" fn set_arrived_ns(call: *mut c_void, arrived_ns: i64) {
    // SAFETY: see `frame`.
    if let Some(call) = unsafe { frame(call) } {
        call.lane.tell(Kind::SetArrived, |out| _ = out.i64(arrived_ns));
    }
}

unsafe extern "C" fn arrived_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: see `frame`.
    unsafe { number(call, Kind::Arrived, |out| _ = out.u32(input), i64::MIN) }
}

unsafe extern "C" fn age_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: see `frame`.
    unsafe { number(call, Kind::Age, |out| _ = out.u32(input), i64::MAX) }
}

unsafe extern "C" fn set_lag_ns(call: *mut c_void, lag_ns: i64) {
    // SAFETY: see `frame`.
    if let Some(call) = unsafe { frame(call) } {
        call.lane.tell(Kind::SetLag, |out| _ = out.i64(lag_ns));
    }
}

/// The table that plugins in the child get.
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
    }
}
