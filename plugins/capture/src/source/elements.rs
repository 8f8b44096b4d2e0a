//! The elements that a GStreamer pipeline names. OpenCV waits for ever for a pipeline with an element that does not exist, so GStreamer
//! is asked for each of them first.

use std::ffi::{CString, c_char, c_int, c_void};

use libloading::os::unix::{Library, RTLD_LAZY};

/// Names of the elements of a pipeline in GStreamer's words, in order.
///
/// An element is the first word behind the start or a `!`, unless it is a caps filter (`video/x-raw`), a reference to another element
/// (`t.`) or a property.
pub fn names(text: &str) -> Vec<String> {
    let mut names = Vec::new();
    let (mut quoted, mut escaped) = (false, false);
    let parts = text.split(|c: char| {
        if escaped {
            escaped = false;
            return false;
        }
        match c {
            '\\' => escaped = true,
            '"' => quoted = !quoted,
            _ => {}
        }
        c == '!' && !quoted
    });
    for part in parts {
        let Some(word) = part.split_whitespace().next() else { continue };
        let is_name = word.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_');
        if is_name && word.starts_with(|c: char| c.is_ascii_alphabetic()) {
            names.push(word.to_owned());
        }
    }
    names
}

/// The first of `names` that GStreamer does not have; `None` when all are there, or GStreamer cannot be asked.
///
/// May take long the first time: GStreamer reads its list of plugins then.
pub fn missing(names: &[String]) -> Option<String> {
    type Init = unsafe extern "C" fn(*mut c_int, *mut c_void, *mut *mut c_void) -> c_int;
    type Find = unsafe extern "C" fn(*const c_char) -> *mut c_void;
    type Unref = unsafe extern "C" fn(*mut c_void);
    // SAFETY: the library's constructors are GLib's, made to run at any time; OpenCV has loaded it already where it has GStreamer.
    let library = unsafe { Library::open(Some("libgstreamer-1.0.so.0"), RTLD_LAZY) }.ok()?;
    // SAFETY: the names and signatures of GStreamer 1.x's public functions, which are stable.
    let (init, find, unref) = unsafe {
        (
            library.get::<Init>(b"gst_init_check\0").ok()?,
            library.get::<Find>(b"gst_element_factory_find\0").ok()?,
            library.get::<Unref>(b"gst_object_unref\0").ok()?,
        )
    };
    // SAFETY: null arguments are allowed; initialising twice does nothing.
    let is_ready = unsafe { init(std::ptr::null_mut(), std::ptr::null_mut(), std::ptr::null_mut()) } != 0;
    let mut found = None;
    for name in names.iter().filter(|_| is_ready) {
        let Ok(text) = CString::new(name.as_str()) else { continue };
        // SAFETY: initialised; a text that ends with 0. What is returned is ours to give back.
        let factory = unsafe { find(text.as_ptr()) };
        if factory.is_null() {
            found = Some(name.clone());
            break;
        }
        // SAFETY: returned by `find`, given back once.
        unsafe { unref(factory) };
    }
    // GStreamer's threads and types stay: the library must never be unloaded.
    std::mem::forget(library);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_the_first_words() {
        assert_eq!(
            names("v4l2src device=/dev/video0 ! video/x-raw,width=640 ! tee name=t ! queue ! appsink"),
            ["v4l2src", "tee", "queue", "appsink"]
        );
        assert_eq!(
            names(r#"filesrc location="a ! b.mkv" ! decodebin ! t. ! appsink"#),
            ["filesrc", "decodebin", "appsink"]
        );
        assert_eq!(names(" ! ( ! x=1"), Vec::<String>::new());
    }
}
