//! Counts heap allocations of the whole process.
//!
//! A Rust global allocator does not see plugins and C++ libraries, so the program defines C's allocation functions
//! itself, over those of glibc; the dynamic linker then binds all calls to them. Memory can be freed by glibc's own
//! `free`, which is not replaced. Nothing is counted except on Linux with glibc.

#[cfg(all(target_os = "linux", target_env = "gnu"))]
mod counted {
    use std::cell::Cell;
    use std::ffi::{c_int, c_void};
    use std::sync::atomic::{AtomicU64, Ordering};

    unsafe extern "C" {
        fn __libc_malloc(size: usize) -> *mut c_void;
        fn __libc_calloc(count: usize, size: usize) -> *mut c_void;
        fn __libc_realloc(old: *mut c_void, size: usize) -> *mut c_void;
        fn __libc_memalign(alignment: usize, size: usize) -> *mut c_void;
    }

    static PROCESS: AtomicU64 = AtomicU64::new(0);

    thread_local! {
        // Constants without destructors: reading them allocates nothing.
        static THREAD: Cell<u64> = const { Cell::new(0) };
        static EXCLUDED: Cell<bool> = const { Cell::new(false) };
    }

    #[inline]
    fn count() {
        THREAD.with(|count| count.set(count.get().wrapping_add(1)));
        if !EXCLUDED.with(Cell::get) {
            PROCESS.fetch_add(1, Ordering::Relaxed);
        }
    }

    pub fn process() -> u64 {
        PROCESS.load(Ordering::Relaxed)
    }

    pub fn thread() -> u64 {
        THREAD.with(Cell::get)
    }

    pub fn exclude_this_thread() {
        EXCLUDED.with(|excluded| excluded.set(true));
    }

    /// # Safety
    /// As C's `malloc`.
    #[unsafe(no_mangle)]
    pub unsafe extern "C" fn malloc(size: usize) -> *mut c_void {
        count();
        // SAFETY: the caller's promise.
        unsafe { __libc_malloc(size) }
    }

    /// # Safety
    /// As C's `calloc`.
    #[unsafe(no_mangle)]
    pub unsafe extern "C" fn calloc(items: usize, size: usize) -> *mut c_void {
        count();
        // SAFETY: the caller's promise.
        unsafe { __libc_calloc(items, size) }
    }

    /// # Safety
    /// As C's `realloc`.
    #[unsafe(no_mangle)]
    pub unsafe extern "C" fn realloc(old: *mut c_void, size: usize) -> *mut c_void {
        count();
        // SAFETY: the caller's promise.
        unsafe { __libc_realloc(old, size) }
    }

    /// # Safety
    /// As C's `memalign`.
    #[unsafe(no_mangle)]
    pub unsafe extern "C" fn memalign(alignment: usize, size: usize) -> *mut c_void {
        count();
        // SAFETY: the caller's promise.
        unsafe { __libc_memalign(alignment, size) }
    }

    /// # Safety
    /// As C's `aligned_alloc`.
    #[unsafe(no_mangle)]
    pub unsafe extern "C" fn aligned_alloc(alignment: usize, size: usize) -> *mut c_void {
        count();
        // SAFETY: the caller's promise.
        unsafe { __libc_memalign(alignment, size) }
    }

    /// # Safety
    /// As POSIX's `posix_memalign`.
    #[unsafe(no_mangle)]
    pub unsafe extern "C" fn posix_memalign(out: *mut *mut c_void, alignment: usize, size: usize) -> c_int {
        count();
        if !alignment.is_power_of_two() || !alignment.is_multiple_of(size_of::<*mut c_void>()) {
            return libc::EINVAL;
        }
        // SAFETY: the caller's promise; `out` is written only on success.
        unsafe {
            let memory = __libc_memalign(alignment, size);
            if memory.is_null() {
                return libc::ENOMEM;
            }
            *out = memory;
        }
        0
    }
}

/// Heap allocations of the process so far without those of excluded threads; `None` where they are not counted.
pub fn process() -> Option<fn() -> u64> {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    return Some(counted::process);
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    None
}

/// Heap allocations of the calling thread so far; `None` where they are not counted.
pub fn thread() -> Option<fn() -> u64> {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    return Some(counted::thread);
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    None
}

/// Excludes the calling thread from the counter of the process because it draws the progress bar.
pub fn exclude_this_thread() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    counted::exclude_this_thread();
}
