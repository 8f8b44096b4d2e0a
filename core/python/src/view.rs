//! Frames for Python.

use std::ptr::NonNull;
use std::sync::atomic::{AtomicBool, Ordering};

use panoscope_abi::{BufferId, Frame, Host};
use panoscope_record::digest::packet_hash;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The bytes of a frame: NumPy makes an array over them without a copy. An array keeps its view.
#[pyclass(frozen, module = "panoscope._native")]
pub struct View {
    memory: Memory,
    #[pyo3(get)]
    len: usize,
    #[pyo3(get)]
    format: u32,
    #[pyo3(get)]
    width: u32,
    #[pyo3(get)]
    height: u32,
    #[pyo3(get)]
    stride_bytes: u32,
}

/// Owner of the bytes.
enum Memory {
    /// A frame of a call of a node.
    Lent {
        address: usize,
        is_writable: bool,
        buffer: BufferId,
        host: &'static Host,
        /// Whether it is retained beyond its call; released when the view ends.
        is_retained: AtomicBool,
    },
    /// Owned by the view.
    Own(Bytes),
}

/// Bytes of a view that arrays may write. Only arrays read them.
struct Bytes(NonNull<[u8]>);

// SAFETY: the bytes belong to this value alone; arrays read and write them under the interpreter's lock, as all memory of arrays.
unsafe impl Send for Bytes {}
// SAFETY: as for `Send`.
unsafe impl Sync for Bytes {}

impl From<Vec<u8>> for Bytes {
    fn from(bytes: Vec<u8>) -> Self {
        Self(NonNull::from(Box::leak(bytes.into_boxed_slice())))
    }
}

impl Drop for Bytes {
    fn drop(&mut self) {
        // SAFETY: made by `From` from a box and given back once; arrays keep the view, and with it this value.
        drop(unsafe { Box::from_raw(self.0.as_ptr()) });
    }
}

impl View {
    /// A view of a frame of the running call.
    pub fn new(frame: &Frame, host: &'static Host, is_writable: bool) -> Self {
        let (address, is_retained) = (frame.data.addr(), AtomicBool::new(false));
        Self::of(frame, Memory::Lent { address, is_writable, buffer: frame.buffer, host, is_retained })
    }

    /// A view of a copy of a frame's bytes.
    pub fn own(frame: &Frame, bytes: Vec<u8>) -> Self {
        let frame = Frame { len: bytes.len(), ..*frame };
        Self::of(&frame, Memory::Own(bytes.into()))
    }

    fn of(frame: &Frame, memory: Memory) -> Self {
        let Frame { len, format, width, height, stride_bytes, .. } = *frame;
        Self { memory, len, format, width, height, stride_bytes }
    }

    /// Keeps the frame until the view ends. Called before the call ends for each remaining view.
    pub fn retain(&self) {
        if let Memory::Lent { buffer, host, is_retained, .. } = &self.memory
            && let Some(retain) = host.retain
            && !is_retained.swap(true, Ordering::AcqRel)
        {
            // SAFETY: the table lives until the process ends; the call that lent the buffer still runs.
            unsafe { retain(host.ctx, *buffer) };
        }
    }

    /// Address of the bytes.
    pub fn address(&self) -> usize {
        match &self.memory {
            Memory::Lent { address, .. } => *address,
            Memory::Own(bytes) => bytes.0.as_ptr().cast::<u8>().addr(),
        }
    }
}

impl Drop for View {
    fn drop(&mut self) {
        if let Memory::Lent { buffer, host, is_retained, .. } = &mut self.memory
            && let Some(release) = host.release
            && *is_retained.get_mut()
        {
            // SAFETY: retained once by `retain`.
            unsafe { release(host.ctx, *buffer) };
        }
    }
}

#[pymethods]
impl View {
    /// The bytes for NumPy.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let is_writable = match &self.memory {
            Memory::Lent { is_writable, .. } => *is_writable,
            Memory::Own(_) => true,
        };
        let interface = PyDict::new(py);
        interface.set_item("shape", (self.len,))?;
        interface.set_item("typestr", "|u1")?;
        interface.set_item("data", (self.address(), !is_writable))?;
        interface.set_item("version", 3)?;
        Ok(interface)
    }

    /// Fingerprint of the bytes as in recordings and `panoscope compare`. Only for packets of a run or a recording.
    fn fingerprint(&self) -> Option<u64> {
        let Memory::Own(bytes) = &self.memory else { return None };
        let Self { format, width, height, stride_bytes, .. } = *self;
        let frame = Frame { format, width, height, stride_bytes, ..Frame::EMPTY };
        // SAFETY: bytes of this view; whoever writes them does so under the interpreter's lock, which the caller holds.
        Some(packet_hash(&frame, unsafe { bytes.0.as_ref() }))
    }
}
