//! As `std::hint`.

/// Lets another thread run: a thread that spins waits for one.
pub fn spin_loop() {
    crate::thread::yield_now();
}
