//! A host for one node in a test: implements every function of the ABI.

use std::ffi::c_void;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use panoscope_base::format;
use panoscope_base::random::SplitMix64;

use crate::abi::{self, BufferId, Frame, Status, Str, Tick};

use super::files::Files;
use super::{Level, LogLine, Metric, Setup};
use super::{memory, on_device};

/// The state of a running call; the call's handle points to it.
pub(super) struct CallState {
    pub(super) pool: u32,
    /// The call's outputs, shared with the node.
    pub(super) outputs: *mut Frame,
    pub(super) outputs_len: usize,
    /// Bit set of the formats that each output may have; 0 allows all.
    pub(super) formats: Vec<u32>,
    pub(super) random: Mutex<SplitMix64>,
    pub(super) reported: Mutex<Reported>,
    /// The run's file claims and the node's name; `None` while inputs are made.
    pub(super) files: Option<(Files, String)>,
    /// The last text that `claim_file` returned; lent to the node until the next call of it.
    pub(super) claimed: Mutex<String>,
    pub(super) times: Times,
}

/// Times of a call, in ns of the harness's clock.
#[derive(Default)]
pub(super) struct Times {
    /// The call.
    pub(super) now_ns: i64,
    /// Arrival of the tick.
    pub(super) tick_ns: i64,
    /// Arrival of each input frame; `i64::MIN` for an empty one.
    pub(super) arrived_ns: Vec<i64>,
    pub(super) set: Mutex<SetTimes>,
}

impl Times {
    fn of(&self, input: u32) -> Option<i64> {
        let known = if input == abi::INPUT_TICK { Some(&self.tick_ns) } else { self.arrived_ns.get(input as usize) };
        known.copied().filter(|&ns| ns != i64::MIN)
    }
}

/// Times that the node set during a call.
#[derive(Clone, Copy, Default)]
pub(super) struct SetTimes {
    pub(super) arrived_ns: Option<i64>,
    pub(super) lag_ns: Option<i64>,
}

/// Reports of a node to the host.
#[derive(Default)]
pub(super) struct Reported {
    pub(super) logs: Vec<LogLine>,
    pub(super) metrics: Vec<Metric>,
    pub(super) failure: Option<String>,
    pub(super) copies: u64,
    pub(super) allocated_bytes: u64,
    /// The first violation of the ABI.
    pub(super) problem: Option<String>,
}

impl CallState {
    pub(super) fn new(pool: u32, outputs: &mut [Frame], formats: Vec<u32>, seed: u64) -> Self {
        Self {
            pool,
            outputs: outputs.as_mut_ptr(),
            outputs_len: outputs.len(),
            formats,
            random: Mutex::new(SplitMix64(seed)),
            reported: Mutex::default(),
            files: None,
            claimed: Mutex::default(),
            times: Times::default(),
        }
    }

    pub(super) fn in_run(mut self, setup: &Setup) -> Self {
        self.files = Some((setup.files.clone(), setup.node_id.clone()));
        self
    }

