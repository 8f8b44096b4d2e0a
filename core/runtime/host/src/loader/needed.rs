//! Finds the shared libraries that a plugin needs, without loading anything, with the search rules of glibc's dynamic
//! linker.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use crate::loader::elf::{OnDisk, Parts};

const PT_LOAD: u32 = 1;
const PT_DYNAMIC: u32 = 2;
const DT_NEEDED: u64 = 1;
const DT_STRTAB: u64 = 5;
const DT_STRSZ: u64 = 10;
const DT_RPATH: u64 = 15;
const DT_RUNPATH: u64 = 29;

/// Maximum size of a table, bytes; real libraries have a few hundred kilobytes.
const MAX_TABLE: u64 = 64 << 20;

/// Needed libraries in an ELF file.
#[derive(Default)]
struct Dynamic {
    needed: Vec<Vec<u8>>,
    /// Folders to search first, as written.
    run_paths: Vec<Vec<u8>>,
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..at.checked_add(8)?)?.try_into().ok()?))
}

fn read(file: &OnDisk, at: u64, len: u64) -> Option<Vec<u8>> {
    let fits = len <= MAX_TABLE && at.checked_add(len)? <= file.size();
    fits.then(|| file.part(at, len).ok().map(std::borrow::Cow::into_owned)).flatten()
}

/// The dynamic section of a 64-bit little-endian ELF file; `None` where it has none, or is damaged.
fn dynamic(path: &Path) -> Option<Dynamic> {
    let file = OnDisk::open(path).ok()?;
    let header = read(&file, 0, 64)?;
    if !header.starts_with(b"\x7fELF\x02\x01") {
        return None;
    }
    let (at, size) = (u64_at(&header, 32)?, u64::from(u32_at(&header, 54)? & 0xffff));
    let count = u64::from(u32_at(&header, 56)? & 0xffff);
    let table = read(&file, at, size.checked_mul(count)?)?;
    let (mut loads, mut section) = (Vec::new(), None);
    for entry in table.chunks_exact(usize::try_from(size).ok().filter(|size| *size >= 56)?) {
        let (offset, address, len) = (u64_at(entry, 8)?, u64_at(entry, 16)?, u64_at(entry, 32)?);
        match u32_at(entry, 0)? {
            PT_LOAD => loads.push((address, offset, len)),
            PT_DYNAMIC => section = Some((offset, len)),
            _ => {}
        }
    }
    let (offset, len) = section?;
    let section = read(&file, offset, len)?;
    let entries: Vec<(u64, u64)> =
        section.chunks_exact(16).filter_map(|entry| Some((u64_at(entry, 0)?, u64_at(entry, 8)?))).collect();
    let value = |tag: u64| entries.iter().find(|(t, _)| *t == tag).map(|(_, value)| *value);
    let address = value(DT_STRTAB)?;
    let (base, offset, _) =
        *loads.iter().find(|(base, _, len)| (*base..base.saturating_add(*len)).contains(&address))?;
    let texts = read(&file, offset.checked_add(address - base)?, value(DT_STRSZ)?)?;
    let text = |at: u64| -> Option<Vec<u8>> {
        let rest = texts.get(usize::try_from(at).ok()?..)?;
        Some(rest[..rest.iter().position(|b| *b == 0)?].to_vec())
    };
    let all = |tag: u64| entries.iter().filter(move |(t, _)| *t == tag).filter_map(|(_, at)| text(*at));
    // A newer RUNPATH replaces an RPATH.
    let run_paths = all(DT_RUNPATH).next().or_else(|| all(DT_RPATH).next()).unwrap_or_default();
    let run_paths = run_paths.split(|b| *b == b':').filter(|p| !p.is_empty()).map(<[u8]>::to_vec).collect();
    Some(Dynamic { needed: all(DT_NEEDED).collect(), run_paths })
}

/// Search paths of the dynamic linker: its variable, its cache and its folders.
struct Linker {
    variable: Vec<PathBuf>,
    cache: BTreeMap<Vec<u8>, PathBuf>,
    folders: Vec<PathBuf>,
}

impl Linker {
    fn of_this_process() -> Self {
        let variable = std::env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
        let variable = std::env::split_paths(&variable).filter(|p| !p.as_os_str().is_empty()).collect();
        let cache = std::fs::read("/etc/ld.so.cache").ok().map(|bytes| cache(&bytes)).unwrap_or_default();
        let machine = if cfg!(target_arch = "x86_64") { "x86_64-linux-gnu" } else { "aarch64-linux-gnu" };
        let folders = [format!("/lib/{machine}"), format!("/usr/lib/{machine}")].map(PathBuf::from);
        let plain = ["/lib64", "/usr/lib64", "/lib", "/usr/lib"].map(PathBuf::from);
        Self { variable, cache, folders: folders.into_iter().chain(plain).collect() }
    }

