//! Reads FFmpeg's log for damage, and for pixels that GStreamer has no format for.
//!
//!
//!
//! FFmpeg conceals missing parts of an image with those of the previous one. GStreamer's elements around it pass such
//! an image on without a flag, an error, or a message; only FFmpeg's log reports it. The elements send that log to
//! GStreamer's category `libav` on the thread that decodes, so every guarded decoder decodes on one thread, and its
//! guard is the thread's.
//!
//! GStreamer 1.22 describes a pool of images of an unknown format with memory that it has not initialised, and mostly
//! crashes. A failed assertion comes before that: the thread of the decoder stops there for ever, and its pipeline is
//! left behind.

use std::cell::{Cell, RefCell};
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::sync::atomic::{AtomicI32, AtomicPtr, Ordering};
use std::sync::{Arc, OnceLock};

use gstreamer as gst;
use gstreamer::ffi;
use gstreamer::glib::{LogLevel, LogLevels};

/// Receives a decoder's messages about damage.
pub trait DamageReport: Send + Sync {
    /// Receives one message of the decoder.
    fn report(&self, message: &str);

    /// Receives the reason why the decoder cannot go on.
    fn fail(&self, reason: &str);
}

thread_local! {
    /// The guard of the decoder that this thread runs.
    static DECODING: RefCell<Option<Arc<dyn DamageReport>>> = const { RefCell::new(None) };
    /// FFmpeg's number of the newest pixel format that GStreamer does not know.
    static UNKNOWN_PIXELS: Cell<Option<c_int>> = const { Cell::new(None) };
}

/// Text that GStreamer's elements write before the number of a pixel format that has no counterpart.
const UNKNOWN: &str = "Unknown pixel format ";

/// The category `libav`, and the threshold that the user set for it.
static CATEGORY: AtomicPtr<ffi::GstDebugCategory> = AtomicPtr::new(std::ptr::null_mut());
static THRESHOLD: AtomicI32 = AtomicI32::new(0);

/// Passes further messages of this thread's decoder to `guard`.
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
    if is_libav && matches!(level, ffi::GST_LEVEL_ERROR | ffi::GST_LEVEL_INFO | ffi::GST_LEVEL_DEBUG) {
        // SAFETY: GStreamer keeps the message valid for the call; its text is terminated, or null.
        let text = unsafe {
            let text = ffi::gst_debug_message_get(message);
            if text.is_null() { "" } else { CStr::from_ptr(text).to_str().unwrap_or("") }
        };
        // "concealing 40 DC, 40 AC, 40 MV errors in P frame" is said as information.
        if level == ffi::GST_LEVEL_DEBUG {
            if let Some(number) = text.strip_prefix(UNKNOWN) {
                UNKNOWN_PIXELS.set(number.trim().parse().ok());
            }
        } else if level == ffi::GST_LEVEL_ERROR || text.trim_start().starts_with("concealing") {
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

/// Installs the handler of FFmpeg's log. Messages enabled with `GST_DEBUG` are still printed.
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
        if category.threshold() < gst::DebugLevel::Debug {
            category.set_threshold(gst::DebugLevel::Debug);
        }
        gst::glib::log_set_handler(Some("GStreamer-Video"), LogLevels::LEVEL_CRITICAL, false, false, assertion_failed);
    });
}

/// Stops the thread of a decoder that is about to use a description of unknown pixels.
fn assertion_failed(domain: Option<&str>, level: LogLevel, message: &str) {
    let guard = DECODING.with_borrow(Clone::clone);
    if let Some(guard) = guard.filter(|_| message.contains("format != GST_VIDEO_FORMAT_UNKNOWN")) {
        let name = UNKNOWN_PIXELS.get().and_then(pixel_format_name);
        let name = name.map_or_else(String::new, |name| format!(" `{name}`"));
        guard.fail(&format!(
            "GStreamer does not know its pixel format{name}: convert the video, for example by \
             `ffmpeg -i IN.mkv -c:v ffv1 -pix_fmt gray16le OUT.mkv`, or with bgr0 for colours"
        ));
        loop {
            std::thread::park();
        }
    }
    gst::glib::log_default_handler(domain, level, Some(message));
}

/// FFmpeg's name of a pixel format, from the library that GStreamer has loaded.
fn pixel_format_name(number: c_int) -> Option<String> {
    let maps = std::fs::read_to_string("/proc/self/maps").ok()?;
    let file = maps.lines().filter_map(|line| line.split_once('/')).find(|(_, path)| path.contains("libavutil.so"))?.1;
    let file = CString::new(format!("/{file}")).ok()?;
    // SAFETY: the text is terminated, and nothing is loaded that is not loaded already; without the library this is null.
    let library = unsafe { libc::dlopen(file.as_ptr(), libc::RTLD_LAZY | libc::RTLD_NOLOAD) };
    if library.is_null() {
        return None;
    }
    // SAFETY: an open library, and a terminated text.
    let symbol = unsafe { libc::dlsym(library, c"av_get_pix_fmt_name".as_ptr()) };
    if symbol.is_null() {
        return None;
    }
    // SAFETY: FFmpeg declares the function so since it has it; it returns null or a terminated constant of the library, which stays loaded.
    unsafe {
        let name_of = std::mem::transmute::<*mut c_void, unsafe extern "C" fn(c_int) -> *const c_char>(symbol);
        let name = name_of(number);
        (!name.is_null()).then(|| CStr::from_ptr(name).to_string_lossy().into_owned())
    }
}

fn number_of(level: gst::DebugLevel) -> i32 {
    use gst::glib::translate::IntoGlib;
    level.into_glib()
}
