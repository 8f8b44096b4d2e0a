//! The functions that the host offers to plugins.

mod times;

use std::ffi::c_void;
use std::path::Path;

use panoscope_abi::{self as abi, BufferId, ChunkFn, Frame, Host, Status, Str};
use panoscope_base::random::SplitMix64;

use crate::claims::{Claimed, Holds};
use crate::clock;
use crate::exec::CallTimes;
use crate::fault::Cause;
use crate::light::{Sources, is_same, later};
use crate::log::Level;
use crate::memory::{FrameRef, Memory, MemoryError, device_table, memory};
use crate::node::NodeRuntime;
use crate::outputs;
use crate::pool;
use crate::retained;
use crate::run_context::RunContext;
use crate::sync::lock;

/// A request of a node that the host refused.
pub(crate) type Refused = Box<(Cause, String)>;

/// The target of a `call` handle.
pub(crate) struct CallContext<'a> {
    /// Output frames of the running call; each frame that is not empty holds a reference. The node sees only a copy.
    pub outputs: *mut Frame,
    /// The copy that the node sees.
    pub shown: *mut Frame,
    pub outputs_len: usize,
    pub inputs: *const Frame,
    pub inputs_len: usize,
    /// An output forwarded from an input whose reference it takes over when the call ends. Until then it holds none.
    pub lent: Option<Lent>,
    /// Formats of the first output, one bit each.
    pub first_formats: u32,
    pub runtime: &'a NodeRuntime,
    /// Files that the instance claims.
    pub holds: &'a Holds,
    /// Outputs whose buffer the node could write in this call, one bit each; the last bit stands for all further ones.
    pub written: u64,
    /// The node's error message; the buffer is reused.
    pub failure: &'a mut String,
    /// Whether the node reported a fault during this call.
    pub has_failure: bool,
    /// A request that the host refused during this call, if any.
    pub refused: Option<Refused>,
    /// State of the generator; `None` until the node asks for a number.
    pub random: Option<SplitMix64>,
    pub tick: abi::Tick,
    pub context: &'a RunContext,
    /// The sources of the graph; none in calls that have no tick.
    pub sources: Option<&'a dyn Sources>,
    /// Questions and declarations of the node about times; none in calls that have no tick.
    pub times: Option<&'a mut CallTimes>,
    /// Whether `times` was used in this call.
    pub has_times: bool,
    /// Whether the call opens a node on trial, whose log lines are left out.
    pub is_trial: bool,
}

/// The bit of an output in [`CallContext::written`].
#[inline]
pub(crate) fn output_bit(output: u32) -> u64 {
    1 << output.min(63)
}

/// See [`CallContext::lent`].
#[derive(Clone, Copy)]
pub(crate) struct Lent {
    pub output: u32,
    pub input: u32,
}

pub(crate) unsafe fn call_context<'a>(call: *mut c_void) -> Option<&'a mut CallContext<'a>> {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    unsafe { call.cast::<CallContext<'a>>().as_mut() }
}

impl<'a> CallContext<'a> {
    /// For a call other than `process`: no inputs, no outputs.
    pub fn without_tick(
        runtime: &'a NodeRuntime,
        context: &'a RunContext,
        holds: &'a Holds,
        failure: &'a mut String,
    ) -> Self {
        Self {
            outputs: std::ptr::null_mut(),
            shown: std::ptr::null_mut(),
            outputs_len: 0,
            inputs: std::ptr::null(),
            inputs_len: 0,
            lent: None,
            first_formats: 0,
            runtime,
            holds,
            written: 0,
            failure,
            has_failure: false,
            refused: None,
            random: None,
            tick: abi::Tick::default(),
            context,
            sources: None,
            times: None,
            has_times: false,
            is_trial: false,
        }
    }
}

