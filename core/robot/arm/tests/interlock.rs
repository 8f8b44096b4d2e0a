//! The caps hold against anything, and the arm still moves.

use panoscope_arm_core::campaign;
use panoscope_arm_core::interlock::caps;
use panoscope_arm_core::interlock::{Cause, Evidence, Interlock, Settings};
use panoscope_arm_core::{Chain, JointVector};

const SEEN: Evidence = Evidence { score: 0.9, in_space: true };
const MS: i64 = 1_000_000;

/// Input of the interlock in one tick.
type Tick = fn(&mut Interlock, i64);

fn lock() -> Interlock {
    Interlock::new(Chain::shipped().expect("the shipped arm"), JointVector::zeros(), 0)
}

/// A turn of the wrist and a push that nearly keep the trocar.
fn roll() -> [f64; 6] {
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.1]
}

/// Ticks every 20 ms with a fresh tip and demand, to `until_ms`.
fn drive(lock: &mut Interlock, from_ms: i64, until_ms: i64) {
    for ms in (from_ms..until_ms).step_by(20) {
        lock.advance(ms * MS, &mut |_| {});
        lock.tip(ms * MS, SEEN);
        lock.demand(ms * MS, &roll());
    }
    lock.advance(until_ms * MS, &mut |_| {});
}

#[test]
fn no_hostile_input_leads_beyond_a_limit() {
    let chain = Chain::shipped().expect("the shipped arm");
    let out = campaign::run(&chain, 1, 40_000);
    println!("{out:?}");
    assert_eq!(out.escapes, 0, "{:?}", out.first);
    assert!(out.cases >= 40_000 && out.set_points > out.cases);
    // The campaign means nothing if the arm stands still: each limit was come near to.
    assert!(out.moving > out.cases / 4, "{out:?}");
    assert!(out.most[1..6].iter().all(|share| *share > 0.6), "{out:?}");
    for cause in Cause::ALL {
        assert!(out.causes[cause.number()] > 0, "{cause:?} never stood");
    }
}

#[test]
fn narrow_joints_hold_too() {
    // The shipped arm's workspace ends before its joints do: here the joints end first.
    let mut text = panoscope_arm_core::chain::SHIPPED_URDF.to_owned();
    for angle in ["2.6", "1.2", "1.4", "2.8", "1.8", "3.0"] {
        text = text.replace(&format!("lower=\"-{angle}\" upper=\"{angle}\""), "lower=\"-0.05\" upper=\"0.05\"");
    }
    let chain = Chain::from_urdf(&text).expect("narrow joints");
    assert!(chain.joints().iter().all(|joint| joint.upper_rad == 0.05));
    let out = campaign::run(&chain, 2, 10_000);
    assert_eq!(out.escapes, 0, "{:?}", out.first);
    assert!(out.most[0] > 0.5 && out.moving > 1000, "{out:?}");
}

