//! One pool: slots of one size in one stretch of address space.

// Plain memory, also where tests replace the atomics of `std`.
use core::sync::atomic::{AtomicU64, Ordering};
use std::fs::File;
use std::os::fd::{AsRawFd, FromRawFd};
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, Mutex, Weak};

use crate::sync::lock;

/// Bytes at the end of each slot that belong to no frame: a node that writes beyond its output into the next slot
/// changes them.
pub(super) const CANARY_BYTES: usize = 16;
const CANARY: [u64; CANARY_BYTES / 8] = [0x5bd1_e995_c6a4_a793, 0x9e37_79b9_7f4a_7c15];

const MAX_SLOTS: usize = 1 << 16;
const RESERVE_BYTES: usize = 4 << 30;

/// Kind of memory behind a pool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Backing {
    /// Anonymous memory of this process.
    Private,
    /// A file in memory that other processes can map, but not write.
    ReadElsewhere,
    /// A file in memory that another process writes.
    WrittenElsewhere,
}

/// The file behind a pool, for another process to map.
#[derive(Clone, Debug)]
pub struct PoolFile {
    /// The file in memory. Its size is sealed.
    pub file: Arc<File>,
    /// Its size in bytes.
    pub len: usize,
}

pub(super) struct Pool {
    pub base: *mut u8,
    pub bits: u32,
    pub references: Box<[AtomicU32]>,
    /// Number of uses of each slot, wrapping.
    pub uses: Box<[AtomicU32]>,
    /// Whether each slot has a copy on the GPU, 0 or 1.
    pub has_device_copy: Box<[AtomicU32]>,
    free: Mutex<Free>,
}

struct Free {
    slots: Vec<u32>,
    untouched: u32,
    /// Whether slots are handed out.
    open: bool,
    /// The file that is mapped; `None` for private memory, and for a closed pool whose slots were all returned.
    file: Option<Arc<File>>,
    /// The newest file, which other processes may still map after this one unmapped it.
    last: Weak<File>,
}

impl Free {
    fn all_back(&self) -> bool {
        self.slots.len() == self.untouched as usize
    }
}

// SAFETY: `base` is a stretch of address space that is never given back; `free` and `references` hand out each slot to one owner at a time.
unsafe impl Send for Pool {}
// SAFETY: `base` never moves and `free` and `references` are only touched under their own synchronisation.
unsafe impl Sync for Pool {}

impl Pool {
    /// Reserves the address space of a pool; nothing is touched until a slot is used.
    pub fn reserve(bits: u32, backing: Backing) -> Option<Pool> {
        let slots = (RESERVE_BYTES >> bits).clamp(2, MAX_SLOTS);
        let len = slots << bits;
        let protection = if backing == Backing::Private { libc::PROT_READ | libc::PROT_WRITE } else { libc::PROT_NONE };
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_NORESERVE;
        // SAFETY: a fresh anonymous mapping at an address that the system chooses.
        let base = unsafe { libc::mmap(std::ptr::null_mut(), len, protection, flags, -1, 0) };
        if base == libc::MAP_FAILED {
            return None;
        }
        let zeros = || (0..slots).map(|_| AtomicU32::new(0)).collect();
        let (references, uses, has_device_copy) = (zeros(), zeros(), zeros());
        let slots = Vec::with_capacity(slots.min(1024));
        let free = Free { slots, untouched: 0, open: backing == Backing::Private, file: None, last: Weak::new() };
        let pool = Pool { base: base.cast(), bits, references, uses, has_device_copy, free: Mutex::new(free) };
        if backing != Backing::Private && !pool.open(backing) {
            // SAFETY: the mapping from above, of which nobody has an address.
            unsafe { libc::munmap(base, len) };
            return None;
        }
        Some(pool)
    }

    /// Maximum number of bytes of a frame.
    pub fn room(&self) -> usize {
        (1 << self.bits) - CANARY_BYTES
    }

    fn canary(&self, slot: u32) -> &[AtomicU64; CANARY_BYTES / 8] {
        // SAFETY: aligned memory inside the slot, which is mapped while it is handed out; a node that writes there by mistake is what this is for.
        unsafe { &*self.base.add(((slot as usize) << self.bits) + self.room()).cast() }
    }

    /// Whether nothing was written beyond the end of a slot since [`Self::put_canary`].
    pub fn is_intact(&self, slot: u32) -> bool {
        self.canary(slot).iter().zip(CANARY).all(|(word, value)| word.load(Ordering::Relaxed) == value)
    }

