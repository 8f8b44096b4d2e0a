//! What a node may ask of the host besides its frames.

use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use crate::Parallel;
use crate::abi;
use crate::error::NodeError;
use crate::host;
use crate::port::RawCall;

/// The host's thread pool.
#[derive(Clone, Copy)]
pub struct Pool<'f> {
    host: &'f abi::Host,
}

impl Parallel for Pool<'_> {
    fn threads(&self) -> usize {
        self.host.threads as usize
    }

    fn run(&self, chunks: usize, body: &(dyn Fn(usize) + Sync)) {
        match chunks {
            0 => {}
            1 => body(0),
            _ => host::parallel_for(self.host, chunks, body),
        }
    }
}

/// The running call.
pub struct Context<'f> {
    raw: RawCall<'f>,
    pool: Pool<'f>,
    ended: std::cell::Cell<bool>,
}

fn log(host: &abi::Host, call: *mut std::ffi::c_void, level: u32, message: &str) {
    if let Some(log) = host.log {
        // SAFETY: `call` is the handle of the running call; the text is borrowed for the length of the function.
        unsafe { log(call, level, abi::Str::borrow(message)) }
    }
}

/// Whether the host's table has the fields up to the one that ends at `end`.
fn has(host: &abi::Host, end: usize) -> bool {
    host.struct_size as usize >= end
}

/// See [`abi::Host::claim_file`]; a host of an earlier version claims nothing.
fn claim(host: &abi::Host, call: *mut std::ffi::c_void, path: &Path, action: u32) -> Result<PathBuf, NodeError> {
    let end = std::mem::offset_of!(abi::Host, claim_file) + size_of::<usize>();
    let (Some(claim), Some(text)) = (host.claim_file.filter(|_| has(host, end)), path.to_str()) else {
        return Ok(path.to_owned());
    };
    let mut answer = abi::Str::EMPTY;
    // SAFETY: `call` is the handle of the running call; the text is borrowed for the length of the function.
    let status = unsafe { claim(call, abi::Str::borrow(text), action, &raw mut answer) };
    // SAFETY: the host's answer is valid until the call ends.
    let answer = unsafe { answer.text() }.unwrap_or("");
    match status {
        abi::STATUS_OK if answer.is_empty() => Ok(path.to_owned()),
        abi::STATUS_OK => Ok(PathBuf::from(answer)),
        _ => Err(NodeError::new(format!("{text} is written by node `{answer}`: give this node a file of its own"))),
    }
}

impl<'f> Context<'f> {
    pub(crate) fn new(raw: RawCall<'f>) -> Self {
        // SAFETY: the host's call and its function table are valid for `'f`.
        let host = unsafe { &*(*raw.raw()).host };
        Self { raw, pool: Pool { host }, ended: std::cell::Cell::new(false) }
    }

    fn call(&self) -> &abi::Call {
        // SAFETY: the host's call is valid for `'f`; fields that change are copied out at once.
        unsafe { &*self.raw.raw() }
    }

    /// The host's threads, for kernels.
    pub fn pool(&self) -> &Pool<'f> {
        &self.pool
    }

    /// The tick being processed.
    pub fn tick(&self) -> abi::Tick {
        self.call().tick
    }

    /// Whether the graph runs in `batch` mode.
    pub fn is_batch(&self) -> bool {
        self.call().flags & abi::CALL_BATCH != 0
    }

    /// For sources: the media time of what was captured.
    pub fn set_capture_ns(&self, capture_ns: i64) {
        // SAFETY: the host reads the field after the call; nobody else holds a reference to it now.
        unsafe { (*self.raw.raw()).tick.capture_ns = capture_ns }
    }

    /// For sources: nothing comes after this call, whose outputs are dropped.
    pub fn end(&self) {
        self.ended.set(true);
    }

    pub(crate) fn ended(&self) -> bool {
        self.ended.get()
    }

    /// Begins to write a file that was claimed with [`Open::claim_file`]; answers the path to create. That is `path` itself the first time in a
    /// run; later, when the node was opened again, `name.part2.ending` and so on, so that nothing written before is cut off. With
    /// `may_replace` the file of an earlier run is replaced, else a path is answered where nothing exists.
    ///
    /// # Errors
    /// Another node writes it.
    pub fn begin_file(&self, path: &Path, may_replace: bool) -> Result<PathBuf, NodeError> {
        let action = if may_replace { abi::CLAIM_BEGIN } else { abi::CLAIM_BEGIN_NEW };
        claim(self.pool.host, self.call().call, path, action)
    }

    /// The host's monotonic clock in ns, for nodes that note when something happened; `None` where the host has none. What a node makes must
    /// not depend on it.
    pub fn clock_ns(&self) -> Option<i64> {
        let host = self.pool.host;
        let end = std::mem::offset_of!(abi::Host, clock_ns) + size_of::<usize>();
        // SAFETY: the handle of the running call.
        host.clock_ns.filter(|_| has(host, end)).map(|clock| unsafe { clock(self.call().call) })
    }

    /// The next number of a generator seeded by node and tick: the same in every run.
    pub fn random(&self) -> u64 {
        match self.pool.host.random {
            // SAFETY: the handle of the running call.
            Some(random) => unsafe { random(self.call().call) },
            None => 0,
        }
    }

    /// Reports a fault after which the node goes on: a device that is gone and waited for. It is counted and written down like a
    /// failed call, but the instance stays. One fault per call; the last one counts.
    pub fn fault(&self, message: &str) {
        if let Some(fail) = self.pool.host.fail {
            // SAFETY: the handle of the running call; the text is borrowed for the length of the function.
            unsafe { fail(self.call().call, abi::Str::borrow(message)) }
        }
    }

    /// A named number, shown beside the node's timing.
    pub fn metric(&self, name: &str, value: f64) {
        if let Some(metric) = self.pool.host.metric {
            // SAFETY: the handle of the running call; the text is borrowed for the length of the function.
            unsafe { metric(self.call().call, abi::Str::borrow(name), value) }
        }
    }

    /// Something the user should know.
    pub fn warn(&self, message: &str) {
        log(self.pool.host, self.call().call, abi::LOG_WARN, message);
    }

    /// Progress.
    pub fn info(&self, message: &str) {
        log(self.pool.host, self.call().call, abi::LOG_INFO, message);
    }

    /// For whoever debugs the node.
    pub fn debug(&self, message: &str) {
        log(self.pool.host, self.call().call, abi::LOG_DEBUG, message);
    }
}

