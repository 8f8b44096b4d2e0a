//! Creates output files.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

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
