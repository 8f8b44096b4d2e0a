//! The host's monotonic clock, cheap enough to be read at every node boundary.
//!
//! Where the processor has an invariant time-stamp counter it is read directly (about 10 ns instead of 25 ns).

use std::sync::OnceLock;
use std::time::{Duration, Instant};

struct Scale {
    start: Instant,
    start_ticks: u64,
    /// Nanoseconds per tick of the counter, times 2^32: one integer multiplication per reading. 0 without a counter to rely on.
    ns_per_tick_q32: u64,
}

#[cfg(target_arch = "x86_64")]
fn is_invariant() -> bool {
    use std::arch::x86_64::__cpuid;
    __cpuid(0x8000_0000).eax >= 0x8000_0007 && __cpuid(0x8000_0007).edx & 1 << 8 != 0
}

#[cfg(target_arch = "x86_64")]
#[inline]
fn counter() -> u64 {
    // SAFETY: every x86-64 processor has the instruction.
    unsafe { std::arch::x86_64::_rdtsc() }
}

#[cfg(not(target_arch = "x86_64"))]
fn is_invariant() -> bool {
    false
}

#[cfg(not(target_arch = "x86_64"))]
fn counter() -> u64 {
    0
}

static SCALE: OnceLock<Scale> = OnceLock::new();

#[cold]
fn set_up() -> &'static Scale {
    SCALE.get_or_init(|| {
        let start = Instant::now();
        let start_ticks = counter();
        let mut ns_per_tick = 0.0f64;
        if is_invariant() {
            while start.elapsed() < Duration::from_millis(3) {
                std::hint::spin_loop();
            }
            let ticks = counter().wrapping_sub(start_ticks);
            ns_per_tick = start.elapsed().as_nanos() as f64 / ticks.max(1) as f64;
        }
        Scale { start, start_ticks, ns_per_tick_q32: (ns_per_tick * 4_294_967_296.0) as u64 }
    })
}

/// Nanoseconds since the first call in this process.
#[inline]
pub fn now_ns() -> u64 {
    let scale = SCALE.get().unwrap_or_else(set_up);
    if scale.ns_per_tick_q32 == 0 {
        return scale.start.elapsed().as_nanos() as u64;
    }
    let ticks = u128::from(counter().wrapping_sub(scale.start_ticks));
    ((ticks * u128::from(scale.ns_per_tick_q32)) >> 32) as u64
}
