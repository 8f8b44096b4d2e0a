//! Finding and opening ONNX Runtime's shared library, once per process.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use ort::environment::Environment;

/// Why there is no ONNX Runtime.
#[derive(Clone, Debug)]
pub struct LibraryError {
    tried: Vec<String>,
}

impl std::fmt::Display for LibraryError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "ONNX Runtime's shared library is not there: run `cargo xtask onnxruntime`, or name the file in ORT_DYLIB_PATH (tried: {})",
            self.tried.join("; ")
        )
    }
}

impl std::error::Error for LibraryError {}

fn libraries_in(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let is_library = |p: &PathBuf| {
        p.file_name().is_some_and(|n| n.to_string_lossy().starts_with("libonnxruntime.so")) && !p.is_symlink()
    };
    let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(is_library).collect();
    found.sort();
    found
}

/// Where the library may stand: the variable first, then beside the program, then the system's own.
fn places() -> Vec<PathBuf> {
    if let Some(named) = std::env::var_os("ORT_DYLIB_PATH").filter(|p| !p.is_empty()) {
        return vec![named.into()];
    }
    let mut places = Vec::new();
    if let Ok(program) = std::env::current_exe() {
        for folder in program.ancestors().skip(1).take(4) {
            places.extend(libraries_in(&folder.join("onnxruntime")));
        }
    }
    places.push("libonnxruntime.so".into());
    places
}

/// Whether the file is an ONNX Runtime: `ort` itself ends the process over one that is not.
fn probe(path: &Path) -> Result<(), String> {
    // SAFETY: opening runs the library's constructors; that is what naming it asks for.
    let library = unsafe { libloading::Library::new(path) }.map_err(|e| format!("{}: {e}", path.display()))?;
    // SAFETY: only the address is looked at.
    let found = unsafe { library.get::<unsafe extern "C" fn()>(b"OrtGetApiBase\0") }.map(drop);
    // Its threads and statics outlive any handle.
    std::mem::forget(library);
    found.map_err(|_| format!("{}: has no OrtGetApiBase", path.display()))
}

fn open() -> Result<Environment, LibraryError> {
    let mut tried = Vec::new();
    for place in places() {
        let opened = probe(&place).and_then(|()| {
            let builder = ort::init_from(&place).map_err(|e| format!("{}: {e}", place.display()))?;
            builder
                .with_name("panoscope")
                .with_telemetry(false)
                .build()
                .map_err(|e| format!("{}: {e}", place.display()))
        });
        match opened {
            Ok(environment) => return Ok(environment),
            Err(reason) => tried.push(reason),
        }
    }
    Err(LibraryError { tried })
}

/// The process's ONNX Runtime.
pub fn environment() -> Result<&'static Environment, LibraryError> {
    static ENVIRONMENT: OnceLock<Result<Environment, LibraryError>> = OnceLock::new();
    ENVIRONMENT.get_or_init(open).as_ref().map_err(Clone::clone)
}
