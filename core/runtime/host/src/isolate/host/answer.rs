//! Functions of the host that run for a child.

use std::ffi::c_void;

use panoscope_abi::{self as abi, Frame, Host, INPUT_TICK, Status, Str};
use panoscope_engine::host;
use panoscope_engine::memory::{FrameRef, Memory, memory};

use super::process::Process;
use super::stock::Stock;
use crate::isolate::wire::lane::{Age, Clock, CopyWanted, Forwarded, Kind, Made, TickRequest, Wanted};
use crate::isolate::wire::{BadMessage, MAX_TEXT_BYTES, Reader, Wire, put_bytes};

/// Arguments of the host's functions while a request is in the child.
#[derive(Clone, Copy)]
pub(super) struct Target {
    pub host: *const Host,
    pub call: *mut c_void,
    /// Target of `save`.
    pub sink: *mut c_void,
    /// The outputs as the node sees them.
    pub outputs: *mut Frame,
    pub outputs_len: usize,
}

impl Target {
    /// For a call without outputs.
    pub fn new(host: *const Host, call: *mut c_void) -> Self {
        Self { host, call, sink: std::ptr::null_mut(), outputs: std::ptr::null_mut(), outputs_len: 0 }
    }

    /// Reports the error message of a failure, if there is a call.
    ///
    /// # Safety
    /// Table and call are valid.
    pub unsafe fn fail(&self, words: &str) {
        if self.call.is_null() {
            return;
        }
        // SAFETY: the caller's promise.
        unsafe {
            if let Some(fail) = (*self.host).fail {
                fail(self.call, Str::borrow(words));
            }
        }
    }

    /// An output as the node sees it.
    fn output(&self, index: u32) -> Option<*mut Frame> {
        // SAFETY: `outputs` holds `outputs_len` frames.
        ((index as usize) < self.outputs_len).then(|| unsafe { self.outputs.add(index as usize) })
    }
}

/// Data that an instance asked for in earlier calls, which is sent with the next ones.
#[derive(Default)]
pub(super) struct Habits {
    /// Inputs whose age it asked for, [`INPUT_TICK`] among them.
    ages: Vec<u32>,
    clock: bool,
}

/// Maximum number of inputs whose ages are sent without being asked for.
const MAX_AGES: usize = 64;

impl Habits {
    /// Habits of a link, which gets the clock in each call.
    pub fn of_link() -> Self {
        Self { clock: true, ..Self::default() }
    }

    fn note_age(&mut self, input: u32) {
        if self.ages.len() < MAX_AGES && !self.ages.contains(&input) {
            self.ages.push(input);
        }
    }

    /// Fills in the clock, and the arrival and age of inputs.
    ///
    /// # Safety
    /// The call is running with the host's table.
    pub unsafe fn fill(&self, host: &Host, call: *mut c_void, request: &mut TickRequest) {
        // The child adds the time that passes on the system's clock.
        let clock = host.clock_ns.filter(|_| self.clock);
        // SAFETY: the caller's promise.
        let host_ns = clock.map(|clock| unsafe { clock(call) });
        request.clock = host_ns.map(|host_ns| Clock { host_ns, system_ns: crate::isolate::system_ns() });
        let inputs_len = request.inputs.len();
        let known = |input: &&u32| **input == INPUT_TICK || (**input as usize) < inputs_len;
        request.ages.clear();
        request.ages.extend(self.ages.iter().filter(known).map(|&input| {
            let ask = |ask: Option<unsafe extern "C" fn(*mut c_void, u32) -> i64>, none: i64| {
                // SAFETY: the caller's promise.
                ask.map_or(none, |ask| unsafe { ask(call, input) })
            };
            Age { input, arrived_ns: ask(host.arrived_ns, i64::MIN), age_ns: ask(host.age_ns, i64::MAX) }
        }));
    }
}

/// Maximum number of bytes of a state that the host keeps for an instance in another process.
const MAX_STATE_BYTES: usize = 256 << 20;
/// Maximum number of files that a node in another process may claim in one call.
const MAX_CLAIMS: usize = 1024;
const MAX_PATH_BYTES: usize = 4096;
/// Maximum length of a metric's name, bytes.
const MAX_NAME_BYTES: usize = 256;

/// Resources of the host that the child used during one request.
#[derive(Default)]
pub(super) struct Spent {
    state_bytes: usize,
    claims: usize,
    /// The limit that it exceeded.
    pub objection: Option<&'static str>,
}

impl Spent {
    fn refuse(&mut self, objection: &'static str) -> BadMessage {
        self.objection = Some(objection);
        BadMessage
    }
}

/// Runs functions of the host for one instance.
pub(super) struct Answerer<'r> {
    pub host: &'r Host,
    pub target: Target,
    pub process: &'r Process,
    pub stock: &'r mut Stock,
    pub habits: &'r mut Habits,
    pub spent: &'r mut Spent,
}

