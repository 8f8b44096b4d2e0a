//! Skill measures beside closed forms, phases, and memory.

use panoscope_arm_core::tracking::skill::motions::{self, Timing};
use panoscope_arm_core::tracking::skill::{Sample, Session, Settings};

#[test]
fn measures_of_known_motions_are_less_than_a_hundredth_off() {
    let settings = Settings::default();
    let mut wrong = Vec::new();
    let mut count = 0;
    for motion in motions::all(&settings) {
        for timing in Timing::ALL {
            for checked in motions::check(&motion, timing, &settings) {
                count += 1;
                let error = checked.error();
                if error.is_nan() || error >= 0.01 {
                    wrong.push(format!(
                        "{} {}: {checked:?}, off by {:.2} %",
                        motion.name,
                        timing.name(),
                        error * 100.0
                    ));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 100, "{count}");
}

fn at(at_s: f64, x: f64) -> Sample {
    Sample { at_s, place_mm: [x, 0.0, 50.0], depth_mm: 50.0, tissue_mm: f64::NAN }
}

#[test]
fn phases_share_out_time_and_path_and_are_taken_up_again() {
    let mut session = Session::new(Settings::default());
    let tool = session.tool(7, || "hook".to_owned()).unwrap();
    for k in 0..=360 {
        let t = f64::from(k) / 30.0;
        session.set_phase(if (4.0..8.0).contains(&t) { "dissection" } else { "exposure" });
        let speed = if (4.0..8.0).contains(&t) { 30.0 } else { 10.0 };
        let before = if t < 4.0 {
            0.0
        } else if t < 8.0 {
            40.0 - 4.0 * 30.0
        } else {
            160.0 - 8.0 * 10.0
        };
        session.observe(tool, at(t, before + speed * t));
        session.advance(t);
    }
    session.finish();
    assert_eq!(session.phases(), ["exposure", "dissection"]);
    let report = session.tools().next().unwrap();
    assert_eq!((report.key, report.name), (7, "hook"));
    let near = |value: f64, want: f64| assert!((value / want - 1.0).abs() < 0.015, "{value}, not {want}");
    near(report.total.time_s(), 12.0);
    near(report.total.path_mm(), 200.0);
    near(report.phases[0].time_s(), 8.0);
    near(report.phases[0].path_mm(), 80.0);
    near(report.phases[1].path_mm(), 120.0);
    near(report.phases[1].mean_speed_mm_s(), 30.0);
    assert_eq!(report.total.departures(), 0, "a change of phase is no departure");
    assert_eq!(report.total.movements(), 3, "a movement ends with its phase");
}

#[test]
fn odd_samples_are_left_out_and_too_many_tools_refused() {
    let mut session = Session::new(Settings::default());
    let tool = session.tool(0, String::new).unwrap();
    for k in 0..60 {
        let t = f64::from(k) / 30.0;
        session.observe(tool, at(t, 10.0 * t));
        // Twice the same time, the past, and no place.
        session.observe(tool, at(t, 500.0));
        session.observe(tool, at(t - 0.5, 500.0));
        session.observe(tool, at(t + 0.01, f64::NAN));
        session.advance(t);
    }
    session.observe(99, at(3.0, 0.0));
    session.finish();
    let path = session.tools().next().unwrap().total.path_mm();
    assert!((path / 19.67 - 1.0).abs() < 0.01, "{path}");
    for key in 1..16 {
        assert!(session.tool(key, String::new).is_some());
    }
    assert_eq!(session.tool(16, String::new), None);
    assert_eq!(session.tool(3, String::new), Some(3));
    Session::new(Settings::default()).finish();
}

#[test]
fn a_tool_that_comes_later_and_one_that_goes_share_only_the_time_in_which_both_are_seen() {
    let mut session = Session::new(Settings::default());
    for k in 0..=300 {
        let t = f64::from(k) / 30.0;
        for (key, range) in [(0, 0.0..6.0), (1, 4.0..10.1)] {
            if range.contains(&t) {
                let tool = session.tool(key, || format!("tool {key}")).unwrap();
                session.observe(tool, at(t, 10.0 * t));
            }
        }
        session.advance(t);
    }
    session.finish();
    let (_, _, both, _) = session.pairs().next().unwrap();
    assert!((both.seen_s() - 2.0).abs() < 0.06 && (both.overlap() - 1.0).abs() < 1e-9, "{both:?}");
    assert!(both.correlation().is_nan(), "steady speeds do not go together or apart");
    let times: Vec<(f64, f64)> = session.tools().map(|t| (t.total.seen_s(), t.total.out_of_view_s())).collect();
    // The first one is gone for the rest; the second one's time begins when it comes.
    for (seen, want) in times.iter().zip([(5.97, 4.03), (6.0, 0.0)]) {
        assert!((seen.0 - want.0).abs() < 0.06 && (seen.1 - want.1).abs() < 0.06, "{times:?}");
    }
}