impl CallContext<'_> {
    fn output(&mut self, index: u32) -> Option<&mut Frame> {
        // SAFETY: `outputs` holds `outputs_len` frames for the length of the call.
        ((index as usize) < self.outputs_len).then(|| unsafe { &mut *self.outputs.add(index as usize) })
    }

    /// Makes a frame an output of this tick and takes over the caller's reference.
    fn place(&mut self, index: u32, frame: &Frame) -> Status {
        let held = self.lent.take_if(|lent| lent.output == index).is_none();
        match self.output(index) {
            Some(slot) => {
                if held && !slot.is_empty() {
                    // SAFETY: an output that is not lent holds a reference, which `write` below forgets.
                    drop(unsafe { FrameRef::adopt(*slot) });
                }
                self.write(index, frame);
                abi::STATUS_OK
            }
            None => {
                // SAFETY: the caller hands over a reference.
                drop(unsafe { FrameRef::adopt(*frame) });
                abi::STATUS_INVALID
            }
        }
    }

    /// Writes the description of an output that exists. `frame.tick.flags` is its own lag behind the tick.
    #[inline]
    fn write(&mut self, index: u32, frame: &Frame) {
        // SAFETY: `shown` and `outputs` hold `outputs_len` frames each, more than `index` (the callers' promise).
        let (slot, shown) = unsafe { (&mut *self.outputs.add(index as usize), &mut *self.shown.add(index as usize)) };
        let tick = abi::Tick { flags: later(self.tick.flags, frame.tick.flags), ..self.tick };
        *slot = *frame;
        slot.tick = tick;
        *shown = *frame;
        shown.tick = tick;
    }

    /// Says where the content of an output is.
    fn set_home(&mut self, index: u32, home: u32) {
        if (index as usize) < self.outputs_len {
            // SAFETY: `shown` and `outputs` hold `outputs_len` frames each.
            unsafe {
                (*self.outputs.add(index as usize)).buffer.home = home;
                (*self.shown.add(index as usize)).buffer.home = home;
            }
        }
    }

    /// Lag of a forwarded frame: one that was made at another tick, such as a retained one, keeps the age of its light.
    #[inline]
    fn lag_of(&self, tick: &abi::Tick) -> u32 {
        if is_same(tick, &self.tick) { 0 } else { self.lag_behind(tick) }
    }

    /// Whether output `index` may be a frame of this description.
    #[inline]
    fn accepts(&self, index: u32, frame: &Frame) -> bool {
        let formats = if index == 0 { self.first_formats } else { self.runtime.rules[index as usize].formats() };
        outputs::fits(formats, frame)
    }

    #[cold]
    fn object(&mut self, index: u32, frame: &Frame) -> Status {
        let (cause, words) = self.runtime.rules[index as usize].objection(frame);
        self.refuse(cause, words)
    }

    #[cold]
    fn refuse(&mut self, cause: Cause, words: String) -> Status {
        self.refused.get_or_insert_with(|| Box::new((cause, words)));
        abi::STATUS_INVALID
    }

    /// The index of a frame among the inputs, if it is one.
    #[inline]
    fn input(&self, frame: &Frame) -> Option<u32> {
        (0..self.inputs_len).find_map(|index| {
            // SAFETY: `inputs` holds `inputs_len` frames for the length of the call.
            let input = unsafe { &*self.inputs.add(index) };
            let same = input.buffer == frame.buffer && input.data == frame.data && frame.len <= input.len;
            (same && !input.is_empty()).then_some(index as u32)
        })
    }

    fn allocate(&self, len: usize) -> Result<(BufferId, *mut u8), Status> {
        // In batch a tick waits for frame memory, in live it is dropped.
        let mut patience_ms = if self.context.ignores_wall_clock() { 5_000 } else { 0 };
        loop {
            let made = match self.runtime.domain() {
                None => memory().allocate(len),
                Some(domain) => memory().allocate_in(domain, len),
            };
            match made {
                Ok(buffer) => return Ok(buffer),
                Err(MemoryError::Exhausted { .. }) if patience_ms > 0 => {
                    patience_ms -= 1;
                    std::thread::sleep(std::time::Duration::from_millis(1));
                }
                Err(MemoryError::Exhausted { .. }) => return Err(abi::STATUS_EXHAUSTED),
                Err(MemoryError::TooLarge { .. }) => return Err(abi::STATUS_INVALID),
            }
        }
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
    // SAFETY: see `call_context`.
    let Some(call_context) = (unsafe { call_context(call) }) else { return abi::STATUS_INVALID };
    if output as usize >= call_context.outputs_len {
        return abi::STATUS_INVALID;
    }
    let wanted = Frame { len, format, width, height, stride_bytes, ..Frame::EMPTY };
    if !call_context.accepts(output, &wanted) {
        return call_context.object(output, &wanted);
    }
    match call_context.allocate(len) {
        Ok((buffer, data)) => {
            call_context.written |= output_bit(output);
            call_context.place(output, &Frame { buffer, data, ..wanted })
        }
        Err(status) => status,
    }
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
    // SAFETY: see `call_context`; null or a place for the buffer.
    let (Some(call_context), Some(place)) = (unsafe { (call_context(call), buffer.as_mut()) }) else {
        return abi::STATUS_INVALID;
    };
    let Some(&mut frame) = call_context.output(output).filter(|_| status == abi::STATUS_OK) else { return status };
    let Some(handle) = memory().place_on_device(frame.buffer, len) else {
        // The output stays in the host's memory, where nobody made it.
        call_context.place(output, &Frame::EMPTY);
        return abi::STATUS_ERROR;
    };
    *place = handle;
    call_context.set_home(output, abi::HOME_DEVICE);
    abi::STATUS_OK
}