impl Answerer<'_> {
    /// Runs the functions that the child deferred, in order. A failure is a fault of the call, which the engine
    /// records.
    ///
    /// # Safety
    /// Table, call and outputs of the target are valid.
    pub unsafe fn run_deferred(&mut self, bytes: &[u8]) -> Result<(), BadMessage> {
        let mut reader = Reader(bytes);
        while !reader.0.is_empty() {
            let kind = Kind::of(reader.take()?).filter(|kind| kind.is_deferred()).ok_or(BadMessage)?;
            // SAFETY: the caller's promise.
            unsafe { self.run(kind, &mut reader)? };
        }
        Ok(())
    }

    /// Runs a function that has no result, or whose status is not awaited.
    ///
    /// # Safety
    /// As [`Self::run_deferred`].
    unsafe fn run(&mut self, kind: Kind, reader: &mut Reader<'_>) -> Result<Status, BadMessage> {
        let (host, call) = (self.host, self.target.call);
        if let Kind::Retain | Kind::Release = kind {
            let function = if kind == Kind::Retain { host.retain } else { host.release };
            let buffer = reader.take()?;
            if kind == Kind::Retain && !self.process.can_read(buffer) {
                return Err(self.spent.refuse("kept a frame that it was not given"));
            }
            if let Some(function) = function {
                // SAFETY: the host checks the buffer.
                unsafe { function(host.ctx, buffer) };
            }
            return Ok(abi::STATUS_OK);
        }
        if call.is_null() {
            return Err(BadMessage);
        }
        match kind {
            Kind::Placed => {
                let Wanted { output, format, width, height, stride_bytes, len } = reader.take()?;
                let len = usize::try_from(len).map_err(|_| BadMessage)?;
                let buffer = self.stock.take(output).filter(|buffer| len <= buffer.frame().len).ok_or(BadMessage)?;
                let frame = Frame { len, format, width, height, stride_bytes, ..buffer.into_raw() };
                self.stock.note(output, len);
                // SAFETY: the reference of the buffer, which has at least `len` bytes; the call is running.
                return Ok(unsafe { host::place(call, output, FrameRef::adopt(frame), false) });
            }
            Kind::Copied => {
                let output = reader.take()?;
                let buffer = self.stock.take(output).ok_or(BadMessage)?;
                // SAFETY: the running call.
                return Ok(unsafe { host::place(call, output, buffer, true) });
            }
            Kind::Forward => {
                let Forwarded { output, is_buffer, mut frame } = reader.take()?;
                if is_buffer {
                    // It can read all of a pool that it was given, so that it could as well copy; of others it knows nothing.
                    if !self.process.can_read(frame.buffer) {
                        return Err(self.spent.refuse("forwarded a frame that it was not given"));
                    }
                    frame.data = memory().resolve(frame.buffer);
                }
                let forward = host.forward.ok_or(BadMessage)?;
                // SAFETY: the running call; the host checks the frame.
                return Ok(unsafe { forward(call, output, &raw const frame) });
            }
            Kind::Metric => {
                let (name, value) = (reader.bytes()?, reader.take()?);
                if name.len() > MAX_NAME_BYTES {
                    return Err(BadMessage);
                }
                if let Some(metric) = host.metric {
                    // SAFETY: the running call; the name lives until the call returns.
                    unsafe { metric(call, Str { ptr: name.as_ptr(), len: name.len() }, value) };
                }
            }
            Kind::SetArrived | Kind::SetLag => {
                let ns = reader.take()?;
                let set = if kind == Kind::SetLag { host.set_lag_ns } else { host.set_arrived_ns };
                if let Some(set) = set {
                    // SAFETY: the running call.
                    unsafe { set(call, ns) };
                }
            }
            _ => return Err(BadMessage),
        }
        Ok(abi::STATUS_OK)
    }

    /// Runs a function of the host for the child and writes its result.
    ///
    /// # Safety
    /// As [`Self::run_deferred`].
    pub unsafe fn answer(&mut self, asked: Kind, message: &[u8], out: &mut Vec<u8>) -> Result<(), BadMessage> {
        out.clear();
        let mut reader = Reader(message);
        let (host, call) = (self.host, self.target.call);
        if asked == Kind::Flush {
            return Ok(());
        }
        if asked == Kind::Save {
            // SAFETY: the caller's promise.
            return unsafe { self.save(reader.bytes()?) };
        }
        if call.is_null() {
            return Err(BadMessage);
        }
        let text = |bytes: &[u8]| Str { ptr: bytes.as_ptr(), len: bytes.len().min(MAX_TEXT_BYTES) };
        match asked {
            Kind::Alloc => {
                let Wanted { output, format, width, height, stride_bytes, len } = reader.take()?;
                let len = usize::try_from(len).map_err(|_| BadMessage)?;
                // SAFETY: the running call; the host checks all numbers.
                let status = host.alloc.map_or(abi::STATUS_INVALID, |alloc| unsafe {
                    alloc(call, output, format, width, height, stride_bytes, len)
                });
                // SAFETY: the outputs live.
                unsafe { self.made(status, output, out) }
            }
            Kind::Forward => {
                let output = Reader(message).take::<Forwarded>()?.output;
                // SAFETY: the caller's promise.
                let status = unsafe { self.run(Kind::Forward, &mut reader)? };
                // SAFETY: the outputs live.
                unsafe { self.made(status, output, out) }
            }
            Kind::MakeMut => {
                let CopyWanted { output, .. } = reader.take()?;
                // SAFETY: the running call; the host checks the number.
                let status = host.make_mut.map_or(abi::STATUS_INVALID, |make_mut| unsafe { make_mut(call, output) });
                // SAFETY: the outputs live.
                unsafe { self.made(status, output, out) }
            }
            Kind::Log => {
                let (level, words) = (reader.take()?, reader.bytes()?);
                if let Some(log) = host.log {
                    // SAFETY: the running call; the words live until the call returns.
                    unsafe { log(call, level, text(words)) };
                }
            }
            Kind::Fail => {
                let words = reader.bytes()?;
                if let Some(fail) = host.fail {
                    // SAFETY: the running call; the words live until the call returns.
                    unsafe { fail(call, text(words)) };
                }
            }
            Kind::ClaimFile => {
                let (action, path) = (reader.take()?, std::str::from_utf8(reader.bytes()?).map_err(|_| BadMessage)?);
                // SAFETY: the caller's promise.
                unsafe { self.claim_file(action, path, out)? };
            }
            Kind::Clock => {
                self.habits.clock = true;
                // SAFETY: the running call.
                host.clock_ns.map_or(0, |clock| unsafe { clock(call) }).put(out);
            }
            Kind::Arrived | Kind::Age => {
                let input = reader.take()?;
                self.habits.note_age(input);
                let ask = if asked == Kind::Age { host.age_ns } else { host.arrived_ns };
                // SAFETY: the running call; the host checks the number.
                ask.map_or(i64::MIN, |ask| unsafe { ask(call, input) }).put(out);
            }
            _ => return Err(BadMessage),
        }
        Ok(())
    }

    /// Adds bytes to the state that is saved, within the limit.
    ///
    /// # Safety
    /// Table and sink of the target are valid.
    unsafe fn save(&mut self, bytes: &[u8]) -> Result<(), BadMessage> {
        self.spent.state_bytes += bytes.len();
        if self.spent.state_bytes > MAX_STATE_BYTES {
            return Err(self.spent.refuse("has a state of more than 256 MB"));
        }
        // SAFETY: the table that came with the sink takes bytes for it.
        if let Some(save) = unsafe { (*self.target.host).save }.filter(|_| !self.target.sink.is_null()) {
            // SAFETY: the bytes live until the call returns.
            unsafe { save(self.target.sink, bytes.as_ptr(), bytes.len()) };
        }
        Ok(())
    }

    /// Claims a file for the node, within the limits, and writes the status and the file's path.
    ///
    /// # Safety
    /// Table and call of the target are valid.
    unsafe fn claim_file(&mut self, action: u32, path: &str, out: &mut Vec<u8>) -> Result<(), BadMessage> {
        self.spent.claims += 1;
        if self.spent.claims > MAX_CLAIMS || path.len() > MAX_PATH_BYTES {
            return Err(self
                .spent
                .refuse("claims more than 1024 files in one call, or a path of more than 4096 bytes"));
        }
        let mut file = Str::EMPTY;
        // SAFETY: the running call; path and place for the answer live until the call returns.
        let status = self.host.claim_file.map_or(abi::STATUS_INVALID, |claim| unsafe {
            claim(self.target.call, Str::borrow(path), action, &raw mut file)
        });
        // SAFETY: the host's answer stays as it is until the next claim.
        let file = unsafe { file.bytes() };
        status.put(out);
        put_bytes(file, out);
        Ok(())
    }

    /// Writes the status of a function that makes an output, and the output.
    ///
    /// # Safety
    /// The outputs of the target are valid.
    unsafe fn made(&mut self, status: Status, output: u32, out: &mut Vec<u8>) {
        let none = |status| Made { status, frame: Frame::EMPTY };
        let made = match self.target.output(output).filter(|_| status == abi::STATUS_OK) {
            Some(frame) => {
                // SAFETY: the caller's promise.
                let frame = unsafe { *frame };
                if Memory::domain_of(frame.buffer) == self.process.domain() {
                    self.stock.note(output, frame.len);
                }
                match self.process.give_pool(frame.buffer) {
                    Ok(()) => Made { status, frame },
                    // Private memory of the host, which a retained frame may still be in.
                    Err(_) => none(abi::STATUS_EXHAUSTED),
                }
            }
            None if status == abi::STATUS_OK => none(abi::STATUS_INVALID),
            None => none(status),
        };
        made.put(out);
    }
}
