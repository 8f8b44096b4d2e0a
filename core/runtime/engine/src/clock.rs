//! The host's monotonic clock, cheap enough to be read at every node boundary.
//!
//! Where the processor has an invariant time-stamp counter it is read directly (about 10 ns instead of 25 ns). The
//! counter's rate is measured over 3 ms at the start and again by `keep` over increasing intervals. The clock
//! corrects its error by running slightly faster or slower. If the counter does not keep time, the clock falls back to
//! the operating system's.
//!
//! The clock counts the time that the machine sleeps, and it never stands still. Where the counter stood still in a
//! sleep, the clock steps forward; where the counter is ahead, for example after a pause of a virtual machine, the
//! clock goes on from there at its rate.

use std::sync::atomic::{AtomicPtr, AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock};
use std::time::Duration;

use crate::sync::lock;

/// Duration of the first measurement.
const FIRST_MEASUREMENT: Duration = Duration::from_millis(3);
/// Time between publishing a stretch and its start, so that every reader has seen it.
const NOTICE_NS: u64 = 50_000_000;
/// Time between two measurements; doubles from the first to the second value.
const FIRST_INTERVAL_NS: u64 = 100_000_000;
const MAX_INTERVAL_NS: u64 = 64_000_000_000;
/// Largest relative change of the rate to correct an error.
const MAX_SLEW: f64 = 0.001;
/// Maximum relative difference between two measured rates; beyond it the counter is not used.
const MAX_RATE_CHANGE: f64 = 0.01;
/// A larger error is a sleep or a pause, not drift: it is taken as time that has passed, and the measurement starts
/// again.
const MAX_ERROR_NS: f64 = 50e6;
/// Longest time between the two readings of a pair that can show such an error.
const MAX_GAP_NS: f64 = 10e6;

/// A period in which the clock runs at one rate. Never freed, because a reader may still hold a reference.
struct Stretch {
    /// Counter at its start.
    begin_ticks: u64,
    /// Time at its start.
    begin_ns: u64,
    /// Nanoseconds per tick of the counter, times 2^32: one integer multiplication per reading. 0 where the operating
    /// system's clock is read instead.
    ns_per_tick_q32: u64,
    /// Lead over the operating system's clock, where that is read instead.
    ahead_ns: i64,
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
    const fn new(begin_ticks: u64, begin_ns: u64, ns_per_tick_q32: u64, ahead_ns: i64) -> Self {
        let span_ticks = AtomicU64::new(if ns_per_tick_q32 == 0 { 0 } else { NO_END });
        let next = AtomicPtr::new(std::ptr::null_mut());
        Self { begin_ticks, begin_ns, ns_per_tick_q32, ahead_ns, span_ticks, next }
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
static NONE: Stretch = Stretch::new(0, 0, 0, 0);
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

/// The operating system's clock, which counts the time that the machine sleeps.
#[cfg(target_os = "linux")]
fn system_ns() -> u64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: fills the struct.
    unsafe { libc::clock_gettime(libc::CLOCK_BOOTTIME, &raw mut time) };
    (time.tv_sec as u64).wrapping_mul(1_000_000_000).wrapping_add(time.tv_nsec as u64)
}

#[cfg(not(target_os = "linux"))]
fn system_ns() -> u64 {
    static START: OnceLock<std::time::Instant> = OnceLock::new();
    u64::try_from(START.get_or_init(std::time::Instant::now).elapsed().as_nanos()).unwrap_or(u64::MAX)
}

/// The counter and the operating system's clock at one moment.
#[derive(Clone, Copy, Debug)]
struct Pair {
    ticks: u64,
    /// Time since the keeper started.
    os_ns: u64,
}

impl Pair {
    /// Reads both several times and keeps the pair with the smallest gap, because the thread may be preempted between
    /// the two readings.
    fn read(start_ns: u64) -> Self {
        let all = (0..8).map(|_| Self::read_once(start_ns));
        all.min_by_key(|(gap, _)| *gap).map_or(Self { ticks: 0, os_ns: 0 }, |(_, pair)| pair)
    }