#[test]
fn every_stop_has_its_cause_and_ends_at_rest() {
    let cases: [(Cause, Tick); 8] = [
        (Cause::OldTip, |lock, ms| lock.demand(ms * MS, &roll())),
        // Tip and demand come in time, but from light of 200 ms ago: ticks that were held back.
        (Cause::OldTip, |lock, ms| {
            lock.tip((ms - 200) * MS, SEEN);
            lock.demand(ms * MS, &roll());
        }),
        (Cause::OldTip, |lock, ms| {
            lock.tip(ms * MS, SEEN);
            lock.demand_of_light(ms * MS, (ms - 200) * MS, &roll());
        }),
        (Cause::DoubtfulTip, |lock, ms| {
            lock.tip(ms * MS, Evidence { score: 0.1, in_space: true });
            lock.demand(ms * MS, &roll());
        }),
        (Cause::DoubtfulTip, |lock, ms| {
            lock.tip(ms * MS, Evidence { score: f64::NAN, in_space: true });
            lock.demand(ms * MS, &roll());
        }),
        (Cause::FlatTip, |lock, ms| {
            lock.tip(ms * MS, Evidence { score: 0.9, in_space: false });
            lock.demand(ms * MS, &roll());
        }),
        (Cause::LoopStalled, |lock, ms| lock.tip(ms * MS, SEEN)),
        (Cause::BadDemand, |lock, ms| {
            lock.tip(ms * MS, SEEN);
            lock.demand(ms * MS, &[f64::NAN; 6]);
        }),
    ];
    for (cause, tick) in cases {
        let mut lock = lock();
        drive(&mut lock, 0, 1000);
        assert_eq!(lock.stop(), None);
        assert!(lock.set_point().velocity.amax() > 0.09);
        while lock.take_event().is_some() {}
        for ms in (1000..1800).step_by(20) {
            lock.advance(ms * MS, &mut |_| {});
            tick(&mut lock, ms);
        }
        lock.advance(1800 * MS, &mut |_| {});
        assert_eq!(lock.stop(), Some(cause));
        assert!(lock.set_point().is_at_rest(), "{cause}");
        let event = lock.take_event().expect("the stop is told");
        assert_eq!(event.stop, Some(cause));
        assert!(event.to_string().contains(cause.words()));
        // What was wrong is over: the arm moves again by itself.
        drive(&mut lock, 1820, 2400);
        assert_eq!(lock.stop(), None, "{cause}");
    }
}

#[test]
fn an_emergency_stop_latches() {
    let mut lock = lock();
    drive(&mut lock, 0, 1000);
    lock.latch(Cause::EmergencyStop);
    drive(&mut lock, 1000, 3000);
    assert_eq!((lock.stop(), lock.set_point().is_at_rest()), (Some(Cause::EmergencyStop), true));
    lock.release();
    lock.advance(3010 * MS, &mut |_| {});
    assert!(lock.set_point().is_at_rest(), "old tips and demands are forgotten");
    drive(&mut lock, 3020, 3600);
    assert_eq!(lock.stop(), None);
}

#[test]
fn a_stop_is_smooth_and_short() {
    let mut lock = lock();
    drive(&mut lock, 0, 1500);
    let from = lock.set_point().velocity[5];
    lock.latch(Cause::EmergencyStop);
    let mut speeds = Vec::new();
    lock.advance(1700 * MS, &mut |point| speeds.push(point.velocity[5]));
    assert!(from > 0.09 && speeds.windows(2).all(|w| w[1] <= w[0] + 1e-6 && w[1] > -1e-12), "{speeds:?}");
    assert_eq!(speeds.last(), Some(&0.0), "within 200 ms from {from} rad/s");
}

#[test]
fn a_tick_of_30_frames_a_second_is_no_stop() {
    let mut lock = lock();
    let mut ms = 0.0f64;
    while ms < 3000.0 {
        let now = (ms * 1e6) as i64;
        lock.advance(now, &mut |_| {});
        lock.tip(now, SEEN);
        lock.demand(now, &roll());
        ms += 1000.0 / 30.0;
    }
    // The demand is dead for the last 3 ms of each tick: that costs next to no speed and is no stop.
    assert!(lock.set_point().velocity[5] > 0.098, "{}", lock.set_point().velocity[5]);
    assert_eq!(lock.stops(), 0);
}

#[test]
fn settings_cannot_lift_the_ceilings() {
    let mut lock = lock();
    lock.set(Settings { max_age_ms: 1e9, min_score: -5.0 });
    drive(&mut lock, 0, 1000);
    // A tip of no score is never followed, and none older than 300 ms.
    lock.tip(1000 * MS, Evidence { score: 0.0, in_space: true });
    lock.demand(1000 * MS, &roll());
    lock.advance(1010 * MS, &mut |_| {});
    assert_eq!(lock.stop(), Some(Cause::DoubtfulTip));
    lock.tip(1010 * MS, SEEN);
    for ms in (1010..1400).step_by(10) {
        lock.advance(ms * MS, &mut |_| {});
        lock.demand(ms * MS, &roll());
    }
    assert_eq!(lock.stop(), Some(Cause::OldTip));
    assert!(caps::TIP_AGE.as_millis() == 300 && caps::DEMAND_AGE.as_millis() == 24);
}