    pub(super) fn set_times(&self) -> SetTimes {
        *self.times.set.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    pub(super) fn into_reported(self) -> Reported {
        self.reported.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// # Safety
    /// `call` is the handle of the running call.
    unsafe fn of<'a>(call: *mut c_void) -> Option<&'a CallState> {
        // SAFETY: the caller passes the handle of the running call, whose state lives until the call returns; null gives `None`.
        unsafe { call.cast::<CallState>().as_ref() }
    }

    fn reported(&self) -> std::sync::MutexGuard<'_, Reported> {
        self.reported.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Records a violation of the ABI and returns the status for it.
    fn violation(&self, problem: String) -> Status {
        self.reported().problem.get_or_insert(problem);
        abi::STATUS_INVALID
    }

    fn output(&self, index: u32) -> Option<*mut Frame> {
        // SAFETY: the index is below the number of outputs, which `new` took from a slice.
        ((index as usize) < self.outputs_len).then(|| unsafe { self.outputs.add(index as usize) })
    }

    /// Replaces output `slot` and releases the frame that it held.
    fn put(&self, slot: *mut Frame, frame: Frame) {
        // SAFETY: `slot` points into the call's outputs, which live as long as the call; nobody holds a reference to them.
        let old = unsafe { slot.replace(frame) };
        if !old.is_empty() {
            memory::release(old.buffer);
        }
    }
}

/// A call without frames or parameters.
pub(super) fn bare_call(host: &abi::Host, state: &mut CallState, tick: Tick) -> abi::Call {
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

/// The function table for calls of one harness; loops run on `threads` threads.
pub(super) fn table(threads: usize) -> Box<abi::Host> {
    Box::new(abi::Host {
        struct_size: size_of::<abi::Host>() as u32,
        abi_major: abi::ABI_MAJOR,
        abi_minor: abi::ABI_MINOR,
        threads: threads as u32,
        // The number of threads itself: `parallel_for` needs nothing else of its harness.
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
        set_arrived_ns: Some(set_arrived_ns),
        arrived_ns: Some(arrived_ns),
        age_ns: Some(age_ns),
        set_lag_ns: Some(set_lag_ns),
        device: Some(on_device::device),
        device_buffer: Some(on_device::device_buffer),
        alloc_on_device: Some(alloc_on_device),
        fetch: Some(on_device::fetch),
    })
}

/// The function table outside calls; one for the whole process.
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
    // SAFETY: the ABI requires the node to pass the handle of its running call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return abi::STATUS_INVALID };
    let Some(slot) = state.output(output) else {
        return state.violation(format!("it made output {output}, there are {}", state.outputs_len));
    };
    let allowed = state.formats[output as usize];
    if allowed != 0 && (format > 31 || allowed & abi::format_bit(format) == 0) {
        return state.violation(format!("output {output} was made with format {format}, which it does not declare"));
    }
    let Some(known) = format::of(format) else {
        return state.violation(format!("format {format} does not exist"));
    };
    if format != abi::FORMAT_BYTES {
        let (columns, rows, stride) = (width as usize, height as usize, stride_bytes as usize);
        let need = format::image_bytes(columns, rows, stride, known.pixel_bytes());
        let Some(need) = need.filter(|_| width > 0 && height > 0) else {
            return state.violation(format!("output {output}: {width}x{height} with {stride_bytes} bytes a row"));
        };
        if len < need {
            return state.violation(format!("output {output}: {len} bytes are too few for {width}x{height}"));
        }
    }
    let Some((buffer, data)) = memory::allocate(state.pool, len) else { return abi::STATUS_EXHAUSTED };
    state.reported().allocated_bytes += len as u64;
    state.put(slot, Frame { buffer, data, len, format, width, height, stride_bytes, ..Frame::EMPTY });
    abi::STATUS_OK
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
    // SAFETY: the caller's promise is that of `alloc`.
    let status = unsafe { alloc(call, output, format, width, height, stride_bytes, len) };
    // SAFETY: the ABI requires the handle of the running call, and null or a place for the buffer.
    let (Some(state), Some(place)) = (unsafe { (CallState::of(call), buffer.as_mut()) }) else {
        return abi::STATUS_INVALID;
    };
    let Some(slot) = state.output(output).filter(|_| status == abi::STATUS_OK) else { return status };
    // SAFETY: `output` returns a pointer into the call's outputs, which live as long as the call.
    let made = unsafe { &mut *slot };
    let Some(handle) = on_device::make(made, Some(len)) else { return abi::STATUS_ERROR };
    *place = handle;
    made.buffer.home = abi::HOME_DEVICE;
    abi::STATUS_OK
}

unsafe extern "C" fn forward(call: *mut c_void, output: u32, frame: *const Frame) -> Status {
    // SAFETY: the ABI requires the node to pass the handle of its running call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return abi::STATUS_INVALID };
    // SAFETY: the ABI requires null or a pointer to a readable frame.
    let Some(frame) = (unsafe { frame.as_ref() }) else {
        return state.violation("it forwarded a null frame".to_owned());
    };
    let Some(slot) = state.output(output) else {
        return state.violation(format!("it made output {output}, there are {}", state.outputs_len));
    };
    let frame = *frame;
    if frame.is_empty() {
        state.put(slot, Frame::EMPTY);
        return abi::STATUS_OK;
    }
    if frame.buffer.pool != state.pool || !memory::retain(frame.buffer) {
        return state.violation(format!("output {output}: it forwarded a buffer that it does not hold"));
    }
    state.put(slot, Frame { data: memory::resolve(frame.buffer), ..frame });
    abi::STATUS_OK
}

unsafe extern "C" fn make_mut(call: *mut c_void, output: u32) -> Status {
    // SAFETY: the ABI requires the node to pass the handle of its running call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return abi::STATUS_INVALID };
    let Some(slot) = state.output(output) else {
        return state.violation(format!("it asked to write output {output}, there are {}", state.outputs_len));
    };
    // SAFETY: `output` returns a pointer into the call's outputs, which live as long as the call.
    let frame = unsafe { slot.read() };
    if frame.is_empty() {
        return state.violation(format!("it asked to write output {output}, which is empty"));
    }
    if memory::holders(frame.buffer) == 1 {
        return abi::STATUS_OK;
    }
    // SAFETY: the output holds a reference to the buffer, so its `len` bytes are readable.
    let bytes = unsafe { std::slice::from_raw_parts(memory::resolve(frame.buffer), frame.len) };
    let Some(copy) = memory::store(state.pool, bytes, frame) else { return abi::STATUS_EXHAUSTED };
    state.reported().copies += 1;
    state.put(slot, copy);
    abi::STATUS_OK
}

unsafe extern "C" fn retain(_: *mut c_void, buffer: BufferId) {
    if !memory::retain(buffer) {
        memory::record_violation(buffer.pool, "it retained a buffer that is gone".to_owned());
    }
}

unsafe extern "C" fn release(_: *mut c_void, buffer: BufferId) {
    memory::release(buffer);
}

unsafe extern "C" fn resolve(_: *mut c_void, buffer: BufferId) -> *mut u8 {
    memory::resolve(buffer)
}

/// The pointer that a node passes to the chunks of its loop.
#[derive(Clone, Copy)]
struct NodePointer(*mut c_void);
// SAFETY: the ABI requires the node to allow its chunks on any thread.
unsafe impl Send for NodePointer {}
// SAFETY: the ABI requires the node to allow its chunks on several threads at once.
unsafe impl Sync for NodePointer {}

unsafe extern "C" fn parallel_for(ctx: *mut c_void, chunks: usize, body: abi::ChunkFn, data: *mut c_void) -> Status {
    let Some(body) = body else { return abi::STATUS_INVALID };
    let helpers = ctx.addr().min(chunks).saturating_sub(1);
    let next = AtomicUsize::new(0);
    let data = NodePointer(data);
    let work = || {
        // Borrows the whole wrapper, not only its pointer, so that the closure is `Send`.
        let data = &data;
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= chunks {
                return;
            }
            // SAFETY: the node's function is called with the node's pointer, once per index, and all calls end before this function returns.
            unsafe { body(data.0, index) };
        }
    };
    std::thread::scope(|scope| {
        (0..helpers).for_each(|_| drop(scope.spawn(work)));
        work();
    });
    abi::STATUS_OK
}

unsafe fn text_of(text: Str) -> String {
    // SAFETY: the ABI requires a text to be readable until the function that takes it returns.
    String::from_utf8_lossy(unsafe { text.bytes() }).into_owned()
}

unsafe extern "C" fn log(call: *mut c_void, level: u32, message: Str) {
    // SAFETY: the ABI requires the handle of the running call and a text that is readable until this function returns.
    unsafe {
        let Some(state) = CallState::of(call) else { return };
        let level = match level {
            abi::LOG_ERROR => Level::Error,
            abi::LOG_WARN => Level::Warn,
            abi::LOG_INFO => Level::Info,
            abi::LOG_DEBUG => Level::Debug,
            other => {
                state.violation(format!("it wrote a log line of level {other}"));
                return;
            }
        };
        state.reported().logs.push(LogLine { level, message: text_of(message) });
    }
}

unsafe extern "C" fn fail(call: *mut c_void, message: Str) {
    // SAFETY: the ABI requires the handle of the running call and a text that is readable until this function returns.
    unsafe {
        if let Some(state) = CallState::of(call) {
            state.reported().failure = Some(text_of(message));
        }
    }
}

unsafe extern "C" fn metric(call: *mut c_void, name: Str, value: f64) {
    // SAFETY: the ABI requires the handle of the running call and a text that is readable until this function returns.
    unsafe {
        if let Some(state) = CallState::of(call) {
            state.reported().metrics.push(Metric { name: text_of(name), value });
        }
    }
}

unsafe extern "C" fn random(call: *mut c_void) -> u64 {
    // SAFETY: the ABI requires the node to pass the handle of its running call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return 0 };
    state.random.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).bits()
}