    /// Reads both. Returns also the counter's ticks in between.
    fn read_once(start_ns: u64) -> (u64, Self) {
        let before = counter();
        let os_ns = system_ns().saturating_sub(start_ns);
        let gap = counter().wrapping_sub(before);
        (gap, Self { ticks: before.wrapping_add(gap / 2), os_ns })
    }
}

/// Next step of the clock.
#[derive(Debug, PartialEq)]
enum Next {
    /// Use the counter, at this rate.
    Rate(f64),
    /// Step: time has passed that only one of both clocks has counted.
    Step,
    /// Use the operating system's clock; the counter does not keep time.
    Os,
}

/// Chooses the next rate. `off_ns` is how far the clock is ahead of where the operating system's puts it, `measured`
/// the counter's rate over the longest known time, `horizon_ns` the time in which to correct the error.
fn decide(current: f64, measured: f64, off_ns: f64, horizon_ns: f64) -> Next {
    if off_ns.abs() > MAX_ERROR_NS {
        return Next::Step;
    }
    let changed = (measured / current - 1.0).abs();
    if !measured.is_finite() || measured <= 0.0 || changed > MAX_RATE_CHANGE {
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
    /// Time of a stretch without the counter: never before its start, never backwards.
    fn os(&self, stretch: &Stretch, os_ns: u64) -> u64 {
        let ns = os_ns.saturating_add_signed(stretch.ahead_ns).max(stretch.begin_ns);
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
                return self.os(stretch, os_ns());
            }
            let passed = ticks.wrapping_sub(stretch.begin_ticks);
            if passed >= NO_END {
                // Another processor's counter may be slightly behind. A counter that restarted is not used.
                let little = passed.wrapping_neg() < MAX_COUNTERS_DIFFER;
                return if little { stretch.begin_ns } else { self.os(stretch, os_ns()) };
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

    /// Adds a stretch.
    fn go_on(&self, new: &NewStretch) {
        let last = self.last();
        let next = Stretch::new(new.begin_ticks, new.begin_ns, new.ns_per_tick_q32, new.ahead_ns);
        last.next.store(Box::leak(Box::new(next)), Ordering::Release);
        last.span_ticks.store(new.begin_ticks.wrapping_sub(last.begin_ticks), Ordering::Release);
    }
}

/// The next stretch of a clock. It starts in the future.
struct NewStretch {
    begin_ticks: u64,
    /// The clock at its start: at least as late as in the stretch before.
    begin_ns: u64,
    ns_per_tick_q32: u64,
    ahead_ns: i64,
    /// Measures the rate from here on, if the clock stepped.
    from: Option<Pair>,
    interval_ns: u64,
}

/// Measures the counter against the operating system's clock.
struct Keeper {
    start_ns: u64,
    measured: Mutex<Measured>,
}

struct Measured {
    /// Start of the interval over which the rate is measured.
    first: Pair,
    /// Time of the next measurement by the operating system's clock, and the interval after it.
    due_ns: u64,
    interval_ns: u64,
}

impl Keeper {
    fn new(start_ns: u64, first: Pair) -> Self {
        let due_ns = first.os_ns + FIRST_INTERVAL_NS;
        Self { start_ns, measured: Mutex::new(Measured { first, due_ns, interval_ns: FIRST_INTERVAL_NS }) }
    }

    /// Whether a measurement is due: by the time, or because of an error at `pair`, whose readings lie `gap_ticks`
    /// apart.
    fn is_due(&self, clock: &Clock, pair: Pair, gap_ticks: u64) -> bool {
        let last = clock.last();
        let is_counter = last.ns_per_tick_q32 != 0;
        let is_certain = gap_ticks as f64 * last.ns_per_tick() < MAX_GAP_NS;
        is_counter && (pair.os_ns >= lock(&self.measured).due_ns || (is_certain && is_step(last, pair)))
    }

    /// The next stretch of `clock`.
    fn next(&self, clock: &Clock, pair: Pair) -> Option<NewStretch> {
        let last = clock.last();
        if last.ns_per_tick_q32 == 0 || is_before(last, pair) {
            return None;
        }
        let measured = lock(&self.measured);
        let ns = pair.os_ns.saturating_sub(measured.first.os_ns);
        let ticks = pair.ticks.wrapping_sub(measured.first.ticks);
        let interval_ns = (measured.interval_ns * 2).min(MAX_INTERVAL_NS);
        let off_ns = off_ns(last, pair);
        let begin_ticks = pair.ticks.wrapping_add((NOTICE_NS as f64 / last.ns_per_tick()) as u64);
        let begin_ns = last.at(begin_ticks);
        let same = NewStretch {
            begin_ticks,
            begin_ns,
            ns_per_tick_q32: last.ns_per_tick_q32,
            ahead_ns: last.ahead_ns,
            from: None,
            interval_ns,
        };
        let rate = ns as f64 / ticks.max(1) as f64;
        let next = decide(last.ns_per_tick(), rate, off_ns as f64, interval_ns as f64);
        // After a step the clock agrees with the counter, unless that one does not keep time.
        let is_new = measured.interval_ns == FIRST_INTERVAL_NS;
        Some(match if next == Next::Step && is_new { Next::Os } else { next } {
            Next::Rate(rate) => NewStretch { ns_per_tick_q32: (rate * Q32) as u64, ..same },
            // The clock goes on from where it is: the operating system's is behind by so much more from here on.
            Next::Step if off_ns > 0 => {
                let ahead_ns = last.ahead_ns.saturating_add(off_ns);
                NewStretch { ahead_ns, from: Some(pair), interval_ns: FIRST_INTERVAL_NS, ..same }
            }
            // The counter stood still.
            Next::Step => {
                let begin_ns = begin_ns.saturating_add(off_ns.unsigned_abs());
                NewStretch { begin_ns, from: Some(pair), interval_ns: FIRST_INTERVAL_NS, ..same }
            }
            Next::Os => {
                let ahead_ns = begin_ns.cast_signed().saturating_sub((pair.os_ns + NOTICE_NS).cast_signed());
                NewStretch { ns_per_tick_q32: 0, ahead_ns: ahead_ns.max(last.ahead_ns), ..same }
            }
        })
    }

    /// Publishes a stretch.
    fn publish(&self, clock: &Clock, new: &NewStretch, pair: Pair) {
        clock.go_on(new);
        let mut measured = lock(&self.measured);
        measured.first = new.from.unwrap_or(measured.first);
        (measured.due_ns, measured.interval_ns) = (pair.os_ns + new.interval_ns, new.interval_ns);
    }
}

/// Whether a stretch begins after `pair`: it was published just now, or the counter restarted and is not used.
fn is_before(last: &Stretch, pair: Pair) -> bool {
    pair.ticks.wrapping_sub(last.begin_ticks) >= NO_END
}

/// Lead of the clock over the operating system's, in a stretch with a counter that has begun.
fn off_ns(last: &Stretch, pair: Pair) -> i64 {
    let theirs = pair.os_ns.saturating_add_signed(last.ahead_ns);
    last.at(pair.ticks).cast_signed().saturating_sub(theirs.cast_signed())
}

/// Whether an error is too large for drift.
fn is_step(last: &Stretch, pair: Pair) -> bool {
    !is_before(last, pair) && off_ns(last, pair).unsigned_abs() as f64 > MAX_ERROR_NS
}

fn keeper() -> &'static Keeper {
    KEEPER.get_or_init(|| {
        let start_ns = system_ns();
        let first = Pair::read(start_ns);
        let mut rate = 0.0;
        if is_invariant() {
            let end_ns = start_ns + FIRST_MEASUREMENT.as_nanos() as u64;
            while system_ns() < end_ns {
                std::hint::spin_loop();
            }
            let last = Pair::read(start_ns);
            rate = (last.os_ns - first.os_ns) as f64 / last.ticks.wrapping_sub(first.ticks).max(1) as f64;
        }
        let stretch = Stretch::new(first.ticks, first.os_ns, (rate * Q32) as u64, 0);
        CLOCK.newest.store(Box::leak(Box::new(stretch)), Ordering::Release);
        Keeper::new(start_ns, first)
    })
}

/// Measures the clock if a measurement is due. The watchdog calls this many times per second.
pub(crate) fn keep() {
    let keeper = keeper();
    let (gap_ticks, pair) = Pair::read_once(keeper.start_ns);
    if !keeper.is_due(&CLOCK, pair, gap_ticks) {
        return;
    }
    let pair = Pair::read(keeper.start_ns);
    if let Some(next) = keeper.next(&CLOCK, pair) {
        // A thread that was preempted until now would publish too late, so it measures again next time.
        let held_up = counter().wrapping_sub(pair.ticks) > next.begin_ticks.wrapping_sub(pair.ticks) / 2;
        if !held_up {
            keeper.publish(&CLOCK, &next, pair);
        }
    }
}

#[cold]
fn read_otherwise(at: *const Stretch, ticks: u64) -> u64 {
    let keeper = keeper();
    let os_ns = || system_ns().saturating_sub(keeper.start_ns);
    if std::ptr::eq(at, &raw const NONE) {
        return CLOCK.read_otherwise(CLOCK.newest.load(Ordering::Acquire), counter(), os_ns);
    }
    CLOCK.read_otherwise(at, ticks, os_ns)
}

/// Nanoseconds since the first call in this process, the time that the machine slept included.
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
        let stretch = Box::leak(Box::new(Stretch::new(FIRST.ticks, 0, (claimed * Q32) as u64, 0)));
        let clock = Clock { newest: AtomicPtr::new(stretch), last_ns: AtomicU64::new(0) };
        (clock, Keeper::new(0, FIRST))
    }

