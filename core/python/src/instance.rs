//! The functions of a node type, which call Python.

use std::cell::Cell;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};

use panoscope_abi::{self as abi, Frame, Host, ParamValue, PortRange, Status, Str};
use pyo3::ffi;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyList, PyTuple};

use crate::call::Call;
use crate::{RUNNER, classes, explain};

/// An instance of a node class.
struct Instance {
    /// `panoscope.runner.Runner`.
    runner: Py<PyAny>,
    call: Py<Call>,
    host: &'static Host,
    params_version: u64,
}

thread_local! {
    /// Whether the interpreter knows this thread.
    static IS_KNOWN: Cell<bool> = const { Cell::new(false) };
}

/// Runs `work` with the interpreter's lock. The interpreter's thread state is kept until the process ends, so that
/// Python's thread-local data survives between calls.
pub fn attach<R>(work: impl FnOnce(Python<'_>) -> R) -> R {
    if !IS_KNOWN.replace(true) {
        // SAFETY: plain calls of the interpreter, which `serve` runs in: the first makes this thread known and takes the lock, the second
        // gives the lock back and leaves the thread known.
        unsafe {
            ffi::PyGILState_Ensure();
            ffi::PyEval_SaveThread();
        }
    }
    Python::attach(work)
}

fn fail(host: &Host, call: *mut c_void, words: &str) {
    if let Some(fail) = host.fail {
        // SAFETY: the handle of the running call; the text is copied.
        unsafe { fail(call, Str::borrow(words)) };
    }
}

/// Runs `work`; an exception becomes the message of a fault.
fn guarded(host: &Host, call: *mut c_void, work: impl FnOnce(Python<'_>) -> PyResult<()>) -> Status {
    let run = || {
        attach(|py| match work(py) {
            Ok(()) => abi::STATUS_OK,
            Err(error) if is_end(py, &error) => abi::STATUS_END,
            Err(error) => {
                fail(host, call, &explain(py, &error));
                abi::STATUS_ERROR
            }
        })
    };
    catch_unwind(AssertUnwindSafe(run)).unwrap_or(abi::STATUS_PANIC)
}

fn is_end(py: Python<'_>, error: &PyErr) -> bool {
    let end = py.import(intern!(py, "panoscope.nodes")).and_then(|nodes| nodes.getattr(intern!(py, "End")));
    end.is_ok_and(|end| error.is_instance(py, &end))
}

unsafe fn slice<'a, T>(first: *const T, len: usize) -> &'a [T] {
    // SAFETY: the caller's promise: `len` values from `first` on.
    if len == 0 { &[] } else { unsafe { std::slice::from_raw_parts(first, len) } }
}

/// The values of parameters as a tuple.
///
/// # Safety
/// `params` has `len` values that stay valid during this call.
unsafe fn values<'py>(py: Python<'py>, params: *const ParamValue, len: usize) -> PyResult<Bound<'py, PyTuple>> {
    // SAFETY: the caller's promise.
    let params = unsafe { slice(params, len) };
    let value = |param: &ParamValue| -> PyResult<Bound<'py, PyAny>> {
        Ok(match param.kind {
            abi::PARAM_BOOL => (param.int_value != 0).into_pyobject(py)?.to_owned().into_any(),
            abi::PARAM_INT => param.int_value.into_pyobject(py)?.into_any(),
            abi::PARAM_FLOAT => param.float_value.into_pyobject(py)?.into_any(),
            // SAFETY: the caller's promise, for what a value points to.
            abi::PARAM_FLOATS => PyList::new(py, unsafe { slice(param.floats, param.floats_len) })?.into_any(),
            // SAFETY: the caller's promise covers the texts of values.
            _ => unsafe { param.text.text() }.unwrap_or("").into_pyobject(py)?.into_any(),
        })
    };
    PyTuple::new(py, params.iter().map(value).collect::<PyResult<Vec<_>>>()?)
}

/// The descriptor's [`abi::NodeType::open`].
pub unsafe extern "C" fn open(call: *mut abi::OpenCall, instance: *mut *mut c_void) -> Status {
    // SAFETY: the contract: the call and what it points to live until this returns; the table lives until the process ends.
    let (call, host) = unsafe { (&*call, &*(*call).host) };
    let Some(node_type) = panoscope_host::isolate::child::opening() else {
        fail(host, call.call, "a node in Python must run in a separate process");
        return abi::STATUS_INVALID;
    };
    guarded(host, call.call, |py| {
        let class = classes::class_of(py, node_type);
        // SAFETY: the contract, for the texts and the values.
        let (node, graph_dir, values) = unsafe {
            (
                call.node_id.text().unwrap_or(""),
                call.graph_dir.text().unwrap_or(""),
                values(py, call.params, call.params_len)?,
            )
        };
        let runner = py.import(RUNNER)?.getattr("Runner")?.call1((class, values, node, graph_dir))?.unbind();
        let new = Instance { runner, call: Py::new(py, Call::new(host))?, host, params_version: 0 };
        // SAFETY: the contract: a place for the instance.
        unsafe { *instance = Box::into_raw(Box::new(new)).cast() };
        Ok(())
    })
}

