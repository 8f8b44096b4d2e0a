use core::ffi::c_void;

use crate::{BufferId, ChunkFn, Device, Frame, PortRange, Status, Str, Tick};

/// A parameter's value at a point in time.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct ParamValue {
    /// One of the `PARAM_` constants.
    pub kind: u32,
    /// The chosen entry of a `PARAM_CHOICE`.
    pub index: u32,
    /// `PARAM_BOOL` (0 or 1) and `PARAM_INT`.
    pub int_value: i64,
    /// `PARAM_FLOAT`.
    pub float_value: f64,
    /// `PARAM_TEXT`, `PARAM_PATH` (absolute) and the name of a `PARAM_CHOICE`.
    pub text: Str,
    /// `PARAM_FLOATS`.
    pub floats: *const f64,
    /// Count of `floats`.
    pub floats_len: usize,
}

// SAFETY: a value is immutable while a snapshot that holds it lives.
unsafe impl Send for ParamValue {}
// SAFETY: a value is immutable while a snapshot that holds it lives; the host keeps it.
unsafe impl Sync for ParamValue {}

/// Set in [`Call::flags`] in `batch` mode.
pub const CALL_BATCH: u32 = 1;

/// Arguments of [`crate::NodeType::open`].
#[repr(C)]
#[derive(Debug)]
pub struct OpenCall {
    /// Size of this struct in bytes.
    pub struct_size: u32,
    /// `CALL_` bits.
    pub flags: u32,
    /// The host's functions; the same for the life of the plugin.
    pub host: *const Host,
    /// Handle for host functions that take a `call`.
    pub call: *mut c_void,
    /// The node's name in the graph.
    pub node_id: Str,
    /// Values in the order of the type's declaration.
    pub params: *const ParamValue,
    /// Count of `params`.
    pub params_len: usize,
    /// Folder of the graph file, absolute.
    pub graph_dir: Str,
    /// Bit `i` is set when output `i` has a reader (outputs above 63 count as read).
    pub outputs_read: u64,
}

/// Set in [`ValidateCall::flags`] when `connections` and `outputs_read` are known.
pub const CALL_WIRED: u32 = 2;

/// In [`ValidateCall::invalid`]: the node cannot open, or no tick of it can succeed.
pub const PROBLEM_ERROR: u32 = 1;
/// In [`ValidateCall::invalid`]: the node works, but probably not as intended.
pub const PROBLEM_WARNING: u32 = 2;
/// In [`ValidateCall::invalid`]: the problem concerns the whole node, not one parameter.
pub const NO_PARAM: u32 = 0xFFFF_FFFF;

/// Arguments of [`crate::NodeType::validate`].
#[repr(C)]
#[derive(Debug)]
pub struct ValidateCall {
    /// Size of this struct in bytes.
    pub struct_size: u32,
    /// `CALL_` bits.
    pub flags: u32,
    /// Handle for `invalid`.
    pub call: *mut c_void,
    /// The node's name in the graph.
    pub node_id: Str,
    /// Values in the order of the type's declaration.
    pub params: *const ParamValue,
    /// Count of `params`.
    pub params_len: usize,
    /// Folder of the graph file, absolute.
    pub graph_dir: Str,
    /// Number of connections of each declared input.
    pub connections: *const u32,
    /// Count of `connections`; 0 without [`CALL_WIRED`].
    pub connections_len: usize,
    /// Bit `i` is set when output `i` has a reader (outputs above 63 count as read).
    pub outputs_read: u64,
    /// Takes one problem: a `PROBLEM_` severity, the position of the parameter it is about (or [`NO_PARAM`]), what is
    /// wrong in one sentence, and what to do about it (may be empty). Texts are copied.
    pub invalid: Option<unsafe extern "C" fn(call: *mut c_void, severity: u32, param: u32, message: Str, help: Str)>,
}