    fn read(clock: &Clock, pair: Pair) -> u64 {
        clock.read_otherwise(clock.newest.load(Ordering::Acquire), pair.ticks, || pair.os_ns)
    }

    const STEP_NS: u64 = 7_000_000;

    /// As [`super::keep`].
    fn keep(clock: &Clock, keeper: &Keeper, pair: Pair) {
        if keeper.is_due(clock, pair, 0)
            && let Some(next) = keeper.next(clock, pair)
        {
            keeper.publish(clock, &next, pair);
        }
    }

    /// Simulates 1,000 s in steps of 7 ms. Returns the largest error in the last 500 s and the largest step back.
    fn pass(clock: &Clock, keeper: &Keeper, ns_per_tick: impl Fn(u64) -> f64) -> (f64, u64) {
        let (mut ticks, mut before, mut worst, mut back) = (FIRST.ticks as f64, 0u64, 0.0f64, 0u64);
        for step in 1..1_000_000_000_000u64 / STEP_NS {
            let os_ns = step * STEP_NS;
            ticks += STEP_NS as f64 / ns_per_tick(os_ns);
            let pair = Pair { ticks: ticks as u64, os_ns };
            keep(clock, keeper, pair);
            let now = read(clock, pair);
            back = back.max(before.saturating_sub(now));
            before = now;
            if os_ns > 500_000_000_000 {
                worst = worst.max((now as f64 - os_ns as f64).abs());
            }
        }
        (worst, back)
    }

