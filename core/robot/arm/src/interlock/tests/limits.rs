//! The limits of set-points and of encoders, at their edges.

use super::*;

#[test]
fn limits_are_the_constants_lowered_by_the_arms_file() {
    let chain = changed(&[("effort=\"10\" velocity=\"0.4\"", "effort=\"10\" velocity=\"0.2\"")]);
    let limits = Caps::of(&chain);
    assert_eq!((limits.speed[5], limits.speed[0]), (0.2, 0.4));
    let fast = Caps::of(&changed(&[("velocity=\"0.4\"", "velocity=\"3.0\"")]));
    assert_eq!(fast.speed, JointVector::from_element(0.4), "a file cannot raise them");
    assert_eq!(fast.acceleration, JointVector::from_element(2.0));
    assert_eq!(fast.jerk, JointVector::from_element(30.0));
    assert_eq!((limits.lower_rad[1], limits.upper_rad[4]), (-1.2, 1.8));
}

#[test]
fn angles_may_reach_their_limits_and_plans_stay_off_by_a_margin() {
    let limits = Caps::of(&shipped());
    assert!(limits.angles_allowed(&limits.lower_rad, false) && limits.angles_allowed(&limits.upper_rad, false));
    for k in 0..JOINTS {
        for (with_margin, margin) in [(false, 0.0), (true, 0.012)] {
            let mut angles = JointVector::zeros();
            for (edge, outward) in [(limits.lower_rad[k] + margin, -1e-9), (limits.upper_rad[k] - margin, 1e-9)] {
                angles[k] = edge;
                assert!(limits.angles_allowed(&angles, with_margin), "joint {k} at {edge}");
                angles[k] = edge + outward;
                assert!(!limits.angles_allowed(&angles, with_margin), "joint {k} beyond {edge}");
            }
            angles[k] = f64::NAN;
            assert!(!limits.angles_allowed(&angles, with_margin));
        }
    }
}

#[test]
fn a_tube_may_reach_its_limits_and_plans_stay_off_by_a_margin() {
    let middle = TubePose { pivot_mm: 0.0, depth_mm: 100.0, tilt_rad: 0.0 };
    for (with_margin, pivot_mm, tilt_rad, depth_mm) in
        [(false, 1.0, 0.6, (20.0, 190.0)), (true, 1.0 - 0.15, 0.6 - 0.01, (20.0 + 1.0, 190.0 - 1.0))]
    {
        let (inside, small) = (|pose: TubePose| pose.is_allowed(with_margin), 1e-9);
        assert!(inside(TubePose { pivot_mm, ..middle }) && !inside(TubePose { pivot_mm: pivot_mm + small, ..middle }));
        assert!(inside(TubePose { tilt_rad, ..middle }) && !inside(TubePose { tilt_rad: tilt_rad + small, ..middle }));
        for (edge, beyond) in [(depth_mm.0, depth_mm.0 - small), (depth_mm.1, depth_mm.1 + small)] {
            assert!(inside(TubePose { depth_mm: edge, ..middle }) && !inside(TubePose { depth_mm: beyond, ..middle }));
        }
        for pose in [
            TubePose { pivot_mm: f64::NAN, ..middle },
            TubePose { tilt_rad: f64::NAN, ..middle },
            TubePose { depth_mm: f64::NAN, ..middle },
        ] {
            assert!(!inside(pose));
        }
    }
}

#[test]
fn a_camera_may_be_as_fast_as_its_limit_less_the_margin() {
    let limits = Caps::of(&shipped());
    assert!(limits.camera_allowed(60.0 * 0.93) && !limits.camera_allowed(60.0 * 0.93 + 1e-9));
    assert!(!limits.camera_allowed(f64::NAN));
}

#[test]
fn a_share_is_the_largest_of_all_joints() {
    let limits = JointVector::from_fn(|k, _| 1.0 + k as f64);
    assert_eq!(share(&JointVector::zeros(), &limits), 0.0);
    assert_eq!(share(&joint(0, -0.5), &limits), 0.5);
    assert_eq!(share(&(joint(1, 0.5) + joint(5, -12.0)), &limits), 2.0);
}

#[test]
fn the_tubes_pose_is_that_of_its_axis() {
    let chain = shipped();
    let home = chain.stance(&JointVector::zeros()).base_from_tip * Vector3::z();
    let at_home = TubePose::of(&chain, &chain.stance(&JointVector::zeros()), &home);
    assert!(at_home.pivot_mm < 1e-6 && at_home.tilt_rad < 1e-6 && (at_home.depth_mm - 110.0).abs() < 1e-6);
    // The pitch of the wrist, 270 mm above the trocar.
    let tilted = TubePose::of(&chain, &chain.stance(&joint(4, 0.1)), &home);
    assert!((tilted.tilt_rad - 0.1).abs() < 1e-9, "{tilted:?}");
    assert!((tilted.pivot_mm - 270.0 * 0.1_f64.sin()).abs() < 1e-6, "{tilted:?}");
    assert!((tilted.depth_mm - (380.0 - 270.0 * 0.1_f64.cos())).abs() < 1e-6, "{tilted:?}");
}

/// Turns a joint evenly, in answers 10 ms apart; the first cause.
fn turning(chain: &Chain, index: usize, from_rad: f64, rad_s: f64) -> Option<Cause> {
    let mut measured = Measured::new(chain);
    (0..100).find_map(|k| measured.check(chain, k * 10 * MS, &joint(index, from_rad + rad_s * k as f64 * 0.01)))
}

