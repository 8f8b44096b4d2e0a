//! Domains: sets of pools that other processes map.

use std::sync::Mutex;
use std::sync::atomic::Ordering;

use panoscope_abi::BufferId;

use super::{Backing, DOMAINS, Memory, MemoryError, PRIVATE, Pool, PoolFile, memory};
use crate::sync::lock;

/// No domain is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{most} groups of isolated nodes have frames in use, which is the limit")]
pub struct DomainError {
    /// Maximum number of groups that may exist at a time.
    pub most: usize,
}

/// Domains in use.
pub(super) struct Shared {
    state: Mutex<State>,
}

struct State {
    /// Rights of other processes on the pools of each domain in use.
    backing: [Option<Backing>; DOMAINS],
    /// The domain that holds this process's own frames, and the number of users of [`SharedFrames`].
    own: Option<(Domain, usize)>,
}

impl Shared {
    pub const fn new() -> Self {
        Self { state: Mutex::new(State { backing: [const { None }; DOMAINS], own: None }) }
    }

    /// Calls `work` with what other processes may do with the pools of a domain, which stays open meanwhile; `None` if
    /// it is closed.
    pub fn with_backing<R>(&self, domain: u32, work: impl FnOnce(Backing) -> R) -> Option<R> {
        let state = lock(&self.state);
        let backing = if domain == PRIVATE { Some(Backing::Private) } else { state.backing[domain as usize] };
        backing.map(work)
    }
}

/// Pools whose frames another process can map. Dropping it releases the memory, each pool once no frame of it is held.
#[derive(Debug)]
pub struct Domain(u32);

impl Domain {
    /// Pools that a group's process writes.
    ///
    /// # Errors
    /// All domains have frames in use.
    pub fn written_elsewhere() -> Result<Self, DomainError> {
        Self::open(&mut lock(&memory().shared.state), Backing::WrittenElsewhere)
    }

    fn open(state: &mut State, backing: Backing) -> Result<Self, DomainError> {
        let memory = memory();
        let unused = |domain: &u32| {
            state.backing[*domain as usize].is_none() && memory.pools_of(*domain).all(|(_, pool)| pool.is_unmapped())
        };
        let number = (PRIVATE + 1..DOMAINS as u32).find(unused).ok_or(DomainError { most: DOMAINS - 2 })?;
        // Pools that an earlier domain of this number used; the others are made when they are first used.
        memory.pools_of(number).for_each(|(_, pool)| _ = pool.open(backing));
        state.backing[number as usize] = Some(backing);
        Ok(Self(number))
    }

    /// Number of the domain, for [`Memory::allocate_in`].
    pub fn number(&self) -> u32 {
        self.0
    }

    fn close(&self, state: &mut State) {
        state.backing[self.0 as usize] = None;
        memory().pools_of(self.0).for_each(|(_, pool)| pool.close());
    }
}

impl Drop for Domain {
    fn drop(&mut self) {
        self.close(&mut lock(&memory().shared.state));
    }
}

/// While one of these exists, frames of this process are made where other processes can map them.
#[derive(Debug)]
pub struct SharedFrames(());

impl SharedFrames {
    /// Begins.
    ///
    /// # Errors
    /// All domains have frames in use.
    pub fn begin() -> Result<Self, DomainError> {
        let memory = memory();
        let mut state = lock(&memory.shared.state);
        match &mut state.own {
            Some((_, users)) => *users += 1,
            None => {
                let domain = Domain::open(&mut state, Backing::ReadElsewhere)?;
                memory.current.store(domain.0, Ordering::Relaxed);
                state.own = Some((domain, 1));
            }
        }
        Ok(Self(()))
    }
}

impl Drop for SharedFrames {
    fn drop(&mut self) {
        let memory = memory();
        let mut state = lock(&memory.shared.state);
        let Some((_, users)) = &mut state.own else { return };
        *users -= 1;
        if *users == 0
            && let Some((domain, _)) = state.own.take()
        {
            // A thread that read the number before finds the pools closed and uses private memory.
            memory.current.store(PRIVATE, Ordering::Relaxed);
            domain.close(&mut state);
            std::mem::forget(domain);
        }
    }
}