    /// Simulates 40 s in steps of 7 ms, at second 20 of which the counter passes `counter_ns` and the operating
    /// system's clock `os_ns` at once. Returns the smallest and the largest step of the clock, and its reading at the
    /// end.
    fn jump(counter_ns: u64, os_ns: u64) -> (u64, u64, u64) {
        let (clock, keeper) = clock(0.333);
        let (mut at_ns, mut at_os_ns) = (0, 0);
        let (mut before, mut least, mut most) = (0, u64::MAX, 0);
        for step in 1..40_000_000_000 / STEP_NS {
            let is_jump = step == 20_000_000_000 / STEP_NS;
            at_ns += if is_jump { counter_ns } else { STEP_NS };
            at_os_ns += if is_jump { os_ns } else { STEP_NS };
            let pair = Pair { ticks: FIRST.ticks + (at_ns as f64 / 0.333) as u64, os_ns: at_os_ns };
            keep(&clock, &keeper, pair);
            let now = read(&clock, pair);
            least = least.min(now - before);
            most = most.max(now - before);
            before = now;
        }
        (least, most, before)
    }

    const SLEEP_NS: u64 = 60_000_000_000;

    /// The counter runs on in a sleep or a pause that the operating system's clock does not count.
    #[test]
    fn a_clock_that_is_ahead_goes_on_at_its_rate() {
        let (least, most, end) = jump(SLEEP_NS, STEP_NS);
        assert!(least > STEP_NS * 9 / 10, "{least} ns of {STEP_NS} ns: it stands still");
        assert!((SLEEP_NS - STEP_NS..SLEEP_NS + STEP_NS).contains(&most), "{most} ns: the sleep counts");
        assert!(end.abs_diff(SLEEP_NS + 40_000_000_000) < 100_000_000, "{end}");
    }