unsafe extern "C" fn device(_: *mut c_void, reason: *mut Str) -> *const abi::Device {
    // SAFETY: null or a place for the reason (the contract).
    unsafe { device_table(reason) }
}

unsafe extern "C" fn device_buffer(_: *mut c_void, frame: *const Frame) -> u64 {
    // SAFETY: the frame is read for the length of this function; null gives `None`.
    let Some(frame) = (unsafe { frame.as_ref() }) else { return 0 };
    if !memory().retain_checked(frame) {
        return 0;
    }
    let handle = memory().device_buffer(frame);
    memory().release(frame.buffer);
    handle.unwrap_or(0)
}

unsafe extern "C" fn fetch(_: *mut c_void, frame: *const Frame) -> Status {
    // SAFETY: the frame is read for the length of this function; null gives `None`.
    let Some(frame) = (unsafe { frame.as_ref() }) else { return abi::STATUS_INVALID };
    if !memory().retain_checked(frame) {
        return abi::STATUS_INVALID;
    }
    let is_there = memory().fetch(frame);
    memory().release(frame.buffer);
    if is_there { abi::STATUS_OK } else { abi::STATUS_ERROR }
}

/// Makes `frame`, a buffer of the domain of the node's group with one reference, output `output` of the running call,
/// as [`abi::Host::alloc`] does with a new one. Only buffer and description of the frame are used. With `is_copy` it is
/// a copy of the output, as [`abi::Host::make_mut`] makes one: only the buffer is used.
///
/// # Safety
/// `call` is the handle of the running call; `frame` is large enough for its description.
pub unsafe fn place(call: *mut c_void, output: u32, frame: FrameRef, is_copy: bool) -> Status {
    // SAFETY: the caller's promise.
    let Some(call_context) = (unsafe { call_context(call) }) else { return abi::STATUS_INVALID };
    let Some(&mut current) = call_context.output(output) else { return abi::STATUS_INVALID };
    let mut made = Frame { tick: abi::Tick::default(), ..*frame.frame() };
    if is_copy {
        if current.is_empty() || current.len > frame.frame().len {
            return abi::STATUS_INVALID;
        }
        made = Frame { buffer: made.buffer, data: made.data, ..current };
        call_context.runtime.stats.count_copy(current.len);
    } else if !call_context.accepts(output, &made) {
        return call_context.object(output, &made);
    }
    // Its reference goes to the output.
    std::mem::forget(frame);
    call_context.written |= output_bit(output);
    call_context.place(output, &made)
}

/// Keeps the position of a source after the tick of the running call: if its process dies, its next instance continues
/// there.
///
/// # Safety
/// `call` is the handle of the running call.
pub unsafe fn keep_position(call: *mut c_void, state: &[u8]) {
    // SAFETY: the caller's promise.
    if let Some(call) = unsafe { call_context(call) } {
        call.runtime.recovery.keep_position(state);
    }
}

