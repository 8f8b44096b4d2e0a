//! As `std::sync`.

pub mod atomic;
pub mod mpsc;

use std::cell::UnsafeCell;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

pub use std::sync::{Arc, LockResult, PoisonError, TryLockError, TryLockResult, Weak};

use crate::world::scheduler::{self, Key, point};

/// As `std::sync::Mutex`.
pub struct Mutex<T: ?Sized> {
    held: AtomicBool,
    waiting: AtomicU32,
    poisoned: AtomicBool,
    value: UnsafeCell<T>,
}

// SAFETY: `held` lets one guard exist at a time, and one thread of a world runs at a time.
unsafe impl<T: ?Sized + Send> Send for Mutex<T> {}
// SAFETY: `held` lets one guard exist at a time, and one thread of a world runs at a time.
unsafe impl<T: ?Sized + Send> Sync for Mutex<T> {}

impl<T> Mutex<T> {
    /// An unlocked mutex.
    pub const fn new(value: T) -> Self {
        Self {
            held: AtomicBool::new(false),
            waiting: AtomicU32::new(0),
            poisoned: AtomicBool::new(false),
            value: UnsafeCell::new(value),
        }
    }

    /// The value.
    pub fn into_inner(self) -> LockResult<T> {
        let poisoned = self.poisoned.load(Ordering::Relaxed);
        let value = self.value.into_inner();
        if poisoned { Err(PoisonError::new(value)) } else { Ok(value) }
    }
}

impl<T: ?Sized> Mutex<T> {
    fn key(&self) -> Key {
        Key::Address((&raw const self.held).addr())
    }

    /// Locks; waits while another thread holds the lock.
    pub fn lock(&self) -> LockResult<MutexGuard<'_, T>> {
        point();
        while self.held.swap(true, Ordering::Acquire) {
            self.waiting.fetch_add(1, Ordering::Relaxed);
            scheduler::wait_for(self.key(), None, "a lock", false);
            self.waiting.fetch_sub(1, Ordering::Relaxed);
        }
        self.guard()
    }

    /// Locks, unless another thread holds the lock.
    pub fn try_lock(&self) -> TryLockResult<MutexGuard<'_, T>> {
        point();
        if self.held.swap(true, Ordering::Acquire) {
            return Err(TryLockError::WouldBlock);
        }
        self.guard().map_err(TryLockError::Poisoned)
    }

    /// The value, through the only reference.
    pub fn get_mut(&mut self) -> LockResult<&mut T> {
        Ok(self.value.get_mut())
    }

    fn guard(&self) -> LockResult<MutexGuard<'_, T>> {
        let guard = MutexGuard { mutex: self, was_panicking: std::thread::panicking(), not_send: PhantomData };
        if self.poisoned.load(Ordering::Relaxed) { Err(PoisonError::new(guard)) } else { Ok(guard) }
    }

    fn unlock(&self) {
        self.held.store(false, Ordering::Release);
        if self.waiting.load(Ordering::Relaxed) > 0 {
            scheduler::wake(self.key(), true);
        }
    }
}

impl<T: Default> Default for Mutex<T> {
    fn default() -> Self {
        Self::new(T::default())
    }
}

impl<T: ?Sized> std::fmt::Debug for Mutex<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Mutex")
    }
}

/// As `std::sync::MutexGuard`.
pub struct MutexGuard<'a, T: ?Sized> {
    mutex: &'a Mutex<T>,
    was_panicking: bool,
    not_send: PhantomData<*const ()>,
}

// SAFETY: a shared guard gives only `&T`.
unsafe impl<T: ?Sized + Sync> Sync for MutexGuard<'_, T> {}

impl<T: ?Sized> Deref for MutexGuard<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        // SAFETY: the guard holds the lock.
        unsafe { &*self.mutex.value.get() }
    }
}

impl<T: ?Sized> DerefMut for MutexGuard<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        // SAFETY: the guard holds the lock.
        unsafe { &mut *self.mutex.value.get() }
    }
}

impl<T: ?Sized> Drop for MutexGuard<'_, T> {
    fn drop(&mut self) {
        if !self.was_panicking && std::thread::panicking() {
            self.mutex.poisoned.store(true, Ordering::Relaxed);
        }
        self.mutex.unlock();
    }
}

