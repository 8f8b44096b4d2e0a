//! Libraries that are loaded on demand: GStreamer with its elements, OpenCV, ONNX Runtime.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::fs;
use std::path::{Path, PathBuf};

/// Elements that nodes use by name, with Debian's package of each; the packages that everything with video needs come
/// first.
pub const ELEMENTS: &[(&str, &str, &[&str])] = &[
    (
        "gstreamer1.0-plugins-base",
        "cameras, files and streams",
        &["appsink", "appsrc", "decodebin", "videoconvert", "videotestsrc"],
    ),
    (
        "gstreamer1.0-plugins-good",
        "cameras, files and streams",
        &["v4l2src", "rtspsrc", "jpegdec", "jpegenc", "matroskamux", "matroskademux", "qtdemux", "rtph264pay"],
    ),
    (
        "gstreamer1.0-plugins-bad",
        "H.264 and H.265 in files and streams, video in web browsers",
        &["h264parse", "h265parse", "webrtcbin", "dtlssrtpenc", "dtlssrtpdec", "srtpenc", "srtpdec"],
    ),
    ("gstreamer1.0-plugins-ugly", "writing H.264", &["x264enc"]),
    ("gstreamer1.0-nice", "video in web browsers", &["nicesrc", "nicesink"]),
    ("gstreamer1.0-rtsp", "sending a stream to an RTSP server", &["rtspclientsink"]),
    ("gstreamer1.0-libav", "reading H.264 and H.265", &["avdec_h264", "avdec_h265"]),
];

/// GStreamer, opened at run time: the command does not link it.
pub struct GStreamer {
    find: unsafe extern "C" fn(*const c_char) -> *mut c_void,
    unref: unsafe extern "C" fn(*mut c_void),
    /// Its own version text.
    pub version: String,
}

impl GStreamer {
    /// Loads and initialises GStreamer; `None` when it is not installed or does not start.
    pub fn open() -> Option<Self> {
        let library = open_library("libgstreamer-1.0.so.0")?;
        let init = symbol(library, c"gst_init_check")?;
        let version = symbol(library, c"gst_version_string")?;
        let find = symbol(library, c"gst_element_factory_find")?;
        let unref = symbol(library, c"gst_object_unref")?;
        // SAFETY: these are the declarations of GStreamer 1.x, whose ABI is stable, and `symbol` found each by its name in that library.
        let (init, version, find, unref) = unsafe {
            (
                std::mem::transmute::<*mut c_void, unsafe extern "C" fn(*mut c_int, *mut c_void, *mut c_void) -> c_int>(
                    init,
                ),
                std::mem::transmute::<*mut c_void, unsafe extern "C" fn() -> *mut c_char>(version),
                std::mem::transmute::<*mut c_void, unsafe extern "C" fn(*const c_char) -> *mut c_void>(find),
                std::mem::transmute::<*mut c_void, unsafe extern "C" fn(*mut c_void)>(unref),
            )
        };
        // SAFETY: all arguments of `gst_init_check` may be null; the version is a terminated text that is never freed here.
        let version = unsafe {
            if init(std::ptr::null_mut(), std::ptr::null_mut(), std::ptr::null_mut()) == 0 {
                return None;
            }
            CStr::from_ptr(version()).to_string_lossy().into_owned()
        };
        Some(Self { find, unref, version })
    }

    /// Whether a plugin offers the element.
    pub fn has(&self, element: &str) -> bool {
        let Ok(name) = CString::new(element) else { return false };
        // SAFETY: GStreamer is initialised, and the name is terminated; the reference that was returned is given back.
        unsafe {
            let factory = (self.find)(name.as_ptr());
            if !factory.is_null() {
                (self.unref)(factory);
            }
            !factory.is_null()
        }
    }
}

/// The file of a mapped library whose name begins with `name`.
pub fn mapped(name: &str) -> Option<PathBuf> {
    let maps = fs::read_to_string("/proc/self/maps").ok()?;
    let mut files = maps.lines().filter_map(|line| line.find('/').map(|at| Path::new(&line[at..])));
    files.find(|file| file.file_name().is_some_and(|n| n.to_string_lossy().starts_with(name))).map(Path::to_owned)
}

/// Whether the dynamic linker loads a library; it stays loaded until the program ends.
pub fn loads(name: &str) -> bool {
    open_library(name).is_some()
}

fn open_library(name: &str) -> Option<*mut c_void> {
    let name = CString::new(name).ok()?;
    // SAFETY: constructors of a system library run; it is never closed.
    let handle = unsafe { libc::dlopen(name.as_ptr(), libc::RTLD_LAZY | libc::RTLD_LOCAL) };
    (!handle.is_null()).then_some(handle)
}

fn symbol(library: *mut c_void, name: &CStr) -> Option<*mut c_void> {
    // SAFETY: `library` is a handle that `open_library` returned and nobody closes.
    let found = unsafe { libc::dlsym(library, name.as_ptr()) };
    (!found.is_null()).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mapped_library_is_found_by_its_name() {
        assert!(mapped("libc.so").is_some_and(|file| file.is_absolute()));
        assert_eq!(mapped("libno-such-library"), None);
        assert!(loads("libc.so.6") && !loads("libno-such-library.so"));
    }

    #[test]
    fn elements_are_looked_up() {
        let Some(gstreamer) = GStreamer::open() else {
            return panoscope_testing::skipped!("GStreamer is not installed");
        };
        assert!(gstreamer.version.starts_with("GStreamer 1."), "{}", gstreamer.version);
        assert!(gstreamer.has("fakesink") && !gstreamer.has("no-such-element") && !gstreamer.has("nul\0nul"));
    }
}
