use super::*;
use crate::light::{Lag, Sources};
use crate::memory::memory;
use panoscope_abi::Frame;

/// Ticks arrive at their capture time.
struct ByCapture;

impl Sources for ByCapture {
    fn arrived_ns(&self, tick: &Tick) -> Option<i64> {
        Some(tick.capture_ns)
    }

    fn is_constant(&self, _: &Tick) -> bool {
        false
    }

    fn is_forgotten(&self, _: &Tick) -> bool {
        false
    }
}

fn lit_at(now_ns: u64) -> Lights<'static> {
    Lights { sources: &ByCapture, by_capture: false, now_ns }
}

fn packet(seq: u64) -> FrameRef {
    let (buffer, data) = memory().allocate(16).expect("memory");
    let tick = Tick { source: 0, flags: 0, seq, capture_ns: seq as i64 * 10 };
    // SAFETY: the one reference of a new buffer.
    unsafe { FrameRef::adopt(Frame { buffer, data, len: 16, tick, ..Frame::EMPTY }) }
}

fn seq(frame: &FrameRef) -> Option<u64> {
    (!frame.is_empty()).then(|| frame.tick().seq)
}

fn fired(take: Take) -> Option<(u64, bool)> {
    match take {
        Take::Fire { tick, complete } => Some((tick.seq, complete)),
        _ => None,
    }
}

#[test]
fn exact_slots_wait_for_each_other() {
    let slots = vec![Slot::new(Rule::Exact, false, 1), Slot::new(Rule::Exact, false, 1)];
    let mut join = Join::new(slots, false);
    join.push(0, packet(0));
    assert_eq!(join.try_take(None, &lit_at(0)), Take::Wait);
    join.push(1, FrameRef::empty(Tick::default()));
    assert_eq!(fired(join.try_take(None, &lit_at(0))), Some((0, false)), "an empty required input skips the node");
    join.end(0);
    join.end(1);
    assert_eq!(join.try_take(None, &lit_at(0)), Take::Finished);
}

#[test]
fn delay_gives_the_previous_tick() {
    let slots = vec![Slot::new(Rule::Exact, false, 1), Slot::new(Rule::Delay, true, 1)];
    let mut join = Join::new(slots, true);
    join.push(0, packet(0));
    join.push(0, packet(1));
    join.push(0, packet(2));
    assert_eq!(fired(join.try_take(None, &lit_at(0))), Some((0, true)));
    assert_eq!(seq(&join.staged[1]), None, "nothing on the first tick");
    assert_eq!(join.try_take(None, &lit_at(0)), Take::Wait, "waits for the producer's tick 0");
    join.push(1, packet(0));
    assert_eq!(fired(join.try_take(None, &lit_at(0))), Some((1, true)));
    assert_eq!(seq(&join.staged[1]), Some(0));
    join.push(1, FrameRef::empty(Tick { seq: 1, ..Tick::default() }));
    assert_eq!(fired(join.try_take(None, &lit_at(0))), Some((2, true)));
    assert_eq!(seq(&join.staged[1]), Some(0), "an empty one leaves the last value");
}

#[test]
fn batch_latest_waits_for_the_newest_not_after_the_tick() {
    let slots = vec![Slot::new(Rule::Exact, false, 1), Slot::new(Rule::Latest { trigger: false }, true, 1)];
    let mut join = Join::new(slots, true);
    join.push(0, packet(5));
    join.push(1, packet(3));
    assert_eq!(join.try_take(None, &lit_at(0)), Take::Wait, "a newer one may still come");
    join.push(1, packet(4));
    join.push(1, packet(6));
    assert_eq!(fired(join.try_take(None, &lit_at(0))), Some((5, true)));
    assert_eq!(seq(&join.staged[1]), Some(4));
}

#[test]
fn live_latest_overwrites_and_counts() {
    let mut join = Join::new(vec![Slot::new(Rule::Latest { trigger: true }, false, 1)], false);
    assert_eq!(join.push(0, packet(0)), 0);
    assert_eq!(join.push(0, packet(1)), 1);
    assert_eq!(fired(join.try_take(None, &lit_at(0))), Some((1, true)));
    assert_eq!(join.try_take(None, &lit_at(0)), Take::Wait, "one arrival fires once");
}

