//! The host's monotonic clock, cheap enough to be read at every node boundary.
//!
//! Where the processor has an invariant time-stamp counter it is read directly (about 10 ns instead of 25 ns).

use std::sync::OnceLock;
use std::time::{Duration, Instant};

struct Scale {
    start: Instant,
    start_ticks: u64,
    /// Nanoseconds per tick of the counter, times 2^32: one integer multiplication per reading.
    ns_per_tick_q32: u64,
}

#[cfg(target_arch = "x86_64")]
fn counter() -> Option<u64> {
    static INVARIANT: OnceLock<bool> = OnceLock::new();
    let invariant = *INVARIANT.get_or_init(|| {
        use std::arch::x86_64::__cpuid;
        __cpuid(0x8000_0000).eax >= 0x8000_0007 && __cpuid(0x8000_0007).edx & 1 << 8 != 0
    });
    // SAFETY: every x86-64 processor has the instruction.
    invariant.then(|| unsafe { std::arch::x86_64::_rdtsc() })
}

#[cfg(not(target_arch = "x86_64"))]
fn counter() -> Option<u64> {
    None
}

fn scale() -> &'static Scale {
    static SCALE: OnceLock<Scale> = OnceLock::new();
    SCALE.get_or_init(|| {
        let start = Instant::now();
        let start_ticks = counter().unwrap_or(0);
        let mut ns_per_tick = 1.0f64;
        if counter().is_some() {
            while start.elapsed() < Duration::from_millis(3) {
                std::hint::spin_loop();
            }
            let ticks = counter().unwrap_or(0).wrapping_sub(start_ticks);
            ns_per_tick = start.elapsed().as_nanos() as f64 / ticks.max(1) as f64;
        }
        Scale { start, start_ticks, ns_per_tick_q32: (ns_per_tick * 4_294_967_296.0) as u64 }
    })
}

/// Nanoseconds since the first call in this process.
#[inline]
pub fn now_ns() -> u64 {
    let scale = scale();
    match counter() {
        Some(ticks) => {
            let ticks = u128::from(ticks.wrapping_sub(scale.start_ticks));
            ((ticks * u128::from(scale.ns_per_tick_q32)) >> 32) as u64
        }
        None => scale.start.elapsed().as_nanos() as u64,
    }
}