unsafe extern "C" fn forward(call: *mut c_void, output: u32, frame: *const Frame) -> Status {
    // SAFETY: see `call_context`; the frame is read for the length of this function.
    let (Some(call_context), Some(frame)) = (unsafe { (call_context(call), frame.as_ref()) }) else {
        return abi::STATUS_INVALID;
    };
    let mut frame = *frame;
    frame.tick.flags = call_context.lag_of(&frame.tick);
    call_context.written &= !output_bit(output);
    if output as usize >= call_context.outputs_len {
        return abi::STATUS_INVALID;
    }
    if !call_context.accepts(output, &frame) {
        return call_context.object(output, &frame);
    }
    if call_context.lent.is_none()
        && let Some(input) = call_context.input(&frame)
    {
        match call_context.output(output) {
            Some(slot) if slot.is_empty() => call_context.write(output, &frame),
            _ => _ = call_context.place(output, &frame),
        }
        call_context.lent = Some(Lent { output, input });
        return abi::STATUS_OK;
    }
    if !memory().retain_checked(&frame) {
        let words = format!(
            "output `{}` was forwarded from memory that is no frame of the host",
            call_context.runtime.rules[output as usize].name
        );
        return call_context.refuse(Cause::BadOutput, words);
    }
    call_context.place(output, &frame)
}

unsafe extern "C" fn make_mut(call: *mut c_void, output: u32) -> Status {
    // SAFETY: see `call_context`.
    let Some(call_context) = (unsafe { call_context(call) }) else { return abi::STATUS_INVALID };
    let Some(&mut frame) = call_context.output(output) else { return abi::STATUS_INVALID };
    if frame.is_empty() {
        return abi::STATUS_INVALID;
    }
    let lent = call_context.lent.is_some_and(|lent| lent.output == output);
    // An isolated node cannot write the frames of this process.
    let own = call_context.runtime.domain().is_none_or(|domain| Memory::domain_of(frame.buffer) == domain);
    memory().fetch(&frame);
    if !lent && own && memory().references(frame.buffer) == 1 {
        memory().forget_device_copy(frame.buffer);
        call_context.set_home(output, abi::HOME_HOST);
        call_context.written |= output_bit(output);
        return abi::STATUS_OK;
    }
    match call_context.allocate(frame.len) {
        Ok((buffer, data)) => {
            // SAFETY: two live buffers of at least `len` bytes that do not overlap.
            unsafe { std::ptr::copy_nonoverlapping(frame.data, data, frame.len) };
            call_context.runtime.stats.count_copy(frame.len);
            call_context.written |= output_bit(output);
            call_context.place(output, &Frame { buffer, data, ..frame })
        }
        Err(status) => status,
    }
}

unsafe extern "C" fn retain(ctx: *mut c_void, buffer: BufferId) {
    retained::retain(ctx as retained::Plugin, buffer);
}

unsafe extern "C" fn release(ctx: *mut c_void, buffer: BufferId) {
    retained::release(ctx as retained::Plugin, buffer);
}

unsafe extern "C" fn resolve(_: *mut c_void, buffer: BufferId) -> *mut u8 {
    memory().resolve(buffer)
}

unsafe extern "C" fn parallel_for(_: *mut c_void, chunks: usize, body: ChunkFn, data: *mut c_void) -> Status {
    // SAFETY: the plugin's promise to `parallel_for`.
    if unsafe { pool::parallel_for(chunks, body, data) } { abi::STATUS_OK } else { abi::STATUS_INVALID }
}

unsafe fn words<'a>(text: Str) -> std::borrow::Cow<'a, str> {
    // SAFETY: the plugin lends the text for the length of the call.
    let bytes = unsafe { text.bytes() };
    // Cheaper for valid text, which it almost always is.
    str::from_utf8(bytes).map_or_else(|_| String::from_utf8_lossy(bytes), std::borrow::Cow::Borrowed)
}

unsafe extern "C" fn log(call: *mut c_void, level: u32, message: Str) {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    if let Some(call_context) = unsafe { call_context(call) }.filter(|call_context| !call_context.is_trial) {
        let level = match level {
            abi::LOG_ERROR => Level::Error,
            abi::LOG_WARN => Level::Warn,
            abi::LOG_INFO => Level::Info,
            _ => Level::Debug,
        };
        // SAFETY: the plugin lends the text for the length of this call (the contract).
        call_context.context.log.write(level, &call_context.runtime.id, &unsafe { words(message) });
    }
}