    /// Marks the end of a slot that is handed out.
    pub fn put_canary(&self, slot: u32) {
        self.canary(slot).iter().zip(CANARY).for_each(|(word, value)| word.store(value, Ordering::Relaxed));
    }

    fn len(&self) -> usize {
        self.references.len() << self.bits
    }

    /// Takes a free slot; `None` if the pool is exhausted or closed.
    pub fn take(&self) -> Option<u32> {
        let mut free = lock(&self.free);
        if !free.open {
            return None;
        }
        if let Some(slot) = free.slots.pop() {
            return Some(slot);
        }
        if (free.untouched as usize) < self.references.len() {
            free.untouched += 1;
            return Some(free.untouched - 1);
        }
        None
    }

    /// Puts a slot back that [`Self::take`] returned.
    pub fn put_back(&self, slot: u32) {
        let mut free = lock(&self.free);
        free.slots.push(slot);
        if !free.open {
            self.unmap_if_unused(&mut free);
        }
    }

    /// The file behind the pool, for another process; `None` for private memory.
    pub fn file(&self) -> Option<PoolFile> {
        let file = lock(&self.free).file.clone()?;
        Some(PoolFile { file, len: self.len() })
    }

    /// Maps a new file in memory and hands out slots; `false` if the system refuses.
    pub fn open(&self, backing: Backing) -> bool {
        let mut free = lock(&self.free);
        let Ok(file) = memory_file(self.len()) else { return false };
        let flags = libc::MAP_SHARED | libc::MAP_NORESERVE | libc::MAP_FIXED;
        let protection = libc::PROT_READ | libc::PROT_WRITE;
        // SAFETY: the stretch from `base` belongs to this pool and none of its slots is in use: the pool is new, or closed and unmapped.
        let mapped = unsafe { libc::mmap(self.base.cast(), self.len(), protection, flags, file.as_raw_fd(), 0) }
            != libc::MAP_FAILED;
        // The mapping above stays writable under the seal.
        if !mapped || (backing == Backing::ReadElsewhere && seal(&file, libc::F_SEAL_FUTURE_WRITE).is_err()) {
            return false;
        }
        let file = Arc::new(file);
        (free.last, free.file, free.open) = (Arc::downgrade(&file), Some(file), true);
        free.slots.clear();
        free.untouched = 0;
        true
    }

    /// Stops handing out slots. The memory is released once all slots are returned.
    pub fn close(&self) {
        let mut free = lock(&self.free);
        free.open = false;
        self.unmap_if_unused(&mut free);
    }

    /// Whether the pool is closed, its memory was released, and no one holds its file for another process.
    pub fn is_unmapped(&self) -> bool {
        let free = lock(&self.free);
        !free.open && free.file.is_none() && free.last.strong_count() == 0
    }

    #[cold]
    fn unmap_if_unused(&self, free: &mut Free) {
        if !free.all_back() || free.file.is_none() {
            return;
        }
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_NORESERVE | libc::MAP_FIXED;
        // SAFETY: replaces the pool's own mapping, of which no slot is in use, by nothing; the address space stays reserved.
        unsafe { libc::mmap(self.base.cast(), self.len(), libc::PROT_NONE, flags, -1, 0) };
        free.file = None;
        free.slots.clear();
        free.untouched = 0;
    }
}

/// A file in memory of a fixed size: nobody can shorten it under the readers of a mapping.
fn memory_file(len: usize) -> std::io::Result<File> {
    // SAFETY: the name is a zero-terminated text.
    let fd = unsafe { libc::memfd_create(c"panoscope-frames".as_ptr(), libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING) };
    if fd < 0 {
        return Err(std::io::Error::last_os_error());
    }
    // SAFETY: `memfd_create` returned this file descriptor, and nothing else owns it.
    let file = unsafe { File::from_raw_fd(fd) };
    file.set_len(len as u64)?;
    seal(&file, libc::F_SEAL_SHRINK | libc::F_SEAL_GROW)?;
    Ok(file)
}

fn seal(file: &File, seals: libc::c_int) -> std::io::Result<()> {
    // SAFETY: a plain system call on a file that is open.
    match unsafe { libc::fcntl(file.as_raw_fd(), libc::F_ADD_SEALS, seals) } {
        0 => Ok(()),
        _ => Err(std::io::Error::last_os_error()),
    }
}
