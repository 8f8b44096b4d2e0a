//! When the arm follows, when it stops, and what it reports.

use super::*;

const NOW: i64 = 1_000 * MS;

/// An interlock at [`NOW`] with a tip and a demand that are followed.
fn asked() -> Interlock {
    let mut lock = Interlock::new(shipped(), JointVector::zeros(), NOW);
    ask(&mut lock, NOW, 0.1);
    lock
}

/// The cause of the next step.
fn next(mut lock: Interlock) -> Option<Cause> {
    lock.advance(NOW + MS, &mut |_| {});
    lock.stop()
}

#[test]
fn a_tip_is_followed_up_to_its_age_into_both_directions_of_time() {
    for (light_ns, cause) in [
        (NOW - 150 * MS, None),
        (NOW - 150 * MS - 1, Some(Cause::OldTip)),
        (NOW + 150 * MS, None),
        (NOW + 150 * MS + 1, Some(Cause::OldTip)),
        (i64::MIN, Some(Cause::OldTip)),
        (i64::MAX, Some(Cause::OldTip)),
    ] {
        let mut lock = asked();
        lock.tip(light_ns, SEEN);
        assert_eq!(next(lock), cause, "tip of {light_ns}");
        let mut lock = asked();
        lock.correct_tip(light_ns);
        assert_eq!(next(lock), cause, "corrected to {light_ns}");
        let mut lock = asked();
        lock.demand_of_light(NOW, light_ns, joint(5, 0.1).as_slice());
        assert_eq!(next(lock), cause, "demand of light of {light_ns}");
    }
    // There is no tip to correct.
    let mut lock = Interlock::new(shipped(), JointVector::zeros(), NOW);
    lock.correct_tip(NOW);
    assert_eq!(next(lock), Some(Cause::NoTip));
}

#[test]
fn a_demand_expires_after_24_ms() {
    for (made_ns, cause) in [
        (NOW - 24 * MS + 1, None),
        (NOW - 24 * MS, Some(Cause::LoopStalled)),
        (NOW + 24 * MS - 1, None),
        (NOW + 24 * MS, Some(Cause::LoopStalled)),
        (i64::MIN, Some(Cause::LoopStalled)),
        (i64::MAX, Some(Cause::LoopStalled)),
    ] {
        let mut lock = asked();
        lock.demand_of_light(made_ns, NOW, joint(5, 0.1).as_slice());
        assert_eq!(next(lock), cause, "{made_ns}");
    }
    // However the steps of 1 ms lie: the last step begins before the expiry.
    for early_ns in [0, 1, 500_000, 999_999] {
        let mut lock = asked();
        lock.demand(NOW - early_ns, joint(5, 0.1).as_slice());
        assert_eq!(lock.expires_ns(), None, "it does not follow yet");
        lock.advance(NOW + 10 * MS, &mut |_| {});
        assert_eq!(lock.expires_ns(), Some(NOW - early_ns + 24 * MS));
        lock.advance(NOW + 24 * MS, &mut |_| {});
        assert_eq!(lock.stop(), None, "{early_ns}");
        lock.advance(NOW + 25 * MS, &mut |_| {});
        assert_eq!((lock.stop(), lock.expires_ns()), (Some(Cause::LoopStalled), None), "{early_ns}");
    }
}

#[test]
fn a_demand_of_old_light_is_named_so_however_old_it_becomes() {
    for (light_ns, cause) in
        [(NOW - 150 * MS, Cause::LoopStalled), (NOW - 150 * MS - 1, Cause::OldTip), (i64::MIN, Cause::OldTip)]
    {
        let mut lock = asked();
        lock.demand_of_light(NOW, light_ns, joint(5, 0.1).as_slice());
        lock.advance(NOW + 60 * MS, &mut |_| {});
        assert_eq!(lock.stop(), Some(cause), "light of {light_ns}");
    }
}

#[test]
fn a_demand_that_expires_within_a_call_is_followed_up_to_then() {
    for left in [1, 4, 9] {
        let mut lock = asked();
        lock.demand(NOW - (24 - left) * MS, joint(5, 0.1).as_slice());
        let mut points = Vec::new();
        lock.advance(NOW + 40 * MS, &mut |point| points.push(*point));
        let turn = points.windows(2).position(|two| two[1].acceleration[5] < two[0].acceleration[5]);
        assert_eq!(turn, Some(left as usize - 1), "it accelerates for {left} ms");
    }
}

#[test]
fn a_demand_has_six_finite_numbers() {
    let sound = joint(5, 0.1);
    assert_eq!(next(asked()), None);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for k in 0..JOINTS {
            let mut values = sound;
            values[k] = bad;
            let mut lock = asked();
            lock.demand(NOW, values.as_slice());
            assert_eq!(next(lock), Some(Cause::BadDemand), "{bad} in joint {k}");
        }
    }
    for count in [0, 5, 7] {
        let mut lock = asked();
        lock.demand(NOW, &[0.0; 7][..count]);
        assert_eq!(next(lock), Some(Cause::BadDemand), "{count} numbers");
    }
}

