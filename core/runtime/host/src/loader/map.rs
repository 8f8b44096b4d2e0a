//! Maps a plugin's file into the process and reads its descriptor.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::isolate::{Describer, Description};
use panoscope_abi as abi;
use panoscope_engine::loading;
use panoscope_engine::memory::open_device_by;
use panoscope_graph::from_abi::problems_of;
use panoscope_graph::{NodeSetup, NodeType, ParamProblem, Severity, Validator};

use crate::loader::copies::{Way, copy_of};
use crate::loader::elf;
use crate::loader::error::LoadError;
use crate::loader::file_name::is_python;
use crate::loader::plugin_file::{Loaded, PluginFile};
use crate::loader::python::{self, Python};

/// Reads a plugin's note without loading the plugin.
pub fn inspect(file: &Path) -> Result<PluginFile, LoadError> {
    if is_python(file) {
        let (note, python) = python::inspect(file)?;
        return Ok(PluginFile { file: file.to_owned(), note, python: Some(python) });
    }
    let parts = elf::OnDisk::open(file).map_err(|cause| LoadError::Unreadable { file: file.to_owned(), cause })?;
    let note = elf::read_note(&parts).map_err(|cause| LoadError::BadFile { file: file.to_owned(), cause })?;
    if note.abi_major != abi::ABI_MAJOR {
        let (found, expected) = (note.abi_major, abi::ABI_MAJOR);
        return Err(LoadError::AbiMismatch { file: file.to_owned(), found, expected });
    }
    Ok(PluginFile { file: file.to_owned(), note, python: None })
}

/// Loads a plugin from a private copy of its file, so that a rebuild does not change mapped memory.
pub fn load(plugin: &PluginFile) -> Result<Loaded, LoadError> {
    load_verified(plugin, None)
}

/// As [`load`], but only if the copy has this SHA-256. The copy is sealed and then mapped: the bytes that were compared
/// are those that run. Unchanged files are mapped once per process.
pub fn load_verified(plugin: &PluginFile, sha256: Option<&str>) -> Result<Loaded, LoadError> {
    let copy = copy_of(plugin, sha256)?;
    copy.loaded(Way::Mapped, || {
        let mapped = map(plugin, &copy.path)?;
        crate::isolate::remember(&mapped.entries, &copy.path, &plugin.file);
        Ok(mapped)
    })
}

/// As [`load_verified`], for a plugin whose nodes all run in separate processes: none of its code runs in this process.
/// A confined process maps the copy and describes it within `limit`.
pub fn describe_verified(plugin: &PluginFile, sha256: Option<&str>, limit: Duration) -> Result<Loaded, LoadError> {
    let copy = copy_of(plugin, sha256)?;
    let kept = plugin.python.as_ref().and_then(|python| python.kept_description(&plugin.file, &copy.path));
    copy.loaded(Way::Described(kept.clone()), || describe(plugin, &copy.path, limit, kept.as_deref()))
}

/// Loads a plugin from an image of its file, in a process of isolated nodes. The process that sent the image verified
/// it.
pub(crate) fn load_image(image: &Path, file: &Path) -> Result<Loaded, LoadError> {
    let PluginFile { note, .. } = inspect(image)?;
    map(&PluginFile { file: file.to_owned(), note, python: None }, image)
}

/// Asks a separate process what a plugin offers.
fn describe(plugin: &PluginFile, image: &Path, limit: Duration, kept: Option<&Path>) -> Result<Loaded, LoadError> {
    let PluginFile { file, note, python } = plugin;
    let launch = python.as_ref().map(Python::launch).transpose();
    let launch = launch.map_err(|cause| LoadError::NoPython { file: file.clone(), cause })?;
    let described = crate::isolate::describe(image, file, &note.name, launch, limit, kept);
    let Description { plugin: descriptor, describer } =
        described.map_err(|cause| LoadError::Undescribed { file: file.clone(), cause })?;
    // SAFETY: what another process wrote was read into memory that is never freed; its lengths are those of that memory.
    let (mut node_types, entries) = unsafe { checked(descriptor, plugin)? };
    for (index, node_type) in node_types.iter_mut().enumerate().filter(|(_, node_type)| node_type.validator.is_some()) {
        let describer = Arc::clone(&describer);
        node_type.validator = Some(Validator::new(move |setup| problems(&describer, index as u32, setup)));
    }
    if let Some(python) = python {
        node_types.iter_mut().for_each(|node_type| node_type.interpreter = Some(python.interpreter.clone()));
    }
    crate::isolate::remember_described(&entries, &describer);
    loading::remember(&entries, file);
    Ok(Loaded { plugin: plugin.clone(), node_types, entries })
}

