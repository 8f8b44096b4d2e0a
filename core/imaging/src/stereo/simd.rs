//! Which instruction set the stereo kernels use.

use std::sync::atomic::{AtomicU8, Ordering};

static LEVEL: AtomicU8 = AtomicU8::new(0);

/// Whether AVX2 and FMA kernels may run; asked of the processor once.
pub(crate) fn has_avx2() -> bool {
    match LEVEL.load(Ordering::Relaxed) {
        0 => {
            let found = detect();
            LEVEL.store(if found { 2 } else { 1 }, Ordering::Relaxed);
            found
        }
        level => level == 2,
    }
}

#[cfg(target_arch = "x86_64")]
fn detect() -> bool {
    std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
}

#[cfg(not(target_arch = "x86_64"))]
fn detect() -> bool {
    false
}
