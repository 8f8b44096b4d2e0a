//! Gains found on the simulated arm.

use panoscope_arm_core::Chain;
use panoscope_arm_core::control::Goals;
use panoscope_arm_core::dynamics::Quality;
use panoscope_arm_core::rehearsal::shipped_goals;
use panoscope_arm_core::tuning::course::{Channel, Course, Motion, measure};
use panoscope_arm_core::tuning::relay::{Parts, Tuned};
use panoscope_arm_core::tuning::search::{self, Cost, STEP_MM};

const RANGES: search::Ranges = [(0.5, 20.0), (0.02, 10.0), (0.005, 1.0)];

fn course() -> Course {
    Course::shipped(Chain::shipped().expect("the shipped arm"))
}

#[test]
fn the_relay_finds_the_dead_time_of_the_simulated_arm() {
    for channel in Channel::ALL {
        let mut last: Option<f64> = None;
        for latency_ms in [50.0, 100.0, 150.0] {
            let course = Course { quality: Quality { latency_ms, ..Quality::default() }, ..course() };
            let found = course.relay(&shipped_goals(), channel).expect("it swings");
            // An integrator of speed 1 behind a dead time L swings with 4 L: latency, lag, one tick of the relay, limits of acceleration.
            let dead_s = found.period_s / 4.0;
            let least = latency_ms * 1e-3 + 0.015;
            assert!((least..least + 0.15).contains(&dead_s), "{channel:?} {latency_ms} ms: {found:?}");
            // Later arms swing more slowly, by four times what they are later.
            if let Some(last) = last {
                assert!(
                    (found.period_s - last - 0.2).abs() < 0.1,
                    "{channel:?} {latency_ms} ms: {found:?} after {last}"
                );
            }
            last = Some(found.period_s);
            // Speed 1: gain and period belong together.
            let speed = std::f64::consts::PI / (2.0 * found.gain * dead_s);
            assert!((speed - 1.0).abs() < 0.35, "{channel:?}: speed {speed}, {found:?}");
        }
    }
}

#[test]
fn a_tuned_pid_beats_p_on_a_ramp_and_keeps_its_overshoot() {
    // Nothing fed forward, as in the thesis: with it there is little left for the PID to do on a ramp.
    let (course, goals) = (course(), Goals { feed_forward: 0.0, ..shipped_goals() });
    for channel in Channel::ALL {
        let ultimate = course.relay(&goals, channel).expect("it swings");
        let found = |parts: Parts, fewer: Option<Tuned>| {
            let starts = search::starts(&ultimate, parts, fewer);
            let mut judge = |tuned: Tuned| search::cost(&course, &goals, channel, tuned, 10.0);
            let (tuned, cost) =
                search::search(&starts, &search::ranges(&ultimate), parts, &mut judge, &mut |_, _| true)
                    .expect("the arm moves");
            (tuned, cost, search::report(&course, &goals, channel, tuned).expect("the arm moves"))
        };
        let (p, p_cost, p_report) = found(Parts::P, None);
        let (pid, pid_cost, pid_report) = found(Parts::Pid, Some(p));
        println!("{channel:?}: P {p:?} {p_cost:?} {p_report:?}\n PID {pid:?} {pid_cost:?} {pid_report:?}");
        assert!((p.integral, p.derivative) == (0.0, 0.0) && pid.derivative > 0.0 && pid.integral > 0.0);
        assert!(pid_report.ramp_mm < 0.97 * p_report.ramp_mm, "{pid_report:?} {p_report:?}");
        assert!(pid_cost.total < 0.9 * p_cost.total, "{pid_cost:?} {p_cost:?}");
        assert!(pid.proportional <= 0.6 * ultimate.gain + 1e-9, "{pid:?} of {ultimate:?}");
        assert!(pid_report.step.overshoot_pct <= 12.0 && pid_cost.overshoot_pct <= 12.0, "{pid_cost:?} {pid_report:?}");
    }
}

#[test]
fn a_step_is_measured_as_it_is() {
    // First order, 0.2 s, with 30 samples a second.
    let samples: Vec<_> = (-30..105)
        .map(|k| {
            let at_s = f64::from(k) / 30.0;
            let error_mm = if at_s < 0.0 { 0.0 } else { STEP_MM * (-at_s / 0.2).exp() };
            panoscope_arm_core::tuning::course::Sample { at_s, error_mm, camera_mm_s2: 3.0 }
        })
        .collect();
    let m = measure(&samples, Motion::Step(STEP_MM));
    assert!((m.rise_s - 0.2 * 9.0_f64.ln()).abs() < 0.04 && (m.settling_s - 0.2 * 10.0_f64.ln()).abs() < 0.04, "{m:?}");
    assert!(m.overshoot_pct == 0.0 && m.steady_mm < 1e-5 && m.shake_mm_s2 == 3.0, "{m:?}");
    // The integral of t e^(-t/T) is T^2.
    assert!((m.itae - STEP_MM * 0.04).abs() < 0.01, "{m:?}");
}

#[test]
fn the_search_finds_the_bottom_of_a_bowl() {
    let bowl = |t: Tuned| {
        let off = [(t.proportional, 3.0), (t.integral, 0.4), (t.derivative, 0.1)];
        let total = off.iter().map(|(gain, best): &(f64, f64)| (gain / best).ln().powi(2)).sum();
        Ok(Cost { total, itae: total, swing_mm: 0.0, overshoot_pct: 0.0, shake_mm_s2: 0.0 })
    };
    let start = Tuned { proportional: 15.0, integral: 5.0, derivative: 0.9 };
    let (found, cost) = search::search(&[start], &RANGES, Parts::Pid, &mut { bowl }, &mut |_, _| true).expect("a bowl");
    assert!(cost.total < 0.03, "{found:?} {cost:?}");
    let mut tries = 0;
    let (_, stopped) = search::search(&[start], &RANGES, Parts::Pid, &mut { bowl }, &mut |_, _| {
        tries += 1;
        tries < 3
    })
    .expect("a bowl");
    assert!(tries == 3 && stopped.total > cost.total);
}

#[test]
fn motions_begin_where_the_tip_should_be() {
    let samples = course().play(&shipped_goals(), Channel::Picture, Motion::Step(STEP_MM)).expect("the arm moves");
    let at = |at_s: f64| samples.iter().find(|s| s.at_s >= at_s - 1e-6).expect("a sample").error_mm;
    assert!(at(-0.5).abs() < 0.3 && (at(0.0) - STEP_MM).abs() < 0.3 && at(3.0).abs() < 0.5, "{samples:?}");
}
