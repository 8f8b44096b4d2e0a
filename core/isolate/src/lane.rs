//! A stretch of memory on which host and child take turns.
//!
//! One word says whose turn it is. The other side spins for a few microseconds, then sleeps on the word as a futex. A side that sleeps marks
//! the word, so that passing the turn to one that spins needs no system call.

use std::fs::File;
use std::os::fd::{AsRawFd, FromRawFd};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::wire::{BadMessage, Kind};

/// The host may write.
const HOST: u32 = 1;
/// The child may write.
const CHILD: u32 = 2;
/// The child is gone.
const GONE: u32 = 3;
/// The other side sleeps until the word changes.
const SLEEPS: u32 = 1 << 31;

/// Size of a lane. Only what a message needs is ever touched.
pub(crate) const LANE_BYTES: usize = 1 << 20;
/// Where the message begins.
const HEAD_BYTES: usize = 64;
/// Longest message.
pub(crate) const MOST_BYTES: usize = LANE_BYTES - HEAD_BYTES;

/// How long a side spins for its turn before it sleeps.
const SPIN: Duration = Duration::from_micros(20);

#[repr(C)]
struct Head {
    turn: AtomicU32,
    kind: AtomicU32,
    len: AtomicU32,
    /// Signal that a thread of the lane received, set by the child's handler; 0 for none.
    signal: AtomicU32,
}

const _: () = assert!(size_of::<Head>() <= HEAD_BYTES);

/// A side of a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    Host,
    Child,
}

/// A mapped lane.
pub(crate) struct Lane {
    base: *mut u8,
}

// SAFETY: the head is atomics; the message is written by the side whose turn it is.
unsafe impl Send for Lane {}
// SAFETY: the head is atomics; the message is written by the side whose turn it is.
unsafe impl Sync for Lane {}

/// The other side is gone, or its message makes no sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lost {
    Gone,
    Bad,
}

impl From<BadMessage> for Lost {
    fn from(_: BadMessage) -> Self {
        Self::Bad
    }
}

impl Lane {
    /// A new lane, the host's turn, with the file for the child to map.
    pub fn create() -> std::io::Result<(Self, File)> {
        // SAFETY: the name is a zero-terminated text.
        let fd = unsafe { libc::memfd_create(c"panoscope-lane".as_ptr(), libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING) };
        if fd < 0 {
            return Err(std::io::Error::last_os_error());
        }
        // SAFETY: `memfd_create` returned this file descriptor, and nothing else owns it.
        let file = unsafe { File::from_raw_fd(fd) };
        file.set_len(LANE_BYTES as u64)?;
        // The child cannot shorten it under the host.
        let seals = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW | libc::F_SEAL_SEAL;
        // SAFETY: a plain system call on a file that is open.
        if unsafe { libc::fcntl(fd, libc::F_ADD_SEALS, seals) } != 0 {
            return Err(std::io::Error::last_os_error());
        }
        let lane = Self::map(&file)?;
        lane.head().turn.store(HOST, Ordering::Release);
        Ok((lane, file))
    }

    /// Maps the file of [`Self::create`].
    pub fn map(file: &File) -> std::io::Result<Self> {
        let protection = libc::PROT_READ | libc::PROT_WRITE;
        // SAFETY: a fresh mapping at an address that the system chooses, of a file with this size, which is sealed.
        let base =
            unsafe { libc::mmap(std::ptr::null_mut(), LANE_BYTES, protection, libc::MAP_SHARED, file.as_raw_fd(), 0) };
        if base == libc::MAP_FAILED { Err(std::io::Error::last_os_error()) } else { Ok(Self { base: base.cast() }) }
    }

    fn head(&self) -> &Head {
        // SAFETY: the mapping begins with a head, is aligned to a page and lives as long as this lane; all of the head is atomics.
        unsafe { &*self.base.cast::<Head>() }
    }

    /// Writes a message and passes the turn to the other side. The caller has the turn.
    pub fn post(&self, from: Side, kind: Kind, message: &[u8]) {
        let len = message.len().min(MOST_BYTES);
        // SAFETY: `len` bytes lie inside the mapping behind the head; the other side reads them after its turn begins.
        unsafe { std::ptr::copy_nonoverlapping(message.as_ptr(), self.base.add(HEAD_BYTES), len) };
        self.head().kind.store(kind as u32, Ordering::Relaxed);
        self.head().len.store(len as u32, Ordering::Relaxed);
        self.pass(if from == Side::Host { CHILD } else { HOST });
    }