    /// The counter stops in a sleep that the operating system's clock counts.
    #[test]
    fn a_clock_that_is_behind_steps_forward_soon() {
        let (least, most, end) = jump(STEP_NS, SLEEP_NS);
        assert!(least > STEP_NS * 9 / 10, "{least} ns of {STEP_NS} ns");
        assert!((SLEEP_NS - STEP_NS..SLEEP_NS + 2 * STEP_NS).contains(&most), "{most} ns: the sleep counts");
        assert!(end.abs_diff(SLEEP_NS + 40_000_000_000) < 100_000_000, "{end}");
    }

    /// Slewed by the system, or a counter that changes its rate: the clock takes the rate of the operating system's.
    #[test]
    fn a_clock_at_a_wrong_rate_never_stands_still() {
        for factor in [0.5, 0.9, 0.95, 1.05, 1.1, 2.0] {
            let (clock, keeper) = clock(0.333);
            let (mut ticks, mut before, mut held_ns) = (FIRST.ticks as f64, 0, 0);
            for step in 1..100_000_000_000 / STEP_NS {
                let os_ns = step * STEP_NS;
                ticks += STEP_NS as f64 / 0.333 * if os_ns < 20_000_000_000 { 1.0 } else { factor };
                let pair = Pair { ticks: ticks as u64, os_ns };
                keep(&clock, &keeper, pair);
                let now = read(&clock, pair);
                held_ns = if now > before { 0 } else { held_ns + STEP_NS };
                assert!(now >= before && held_ns <= NOTICE_NS, "{factor}: it holds {before} ns for {held_ns} ns");
                before = now;
            }
        }
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
        let stretch = Box::leak(Box::new(Stretch::new(u64::MAX / 4, 7_000, (0.333 * Q32) as u64, 0)));
        clock.newest.store(stretch, Ordering::Release);
        assert_eq!(read(&clock, Pair { ticks: 5, os_ns: 1_000_000 }), 1_000_000);
        assert_eq!(read(&clock, Pair { ticks: 6, os_ns: 900_000 }), 1_000_000, "never backwards");
    }

    #[test]
    fn the_clock_agrees_with_the_operating_system() {
        let (start_ns, start) = (now_ns(), std::time::Instant::now());
        let mut before = start_ns;
        while start.elapsed() < Duration::from_millis(400) {
            super::keep();
            let now = now_ns();
            assert!(now >= before, "monotonic");
            before = now;
        }
        let (ours, theirs) = ((now_ns() - start_ns) as f64, start.elapsed().as_nanos() as f64);
        assert!((ours - theirs).abs() < 5e6, "{ours} ns, {theirs} ns by the operating system");
    }
}