unsafe extern "C" fn save(sink: *mut c_void, bytes: *const u8, len: usize) {
    if sink.is_null() || (bytes.is_null() && len > 0) {
        return;
    }
    // SAFETY: the node passes on the `sink` that it got from `Harness::save_state`, and `len` readable bytes.
    unsafe {
        let sink = &mut *sink.cast::<Option<Vec<u8>>>();
        let bytes = if len == 0 { &[] } else { std::slice::from_raw_parts(bytes, len) };
        sink.get_or_insert_default().extend_from_slice(bytes);
    }
}

unsafe extern "C" fn claim_file(call: *mut c_void, path: Str, action: u32, file: *mut Str) -> Status {
    // SAFETY: the ABI requires the handle of the running call, a readable text, and null or a writable `file`.
    unsafe {
        let Some(state) = CallState::of(call) else { return abi::STATUS_INVALID };
        if file.is_null() || action > abi::CLAIM_BEGIN_NEW {
            return state.violation(format!("it claimed a file with action {action}"));
        }
        let Some((files, node)) = &state.files else { return abi::STATUS_INVALID };
        let (status, text) = match files.claim(node, &text_of(path), action) {
            Ok(path) => (abi::STATUS_OK, path),
            Err(taken) => (abi::STATUS_INVALID, taken.holder),
        };
        let mut claimed = state.claimed.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        *claimed = text;
        *file = Str::borrow(&claimed);
        status
    }
}

