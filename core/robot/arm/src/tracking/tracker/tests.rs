use super::*;
use crate::tracking::kalman::Model;
use panoscope_base::random::{SplitMix64, unit};

const RULES: Rules = Rules {
    model: Model { acceleration_mm_s2: 150.0, gate: 16.3 },
    lateral_px: 1.0,
    disparity_px: 0.5,
    focal_px: 750.0,
    baseline_mm: 15.0,
    min_score: 0.3,
    max_gap_s: 0.3,
    switch_s: 0.6,
};

fn report(x: f64, track_id: i64) -> Report {
    Report { xyz_mm: Vector3::new(x, 0.0, 65.0), score: 0.9, track_id, class_index: 0, age_s: 0.0 }
}

fn step(tracker: &mut Tracker, tick: i64, reports: &[Report]) -> Known {
    tracker.step(tick * 33_333_333, reports.iter().copied(), &Isometry3::identity(), &RULES)
}

#[test]
fn a_tip_that_hides_is_predicted_for_a_while_and_then_lost() {
    let mut tracker = Tracker::default();
    assert_eq!(step(&mut tracker, 0, &[]), Known::Lost);
    for tick in 1..30 {
        assert_eq!(step(&mut tracker, tick, &[report(0.5 * tick as f64, 1)]), Known::Seen(0));
    }
    for tick in 30..38 {
        assert!(matches!(step(&mut tracker, tick, &[]), Known::Predicted(_)), "tick {tick}");
    }
    let (at, _) = tracker.state().expect("predicted");
    assert!((at.x - 0.5 * 37.0).abs() < 0.3, "{at}");
    assert_eq!(step(&mut tracker, 39, &[]), Known::Lost);
    assert_eq!(tracker.state(), None);
    // It comes back elsewhere.
    assert_eq!(step(&mut tracker, 40, &[report(-10.0, 1)]), Known::Seen(0));
    assert_eq!(tracker.track_id(), 1);
}

#[test]
fn a_report_of_unknown_class_votes_for_none() {
    let of = |class_index: u32, tick: i64| Report { class_index, ..report(0.1 * tick as f64, -1) };
    let mut tracker = Tracker::default();
    assert_eq!(tracker.class_index(), UNKNOWN_CLASS);
    // It begins unknown, is named by the first report that has a class, and keeps the name through any number of unknown ones.
    step(&mut tracker, 0, &[of(UNKNOWN_CLASS, 0)]);
    assert_eq!(tracker.class_index(), UNKNOWN_CLASS);
    step(&mut tracker, 1, &[of(4, 1)]);
    assert_eq!(tracker.class_index(), 4);
    for tick in 2..90 {
        assert_eq!(step(&mut tracker, tick, &[of(UNKNOWN_CLASS, tick)]), Known::Seen(0));
        assert_eq!(tracker.class_index(), 4, "tick {tick}");
    }
    // One report was for 4: one for another class ends in a draw, which takes the newer one.
    step(&mut tracker, 90, &[of(2, 90)]);
    assert_eq!(tracker.class_index(), 2);
    // Between two tips as near, the unknown one is not held to be another tool.
    let mut known = Tracker::default();
    (0..40).for_each(|tick| {
        step(&mut known, tick, &[Report { class_index: 4, ..report(0.0, -1) }]);
    });
    let (near, far) =
        (Report { class_index: UNKNOWN_CLASS, ..report(0.3, -1) }, Report { class_index: 4, ..report(2.9, -1) });
    assert_eq!(step(&mut known, 40, &[far, near]), Known::Seen(1));
}

#[test]
fn another_tool_leads_only_when_the_first_is_long_gone() {
    let mut tracker = Tracker::default();
    for tick in 0..20 {
        // The other one is surer and comes first, the leading one is nearer to the middle of the shared picture.
        let other = Report { score: 1.0, ..report(-12.0, 2) };
        assert_eq!(step(&mut tracker, tick, &[other, report(0.0, 1)]), Known::Seen(1));
        assert_eq!(tracker.track_id(), 1);
    }
    let others = report(-12.0, 2);
    for tick in 20..28 {
        assert!(matches!(step(&mut tracker, tick, &[others]), Known::Predicted(_)), "tick {tick}");
    }
    let back = report(0.0, 1);
    assert!(matches!(step(&mut tracker, 28, &[others, back]), Known::Seen(1)));
    let mut switched = None;
    for tick in 29..60 {
        if step(&mut tracker, tick, &[others]) == Known::Seen(0) && switched.is_none() {
            switched = Some(tick);
        }
    }
    assert!(switched.is_some_and(|tick| (44..=50).contains(&tick)), "{switched:?}");
}