unsafe extern "C" fn fail(call: *mut c_void, message: Str) {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    if let Some(call_context) = unsafe { call_context(call) } {
        call_context.failure.clear();
        // SAFETY: the plugin lends the text for the length of this call (the contract). Its errors may quote an address.
        call_context.failure.push_str(&panoscope_base::secret::redact(&unsafe { words(message) }));
        call_context.has_failure = true;
    }
}

unsafe extern "C" fn metric(call: *mut c_void, name: Str, value: f64) {
    // SAFETY: plugins pass back the handle of the running call (the contract).
    if let Some(call_context) = unsafe { call_context(call) } {
        // SAFETY: the plugin lends the text for the length of this call (the contract).
        let name = unsafe { words(name) };
        if let Some(hear) = call_context.runtime.hear_number.get() {
            hear(&call_context.tick, &name, value);
        }
        call_context.runtime.progress.set_metric(&name, value);
    }
}

/// Seed of a node's random numbers for a tick; the same in every run.
pub fn random_seed(id: &str, tick: abi::Tick) -> u64 {
    let hash = abi::fnv1a(abi::FNV_START, id.as_bytes());
    abi::fnv1a(abi::fnv1a(hash, &tick.seq.to_le_bytes()), &tick.source.to_le_bytes())
}

unsafe extern "C" fn random(call: *mut c_void) -> u64 {
    // SAFETY: see `call_context`.
    match unsafe { call_context(call) } {
        Some(call_context) => {
            let begin = || SplitMix64(random_seed(&call_context.runtime.id, call_context.tick));
            call_context.random.get_or_insert_with(begin).bits()
        }
        None => 0,
    }
}

unsafe extern "C" fn save(_: *mut c_void, _: *const u8, _: usize) {
    // Only the table passed to `save_state` has a sink.
}

unsafe extern "C" fn claim_file(call: *mut c_void, path: Str, action: u32, file: *mut Str) -> Status {
    // SAFETY: plugins pass back the handle of the running call and lend the text for the length of this function (the contract).
    let (Some(call_context), Some(path)) = (unsafe { (call_context(call), path.text()) }) else {
        return abi::STATUS_INVALID;
    };
    let holds = call_context.holds;
    let Some(claims) = holds.claims.as_ref().filter(|_| action <= abi::CLAIM_BEGIN_NEW) else {
        return abi::STATUS_INVALID;
    };
    let (status, text) = match claims.claim(holds.token, &call_context.runtime.id, Path::new(path), action) {
        Ok(path) => (abi::STATUS_OK, path.to_string_lossy().into_owned()),
        Err(Claimed::Node { by }) => (abi::STATUS_INVALID, by),
        Err(error @ Claimed::Run(_)) => (abi::STATUS_ERROR, error.to_string()),
    };
    let mut answer = lock(&holds.answer);
    *answer = text;
    // SAFETY: null or a place for the answer; the text stays as it is until the next claim of this instance.
    if let Some(file) = unsafe { file.as_mut() } {
        *file = Str::borrow(&answer);
    }
    status
}

unsafe extern "C" fn clock_ns(_: *mut c_void) -> i64 {
    i64::try_from(clock::now_ns()).unwrap_or(i64::MAX)
}

/// A function table for an engine with `threads` threads.
pub(crate) fn table(threads: usize) -> Host {
    Host {
        struct_size: size_of::<Host>() as u32,
        abi_major: abi::ABI_MAJOR,
        abi_minor: abi::ABI_MINOR,
        threads: threads as u32,
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
        set_arrived_ns: Some(times::set_arrived_ns),
        arrived_ns: Some(times::arrived_ns),
        age_ns: Some(times::age_ns),
        set_lag_ns: Some(times::set_lag_ns),
        device: Some(device),
        device_buffer: Some(device_buffer),
        alloc_on_device: Some(alloc_on_device),
        fetch: Some(fetch),
    }
}

/// The table given to a plugin when it is loaded; valid until the process ends. Its handle identifies the plugin on any
/// thread.
pub(crate) fn plugin_table(descriptor: *const abi::Plugin) -> *const Host {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let ctx = retained::plugin_of(descriptor.cast()) as *mut c_void;
    Box::leak(Box::new(Host { ctx, ..table(threads) }))
}
