//! Frame memory: reference-counted buffers named by (pool, offset).
//!
//! One pool per power of two. A pool reserves address space once and touches it slot by slot, so a buffer's address is
//! its pool's base plus its offset, and never changes. A buffer returns to its pool's free list with its last
//! reference.
//!
//! Pools belong to a *domain*. Domain 0 is private memory of this process. While a graph has isolated nodes, frames
//! come from a domain that their processes map read-only, and each group of isolated nodes makes its outputs in a
//! separate domain, see [`Domain`].

mod device;
mod domain;
mod homes;
mod pool;

use std::sync::OnceLock;
use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};

use panoscope_abi::{BufferId, Frame};

pub use self::device::{DeviceMemory, OpenDevice, device_table, open_device_by};
use self::domain::Shared;
pub use self::domain::{Domain, DomainError, SharedFrames};
pub(crate) use self::homes::{in_use as device_in_use, lost as lost_on_device};
pub use self::pool::PoolFile;
use self::pool::{Backing, CANARY_BYTES, Pool};

const MIN_BITS: u32 = 8;
const MAX_BITS: u32 = 30;
/// Pools of a domain, one per power of two.
const POOLS: usize = (MAX_BITS - MIN_BITS + 1) as usize;
/// Domains of the process, the private one included.
const DOMAINS: usize = 16;
/// Numbers of pools are 1 to this.
pub const MAX_POOLS: usize = POOLS * DOMAINS;
/// The domain that only this process maps.
const PRIVATE: u32 = 0;

/// The frame memory of the process.
pub struct Memory {
    pools: [OnceLock<Pool>; MAX_POOLS],
    /// The domain of frames that belong to no group.
    current: AtomicU32,
    shared: Shared,
    in_use_bytes: AtomicI64,
    limit_bytes: AtomicI64,
}

/// A buffer could not be allocated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MemoryError {
    /// The limit is reached or the pool has no slot left.
    #[error("frame memory is exhausted: {wanted_bytes} bytes requested, {in_use_bytes} in use of {limit_bytes}")]
    Exhausted {
        /// Bytes asked for.
        wanted_bytes: usize,
        /// Bytes handed out.
        in_use_bytes: i64,
        /// Maximum number of bytes that may be handed out.
        limit_bytes: i64,
    },
    /// More than any pool holds.
    #[error("a frame of {wanted_bytes} bytes is larger than the largest buffer of 1 GiB")]
    TooLarge {
        /// Bytes asked for.
        wanted_bytes: usize,
    },
}

/// Size of the buffers for frames of this many bytes, as a power of two. A buffer that is too large has none.
fn bits_for(len: usize) -> u32 {
    let bytes = len.max(1).saturating_add(CANARY_BYTES);
    (usize::BITS - (bytes - 1).leading_zeros()).max(MIN_BITS)
}

/// Maximum number of bytes of a frame that fits into the buffer for a frame of `len` bytes.
pub fn room_for(len: usize) -> usize {
    1usize.checked_shl(bits_for(len)).map_or(len, |bytes| bytes - CANARY_BYTES)
}

/// The frame memory of the process.
pub fn memory() -> &'static Memory {
    static MEMORY: Memory = Memory {
        pools: [const { OnceLock::new() }; MAX_POOLS],
        current: AtomicU32::new(PRIVATE),
        shared: Shared::new(),
        in_use_bytes: AtomicI64::new(0),
        limit_bytes: AtomicI64::new(2 << 30),
    };
    &MEMORY
}

impl Memory {
    /// Maximum number of bytes that may be handed out at a time.
    pub fn set_limit_bytes(&self, limit: i64) {
        self.limit_bytes.store(limit, Ordering::Relaxed);
    }

    /// Limit of [`Self::set_limit_bytes`].
    pub fn limit_bytes(&self) -> i64 {
        self.limit_bytes.load(Ordering::Relaxed)
    }

    /// Bytes handed out now (as sizes of the buffers, not of the frames).
    pub fn in_use_bytes(&self) -> i64 {
        self.in_use_bytes.load(Ordering::Relaxed)
    }

