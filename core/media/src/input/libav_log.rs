//! What FFmpeg's decoders say about damage.
//!
//! FFmpeg conceals missing parts of a picture with those of the picture before. GStreamer's elements around it pass such a picture on without a
//! flag, an error, or a message; FFmpeg's log is the only place where it is said. The elements send that log to GStreamer's category `libav` on
//! the thread that decodes, so every guarded decoder decodes on one thread, and its guard is the thread's.

use std::cell::RefCell;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::sync::atomic::{AtomicI32, AtomicPtr, Ordering};
use std::sync::{Arc, OnceLock};

use gstreamer as gst;
use gstreamer::ffi;

/// Receives what a decoder logs about damage.
pub trait DamageReport: Send + Sync {
    /// Takes one message of the decoder.
    fn report(&self, message: &str);
}

thread_local! {
    /// The guard of the decoder that this thread runs.
    static DECODING: RefCell<Option<Arc<dyn DamageReport>>> = const { RefCell::new(None) };
}

/// The category `libav`, and the threshold that the user set for it.
static CATEGORY: AtomicPtr<ffi::GstDebugCategory> = AtomicPtr::new(std::ptr::null_mut());
static THRESHOLD: AtomicI32 = AtomicI32::new(0);

/// Gives what this thread's decoder logs from now on to `guard`.
pub fn attend<R: DamageReport + 'static>(guard: &Arc<R>) {
    DECODING.with_borrow_mut(|current| {
        if !current.as_ref().is_some_and(|other| std::ptr::addr_eq(Arc::as_ptr(other), Arc::as_ptr(guard))) {
            *current = Some(guard.clone());
        }
    });
}

unsafe extern "C" fn received(
    category: *mut ffi::GstDebugCategory,
    level: ffi::GstDebugLevel,
    file: *const c_char,
    function: *const c_char,
    line: c_int,
    object: *mut gst::glib::gobject_ffi::GObject,
    message: *mut ffi::GstDebugMessage,
    user_data: *mut c_void,
) {
    let is_libav = std::ptr::eq(category, CATEGORY.load(Ordering::Acquire));
    if is_libav && (level == ffi::GST_LEVEL_ERROR || level == ffi::GST_LEVEL_INFO) {
        // SAFETY: GStreamer keeps the message valid for the call; its text is terminated, or null.
        let text = unsafe {
            let text = ffi::gst_debug_message_get(message);
            if text.is_null() { "" } else { CStr::from_ptr(text).to_str().unwrap_or("") }
        };
        // "concealing 40 DC, 40 AC, 40 MV errors in P frame" is said as information.
        if level == ffi::GST_LEVEL_ERROR || text.trim_start().starts_with("concealing") {
            DECODING.with_borrow(|current| {
                if let Some(guard) = current {
                    guard.report(text);
                }
            });
        }
    }
    if !is_libav || level <= THRESHOLD.load(Ordering::Acquire) {
        // SAFETY: all arguments are GStreamer's own, passed on within its call.
        unsafe { ffi::gst_debug_log_default(category, level, file, function, line, object, message, user_data) }
    }
}

/// Receives FFmpeg's log from now on. What the user asked for with `GST_DEBUG` is still printed.
pub fn install() {
    static INSTALLED: OnceLock<()> = OnceLock::new();
    INSTALLED.get_or_init(|| {
        // The category exists once an element of the plugin does.
        let _ = gst::ElementFactory::make("avdec_h264").build();
        let Some(category) = gst::DebugCategory::get("libav") else { return };
        THRESHOLD.store(number_of(category.threshold()), Ordering::Release);
        CATEGORY.store(category.as_ptr(), Ordering::Release);
        gst::log::remove_default_log_function();
        // SAFETY: `received` has the type that GStreamer calls; it needs no data, and plugins are never unmapped.
        unsafe { ffi::gst_debug_add_log_function(Some(received), std::ptr::null_mut(), None) };
        if category.threshold() < gst::DebugLevel::Info {
            category.set_threshold(gst::DebugLevel::Info);
        }
    });
}

fn number_of(level: gst::DebugLevel) -> i32 {
    use gst::glib::translate::IntoGlib;
    level.into_glib()
}
