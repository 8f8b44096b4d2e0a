//! The contract's host for one node in one process: every function, nothing faked.

use std::ffi::c_void;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use panoscope_base::format;
use panoscope_base::random::SplitMix64;

use crate::abi::{self, BufferId, Frame, Status, Str};

use super::files::Files;
use super::memory;
use super::{Level, LogLine, Metric};

/// What a running call's handle points to.
pub(super) struct CallState {
    pub(super) pool: u32,
    /// The call's outputs; the node reads the same memory.
    pub(super) outputs: *mut Frame,
    pub(super) outputs_len: usize,
    /// Bit set of formats that each output may have, and whether formats are checked.
    pub(super) formats: Vec<u32>,
    pub(super) random: Mutex<SplitMix64>,
    pub(super) said: Mutex<Said>,
    /// The run's files and the node's name; none while inputs are made.
    pub(super) files: Option<(Files, String)>,
    /// The last answer of `claim_file`, lent to the node.
    pub(super) answer: Mutex<String>,
}

/// What a node told the host.
#[derive(Default)]
pub(super) struct Said {
    pub(super) logs: Vec<LogLine>,
    pub(super) metrics: Vec<Metric>,
    pub(super) failure: Option<String>,
    pub(super) copies: u64,
    pub(super) allocated_bytes: u64,
    pub(super) problem: Option<String>,
}

impl CallState {
    /// # Safety
    /// `call` is the handle of the running call.
    unsafe fn of<'a>(call: *mut c_void) -> Option<&'a CallState> {
        // SAFETY: the caller's promise; null is answered with `None`.
        unsafe { call.cast::<CallState>().as_ref() }
    }

    fn said(&self) -> std::sync::MutexGuard<'_, Said> {
        self.said.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    fn blame(&self, problem: String) -> Status {
        self.said().problem.get_or_insert(problem);
        abi::STATUS_INVALID
    }

    fn output(&self, index: u32) -> Option<*mut Frame> {
        // SAFETY: inside the call's outputs.
        ((index as usize) < self.outputs_len).then(|| unsafe { self.outputs.add(index as usize) })
    }

    /// Replaces output `slot`, giving up what stood there.
    fn put(&self, slot: *mut Frame, frame: Frame) {
        // SAFETY: `slot` points into the call's outputs, which live as long as the call; no reference to them is held.
        let old = unsafe { slot.replace(frame) };
        if !old.is_empty() {
            memory::release(old.buffer);
        }
    }
}

/// The table that a harness passes in its calls; `threads` take part in loops.
pub(super) fn table(threads: usize) -> Box<abi::Host> {
    Box::new(abi::Host {
        struct_size: size_of::<abi::Host>() as u32,
        abi_major: abi::ABI_MAJOR,
        abi_minor: abi::ABI_MINOR,
        threads: threads as u32,
        // The number itself: what `parallel_for` needs to know of its harness.
        ctx: std::ptr::without_provenance_mut(threads),
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
    })
}

/// The table for functions that need no running call; the same for the whole process.
pub(super) fn attached() -> &'static abi::Host {
    static TABLE: std::sync::OnceLock<Box<abi::Host>> = std::sync::OnceLock::new();
    TABLE.get_or_init(|| table(1))
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
    // SAFETY: the node passes the handle of its call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return abi::STATUS_INVALID };
    let Some(slot) = state.output(output) else {
        return state.blame(format!("it made output {output}, there are {}", state.outputs_len));
    };
    let allowed = state.formats[output as usize];
    if allowed != 0 && (format > 31 || allowed & abi::format_bit(format) == 0) {
        return state.blame(format!("output {output} was made with format {format}, which it does not declare"));
    }
    let Some(known) = format::of(format) else {
        return state.blame(format!("format {format} does not exist"));
    };
    if format != abi::FORMAT_BYTES {
        let (columns, rows, stride) = (width as usize, height as usize, stride_bytes as usize);
        let need = format::image_bytes(columns, rows, stride, known.pixel_bytes());
        let Some(need) = need.filter(|_| width > 0 && height > 0) else {
            return state.blame(format!("output {output}: {width}x{height} with {stride_bytes} bytes a row"));
        };
        if len < need {
            return state.blame(format!("output {output}: {len} bytes are too few for {width}x{height}"));
        }
    }
    let Some((buffer, data)) = memory::allocate(state.pool, len) else { return abi::STATUS_EXHAUSTED };
    state.said().allocated_bytes += len as u64;
    state.put(slot, Frame { buffer, data, len, format, width, height, stride_bytes, ..Frame::EMPTY });
    abi::STATUS_OK
}

unsafe extern "C" fn forward(call: *mut c_void, output: u32, frame: *const Frame) -> Status {
    // SAFETY: the node passes the handle of its call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return abi::STATUS_INVALID };
    // SAFETY: null, or a frame of the node's.
    let Some(frame) = (unsafe { frame.as_ref() }) else {
        return state.blame("it forwarded a null frame".to_owned());
    };
    let Some(slot) = state.output(output) else {
        return state.blame(format!("it made output {output}, there are {}", state.outputs_len));
    };
    let frame = *frame;
    if frame.is_empty() {
        state.put(slot, Frame::EMPTY);
        return abi::STATUS_OK;
    }
    if frame.buffer.pool != state.pool || !memory::retain(frame.buffer) {
        return state.blame(format!("output {output}: it forwarded a buffer that it does not hold"));
    }
    state.put(slot, Frame { data: memory::resolve(frame.buffer), ..frame });
    abi::STATUS_OK
}