#[test]
fn a_score_is_between_its_limit_and_one() {
    let with = |min_score: f64, score: f64| {
        let mut lock = asked();
        lock.set(Settings { min_score, ..Settings::default() });
        lock.tip(NOW, Evidence { score, in_space: true });
        next(lock)
    };
    let doubtful = Some(Cause::DoubtfulTip);
    assert_eq!((with(0.3, 0.3), with(0.3, 0.299), with(0.3, 1.0), with(0.3, 1.001)), (None, doubtful, None, doubtful));
    assert_eq!((with(0.0, 0.0), with(-5.0, 0.0), with(0.0, 1e-9)), (doubtful, doubtful, None), "0 is no tip");
    assert_eq!((with(f64::NAN, 0.999), with(f64::NAN, 1.0), with(0.3, f64::NAN)), (doubtful, None, doubtful));
    assert_eq!((with(9.0, 1.0), with(9.0, 0.999)), (None, doubtful));
    let mut lock = asked();
    lock.tip(NOW, Evidence { score: 0.9, in_space: false });
    assert_eq!(next(lock), Some(Cause::FlatTip));
}

#[test]
fn the_largest_age_is_at_most_300_ms() {
    let with = |max_age_ms: f64, age_ns: i64| {
        let mut lock = asked();
        lock.set(Settings { max_age_ms, ..Settings::default() });
        lock.tip(NOW - age_ns, SEEN);
        lock.demand(NOW, joint(5, 0.1).as_slice());
        next(lock)
    };
    let old = Some(Cause::OldTip);
    assert_eq!((with(1e9, 300 * MS), with(1e9, 300 * MS + 1)), (None, old));
    assert_eq!((with(80.0, 80 * MS), with(80.0, 80 * MS + 1)), (None, old));
    for none in [f64::NAN, -1.0, f64::NEG_INFINITY] {
        assert_eq!((with(none, 0), with(none, 1)), (None, old), "{none}");
    }
}

#[test]
fn what_is_missing_is_named() {
    let mut lock = Interlock::new(shipped(), JointVector::zeros(), NOW);
    assert_eq!((lock.stop(), lock.stopped(), lock.latched()), (Some(Cause::NoTip), Some(Cause::NoTip), None));
    lock.demand(NOW, joint(5, 0.1).as_slice());
    assert_eq!(next(lock), Some(Cause::NoTip));
    let mut lock = Interlock::new(shipped(), JointVector::zeros(), NOW);
    lock.tip(NOW, SEEN);
    assert_eq!(next(lock), Some(Cause::NoDemand));
    // A new start of the clock forgets both.
    let mut lock = asked();
    lock.start_clock(NOW);
    assert_eq!(next(lock), Some(Cause::NoTip));
    let mut lock = asked();
    lock.start_clock(NOW - 7 * MS);
    lock.tip(NOW, SEEN);
    let mut steps = 0;
    lock.advance(NOW, &mut |_| steps += 1);
    assert_eq!((lock.stop(), steps), (Some(Cause::NoDemand), 7));
}

#[test]
fn the_first_cause_latches_until_it_is_released() {
    let mut lock = asked();
    lock.latch(Cause::Stalled);
    lock.latch(Cause::EmergencyStop);
    assert_eq!(lock.latched(), Some(Cause::Stalled));
    lock.advance(NOW + 20 * MS, &mut |_| {});
    assert_eq!((lock.stop(), lock.stopped()), (Some(Cause::Stalled), Some(Cause::Stalled)));
    lock.release();
    assert_eq!(lock.latched(), None);
    lock.advance(NOW + 30 * MS, &mut |_| {});
    assert_eq!(lock.stop(), Some(Cause::NoTip), "tip and demand of before are forgotten");
    lock.tip(NOW + 30 * MS, SEEN);
    lock.advance(NOW + 40 * MS, &mut |_| {});
    assert_eq!(lock.stop(), Some(Cause::NoDemand));
}

