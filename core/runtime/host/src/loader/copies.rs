//! Sealed copies of plugins, and the results of loading them: one of each per file content, shared by all loaders of
//! the process.
//!
//! A copy and a mapped library stay until the process ends. Without sharing, each graph that one process opens would
//! add a file descriptor and the memory of its plugins.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use crate::loader::elf::{self, Parts};
use crate::loader::error::LoadError;
use crate::loader::plugin_file::{Loaded, PluginFile};
use crate::loader::sealed::{Fingerprint, SealedWriter};

/// Size of the blocks that are compared.
const CHUNK_BYTES: usize = 1 << 16;

/// Origin of a [`Loaded`]; each has separate node types.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Way {
    /// The library was mapped into this process.
    Mapped,
    /// Another process described it. For Python: the name of its description, which depends on the interpreter and on
    /// the modules next to the file.
    Described(Option<PathBuf>),
}

/// A sealed copy of a plugin's file.
pub(crate) struct PluginCopy {
    file: PathBuf,
    /// Path of the copy; valid until the process ends.
    pub path: PathBuf,
    bytes: elf::OnDisk,
    sha256: OnceLock<String>,
    loaded: Mutex<BTreeMap<Way, Loaded>>,
}

/// All copies. They are never removed: debuggers read symbols through them, processes of isolated nodes map them, and
/// the dynamic linker would mistake another file of the same number for one of them.
static COPIES: Mutex<Vec<Arc<PluginCopy>>> = Mutex::new(Vec::new());

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The sealed copy of a plugin's file as it is now; with this SHA-256, if one is given.
pub(crate) fn copy_of(plugin: &PluginFile, sha256: Option<&str>) -> Result<Arc<PluginCopy>, LoadError> {
    let file = &plugin.file;
    let unreadable = |cause| LoadError::Unreadable { file: file.clone(), cause };
    let mut copies = lock(&COPIES);
    for copy in copies.iter().filter(|copy| copy.file == *file) {
        if copy.is_same(file).map_err(unreadable)? {
            copy.check(sha256)?;
            return Ok(Arc::clone(copy));
        }
    }
    let copy = PluginCopy::new(file, File::open(file).map_err(unreadable)?)?;
    // Before anything of it is mapped: its constructors run as soon as it is.
    copy.check(sha256)?;
    // The copy is checked again, because the file may have changed since it was found.
    if plugin.python.is_none() {
        elf::read_note(&copy.bytes).map_err(|cause| LoadError::BadFile { file: file.clone(), cause })?;
    }
    let copy = Arc::new(copy);
    copies.push(Arc::clone(&copy));
    Ok(copy)
}

impl PluginCopy {
    fn new(file: &Path, mut whole: File) -> Result<Self, LoadError> {
        let mut copied = || -> std::io::Result<File> {
            let mut writer = SealedWriter::new(file)?;
            writer.append_unhashed(&mut whole)?;
            writer.seal()
        };
        let sealed = copied().and_then(|copy| {
            let path = PathBuf::from(format!("/proc/self/fd/{}", copy.as_raw_fd()));
            Ok((path, elf::OnDisk::over(copy)?))
        });
        let (path, bytes) = sealed.map_err(|cause| LoadError::Copy { file: file.to_owned(), cause })?;
        Ok(Self { file: file.to_owned(), path, bytes, sha256: OnceLock::new(), loaded: Mutex::default() })
    }

    /// Whether a file has the bytes of this copy.
    fn is_same(&self, file: &Path) -> std::io::Result<bool> {
        let mut file = File::open(file)?;
        if file.metadata()?.len() != self.bytes.size() {
            return Ok(false);
        }
        let (mut buffer, mut at) = (vec![0; CHUNK_BYTES], 0);
        loop {
            let read = match file.read(&mut buffer) {
                Ok(0) => return Ok(at == self.bytes.size()),
                Ok(read) => read as u64,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            let is_inside = at + read <= self.bytes.size();
            let same = |part: &[u8]| *part == buffer[..read as usize];
            if !is_inside || !self.bytes.part(at, read).is_ok_and(|part| same(&part)) {
                return Ok(false);
            }
            at += read;
        }
    }

    /// Compares the copy with a SHA-256.
    fn check(&self, sha256: Option<&str>) -> Result<(), LoadError> {
        let Some(sha256) = sha256 else { return Ok(()) };
        let own = match self.sha256.get() {
            Some(own) => own,
            None => {
                let found = Fingerprint::of_file(&self.path);
                let found = found.map_err(|cause| LoadError::Copy { file: self.file.clone(), cause })?;
                self.sha256.get_or_init(|| found.sha256)
            }
        };
        match own == sha256 {
            true => Ok(()),
            false => Err(LoadError::NotLocked { file: self.file.clone() }),
        }
    }

    /// The result of loading the copy in this way; loads it the first time and retries after a failure.
    pub fn loaded(&self, way: Way, load: impl FnOnce() -> Result<Loaded, LoadError>) -> Result<Loaded, LoadError> {
        let mut loaded = lock(&self.loaded);
        if let Some(loaded) = loaded.get(&way) {
            return Ok(loaded.clone());
        }
        let new = load()?;
        loaded.insert(way, new.clone());
        Ok(new)
    }
}
