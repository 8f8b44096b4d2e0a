//! Files that a run writes: one run at a time, readable by their owner only, never through a symbolic link.

use std::ffi::OsString;
use std::fs::{self, DirBuilder, File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

pub use panoscope_base::files::{create, is_special};

/// Maximum wait of a run for the lock of an output: a run that was just killed may still hold it.
pub const LOCK_PATIENCE: Duration = Duration::from_secs(1);
/// Time between two attempts to lock.
const LOCK_POLL: Duration = Duration::from_millis(10);

/// Another run has the lock of an output.
#[derive(Debug, thiserror::Error)]
#[error(
    "another run{} writes {}: stop that run, or give this one another file",
    .process.map(|id| format!(" (process {id})")).unwrap_or_default(),
    .output.display()
)]
pub struct OutputLocked {
    /// The output.
    pub output: PathBuf,
    /// The process that writes it, where that is known.
    pub process: Option<u32>,
}

/// An exclusive claim on an output, against other processes and other engines of this one.
///
/// It is a lock on the hidden file `.NAME.lock` next to the output, which is removed with it. The system releases the
/// lock when the process ends, however it ends; the next run takes over a lock file that a killed one left.
#[derive(Debug)]
pub struct OutputLock {
    path: PathBuf,
    /// Holds the lock while it is open.
    _file: File,
}

impl OutputLock {
    /// Takes the lock of `output`, which need not exist. `None` where nothing can be locked: a device or a pipe, a
    /// folder that does not exist or is not writable, a file system without locks.
    ///
    /// # Errors
    /// Another run has the lock, also after `patience`.
    pub fn take(output: &Path, patience: Duration) -> Result<Option<Self>, OutputLocked> {
        let Some(name) = output.file_name().filter(|_| !is_special(output)) else { return Ok(None) };
        let mut lock_name = OsString::from(".");
        lock_name.push(name);
        lock_name.push(".lock");
        let path = output.with_file_name(lock_name);
        let until = Instant::now() + patience;
        loop {
            let opened = OpenOptions::new()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .mode(0o600)
                .custom_flags(libc::O_NOFOLLOW)
                .open(&path);
            let Ok(mut file) = opened else { return Ok(None) };
            match file.try_lock() {
                // Removed by the run that had it, between opening and locking: its successor locks another file.
                Ok(()) if !is_at(&file, &path) => {}
                Ok(()) => {
                    // Only for the message of others.
                    let _ = file.set_len(0).and_then(|()| write!(file, "{}", std::process::id()));
                    return Ok(Some(Self { path, _file: file }));
                }
                Err(TryLockError::WouldBlock) if Instant::now() < until => std::thread::sleep(LOCK_POLL),
                Err(TryLockError::WouldBlock) => {
                    let mut text = String::new();
                    let _ = file.read_to_string(&mut text);
                    return Err(OutputLocked { output: output.to_owned(), process: text.trim().parse().ok() });
                }
                Err(TryLockError::Error(_)) => return Ok(None),
            }
        }
    }
}

impl Drop for OutputLock {
    fn drop(&mut self) {
        // Before the lock is released, so that the file of a successor is never removed.
        let _ = fs::remove_file(&self.path);
    }
}

fn is_at(file: &File, path: &Path) -> bool {
    match (file.metadata(), path.symlink_metadata()) {
        (Ok(open), Ok(found)) => (open.dev(), open.ino()) == (found.dev(), found.ino()),
        _ => false,
    }
}

/// Opens a file for appending; one that is created has mode 0600. A symbolic link is replaced by a file, as in
/// [`create`].
///
/// # Errors
/// Any error of the file system.
pub fn append(path: &Path) -> io::Result<File> {
    create_folders(path)?;
    if path.is_symlink() && !is_special(path) {
        return create(path);
    }
    OpenOptions::new().create(true).append(true).mode(0o600).open(path)
}

/// Creates the missing parent folders of the file `path`, with mode 0700.
///
/// # Errors
/// Any error of the file system.
pub fn create_folders(path: &Path) -> io::Result<()> {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => DirBuilder::new().recursive(true).mode(0o700).create(folder),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("panoscope_files_{name}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        path
    }

    #[test]
    fn an_output_has_one_lock_that_leaves_nothing_behind() {
        let folder = folder("lock");
        let output = folder.join("v.mkv");
        let lock = OutputLock::take(&output, Duration::ZERO).unwrap().expect("a lock");
        let message = OutputLock::take(&output, Duration::ZERO).expect_err("it is taken").to_string();
        let process = std::process::id();
        assert!(
            message.starts_with(&format!("another run (process {process}) writes {}", output.display())),
            "{message}"
        );
        assert!(OutputLock::take(&folder.join("w.mkv"), Duration::ZERO).unwrap().is_some(), "another file is free");
        drop(lock);
        assert!(OutputLock::take(&output, Duration::ZERO).unwrap().is_some());
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        // As a killed run leaves it.
        fs::write(folder.join(".v.mkv.lock"), "1").unwrap();
        assert!(OutputLock::take(&output, Duration::ZERO).unwrap().is_some());
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_cannot_be_locked_is_no_error() {
        assert!(OutputLock::take(Path::new("/dev/null"), Duration::ZERO).unwrap().is_none());
        assert!(OutputLock::take(Path::new("/no/such/folder/v.mkv"), Duration::ZERO).unwrap().is_none());
    }

    #[test]
    fn files_are_private_and_replace_links() {
        let folder = folder("create");
        let (target, link) = (folder.join("target"), folder.join("new/link"));
        create_folders(&link).unwrap();
        assert_eq!(folder.join("new").metadata().unwrap().mode() & 0o777, 0o700);
        fs::write(&target, "kept").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        create(&link).unwrap().write_all(b"new").unwrap();
        assert_eq!(fs::read_to_string(&target).unwrap(), "kept");
        assert_eq!(fs::read_to_string(&link).unwrap(), "new");
        assert_eq!(link.symlink_metadata().unwrap().mode() & 0o777, 0o600);
        // An older file that others may read.
        create(&target).unwrap();
        assert_eq!(target.metadata().unwrap().mode() & 0o777, 0o600);
        create(Path::new("/dev/null")).unwrap().write_all(b"x").unwrap();
        let log = folder.join("log");
        std::os::unix::fs::symlink(&target, &log).unwrap();
        for line in ["one", "two"] {
            append(&log).unwrap().write_all(line.as_bytes()).unwrap();
        }
        assert_eq!(fs::read_to_string(&log).unwrap(), "onetwo");
        assert_eq!(fs::read_to_string(&target).unwrap(), "");
        fs::remove_dir_all(folder).unwrap();
    }
}