    fn pool(&self, number: u32) -> Option<&Pool> {
        self.pools.get((number as usize).checked_sub(1)?)?.get()
    }

    /// A buffer of at least `len` bytes with one reference; its contents are unspecified, but initialised.
    pub fn allocate(&self, len: usize) -> Result<(BufferId, *mut u8), MemoryError> {
        match self.current.load(Ordering::Relaxed) {
            PRIVATE => self.allocate_at(PRIVATE, len),
            // The domain may have been closed meanwhile.
            shared => self.allocate_at(shared, len).or_else(|_| self.allocate_at(PRIVATE, len)),
        }
    }

    #[inline]
    fn allocate_at(&self, domain: u32, len: usize) -> Result<(BufferId, *mut u8), MemoryError> {
        let bits = bits_for(len);
        if bits > MAX_BITS {
            return Err(MemoryError::TooLarge { wanted_bytes: len });
        }
        let number = (domain as usize * POOLS) as u32 + bits - MIN_BITS;
        let size = 1i64 << bits;
        let limit_bytes = self.limit_bytes.load(Ordering::Relaxed);
        let exhausted = |in_use_bytes| MemoryError::Exhausted { wanted_bytes: len, in_use_bytes, limit_bytes };
        let before = self.in_use_bytes.fetch_add(size, Ordering::Relaxed);
        let slot = if before + size > limit_bytes {
            None
        } else {
            let place = &self.pools[number as usize];
            let pool = place.get().or_else(|| self.make_pool(place, domain, bits));
            pool.and_then(|pool| Some((pool, pool.take()?)))
        };
        let Some((pool, slot)) = slot else {
            self.in_use_bytes.fetch_sub(size, Ordering::Relaxed);
            return Err(exhausted(before));
        };
        pool.put_canary(slot);
        pool.references[slot as usize].store(1, Ordering::Relaxed);
        // Only the owner of the slot writes it.
        let uses = &pool.uses[slot as usize];
        uses.store(uses.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        let offset = (slot as u64) << bits;
        let id = BufferId { pool: number + 1, home: 0, offset };
        // SAFETY: the slot lies inside the reserved mapping.
        Ok((id, unsafe { pool.base.add(offset as usize) }))
    }

    #[cold]
    fn make_pool<'m>(&self, place: &'m OnceLock<Pool>, domain: u32, bits: u32) -> Option<&'m Pool> {
        // One thread at a time. A pool that the system refuses is tried again with the next frame.
        self.shared.with_backing(domain, |backing| match place.get() {
            Some(pool) => Some(pool),
            None => {
                let pool = Pool::reserve(bits, backing)?;
                Some(place.get_or_init(|| pool))
            }
        })?
    }

    /// Whether nothing was written beyond the end of a buffer that the caller holds.
    pub(crate) fn is_intact(&self, id: BufferId) -> bool {
        self.slot(id).is_none_or(|(pool, slot)| pool.is_intact(slot as u32))
    }

    /// Address of a buffer, null when there is no such buffer.
    pub fn resolve(&self, id: BufferId) -> *mut u8 {
        match self.slot(id) {
            // SAFETY: the slot lies inside the reserved mapping.
            Some((pool, _)) => unsafe { pool.base.add(id.offset as usize) },
            None => std::ptr::null_mut(),
        }
    }

    fn slot(&self, id: BufferId) -> Option<(&Pool, usize)> {
        let pool = self.pool(id.pool)?;
        let slot = (id.offset >> pool.bits) as usize;
        (slot < pool.references.len() && (slot as u64) << pool.bits == id.offset).then_some((pool, slot))
    }

    /// References to a buffer.
    pub fn references(&self, id: BufferId) -> u32 {
        self.slot(id).map_or(0, |(pool, slot)| pool.references[slot].load(Ordering::Acquire))
    }

    /// Number of uses of a buffer, wrapping: while the number stays, so do the bytes of a frame in it. 0 for no buffer.
    pub fn uses(&self, id: BufferId) -> u32 {
        self.slot(id).map_or(0, |(pool, slot)| pool.uses[slot].load(Ordering::Relaxed))
    }

    /// Adds a reference to a buffer of which the caller holds one.
    pub(crate) fn retain(&self, id: BufferId) {
        if let Some((pool, slot)) = self.slot(id) {
            pool.references[slot].fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Adds a reference to a buffer that is in use; `false` if it is not, or does not exist.
    pub(crate) fn retain_held(&self, id: BufferId) -> bool {
        let Some((pool, slot)) = self.slot(id) else { return false };
        let references = &pool.references[slot];
        let mut count = references.load(Ordering::Relaxed);
        while count != 0 {
            match references.compare_exchange_weak(count, count + 1, Ordering::Relaxed, Ordering::Relaxed) {
                Ok(_) => return true,
                Err(now) => count = now,
            }
        }
        false
    }

    /// Adds a reference to the buffer of a frame that came from a plugin; `false` if no such buffer is in use, or its
    /// address or length do not match.
    pub(crate) fn retain_checked(&self, frame: &Frame) -> bool {
        let Some((pool, _)) = self.slot(frame.buffer) else { return false };
        // SAFETY: the slot lies inside the reserved mapping.
        let address = unsafe { pool.base.add(frame.buffer.offset as usize) };
        frame.data == address && frame.len <= pool.room() && self.retain_held(frame.buffer)
    }

    /// Removes a reference; the last one frees the buffer.
    pub(crate) fn release(&self, id: BufferId) {
        let Some((pool, slot)) = self.slot(id) else { return };
        let before = pool.references[slot].load(Ordering::Relaxed);
        if before == 0 {
            return; // The buffer is free already.
        }
        if pool.references[slot].fetch_sub(1, Ordering::Release) == 1 {
            // Orders the reads of all former owners before the next use. A load and not a fence, which ThreadSanitizer does not know.
            pool.references[slot].load(Ordering::Acquire);
            self.in_use_bytes.fetch_sub(1 << pool.bits, Ordering::Relaxed);
            if pool.has_device_copy[slot].load(Ordering::Relaxed) != 0 {
                pool.has_device_copy[slot].store(0, Ordering::Relaxed);
                self.drop_device_copy(id);
            }
            pool.put_back(slot as u32);
        }
    }
}

/// One reference to a frame's buffer, or none for an empty port. Same layout as the contract's [`Frame`].
#[derive(Debug)]
#[repr(transparent)]
pub struct FrameRef(Frame);

impl FrameRef {
    /// An empty port at a tick.
    pub fn empty(tick: panoscope_abi::Tick) -> Self {
        Self(Frame { tick, ..Frame::EMPTY })
    }

    /// Takes over one reference that the caller holds.
    ///
    /// # Safety
    /// The frame is empty, or `frame.buffer` is a buffer of [`memory`] of which the caller gives up one reference,
    /// `frame.data` is its address and `frame.len` lies within it.
    pub unsafe fn adopt(frame: Frame) -> Self {
        Self(frame)
    }

    /// Becomes empty without releasing its reference, which another owner took over.
    #[inline]
    pub(crate) fn forget(&mut self) {
        self.0 = Frame::EMPTY;
    }

    /// Views a frame in a list as the reference that it holds.
    ///
    /// # Safety
    /// As for [`Self::adopt`], but the reference stays with the list: taking it leaves an empty frame behind.
    pub(crate) unsafe fn adopt_in_place(frame: &mut Frame) -> &mut Self {
        // SAFETY: `Self` is a transparent `Frame`.
        unsafe { &mut *(&raw mut *frame).cast() }
    }

    /// Hands the reference to the caller.
    pub fn into_raw(self) -> Frame {
        let frame = self.0;
        std::mem::forget(self);
        frame
    }

    /// The description.
    pub fn frame(&self) -> &Frame {
        &self.0
    }

    /// The tick.
    pub fn tick(&self) -> panoscope_abi::Tick {
        self.0.tick
    }

    /// Whether the port is empty.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The bytes, fetched from the GPU if they are there alone; empty for an empty port.
    pub fn bytes(&self) -> &[u8] {
        if self.0.is_empty() || self.0.len == 0 {
            return &[];
        }
        memory().fetch(&self.0);
        // SAFETY: this reference keeps the buffer alive; nodes write only buffers that nobody shares.
        unsafe { std::slice::from_raw_parts(self.0.data, self.0.len) }
    }
}

impl Clone for FrameRef {
    fn clone(&self) -> Self {
        if !self.0.is_empty() {
            memory().retain(self.0.buffer);
        }
        Self(self.0)
    }
}

impl Drop for FrameRef {
    fn drop(&mut self) {
        if !self.0.is_empty() {
            memory().release(self.0.buffer);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_come_back_and_are_reused() {
        let memory = memory();
        let (id, address) = memory.allocate(1000).expect("memory");
        assert_eq!(memory.resolve(id), address);
        assert_eq!(address as usize % 64, 0);
        memory.retain(id);
        memory.release(id);
        assert_eq!(memory.references(id), 1);
        memory.release(id);
        assert_eq!(memory.references(id), 0);
        memory.release(id);
        assert_eq!(memory.references(id), 0, "one release too many is harmless");
    }

    #[test]
    fn hostile_ids_name_nothing() {
        let memory = memory();
        for id in [
            BufferId { pool: 0, home: 0, offset: 0 },
            BufferId { pool: 999, home: 0, offset: 0 },
            BufferId { pool: 3, home: 0, offset: 77 },
            BufferId { pool: 3, home: 0, offset: u64::MAX },
        ] {
            assert!(memory.resolve(id).is_null());
            memory.retain(id);
            memory.release(id);
        }
    }

    #[test]
    fn too_much_is_refused() {
        assert!(matches!(memory().allocate(2 << 30), Err(MemoryError::TooLarge { .. })));
        assert!(matches!(memory().allocate(usize::MAX), Err(MemoryError::TooLarge { .. })));
    }

    #[test]
    fn a_write_beyond_a_buffer_is_noticed() {
        let memory = memory();
        for len in [1, 240, 241, 256, 1 << 16, 3_000_000] {
            let (id, data) = memory.allocate(len).expect("memory");
            let room = room_for(len);
            assert!(room >= len && room_for(room) == room, "{len}");
            // SAFETY: a new buffer has as much room.
            unsafe { data.write_bytes(7, room) };
            assert!(memory.is_intact(id), "{len}: all of it belongs to the frame");
            // SAFETY: inside the mapping; a byte that belongs to no frame.
            unsafe { data.add(room).write(7) };
            assert!(!memory.is_intact(id), "{len}");
            memory.release(id);
            assert_eq!(memory.allocate(len).map(|(again, _)| memory.is_intact(again)), Ok(true), "{len}");
        }
    }

    /// The system may refuse the address space of a pool once; that is no reason to refuse it for ever.
    #[test]
    #[cfg(target_os = "linux")]
    fn a_pool_that_the_system_refused_is_tried_again() {
        const LEN: usize = 700 << 20;
        let mut before = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
        // SAFETY: fills the struct.
        assert_eq!(unsafe { libc::getrlimit(libc::RLIMIT_AS, &raw mut before) }, 0);
        let little = libc::rlimit { rlim_cur: 1 << 20, ..before };
        // SAFETY: plain system calls.
        unsafe { libc::setrlimit(libc::RLIMIT_AS, &raw const little) };
        let refused = memory().allocate(LEN);
        // SAFETY: as above.
        unsafe { libc::setrlimit(libc::RLIMIT_AS, &raw const before) };
        assert!(matches!(refused, Err(MemoryError::Exhausted { .. })), "{refused:?}");
        let (id, _) = memory().allocate(LEN).expect("memory");
        memory().release(id);
    }
}
