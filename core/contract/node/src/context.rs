//! The host's services to a node besides its frames: threads, log, files, clock, random numbers.

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

/// The host's services during one call of `process`.
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
pub(crate) fn has(host: &abi::Host, end: usize) -> bool {
    host.struct_size as usize >= end
}

/// See [`abi::Host::claim_file`]. A host of an earlier version has no such function; the path is then returned as it
/// is.
fn claim(host: &abi::Host, call: *mut std::ffi::c_void, path: &Path, action: u32) -> Result<PathBuf, NodeError> {
    let end = std::mem::offset_of!(abi::Host, claim_file) + size_of::<usize>();
    let (Some(claim), Some(text)) = (host.claim_file.filter(|_| has(host, end)), path.to_str()) else {
        return Ok(path.to_owned());
    };
    let mut returned = abi::Str::EMPTY;
    // SAFETY: `call` is the handle of the running call; the text is borrowed for the length of the function.
    let status = unsafe { claim(call, abi::Str::borrow(text), action, &raw mut returned) };
    // SAFETY: the host keeps the text that it returned valid until the call ends.
    let returned = unsafe { returned.text() }.unwrap_or("");
    match status {
        abi::STATUS_OK if returned.is_empty() => Ok(path.to_owned()),
        abi::STATUS_OK => Ok(PathBuf::from(returned)),
        // Another run writes the file: the host has said which.
        abi::STATUS_ERROR => Err(NodeError::new(returned)),
        _ => Err(NodeError::new(format!("node `{returned}` already writes {text}: give this node another file"))),
    }
}

impl<'f> Context<'f> {
    pub(crate) fn new(raw: RawCall<'f>) -> Self {
        // SAFETY: the host's call and its function table are valid for `'f`.
        let host = unsafe { &*(*raw.raw()).host };
        Self { raw, pool: Pool { host }, ended: std::cell::Cell::new(false) }
    }

