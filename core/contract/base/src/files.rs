//! Creates and replaces output files.

use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Whether `path` leads to a device, a pipe or a socket, which are written to and never replaced.
pub fn is_special(path: &Path) -> bool {
    path.metadata().is_ok_and(|found| {
        let kind = found.file_type();
        kind.is_char_device() || kind.is_block_device() || kind.is_fifo() || kind.is_socket()
    })
}

/// Creates a file with mode 0600 in place of a file or a symbolic link of that name; the target of a link stays as it
/// is. Devices and pipes are opened.
///
/// # Errors
/// Any error of the file system.
pub fn create(path: &Path) -> io::Result<File> {
    if is_special(path) {
        return OpenOptions::new().write(true).open(path);
    }
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => OpenOptions::new().write(true).create_new(true).mode(0o600).open(path),
    }
}

/// Writes a file atomically: at any moment the complete old or the complete new file exists, also when several threads or
/// processes write it at once.
///
/// # Errors
/// The file cannot be written; it is unchanged.
pub fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    replace_with(path, None, |file| file.write_all(bytes))
}

/// As [`replace`], with the permissions of the new file and a function that writes its content.
///
/// # Errors
/// The file cannot be written, or `write` fails; the file is unchanged.
pub fn replace_with(
    path: &Path,
    mode: Option<Permissions>,
    write: impl FnOnce(&mut File) -> io::Result<()>,
) -> io::Result<()> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let mut part = path.as_os_str().to_owned();
    part.push(format!(".{}-{}.part", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed)));
    let part = PathBuf::from(part);
    let written = (|| {
        let mut file = File::create(&part)?;
        if let Some(mode) = mode {
            file.set_permissions(mode)?;
        }
        write(&mut file)?;
        file.sync_all()?;
        fs::rename(&part, path)
    })();
    if written.is_err() {
        let _ = fs::remove_file(&part);
        return written;
    }
    // Makes the rename survive a power failure. File systems that cannot sync a folder ensure this themselves.
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let _ = File::open(folder).and_then(|f| f.sync_all());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_several_threads_replace_is_always_complete() {
        let folder = std::env::temp_dir().join(format!("panoscope-replace-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("report.json");
        let text = |thread: u8| vec![b'a' + thread; 20_000];
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let path = &path;
                scope.spawn(move || {
                    for _ in 0..50 {
                        replace(path, &text(thread)).expect("replaced");
                        let now = fs::read(path).expect("there is always a file");
                        assert!((0..4).any(|other| now == text(other)), "{} bytes of several texts", now.len());
                    }
                });
            }
        });
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "no part is left");
        let refused = replace_with(&path, None, |_| Err(io::Error::other("no")));
        assert!(refused.is_err() && fs::read_dir(&folder).unwrap().count() == 1, "{refused:?}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
