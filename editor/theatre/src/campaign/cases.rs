//! Single faults of cameras and processes: what the window shows of each.

use super::*;

/// A run in which nothing happens by itself, and some seconds of it.
fn calm(reading: Reading, views: usize) -> Run {
    let mut run = Run::of(reading, views, SplitMix64(7));
    run.world.borrow_mut().is_calm = true;
    pass(&mut run, 2000);
    run
}

/// Looks at every frame for a time: ten a second, as slow as the window draws.
fn pass(run: &mut Run, ms: usize) {
    (0..ms / 100).for_each(|_| run.draw(10, true).unwrap_or_else(|error| panic!("{error}")));
}

fn perform(run: &mut Run, action: Action) {
    run.harness.state_mut().as_mut().expect("it is open").perform(action);
}

#[test]
fn a_frozen_picture_is_as_old_as_it_was() {
    for views in 0..VIEWS {
        let mut run = calm(Reading::Apart, views);
        for n in 0..2 {
            run.world.borrow_mut().set(n, CameraState::Silent);
        }
        pass(&mut run, 1500);
        let dimmed = run.tally.dimmed;
        perform(&mut run, Action::Freeze);
        pass(&mut run, 500);
        assert!(run.theatre().is_frozen() && run.tally.dimmed > dimmed);
        // Frozen for long, then nothing new comes.
        let mut run = calm(Reading::Apart, views);
        perform(&mut run, Action::Freeze);
        pass(&mut run, 3000);
        for n in 0..2 {
            run.world.borrow_mut().set(n, CameraState::Silent);
        }
        pass(&mut run, 100);
        perform(&mut run, Action::Freeze);
        pass(&mut run, 500);
    }
}

#[test]
fn a_view_that_comes_into_sight_again_is_dimmed_until_its_next_image() {
    let mut run = calm(Reading::Apart, 0);
    perform(&mut run, Action::One(3));
    pass(&mut run, 3000);
    for n in 0..2 {
        run.world.borrow_mut().set(n, CameraState::Silent);
    }
    pass(&mut run, 200);
    for view in [0, 1, 2] {
        perform(&mut run, Action::One(view));
        pass(&mut run, 200);
    }
}

#[test]
fn after_a_restart_no_image_of_the_run_before_is_shown() {
    for views in 0..VIEWS {
        let mut run = calm(Reading::Single, views);
        run.world.borrow_mut().fail();
        pass(&mut run, 3000);
        perform(&mut run, Action::Again);
        pass(&mut run, 3000);
    }
}

#[test]
fn a_camera_that_sends_the_same_image_again_and_again_is_named_and_dimmed() {
    for reading in Reading::ALL {
        let mut run = calm(reading, 0);
        let now_ms = run.world.borrow().ms;
        run.world.borrow_mut().set(0, CameraState::Stuck(now_ms));
        pass(&mut run, 3000);
        let name = &run.titles[usize::from(LEFT)].last().expect("a camera").clone();
        let notices = run.theatre().notices();
        assert!(notices[0].message.starts_with(&format!("{name} stuck: the same image for 2 s")), "{notices:?}");
        assert!(notices.iter().all(|notice| !notice.message.contains("Right")), "{notices:?}");
        run.world.borrow_mut().set(0, CameraState::Live);
        pass(&mut run, 1000);
        assert!(run.theatre().notices().is_empty(), "{:?}", run.theatre().notices());
    }
}

/// Whether a notice says that left and right are swapped.
fn says_swapped(run: &Run) -> bool {
    run.theatre().notices().iter().any(|notice| notice.message.contains("swapped"))
}

#[test]
fn an_image_of_swapped_views_says_so_until_a_new_one_comes() {
    for (views, is_3d) in [(1, false), (2, false), (2, true)] {
        let mut run = calm(Reading::Single, views);
        if is_3d {
            perform(&mut run, Action::ThreeD);
        }
        run.world.borrow_mut().swap();
        // Frozen before the graph can know it.
        pass(&mut run, 1000);
        perform(&mut run, Action::Freeze);
        pass(&mut run, 3000);
        assert!(says_swapped(&run));
        run.world.borrow_mut().swap();
        pass(&mut run, 4000);
        assert!(run.theatre().is_frozen() && says_swapped(&run), "{:?}", run.theatre().notices());
        perform(&mut run, Action::Freeze);
        pass(&mut run, 500);
        assert!(!says_swapped(&run), "{:?}", run.theatre().notices());
    }
}

/// Measures a length in the image of this moment.
fn measure(run: &mut Run) {
    perform(run, Action::Measure);
    pass(run, 500);
    for x in [0.3, 0.6] {
        run.harness.state_mut().as_mut().expect("it is open").measure.tap(x, 0.5);
    }
    let before = run.tally.lengths;
    pass(run, 300);
    assert!(run.tally.lengths > before, "there is no reason against it yet");
}

#[test]
fn a_length_of_swapped_views_does_not_come_back() {
    let mut run = calm(Reading::Single, 3);
    run.world.borrow_mut().swap();
    pass(&mut run, 300);
    measure(&mut run);
    pass(&mut run, 3000);
    let before = run.tally.lengths;
    run.world.borrow_mut().swap();
    pass(&mut run, 4000);
    assert_eq!(run.tally.lengths, before);
}

#[test]
fn views_of_two_instants_give_no_length() {
    let mut run = calm(Reading::Single, 3);
    measure(&mut run);
    run.world.borrow_mut().is_out_of_step = true;
    pass(&mut run, 1000);
    let before = run.tally.lengths;
    let notices = run.theatre().notices();
    assert!(notices[0].message.starts_with("The cameras show different instants"), "{notices:?}");
    run.world.borrow_mut().is_out_of_step = false;
    pass(&mut run, 2000);
    assert_eq!(run.tally.lengths, before);
    assert!(run.theatre().notices().is_empty(), "{:?}", run.theatre().notices());
}

#[test]
fn views_that_were_swapped_when_the_process_died_are_still_called_so() {
    for (views, is_3d) in [(1, false), (2, true), (3, false)] {
        let mut run = calm(Reading::Single, views);
        if is_3d {
            perform(&mut run, Action::ThreeD);
        }
        run.world.borrow_mut().swap();
        pass(&mut run, 3000);
        run.world.borrow_mut().crash();
        // No node has looked at the cameras of the next process yet.
        for _ in 0..60 {
            pass(&mut run, 100);
            assert!(says_swapped(&run), "{:?}", run.theatre().notices());
        }
        run.world.borrow_mut().swap();
        pass(&mut run, 3000);
        assert!(!says_swapped(&run), "{:?}", run.theatre().notices());
    }
}

/// Looks at every frame for a time: fifty a second, as many as a fast machine draws.
fn pass_finely(run: &mut Run, ms: usize) {
    (0..ms / 20).for_each(|_| run.draw(2, true).unwrap_or_else(|error| panic!("{error}")));
}

#[test]
fn what_was_made_of_a_stuck_camera_stays_old_when_it_goes_on() {
    let goes_on = [CameraState::Live, CameraState::Late(500), CameraState::Late(2850)];
    for (reading, state) in [Reading::Together, Reading::Apart].into_iter().flat_map(|r| goes_on.map(|s| (r, s))) {
        for is_3d in [false, true] {
            let mut run = calm(reading, 0);
            if is_3d {
                perform(&mut run, Action::ThreeD);
            }
            let now_ms = run.world.borrow().ms;
            run.world.borrow_mut().set(1, CameraState::Stuck(now_ms));
            pass(&mut run, 3000);
            run.world.borrow_mut().set(1, state);
            pass_finely(&mut run, 600);
        }
    }
}
