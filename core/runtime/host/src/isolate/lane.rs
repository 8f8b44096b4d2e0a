//! Shared memory on which host and child take turns.
//!
//! One word says whose turn it is. The other side spins for a while if its last waits were short, then sleeps on the
//! word as a futex. A side that sleeps marks the word, so that passing the turn to one that spins needs no system call.

use std::fs::File;
use std::os::fd::{AsRawFd, FromRawFd};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicI64, AtomicU32, AtomicU64, Ordering};
use std::time::Instant;

use crate::isolate::wire::BadMessage;
use crate::isolate::wire::lane::Kind;

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
/// Offset of the message.
const HEAD_BYTES: usize = 64;
/// Maximum length of a message, bytes.
pub(crate) const MAX_MESSAGE_BYTES: usize = LANE_BYTES - HEAD_BYTES;

/// A side spins for its turn while its waits are usually shorter than this. Waking a thread that sleeps takes 15 to 40
/// us on an idle core.
const SHORT_WAIT_NS: u64 = 80_000;
/// Maximum time of a spin.
const MAX_SPIN_NS: u64 = 100_000;
/// Reads of the word before the clock is read for the first time.
const FIRST_LOOKS: u32 = 256;
/// Reads of the word between two yields to other threads.
const LOOKS_PER_YIELD: u32 = 16;
/// Waits beyond this count as this long, so that a pause is soon forgotten.
const MAX_SAMPLE_NS: u64 = 1_000_000;

/// Whether the other side can run while this one spins.
static SPINS: LazyLock<bool> =
    LazyLock::new(|| std::thread::available_parallelism().is_ok_and(|cores| cores.get() > 1));

#[repr(C)]
struct Head {
    turn: AtomicU32,
    kind: AtomicU32,
    len: AtomicU32,
    /// Signal that a thread of the lane received, set by the child's handler; 0 for none.
    signal: AtomicU32,
    /// Counters of the connection to another machine, written by its link.
    link: LinkCounts,
}

/// State of a link's connection. Atomic, because the host reads it at any time.
#[repr(C)]
#[derive(Default)]
pub(crate) struct LinkCounts {
    pub clock_offset_ns: AtomicI64,
    /// Maximum error of the clock offset, ns; 0 while the offset is unknown.
    pub clock_uncertainty_ns: AtomicU64,
    pub round_trip_ns: AtomicU64,
    pub sent_bytes: AtomicU64,
    pub received_bytes: AtomicU64,
}

const _: () = assert!(size_of::<Head>() <= HEAD_BYTES);

/// A side of a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    Host,
    Child,
}

/// A mapped lane. Counters are those of this side.
pub(crate) struct Lane {
    base: *mut u8,
    /// Moving average of the waiting time of this side.
    usual_ns: AtomicU64,
    posts: AtomicU64,
    sleeps: AtomicU64,
}

// SAFETY: the head is atomics; the message is written by the side whose turn it is.
unsafe impl Send for Lane {}
// SAFETY: the head is atomics; the message is written by the side whose turn it is.
unsafe impl Sync for Lane {}

/// No message from the other side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lost {
    Gone,
    /// The message is malformed.
    Bad,
    /// The message did not arrive in time.
    Late,
}

impl From<BadMessage> for Lost {
    fn from(_: BadMessage) -> Self {
        Self::Bad
    }
}