/// The descriptor's [`abi::NodeType::process`].
pub unsafe extern "C" fn process(instance: *mut c_void, call: *mut abi::Call) -> Status {
    // SAFETY: the contract: an instance of `open`, which only this thread uses, and a call that lives until this returns.
    let (this, running) = unsafe { (&mut *instance.cast::<Instance>(), &*call) };
    let (handle, host) = (running.call, this.host);
    guarded(host, handle, |py| {
        let runner = this.runner.bind(py);
        if this.params_version != running.params_version {
            // SAFETY: the contract, for the values.
            let values = unsafe { values(py, running.params, running.params_len)? };
            runner.call_method1(intern!(py, "set_params"), (values,))?;
            this.params_version = running.params_version;
        }
        let shared = this.call.get();
        shared.begin(call);
        let done = inputs(py, shared, running)
            .and_then(|views| runner.call_method1(intern!(py, "process"), (&this.call, views)).map(drop));
        shared.end(py);
        done
    })
}

/// A view, a list of views or none for each input port.
fn inputs<'py>(py: Python<'py>, shared: &Call, call: &abi::Call) -> PyResult<Bound<'py, PyTuple>> {
    // SAFETY: the contract: as many frames and ranges for the length of the call.
    let (frames, ranges): (&[Frame], &[PortRange]) =
        unsafe { (slice(call.inputs, call.inputs_len), slice(call.input_ranges, call.input_ranges_len)) };
    let view = |frame: &Frame| shared.view(py, frame, false);
    let port = |range: &PortRange| -> PyResult<Bound<'py, PyAny>> {
        let first = range.first as usize;
        let of_port = frames.get(first..first + range.count as usize).unwrap_or(&[]);
        Ok(match of_port {
            [] => py.None().into_bound(py),
            [frame] if frame.is_empty() => py.None().into_bound(py),
            [frame] => view(frame)?.into_bound(py).into_any(),
            many => {
                let views = many.iter().filter(|frame| !frame.is_empty()).map(view).collect::<PyResult<Vec<_>>>()?;
                PyList::new(py, views)?.into_any()
            }
        })
    };
    PyTuple::new(py, ranges.iter().map(port).collect::<PyResult<Vec<_>>>()?)
}

/// The descriptor's [`abi::NodeType::close`].
pub unsafe extern "C" fn close(instance: *mut c_void) {
    // SAFETY: the contract: an instance of `open`, closed once.
    let this = unsafe { Box::from_raw(instance.cast::<Instance>()) };
    let run = || {
        attach(|py| {
            if let Err(error) = this.runner.bind(py).call_method0("close") {
                eprintln!("panoscope: a node in Python did not close: {}", explain(py, &error));
            }
            drop(this);
        });
    };
    // Whatever it is, the instance is gone.
    let _ = catch_unwind(AssertUnwindSafe(run));
}

/// The descriptor's [`abi::NodeType::save_state`].
pub unsafe extern "C" fn save_state(instance: *mut c_void, host: *const Host, sink: *mut c_void) -> Status {
    // SAFETY: the contract: an instance of `open`, and a table that lives until this returns.
    let (this, host) = unsafe { (&*instance.cast::<Instance>(), &*host) };
    let run = || {
        attach(|py| {
            let state = this.runner.bind(py).call_method0("save_state")?;
            if let (Ok(state), Some(save)) = (state.cast::<PyBytes>(), host.save) {
                let bytes = state.as_bytes();
                // SAFETY: the bytes live until this returns.
                unsafe { save(sink, bytes.as_ptr(), bytes.len()) };
            }
            PyResult::Ok(())
        })
    };
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(Ok(())) => abi::STATUS_OK,
        _ => abi::STATUS_ERROR,
    }
}

/// The descriptor's [`abi::NodeType::load_state`].
pub unsafe extern "C" fn load_state(instance: *mut c_void, bytes: *const u8, len: usize) -> Status {
    // SAFETY: the contract: an instance of `open`, and `len` bytes.
    let (this, bytes) = unsafe { (&*instance.cast::<Instance>(), slice(bytes, len)) };
    let run = || attach(|py| this.runner.bind(py).call_method1("load_state", (PyBytes::new(py, bytes),)).map(drop));
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(Ok(())) => abi::STATUS_OK,
        _ => abi::STATUS_ERROR,
    }
}
