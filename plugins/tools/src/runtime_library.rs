//! Finding and opening ONNX Runtime's shared library, once per process.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use ort::environment::Environment;

/// No file is a usable ONNX Runtime.
#[derive(Clone, Debug, thiserror::Error)]
#[error(
    "ONNX Runtime's shared library is not there: run `cargo xtask onnxruntime`, or name the file in ORT_DYLIB_PATH (tried: {})",
    .tried.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
)]
pub struct LibraryError {
    /// Each file that was tried.
    pub tried: Vec<FileError>,
}

/// Why one file is no usable ONNX Runtime.
#[derive(Clone, Debug, thiserror::Error)]
pub enum FileError {
    /// The system does not load it.
    #[error("{path}: {reason}", path = path.display())]
    NotLoaded {
        /// The file.
        path: PathBuf,
        /// The system's message.
        reason: String,
    },
    /// It is another library.
    #[error("{path}: has no OrtGetApiBase", path = path.display())]
    OtherLibrary {
        /// The file.
        path: PathBuf,
    },
    /// ONNX Runtime does not start.
    #[error("{path}: {reason}", path = path.display())]
    NotStarted {
        /// The file.
        path: PathBuf,
        /// Its message.
        reason: String,
    },
}

fn libraries_in(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let is_library = |p: &PathBuf| {
        p.file_name().is_some_and(|n| n.to_string_lossy().starts_with("libonnxruntime.so")) && !p.is_symlink()
    };
    let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(is_library).collect();
    found.sort();
    found
}

/// Files to try: the variable's first, then those beside the program, then the system's.
fn candidates() -> Vec<PathBuf> {
    if let Some(named) = std::env::var_os("ORT_DYLIB_PATH").filter(|p| !p.is_empty()) {
        return vec![named.into()];
    }
    let mut files = Vec::new();
    if let Ok(program) = std::env::current_exe() {
        for folder in program.ancestors().skip(1).take(4) {
            files.extend(libraries_in(&folder.join("onnxruntime")));
        }
    }
    files.push("libonnxruntime.so".into());
    files
}

/// Checks that a file is an ONNX Runtime, because `ort` ends the process when it is not.
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