#[test]
fn time_that_jumps_stops_the_arm_until_a_new_tip_and_demand() {
    // 250 ms may pass between two calls; they are made up for.
    for (passed_ns, steps, cause) in [
        (250 * MS, 250, Cause::OldTip),
        (250 * MS + 1, 250, Cause::Clock),
        (3600 * 1000 * MS, 250, Cause::Clock),
        (i64::MAX, 250, Cause::Clock),
    ] {
        let mut lock = lock();
        drive(&mut lock, 0, 500, 0.1);
        let mut count = 0;
        lock.advance((500 * MS).saturating_add(passed_ns), &mut |_| count += 1);
        assert_eq!((count, lock.stop()), (steps, Some(cause)), "after {passed_ns} ns");
    }
    // Backwards: no step, then a stop.
    let mut lock = lock();
    drive(&mut lock, 0, 500, 0.1);
    let (before, mut count) = (*lock.set_point(), 0);
    lock.advance(500 * MS - 1, &mut |_| count += 1);
    lock.advance(400 * MS, &mut |_| count += 1);
    assert_eq!((count, *lock.set_point()), (0, before));
    lock.advance(405 * MS, &mut |_| count += 1);
    assert_eq!((count, lock.stop()), (5, Some(Cause::Clock)));
    lock.tip(405 * MS, SEEN);
    lock.advance(406 * MS, &mut |_| {});
    assert_eq!(lock.stop(), Some(Cause::NoDemand));
    ask(&mut lock, 406 * MS, 0.1);
    lock.advance(416 * MS, &mut |_| {});
    assert_eq!(lock.stop(), None);
    // It is over: what is missing now is a tip, not the clock.
    lock.release();
    lock.advance(420 * MS, &mut |_| {});
    assert_eq!(lock.stop(), Some(Cause::NoTip));
    // The same time again is no jump.
    let mut lock = asked();
    lock.advance(NOW, &mut |_| {});
    assert_eq!(next(lock), None);
}

#[test]
fn a_stop_is_reported_from_25_steps_on_and_once() {
    let mut lock = lock();
    drive(&mut lock, 0, 500, 0.1);
    assert_eq!(events(&mut lock), [None], "it moves after its start");
    assert_eq!((lock.stops(), lock.stopped()), (0, None));
    // The last demand is of 490 ms: it expires at 520 ms. 24 steps later it is not worth a report.
    lock.advance(544 * MS, &mut |_| {});
    assert_eq!((lock.stop(), lock.stopped(), lock.stops()), (Some(Cause::LoopStalled), None, 0));
    drive(&mut lock, 544, 700, 0.1);
    assert_eq!((events(&mut lock), lock.stops()), (vec![], 0));
    // The last demand is of 694 ms.
    lock.advance((724 + 24) * MS, &mut |_| {});
    assert_eq!(lock.stopped(), None, "earlier steps do not count");
    lock.advance((724 + 25) * MS, &mut |_| {});
    assert_eq!((lock.stopped(), lock.stops()), (Some(Cause::LoopStalled), 1));
    assert_eq!(events(&mut lock), [Some(Cause::LoopStalled)]);
    // Later the tip is too old: still the same stop.
    lock.advance(900 * MS, &mut |_| {});
    assert_eq!((lock.stopped(), lock.stops()), (Some(Cause::OldTip), 1));
    assert_eq!(events(&mut lock), []);
    // A stop that latches is one of its own, at once.
    lock.latch(Cause::EmergencyStop);
    lock.advance(901 * MS, &mut |_| {});
    assert_eq!((lock.stopped(), lock.stops()), (Some(Cause::EmergencyStop), 2));
    lock.advance(1000 * MS, &mut |_| {});
    assert_eq!(events(&mut lock), [Some(Cause::EmergencyStop)]);
    lock.release();
    lock.count_stops_from(41);
    drive(&mut lock, 1000, 1100, 0.1);
    assert_eq!((events(&mut lock), lock.stops(), lock.stopped()), (vec![None], 41, None));
    lock.latch(Cause::Stalled);
    lock.advance(1101 * MS, &mut |_| {});
    assert_eq!(lock.stops(), 42);
    let event = lock.take_event().expect("a stop");
    assert_eq!((event.at_ns, event.stop), (1101 * MS, Some(Cause::Stalled)));
    assert!((event.speed_rad_s - lock.set_point().velocity.amax()).abs() < 1e-12 && event.speed_rad_s > 0.01);
}

#[test]
fn the_newest_32_events_wait_to_be_taken() {
    let mut lock = lock();
    let mut ms = 0;
    for _ in 0..40 {
        lock.release();
        drive(&mut lock, ms, ms + 20, 0.1);
        lock.latch(Cause::EmergencyStop);
        lock.advance((ms + 21) * MS, &mut |_| {});
        ms += 30;
    }
    assert_eq!(lock.stops(), 40);
    let taken: Vec<Event> = std::iter::from_fn(|| lock.take_event()).collect();
    assert_eq!(taken.len(), 32);
    assert_eq!(taken.last().map(|event| (event.at_ns, event.stop)), Some(((ms - 9) * MS, Some(Cause::EmergencyStop))));
    assert!(taken.windows(2).all(|two| two[0].at_ns < two[1].at_ns && two[0].stop.is_some() != two[1].stop.is_some()));
}
