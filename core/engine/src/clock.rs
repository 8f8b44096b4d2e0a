//! The host's monotonic clock, cheap enough to be read at every node boundary.
//!
//! Where the processor has an invariant time-stamp counter it is read directly (about 10 ns instead of 25 ns). The counter's rate is
//! measured over 3 ms at the start and again over longer and longer times by [`keep`]. The clock corrects its error by running
//! slightly faster or slower, never by a step. If the counter does not keep time, the clock falls back to the operating system's.

use std::sync::atomic::{AtomicPtr, AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant};

use crate::sync::lock;

/// Duration of the first measurement.
const FIRST_MEASUREMENT: Duration = Duration::from_millis(3);
/// Time between publishing a stretch and its start, so that every reader has seen it.
const NOTICE_NS: u64 = 50_000_000;
/// Time between two measurements; doubles from the first to the second value.
const FIRST_INTERVAL_NS: u64 = 100_000_000;
const LONGEST_INTERVAL_NS: u64 = 64_000_000_000;
/// Largest relative change of the rate to correct an error.
const MAX_SLEW: f64 = 0.001;
/// Beyond this difference of rates between two measurements, or this error, the counter is not used.
const MAX_RATE_CHANGE: f64 = 0.01;
const MAX_ERROR_NS: f64 = 50e6;

/// A period in which the clock runs at one rate. Never freed, because a reader may still hold a reference.
struct Stretch {
    /// Counter at its start.
    begin_ticks: u64,
    /// Time at its start.
    begin_ns: u64,
    /// Nanoseconds per tick of the counter, times 2^32: one integer multiplication per reading. 0 where the operating system's clock is
    /// read instead.
    ns_per_tick_q32: u64,
    /// Counter ticks until its end, [`NO_END`] while it has none; 0 where the counter is not used.
    span_ticks: AtomicU64,
    /// The next stretch.
    next: AtomicPtr<Stretch>,
}

/// Half of the range, so that a counter before the start of a stretch also counts as past its end.
const NO_END: u64 = 1 << 63;
/// Largest difference between the counters of two processors.
const MAX_COUNTERS_DIFFER: u64 = 1 << 20;

impl Stretch {
    const fn new(begin_ticks: u64, begin_ns: u64, ns_per_tick_q32: u64) -> Self {
        let span_ticks = AtomicU64::new(if ns_per_tick_q32 == 0 { 0 } else { NO_END });
        Self { begin_ticks, begin_ns, ns_per_tick_q32, span_ticks, next: AtomicPtr::new(std::ptr::null_mut()) }
    }

    #[inline]
    fn at(&self, ticks: u64) -> u64 {
        let passed = u128::from(ticks.wrapping_sub(self.begin_ticks)) * u128::from(self.ns_per_tick_q32);
        self.begin_ns.wrapping_add((passed >> 32) as u64)
    }

    fn ns_per_tick(&self) -> f64 {
        self.ns_per_tick_q32 as f64 / Q32
    }
}

const Q32: f64 = 4_294_967_296.0;

/// Before the first reading.
static NONE: Stretch = Stretch::new(0, 0, 0);
static CLOCK: Clock = Clock { newest: AtomicPtr::new((&raw const NONE).cast_mut()), last_ns: AtomicU64::new(0) };
static KEEPER: OnceLock<Keeper> = OnceLock::new();

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
#[inline]
fn counter() -> u64 {
    0
}

/// The counter and the operating system's clock at one moment.
#[derive(Clone, Copy, Debug)]
struct Pair {
    ticks: u64,
    /// Time since the keeper started.
    os_ns: u64,
}

impl Pair {
    /// Reads both several times and keeps the pair with the smallest gap, because the thread may be preempted between the two readings.
    fn read(start: Instant) -> Self {
        let one = || {
            let before = counter();
            let os_ns = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
            let gap = counter().wrapping_sub(before);
            (gap, Self { ticks: before.wrapping_add(gap / 2), os_ns })
        };
        (0..8).map(|_| one()).min_by_key(|(gap, _)| *gap).map_or(Self { ticks: 0, os_ns: 0 }, |(_, pair)| pair)
    }
}

