//! The running call of an instance, for Python.

use std::ptr::null_mut;
use std::sync::atomic::{AtomicPtr, Ordering};
use std::sync::{Mutex, PoisonError};

use panoscope_abi::{self as abi, Frame, Host, Status, Str};
use pyo3::exceptions::{PyMemoryError, PyRuntimeError, PyValueError};
use pyo3::ffi;
use pyo3::prelude::*;

use crate::view::View;

/// Services of the host during a node's `process`. Outside of it every method raises.
///
/// The pointer is set and cleared by the thread of the call while it holds the interpreter's lock, and every method
/// holds that lock.
#[pyclass(frozen, module = "panoscope._native")]
pub struct Call {
    running: AtomicPtr<abi::Call>,
    host: &'static Host,
    /// Views made in this call.
    views: Mutex<Vec<Py<View>>>,
}

impl Call {
    /// State of an instance without a running call.
    pub fn new(host: &'static Host) -> Self {
        Self { running: AtomicPtr::new(null_mut()), host, views: Mutex::default() }
    }

    /// Begins a call.
    pub fn begin(&self, call: *mut abi::Call) {
        self.running.store(call, Ordering::Release);
    }

    /// Ends a call; frames with remaining views are retained.
    pub fn end(&self, _locked: Python<'_>) {
        for view in self.views.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
            // SAFETY: a live object, under the interpreter's lock.
            if unsafe { ffi::Py_REFCNT(view.as_ptr()) } > 1 {
                view.get().retain();
            }
        }
        self.running.store(null_mut(), Ordering::Release);
    }

    /// A view of a frame of the call.
    pub fn view(&self, py: Python<'_>, frame: &Frame, is_writable: bool) -> PyResult<Py<View>> {
        let view = Py::new(py, View::new(frame, self.host, is_writable))?;
        self.views.lock().unwrap_or_else(PoisonError::into_inner).push(view.clone_ref(py));
        Ok(view)
    }

    fn running(&self) -> PyResult<&abi::Call> {
        // SAFETY: not null only while the call runs; see the type about who may be here meanwhile.
        let running = unsafe { self.running.load(Ordering::Acquire).as_ref() };
        running.ok_or_else(|| PyRuntimeError::new_err("this works only while the node's `process` runs"))
    }

    /// Forwards the first matching input frame as an output.
    fn forward_one(&self, output: u32, fits: impl Fn(&Frame) -> bool) -> PyResult<bool> {
        let call = self.running()?;
        let inputs = match call.inputs_len {
            0 => &[],
            // SAFETY: `inputs` has `inputs_len` frames for the length of the call.
            len => unsafe { std::slice::from_raw_parts(call.inputs, len) },
        };
        let found = inputs.iter().find(|frame| !frame.is_empty() && fits(frame));
        let (Some(frame), Some(forward)) = (found, self.host.forward) else { return Ok(false) };
        // SAFETY: the handle of the running call, and one of its inputs.
        let status: Status = unsafe { forward(call.call, output, frame) };
        Ok(status == abi::STATUS_OK)
    }

    /// Output `output` of the call.
    fn output(call: &abi::Call, output: u32) -> Option<Frame> {
        // SAFETY: `outputs` has `outputs_len` frames for the length of the call.
        ((output as usize) < call.outputs_len).then(|| unsafe { call.outputs.add(output as usize).read() })
    }
}

#[pymethods]
impl Call {
    /// Makes an output of `len` bytes and returns a writable view of it.
    fn alloc(
        &self,
        py: Python<'_>,
        output: u32,
        format: u32,
        width: u32,
        height: u32,
        stride_bytes: u32,
        len: usize,
    ) -> PyResult<Py<View>> {
        let call = self.running()?;
        // SAFETY: the handle of the running call.
        let status = self.host.alloc.map_or(abi::STATUS_INVALID, |alloc| unsafe {
            alloc(call.call, output, format, width, height, stride_bytes, len)
        });
        match (status, Self::output(call, output)) {
            (abi::STATUS_OK, Some(frame)) => self.view(py, &frame, true),
            (abi::STATUS_EXHAUSTED, _) => {
                Err(PyMemoryError::new_err(format!("no frame memory of {len} bytes is left")))
            }
            _ => {
                Err(PyValueError::new_err(format!("the host refuses a frame of {width}x{height} for output {output}")))
            }
        }
    }

    /// Whether output `output` was made by [`Self::alloc`] at `address` with `len` bytes.
    fn is_made(&self, output: u32, address: usize, len: usize) -> PyResult<bool> {
        let frame = Self::output(self.running()?, output);
        Ok(frame.is_some_and(|frame| !frame.is_empty() && frame.data.addr() == address && frame.len == len))
    }

    /// Forwards the input frame at `address` with this description, if there is one, as an output. Nothing is copied.
    fn forward(
        &self,
        output: u32,
        address: usize,
        format: u32,
        width: u32,
        height: u32,
        stride_bytes: u32,
    ) -> PyResult<bool> {
        let described = (format, width, height, stride_bytes);
        self.forward_one(output, |frame| {
            frame.data.addr() == address && (frame.format, frame.width, frame.height, frame.stride_bytes) == described
        })
    }

    /// Forwards the input frame of a view as an output.
    fn forward_view(&self, output: u32, view: &View) -> PyResult<bool> {
        let address = view.address();
        self.forward_one(output, |frame| frame.data.addr() == address)
    }

    /// Source, number and capture time of the tick.
    fn tick(&self) -> PyResult<(u32, u64, i64)> {
        let tick = self.running()?.tick;
        Ok((tick.source, tick.seq, tick.capture_ns))
    }

    /// Sets the capture time of a source's tick.
    fn set_capture_ns(&self, capture_ns: i64) -> PyResult<()> {
        self.running()?;
        // SAFETY: the call runs, as just checked; nobody else has a reference to its tick.
        unsafe { (*self.running.load(Ordering::Acquire)).tick.capture_ns = capture_ns };
        Ok(())
    }

    /// The host's clock.
    fn clock_ns(&self) -> PyResult<i64> {
        let call = self.running()?;
        // SAFETY: the handle of the running call.
        Ok(self.host.clock_ns.map_or(0, |clock| unsafe { clock(call.call) }))
    }

    /// Age of the light of an input, by its position among the frames of the call; infinite if unknown.
    fn age_ns(&self, input: u32) -> PyResult<f64> {
        let call = self.running()?;
        // SAFETY: the handle of the running call.
        let age_ns = self.host.age_ns.map_or(i64::MAX, |age| unsafe { age(call.call, input) });
        Ok(if age_ns == i64::MAX { f64::NAN } else { age_ns as f64 })
    }

    /// Reports a named number of the node.
    fn metric(&self, name: &str, value: f64) -> PyResult<()> {
        let call = self.running()?;
        if let Some(metric) = self.host.metric {
            // SAFETY: the handle of the running call; the text is copied.
            unsafe { metric(call.call, Str::borrow(name), value) };
        }
        Ok(())
    }

    /// Writes a line to the host's log.
    fn log(&self, level: u32, message: &str) -> PyResult<()> {
        let call = self.running()?;
        if let Some(log) = self.host.log {
            // SAFETY: the handle of the running call; the text is copied.
            unsafe { log(call.call, level, Str::borrow(message)) };
        }
        Ok(())
    }
}
