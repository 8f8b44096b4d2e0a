//! Shared memory for pixels: slots that the process that runs the graph writes and the window reads.
//!
//! The window makes the memory and seals its size, so that the other process cannot take it away. The window copies what it shows: a process
//! that writes wildly can spoil one picture, nothing else.

use std::fs::File;
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};

/// Number of slots.
pub(crate) const SLOTS: u32 = 12;
/// Size of a slot. Memory that is never written costs nothing.
const SLOT_BYTES: usize = 128 << 20;
const REGION_BYTES: usize = SLOT_BYTES * SLOTS as usize;

/// The mapped memory.
pub(crate) struct Region {
    base: *mut u8,
    file: File,
}

// SAFETY: the mapping is plain memory that stays until the region is dropped.
unsafe impl Send for Region {}
// SAFETY: all access copies bytes through raw pointers; a slot is written by one process at a time, by the protocol, and any bytes are valid.
unsafe impl Sync for Region {}

impl Region {
    /// New memory.
    ///
    /// # Errors
    /// The system has none.
    pub fn create() -> io::Result<Self> {
        let flags = libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING;
        // SAFETY: the name is a zero-terminated text.
        let fd = unsafe { libc::memfd_create(c"panoscope-pictures".as_ptr(), flags) };
        if fd < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: `memfd_create` returned this file descriptor, and nothing else owns it.
        let file = unsafe { File::from_raw_fd(fd) };
        file.set_len(REGION_BYTES as u64)?;
        let seals = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW | libc::F_SEAL_SEAL;
        // SAFETY: a plain system call on a file that is open.
        if unsafe { libc::fcntl(fd, libc::F_ADD_SEALS, seals) } != 0 {
            return Err(io::Error::last_os_error());
        }
        Self::map(file, libc::PROT_READ)
    }

    /// The memory of the window that started this process, to be written.
    ///
    /// # Errors
    /// The file descriptor is not that of a region.
    pub fn inherited(fd: RawFd) -> io::Result<Self> {
        // SAFETY: a plain question; a number that is no open file is an error.
        if fd < 3 || unsafe { libc::fcntl(fd, libc::F_SETFD, libc::FD_CLOEXEC) } != 0 {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "no shared memory was handed over"));
        }
        // SAFETY: it is open, and the window left it to this process alone.
        let file = File::from(unsafe { OwnedFd::from_raw_fd(fd) });
        if file.metadata()?.len() != REGION_BYTES as u64 {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "the shared memory has another size"));
        }
        Self::map(file, libc::PROT_READ | libc::PROT_WRITE)
    }

    fn map(file: File, protection: libc::c_int) -> io::Result<Self> {
        // SAFETY: a fresh mapping at an address that the system chooses, of a file with this size, which is sealed.
        let base = unsafe {
            libc::mmap(std::ptr::null_mut(), REGION_BYTES, protection, libc::MAP_SHARED, file.as_raw_fd(), 0)
        };
        if base == libc::MAP_FAILED { Err(io::Error::last_os_error()) } else { Ok(Self { base: base.cast(), file }) }
    }

    /// File descriptor, for the process that writes.
    pub fn fd(&self) -> RawFd {
        self.file.as_raw_fd()
    }

    /// Whether so many bytes fit a slot.
    pub fn fits(bytes: usize) -> bool {
        bytes <= SLOT_BYTES
    }

    /// Writes bytes into a slot. The region was made by [`Self::inherited`]; `false` when there is no such slot or they do not fit.
    pub fn write(&self, slot: u32, bytes: &[u8]) -> bool {
        if slot >= SLOTS || !Self::fits(bytes.len()) {
            return false;
        }
        // SAFETY: the slot lies inside the mapping, which is writable, and nobody else writes a slot that this process has not sent.
        unsafe {
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), self.base.add(slot as usize * SLOT_BYTES), bytes.len())
        };
        true
    }

    /// Copies `len` bytes of a slot; `None` when there are not so many.
    pub fn read(&self, slot: u32, len: usize) -> Option<Vec<u8>> {
        if slot >= SLOTS || !Self::fits(len) {
            return None;
        }
        let mut bytes = Vec::with_capacity(len);
        // SAFETY: `len` bytes lie inside the mapping, and there is room for them. The other process may write them at the same time if it breaks
        // the protocol: any bytes are valid, and only the copy is used.
        unsafe {
            std::ptr::copy_nonoverlapping(self.base.add(slot as usize * SLOT_BYTES), bytes.as_mut_ptr(), len);
            bytes.set_len(len);
        }
        Some(bytes)
    }
}

impl Drop for Region {
    fn drop(&mut self) {
        // SAFETY: the mapping was made by `map` and nobody uses it any more.
        unsafe { libc::munmap(self.base.cast(), REGION_BYTES) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::fd::IntoRawFd;

    #[test]
    fn bytes_of_one_mapping_are_seen_in_the_other() {
        let window = Region::create().expect("memory");
        let copy = window.file.try_clone().expect("a file");
        assert!(copy.set_len(1).is_err(), "nobody can shorten it");
        let worker = Region::inherited(copy.into_raw_fd()).expect("mapped");
        assert!(worker.write(3, b"pixels"));
        assert_eq!(window.read(3, 6).as_deref(), Some(b"pixels".as_slice()));
        assert_eq!(window.read(SLOTS, 1), None);
        assert_eq!(window.read(0, SLOT_BYTES + 1), None);
        assert!(!worker.write(SLOTS, b"x"));
    }
}
