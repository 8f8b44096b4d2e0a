//! Maps a plugin's file into the process and reads its description.

use std::ffi::OsStr;
use std::fs::File;
use std::path::{Path, PathBuf};

use panoscope_abi as abi;
use panoscope_engine::loading;
use panoscope_graph::NodeType;

use crate::elf::{self, Note};
use crate::error::LoadError;

/// A plugin's file and what its note says.
#[derive(Clone, Debug)]
pub struct Found {
    /// The shared library.
    pub file: PathBuf,
    /// What stands in its note.
    pub note: Note,
}

/// A loaded plugin; it stays mapped until the process ends.
#[derive(Clone)]
pub struct Loaded {
    /// Where it came from.
    pub found: Found,
    /// Its node types for the catalogue.
    pub node_types: Vec<NodeType>,
    /// Its node types for the engine, in the same order.
    pub entries: Vec<&'static abi::NodeType>,
}

/// Reads a plugin's note without loading it.
pub fn inspect(file: &Path) -> Result<Found, LoadError> {
    let parts = elf::OnDisk::open(file).map_err(|cause| LoadError::Unreadable { file: file.to_owned(), cause })?;
    let note = elf::read_note(&parts).map_err(|cause| LoadError::BadFile { file: file.to_owned(), cause })?;
    if note.abi_major != abi::ABI_MAJOR {
        let (found, expected) = (note.abi_major, abi::ABI_MAJOR);
        return Err(LoadError::AbiMismatch { file: file.to_owned(), found, expected });
    }
    Ok(Found { file: file.to_owned(), note })
}

/// Loads a plugin from a private copy of its file, so that a rebuild never changes what is mapped.
pub fn load(found: &Found) -> Result<Loaded, LoadError> {
    let file = &found.file;
    let link = |cause: String| LoadError::Link { file: file.clone(), cause };
    let mut whole = File::open(file).map_err(|cause| LoadError::Unreadable { file: file.clone(), cause })?;
    let copy = private_copy(file, &mut whole).map_err(|e| link(format!("no private copy could be made: {e}")))?;
    // Checked again on the very bytes that are loaded: the file may have changed since it was found.
    elf::read_note(&copy.parts).map_err(|cause| LoadError::BadFile { file: file.clone(), cause })?;
    // SAFETY: constructors of the library run here. The note says that it is a plugin of this ABI; a plugin is trusted like
    // any program its user installs.
    let library = loading::run(file, || unsafe {
        libloading::os::unix::Library::open(Some(&copy.path), libc::RTLD_NOW | libc::RTLD_LOCAL)
            .map_err(|e| link(clean(&e, &copy.path, file)))
    });
    let library = library?;
    let bad = |cause: String| LoadError::BadDescriptor { file: file.clone(), cause };
    // SAFETY: the symbol's type is part of the contract.
    let plugin = unsafe {
        let entry = library
            .get::<abi::Entry>(abi::ENTRY_SYMBOL.as_bytes())
            .map_err(|_| bad(format!("it exports no symbol `{}`", abi::ENTRY_SYMBOL)))?;
        loading::run(file, || entry())
    };
    // The library stays mapped: its threads, thread-locals and exit handlers cannot be undone safely. The descriptor of its copy stays open
    // like the mapping: debuggers and profilers read symbols through it.
    std::mem::forget(library);
    std::mem::forget(copy);
    // SAFETY: a descriptor of a plugin that stays mapped; every field is checked before use.
    let mut node_types = unsafe { panoscope_graph::from_abi::node_types(plugin) }.map_err(|e| bad(e.to_string()))?;
    // Files that come with a plugin lie in a folder of its name beside its library.
    let shipped_dir = file.parent().unwrap_or(Path::new("")).join(&found.note.name);
    for node_type in &mut node_types {
        node_type.shipped_dir.clone_from(&shipped_dir);
        node_type.validator = node_type.validator.take().map(|v| loading::guard_check(&node_type.name, file, v));
    }
    // SAFETY: validated by `node_types`.
    let descriptor = unsafe { &*plugin };
    // SAFETY: the texts of the descriptor are statics of the plugin, which stays mapped.
    let name = unsafe { descriptor.name.text() }.unwrap_or("");
    if name != found.note.name {
        return Err(bad(format!("its note says `{}`, its code says `{name}`", found.note.name)));
    }
    // SAFETY: validated by `node_types`.
    let entries: Vec<&'static abi::NodeType> = (0..descriptor.node_types_len)
        .map(|index| unsafe { panoscope_graph::from_abi::whole(*descriptor.node_types.add(index)) })
        .collect();
    loading::remember(&entries, file);
    if let Some(attach) = descriptor.attach {
        // SAFETY: the plugin's table outlives it.
        let status = loading::run(file, || unsafe { attach(loading::plugin_table(plugin)) });
        if status != abi::STATUS_OK {
            return Err(bad(format!("it refused the host ({status})")));
        }
    }
    Ok(Loaded { found: found.clone(), node_types, entries })
}

struct PrivateCopy {
    path: PathBuf,
    /// The same bytes.
    parts: elf::OnDisk,
}

/// A copy in memory.
fn private_copy(file: &Path, whole: &mut File) -> std::io::Result<PrivateCopy> {
    use std::os::fd::{AsRawFd, FromRawFd};
    let name = file.file_name().unwrap_or(OsStr::new("plugin")).to_string_lossy();
    let c_name = std::ffi::CString::new(name.as_bytes()).map_err(std::io::Error::other)?;
    // SAFETY: a plain system call with a terminated name.
    let fd = unsafe { libc::memfd_create(c_name.as_ptr(), libc::MFD_CLOEXEC) };
    if fd < 0 {
        return Err(std::io::Error::last_os_error());
    }
    // SAFETY: a fresh descriptor that nobody else owns.
    let mut copy = unsafe { File::from_raw_fd(fd) };
    std::io::copy(whole, &mut copy)?;
    let path = PathBuf::from(format!("/proc/self/fd/{}", copy.as_raw_fd()));
    Ok(PrivateCopy { path, parts: elf::OnDisk::over(copy)? })
}

fn clean(error: &libloading::Error, copy: &Path, file: &Path) -> String {
    let mut text = error.to_string();
    if let Some(source) = std::error::Error::source(error) {
        text = source.to_string();
    }
    text.replace(&copy.display().to_string(), &file.display().to_string())
}