/// Arguments of [`crate::NodeType::process`].
#[repr(C)]
#[derive(Debug)]
pub struct Call {
    /// Size of this struct in bytes.
    pub struct_size: u32,
    /// `CALL_` bits.
    pub flags: u32,
    /// The host's functions.
    pub host: *const Host,
    /// Handle for host functions that take a `call`.
    pub call: *mut c_void,
    /// The tick being processed. A source may set `capture_ns`; the host numbers it.
    pub tick: Tick,
    /// All input frames, flattened; `input_ranges` says which belong to which port.
    pub inputs: *const Frame,
    /// Count of `inputs`.
    pub inputs_len: usize,
    /// One range per declared input port.
    pub input_ranges: *const PortRange,
    /// Count of `input_ranges`.
    pub input_ranges_len: usize,
    /// One frame per declared output port, empty at the start of the call; filled by [`Host::alloc`] and
    /// [`Host::forward`].
    pub outputs: *mut Frame,
    /// Count of `outputs`.
    pub outputs_len: usize,
    /// Values in the order of the type's declaration.
    pub params: *const ParamValue,
    /// Count of `params`.
    pub params_len: usize,
    /// Changes whenever `params` change.
    pub params_version: u64,
    /// Bit `i` is set when output `i` has a reader (outputs above 63 count as read).
    pub outputs_read: u64,
}

/// Errors that stop a node.
pub const LOG_ERROR: u32 = 1;
/// Something a user should know.
pub const LOG_WARN: u32 = 2;
/// Progress.
pub const LOG_INFO: u32 = 3;
/// Details for debugging the node.
pub const LOG_DEBUG: u32 = 4;