unsafe extern "C" fn make_mut(call: *mut c_void, output: u32) -> Status {
    // SAFETY: the node passes the handle of its call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return abi::STATUS_INVALID };
    let Some(slot) = state.output(output) else {
        return state.blame(format!("it asked to write output {output}, there are {}", state.outputs_len));
    };
    // SAFETY: inside the call's outputs.
    let frame = unsafe { slot.read() };
    if frame.is_empty() {
        return state.blame(format!("it asked to write output {output}, which is empty"));
    }
    if memory::holders(frame.buffer) == 1 {
        return abi::STATUS_OK;
    }
    // SAFETY: the output holds the buffer, so its bytes are there.
    let bytes = unsafe { std::slice::from_raw_parts(memory::resolve(frame.buffer), frame.len) };
    let Some(copy) = memory::store(state.pool, bytes, frame) else { return abi::STATUS_EXHAUSTED };
    state.said().copies += 1;
    state.put(slot, copy);
    abi::STATUS_OK
}

unsafe extern "C" fn retain(_: *mut c_void, buffer: BufferId) {
    if !memory::retain(buffer) {
        memory::blame(buffer.pool, "it retained a buffer that is gone".to_owned());
    }
}

unsafe extern "C" fn release(_: *mut c_void, buffer: BufferId) {
    memory::release(buffer);
}

unsafe extern "C" fn resolve(_: *mut c_void, buffer: BufferId) -> *mut u8 {
    memory::resolve(buffer)
}

/// The node's pointer, shared by the threads of its loop.
#[derive(Clone, Copy)]
struct Data(*mut c_void);
// SAFETY: the contract lets chunks run on any thread.
unsafe impl Send for Data {}
// SAFETY: the pointer is only copied; chunks may run on any thread by the contract, and the node shares what it points to.
unsafe impl Sync for Data {}

unsafe extern "C" fn parallel_for(ctx: *mut c_void, chunks: usize, body: abi::ChunkFn, data: *mut c_void) -> Status {
    let Some(body) = body else { return abi::STATUS_INVALID };
    let helpers = ctx.addr().min(chunks).saturating_sub(1);
    let next = AtomicUsize::new(0);
    let data = Data(data);
    let work = || {
        // The whole wrapper is borrowed, not its pointer alone, so that the closure may go to another thread.
        let data = &data;
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= chunks {
                return;
            }
            // SAFETY: the node's function with the node's pointer, each index once, all done before this function returns.
            unsafe { body(data.0, index) };
        }
    };
    std::thread::scope(|scope| {
        (0..helpers).for_each(|_| drop(scope.spawn(work)));
        work();
    });
    abi::STATUS_OK
}

unsafe fn words(text: Str) -> String {
    // SAFETY: the node's text is valid for the length of the function that takes it.
    String::from_utf8_lossy(unsafe { text.bytes() }).into_owned()
}

unsafe extern "C" fn log(call: *mut c_void, level: u32, message: Str) {
    // SAFETY: the node passes the handle of its call and a text valid for this function.
    unsafe {
        let Some(state) = CallState::of(call) else { return };
        let level = match level {
            abi::LOG_ERROR => Level::Error,
            abi::LOG_WARN => Level::Warn,
            abi::LOG_INFO => Level::Info,
            abi::LOG_DEBUG => Level::Debug,
            other => {
                state.blame(format!("it wrote a log line of level {other}"));
                return;
            }
        };
        state.said().logs.push(LogLine { level, message: words(message) });
    }
}

unsafe extern "C" fn fail(call: *mut c_void, message: Str) {
    // SAFETY: the node passes the handle of its call and a text valid for this function.
    unsafe {
        if let Some(state) = CallState::of(call) {
            state.said().failure = Some(words(message));
        }
    }
}

unsafe extern "C" fn metric(call: *mut c_void, name: Str, value: f64) {
    // SAFETY: the node passes the handle of its call and a text valid for this function.
    unsafe {
        if let Some(state) = CallState::of(call) {
            state.said().metrics.push(Metric { name: words(name), value });
        }
    }
}

unsafe extern "C" fn random(call: *mut c_void) -> u64 {
    // SAFETY: the node passes the handle of its call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return 0 };
    state.random.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).bits()
}

unsafe extern "C" fn save(sink: *mut c_void, bytes: *const u8, len: usize) {
    if sink.is_null() || (bytes.is_null() && len > 0) {
        return;
    }
    // SAFETY: `sink` is the vector that `Harness::save_state` passed; `bytes` is valid for `len`.
    unsafe {
        let sink = &mut *sink.cast::<Option<Vec<u8>>>();
        let bytes = if len == 0 { &[] } else { std::slice::from_raw_parts(bytes, len) };
        sink.get_or_insert_default().extend_from_slice(bytes);
    }
}

unsafe extern "C" fn claim_file(call: *mut c_void, path: Str, action: u32, file: *mut Str) -> Status {
    // SAFETY: the node passes the handle of its call, a text valid for this function and a place for the answer.
    unsafe {
        let Some(state) = CallState::of(call) else { return abi::STATUS_INVALID };
        if file.is_null() || action > abi::CLAIM_BEGIN_NEW {
            return state.blame(format!("it claimed a file with action {action}"));
        }
        let Some((files, node)) = &state.files else { return abi::STATUS_INVALID };
        let (status, text) = match files.claim(node, &words(path), action) {
            Ok(path) => (abi::STATUS_OK, path),
            Err(other) => (abi::STATUS_INVALID, other),
        };
        let mut answer = state.answer.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        *answer = text;
        *file = Str::borrow(&answer);
        status
    }
}

unsafe extern "C" fn clock_ns(_: *mut c_void) -> i64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    let start = START.get_or_init(std::time::Instant::now);
    i64::try_from(start.elapsed().as_nanos()).unwrap_or(i64::MAX)
}
