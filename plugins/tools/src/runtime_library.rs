//! Finds and opens ONNX Runtime's shared library, once per process.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use ort::environment::Environment;
use panoscope_base::onnx;

/// No usable ONNX Runtime was found.
#[derive(Clone, Debug, thiserror::Error)]
#[error(
    "ONNX Runtime's shared library was not found: run `cargo xtask onnxruntime`, or name the file in ORT_DYLIB_PATH (tried: {})",
    .tried.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
)]
pub struct LibraryError {
    /// Error of each file that was tried.
    pub tried: Vec<FileError>,
}

/// Why a file is not a usable ONNX Runtime.
#[derive(Clone, Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum FileError {
    /// The system cannot load it.
    #[error("{path}: {reason}", path = path.display())]
    NotLoaded { path: PathBuf, reason: String },
    /// It is another library.
    #[error("{path}: not an ONNX Runtime (no OrtGetApiBase)", path = path.display())]
    OtherLibrary { path: PathBuf },
    /// ONNX Runtime cannot start.
    #[error("{path}: {reason}", path = path.display())]
    NotStarted { path: PathBuf, reason: String },
}

/// Whether this process has already loaded an ONNX Runtime: a host that compares it with a lock does so before any node opens.
fn is_loaded() -> bool {
    const RTLD_NOLOAD: i32 = 4;
    let flags = libloading::os::unix::RTLD_NOW | RTLD_NOLOAD;
    // SAFETY: with this flag nothing is loaded, so no code of a library runs.
    unsafe { libloading::os::unix::Library::open(Some(onnx::RUNTIME_SONAME), flags) }.map(std::mem::forget).is_ok()
}

/// Files to try: the one that is already loaded, or else those of [`onnx::runtime_candidates`].
fn candidates() -> Vec<PathBuf> {
    if is_loaded() { vec![onnx::RUNTIME_SONAME.into()] } else { onnx::runtime_candidates() }
}

/// Checks that a file is an ONNX Runtime, because `ort` aborts the process when it is not.
fn probe(path: &Path) -> Result<(), FileError> {
    let not_loaded = |e: libloading::Error| FileError::NotLoaded { path: path.to_owned(), reason: e.to_string() };
    // SAFETY: opening runs the library's constructors. The user chose the file, by the variable or by its place beside the program.
    let library = unsafe { libloading::Library::new(path) }.map_err(not_loaded)?;
    // SAFETY: the symbol's address is compared with null and never called, so its type does not matter.
    let found = unsafe { library.get::<unsafe extern "C" fn()>(b"OrtGetApiBase\0") }.map(drop);
    // Its threads and statics outlive any handle.
    std::mem::forget(library);
    found.map_err(|_| FileError::OtherLibrary { path: path.to_owned() })
}

fn not_started(file: &Path, error: &dyn std::error::Error) -> FileError {
    FileError::NotStarted { path: file.to_owned(), reason: error.to_string() }
}

fn open() -> Result<Environment, LibraryError> {
    let mut tried = Vec::new();
    for file in candidates() {
        let opened = probe(&file).and_then(|()| {
            let builder = ort::init_from(&file).map_err(|e| not_started(&file, &e))?;
            builder.with_name("panoscope").with_telemetry(false).build().map_err(|e| not_started(&file, &e))
        });
        match opened {
            Ok(environment) => return Ok(environment),
            Err(error) => tried.push(error),
        }
    }
    Err(LibraryError { tried })
}

/// The process's ONNX Runtime.
///
/// # Errors
/// No usable library was found.
pub fn environment() -> Result<&'static Environment, LibraryError> {
    static ENVIRONMENT: OnceLock<Result<Environment, LibraryError>> = OnceLock::new();
    ENVIRONMENT.get_or_init(open).as_ref().map_err(Clone::clone)
}
