//! Simulates the recorded calls of a run on a machine with another number of cores.
//!
//! A call starts when the calls of its tick that it waits for and its node's previous call have ended and a core is
//! free; the oldest tick goes first, then the order of the graph. A source starts a tick while fewer ticks than a limit
//! are in flight. Two things are left out: a call is not divided among cores, which several nodes do, so that the
//! answer is a lower bound; and memory is as fast for many cores as for one.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap, HashMap};

use super::{Calls, Waits};

/// A call.
#[derive(Clone, Debug)]
struct Job {
    tick: usize,
    node: usize,
    work_ns: u64,
    /// Number of calls that must end before it starts.
    needs: usize,
    /// Calls that wait for it.
    readers: Vec<usize>,
}

/// Calls of complete ticks, each with the calls that it waits for.
#[derive(Clone, Debug, Default)]
pub struct Recorded {
    jobs: Vec<Job>,
    /// First call of each tick, that of its source.
    sources: Vec<usize>,
    nodes: Vec<String>,
}

impl Recorded {
    /// The ticks of the busiest source whose calls are all in the timeline; `None` if there are fewer than two.
    pub fn of(calls: &Calls, waits: &Waits) -> Option<Self> {
        let positions: Vec<Option<usize>> = calls.nodes.iter().map(|node| waits.position(node)).collect();
        let producers = waits.producers();
        let mut per_source: HashMap<u32, usize> = HashMap::new();
        for call in &calls.calls {
            *per_source.entry(call.source).or_default() += 1;
        }
        let source = *per_source.iter().max_by_key(|(source, count)| (**count, Reverse(**source)))?.0;
        let mut by_tick: HashMap<u64, HashMap<usize, u64>> = HashMap::new();
        for call in calls.calls.iter().filter(|call| call.made && call.source == source) {
            if let Some(node) = positions[call.node as usize] {
                by_tick.entry(call.seq).or_default().insert(node, call.end_ns.saturating_sub(call.start_ns));
            }
        }
        let mut ticks: Vec<u64> = by_tick.keys().copied().collect();
        ticks.sort_unstable();
        let mut found = Self { nodes: waits.names(), ..Self::default() };
        let mut last_of_node: HashMap<usize, usize> = HashMap::new();
        for seq in ticks {
            let of_tick = &by_tick[&seq];
            let mut nodes: Vec<usize> = of_tick.keys().copied().collect();
            nodes.sort_unstable();
            // A tick whose begin was lost has no call of its source.
            if nodes.first().is_none_or(|first| !producers[*first].is_empty()) {
                continue;
            }
            let (tick, mut at) = (found.sources.len(), HashMap::new());
            for node in nodes {
                let number = found.jobs.len();
                let of_same_tick = producers[node].iter().filter_map(|from| at.get(from).copied());
                let before: Vec<usize> = of_same_tick.chain(last_of_node.insert(node, number)).collect();
                found.jobs.push(Job { tick, node, work_ns: of_tick[&node], needs: before.len(), readers: Vec::new() });
                before.iter().for_each(|from| found.jobs[*from].readers.push(number));
                if at.is_empty() {
                    found.sources.push(number);
                }
                at.insert(node, number);
            }
        }
        (found.sources.len() > 1).then_some(found)
    }

    /// Frames per second on `cores` cores with at most `in_flight` ticks between source and sinks.
    pub fn pictures_per_s(&self, cores: usize, in_flight: usize) -> f64 {
        let (cores, in_flight) = (cores.max(1), in_flight.max(1));
        let mut needs: Vec<usize> = self.jobs.iter().map(|job| job.needs).collect();
        let mut left = vec![0usize; self.sources.len()];
        self.jobs.iter().for_each(|job| left[job.tick] += 1);
        // The tick that has to be over before a source starts counts as one call more.
        self.sources.iter().skip(in_flight).for_each(|source| needs[*source] += 1);
        let mut ready: BTreeSet<(usize, usize, usize)> = BTreeSet::new();
        let key = |job: usize| (self.jobs[job].tick, self.jobs[job].node, job);
        ready.extend((0..self.jobs.len()).filter(|job| needs[*job] == 0).map(key));
        let mut running: BinaryHeap<Reverse<(u64, usize)>> = BinaryHeap::new();
        let (mut now, mut begun_ns) = (0u64, 0u64);
        // The first tenth fills the graph.
        let counted_from = self.sources.len() / 10;
        let free = |needs: &mut Vec<usize>, ready: &mut BTreeSet<_>, job: usize| {
            needs[job] -= 1;
            if needs[job] == 0 {
                ready.insert(key(job));
            }
        };
        loop {
            while running.len() < cores {
                let Some((.., job)) = ready.pop_first() else { break };
                running.push(Reverse((now + self.jobs[job].work_ns, job)));
            }
            let Some(Reverse((end, job))) = running.pop() else { break };
            now = end;
            self.jobs[job].readers.iter().for_each(|reader| free(&mut needs, &mut ready, *reader));
            let tick = self.jobs[job].tick;
            left[tick] -= 1;
            if left[tick] == 0 {
                if let Some(source) = self.sources.get(tick + in_flight) {
                    free(&mut needs, &mut ready, *source);
                }
                if tick < counted_from {
                    begun_ns = begun_ns.max(now);
                }
            }
        }
        (self.sources.len() - counted_from) as f64 / ((now - begun_ns).max(1) as f64 / 1e9)
    }

