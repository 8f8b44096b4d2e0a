//! Time of a message: its stamp, or the time at which it was recorded if the stamp is implausible.

use std::collections::HashMap;

/// Messages of a topic may overtake each other by this much. A larger step back is a clock that was set, or a simulation that restarted.
const MAX_REORDER_NS: i64 = 100_000_000;

/// Newest stamp and recording time of a topic.
#[derive(Clone, Copy, Debug)]
struct Last {
    stamp_ns: i64,
    log_ns: i64,
}

/// Times of the messages of all topics.
#[derive(Debug, Default)]
pub struct Times {
    last: HashMap<String, Last>,
    /// Whether stamps are no longer used.
    uses_log: bool,
    /// Added to stamps, so that time does not step back with them.
    offset_ns: i64,
}

impl Times {
    /// Time of a message from its stamp and recording time, and a warning, once for each cause.
    pub fn of(&mut self, topic: &str, stamp_ns: i64, log_ns: i64) -> (i64, Option<String>) {
        let mut remark = None;
        if stamp_ns == 0 && !self.uses_log {
            self.uses_log = true;
            remark =
                Some(format!("messages of `{topic}` have no timestamp: the recording times are used for all topics"));
        }
        if self.uses_log {
            return (log_ns, remark);
        }
        let last = self.last.insert(topic.to_owned(), Last { stamp_ns, log_ns });
        if let Some(last) = last.filter(|last| stamp_ns < last.stamp_ns.saturating_sub(MAX_REORDER_NS)) {
            let back_ms = (last.stamp_ns.saturating_sub(stamp_ns)) as f64 / 1e6;
            // All topics have one clock: the others have stepped back too, or will with their next message.
            let since_ns = log_ns.saturating_sub(last.log_ns).max(1);
            let before_ns = last.stamp_ns.saturating_add(self.offset_ns);
            self.offset_ns = before_ns.saturating_add(since_ns).saturating_sub(stamp_ns);
            self.last.retain(|other, _| other == topic);
            remark = Some(format!(
                "the timestamps of `{topic}` step back by {back_ms:.0} ms: they continue by the recording times"
            ));
        }
        (stamp_ns.saturating_add(self.offset_ns), remark)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn stamps_are_the_time_while_they_can_be() {
        let mut times = Times::default();
        assert_eq!(times.of("/l", 100 * MS, 900 * MS), (100 * MS, None));
        assert_eq!(times.of("/r", 90 * MS, 901 * MS), (90 * MS, None));
        // Overtaken on the network.
        assert_eq!(times.of("/l", 70 * MS, 933 * MS), (70 * MS, None));
    }

    #[test]
    fn messages_without_a_time_have_that_of_the_recording() {
        let mut times = Times::default();
        let (first, remark) = times.of("/l", 0, 900 * MS);
        assert!(first == 900 * MS && remark.is_some_and(|words| words.contains("`/l` have no timestamp")));
        assert_eq!(times.of("/r", 17 * MS, 901 * MS), (901 * MS, None));
    }

    #[test]
    fn a_clock_that_is_set_back_does_not_stop_time() {
        let mut times = Times::default();
        for (topic, stamp) in [("/l", 5000), ("/r", 5001), ("/l", 5033), ("/r", 5034)] {
            assert_eq!(times.of(topic, stamp * MS, (stamp + 100) * MS), (stamp * MS, None));
        }
        let (time, remark) = times.of("/l", 10 * MS, 5166 * MS);
        assert!(time == 5066 * MS && remark.is_some_and(|words| words.contains("step back by 5023 ms")));
        assert_eq!(times.of("/r", 11 * MS, 5167 * MS), (5067 * MS, None));
        assert_eq!(times.of("/l", 43 * MS, 5200 * MS), (5099 * MS, None));
    }
}
