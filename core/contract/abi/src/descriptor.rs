use core::ffi::c_void;

use crate::{Call, Host, Note, OpenCall, Status, Str, ValidateCall};

/// Short calculation, runs on the shared pool or inline after its producer.
pub const KIND_COMPUTE: u32 = 0;
/// May wait (grab, inference, encode, serial): owns a thread.
pub const KIND_BLOCKING: u32 = 1;
/// Control loop: owns a thread with real-time priority where the system allows it.
pub const KIND_REALTIME: u32 = 2;

/// The node makes ticks: it runs without waiting for any input.
pub const NODE_SOURCE: u32 = 1;
/// The node owns a device: two instances cannot be open at once.
pub const NODE_EXCLUSIVE: u32 = 2;
/// The node acts on the world outside the graph (writes files, moves an arm).
pub const NODE_SIDE_EFFECTS: u32 = 4;
/// The node calls [`Host::fetch`] before it reads a frame of [`crate::HOME_DEVICE`]. For other nodes the host fetches
/// all inputs before each call. Since `ABI_MINOR` 6.
pub const NODE_FETCHES: u32 = 8;

/// The input may stay unconnected, and may be empty for a tick.
pub const PORT_OPTIONAL: u32 = 1;
/// The input takes any number of frames.
pub const PORT_LIST: u32 = 2;

/// `true` or `false`.
pub const PARAM_BOOL: u32 = 1;
/// A whole number.
pub const PARAM_INT: u32 = 2;
/// A number.
pub const PARAM_FLOAT: u32 = 3;
/// One of a fixed list of names.
pub const PARAM_CHOICE: u32 = 4;
/// Any text.
pub const PARAM_TEXT: u32 = 5;
/// A file or folder, relative to the graph file.
pub const PARAM_PATH: u32 = 6;
/// A list of numbers.
pub const PARAM_FLOATS: u32 = 7;

/// A change closes the node and reopens it.
pub const PARAM_REOPEN: u32 = 1;
/// The file named by the path must exist when the graph is checked.
pub const PARAM_MUST_EXIST: u32 = 2;
/// The numbers are points of an image in px: u, v, u, v, ... The image is the first one that the node reads, or the
/// first one that a source makes.
pub const PARAM_POINTS: u32 = 4;
/// The numbers are rectangles of an image in px: x, y, width, height, ... The image is as for points.
pub const PARAM_RECTANGLES: u32 = 8;
/// The text may name a file or folder, relative to the graph file.
pub const PARAM_FILE: u32 = 16;
/// The node writes the file that the path names; the path may hold placeholders such as `{seq}`.
pub const PARAM_WRITES: u32 = 32;
/// The default of the path names a file that comes with the plugin: relative to the folder next to the plugin's library
/// that has the plugin's name, not to the graph file.
pub const PARAM_SHIPPED: u32 = 64;

/// Bit of [`crate::FORMAT_GRAY8`] and so on in [`Port::formats`].
pub const fn format_bit(format: u32) -> u32 {
    1 << format
}

/// An input or output of a node type.
#[repr(C)]
#[derive(Debug)]
pub struct Port {
    /// Name in graph files.
    pub name: Str,
    /// Description of the data, for users.
    pub doc: Str,
    /// Name of the packet type: `image`, `disparity`, ... or a plugin's own.
    pub packet: Str,
    /// Hash of the packet's memory layout; 0 for types without fixed layout.
    pub layout_hash: u64,
    /// Bit set of formats that an input takes or an output may make; 0 for plain data.
    pub formats: u32,
    /// `PORT_` bits.
    pub flags: u32,
}

/// A parameter of a node type.
#[repr(C)]
#[derive(Debug)]
pub struct Param {
    /// Name in graph files.
    pub name: Str,
    /// Description of its effect, for users.
    pub doc: Str,
    /// Unit such as `px`, `mm`, `ms`; empty for none.
    pub unit: Str,
    /// One of the `PARAM_` kinds.
    pub kind: u32,
    /// `PARAM_REOPEN`, `PARAM_MUST_EXIST`, `PARAM_POINTS`, `PARAM_RECTANGLES`, `PARAM_FILE`, `PARAM_WRITES`,
    /// `PARAM_SHIPPED`.
    pub flags: u32,
    /// Default of `PARAM_BOOL`, `PARAM_INT`, `PARAM_FLOAT`; index of the default `PARAM_CHOICE`.
    pub default_number: f64,
    /// Smallest value of `PARAM_INT` and `PARAM_FLOAT`; fewest entries of `PARAM_FLOATS`.
    pub min: f64,
    /// Largest value of `PARAM_INT` and `PARAM_FLOAT`; most entries of `PARAM_FLOATS`.
    pub max: f64,
    /// Distance of neighbouring values; 0 when any value is fine.
    pub step: f64,
    /// Default of `PARAM_TEXT` and `PARAM_PATH`.
    pub default_text: Str,
    /// Names of the entries of a `PARAM_CHOICE`.
    pub choices: *const Str,
    /// Count of `choices`.
    pub choices_len: usize,
    /// Default of `PARAM_FLOATS`.
    pub default_floats: *const f64,
    /// Count of `default_floats`.
    pub default_floats_len: usize,
}

