//! Times in which the process did not run: the machine slept, or the process was stopped.

use std::collections::VecDeque;

/// Maximum lateness of a waiting thread, ns; a larger one counts as sleep.
const MAX_LATE_NS: u64 = 20_000_000;
/// Number of sleeps that are kept.
const MAX_SLEEPS: usize = 64;

/// Newest sleeps of the process, noticed by a thread that waits repeatedly.
#[derive(Debug, Default)]
pub(crate) struct Sleeps {
    /// Start and end of each in ns, oldest first.
    recent: VecDeque<(u64, u64)>,
    /// When the thread began its last wait.
    waits_since_ns: u64,
}

impl Sleeps {
    /// The thread begins to wait.
    pub fn begin_wait(&mut self, now_ns: u64) {
        self.waits_since_ns = now_ns;
    }

    /// The thread wakes up from a wait of at most `limit_ns`. Returns the excess in ns if it was a sleep, else 0.
    pub fn end_wait(&mut self, now_ns: u64, limit_ns: u64) -> u64 {
        let due_ns = self.waits_since_ns.saturating_add(limit_ns);
        let late_ns = now_ns.saturating_sub(due_ns);
        if late_ns <= MAX_LATE_NS {
            return 0;
        }
        if self.recent.len() == MAX_SLEEPS {
            self.recent.pop_front();
        }
        self.recent.push_back((due_ns, now_ns));
        late_ns
    }

    /// Time from `since_ns` to `now_ns` without the sleeps in between.
    pub fn awake_ns(&self, since_ns: u64, now_ns: u64) -> u64 {
        let slept = self.recent.iter().map(|&(start, end)| end.min(now_ns).saturating_sub(start.max(since_ns)));
        now_ns.saturating_sub(since_ns).saturating_sub(slept.sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_gets_back_the_time_that_the_process_slept() {
        let mut sleeps = Sleeps::default();
        let ms = 1_000_000;
        sleeps.begin_wait(100 * ms);
        assert_eq!(sleeps.end_wait(125 * ms, 20 * ms), 0, "a little late");
        sleeps.begin_wait(125 * ms);
        assert_eq!(sleeps.end_wait(4_145 * ms, 20 * ms), 4_000 * ms);
        assert_eq!(sleeps.awake_ns(120 * ms, 4_150 * ms), 30 * ms, "it began before the sleep");
        assert_eq!(sleeps.awake_ns(1_145 * ms, 4_150 * ms), 5 * ms, "inside");
        assert_eq!(sleeps.awake_ns(4_146 * ms, 4_150 * ms), 4 * ms, "after it");
        assert_eq!(sleeps.awake_ns(10 * ms, 100 * ms), 90 * ms, "all before it");
        // Each of many sleeps counts.
        for round in 2..10u64 {
            sleeps.begin_wait(round * 10_000 * ms);
            assert_eq!(sleeps.end_wait(round * 10_000 * ms + 1_000 * ms, 0), 1_000 * ms);
        }
        assert_eq!(sleeps.awake_ns(20_000 * ms, 100_000 * ms), 72_000 * ms);
    }
}
