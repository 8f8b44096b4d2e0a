//! At which ticks a node with `max_rate_hz` is called.

/// Ticks of a source at 60 Hz, for which the calls of nodes with a rate are laid on different ticks.
const TICK_NS: i64 = 1_000_000_000 / 60;
/// Ticks of the timetable of [`phase_ns`]: two seconds.
const TABLE: usize = 120;

/// The period of a rate, ns.
pub(crate) fn period_ns(hz: f64) -> i64 {
    (1e9 / hz) as i64
}

/// Capture time of a call of a node, ns, which its other calls are whole periods away from. `periods_ns` are those of all nodes of the graph that have
/// a rate, in order, up to this one. Each node takes the ticks on which the fewest of those before it run: their work together would hold up
/// the ticks that have it all. The calls are due between two ticks, so that a camera whose ticks come a little early or late loses none.
pub(crate) fn phase_ns(periods_ns: &[i64]) -> i64 {
    let mut taken = [0_u32; TABLE];
    let mut phase_ns = 0;
    for &period_ns in periods_ns.iter().filter(|period_ns| **period_ns > 0) {
        let ticks = |first: usize| {
            let after = move |call: i64| usize::try_from((call * period_ns + TICK_NS / 2) / TICK_NS).unwrap_or(TABLE);
            (0..).map(move |call| first + after(call)).take_while(|tick| *tick < TABLE)
        };
        let slots = (period_ns / TICK_NS).clamp(1, TABLE as i64) as usize;
        let busy = |first: &usize| ticks(*first).map(|tick| taken[tick]).sum::<u32>();
        let first = (0..slots).min_by_key(busy).unwrap_or(0);
        ticks(first).for_each(|tick| taken[tick] += 1);
        phase_ns = first as i64 * TICK_NS - period_ns.min(TICK_NS) / 2;
    }
    phase_ns
}

/// A grid of due times, in capture time. A call after its due time moves no later one, so that a rate that a source's does not divide, or a
/// camera whose ticks come a little early or late, keeps the mean.
pub(crate) struct Rate {
    /// Between two due times, ns; 0 where every tick is due.
    period_ns: i64,
    /// See [`phase_ns`]; `None` for periods that begin with the first call.
    phase_ns: Option<i64>,
    /// The last tick that was run, `i64::MIN` for none.
    last_ns: i64,
    due_ns: i64,
    /// Inputs that were not empty in a tick since the last one that was run, one bit each.
    seen: u64,
}

impl Rate {
    /// No limit.
    pub const NONE: Self = Self { period_ns: 0, phase_ns: None, last_ns: i64::MIN, due_ns: i64::MIN, seen: 0 };

    /// Sets the period, 0 for none, and the phase.
    pub fn set(&mut self, period_ns: i64, phase_ns: Option<i64>) {
        if period_ns == self.period_ns {
            return;
        }
        (self.period_ns, self.phase_ns) = (period_ns, phase_ns);
        self.due_ns = self.last_ns.saturating_add(period_ns);
    }

    /// Whether there is a limit.
    pub fn is_limited(&self) -> bool {
        self.period_ns > 0
    }

    /// Whether a tick is due; `present` are its inputs that are not empty. A tick without an input that has come since the last call waits for one
    /// with it, for another period at most: inputs at two rates might else never come together.
    #[cold]
    pub fn is_due(&mut self, at_ns: i64, present: u64) -> bool {
        self.seen |= present;
        let wait_ns = if present == self.seen { 0 } else { self.period_ns };
        // After a step back in capture time a node runs at once instead of waiting for the old time.
        at_ns < self.last_ns || self.last_ns == i64::MIN || at_ns >= self.due_ns.saturating_add(wait_ns)
    }

    /// A tick is run.
    #[cold]
    pub fn run(&mut self, at_ns: i64) {
        let late_ns = at_ns.saturating_sub(self.due_ns);
        self.due_ns = match self.last_ns {
            i64::MIN => self.first_due_ns(at_ns),
            _ if (0..self.period_ns).contains(&late_ns) => self.due_ns.saturating_add(self.period_ns),
            _ => self.first_due_ns(at_ns),
        };
        (self.last_ns, self.seen) = (at_ns, 0);
    }

    /// The due time after a call that begins the grid: half a period to one and a half later, with a phase.
    fn first_due_ns(&self, at_ns: i64) -> i64 {
        let Some(phase_ns) = self.phase_ns.filter(|_| self.is_limited()) else {
            return at_ns.saturating_add(self.period_ns);
        };
        let after_ns = phase_ns.saturating_sub(at_ns).rem_euclid(self.period_ns);
        let is_soon = after_ns < self.period_ns / 2;
        at_ns.saturating_add(after_ns).saturating_add(if is_soon { self.period_ns } else { 0 })
    }
}

#[cfg(test)]
mod tests {
    use panoscope_base::random::SplitMix64;

    use super::*;

