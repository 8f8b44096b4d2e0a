//! As `std::hint`.

/// Lets another thread run: a spinning thread waits for one.
pub fn spin_loop() {
    crate::world::thread::yield_now();
}