#[test]
fn a_tip_that_another_tool_covers_keeps_the_lead() {
    let (lead, other) = (report(0.0, 1), Report { class_index: 4, ..report(-12.0, 2) });
    for (number, class_index, keeps) in [(1, 0, true), (-1, 0, true), (2, 0, false), (-1, 4, false)] {
        let mut tracker = Tracker::default();
        for tick in 0..20 {
            assert_eq!(step(&mut tracker, tick, &[lead, other]), Known::Seen(0));
        }
        // Two seconds behind the other tool: after a while nothing is known of it, but the arm follows no other.
        for tick in 20..80 {
            tracker.cover(number, class_index);
            let known = step(&mut tracker, tick, &[other]);
            assert!(!keeps || !matches!(known, Known::Seen(_)), "tick {tick}: {known:?}");
        }
        assert_eq!(tracker.track_id(), if keeps { -1 } else { 2 }, "{number}, class {class_index}");
        let back = step(&mut tracker, 80, &[other, lead]);
        assert_eq!(back, Known::Seen(usize::from(keeps)), "{number}, class {class_index}");
    }
    // It is in view no longer, or covered for too long.
    for covered in [20, 600] {
        let mut tracker = Tracker::default();
        for tick in 0..20 {
            step(&mut tracker, tick, &[lead, other]);
        }
        let mut led = None;
        for tick in 20..600 {
            if tick < covered {
                tracker.cover(1, 0);
            }
            if step(&mut tracker, tick, &[other]) == Known::Seen(0) && led.is_none() {
                led = Some(tick);
            }
        }
        let expected = if covered == 20 { 36..=40 } else { 168..=190 };
        assert!(led.is_some_and(|tick| expected.contains(&tick)), "covered until {covered}: {led:?}");
    }
}

#[test]
fn invalid_reports_are_ignored() {
    let mut tracker = Tracker::default();
    step(&mut tracker, 0, &[report(0.0, 1)]);
    let bad = [
        Report { score: f64::NAN, ..report(0.0, 1) },
        Report { xyz_mm: Vector3::new(f64::NAN, 0.0, 65.0), ..report(0.0, 1) },
        Report { xyz_mm: Vector3::new(0.0, 0.0, -65.0), ..report(0.0, 1) },
        Report { score: 0.1, ..report(0.0, 1) },
    ];
    for (tick, bad) in (1..).zip(bad) {
        assert!(matches!(step(&mut tracker, tick, &[bad]), Known::Predicted(_)), "{bad:?}");
    }
    // Time that goes back starts anew.
    assert_eq!(step(&mut tracker, 0, &[]), Known::Lost);
}

/// Two tools without numbers whose trajectories cross. Returns the share of ticks in which the tracker knows the first
/// one, and its largest error in mm. Noise as stereo has it; the tip farther from the camera is hidden while both lie
/// within `hides_mm` across.
fn cross(trajectories: [&dyn Fn(f64) -> Vector3<f64>; 2], hides_mm: f64, classes: [u32; 2], seed: u64) -> (f64, f64) {
    let (mut tracker, mut random) = (Tracker::default(), SplitMix64(seed));
    let (mut known, mut worst) = (0, 0.0_f64);
    for tick in 0..240_i64 {
        let t = tick as f64 / 30.0;
        let [one, two] = trajectories.map(|trajectory| trajectory(t));
        let hidden = (one - two).xy().norm() < hides_mm;
        let mut reports = Vec::new();
        for (place, other, class_index) in [(one, two, classes[0]), (two, one, classes[1])] {
            let mut noise = |deviation: f64| (0..12).map(|_| unit(random.bits()) - 0.5).sum::<f64>() * deviation;
            let xyz_mm = place + Vector3::new(noise(0.1), noise(0.1), noise(0.25));
            if !(hidden && place.z > other.z) {
                reports.push(Report { xyz_mm, score: 0.9, track_id: -1, class_index, age_s: 0.0 });
            }
        }
        // Reports come in any order.
        if random.below(2) == 0 {
            reports.reverse();
        }
        let _ = step(&mut tracker, tick, &reports);
        if let Some((place, _)) = tracker.state() {
            known += 1;
            worst = worst.max((place - one).norm());
        }
    }
    (f64::from(known) / 240.0, worst)
}

#[test]
fn a_tool_that_passes_before_the_leading_one_takes_no_lead() {
    // As in the rehearsal: 8 mm before it, in front of it for a third of a second or more.
    for (hides_mm, seed) in [(2.5, 1), (2.5, 2), (4.0, 3), (4.0, 4)] {
        let rest = |_: f64| Vector3::new(7.5, 0.0, 66.0);
        let pass = |t: f64| Vector3::new(7.5 - 18.0 * (t / 8.0 * std::f64::consts::TAU).cos(), 2.0, 58.0);
        let (known, worst) = cross([&rest, &pass], hides_mm, [0, 0], seed);
        assert!(known > 0.85 && worst < 3.0, "hidden within {hides_mm} mm: known {known}, off by {worst} mm");
    }
}

