//! Frames and times in the messages of a lane.

use panoscope_abi::{self as abi, BufferId};

use super::RelayError;
use crate::isolate::wire::{Kind, Reader, Writer};

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

/// The request of a tick.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// The inputs that are not empty.
    pub inputs: Vec<Bytes>,
    /// Buffers for outputs, of which the node makes new frames: pool and offset.
    pub reserved: Vec<(u32, u64)>,
    /// The host's clock and its system's clock at that moment, ns.
    pub clock: Option<(i64, i64)>,
    /// Offset of the second of these in the message: eight bytes, little-endian.
    pub clock_position: usize,
}

/// Decodes the request of a tick that a host sends to a link.
///
/// # Errors
/// It is malformed.
pub fn request(message: &[u8]) -> Result<Request, RelayError> {
    let mut reader = Reader(message);
    let mut request = Request::default();
    reader.u32()?;
    reader.tick()?;
    reader.u64()?;
    reader.u64()?;
    if reader.u32()? == 1 {
        reader.params()?;
    }
    for _ in 0..reader.count(8)? {
        reader.u64()?;
    }
    let inputs = reader.count(1)?;
    let mut all = Vec::with_capacity(inputs);
    for _ in 0..inputs {
        all.push(reader.frame()?);
    }
    for _ in 0..reader.count(20)? {
        let (buffer, size) = (reader.buffer()?, reader.u64()?);
        if size > 0 {
            request.reserved.push((buffer.pool, buffer.offset));
        }
    }
    let knows_clock = reader.u32()? == 1;
    let clock_ns = reader.i64()?;
    request.clock_position = message.len() - reader.0.len();
    let system_ns = reader.i64()?;
    request.clock = knows_clock.then_some((clock_ns, system_ns));
    for _ in 0..reader.count(20)? {
        reader.u32()?;
        reader.u64()?;
        reader.u64()?;
    }
    for frame in all {
        let uses = reader.u32()?;
        if !frame.is_empty() {
            request.inputs.push(Bytes { uses, ..Bytes::of(&frame) });
        }
    }
    Ok(request)
}

/// Whether a result reports success.
///
/// # Errors
/// It is malformed.
pub fn succeeded(done: &[u8]) -> Result<bool, RelayError> {
    let mut reader = Reader(done);
    reader.bytes()?;
    Ok(reader.i32()? == abi::STATUS_OK)
}

/// The outputs that are not empty, in the result of a tick.
///
/// # Errors
/// It is malformed.
pub fn outputs(done: &[u8]) -> Result<Vec<Bytes>, RelayError> {
    let mut reader = Reader(done);
    reader.bytes()?;
    reader.i32()?;
    reader.tick()?;
    let mut outputs = Vec::new();
    for _ in 0..reader.count(1)? {
        let frame = reader.frame()?;
        if !frame.is_empty() {
            outputs.push(Bytes::of(&frame));
        }
    }
    Ok(outputs)
}

/// The frame that the host made for a node, if it made one, in the answer to [`super::kind::ALLOC`] or
/// [`super::kind::MAKE_MUT`].
///
/// # Errors
/// It is malformed.
pub fn answered(answer: &[u8]) -> Result<Option<Bytes>, RelayError> {
    let mut reader = Reader(answer);
    let (status, frame) = (reader.i32()?, reader.frame()?);
    Ok((status == abi::STATUS_OK && !frame.is_empty()).then(|| Bytes::of(&frame)))
}

/// The frame that [`super::kind::MAKE_MUT`] wants a copy of.
///
/// # Errors
/// It is malformed.
pub fn made_copy(message: &[u8]) -> Result<Bytes, RelayError> {
    let mut reader = Reader(message);
    reader.bytes()?;
    reader.u32()?;
    Ok(Bytes::of(&reader.frame()?))
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
    Writer(&mut deferred).u32(Kind::SetArrived as u32).i64(arrived_ns);
    deferred.extend_from_slice(written);
    out.clear();
    Writer(out).bytes(&deferred);
    out.extend_from_slice(reader.0);
    Ok(())
}

/// Content of a request to open an instance.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Open {
    /// Number of the plugin.
    pub plugin: u32,
    /// The node's name.
    pub node: String,
    /// Folder of the graph.
    pub graph_dir: String,
    /// Files that the node reads according to its declaration, absolute.
    pub files: Vec<String>,
}

/// Decodes the request to open an instance that a host sends to a link.
///
/// # Errors
/// It is malformed.
pub fn open(message: &[u8]) -> Result<Open, RelayError> {
    let mut reader = Reader(message);
    let plugin = reader.u32()?;
    for _ in 0..3 {
        reader.u32()?;
    }
    reader.u64()?;
    let (node, graph_dir) = (reader.text()?.to_owned(), reader.text()?.to_owned());
    let params = reader.params()?;
    let mut files = Vec::new();
    for _ in 0..reader.count(4)? {
        let value = params.values.get(reader.u32()? as usize).ok_or(RelayError::Bad)?;
        // SAFETY: the text lives in `params`.
        if let Some(text) = unsafe { value.text.text() }.filter(|text| !text.is_empty()) {
            files.push(text.to_owned());
        }
    }
    Ok(Open { plugin, node, graph_dir, files })
}

/// The request to open an instance or that of a tick, with replaced paths: `graph_dir` for the folder of the graph, and
/// `path(p)` for each path parameter `p`.
///
/// # Errors
/// The message is malformed.
pub fn with_paths(
    kind: u32,
    message: &[u8],
    graph_dir: &str,
    path: impl Fn(&str) -> String,
) -> Result<Vec<u8>, RelayError> {
    let mut reader = Reader(message);
    let mut out = Vec::with_capacity(message.len() + 256);
    if kind == Kind::Open as u32 {
        for _ in 0..4 {
            reader.u32()?;
        }
        reader.u64()?;
        reader.bytes()?;
        out.extend_from_slice(&message[..message.len() - reader.0.len()]);
        reader.bytes()?;
        Writer(&mut out).bytes(graph_dir.as_bytes());
    } else {
        reader.u32()?;
        reader.tick()?;
        reader.u64()?;
        reader.u64()?;
        if reader.u32()? != 1 {
            return Ok(message.to_vec());
        }
        out.extend_from_slice(&message[..message.len() - reader.0.len()]);
    }
    let mut params = reader.params()?;
    let mut texts: Vec<String> = Vec::with_capacity(params.values.len());
    for value in params.values.iter().filter(|value| value.kind == abi::PARAM_PATH) {
        // SAFETY: the text lives in `params`.
        texts.push(path(unsafe { value.text.text() }.ok_or(RelayError::Bad)?));
    }
    for (value, text) in params.values.iter_mut().filter(|value| value.kind == abi::PARAM_PATH).zip(&texts) {
        value.text = abi::Str::borrow(text);
    }
    // SAFETY: the values with all that they point to live in `params` and `texts`.
    unsafe { Writer(&mut out).params(params.values.as_ptr(), params.values.len()) };
    out.extend_from_slice(reader.0);
    Ok(out)
}
