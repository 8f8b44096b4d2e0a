//! Frames and times in the messages of a lane.

use panoscope_abi::{self as abi, BufferId};

use super::RelayError;
use crate::isolate::wire::lane::{self, CopyWanted, Kind, Made, Reserved, TickDone, TickRequest, after_deferred};
use crate::isolate::wire::{Reader, Wire, put_bytes, whole};

/// The bytes of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes {
    /// Number of its pool.
    pub pool: u32,
    /// Offset of its buffer in the pool.
    pub offset: u64,
    /// Length in bytes.
    pub len: u64,
    /// Whether they are pixels.
    pub is_pixels: bool,
    /// Columns, rows and bytes from row to row of an image of 8-bit blue, green and red; `None` for other frames.
    pub colour_px: Option<(u32, u32, u32)>,
    /// How often the buffer was handed out, if the host states it: while the number is the same, the bytes are
    /// unchanged. 0 if unknown.
    pub uses: u32,
}

impl Bytes {
    fn of(frame: &abi::Frame) -> Self {
        let BufferId { pool, offset, .. } = frame.buffer;
        let colour_px = (frame.format == abi::FORMAT_BGR8).then_some((frame.width, frame.height, frame.stride_bytes));
        Self { pool, offset, len: frame.len as u64, is_pixels: frame.format != abi::FORMAT_BYTES, colour_px, uses: 0 }
    }
}

/// The request of a tick that a host sends to a link.
#[derive(Clone, Debug)]
pub struct Request(TickRequest);

impl Request {
    /// Decodes it.
    ///
    /// # Errors
    /// It is malformed.
    pub fn read(message: &[u8]) -> Result<Self, RelayError> {
        Ok(Self(whole(message)?))
    }

    /// The inputs that are not empty.
    pub fn inputs(&self) -> impl Iterator<Item = Bytes> {
        let uses = self.0.uses.iter().chain(std::iter::repeat(&0));
        let all = self.0.inputs.iter().zip(uses).filter(|(frame, _)| !frame.is_empty());
        all.map(|(frame, uses)| Bytes { uses: *uses, ..Bytes::of(frame) })
    }

    /// Buffers for outputs, of which the node makes new frames: pool and offset.
    pub fn reserved(&self) -> impl Iterator<Item = (u32, u64)> {
        self.0
            .stock
            .iter()
            .filter(|reserved| reserved.len > 0)
            .map(|Reserved { buffer, .. }| (buffer.pool, buffer.offset))
    }

    /// The host's clock minus its system's, ns, if the host sends them. Its system's clock is then moved by `by_ns` to
    /// that of the other machine.
    pub fn move_clock(&mut self, by_ns: i64) -> Option<i64> {
        let clock = self.0.clock.as_mut()?;
        let difference_ns = clock.host_ns.saturating_sub(clock.system_ns);
        clock.system_ns = clock.system_ns.saturating_add(by_ns);
        Some(difference_ns)
    }

    /// Replaces each path parameter `p` by `path(p)`.
    ///
    /// # Errors
    /// A path is not UTF-8.
    pub fn replace_paths(&mut self, path: impl Fn(&str) -> String) -> Result<(), RelayError> {
        Ok(self.0.params.as_mut().map_or(Ok(()), |params| params.replace_paths(path))?)
    }

    /// Encodes it in place of a message.
    pub fn write(&self, message: &mut Vec<u8>) {
        message.clear();
        self.0.put(message);
    }
}

/// Whether a result reports success.
///
/// # Errors
/// It is malformed.
pub fn succeeded(done: &[u8]) -> Result<bool, RelayError> {
    Ok(after_deferred(done)?.take::<abi::Status>()? == abi::STATUS_OK)
}

/// The outputs that are not empty, in the result of a tick.
///
/// # Errors
/// It is malformed.
pub fn outputs(done: &[u8]) -> Result<Vec<Bytes>, RelayError> {
    let mut reader = after_deferred(done)?;
    reader.take::<abi::Status>()?;
    let made = reader.take::<TickDone>()?.outputs;
    Ok(made.iter().filter(|frame| !frame.is_empty()).map(Bytes::of).collect())
}

/// The frame that the host made for a node, if it made one, in the answer to [`super::kind::ALLOC`] or
/// [`super::kind::MAKE_MUT`].
///
/// # Errors
/// It is malformed.
pub fn answered(answer: &[u8]) -> Result<Option<Bytes>, RelayError> {
    let Made { status, frame } = whole(answer)?;
    Ok((status == abi::STATUS_OK && !frame.is_empty()).then(|| Bytes::of(&frame)))
}

/// The frame that [`super::kind::MAKE_MUT`] wants a copy of.
///
/// # Errors
/// It is malformed.
pub fn made_copy(message: &[u8]) -> Result<Bytes, RelayError> {
    Ok(Bytes::of(&after_deferred(message)?.take::<CopyWanted>()?.frame))
}

/// Inserts the arrival of a tick's light, ns of the host's clock, before the functions that the process deferred. An
/// arrival that the source itself sets comes later and takes effect.
///
/// # Errors
/// The message is malformed.
pub fn arrived(message: &[u8], arrived_ns: i64, out: &mut Vec<u8>) -> Result<(), RelayError> {
    let mut reader = Reader(message);
    let written = reader.bytes()?;
    let mut deferred = Vec::with_capacity(written.len() + 12);
    (Kind::SetArrived as u32).put(&mut deferred);
    arrived_ns.put(&mut deferred);
    deferred.extend_from_slice(written);
    out.clear();
    put_bytes(&deferred, out);
    out.extend_from_slice(reader.0);
    Ok(())
}

/// The request to open an instance that a host sends to a link.
#[derive(Clone, Debug)]
pub struct Open(lane::Open);

impl Open {
    /// Decodes it.
    ///
    /// # Errors
    /// It is malformed.
    pub fn read(message: &[u8]) -> Result<Self, RelayError> {
        let open = whole::<lane::Open>(message)?;
        let names = |at: &u32| open.params.text(*at).is_some();
        if open.reads.iter().all(names) { Ok(Self(open)) } else { Err(RelayError::Bad) }
    }

    /// The node's name.
    pub fn node(&self) -> &str {
        &self.0.node
    }

    /// Folder of the graph.
    pub fn graph_dir(&self) -> &str {
        &self.0.graph_dir
    }

    /// Files that the node reads according to its declaration, absolute.
    pub fn files(&self) -> impl Iterator<Item = &str> {
        self.0.reads.iter().filter_map(|at| self.0.params.text(*at)).filter(|text| !text.is_empty())
    }

    /// Replaces the folder of the graph, and each path parameter `p` by `path(p)`.
    ///
    /// # Errors
    /// A path is not UTF-8.
    pub fn replace_paths(&mut self, graph_dir: String, path: impl Fn(&str) -> String) -> Result<(), RelayError> {
        self.0.graph_dir = graph_dir;
        Ok(self.0.params.replace_paths(path)?)
    }

    /// Encodes it in place of a message.
    pub fn write(&self, message: &mut Vec<u8>) {
        message.clear();
        self.0.put(message);
    }
}