#[test]
fn nearest_takes_the_closest_or_nothing() {
    let nearest = Rule::Nearest { tolerance_ns: 12 };
    let room = Slot::usual_capacity(nearest);
    let mut join = Join::new(vec![Slot::new(Rule::Exact, false, 1), Slot::new(nearest, true, room)], false);
    join.push(0, packet(5));
    assert_eq!(join.try_take(None, &lit_at(100)), Take::Wait);
    join.push(1, packet(4));
    join.push(1, packet(7));
    assert_eq!(fired(join.try_take(None, &lit_at(101))), Some((5, true)));
    assert_eq!(seq(&join.staged[1]), Some(4));
    join.push(0, packet(20));
    assert_eq!(join.try_take(None, &lit_at(200)), Take::Wait);
    assert_eq!(fired(join.try_take(None, &lit_at(212))), Some((20, true)), "the wait has an end");
    assert_eq!(seq(&join.staged[1]), None);
}

#[test]
fn nearest_and_delay_take_no_more_than_fit_and_count_what_goes() {
    for rule in [Rule::Nearest { tolerance_ns: 12 }, Rule::Delay] {
        let mut join = Join::new(vec![Slot::new(Rule::Exact, false, 1), Slot::new(rule, true, 4)], false);
        let dropped: u64 = (0..1_000).map(|seq| join.push(1, packet(seq))).sum();
        assert_eq!((join.waiting(1), dropped, join.slots[1].dropped()), (4, 996, 996), "{rule:?}");
        join.push(0, packet(997));
        join.push(1, packet(1_000));
        assert_eq!(fired(join.try_take(None, &lit_at(0))), Some((997, true)));
        if rule != Rule::Delay {
            assert_eq!(seq(&join.staged[1]), Some(997), "the newest are kept");
        }
    }
    // In batch nothing is lost.
    let slots = vec![Slot::new(Rule::Exact, false, 1), Slot::new(Rule::Nearest { tolerance_ns: 12 }, true, 4)];
    let mut join = Join::new(slots, true);
    assert_eq!((0..100).map(|seq| join.push(1, packet(seq))).sum::<u64>(), 0);
}

#[test]
fn capture_times_at_the_ends_of_their_range_do_no_harm() {
    let at = |capture_ns| {
        let raw = packet(1).into_raw();
        // SAFETY: the reference that was just taken out.
        unsafe { FrameRef::adopt(Frame { tick: Tick { capture_ns, ..raw.tick }, ..raw }) }
    };
    let slots = vec![Slot::new(Rule::Exact, false, 1), Slot::new(Rule::Nearest { tolerance_ns: i64::MAX }, true, 4)];
    let mut join = Join::new(slots, false);
    join.push(0, at(i64::MAX));
    join.push(1, at(i64::MIN));
    assert_eq!(join.try_take(None, &lit_at(u64::MAX - 1)), Take::Wait);
    join.push(1, at(i64::MIN + 1));
    assert_eq!(fired(join.try_take(None, &lit_at(u64::MAX))), Some((1, true)));
    assert_eq!(seq(&join.staged[1]), None, "too far away");
}

#[test]
fn batch_arrivals_merge_by_capture_time() {
    let trigger = Rule::Latest { trigger: true };
    let mut join = Join::new(vec![Slot::new(trigger, true, 1), Slot::new(trigger, true, 1)], true);
    join.push(1, packet(2));
    assert_eq!(join.try_take(None, &lit_at(0)), Take::Wait);
    join.push(0, packet(1));
    assert_eq!(fired(join.try_take(None, &lit_at(0))).map(|f| f.0), Some(1));
    join.end(0);
    assert_eq!(fired(join.try_take(None, &lit_at(0))).map(|f| f.0), Some(2));
    join.end(1);
    assert_eq!(join.try_take(None, &lit_at(0)), Take::Finished);
}

