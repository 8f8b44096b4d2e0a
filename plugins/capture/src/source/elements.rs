//! Elements that a GStreamer pipeline names, looked up in GStreamer's registry: no pipeline is built and no device touched.

use std::ffi::{CString, c_char, c_int, c_void};
use std::sync::OnceLock;

type Init = unsafe extern "C" fn(*mut c_int, *mut *mut *mut c_char, *mut *mut c_void) -> c_int;
type Find = unsafe extern "C" fn(*const c_char) -> *mut c_void;
type Unref = unsafe extern "C" fn(*mut c_void);

/// GStreamer's functions, where OpenCV brought it into the process.
struct Registry {
    find: Find,
    unref: Unref,
}

impl Registry {
    /// The process's GStreamer; `None` when this OpenCV works without it, or when it does not start.
    fn get() -> Option<&'static Self> {
        static REGISTRY: OnceLock<Option<Registry>> = OnceLock::new();
        REGISTRY.get_or_init(Self::open).as_ref()
    }

    fn open() -> Option<Self> {
        // SAFETY: only finds a library that is mapped already; the handle is kept for the life of the process, so that its functions stay.
        let library = unsafe { libc::dlopen(c"libgstreamer-1.0.so.0".as_ptr(), libc::RTLD_LAZY | libc::RTLD_NOLOAD) };
        if library.is_null() {
            return None;
        }
        let symbol = |name: &std::ffi::CStr| {
            // SAFETY: a handle of `dlopen` and a terminated name.
            let found = unsafe { libc::dlsym(library, name.as_ptr()) };
            (!found.is_null()).then_some(found)
        };
        let (init, find, unref) =
            (symbol(c"gst_init_check")?, symbol(c"gst_element_factory_find")?, symbol(c"gst_object_unref")?);
        // SAFETY: the signatures are those of GStreamer's stable interface (1.0).
        unsafe {
            let init = std::mem::transmute::<*mut c_void, Init>(init);
            // May be called again, and from any thread: OpenCV does.
            if init(std::ptr::null_mut(), std::ptr::null_mut(), std::ptr::null_mut()) == 0 {
                return None;
            }
            Some(Self {
                find: std::mem::transmute::<*mut c_void, Find>(find),
                unref: std::mem::transmute::<*mut c_void, Unref>(unref),
            })
        }
    }

    fn has(&self, element: &str) -> bool {
        let Ok(name) = CString::new(element) else { return false };
        // SAFETY: GStreamer is initialised (`open`); the factory that is found belongs to the caller, who gives it back.
        unsafe {
            let factory = (self.find)(name.as_ptr());
            if !factory.is_null() {
                (self.unref)(factory);
            }
            !factory.is_null()
        }
    }
}

/// Names that stand where a pipeline has its elements: the first word behind the start or a `!`. What is not plainly one (caps, pads, bins)
/// is left out.
pub fn names(pipeline: &str) -> Vec<&str> {
    let (mut quote, mut escaped) = (None, false);
    // A quoted text may hold `!`.
    let parts = pipeline.split(|c: char| {
        if std::mem::take(&mut escaped) {
            return false;
        }
        match (quote, c) {
            (_, '\\') => escaped = true,
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), _) if open == c => quote = None,
            _ => {}
        }
        c == '!' && quote.is_none()
    });
    let is_name = |word: &&str| {
        word.starts_with(|c: char| c.is_ascii_alphabetic())
            && word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
    };
    parts.filter_map(|part| part.split_whitespace().next()).filter(is_name).collect()
}

/// The first of `names` that this machine does not have; `None` also when it is unknown.
pub fn missing<'t>(names: &[&'t str]) -> Option<&'t str> {
    let registry = Registry::get()?;
    names.iter().copied().find(|name| !registry.has(name))
}

/// The first element of a pipeline that this machine does not have; `None` also when it is unknown.
pub fn unknown_element(pipeline: &str) -> Option<&str> {
    missing(&names(pipeline))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_told_from_caps_and_pads() {
        let text = "v4l2src device=/dev/video0 ! video/x-raw,width=640 ! tee name=t t. ! queue ! appsink t. ! fakesink";
        assert_eq!(names(text), ["v4l2src", "tee", "queue", "appsink", "fakesink"]);
        let text = r#"filesrc location="a ! \" ! b.mkv" ! 'video/x-raw, width=640' ! decodebin ! t. ! appsink"#;
        assert_eq!(names(text), ["filesrc", "decodebin", "appsink"]);
        assert!(names(" ! ( ! x=1").is_empty());
    }

    #[test]
    fn a_misspelt_element_is_found_without_a_pipeline() {
        if Registry::get().is_none() {
            panoscope_testing::skipped!("this OpenCV has no GStreamer");
            return;
        }
        assert_eq!(unknown_element("videotestsorce num-buffers=2 ! appsink"), Some("videotestsorce"));
        assert_eq!(unknown_element("fakesrc ! queue ! fakesink"), None);
    }
}
