//! Opens a graph under its lock: nothing is used before it is compared, and the compared bytes are the bytes in use.
//!
//! The order guarantees this:
//!
//! 1. The graph's files, the plugins, their libraries and the programs are compared on disk. No code of a plugin has
//!    run so far.
//! 2. The plugins are loaded, each from a sealed copy whose hash is compared once more before it is mapped. Now their
//!    node types say which parameters name files.
//! 3. Those files are copied into sealed memory, and the copies are compared. ONNX Runtime is loaded from its copy.
//! 4. Nodes get the paths of the copies instead of those of the files, whenever they open.

use std::path::Path;
use std::sync::Arc;

use panoscope_graph::{Catalog, Diagnostics, GraphText, ParamKind, check};

use crate::loader::depends;
use crate::loader::graph_file::Ready;
use crate::loader::lock::{Difference, Lock};
use crate::loader::locked_file::{Kind, LockedFile};
pub use crate::loader::seal::Seal;
use crate::loader::search::{Loader, search_path};

/// A graph that was not opened under its lock.
#[derive(Debug, thiserror::Error)]
pub enum VerifyError {
    /// Files differ from the lock.
    #[error("the graph differs from its lock:\n{}", .0.iter().map(|d| format!("  {d}")).collect::<Vec<_>>().join("\n"))]
    Differs(Vec<Difference>),
    /// The graph has mistakes.
    #[error("{}", .0.render(false).trim_end())]
    Check(Diagnostics),
    /// ONNX Runtime was compared, but cannot be loaded.
    #[error("ONNX Runtime is as it was locked, but cannot be loaded: {0}")]
    Runtime(String),
}

/// Loads ONNX Runtime from its sealed copy, before a node loads the file itself; nodes use the loaded one.
fn load_runtime(copy: &Path) -> Result<(), VerifyError> {
    // SAFETY: this runs the library's constructors; its bytes were compared with the lock, whose author answers for them.
    let library = unsafe { libloading::os::unix::Library::open(Some(copy), libc::RTLD_NOW | libc::RTLD_LOCAL) };
    // Its threads and statics outlive any handle.
    library.map(std::mem::forget).map_err(|error| VerifyError::Runtime(error.to_string()))
}

/// The plugins that may run before a graph is opened, to list its arguments: those of its lock, or none if a plugin or
/// library differs from it. Parts and overlays may still be missing, so they are not compared.
pub fn loader_before_opening(text: &GraphText, lock: &Lock, extra_plugins: &[&str]) -> Loader {
    let loader = Loader::search(&search_path(&text.plugin_paths())).pinned(&lock.files);
    let mut now = depends::code(text, loader.found(), extra_plugins);
    now.retain(|file| matches!(file.kind, Kind::Plugin | Kind::Library));
    match now.iter().all(|file| lock.files.contains(file)) {
        true => loader,
        false => Loader::default(),
    }
}

/// Reopens a graph under its lock after an earlier process opened it: loads its plugins and seals the files that match
/// the lock. A graph that reads a file that differs is refused until that file matches.
///
/// # Errors
/// Code or ONNX Runtime differs from the lock, or the graph has mistakes.
pub fn reopen(text: &GraphText, lock: &Lock, extra_plugins: &[&str]) -> Result<(Loader, Arc<Seal>), VerifyError> {
    let loader = locked_code(text, lock, extra_plugins)?;
    let catalog = loader.catalog_of(text);
    let mut unasked = without_checks(&catalog);
    for param in unasked.node_types.iter_mut().flat_map(|node_type| &mut node_type.params) {
        if let ParamKind::Path { must_exist, .. } = &mut param.kind {
            *must_exist = false;
        }
    }
    let (graph, _) = check(text, &unasked).into_result().map_err(VerifyError::Check)?;
    let folder = text.path().parent().unwrap_or(Path::new(""));
    let files = depends::data(&graph, &catalog, folder);
    let (mut seal, now, runtime) = Seal::of(&files, folder);
    same_files(lock, &now.iter().filter(|file| file.kind == Kind::Runtime).cloned().collect::<Vec<_>>(), |kind| {
        kind == Kind::Runtime
    })?;
    seal.withhold(&files, &now, lock);
    if let Some(runtime) = runtime {
        load_runtime(&runtime)?;
    }
    Ok((loader, Arc::new(seal)))
}

/// The plugins of a graph whose code matches the lock; none is loaded yet.
fn locked_code(text: &GraphText, lock: &Lock, extra_plugins: &[&str]) -> Result<Loader, VerifyError> {
    let loader = Loader::search(&search_path(&text.plugin_paths())).pinned(&lock.files);
    same_files(lock, &depends::code(text, loader.found(), extra_plugins), Kind::is_code)?;
    Ok(loader)
}

fn same_files(lock: &Lock, now: &[LockedFile], is_among: impl Fn(Kind) -> bool) -> Result<(), VerifyError> {
    match lock.differences_among(now, is_among) {
        differences if differences.is_empty() => Ok(()),
        differences => Err(VerifyError::Differs(differences)),
    }
}

/// Node types without the plugins' own checks, which read files.
fn without_checks(catalog: &Catalog) -> Catalog {
    let mut unasked = catalog.clone();
    unasked.node_types.iter_mut().for_each(|node_type| node_type.validator = None);
    unasked
}

/// Opens a graph under its lock. `extra_plugins` are plugins in the lock in addition to the graph's own.
///
/// # Errors
/// See [`VerifyError`]. Where files of step 1 differ, no plugin was loaded.
pub fn open(text: &GraphText, lock: &Lock, extra_plugins: &[&str]) -> Result<Ready, VerifyError> {
    let loader = locked_code(text, lock, extra_plugins)?;
    let catalog = loader.catalog_of(text);
    // The files are not compared yet.
    let (graph, _) = check(text, &without_checks(&catalog)).into_result().map_err(VerifyError::Check)?;
    let folder = text.path().parent().unwrap_or(Path::new(""));
    let files = depends::data(&graph, &catalog, folder);
    let (seal, now, runtime) = Seal::of(&files, folder);
    same_files(lock, &now, |kind| !kind.is_code())?;
    if let Some(runtime) = runtime {
        load_runtime(&runtime)?;
    }
    let (graph, warnings) = check(text, &catalog).into_result().map_err(VerifyError::Check)?;
    let (text, loader, seal) = (text.clone(), Arc::new(loader), Some(Arc::new(seal)));
    Ok(Ready { text, graph, catalog, loader, warnings, seal })
}