/// Problems of parameters and wiring, reported by a node type that another process loads.
fn problems(describer: &Describer, index: u32, setup: &NodeSetup<'_>) -> Vec<ParamProblem> {
    let mut failure = None;
    let mut problems = problems_of(setup, |call| {
        // SAFETY: `problems_of` lends a call that lives until this returns.
        unsafe { describer.validate(index, call) }.unwrap_or_else(|error| {
            failure = Some(error.to_string());
            abi::STATUS_OK
        })
    });
    if let Some(message) = failure {
        let message = format!("its parameters could not be checked: {message}");
        problems.push(ParamProblem { severity: Severity::Error, param: None, message, help: String::new() });
    }
    problems
}

/// The node types of a descriptor, for the catalogue and for the engine.
///
/// # Safety
/// The descriptor is null, or a plugin's descriptor that stays valid until the process ends.
unsafe fn checked(
    descriptor: *const abi::Plugin,
    plugin: &PluginFile,
) -> Result<(Vec<NodeType>, Vec<&'static abi::NodeType>), LoadError> {
    let PluginFile { file, note, .. } = plugin;
    let bad = |cause: String| LoadError::BadDescriptor { file: file.clone(), cause };
    // SAFETY: the caller's promise; `node_types` checks every field before it uses it.
    let mut node_types =
        unsafe { panoscope_graph::from_abi::node_types(descriptor) }.map_err(|e| bad(e.to_string()))?;
    // Files that ship with a plugin are in a folder of the plugin's name beside its library.
    let shipped_dir = file.parent().unwrap_or(Path::new("")).join(&note.name);
    for node_type in &mut node_types {
        node_type.shipped_dir.clone_from(&shipped_dir);
    }
    // SAFETY: `node_types` checked the descriptor, which stays valid.
    let descriptor = unsafe { &*descriptor };
    // SAFETY: `node_types` checked the name, which stays valid.
    let name = unsafe { descriptor.name.text() }.unwrap_or("");
    if name != note.name {
        return Err(bad(format!("its note says `{}`, its code says `{name}`", note.name)));
    }
    // SAFETY: `node_types` checked the array of node types and its length.
    let entries = (0..descriptor.node_types_len)
        .map(|index| unsafe { panoscope_graph::from_abi::whole(*descriptor.node_types.add(index)) })
        .collect();
    Ok((node_types, entries))
}

/// Maps the image of a plugin's file.
fn map(plugin: &PluginFile, image: &Path) -> Result<Loaded, LoadError> {
    let PluginFile { file, .. } = plugin;
    let link = |cause: String| LoadError::Link { file: file.clone(), cause };
    // SAFETY: this runs the library's constructors. `read_note` checked that it is a complete plugin of this ABI; the user who
    // installs a plugin is responsible for what its code does.
    let library = loading::run(file, || unsafe {
        libloading::os::unix::Library::open(Some(image), libc::RTLD_NOW | libc::RTLD_LOCAL)
            .map_err(|e| link(clean(&e, image, file)))
    });
    let library = library?;
    let bad = |cause: String| LoadError::BadDescriptor { file: file.clone(), cause };
    // SAFETY: the ABI fixes the type of the entry symbol; the plugin's note claims this ABI.
    let descriptor = unsafe {
        let entry = library
            .get::<abi::Entry>(abi::ENTRY_SYMBOL.as_bytes())
            .map_err(|_| bad(format!("it exports no symbol `{}`", abi::ENTRY_SYMBOL)))?;
        loading::run(file, || entry())
    };
    // The library stays mapped, because its threads, thread-locals and exit handlers cannot be removed safely.
    std::mem::forget(library);
    // SAFETY: the plugin stays mapped.
    let (mut node_types, entries) = unsafe { checked(descriptor, plugin)? };
    for node_type in &mut node_types {
        node_type.validator = node_type.validator.take().map(|v| loading::guard_check(&node_type.name, file, v));
    }
    loading::remember(&entries, file);
    // SAFETY: `checked` read the descriptor, which stays mapped.
    if let Some(attach) = unsafe { (*descriptor).attach } {
        open_device_by(panoscope_gpu::table);
        // SAFETY: `plugin_table` returns a table that is never freed.
        let status = loading::run(file, || unsafe { attach(loading::plugin_table(descriptor)) });
        if status != abi::STATUS_OK {
            return Err(bad(format!("its `attach` function returned status {status}")));
        }
    }
    Ok(Loaded { plugin: plugin.clone(), node_types, entries })
}

/// The dynamic linker's message, with the file's path instead of the copy's.
fn clean(error: &libloading::Error, copy: &Path, file: &Path) -> String {
    let mut text = error.to_string();
    if let Some(source) = std::error::Error::source(error) {
        text = source.to_string();
    }
    text.replace(&copy.display().to_string(), &file.display().to_string())
}
