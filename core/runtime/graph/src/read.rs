//! Reads the files of a graph, up to a limit.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Maximum number of bytes of one file of a graph.
pub(crate) const MAX_BYTES: u64 = 16 << 20;

/// Reads a file that a graph names or is. A device or a pipe is refused, because reading it may never end.
///
/// # Errors
/// The system's error; [`io::ErrorKind::IsADirectory`] for a folder, [`io::ErrorKind::InvalidInput`] for what is not a
/// regular file and [`io::ErrorKind::FileTooLarge`] for more than [`MAX_BYTES`].
pub(crate) fn read_file(path: &Path) -> io::Result<Vec<u8>> {
    let about = std::fs::metadata(path)?;
    if about.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    if !about.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is a device or a pipe, not a regular file"));
    }
    let too_large = || io::Error::new(io::ErrorKind::FileTooLarge, format!("it has more than {MAX_BYTES} bytes"));
    if about.len() > MAX_BYTES {
        return Err(too_large());
    }
    let mut bytes = Vec::with_capacity(about.len() as usize);
    // The file may grow while it is read.
    File::open(path)?.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_BYTES { Err(too_large()) } else { Ok(bytes) }
}