    /// The file of a library that `user` needs.
    fn find(&self, name: &[u8], user: Option<&Path>, run_paths: &[Vec<u8>]) -> Option<PathBuf> {
        let name_text = Path::new(OsStr::from_bytes(name));
        if name.contains(&b'/') {
            return Some(name_text.to_owned()).filter(|file| file.is_file());
        }
        let origin = user.and_then(Path::parent).map(|folder| folder.display().to_string());
        let own = run_paths.iter().filter_map(|path| {
            let text = String::from_utf8_lossy(path);
            match &origin {
                Some(origin) => Some(text.replace("$ORIGIN", origin).replace("${ORIGIN}", origin).into()),
                None => (!text.contains('$')).then(|| PathBuf::from(text.as_ref())),
            }
        });
        let before = self.variable.iter().cloned().chain(own).map(|folder| folder.join(name_text));
        let cached = self.cache.get(name).cloned();
        let after = self.folders.iter().map(|folder| folder.join(name_text));
        before.chain(cached).chain(after).find(|file| file.is_file())
    }
}

/// The entries of `/etc/ld.so.cache`, the first of each name.
fn cache(bytes: &[u8]) -> BTreeMap<Vec<u8>, PathBuf> {
    const MAGIC: &[u8] = b"glibc-ld.so.cache1.1";
    let mut found = BTreeMap::new();
    // An older cache may stand before the one of this format.
    let Some(start) = bytes.windows(MAGIC.len()).position(|window| window == MAGIC) else { return found };
    let bytes = &bytes[start..];
    let text = |at: u32| -> Option<&[u8]> {
        let rest = bytes.get(usize::try_from(at).ok()?..)?;
        Some(&rest[..rest.iter().position(|b| *b == 0)?])
    };
    for index in 0..u32_at(bytes, 20).unwrap_or(0) as usize {
        let at = 48 + 24 * index;
        let (Some(name), Some(file)) = (u32_at(bytes, at + 4), u32_at(bytes, at + 8)) else { break };
        if let (Some(name), Some(file)) = (text(name), text(file)) {
            found.entry(name.to_vec()).or_insert_with(|| PathBuf::from(OsStr::from_bytes(file)));
        }
    }
    found
}

/// A library by the name that the dynamic linker searches; `None` where it is not found.
pub fn library(name: &str) -> Option<PathBuf> {
    Linker::of_this_process().find(name.as_bytes(), None, &[])
}

/// All libraries that these files need, directly or not: name and file, sorted by name. The file is `None` where the
/// library is not found.
pub fn libraries<'f>(files: impl IntoIterator<Item = &'f Path>) -> BTreeMap<String, Option<PathBuf>> {
    let linker = Linker::of_this_process();
    let mut found = BTreeMap::new();
    let mut seen: BTreeSet<PathBuf> = BTreeSet::new();
    // A plugin is loaded from memory, so its own folder is not searched; a library's is.
    let mut waiting: Vec<(PathBuf, bool)> = files.into_iter().map(|file| (file.to_owned(), true)).collect();
    while let Some((file, is_plugin)) = waiting.pop() {
        if !seen.insert(file.clone()) {
            continue;
        }
        let Some(Dynamic { needed, run_paths }) = dynamic(&file) else { continue };
        for name in needed {
            let user = (!is_plugin).then_some(file.as_path());
            let library = linker.find(&name, user, &run_paths);
            waiting.extend(library.iter().map(|file| (file.clone(), false)));
            found.entry(String::from_utf8_lossy(&name).into_owned()).or_insert(library);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn libraries_of_a_program_are_found_with_those_they_need() {
        let program = std::env::current_exe().unwrap();
        let found = libraries([program.as_path()]);
        let libc = found.get("libc.so.6").cloned().flatten().expect("this program needs the C library");
        // The dynamic linker mapped the same file.
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
        let libc = libc.canonicalize().unwrap();
        assert!(maps.contains(&libc.display().to_string()), "{}", libc.display());
        assert!(found.values().all(|file| file.as_ref().is_some_and(|f| f.is_file())), "{found:?}");
    }

    #[test]
    fn damaged_files_need_nothing() {
        let file = std::env::temp_dir().join(format!("panoscope_needed_{}", std::process::id()));
        let whole = std::fs::read(std::env::current_exe().unwrap()).unwrap();
        for len in [0, 3, 63, 64, 100, 1000] {
            std::fs::write(&file, &whole[..len]).unwrap();
            assert!(libraries([file.as_path()]).is_empty(), "{len}");
        }
        for at in (0..64).chain(64..64 + 56 * 12) {
            let mut bytes = whole[..whole.len().min(1 << 16)].to_vec();
            bytes[at] ^= 0xff;
            std::fs::write(&file, bytes).unwrap();
            // Any answer is right, as long as there is one.
            let _ = libraries([file.as_path()]);
        }
        assert!(cache(b"glibc-ld.so.cache1.1\xff\xff\xff\xff").is_empty());
        std::fs::remove_file(file).unwrap();
    }
}