/// A node type that a plugin offers.
#[repr(C)]
#[derive(Debug)]
pub struct NodeType {
    /// Size of this struct in bytes.
    pub struct_size: u32,
    /// One of the `KIND_` constants.
    pub kind: u32,
    /// `NODE_` bits.
    pub flags: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// Name in graph files.
    pub name: Str,
    /// Family: source, stereo, stitch, tools, arm, overlay, sink, filter.
    pub family: Str,
    /// Description of the node, for users.
    pub doc: Str,
    /// Input ports.
    pub inputs: *const Port,
    /// Count of `inputs`.
    pub inputs_len: usize,
    /// Output ports.
    pub outputs: *const Port,
    /// Count of `outputs`.
    pub outputs_len: usize,
    /// Parameters.
    pub params: *const Param,
    /// Count of `params`.
    pub params_len: usize,
    /// Makes an instance. May take long; runs off the hot path.
    pub open: Option<unsafe extern "C" fn(open: *mut OpenCall, instance: *mut *mut c_void) -> Status>,
    /// Processes one tick. One call at a time per instance, from any thread.
    pub process: Option<unsafe extern "C" fn(instance: *mut c_void, call: *mut Call) -> Status>,
    /// Finishes files, gives back devices and frees the instance.
    pub close: Option<unsafe extern "C" fn(instance: *mut c_void)>,
    /// Optional: passes the instance's state to [`Host::save`].
    pub save_state: Option<unsafe extern "C" fn(instance: *mut c_void, host: *const Host, sink: *mut c_void) -> Status>,
    /// Optional: takes the bytes that an earlier instance saved.
    pub load_state: Option<unsafe extern "C" fn(instance: *mut c_void, bytes: *const u8, len: usize) -> Status>,
    /// Optional: reports to [`ValidateCall::invalid`] parameters and wiring that [`NodeType::open`] or the first tick
    /// would refuse. Opens no device, writes nothing and makes no instance; may be called at any time, from any thread.
    /// Since `ABI_MINOR` 2.
    pub validate: Option<unsafe extern "C" fn(call: *mut ValidateCall) -> Status>,
    /// Optional: completes files before [`NodeType::close`] and reports through [`Host::fail`] what could not be
    /// written. `call` is the handle for host functions that take one. Since `ABI_MINOR` 2.
    pub finish: Option<unsafe extern "C" fn(instance: *mut c_void, host: *const Host, call: *mut c_void) -> Status>,
}

impl NodeType {
    /// Bytes of the descriptor of the first minor version: fields after it may be missing.
    pub const FIRST_SIZE: usize = core::mem::offset_of!(NodeType, validate);

    /// [`NodeType::finish`]; `None` when the plugin is older than this field.
    pub fn finish_function(
        &self,
    ) -> Option<unsafe extern "C" fn(instance: *mut c_void, host: *const Host, call: *mut c_void) -> Status> {
        let end = core::mem::offset_of!(NodeType, finish) + size_of::<usize>();
        if self.struct_size as usize >= end { self.finish } else { None }
    }
}

/// Descriptor that a plugin exports.
#[repr(C)]
#[derive(Debug)]
pub struct Plugin {
    /// [`crate::MAGIC`].
    pub magic: u64,
    /// [`crate::ABI_MAJOR`] that the plugin was built with.
    pub abi_major: u32,
    /// [`crate::ABI_MINOR`] that the plugin was built with.
    pub abi_minor: u32,
    /// Size of this struct in bytes.
    pub struct_size: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// Name in a graph's `plugins` list.
    pub name: Str,
    /// Version for people.
    pub version: Str,
    /// Purpose of the plugin.
    pub doc: Str,
    /// Node types, one pointer each.
    pub node_types: *const *const NodeType,
    /// Count of `node_types`.
    pub node_types_len: usize,
    /// The note that the ELF file carries; keeps it linked.
    pub note: *const Note,
    /// Called once after loading with the host's functions.
    pub attach: Option<unsafe extern "C" fn(host: *const Host) -> Status>,
}

// SAFETY: descriptors are immutable statics of the plugin, which stays mapped.
unsafe impl Send for Plugin {}
// SAFETY: descriptors are immutable statics of the plugin, which the host never unmaps.
unsafe impl Sync for Plugin {}
// SAFETY: descriptors are immutable statics of the plugin, which the host never unmaps.
unsafe impl Send for NodeType {}
// SAFETY: descriptors are immutable statics of the plugin, which the host never unmaps.
unsafe impl Sync for NodeType {}
// SAFETY: descriptors are immutable statics of the plugin, which the host never unmaps.
unsafe impl Send for Port {}
// SAFETY: descriptors are immutable statics of the plugin, which the host never unmaps.
unsafe impl Sync for Port {}
// SAFETY: descriptors are immutable statics of the plugin, which the host never unmaps.
unsafe impl Send for Param {}
// SAFETY: descriptors are immutable statics of the plugin, which the host never unmaps.
unsafe impl Sync for Param {}

/// Type of [`crate::ENTRY_SYMBOL`].
pub type Entry = unsafe extern "C" fn() -> *const Plugin;