    fn pass(&self, to: u32) {
        if self.head().turn.swap(to, Ordering::SeqCst) & SLEEPS != 0 {
            self.wake();
        }
    }

    fn wake(&self) {
        // SAFETY: a plain system call on a word of the mapping.
        unsafe { libc::syscall(libc::SYS_futex, &raw const self.head().turn, libc::FUTEX_WAKE, i32::MAX) };
    }

    /// Tells the host's side that the child is gone.
    pub fn close(&self) {
        self.head().turn.swap(GONE, Ordering::SeqCst);
        self.wake();
    }

    /// Waits for the turn of `side`, then copies the message to `message`.
    pub fn receive(&self, side: Side, message: &mut Vec<u8>) -> Result<Kind, Lost> {
        self.wait(if side == Side::Host { CHILD } else { HOST });
        if self.head().turn.load(Ordering::Acquire) & !SLEEPS == GONE {
            return Err(Lost::Gone);
        }
        let kind = Kind::of(self.head().kind.load(Ordering::Relaxed)).ok_or(Lost::Bad)?;
        let len = self.head().len.load(Ordering::Relaxed) as usize;
        if len > MOST_BYTES {
            return Err(Lost::Bad);
        }
        message.clear();
        message.reserve(len);
        // SAFETY: `len` bytes lie inside the mapping behind the head, and there is room for them in `message`. The other side may write them
        // at the same time if it breaks the protocol: any bytes are valid, and only the copy is read.
        unsafe {
            std::ptr::copy_nonoverlapping(self.base.add(HEAD_BYTES), message.as_mut_ptr(), len);
            message.set_len(len);
        }
        Ok(kind)
    }

    /// Waits until the turn is no longer `other`'s.
    fn wait(&self, other: u32) {
        let turn = &self.head().turn;
        let mut since = None;
        loop {
            for _ in 0..64 {
                if turn.load(Ordering::Acquire) & !SLEEPS != other {
                    return;
                }
                std::hint::spin_loop();
            }
            if since.get_or_insert_with(Instant::now).elapsed() >= SPIN {
                break;
            }
        }
        loop {
            let now = turn.load(Ordering::Acquire);
            if now & !SLEEPS != other {
                return;
            }
            if now & SLEEPS == 0
                && turn.compare_exchange(now, now | SLEEPS, Ordering::SeqCst, Ordering::Acquire).is_err()
            {
                continue;
            }
            // SAFETY: a plain system call on a word of the mapping; the null pointer is a time limit that never passes.
            unsafe {
                let never = std::ptr::null::<libc::timespec>();
                libc::syscall(libc::SYS_futex, &raw const *turn, libc::FUTEX_WAIT, other | SLEEPS, never);
            }
        }
    }

    /// Records the signal that ends the process, in the child's handler.
    pub fn set_signal(&self, signal: u32) {
        self.head().signal.store(signal, Ordering::Relaxed);
    }

    /// The signal that a thread of the lane received; 0 for none.
    pub fn signal(&self) -> u32 {
        self.head().signal.load(Ordering::Relaxed)
    }
}

impl Drop for Lane {
    fn drop(&mut self) {
        // SAFETY: the mapping was made by `map` and nobody uses it any more.
        unsafe { libc::munmap(self.base.cast(), LANE_BYTES) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_sides_take_turns() {
        let (host, file) = Lane::create().expect("memory");
        let child = Lane::map(&file).expect("memory");
        let echo = std::thread::spawn(move || {
            let mut message = Vec::new();
            while child.receive(Side::Child, &mut message) == Ok(Kind::Process) {
                message.reverse();
                child.post(Side::Child, Kind::Done, &message);
            }
        });
        let mut answer = Vec::new();
        for round in 0..2000_u32 {
            let message = round.to_le_bytes();
            host.post(Side::Host, Kind::Process, &message);
            assert_eq!(host.receive(Side::Host, &mut answer), Ok(Kind::Done));
            assert_eq!(answer, message.iter().rev().copied().collect::<Vec<u8>>());
        }
        host.post(Side::Host, Kind::Close, &[]);
        echo.join().expect("no panic");
    }

    #[test]
    fn a_lane_that_is_closed_wakes_its_host() {
        let (host, file) = Lane::create().expect("memory");
        let watcher = Lane::map(&file).expect("memory");
        host.post(Side::Host, Kind::Process, b"x");
        let waits = std::thread::spawn(move || host.receive(Side::Host, &mut Vec::new()));
        watcher.close();
        assert_eq!(waits.join().expect("no panic"), Err(Lost::Gone));
        assert!(file.set_len(1).is_err(), "nobody can shorten it");
    }
}