fn clock_now_ns() -> i64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    let start = START.get_or_init(std::time::Instant::now);
    i64::try_from(start.elapsed().as_nanos()).unwrap_or(i64::MAX)
}

unsafe extern "C" fn clock_ns(_: *mut c_void) -> i64 {
    clock_now_ns()
}

unsafe extern "C" fn set_arrived_ns(call: *mut c_void, arrived_ns: i64) {
    // SAFETY: the ABI requires the node to pass the handle of its running call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return };
    let mut set = state.times.set.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    set.arrived_ns = Some(arrived_ns.min(clock_now_ns()));
}

unsafe extern "C" fn set_lag_ns(call: *mut c_void, lag_ns: i64) {
    // SAFETY: the ABI requires the node to pass the handle of its running call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return };
    state.times.set.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).lag_ns = Some(lag_ns.max(0));
}

unsafe extern "C" fn arrived_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: the ABI requires the node to pass the handle of its running call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return i64::MIN };
    state.times.of(input).unwrap_or(i64::MIN)
}

unsafe extern "C" fn age_ns(call: *mut c_void, input: u32) -> i64 {
    // SAFETY: the ABI requires the node to pass the handle of its running call.
    let Some(state) = (unsafe { CallState::of(call) }) else { return i64::MAX };
    let arrived_ns = state.times.of(input);
    arrived_ns.map_or(i64::MAX, |arrived_ns| state.times.now_ns.saturating_sub(arrived_ns).max(0))
}
