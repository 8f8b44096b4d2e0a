use core::ffi::c_void;

/// Identity and time of the data that one source call made.
///
/// All ports of one source call share it. `capture_ns` is media time: deterministic and visible to nodes.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tick {
    /// Which source of the graph.
    pub source: u32,
    /// Lag of the packet's light behind that of its tick: of the oldest light in the upper 20 bits, of the newest in
    /// the lower 12. Both are rounded up to 10 us and have a 5-bit exponent above their digits. The host sets it; see
    /// [`crate::Host::set_lag_ns`].
    pub flags: u32,
    /// Counts the source's calls from 0.
    pub seq: u64,
    /// Media time of the capture in nanoseconds.
    pub capture_ns: i64,
}

/// Names a buffer of the host without an address, so that it means the same in another process.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BufferId {
    /// Pool number; 0 means no buffer.
    pub pool: u32,
    /// Where its content is, a `HOME_` constant.
    pub home: u32,
    /// Byte offset of the buffer in its pool.
    pub offset: u64,
}

/// In [`BufferId::home`]: the content is at [`Frame::data`].
pub const HOME_HOST: u32 = 0;
/// In [`BufferId::home`]: the content may be in the memory of the GPU alone. Before reading [`Frame::data`] a node calls
/// [`crate::Host::fetch`]. Only nodes with [`crate::NODE_FETCHES`] get such frames.
pub const HOME_DEVICE: u32 = 1;

/// Payload is raw bytes or plain data of the port's packet type.
pub const FORMAT_BYTES: u32 = 0;
/// One byte per pixel.
pub const FORMAT_GRAY8: u32 = 1;
/// Three bytes per pixel in the order blue, green, red.
pub const FORMAT_BGR8: u32 = 2;
/// Four bytes per pixel in the order red, green, blue, alpha.
pub const FORMAT_RGBA8: u32 = 3;
/// One 16-bit unsigned number per pixel.
pub const FORMAT_GRAY16: u32 = 4;
/// One 32-bit float per pixel.
pub const FORMAT_F32: u32 = 5;
/// Sixteen bytes per point, see [`crate::CloudPoint`].
pub const FORMAT_CLOUD: u32 = 6;

/// One packet as a node sees it: a borrowed buffer and the layout of its content.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// The buffer; `pool` 0 means that the port is empty for this tick.
    pub buffer: BufferId,
    /// First byte of the payload; valid during the call. See [`BufferId::home`].
    pub data: *mut u8,
    /// Bytes in use.
    pub len: usize,
    /// One of the `FORMAT_` constants.
    pub format: u32,
    /// Columns in pixels; for plain data 0.
    pub width: u32,
    /// Rows; for plain data 0.
    pub height: u32,
    /// Bytes from one row's start to the next one's.
    pub stride_bytes: u32,
    /// The tick whose data this is.
    pub tick: Tick,
}

impl Frame {
    /// An empty port.
    pub const EMPTY: Frame = Frame {
        buffer: BufferId { pool: 0, home: HOME_HOST, offset: 0 },
        data: core::ptr::null_mut(),
        len: 0,
        format: 0,
        width: 0,
        height: 0,
        stride_bytes: 0,
        tick: Tick { source: 0, flags: 0, seq: 0, capture_ns: 0 },
    };

    /// Whether the port holds nothing for this tick.
    pub const fn is_empty(&self) -> bool {
        self.buffer.pool == 0
    }
}

// SAFETY: a `Frame` is a description; the buffer behind it is shared under the host's reference count.
unsafe impl Send for Frame {}
// SAFETY: a `Frame` is a description; the buffer behind it is shared under the host's reference count, and no reader writes it.
unsafe impl Sync for Frame {}

/// Which of the flattened [`crate::Call::inputs`] belong to one input port.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortRange {
    /// Index of the first frame.
    pub first: u32,
    /// Number of frames; 1 except for list ports.
    pub count: u32,
}

/// One chunk of a [`crate::Host::parallel_for`] loop. Must not unwind.
pub type ChunkFn = Option<unsafe extern "C" fn(data: *mut c_void, chunk: usize)>;