/// The kind of the next stretch.
#[derive(Debug, PartialEq)]
enum Next {
    /// The counter, at this rate.
    Rate(f64),
    /// The counter does not keep time.
    Os,
}

/// Chooses the next rate. `off_ns` is how far the clock is ahead of the operating system's, `measured` the counter's rate over
/// the longest known time, `horizon_ns` the time in which to correct the error.
fn decide(current: f64, measured: f64, off_ns: f64, horizon_ns: f64) -> Next {
    let changed = (measured / current - 1.0).abs();
    if !measured.is_finite() || measured <= 0.0 || changed > MAX_RATE_CHANGE || off_ns.abs() > MAX_ERROR_NS {
        return Next::Os;
    }
    let slew = (off_ns / horizon_ns).clamp(-MAX_SLEW, MAX_SLEW);
    Next::Rate(measured * (1.0 - slew))
}

/// The stretches of a clock.
struct Clock {
    /// The stretch that readers start with; `next` leads to later ones.
    newest: AtomicPtr<Stretch>,
    /// Newest reading of the operating system's clock.
    last_ns: AtomicU64,
}

impl Clock {
    /// Time without the counter: never before `least_ns`, never backwards.
    fn os(&self, least_ns: u64, os_ns: u64) -> u64 {
        let ns = os_ns.max(least_ns);
        self.last_ns.fetch_max(ns, Ordering::Relaxed).max(ns)
    }

    /// The last published stretch.
    fn last(&self) -> &'static Stretch {
        let mut at = self.newest.load(Ordering::Acquire);
        loop {
            // SAFETY: `newest` and `next` hold stretches that are never freed, or null, which ends this loop.
            let stretch = unsafe { &*at };
            let next = stretch.next.load(Ordering::Acquire);
            if next.is_null() {
                return stretch;
            }
            at = next;
        }
    }

    /// Reads the time where `stretch` does not apply: after its end, before its start, or without a counter.
    fn read_otherwise(&self, mut at: *const Stretch, ticks: u64, os_ns: impl FnOnce() -> u64) -> u64 {
        loop {
            // SAFETY: `next` holds a stretch that is never freed, or null, which `as_ref` turns into `None`.
            let stretch = unsafe { &*at };
            if stretch.ns_per_tick_q32 == 0 {
                return self.os(stretch.begin_ns, os_ns());
            }
            let passed = ticks.wrapping_sub(stretch.begin_ticks);
            if passed >= NO_END {
                // Another processor's counter may be slightly behind. A counter that restarted is not used.
                let little = passed.wrapping_neg() < MAX_COUNTERS_DIFFER;
                return if little { stretch.begin_ns } else { self.os(stretch.begin_ns, os_ns()) };
            }
            let next = stretch.next.load(Ordering::Acquire);
            if passed < stretch.span_ticks.load(Ordering::Acquire) || next.is_null() {
                return stretch.at(ticks);
            }
            // From here on readers start with the next stretch.
            let _ = self.newest.compare_exchange(at.cast_mut(), next, Ordering::AcqRel, Ordering::Relaxed);
            at = next;
        }
    }

    /// Adds a stretch that starts at `begin_ticks`, which lies in the future, with the time of the last one there.
    fn go_on(&self, begin_ticks: u64, ns_per_tick_q32: u64) {
        let last = self.last();
        let next = Box::leak(Box::new(Stretch::new(begin_ticks, last.at(begin_ticks), ns_per_tick_q32)));
        last.next.store(next, Ordering::Release);
        last.span_ticks.store(begin_ticks.wrapping_sub(last.begin_ticks), Ordering::Release);
    }
}

/// Measures the counter against the operating system's clock.
struct Keeper {
    start: Instant,
    first: Pair,
    /// Time of the next measurement, and the interval after it.
    due: Mutex<(u64, u64)>,
}