/// Functions of the host. One table per plugin; valid until the process ends.
///
/// Functions that take a `call` expect the handle of the running [`Call`] or [`OpenCall`].
#[repr(C)]
#[derive(Debug)]
pub struct Host {
    /// Size of this struct in bytes: functions past it do not exist in this host.
    pub struct_size: u32,
    /// [`crate::ABI_MAJOR`] of the host.
    pub abi_major: u32,
    /// [`crate::ABI_MINOR`] of the host.
    pub abi_minor: u32,
    /// Threads of the host's pool.
    pub threads: u32,
    /// Handle for `parallel_for`, `retain`, `release` and `resolve`.
    pub ctx: *mut c_void,
    /// Makes output `output` of the running call: a buffer of `len` bytes, described by the other arguments. Contents
    /// are unspecified.
    pub alloc: Option<
        unsafe extern "C" fn(
            call: *mut c_void,
            output: u32,
            format: u32,
            width: u32,
            height: u32,
            stride_bytes: u32,
            len: usize,
        ) -> Status,
    >,
    /// Makes output `output` the same buffer as `frame` (an input of this call, or a retained frame). Nothing is
    /// copied.
    pub forward: Option<unsafe extern "C" fn(call: *mut c_void, output: u32, frame: *const Frame) -> Status>,
    /// Makes sure that output `output` is shared with nobody, by a counted copy if need be, so that it may be written.
    pub make_mut: Option<unsafe extern "C" fn(call: *mut c_void, output: u32) -> Status>,
    /// Keeps a buffer beyond the call.
    pub retain: Option<unsafe extern "C" fn(ctx: *mut c_void, buffer: BufferId)>,
    /// Gives a kept buffer back.
    pub release: Option<unsafe extern "C" fn(ctx: *mut c_void, buffer: BufferId)>,
    /// Address of a buffer that the caller holds; null when there is no such buffer.
    pub resolve: Option<unsafe extern "C" fn(ctx: *mut c_void, buffer: BufferId) -> *mut u8>,
    /// Runs `body(data, i)` for `i` in `0..chunks` on the host's pool; the caller takes part.
    pub parallel_for:
        Option<unsafe extern "C" fn(ctx: *mut c_void, chunks: usize, body: ChunkFn, data: *mut c_void) -> Status>,
    /// A line for the host's log, with the node's name added by the host.
    pub log: Option<unsafe extern "C" fn(call: *mut c_void, level: u32, message: Str)>,
    /// Reports the message of a fault. With `STATUS_ERROR` or `STATUS_PANIC` it says why the call failed; with
    /// `STATUS_END`, why the source ended too early; with `STATUS_OK`, the reported problem, although the node
    /// continues. Each call counts as one fault of the node.
    pub fail: Option<unsafe extern "C" fn(call: *mut c_void, message: Str)>,
    /// A named number of the node, shown next to its timing.
    pub metric: Option<unsafe extern "C" fn(call: *mut c_void, name: Str, value: f64)>,
    /// The next number of a generator seeded by node and tick: the same in every run.
    pub random: Option<unsafe extern "C" fn(call: *mut c_void) -> u64>,
    /// Takes bytes of [`crate::NodeType::save_state`].
    pub save: Option<unsafe extern "C" fn(sink: *mut c_void, bytes: *const u8, len: usize)>,
    /// Claims a file that the node writes, for as long as the instance is open. `action` is a `CLAIM_` constant.
    /// `file`, which may be null, is set to a text that is valid until the call ends. With `STATUS_OK` that is the path
    /// to write. For [`CLAIM_HOLD`] it is the same in the whole run; otherwise it is `path` itself the first time in a
    /// run, later `name.part2.extension` and so on, so that nothing written in this run is cut off. With
    /// `STATUS_INVALID` it is the name of the open node that writes the file, with `STATUS_ERROR` a message: another
    /// run writes it.
    pub claim_file: Option<unsafe extern "C" fn(call: *mut c_void, path: Str, action: u32, file: *mut Str) -> Status>,
    /// The host's monotonic clock in ns: for nodes that note when something happened. What a node makes must not depend
    /// on it.
    pub clock_ns: Option<unsafe extern "C" fn(call: *mut c_void) -> i64>,
    /// For a source: when the light (or the packet) of this tick arrived, by the clock of [`Host::clock_ns`]. All ages
    /// count from there. A time in the future counts as now. Without this call a tick arrives when it enters the graph.
    pub set_arrived_ns: Option<unsafe extern "C" fn(call: *mut c_void, arrived_ns: i64)>,
    /// When the light of an input frame arrived, by the clock of [`Host::clock_ns`]; `input` is an index into
    /// [`Call::inputs`] or [`INPUT_TICK`]. For times between two arrivals. Where results must not depend on the wall
    /// clock (`batch`), the capture time. A replay returns what the recorded run returned. `INT64_MIN` for an empty
    /// frame and where the time is unknown.
    pub arrived_ns: Option<unsafe extern "C" fn(call: *mut c_void, input: u32) -> i64>,
    /// Age of the light of an input frame: the time from [`Host::arrived_ns`] to this call. All answers during one call
    /// are for the same moment; in `batch` that is the capture time of the tick. `INT64_MAX` where `arrived_ns` is
    /// `INT64_MIN`.
    pub age_ns: Option<unsafe extern "C" fn(call: *mut c_void, input: u32) -> i64>,
    /// Declares that the outputs of this call show light older than the tick's by this many ns (held or predicted
    /// values). Readers see this age. An output never looks younger than the oldest input. A source uses
    /// [`Host::set_arrived_ns`].
    pub set_lag_ns: Option<unsafe extern "C" fn(call: *mut c_void, lag_ns: i64)>,
    /// The GPU of this process, opened by the first call. Null when there is none: `reason` then says why.
    pub device: Option<unsafe extern "C" fn(ctx: *mut c_void, reason: *mut Str) -> *const Device>,
    /// The buffer on the GPU with the content of a frame that the caller holds. The content is copied there when it is
    /// not there yet, and the copy is counted. The buffer is lent as long as the frame is held, for reading alone. 0 when
    /// that fails, see [`Device::failure`].
    pub device_buffer: Option<unsafe extern "C" fn(ctx: *mut c_void, frame: *const Frame) -> u64>,
    /// As [`Host::alloc`], with the content on the GPU: the node writes into `buffer`, which is lent as long as the
    /// frame is held.
    pub alloc_on_device: Option<
        unsafe extern "C" fn(
            call: *mut c_void,
            output: u32,
            format: u32,
            width: u32,
            height: u32,
            stride_bytes: u32,
            len: usize,
            buffer: *mut u64,
        ) -> Status,
    >,
    /// Makes sure that the content of a frame that the caller holds is at [`Frame::data`]. A copy from the GPU is
    /// counted. When that fails, the content is black or NaN and the run reports it.
    pub fetch: Option<unsafe extern "C" fn(ctx: *mut c_void, frame: *const Frame) -> Status>,
}

/// For [`Host::arrived_ns`] and [`Host::age_ns`]: the tick of the call, whatever its inputs are.
pub const INPUT_TICK: u32 = 0xFFFF_FFFF;

/// The node is going to write the file: no other node may.
pub const CLAIM_HOLD: u32 = 0;
/// The node begins to write: the returned file may be created or truncated. One of an earlier run is replaced.
pub const CLAIM_BEGIN: u32 = 1;
/// As [`CLAIM_BEGIN`], but the returned path never exists yet.
pub const CLAIM_BEGIN_NEW: u32 = 2;

// SAFETY: the table is immutable and its functions may be called from any thread.
unsafe impl Send for Host {}
// SAFETY: the table is immutable; the host promises that its functions may be called from any thread.
unsafe impl Sync for Host {}