/// As `std::sync::Condvar`.
#[derive(Debug, Default)]
pub struct Condvar {
    waiting: AtomicU32,
}

/// As `std::sync::WaitTimeoutResult`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WaitTimeoutResult(bool);

impl WaitTimeoutResult {
    /// Whether the wait ended because of the timeout.
    pub fn timed_out(&self) -> bool {
        self.0
    }
}

impl Condvar {
    /// A condition variable without waiting threads.
    pub const fn new() -> Self {
        Self { waiting: AtomicU32::new(0) }
    }

    fn key(&self) -> Key {
        Key::Address((&raw const self.waiting).addr())
    }

    fn wait_inside<'a, T>(
        &self,
        guard: MutexGuard<'a, T>,
        limit: Option<Duration>,
    ) -> (LockResult<MutexGuard<'a, T>>, bool) {
        let mutex = guard.mutex;
        self.waiting.fetch_add(1, Ordering::Relaxed);
        // No other thread runs between the two.
        drop(guard);
        let limit_ns = limit.map(|limit| u64::try_from(limit.as_nanos()).unwrap_or(u64::MAX));
        let notified = scheduler::wait_for(self.key(), limit_ns, "a condition", true);
        self.waiting.fetch_sub(1, Ordering::Relaxed);
        (mutex.lock(), notified)
    }

    /// Waits for a notification; may return without one.
    pub fn wait<'a, T>(&self, guard: MutexGuard<'a, T>) -> LockResult<MutexGuard<'a, T>> {
        self.wait_inside(guard, None).0
    }

    /// Waits for a notification or the timeout.
    pub fn wait_timeout<'a, T>(
        &self,
        guard: MutexGuard<'a, T>,
        limit: Duration,
    ) -> LockResult<(MutexGuard<'a, T>, WaitTimeoutResult)> {
        let (guard, notified) = self.wait_inside(guard, Some(limit));
        let result = WaitTimeoutResult(!notified);
        match guard {
            Ok(guard) => Ok((guard, result)),
            Err(poisoned) => Err(PoisonError::new((poisoned.into_inner(), result))),
        }
    }

    /// Wakes one waiting thread.
    pub fn notify_one(&self) {
        point();
        if self.waiting.load(Ordering::Relaxed) > 0 {
            scheduler::wake(self.key(), false);
        }
    }

    /// Wakes all waiting threads.
    pub fn notify_all(&self) {
        point();
        if self.waiting.load(Ordering::Relaxed) > 0 {
            scheduler::wake(self.key(), true);
        }
    }
}

/// As `std::sync::OnceLock`.
pub struct OnceLock<T> {
    filling: Mutex<()>,
    value: std::sync::OnceLock<T>,
}

impl<T> OnceLock<T> {
    /// An empty cell.
    pub const fn new() -> Self {
        Self { filling: Mutex::new(()), value: std::sync::OnceLock::new() }
    }

    /// The value, if it is set.
    pub fn get(&self) -> Option<&T> {
        self.value.get()
    }

    /// Sets the value.
    ///
    /// # Errors
    /// It is set already.
    pub fn set(&self, value: T) -> Result<(), T> {
        point();
        self.value.set(value)
    }

    /// The value; the first caller creates it.
    pub fn get_or_init(&self, make: impl FnOnce() -> T) -> &T {
        point();
        if let Some(value) = self.value.get() {
            return value;
        }
        let _filling = self.filling.lock().unwrap_or_else(PoisonError::into_inner);
        let made = if self.value.get().is_none() { Some(make()) } else { None };
        // No other thread fills it: this one holds the lock.
        self.value.get_or_init(|| made.unwrap_or_else(|| unreachable!("made under the lock")))
    }
}

impl<T> Default for OnceLock<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T> std::fmt::Debug for OnceLock<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("OnceLock")
    }
}

/// As `std::sync::LazyLock`.
pub struct LazyLock<T> {
    cell: OnceLock<T>,
    make: fn() -> T,
}

impl<T> LazyLock<T> {
    /// A value that `make` creates on first use.
    pub const fn new(make: fn() -> T) -> Self {
        Self { cell: OnceLock::new(), make }
    }
}

impl<T> Deref for LazyLock<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.cell.get_or_init(self.make)
    }
}