impl Keeper {
    /// Returns start and rate of the next stretch of `clock`, if one is due.
    fn next(&self, clock: &Clock, pair: Pair) -> Option<(u64, u64)> {
        let last = clock.last();
        let mut due = lock(&self.due);
        if last.ns_per_tick_q32 == 0 || pair.os_ns < due.0 {
            return None;
        }
        let (ns, ticks) = (pair.os_ns - self.first.os_ns, pair.ticks.wrapping_sub(self.first.ticks));
        let interval_ns = (due.1 * 2).min(LONGEST_INTERVAL_NS);
        *due = (pair.os_ns + interval_ns, interval_ns);
        let off_ns = last.at(pair.ticks) as f64 - pair.os_ns as f64;
        let rate = match decide(last.ns_per_tick(), ns as f64 / ticks.max(1) as f64, off_ns, interval_ns as f64) {
            Next::Rate(rate) => (rate * Q32) as u64,
            Next::Os => 0,
        };
        Some((pair.ticks.wrapping_add((NOTICE_NS as f64 / last.ns_per_tick()) as u64), rate))
    }
}

fn keeper() -> &'static Keeper {
    KEEPER.get_or_init(|| {
        let start = Instant::now();
        let first = Pair::read(start);
        let mut rate = 0.0;
        if is_invariant() {
            while start.elapsed() < FIRST_MEASUREMENT {
                std::hint::spin_loop();
            }
            let last = Pair::read(start);
            rate = (last.os_ns - first.os_ns) as f64 / last.ticks.wrapping_sub(first.ticks).max(1) as f64;
        }
        let stretch = Stretch::new(first.ticks, first.os_ns, (rate * Q32) as u64);
        CLOCK.newest.store(Box::leak(Box::new(stretch)), Ordering::Release);
        Keeper { start, first, due: Mutex::new((FIRST_INTERVAL_NS, FIRST_INTERVAL_NS)) }
    })
}

/// Measures the clock if a measurement is due. The watchdog calls this a few times per second.
pub(crate) fn keep() {
    let keeper = keeper();
    let due_ns = lock(&keeper.due).0;
    if now_ns() < due_ns {
        return;
    }
    let pair = Pair::read(keeper.start);
    if let Some((begin_ticks, rate)) = keeper.next(&CLOCK, pair) {
        // A thread that was preempted until now would publish too late, so it measures again next time.
        let held_up = counter().wrapping_sub(pair.ticks) > begin_ticks.wrapping_sub(pair.ticks) / 2;
        if !held_up {
            CLOCK.go_on(begin_ticks, rate);
        }
    }
}

#[cold]
fn read_otherwise(at: *const Stretch, ticks: u64) -> u64 {
    let keeper = keeper();
    let os_ns = || u64::try_from(keeper.start.elapsed().as_nanos()).unwrap_or(u64::MAX);
    if std::ptr::eq(at, &raw const NONE) {
        return CLOCK.read_otherwise(CLOCK.newest.load(Ordering::Acquire), counter(), os_ns);
    }
    CLOCK.read_otherwise(at, ticks, os_ns)
}