    pub(crate) fn host(&self) -> &'f abi::Host {
        self.pool.host
    }

    pub(crate) fn call(&self) -> &abi::Call {
        // SAFETY: the host's call is valid for `'f`; callers copy fields out, so no reference lives while one of them changes.
        unsafe { &*self.raw.raw() }
    }

    /// The host's thread pool, for algorithms that take a [`Parallel`].
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

    /// For sources: sets the tick's capture time, in ns of media time.
    pub fn set_capture_ns(&self, capture_ns: i64) {
        // SAFETY: the host reads the field after the call, and this crate holds no reference to it between calls of this type.
        unsafe { (*self.raw.raw()).tick.capture_ns = capture_ns }
    }

    /// For sources: ends the source. The outputs of this call are dropped.
    pub fn end(&self) {
        self.ended.set(true);
    }

    pub(crate) fn ended(&self) -> bool {
        self.ended.get()
    }

    /// Begins a file that was claimed with [`Open::claim_file`] and returns the path to create. That is `path` itself
    /// the first time in a run, then, when the node is opened again, `name.part2.extension` and so on, so that written
    /// data is never truncated. With `may_replace` the file of an earlier run is replaced, unless the host keeps those;
    /// otherwise the returned path does not exist yet.
    ///
    /// # Errors
    /// Another node writes this file.
    pub fn begin_file(&self, path: &Path, may_replace: bool) -> Result<PathBuf, NodeError> {
        let action = if may_replace { abi::CLAIM_BEGIN } else { abi::CLAIM_BEGIN_NEW };
        claim(self.pool.host, self.call().call, path, action)
    }

    /// The host's monotonic clock in ns, for nodes that record when something happened; `None` where the host has none.
    /// A node's outputs must not depend on it.
    pub fn clock_ns(&self) -> Option<i64> {
        let host = self.pool.host;
        let end = std::mem::offset_of!(abi::Host, clock_ns) + size_of::<usize>();
        // SAFETY: the host keeps the handle of the running call valid for `'f`.
        host.clock_ns.filter(|_| has(host, end)).map(|clock| unsafe { clock(self.call().call) })
    }

    /// The next number of a generator that is seeded by node and tick: the same in every run.
    pub fn random(&self) -> u64 {
        match self.pool.host.random {
            // SAFETY: the host keeps the handle of the running call valid for `'f`.
            Some(random) => unsafe { random(self.call().call) },
            None => 0,
        }
    }

    /// Reports a fault after which the node continues, such as a lost device that it waits for. The host counts and
    /// records it like a failed call, but keeps the instance. One fault per call: a later one replaces it.
    pub fn fault(&self, message: &str) {
        if let Some(fail) = self.pool.host.fail {
            // SAFETY: the handle of the running call; the text is borrowed for the length of the function.
            unsafe { fail(self.call().call, abi::Str::borrow(message)) }
        }
    }

    /// Reports a named number, shown next to the node's timing.
    pub fn metric(&self, name: &str, value: f64) {
        if let Some(metric) = self.pool.host.metric {
            // SAFETY: the handle of the running call; the text is borrowed for the length of the function.
            unsafe { metric(self.call().call, abi::Str::borrow(name), value) }
        }
    }

    /// Logs a message that the user should see.
    pub fn warn(&self, message: &str) {
        log(self.pool.host, self.call().call, abi::LOG_WARN, message);
    }

    /// Logs progress.
    pub fn info(&self, message: &str) {
        log(self.pool.host, self.call().call, abi::LOG_INFO, message);
    }

    /// Logs a message for debugging the node.
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
        // SAFETY: the caller guarantees that `call` and its host table are valid for `'a`.
        let host = unsafe { &*(*call).host };
        Self { call, pool: Pool { host }, lifetime: PhantomData }
    }

    fn call(&self) -> &'a abi::OpenCall {
        // SAFETY: the caller of `new` guarantees that it is valid for `'a`.
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

    /// Claims a file for this node for as long as it is open. Nothing is created but its lock, for which the folder
    /// must exist.
    ///
    /// # Errors
    /// Another node of the graph, or another run, writes this file.
    pub fn claim_file(&self, path: &Path) -> Result<(), NodeError> {
        self.claim_files(path).map(drop)
    }

    /// Claims a file that each write replaces as a whole, or a pattern with `{seq}` of such files. Returns the path or
    /// pattern to write: the same in the whole run, and one without files of earlier runs where the host keeps those.
    ///
    /// # Errors
    /// Another node of the graph, or another run, writes this file.
    pub fn claim_files(&self, path: &Path) -> Result<PathBuf, NodeError> {
        claim(self.pool.host, self.call().call, path, abi::CLAIM_HOLD)
    }

    /// Whether output `index` has a reader.
    pub fn is_read(&self, index: usize) -> bool {
        index >= 64 || self.call().outputs_read >> index & 1 == 1
    }

    /// Whether the graph runs in `batch` mode.
    pub fn is_batch(&self) -> bool {
        self.call().flags & abi::CALL_BATCH != 0
    }

    /// The host's thread pool, for tables that take long to build.
    pub fn pool(&self) -> &Pool<'a> {
        &self.pool
    }

    /// Logs a message that the user should see.
    pub fn warn(&self, message: &str) {
        log(self.pool.host, self.call().call, abi::LOG_WARN, message);
    }

    /// Logs progress.
    pub fn info(&self, message: &str) {
        log(self.pool.host, self.call().call, abi::LOG_INFO, message);
    }
}

impl panoscope_base::Report for Open<'_> {
    fn warn(&self, message: &str) {
        Open::warn(self, message);
    }

    fn info(&self, message: &str) {
        Open::info(self, message);
    }

    /// Does nothing: a node that opens has no metrics.
    fn metric(&self, _: &str, _: f64) {}
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

    /// Logs a message that the user should see.
    pub fn warn(&self, message: &str) {
        log(self.host, self.call, abi::LOG_WARN, message);
    }

    /// Begins to write a file, as [`Context::begin_file`].
    ///
    /// # Errors
    /// Another node writes this file.
    pub fn begin_file(&self, path: &Path, may_replace: bool) -> Result<PathBuf, NodeError> {
        let action = if may_replace { abi::CLAIM_BEGIN } else { abi::CLAIM_BEGIN_NEW };
        claim(self.host, self.call, path, action)
    }
}