impl panoscope_base::Report for Context<'_> {
    fn warn(&self, message: &str) {
        Context::warn(self, message);
    }

    fn info(&self, message: &str) {
        Context::info(self, message);
    }

    fn metric(&self, name: &str, value: f64) {
        Context::metric(self, name, value);
    }
}

/// The call that opens a node.
pub struct Open<'a> {
    call: *mut abi::OpenCall,
    pool: Pool<'a>,
    lifetime: PhantomData<&'a abi::OpenCall>,
}

impl<'a> Open<'a> {
    /// Wraps the host's call.
    ///
    /// # Safety
    /// `call` and everything it points to is valid for `'a`.
    pub(crate) unsafe fn new(call: *mut abi::OpenCall) -> Self {
        // SAFETY: the caller's promise.
        let host = unsafe { &*(*call).host };
        Self { call, pool: Pool { host }, lifetime: PhantomData }
    }

    fn call(&self) -> &'a abi::OpenCall {
        // SAFETY: valid for `'a` (promised to `new`).
        unsafe { &*self.call }
    }

    /// The node's name in the graph.
    pub fn node_id(&self) -> &'a str {
        // SAFETY: texts of the call are valid for `'a`.
        unsafe { self.call().node_id.text() }.unwrap_or("")
    }

    /// Folder of the graph file. `Path` parameters are absolute already.
    pub fn graph_dir(&self) -> &'a Path {
        // SAFETY: texts of the call are valid for `'a`.
        Path::new(unsafe { self.call().graph_dir.text() }.unwrap_or(""))
    }

    /// Claims a file, or a pattern of files, for this node for as long as it is open. Nothing is created.
    ///
    /// # Errors
    /// Another node of the graph writes it.
    pub fn claim_file(&self, path: &Path) -> Result<(), NodeError> {
        claim(self.pool.host, self.call().call, path, abi::CLAIM_HOLD).map(drop)
    }

    /// Whether output `index` has a reader.
    pub fn is_read(&self, index: usize) -> bool {
        index >= 64 || self.call().outputs_read >> index & 1 == 1
    }

    /// Whether the graph runs in `batch` mode.
    pub fn is_batch(&self) -> bool {
        self.call().flags & abi::CALL_BATCH != 0
    }

    /// The host's threads, for tables that take long to build.
    pub fn pool(&self) -> &Pool<'a> {
        &self.pool
    }

    /// Something the user should know.
    pub fn warn(&self, message: &str) {
        log(self.pool.host, self.call().call, abi::LOG_WARN, message);
    }

    /// Progress.
    pub fn info(&self, message: &str) {
        log(self.pool.host, self.call().call, abi::LOG_INFO, message);
    }
}

/// The call that completes a node's files.
pub struct Finish<'a> {
    host: &'a abi::Host,
    call: *mut std::ffi::c_void,
}

impl<'a> Finish<'a> {
    /// Wraps the host's handle.
    ///
    /// # Safety
    /// `call` is a handle of this host that is valid for `'a`.
    pub(crate) unsafe fn new(host: &'a abi::Host, call: *mut std::ffi::c_void) -> Self {
        Self { host, call }
    }

    /// Something the user should know.
    pub fn warn(&self, message: &str) {
        log(self.host, self.call, abi::LOG_WARN, message);
    }

    /// Begins to write a file, as [`Context::begin_file`].
    ///
    /// # Errors
    /// Another node writes it.
    pub fn begin_file(&self, path: &Path, may_replace: bool) -> Result<PathBuf, NodeError> {
        let action = if may_replace { abi::CLAIM_BEGIN } else { abi::CLAIM_BEGIN_NEW };
        claim(self.host, self.call, path, action)
    }
}