/// Nanoseconds since the first call in this process.
#[inline]
pub fn now_ns() -> u64 {
    let at = CLOCK.newest.load(Ordering::Acquire);
    // SAFETY: `newest` holds `NONE` or a stretch that is never freed.
    let stretch = unsafe { &*at };
    let ticks = counter();
    if ticks.wrapping_sub(stretch.begin_ticks) >= stretch.span_ticks.load(Ordering::Relaxed) {
        return read_otherwise(at, ticks);
    }
    stretch.at(ticks)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIRST: Pair = Pair { ticks: 1_000, os_ns: 0 };

    /// A clock that starts with `claimed` ns per tick.
    fn clock(claimed: f64) -> (Clock, Keeper) {
        let stretch = Box::leak(Box::new(Stretch::new(FIRST.ticks, 0, (claimed * Q32) as u64)));
        let due = Mutex::new((FIRST_INTERVAL_NS, FIRST_INTERVAL_NS));
        let clock = Clock { newest: AtomicPtr::new(stretch), last_ns: AtomicU64::new(0) };
        (clock, Keeper { start: Instant::now(), first: FIRST, due })
    }

    fn read(clock: &Clock, pair: Pair) -> u64 {
        clock.read_otherwise(clock.newest.load(Ordering::Acquire), pair.ticks, || pair.os_ns)
    }

    /// Simulates 1,000 s in steps of 7 ms. Returns the largest error in the last 500 s and the largest step back.
    fn pass(clock: &Clock, keeper: &Keeper, ns_per_tick: impl Fn(u64) -> f64) -> (f64, u64) {
        let (mut ticks, mut before, mut worst, mut back) = (FIRST.ticks as f64, 0u64, 0.0f64, 0u64);
        for step in 1..1_000_000_000_000u64 / 7_000_000 {
            let os_ns = step * 7_000_000;
            ticks += 7_000_000.0 / ns_per_tick(os_ns);
            let pair = Pair { ticks: ticks as u64, os_ns };
            if let Some((begin_ticks, rate)) = keeper.next(clock, pair) {
                clock.go_on(begin_ticks, rate);
            }
            let now = read(clock, pair);
            back = back.max(before.saturating_sub(now));
            before = now;
            if os_ns > 500_000_000_000 {
                worst = worst.max((now as f64 - os_ns as f64).abs());
            }
        }
        (worst, back)
    }

    #[test]
    fn a_first_measurement_that_was_off_is_made_good_without_a_step_back() {
        for claimed in [0.333 * 1.004, 0.333 * 0.996, 0.333] {
            let (clock, keeper) = clock(claimed);
            let (worst_ns, back_ns) = pass(&clock, &keeper, |_| 0.333);
            assert_eq!(back_ns, 0, "monotonic");
            assert!(worst_ns < 10_000.0, "{claimed}: off by {worst_ns} ns after minutes");
        }
    }

    #[test]
    fn a_counter_that_does_not_keep_time_is_left() {
        // After 20 s it runs at half its rate.
        let (clock, keeper) = clock(0.333);
        let (worst_ns, back_ns) = pass(&clock, &keeper, |ns| if ns < 20_000_000_000 { 0.333 } else { 0.666 });
        assert_eq!(back_ns, 0, "monotonic");
        assert!(worst_ns < 1_000.0, "the operating system's clock goes on: {worst_ns} ns");
    }

    #[test]
    fn a_counter_that_begins_anew_does_not_stop_the_clock() {
        let (clock, _) = clock(0.333);
        let early = read(&clock, Pair { ticks: 1_000 + 3_000_000_000_000, os_ns: 999_000_000_000 });
        assert!(early.abs_diff(999_000_000_000) < 1_000_000, "{early}");
        let anew = read(&clock, Pair { ticks: 5, os_ns: 1_000_000_000_000 });
        assert!(anew <= 1, "a processor that is 995 ticks behind: {anew}");
        let (clock, _) = self::clock(0.333);
        let stretch = Box::leak(Box::new(Stretch::new(u64::MAX / 4, 7_000, (0.333 * Q32) as u64)));
        clock.newest.store(stretch, Ordering::Release);
        assert_eq!(read(&clock, Pair { ticks: 5, os_ns: 1_000_000 }), 1_000_000);
        assert_eq!(read(&clock, Pair { ticks: 6, os_ns: 900_000 }), 1_000_000, "never backwards");
    }

    #[test]
    fn the_clock_agrees_with_the_operating_system() {
        let (start_ns, start) = (now_ns(), Instant::now());
        let mut before = start_ns;
        while start.elapsed() < Duration::from_millis(400) {
            keep();
            let now = now_ns();
            assert!(now >= before, "monotonic");
            before = now;
        }
        let (ours, theirs) = ((now_ns() - start_ns) as f64, start.elapsed().as_nanos() as f64);
        assert!((ours - theirs).abs() < 5e6, "{ours} ns, {theirs} ns by the operating system");
    }
}
