//! The offset of another machine's clock, from round-trip probes.
//!
//! Each probe bounds the offset: the other clock was read at some moment between sending and receiving (Cristian's
//! method). The probe with the shortest round trip bounds it best; an older one bounds it less, because clocks drift.
//! So the best of the last probes is used, each with an allowance for its age, as NTP's clock filter does.

use std::collections::VecDeque;

/// Number of probes that are kept.
const PROBES: usize = 64;
/// Largest drift of two clocks against each other: 100 ppm.
const DRIFT: i64 = 10_000;

#[derive(Clone, Copy, Debug)]
struct Probe {
    at_ns: i64,
    offset_ns: i64,
    half_way_ns: i64,
}

/// The offset of another clock.
#[derive(Clone, Debug, Default)]
pub struct Offset {
    probes: VecDeque<Probe>,
    round_trip_ns: u64,
}

impl Offset {
    /// Adds a probe that was sent at `sent_ns` and answered at `received_ns`, both of this machine's clock, when the
    /// other clock showed `there_ns`.
    pub fn add(&mut self, sent_ns: i64, there_ns: i64, received_ns: i64) {
        let round_trip_ns = received_ns.saturating_sub(sent_ns);
        if round_trip_ns < 0 {
            return;
        }
        if self.probes.len() == PROBES {
            self.probes.pop_front();
        }
        self.round_trip_ns = round_trip_ns.unsigned_abs();
        let half_way_ns = round_trip_ns / 2;
        let offset_ns = there_ns.saturating_sub(sent_ns.saturating_add(half_way_ns));
        self.probes.push_back(Probe { at_ns: received_ns, offset_ns, half_way_ns });
    }

    /// Adds the answer to a probe, written by [`crate::network::answer_probe`] and received at `received_ns`; `None` if
    /// it is malformed.
    pub fn take_answer(&mut self, bytes: &[u8], received_ns: i64) -> Option<()> {
        let (sent, rest) = bytes.split_first_chunk::<8>()?;
        let there = rest.first_chunk::<8>()?;
        self.add(i64::from_le_bytes(*sent), i64::from_le_bytes(*there), received_ns);
        Some(())
    }

    /// The other clock minus this one, and the maximum error of that, in ns; `None` without a probe.
    pub fn at(&self, now_ns: i64) -> Option<(i64, u64)> {
        let error_ns = |probe: &Probe| {
            let age_ns = now_ns.saturating_sub(probe.at_ns).max(0);
            probe.half_way_ns.saturating_add(age_ns / DRIFT).saturating_add(1)
        };
        let best = self.probes.iter().min_by_key(|probe| error_ns(probe))?;
        Some((best.offset_ns, error_ns(best).unsigned_abs()))
    }

    /// Round-trip time of the last probe, ns.
    pub fn round_trip_ns(&self) -> u64 {
        self.round_trip_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A generator of delays that needs no crate.
    fn delays(mut state: u64) -> impl FnMut(i64) -> i64 {
        move |most| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as i64 % most
        }
    }

    #[test]
    fn the_offset_lies_within_its_error_whatever_the_delays() {
        for seed in 0..200 {
            let mut delay = delays(seed);
            let truth_ns = delay(1 << 30) - (1 << 29);
            let mut offset = Offset::default();
            let mut now_ns = 1_000_000_000;
            assert_eq!(offset.at(now_ns), None);
            for _ in 0..200 {
                // One way may take a hundred times as long as the other.
                let (there_ns, back_ns) = (20_000 + delay(20_000_000), 20_000 + delay(200_000));
                offset.add(now_ns, now_ns + there_ns + truth_ns, now_ns + there_ns + back_ns);
                now_ns += there_ns + back_ns + 100_000_000;
                let (found_ns, error_ns) = offset.at(now_ns).expect("a probe");
                assert!(
                    found_ns.abs_diff(truth_ns) <= error_ns,
                    "seed {seed}: {found_ns} is not {truth_ns} +- {error_ns}"
                );
            }
            let (_, error_ns) = offset.at(now_ns).expect("a probe");
            assert!(error_ns < 2_000_000, "the best of 64 probes is far better than their mean: {error_ns}");
        }
    }

    #[test]
    fn clocks_that_drift_stay_within_the_error() {
        let mut offset = Offset::default();
        // 50 ppm.
        let truth_ns = |now_ns: i64| 7_000_000 + now_ns / 20_000;
        let mut now_ns = 0;
        for round in 0..1_000 {
            let way_ns = if round % 50 == 0 { 50_000 } else { 5_000_000 };
            offset.add(now_ns, now_ns + way_ns + truth_ns(now_ns + way_ns), now_ns + 2 * way_ns);
            now_ns += 200_000_000;
            let (found_ns, error_ns) = offset.at(now_ns).expect("a probe");
            assert!(found_ns.abs_diff(truth_ns(now_ns)) <= error_ns);
        }
    }

    #[test]
    fn an_answer_before_its_question_is_ignored() {
        let mut offset = Offset::default();
        offset.add(10, 5, 9);
        assert_eq!(offset.at(20), None);
    }
}
