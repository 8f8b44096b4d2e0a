//! Immutable copies of files in memory, so that the hashed bytes are the bytes in use.

use std::collections::BTreeMap;
use std::ffi::CString;
use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{AsRawFd, FromRawFd};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use sha2::{Digest, Sha256};

/// Length and SHA-256 of a file's contents.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fingerprint {
    /// Length in bytes.
    pub bytes: u64,
    /// SHA-256 as hexadecimal digits.
    pub sha256: String,
}

impl Fingerprint {
    /// The fingerprint of some bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len() as u64, sha256: hex(&Sha256::digest(bytes)) }
    }

    /// The fingerprint of an open file from its position on.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of_open(file: &mut File) -> std::io::Result<Self> {
        copy(file, &mut std::io::sink())
    }

    /// The fingerprint of a file on disk, as it is now.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of_file(file: &Path) -> std::io::Result<Self> {
        copy(&mut File::open(file)?, &mut std::io::sink())
    }
}

/// Bytes as hexadecimal digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Maximum wait of [`SealedWriter::seal`] for a file that is in use.
const BUSY_LIMIT: Duration = Duration::from_secs(5);
const BUSY_PAUSE: Duration = Duration::from_millis(10);

/// Copies all of `from`; the fingerprint is that of the bytes that were written.
fn copy(from: &mut impl Read, to: &mut impl Write) -> std::io::Result<Fingerprint> {
    let (mut hash, mut buffer, mut bytes) = (Sha256::new(), vec![0; 1 << 16], 0);
    loop {
        match from.read(&mut buffer) {
            Ok(0) => return Ok(Fingerprint { bytes, sha256: hex(&hash.finalize()) }),
            Ok(n) => {
                to.write_all(&buffer[..n])?;
                hash.update(&buffer[..n]);
                bytes += n as u64;
            }
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

/// An anonymous file in memory that is being filled.
pub struct SealedWriter {
    file: File,
}

impl SealedWriter {
    /// An empty file. `name` is what debuggers and `/proc/PID/maps` show.
    ///
    /// # Errors
    /// The system has run out of file descriptors or has no memory files.
    pub fn new(name: &Path) -> std::io::Result<Self> {
        let name = name.file_name().unwrap_or(name.as_os_str()).to_string_lossy();
        // The kernel takes at most 249 bytes.
        let name: String = name.chars().filter(|c| *c != '\0').take(60).collect();
        let name = CString::new(name).map_err(std::io::Error::other)?;
        // SAFETY: `name` is a zero-terminated text that lives until the call returns.
        let fd = unsafe { libc::memfd_create(name.as_ptr(), libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING) };
        if fd < 0 {
            return Err(std::io::Error::last_os_error());
        }
        // SAFETY: `memfd_create` returned this file descriptor, and nothing else owns it.
        Ok(Self { file: unsafe { File::from_raw_fd(fd) } })
    }

    /// Appends a file; the fingerprint is that of the appended bytes.
    ///
    /// # Errors
    /// The file cannot be read, or the memory is full.
    pub fn append_file(&mut self, file: &Path) -> std::io::Result<Fingerprint> {
        self.append_from(&mut File::open(file)?)
    }

    /// Appends all of an open file; the fingerprint is that of the appended bytes.
    ///
    /// # Errors
    /// As [`Self::append_file`].
    pub fn append_from(&mut self, file: &mut File) -> std::io::Result<Fingerprint> {
        copy(file, &mut self.file)
    }

    /// As [`Self::append_from`] without a fingerprint.
    ///
    /// # Errors
    /// As [`Self::append_file`].
    pub fn append_unhashed(&mut self, file: &mut File) -> std::io::Result<()> {
        std::io::copy(file, &mut self.file).map(drop)
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// The memory is full.
    pub fn append(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.file.write_all(bytes)
    }

    /// Seals the file: the kernel then refuses every change, even by this process. Waits while the kernel uses pages of
    /// the file, which happens briefly on a busy machine.
    ///
    /// # Errors
    /// The kernel refuses the seals, or the file is in use for longer than [`BUSY_LIMIT`].
    pub fn seal(self) -> std::io::Result<File> {
        let seals = libc::F_SEAL_WRITE | libc::F_SEAL_GROW | libc::F_SEAL_SHRINK | libc::F_SEAL_SEAL;
        let begun = Instant::now();
        loop {
            // SAFETY: a plain system call on a file descriptor that `self` owns.
            if unsafe { libc::fcntl(self.file.as_raw_fd(), libc::F_ADD_SEALS, seals) } == 0 {
                return Ok(self.file);
            }
            let error = std::io::Error::last_os_error();
            if error.raw_os_error() != Some(libc::EBUSY) || begun.elapsed() > BUSY_LIMIT {
                return Err(error);
            }
            std::thread::sleep(BUSY_PAUSE);
        }
    }
}

/// Path under which this process and its children open a file of this process. It is valid as long as the file stays
/// open.
pub fn path_of(file: &File) -> PathBuf {
    PathBuf::from(format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd()))
}

/// A sealed copy that stays open.
struct Kept {
    path: PathBuf,
    /// The file that it was made of.
    original: PathBuf,
}

/// The sealed copies by their contents. They stay open until the process ends, because a node may reopen its file at
/// any time.
static KEPT: Mutex<BTreeMap<String, Kept>> = Mutex::new(BTreeMap::new());

/// Keeps a sealed copy for the rest of the process, and returns its path. `contents` identifies the content; equal
/// `contents` give the same path: a node whose file is unchanged keeps its parameters.
pub(crate) fn keep(contents: String, sealed: File, original: &Path) -> PathBuf {
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    let entry = kept.entry(contents).or_insert_with(|| {
        let path = path_of(&sealed);
        std::mem::forget(sealed);
        Kept { path, original: original.to_owned() }
    });
    entry.path.clone()
}

/// Whether a path is that of a sealed copy.
pub(crate) fn is_copy(path: &Path) -> bool {
    let kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    kept.values().any(|kept| kept.path == path)
}

/// A message with the names of files in place of the paths of their sealed copies.
pub fn readable(message: &str) -> String {
    let kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    let mut copies: Vec<(String, String)> =
        kept.values().map(|kept| (kept.path.display().to_string(), kept.original.display().to_string())).collect();
    // The longest first: one path may begin with another.
    copies.sort_by_key(|(path, _)| std::cmp::Reverse(path.len()));
    copies.iter().fold(message.to_owned(), |message, (path, original)| message.replace(path, original))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sealing_waits_while_the_file_is_in_use() {
        let mut writer = SealedWriter::new(Path::new("busy")).unwrap();
        writer.append(b"abc").unwrap();
        // SAFETY: a new mapping of a file that is open and three bytes long.
        let mapped = unsafe {
            let (rights, fd) = (libc::PROT_READ | libc::PROT_WRITE, writer.file.as_raw_fd());
            libc::mmap(std::ptr::null_mut(), 3, rights, libc::MAP_SHARED, fd, 0)
        };
        assert_ne!(mapped, libc::MAP_FAILED);
        let address = mapped as usize;
        let other = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(100));
            // SAFETY: the mapping made above, which nobody reads or writes.
            unsafe { libc::munmap(address as *mut libc::c_void, 3) }
        });
        let sealed = writer.seal().unwrap();
        assert_eq!(other.join().unwrap(), 0);
        assert!((&sealed).write_all(b"x").is_err());
    }

    #[test]
    fn a_sealed_copy_refuses_every_change() {
        let source = std::env::temp_dir().join(format!("panoscope_sealed_{}", std::process::id()));
        std::fs::write(&source, "abc").unwrap();
        let mut writer = SealedWriter::new(&source).unwrap();
        let found = writer.append_file(&source).unwrap();
        assert_eq!(found.sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_eq!((found.clone(), Fingerprint::of_file(&source).unwrap()), (Fingerprint::of(b"abc"), found));
        let sealed = writer.seal().unwrap();
        // The original may change; the copy may not.
        std::fs::write(&source, "other").unwrap();
        let path = path_of(&sealed);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "abc");
        assert!(std::fs::write(&path, "x").is_err());
        assert!((&sealed).write_all(b"x").is_err());
        assert!(sealed.set_len(0).is_err() && sealed.set_len(9).is_err());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "abc");
        let kept = keep("abc".to_owned(), sealed, &source);
        let message = format!("cannot read {}: why", kept.display());
        assert_eq!(readable(&message), format!("cannot read {}: why", source.display()));
        let again = SealedWriter::new(&source).unwrap().seal().unwrap();
        assert_eq!(keep("abc".to_owned(), again, &source), kept, "equal contents have one path");
        std::fs::remove_file(source).unwrap();
    }
}