    /// The ticks at which a node is called, of a source with these capture times.
    fn calls(rate: &mut Rate, capture_ns: impl IntoIterator<Item = i64>) -> Vec<usize> {
        let mut called = |(tick, at_ns): (usize, i64)| {
            let is_due = rate.is_due(at_ns, 1);
            is_due.then(|| rate.run(at_ns)).map(|()| tick)
        };
        capture_ns.into_iter().enumerate().filter_map(&mut called).collect()
    }

    fn limited(hz: f64, phase_ns: Option<i64>) -> Rate {
        let mut rate = Rate::NONE;
        rate.set(period_ns(hz), phase_ns);
        rate
    }

    /// The rates of nodes in the order of their graph.
    fn together(hz: &[f64]) -> Vec<Rate> {
        let periods: Vec<i64> = hz.iter().map(|hz| period_ns(*hz)).collect();
        (0..hz.len()).map(|node| limited(hz[node], Some(phase_ns(&periods[..=node])))).collect()
    }

    fn at_hz(hz: f64, count: i64) -> impl Iterator<Item = i64> {
        (0..count).map(move |tick| (tick as f64 * 1e9 / hz).round() as i64)
    }

    #[test]
    fn a_rate_that_divides_the_source_takes_every_nth_tick() {
        let of = |hz: f64, source_hz: f64, count| calls(&mut together(&[hz])[0], at_hz(source_hz, count));
        assert_eq!(of(15.0, 60.0, 13), [0, 4, 8, 12]);
        assert_eq!(of(15.0, 30.0, 7), [0, 2, 4, 6]);
        assert_eq!(of(60.0, 30.0, 4), [0, 1, 2, 3], "a source that is slower");
        assert_eq!(of(200.0, 200.0, 4), [0, 1, 2, 3]);
    }

    /// Calls a full period apart gave 12.5 of 15 calls a second from a source at 25.
    #[test]
    fn a_rate_that_does_not_divide_the_source_is_met_on_average() {
        let calls_of = |hz: f64, capture: Vec<i64>| calls(&mut together(&[hz])[0], capture).len();
        assert_eq!(calls_of(15.0, at_hz(25.0, 250).collect()), 150);
        let mut random = SplitMix64(7);
        let shaken: Vec<i64> = at_hz(60.0, 600).map(|ns| ns + random.below(2_000_000) as i64 - 1_000_000).collect();
        assert!((149..=150).contains(&calls_of(15.0, shaken)));
    }

    /// Phases by multiples of the golden ratio put the first and the fourth of the surgeon's nodes on the same ticks.
    #[test]
    fn nodes_run_at_different_ticks_after_the_first() {
        let mut random = SplitMix64(3);
        let shaken: Vec<i64> = at_hz(60.0, 600).map(|ns| ns + random.below(8_000_000) as i64 - 4_000_000).collect();
        let mut rates = together(&[15.0, 10.0, 10.0, 15.0]);
        // The inputs of each come a tick later than those of the node before.
        let from = |node: usize| shaken.iter().copied().enumerate().skip(node);
        let calls_from = |(node, rate): (usize, &mut Rate)| {
            let called = from(node).filter(|(_, at_ns)| {
                rate.is_due(*at_ns, 1) && {
                    rate.run(*at_ns);
                    true
                }
            });
            called.map(|(tick, _)| tick).collect::<Vec<_>>()
        };
        let all: Vec<Vec<usize>> = rates.iter_mut().enumerate().map(calls_from).collect();
        let mut ticks: Vec<usize> = all.iter().flatten().copied().filter(|tick| *tick > 3).collect();
        let count = ticks.len();
        ticks.sort_unstable();
        ticks.dedup();
        assert_eq!(ticks.len(), count, "{all:?}");
        assert!(all.iter().zip([150, 100, 100, 150]).all(|(of, wanted)| of.len().abs_diff(wanted) <= 1), "{count}");
        let many = together(&[15.0; 9]).iter_mut().map(|rate| calls(rate, at_hz(60.0, 8))).collect::<Vec<_>>();
        let at = |tick: usize| many.iter().filter(|of| of.contains(&tick)).count();
        assert_eq!([4, 5, 6, 7].map(at), [3, 2, 2, 2], "no tick has all the work");
    }

    #[test]
    fn a_step_back_a_gap_and_another_rate_start_the_grid_again() {
        let mut rate = limited(10.0, None);
        let ms = |ms: i64| ms * 1_000_000;
        assert_eq!(calls(&mut rate, [ms(5000), ms(5050), ms(4000), ms(4050), ms(4100)]), [0, 2, 4]);
        assert_eq!(calls(&mut rate, [ms(4550), ms(4600), ms(4650)]), [0, 2], "a gap of several periods");
        rate.set(ms(50), None);
        assert_eq!(calls(&mut rate, [ms(4690), ms(4700), ms(4750)]), [1, 2]);
        rate.set(0, Some(0));
        assert!(!rate.is_limited());
        assert_eq!(calls(&mut rate, [ms(4800), ms(4800), ms(4801)]), [0, 1, 2]);
    }
}