    /// Mean work of all calls of a tick, ms.
    pub fn work_ms(&self) -> f64 {
        self.jobs.iter().map(|job| job.work_ns).sum::<u64>() as f64 / 1e6 / self.sources.len() as f64
    }

    /// The node with the most work, and its work per tick, ms: no number of cores can exceed that node's own rate.
    pub fn busiest(&self) -> Option<(&str, f64)> {
        let mut sums = vec![0u64; self.nodes.len()];
        self.jobs.iter().for_each(|job| sums[job.node] += job.work_ns);
        let (node, sum) = sums.iter().enumerate().max_by_key(|(_, sum)| **sum)?;
        Some((&self.nodes[node], *sum as f64 / 1e6 / self.sources.len() as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Timeline;
    use super::super::tests::enter;
    use super::*;

    /// Ticks of `nodes`, each with those that it waits for; every call takes 10 ms.
    fn recorded(ticks: u64, nodes: &[(&str, &[&str])]) -> Recorded {
        let timeline = Timeline::default();
        for seq in 0..ticks {
            for (place, (name, _)) in nodes.iter().enumerate() {
                let start = (seq * nodes.len() as u64 + place as u64) * 10;
                enter(&timeline, name, seq, start, start + 10);
            }
        }
        Recorded::of(&timeline.snapshot(), &Waits::between(nodes)).expect("ticks")
    }

    fn near(found: f64, wanted: f64) {
        assert!((found / wanted - 1.0).abs() < 0.02, "{found} instead of {wanted}");
    }

    #[test]
    fn a_chain_is_as_fast_as_its_cores_or_its_longest_node() {
        let chain = recorded(400, &[("source", &[]), ("a", &["source"]), ("b", &["a"])]);
        near(chain.pictures_per_s(1, 8), 100.0 / 3.0);
        near(chain.pictures_per_s(2, 8), 200.0 / 3.0);
        near(chain.pictures_per_s(3, 8), 100.0);
        near(chain.pictures_per_s(16, 8), 100.0);
        near(chain.pictures_per_s(16, 1), 100.0 / 3.0);
        near(chain.work_ms(), 30.0);
    }

    #[test]
    fn branches_run_side_by_side() {
        let fan = recorded(400, &[("source", &[]), ("a", &["source"]), ("b", &["source"]), ("c", &["source"])]);
        near(fan.pictures_per_s(1, 1), 25.0);
        near(fan.pictures_per_s(3, 1), 50.0);
        assert_eq!(fan.busiest().map(|(_, ms)| ms.round()), Some(10.0));
    }

    #[test]
    fn a_node_that_skips_ticks_costs_less() {
        let timeline = Timeline::default();
        for seq in 0..100 {
            enter(&timeline, "source", seq, 0, 10);
            if seq % 2 == 0 {
                enter(&timeline, "slow", seq, 10, 30);
            }
        }
        let waits = Waits::between(&[("source", &[]), ("slow", &["source"])]);
        let found = Recorded::of(&timeline.snapshot(), &waits).expect("ticks");
        near(found.work_ms(), 20.0);
        near(found.pictures_per_s(1, 4), 50.0);
        near(found.pictures_per_s(2, 4), 100.0);
    }

    #[test]
    fn a_timeline_without_ticks_gives_nothing() {
        assert!(Recorded::of(&Timeline::default().snapshot(), &Waits::between(&[("source", &[])])).is_none());
    }
}