#[test]
fn tools_that_cross_while_both_move_keep_their_names() {
    // Both at the same depth, 12 mm/s towards each other: for a moment there is one place for both.
    let one = |t: f64| Vector3::new(7.5 + 12.0 * (t - 4.0).clamp(-1.5, 1.5), 0.5, 66.0);
    let two = |t: f64| Vector3::new(7.5 - 12.0 * (t - 4.0).clamp(-1.5, 1.5), -0.5, 66.0);
    for seed in 1..6 {
        // The tool nearer to the middle leads, here by a hair: the second one starts farther out.
        let far = |t: f64| two(t) + Vector3::new(1.0, 0.0, 0.0);
        let (known, worst) = cross([&one, &far], 0.0, [0, 0], seed);
        assert!(known > 0.99 && worst < 3.0, "seed {seed}: known {known}, off by {worst} mm");
    }
}

#[test]
fn classes_distinguish_tools_where_positions_do_not() {
    // They meet, stay together for a second, and each goes back where it came from: only the class distinguishes them.
    let one = |t: f64| Vector3::new(7.5 - 12.0 * ((t - 4.0).abs() - 0.5).clamp(0.0, 1.5), 0.0, 66.0);
    let two = |t: f64| Vector3::new(11.0 + 12.0 * ((t - 4.0).abs() - 0.5).clamp(0.0, 1.6), 0.0, 66.0);
    for seed in 1..6 {
        let (known, worst) = cross([&one, &two], 0.0, [3, 5], seed);
        assert!(known > 0.99 && worst < 4.0, "seed {seed}: known {known}, off by {worst} mm");
    }
}

#[test]
fn two_reports_of_one_tip_are_one_tip() {
    let mut tracker = Tracker::default();
    for tick in 0..60 {
        let other = Report { xyz_mm: Vector3::new(1.0, 0.5, 65.5), ..report(0.0, -1) };
        assert!(matches!(step(&mut tracker, tick, &[report(0.0, -1), other]), Known::Seen(_)));
        assert_eq!(tracker.count(), 1);
    }
}

/// A number that breaks careless arithmetic.
fn hostile(random: &mut SplitMix64) -> f64 {
    match random.below(8) {
        0 => f64::NAN,
        1 => f64::INFINITY,
        2 => f64::NEG_INFINITY,
        3 => f64::MAX,
        4 => f64::MIN_POSITIVE,
        5 => -0.0,
        6 => f64::from_bits(random.bits()),
        _ => (unit(random.bits()) - 0.5) * 1e6,
    }
}

#[test]
fn any_number_of_tips_is_accepted() {
    let (mut tracker, mut random) = (Tracker::default(), SplitMix64(9));
    for tick in 0..400 {
        let any = |random: &mut SplitMix64| (unit(random.bits()) - 0.5) * 200.0;
        let reports: Vec<Report> = (0..random.below(40))
            .map(|_| Report {
                xyz_mm: if random.below(9) == 0 {
                    Vector3::from_fn(|_, _| hostile(&mut random))
                } else {
                    Vector3::new(any(&mut random), any(&mut random), 60.0 + any(&mut random))
                },
                score: if random.below(9) == 0 { hostile(&mut random) } else { 0.9 },
                track_id: random.below(12) as i64 - 4,
                class_index: random.below(3) as u32,
                age_s: if random.below(5) == 0 { hostile(&mut random) } else { 0.0 },
            })
            .collect();
        step(&mut tracker, tick, &reports);
        assert!(tracker.count() <= 8);
        assert!(tracker.state().is_none_or(|(place, speed)| place.iter().chain(speed.iter()).all(|v| v.is_finite())));
    }
}

#[test]
fn late_reports_are_moved_to_where_the_tip_is_now() {
    let mut tracker = Tracker::default();
    let trajectory = |seconds: f64| 20.0 * seconds;
    let mut worst: f64 = 0.0;
    for tick in 0..90_i64 {
        let now_s = tick as f64 / 30.0;
        // A detector at 15 Hz whose reports are 0.1 s old, as if seen by a camera that did not move.
        let late = Report { age_s: 0.1, ..report(trajectory(now_s - 0.1), -1) };
        let reports = if tick % 2 == 0 { vec![late] } else { vec![] };
        step(&mut tracker, tick, &reports);
        if tick > 60 {
            worst = worst.max((tracker.state().expect("followed").0.x - trajectory(now_s)).abs());
        }
    }
    assert!(worst < 0.6, "{worst} mm; it moved 2 mm in 0.1 s");
}
