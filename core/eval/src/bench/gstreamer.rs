//! GStreamer as a peer: the same frames through its own elements, in this process, timed by the same clock.
//!
//! The library is opened at run time if it is installed; building needs nothing of it. Times are taken by probes on the
//! pads where a frame leaves its source and where it reaches its sink, which is what the engine's own ages span.

#![allow(unsafe_code)]

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ptr::null_mut;
use std::time::{Duration, Instant};

use crate::error::{Context, EvalError, Result};
use crate::session::Session;
use panoscope_engine::clock;

type Object = *mut c_void;
type Probe = unsafe extern "C" fn(pad: Object, info: *mut c_void, times: *mut c_void) -> c_int;

const STATE_NULL: c_int = 1;
const STATE_PLAYING: c_int = 4;
const PROBE_BUFFER: c_int = 1 << 4;
const PROBE_OK: c_int = 1;
const MESSAGE_EOS: c_int = 1;
const MESSAGE_ERROR: c_int = 2;

/// The functions of `libgstreamer-1.0.so.0` that are used; their signatures are stable through all of 1.x.
pub struct GStreamer {
    parse_launch: unsafe extern "C" fn(*const c_char, *mut *mut c_void) -> Object,
    set_state: unsafe extern "C" fn(Object, c_int) -> c_int,
    get_bus: unsafe extern "C" fn(Object) -> Object,
    pop_message: unsafe extern "C" fn(Object, u64, c_int) -> Object,
    by_name: unsafe extern "C" fn(Object, *const c_char) -> Object,
    static_pad: unsafe extern "C" fn(Object, *const c_char) -> Object,
    add_probe: unsafe extern "C" fn(Object, c_int, Probe, *mut c_void, *mut c_void) -> u64,
    unref: unsafe extern "C" fn(Object),
    message_unref: unsafe extern "C" fn(Object),
}

/// Cost of a pipeline.
pub struct Run {
    /// Wall time per frame, from the first frame at the source to the last at the sink.
    pub ns_per_frame: f64,
    /// From source to sink, one per frame, sorted; ns.
    pub ages_ns: Vec<u64>,
}

impl Run {
    /// The `q` quantile of the frame age, ns.
    pub fn age_ns(&self, q: f64) -> f64 {
        let last = self.ages_ns.len().saturating_sub(1);
        self.ages_ns.get((last as f64 * q).round() as usize).copied().unwrap_or(0) as f64
    }
}

unsafe extern "C" fn note_time(_: Object, _: *mut c_void, times: *mut c_void) -> c_int {
    // SAFETY: `times` is the `Vec` handed to `add_probe`, which outlives the pipeline and is used by one pad's thread.
    let times = unsafe { &mut *times.cast::<Vec<u64>>() };
    if times.len() < times.capacity() {
        times.push(clock::now_ns());
    }
    PROBE_OK
}

impl GStreamer {
    /// Opens the library; `None` when it is not installed.
    pub fn open() -> Option<Self> {
        // SAFETY: a well-known library without surprises in its constructors; the names and types are those of its headers.
        unsafe {
            let library = libc::dlopen(c"libgstreamer-1.0.so.0".as_ptr(), libc::RTLD_NOW | libc::RTLD_LOCAL);
            if library.is_null() {
                return None;
            }
            let symbol = |name: &CStr| {
                let symbol = libc::dlsym(library, name.as_ptr());
                (!symbol.is_null()).then_some(symbol)
            };
            macro_rules! function {
                ($name:expr) => {
                    std::mem::transmute_copy(&symbol($name)?)
                };
            }
            let init: unsafe extern "C" fn(*mut c_int, *mut *mut *mut c_char) = function!(c"gst_init");
            let this = Self {
                parse_launch: function!(c"gst_parse_launch"),
                set_state: function!(c"gst_element_set_state"),
                get_bus: function!(c"gst_element_get_bus"),
                pop_message: function!(c"gst_bus_timed_pop_filtered"),
                by_name: function!(c"gst_bin_get_by_name"),
                static_pad: function!(c"gst_element_get_static_pad"),
                add_probe: function!(c"gst_pad_add_probe"),
                unref: function!(c"gst_object_unref"),
                message_unref: function!(c"gst_mini_object_unref"),
            };
            init(null_mut(), null_mut());
            Some(this)
        }
    }

    /// `fakesrc` -> `elements` -> `fakesink`, 921,600 untouched bytes per frame, as in ours; nothing is signalled or
    /// kept.
    pub fn run(&self, session: &dyn Session, elements: &[&str], frames: u64, rate_hz: Option<f64>) -> Result<Run> {
        let pace = rate_hz.map_or_else(String::new, |hz| {
            format!(" is-live=true sync=true format=time datarate={}", (921_600.0 * hz) as u64)
        });
        let mut text = format!(
            "fakesrc name=source num-buffers={frames} sizetype=fixed sizemax=921600 filltype=nothing silent=true signal-handoffs=false{pace}"
        );
        for element in elements {
            text.push_str(" ! ");
            text.push_str(element);
        }
        text.push_str(
            " ! fakesink name=sink sync=false async=false silent=true signal-handoffs=false enable-last-sample=false",
        );
        let text = CString::new(text).context("a name of an element")?;
        let mut left: Box<Vec<u64>> = Box::new(Vec::with_capacity(frames as usize));
        let mut arrived: Box<Vec<u64>> = Box::new(Vec::with_capacity(frames as usize));
        // SAFETY: GStreamer's documented use: objects are checked for null, used while referenced, and given back; the probes'
        // lists outlive the pipeline, which is stopped before they are read.
        let fine = unsafe {
            let pipeline = (self.parse_launch)(text.as_ptr(), null_mut());
            if pipeline.is_null() {
                return Err(EvalError::Peer {
                    reason: format!("GStreamer cannot make a pipeline of: {}", text.to_string_lossy()),
                });
            }
            for (name, pad, times) in [(c"source", c"src", &mut left), (c"sink", c"sink", &mut arrived)] {
                let element = (self.by_name)(pipeline, name.as_ptr());
                let pad = (self.static_pad)(element, pad.as_ptr());
                (self.add_probe)(pad, PROBE_BUFFER, note_time, (&raw mut **times).cast(), null_mut());
                (self.unref)(pad);
                (self.unref)(element);
            }
            (self.set_state)(pipeline, STATE_PLAYING);
            let bus = (self.get_bus)(pipeline);
            let until = Instant::now() + Duration::from_secs(120);
            let mut message: Object = null_mut();
            while message.is_null() && Instant::now() < until && !session.is_cancelled() {
                message = (self.pop_message)(bus, 100_000_000, MESSAGE_EOS | MESSAGE_ERROR);
            }
            (self.set_state)(pipeline, STATE_NULL);
            let fine = !message.is_null() && arrived.len() as u64 == frames;
            if !message.is_null() {
                (self.message_unref)(message);
            }
            (self.unref)(bus);
            (self.unref)(pipeline);
            fine
        };
        if !fine {
            return Err(EvalError::Peer {
                reason: format!("GStreamer did not finish: {} of {frames} frames arrived", arrived.len()),
            });
        }
        let span = arrived.last().unwrap_or(&0).saturating_sub(*left.first().unwrap_or(&0));
        let mut ages_ns: Vec<u64> =
            arrived.iter().zip(left.iter()).map(|(to, from)| to.saturating_sub(*from)).collect();
        ages_ns.sort_unstable();
        Ok(Run { ns_per_frame: span as f64 / frames as f64, ages_ns })
    }
}