#[test]
fn a_measured_speed_has_a_quarter_and_the_noise_above_its_limit() {
    for sign in [1.0, -1.0] {
        assert_eq!(turning(&shipped(), 5, 0.0, sign * 0.519), None);
        assert_eq!(turning(&shipped(), 5, 0.0, sign * 0.521), Some(Cause::MeasuredSpeed));
    }
    let slow = changed(&[("effort=\"10\" velocity=\"0.4\"", "effort=\"10\" velocity=\"0.2\"")]);
    assert_eq!(turning(&slow, 5, 0.0, 0.2 * 1.25 + 0.019), None);
    assert_eq!(turning(&slow, 5, 0.0, 0.2 * 1.25 + 0.021), Some(Cause::MeasuredSpeed));
}

#[test]
fn a_measured_speed_is_taken_over_60_ms() {
    let chain = shipped();
    let jump = joint(5, 0.0315);
    for (passed_ms, cause) in [(59, None), (60, Some(Cause::MeasuredSpeed)), (61, None)] {
        let mut measured = Measured::new(&chain);
        assert_eq!(measured.check(&chain, 0, &JointVector::zeros()), None);
        assert_eq!(measured.check(&chain, passed_ms * MS, &jump), cause, "{passed_ms} ms");
    }
    // The same answer says nothing new, also beyond a limit.
    let mut measured = Measured::new(&chain);
    assert_eq!(measured.check(&chain, 5, &JointVector::zeros()), None);
    assert_eq!(measured.check(&chain, 5, &joint(0, 1.0)), None);
    assert_eq!(measured.check(&chain, 6, &joint(0, 1.0)), Some(Cause::MeasuredWorkspace));
    // A short jump counts against the newest answer that is long enough ago, not against an older one.
    let mut measured = Measured::new(&chain);
    for k in 0..40 {
        assert_eq!(measured.check(&chain, k * 10 * MS, &JointVector::zeros()), None);
    }
    assert_eq!(measured.check(&chain, 400 * MS, &jump), Some(Cause::MeasuredSpeed));
    // 16 answers are kept: with answers every 2 ms none is 60 ms old.
    let mut measured = Measured::new(&chain);
    for k in 0..40 {
        assert_eq!(measured.check(&chain, k * 2 * MS, &JointVector::zeros()), None);
    }
    assert_eq!(measured.check(&chain, 80 * MS, &jump), None);
}

#[test]
fn measured_angles_have_a_margin_beyond_their_limits() {
    let chain = shipped();
    let limits = Caps::of(&chain);
    let cause = |rad: f64| Measured::new(&chain).check(&chain, 0, &joint(5, rad));
    for (edge, outward) in [(limits.lower_rad[5] - 0.01, -1e-9), (limits.upper_rad[5] + 0.01, 1e-9)] {
        assert_eq!(cause(edge), None, "{edge}");
        assert_eq!(cause(edge + outward), Some(Cause::MeasuredWorkspace), "{edge}");
    }
}

#[test]
fn measured_poses_have_a_margin_beyond_their_limits() {
    let outside = Some(Cause::MeasuredWorkspace);
    let at_home = |chain: &Chain| Measured::new(chain).check(chain, 0, &JointVector::zeros());
    for (depth_mm, cause) in [(18.99, outside), (19.01, None), (190.99, None), (191.01, outside)] {
        assert_eq!(at_home(&deep(depth_mm)), cause, "{depth_mm} mm");
    }
    let chain = about_trocar();
    for (tilt_rad, cause) in [(0.609, None), (0.611, outside), (-0.609, None), (-0.611, outside)] {
        assert_eq!(Measured::new(&chain).check(&chain, 0, &joint(4, tilt_rad)), cause, "{tilt_rad} rad");
    }
    let chain = shipped();
    for (pivot_mm, cause) in [(1.499, None), (1.501, outside)] {
        let angle = (pivot_mm / 270.0_f64).asin();
        assert_eq!(Measured::new(&chain).check(&chain, 0, &joint(4, angle)), cause, "{pivot_mm} mm");
    }
}

#[test]
fn causes_have_numbers_words_and_come_back() {
    let mut words: Vec<&str> = Cause::ALL.iter().map(|cause| cause.words()).collect();
    for (index, cause) in Cause::ALL.into_iter().enumerate() {
        assert_eq!(cause.number(), index + 1);
        assert_eq!(Cause::from_number(cause.number()), Some(cause));
        assert_eq!(cause.to_string(), cause.words());
        assert!(cause.words().len() > 8);
    }
    words.sort_unstable();
    words.dedup();
    assert_eq!(words.len(), Cause::ALL.len(), "each has words of its own");
    assert_eq!((Cause::from_number(0), Cause::from_number(Cause::ALL.len() + 1)), (None, None));
    // Those that pass by themselves.
    let passing: Vec<Cause> = Cause::ALL.into_iter().filter(|cause| !cause.latches()).collect();
    let expected = [
        Cause::Clock,
        Cause::NoTip,
        Cause::OldTip,
        Cause::DoubtfulTip,
        Cause::FlatTip,
        Cause::NoDemand,
        Cause::LoopStalled,
        Cause::BadDemand,
        Cause::Limit,
    ];
    assert_eq!(passing, expected);
}

#[test]
fn an_event_says_what_happened_and_what_it_takes() {
    let event = Event { at_ns: 1_500 * MS, stop: Some(Cause::OldTip), speed_rad_s: 0.25 };
    assert_eq!(event.to_string(), "at 1500 ms the arm stops from 0.250 rad/s: the tip is too old");
    let latched = Event { stop: Some(Cause::EmergencyStop), ..event }.to_string();
    assert!(latched.ends_with("emergency stop; it stays stopped until `reset` is given another number"), "{latched}");
    assert_eq!(Event { stop: None, ..event }.to_string(), "at 1500 ms the arm moves again");
}
