//! Frames as Python sees them.

use std::sync::atomic::{AtomicBool, Ordering};

use panoscope_abi::{BufferId, Frame, Host};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The bytes of a frame: NumPy makes an array over them without a copy. A view that is kept keeps its frame.
#[pyclass(frozen, module = "panoscope._native")]
pub struct View {
    address: usize,
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
    is_writable: bool,
    buffer: BufferId,
    host: &'static Host,
    /// Kept beyond its call: given back when the view ends.
    is_retained: AtomicBool,
}

impl View {
    /// A view of a frame of the running call.
    pub fn new(frame: &Frame, host: &'static Host, is_writable: bool) -> Self {
        let Frame { len, format, width, height, stride_bytes, buffer, .. } = *frame;
        let (address, is_retained) = (frame.data.addr(), AtomicBool::new(false));
        Self { address, len, format, width, height, stride_bytes, is_writable, buffer, host, is_retained }
    }

    /// Keeps the frame until the view ends. Called before the call ends for a view that somebody still has.
    pub fn retain(&self) {
        if let Some(retain) = self.host.retain
            && !self.is_retained.swap(true, Ordering::AcqRel)
        {
            // SAFETY: the table lives until the process ends; the call that lent the buffer still runs.
            unsafe { retain(self.host.ctx, self.buffer) };
        }
    }
}

impl Drop for View {
    fn drop(&mut self) {
        if let Some(release) = self.host.release
            && *self.is_retained.get_mut()
        {
            // SAFETY: retained once by `retain`.
            unsafe { release(self.host.ctx, self.buffer) };
        }
    }
}

#[pymethods]
impl View {
    /// The bytes for NumPy.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let interface = PyDict::new(py);
        interface.set_item("shape", (self.len,))?;
        interface.set_item("typestr", "|u1")?;
        interface.set_item("data", (self.address, !self.is_writable))?;
        interface.set_item("version", 3)?;
        Ok(interface)
    }
}