#[test]
fn a_pause_keeps_what_a_full_queue_would_drop() {
    for rule in [Rule::Latest { trigger: true }, Rule::Nearest { tolerance_ns: 12 }, Rule::Delay] {
        let mut join = Join::new(vec![Slot::new(rule, true, 2)], false);
        join.pause();
        assert_eq!((0..100).map(|seq| join.push(0, packet(seq))).sum::<u64>(), 0, "{rule:?}");
        join.rewire(Join::new(vec![Slot::new(rule, true, 2)], false), &[Some(0)]);
        let mut successor = join.hand_over();
        assert!(join.is_handed_over() && join.is_finished(), "{rule:?}");
        successor.resume();
        assert_eq!(successor.waiting(0), 100, "{rule:?}");
    }
    // What drains is not granted again.
    let mut join = Join::new(vec![Slot::new(Rule::Latest { trigger: true }, true, 1)], false);
    join.pause();
    (0..10).for_each(|seq| assert_eq!(join.push(0, packet(seq)), 0));
    join.resume();
    for seq in 0..10 {
        assert_eq!(fired(join.try_take(None, &lit_at(0))), Some((seq, true)));
    }
    assert_eq!((join.push(0, packet(10)), join.push(0, packet(11))), (0, 1), "only the newest again");
    // A value that fires nothing is replaced by the next one, also in a pause.
    let slots = vec![Slot::new(Rule::Exact, false, 1), Slot::new(Rule::Latest { trigger: true }, true, 1)];
    let mut join = Join::new(slots, false);
    join.pause();
    (0..10).for_each(|seq| assert_eq!(join.push(1, packet(seq)), 0));
    assert_eq!(join.waiting(1), 1);
}

#[test]
fn what_is_too_old_counts_as_absent() {
    for batch in [true, false] {
        let latest = Rule::Latest { trigger: false };
        let old = |optional| Slot { max_age_ns: Some(100), ..Slot::new(latest, optional, 1) };
        let mut join = Join::new(vec![Slot::new(Rule::Exact, false, 1), old(true), old(false)], batch);
        for seq in [0, 10, 11] {
            join.push(0, packet(seq));
        }
        for slot in [1, 2] {
            join.push(slot, packet(0));
            join.end(slot);
        }
        // In batch by capture times, whatever the clock says.
        let now = |seq: u64| Lights { by_capture: batch, ..lit_at(if batch { u64::MAX / 4 } else { seq * 10 }) };
        assert_eq!(fired(join.try_take(None, &now(0))), Some((0, true)));
        assert_eq!(fired(join.try_take(None, &now(10))), Some((10, true)), "of the highest age that is allowed");
        assert_eq!(join.too_old_on, None);
        let take = join.try_take(None, &now(11));
        assert_eq!(fired(take), Some((11, false)), "a required input is absent");
        assert!(join.staged[1].is_empty() && join.staged[2].is_empty());
        assert_eq!((join.slots[1].too_old, join.slots[2].too_old, join.too_old_on.take()), (1, 1, Some(2)));
        assert_eq!(join.staged_ticks(), [Some((0, 11)), None, None], "a replay takes none either");
    }
}

#[test]
fn a_tick_inherits_the_light_of_all_its_inputs() {
    let rules = [Rule::Exact, Rule::Latest { trigger: false }, Rule::Nearest { tolerance_ns: 1 << 40 }, Rule::Delay];
    for (at_slot, rule) in rules.into_iter().enumerate().skip(1) {
        for (shows_light, wanted_ns) in [(true, 990_000), (false, 0)] {
            let timed = Slot { shows_light, ..Slot::new(rule, true, 4) };
            let mut join = Join::new(vec![Slot::new(Rule::Exact, false, 4), timed], false);
            let packet = |seq: u64, at_ns: i64| {
                let mut raw = packet(seq).into_raw();
                raw.tick.capture_ns = at_ns;
                // SAFETY: the reference that `into_raw` released; only the tick changed.
                unsafe { FrameRef::adopt(raw) }
            };
            join.push(0, packet(1, 10_000));
            if rule == Rule::Delay {
                assert!(fired(join.try_take(None, &lit_at(0))).is_some(), "nothing on the first tick");
            }
            join.push(1, packet(1, 10_000));
            join.push(0, packet(100, 1_000_000));
            join.end(1);
            let mut last = join.try_take(None, &lit_at(u64::MAX / 4));
            if rule != Rule::Delay {
                last = join.try_take(None, &lit_at(u64::MAX / 4));
            }
            let Take::Fire { tick, .. } = last else { panic!("{at_slot}: {last:?}") };
            assert_eq!((tick.seq, Lag::carried(&tick).oldest_ns), (100, wanted_ns), "{rule:?}");
            assert_eq!(Lag::carried(&tick).newest_ns, 0, "the tick's own image is new");
        }
    }
}
