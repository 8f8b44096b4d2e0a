//! At which ticks a node with `max_rate_hz` is called.

/// Share of a period by which the calls of one node follow those of the node before it in the graph: multiples of the golden ratio spread over
/// a period however many nodes there are.
const PHASE: f64 = 0.618_033_988_749_895;

/// A grid of due times, in capture time. A call after its due time moves no later one, so that a rate that a source's does not divide, or a
/// camera whose ticks come a little early or late, keeps the mean.
pub(crate) struct Rate {
    /// Between two due times, ns; 0 where every tick is due.
    period_ns: i64,
    /// From the first call to its successor, ns more than a period.
    phase_ns: i64,
    /// The last tick that was run, `i64::MIN` for none.
    last_ns: i64,
    due_ns: i64,
    /// Inputs that were not empty in a tick since the last one that was run, one bit each.
    seen: u64,
}

impl Rate {
    /// No limit.
    pub const NONE: Self = Self { period_ns: 0, phase_ns: 0, last_ns: i64::MIN, due_ns: i64::MIN, seen: 0 };

    /// Sets the period, 0 for none. Nodes with a limit, `number` of which come first in the graph, run at the same tick once, the first, and from
    /// then on apart if they are `spread`: their work together would hold up the ticks that have it all.
    pub fn set(&mut self, period_ns: i64, number: u32, spread: bool) {
        if period_ns == self.period_ns {
            return;
        }
        let phase = if spread { (f64::from(number) * PHASE).fract() } else { 0.0 };
        (self.period_ns, self.phase_ns) = (period_ns, (period_ns as f64 * phase) as i64);
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
            i64::MIN => at_ns.saturating_add(self.period_ns).saturating_add(self.phase_ns),
            _ if (0..self.period_ns).contains(&late_ns) => self.due_ns.saturating_add(self.period_ns),
            _ => at_ns.saturating_add(self.period_ns),
        };
        (self.last_ns, self.seen) = (at_ns, 0);
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

    fn limited(hz: f64, number: u32, spread: bool) -> Rate {
        let mut rate = Rate::NONE;
        rate.set((1e9 / hz) as i64, number, spread);
        rate
    }

    fn at_hz(hz: f64, count: i64) -> impl Iterator<Item = i64> {
        (0..count).map(move |tick| (tick as f64 * 1e9 / hz).round() as i64)
    }

    #[test]
    fn a_rate_that_divides_the_source_takes_every_nth_tick() {
        assert_eq!(calls(&mut limited(15.0, 0, true), at_hz(60.0, 13)), [0, 4, 8, 12]);
        assert_eq!(calls(&mut limited(60.0, 0, true), at_hz(30.0, 4)), [0, 1, 2, 3], "a source that is slower");
    }

    /// Calls a full period apart gave 12.5 of 15 calls a second from a source at 25.
    #[test]
    fn a_rate_that_does_not_divide_the_source_is_met_on_average() {
        let calls_of = |hz: f64, capture: Vec<i64>| calls(&mut limited(hz, 0, true), capture).len();
        assert_eq!(calls_of(15.0, at_hz(25.0, 250).collect()), 150);
        let mut random = SplitMix64(7);
        let shaken: Vec<i64> = at_hz(60.0, 600).map(|ns| ns + random.below(2_000_000) as i64 - 1_000_000).collect();
        assert!((149..=150).contains(&calls_of(15.0, shaken)));
    }

    #[test]
    fn nodes_of_one_rate_run_at_different_ticks_after_the_first() {
        let of = |number, spread| calls(&mut limited(15.0, number, spread), at_hz(60.0, 40));
        let (first, second) = (of(0, true), of(1, true));
        assert_eq!(first.iter().filter(|tick| second.contains(tick)).collect::<Vec<_>>(), [&0]);
        assert_eq!((first.len(), second.len()), (10, 10));
        assert_eq!(of(0, false), of(1, false), "in batch nothing is held up");
    }

    #[test]
    fn a_step_back_a_gap_and_another_rate_start_the_grid_again() {
        let mut rate = limited(10.0, 0, true);
        let ms = |ms: i64| ms * 1_000_000;
        assert_eq!(calls(&mut rate, [ms(5000), ms(5050), ms(4000), ms(4050), ms(4100)]), [0, 2, 4]);
        assert_eq!(calls(&mut rate, [ms(4550), ms(4600), ms(4650)]), [0, 2], "a gap of several periods");
        rate.set(ms(50), 0, true);
        assert_eq!(calls(&mut rate, [ms(4690), ms(4700), ms(4750)]), [1, 2]);
        rate.set(0, 0, true);
        assert!(!rate.is_limited());
    }
}