impl Lane {
    /// A new lane with the host's turn, and the file for the child to map.
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
        if base == libc::MAP_FAILED {
            return Err(std::io::Error::last_os_error());
        }
        let counter = || AtomicU64::new(0);
        Ok(Self { base: base.cast(), usual_ns: counter(), posts: counter(), sleeps: counter() })
    }

    fn head(&self) -> &Head {
        // SAFETY: the mapping begins with a head, is aligned to a page and lives as long as this lane; all of the head is atomics.
        unsafe { &*self.base.cast::<Head>() }
    }

    /// Writes a message and passes the turn to the other side. The caller has the turn.
    pub fn post(&self, from: Side, kind: Kind, message: &[u8]) {
        let len = message.len().min(MAX_MESSAGE_BYTES);
        self.post_as(from, kind as u32, len as u32, message);
    }

    /// As [`Self::post`], with arbitrary numbers in the head of the message.
    pub fn post_as(&self, from: Side, kind: u32, stated_len: u32, message: &[u8]) {
        self.posts.fetch_add(1, Ordering::Relaxed);
        let len = message.len().min(MAX_MESSAGE_BYTES);
        // SAFETY: `len` bytes lie inside the mapping behind the head; the other side reads them after its turn begins.
        unsafe { std::ptr::copy_nonoverlapping(message.as_ptr(), self.base.add(HEAD_BYTES), len) };
        self.head().kind.store(kind, Ordering::Relaxed);
        self.head().len.store(stated_len, Ordering::Relaxed);
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

    /// Tells the host's side that the child has ended.
    pub fn close(&self) {
        self.head().turn.swap(GONE, Ordering::SeqCst);
        self.wake();
    }

    /// Messages that this side posted, and how often it slept.
    pub fn counts(&self) -> (u64, u64) {
        (self.posts.load(Ordering::Relaxed), self.sleeps.load(Ordering::Relaxed))
    }

    /// Waits for the turn of `side`, then copies the message to `message`.
    pub fn receive(&self, side: Side, message: &mut Vec<u8>) -> Result<Kind, Lost> {
        self.receive_until(side, message, None)
    }

    /// As [`Self::receive`], but no longer than `deadline`. After [`Lost::Late`] the other side still has the turn.
    pub fn receive_until(&self, side: Side, message: &mut Vec<u8>, deadline: Option<Instant>) -> Result<Kind, Lost> {
        if !self.wait(if side == Side::Host { CHILD } else { HOST }, deadline) {
            return Err(Lost::Late);
        }
        if self.head().turn.load(Ordering::Acquire) & !SLEEPS == GONE {
            return Err(Lost::Gone);
        }
        let kind = Kind::of(self.head().kind.load(Ordering::Relaxed)).ok_or(Lost::Bad)?;
        let len = self.head().len.load(Ordering::Relaxed) as usize;
        if len > MAX_MESSAGE_BYTES {
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

    /// Waits until the turn is no longer `other`'s; `false` if that does not happen before the deadline.
    fn wait(&self, other: u32, deadline: Option<Instant>) -> bool {
        let turn = &self.head().turn;
        let passed = || turn.load(Ordering::Acquire) & !SLEEPS != other;
        let usual_ns = self.usual_ns.load(Ordering::Relaxed);
        let spins = usual_ns < SHORT_WAIT_NS && *SPINS;
        if spins {
            for _ in 0..FIRST_LOOKS {
                if passed() {
                    self.usual_ns.store(usual_ns - usual_ns / 4, Ordering::Relaxed);
                    return true;
                }
                std::hint::spin_loop();
            }
        }
        let begin = Instant::now();
        let waited_ns = || u64::try_from(begin.elapsed().as_nanos()).unwrap_or(u64::MAX);
        let in_time = (spins && self.spin(passed, waited_ns)) || self.sleep(other, deadline);
        let sample_ns = waited_ns().min(MAX_SAMPLE_NS);
        self.usual_ns.store(usual_ns - usual_ns / 4 + sample_ns / 4, Ordering::Relaxed);
        in_time
    }

    /// Spins until the turn has passed; `false` if that takes too long. Yields the core to other threads, perhaps the
    /// other side.
    fn spin(&self, passed: impl Fn() -> bool, waited_ns: impl Fn() -> u64) -> bool {
        loop {
            for _ in 0..LOOKS_PER_YIELD {
                if passed() {
                    return true;
                }
                std::hint::spin_loop();
            }
            if waited_ns() >= MAX_SPIN_NS {
                return false;
            }
            std::thread::yield_now();
        }
    }

    fn sleep(&self, other: u32, deadline: Option<Instant>) -> bool {
        let turn = &self.head().turn;
        self.sleeps.fetch_add(1, Ordering::Relaxed);
        loop {
            let now = turn.load(Ordering::Acquire);
            if now & !SLEEPS != other {
                return true;
            }
            let left = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
            if left.is_some_and(|left| left.is_zero()) {
                return false;
            }
            if now & SLEEPS == 0
                && turn.compare_exchange(now, now | SLEEPS, Ordering::SeqCst, Ordering::Acquire).is_err()
            {
                continue;
            }
            let limit = left.map(|left| libc::timespec {
                tv_sec: left.as_secs().try_into().unwrap_or(libc::time_t::MAX),
                tv_nsec: left.subsec_nanos().into(),
            });
            let limit = limit.as_ref().map_or(std::ptr::null(), std::ptr::from_ref);
            // SAFETY: a plain system call on a word of the mapping; the time limit lives until it returns, null is none.
            unsafe { libc::syscall(libc::SYS_futex, &raw const *turn, libc::FUTEX_WAIT, other | SLEEPS, limit) };
        }
    }

    /// State of the connection, as reported by the link to another machine.
    pub fn link(&self) -> &LinkCounts {
        &self.head().link
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
    use std::time::Duration;

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
    fn a_wait_has_a_limit_and_the_answer_still_counts() {
        let (host, file) = Lane::create().expect("memory");
        let child = Lane::map(&file).expect("memory");
        host.post(Side::Host, Kind::Process, b"x");
        let mut message = Vec::new();
        let soon = Instant::now() + Duration::from_millis(2);
        assert_eq!(host.receive_until(Side::Host, &mut message, Some(soon)), Err(Lost::Late));
        assert_eq!(child.receive(Side::Child, &mut message), Ok(Kind::Process));
        child.post(Side::Child, Kind::Done, b"late");
        assert_eq!(host.receive(Side::Host, &mut message), Ok(Kind::Done));
        assert_eq!((&message[..], host.counts().0), (&b"late"[..], 1));
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