impl Memory {
    /// The pools of a domain that were ever used, with their numbers.
    fn pools_of(&self, domain: u32) -> impl Iterator<Item = (u32, &Pool)> {
        let first = domain as usize * super::POOLS;
        let pools = self.pools[first..first + super::POOLS].iter().enumerate();
        pools.filter_map(move |(index, pool)| Some(((first + index) as u32 + 1, pool.get()?)))
    }

    /// A buffer like [`Self::allocate`], in the pools of a [`Domain`].
    ///
    /// # Errors
    /// As [`Self::allocate`].
    pub fn allocate_in(&self, domain: u32, len: usize) -> Result<(BufferId, *mut u8), MemoryError> {
        self.allocate_at(domain, len)
    }

    /// The domain of a buffer; 0 is the private one.
    #[inline]
    pub fn domain_of(id: BufferId) -> u32 {
        (id.pool.saturating_sub(1)) / super::POOLS as u32
    }

    /// The file behind a pool, for another process to map; `None` for private memory and for pools that do not exist.
    pub fn pool_file(&self, pool: u32) -> Option<PoolFile> {
        self.pool(pool)?.file()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::memory::FrameRef;
    use panoscope_abi::Frame;

    /// The domains are those of the process: one test at a time.
    static ALONE: Mutex<()> = Mutex::new(());

    fn frame(domain: u32, len: usize) -> FrameRef {
        let (buffer, data) = memory().allocate_in(domain, len).expect("memory");
        // SAFETY: the one reference of a new buffer.
        unsafe { FrameRef::adopt(Frame { buffer, data, len, ..Frame::EMPTY }) }
    }

    #[test]
    fn memory_of_a_domain_comes_back_with_its_last_frame() {
        let _alone = lock(&ALONE);
        let domain = Domain::written_elsewhere().expect("a domain");
        let held = frame(domain.number(), 5000);
        let pool = held.frame().buffer.pool;
        assert_eq!(Memory::domain_of(held.frame().buffer), domain.number());
        // SAFETY: a buffer of 5000 bytes that only this test has.
        unsafe { held.frame().data.write_bytes(7, 5000) };
        let number = domain.number();
        drop(domain);
        assert_eq!(held.bytes()[4999], 7, "a frame outlives its domain");
        assert!(memory().allocate_in(number, 5000).is_err(), "a closed pool hands out nothing");
        let other = Domain::written_elsewhere().expect("a domain");
        assert_ne!(other.number(), number, "a number with frames in use is not used again");
        drop(held);
        assert!(memory().pool_file(pool).is_none(), "the last frame gives the memory back");
        let again = Domain::written_elsewhere().expect("a domain");
        assert_eq!(again.number(), number);
        let fresh = frame(number, 5000);
        assert_eq!(fresh.bytes()[4999], 0, "new memory");
    }

    #[test]
    fn frames_are_shared_only_while_somebody_wants_it() {
        let _alone = lock(&ALONE);
        let domain = |frame: &FrameRef| Memory::domain_of(frame.frame().buffer);
        let make = || {
            let (buffer, data) = memory().allocate(100).expect("memory");
            // SAFETY: the one reference of a new buffer.
            unsafe { FrameRef::adopt(Frame { buffer, data, len: 100, ..Frame::EMPTY }) }
        };
        assert_eq!(domain(&make()), PRIVATE);
        let first = SharedFrames::begin().expect("a domain");
        let second = SharedFrames::begin().expect("a domain");
        drop(first);
        let held = make();
        assert_ne!(domain(&held), PRIVATE);
        let file = memory().pool_file(held.frame().buffer.pool).expect("a file");
        let writable = libc::PROT_READ | libc::PROT_WRITE;
        use std::os::fd::AsRawFd;
        // SAFETY: a mapping at an address that the system chooses; it is expected to fail.
        let mapped =
            unsafe { libc::mmap(std::ptr::null_mut(), file.len, writable, libc::MAP_SHARED, file.file.as_raw_fd(), 0) };
        assert_eq!(mapped, libc::MAP_FAILED, "nobody else may write");
        assert!(file.file.set_len(0).is_err(), "nobody can shorten it");
        drop(second);
        assert_eq!(domain(&make()), PRIVATE);
        assert!(held.bytes().len() == 100, "a frame stays as long as it is held");
    }
}
