use panoscope_base::Threads;

use super::disturb;
use super::disturbance::Disturbance;
use super::scenes::SIZE;
use super::*;

fn condition(name: &str) -> &'static Condition {
    CONDITIONS.iter().find(|condition| condition.name == name).expect("a condition of the set")
}

/// Level of a view between two pixels of a row, mean of the channels.
fn level(view: &SyntheticView, x: f64, y: usize) -> f64 {
    let left = (x.floor().max(0.0) as usize).min(SIZE.0 - 2);
    let at = |x: usize| view.bgr[3 * (y * SIZE.0 + x)..][..3].iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0;
    let part = (x - left as f64).clamp(0.0, 1.0);
    at(left) * (1.0 - part) + at(left + 1) * part
}

/// Mean difference of the left view from the right one warped by the truth plus `off_px`, over what both see.
fn warp_difference(SyntheticPair([left, right]): &SyntheticPair, off_px: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for index in (0..SIZE.0 * SIZE.1).filter(|index| left.visible[*index] != 0) {
        let (x, y) = (index % SIZE.0, index / SIZE.0);
        let to = x as f64 - f64::from(left.disparity[index]) - off_px;
        if to >= 0.0 && to < SIZE.0 as f64 - 1.0 {
            sum += (level(left, x as f64, y) - level(right, to, y)).abs();
            count += 1;
        }
    }
    sum / f64::from(count)
}

/// Pixels that both cameras see, and those of them where the other view's truth is another.
fn disagreeing(SyntheticPair([left, right]): &SyntheticPair) -> [(usize, usize); 2] {
    [(left, right, -1.0), (right, left, 1.0)].map(|(own, other, sign)| {
        let (mut seen, mut apart) = (0, 0);
        for index in (0..SIZE.0 * SIZE.1).filter(|index| own.visible[*index] != 0) {
            let to = (index % SIZE.0) as f32 + sign * own.disparity[index];
            let there = other.disparity[index / SIZE.0 * SIZE.0 + to.round() as usize];
            seen += 1;
            // Half a column along a slope, or across an edge.
            apart += usize::from((there - own.disparity[index]).abs() > 1.0);
        }
        (seen, apart)
    })
}

#[test]
fn the_truth_explains_both_views() {
    for name in ["slanted", "range"] {
        let pair = render(condition(name), 101, &Threads::new(2));
        // Noise alone leaves about 1.1 levels.
        let at_truth = warp_difference(&pair, 0.0);
        assert!(at_truth < 2.0, "{name}: {at_truth} levels");
        // The truth is exact to a fraction of a pixel: a map half a pixel off explains the views worse.
        for off_px in [-0.5, 0.5] {
            let beside = warp_difference(&pair, off_px);
            assert!(beside > 1.04 * at_truth, "{name}: {beside} levels {off_px} px beside, {at_truth} at the truth");
        }
        for (seen, apart) in disagreeing(&pair) {
            assert!(seen > SIZE.0 * SIZE.1 / 2, "{name}: {seen} seen");
            assert!(apart * 50 < seen, "{name}: {apart} of {seen} apart");
        }
    }
}

#[test]
fn ranges_are_those_of_the_conditions_and_what_is_hidden_is_marked() {
    let pool = Threads::new(2);
    for seed in TUNING_SEEDS.into_iter().chain(HELD_OUT_SEEDS) {
        let (disparity, visible) = render::truth(&scenes::scene(condition("range"), seed), false, &pool);
        let least = disparity.iter().copied().fold(f32::MAX, f32::min);
        let most = disparity.iter().copied().fold(f32::MIN, f32::max);
        assert!((15.0..35.0).contains(&least) && (180.0..200.0).contains(&most), "seed {seed}: {least} to {most} px");
        let (mut outside, mut behind) = (0, 0);
        for (index, (visible, d)) in visible.iter().zip(&disparity).enumerate() {
            let is_outside = ((index % SIZE.0) as f32) < d - 0.01;
            assert!(!is_outside || *visible == 0, "seed {seed}: column {} lies outside the right view", index % SIZE.0);
            outside += usize::from(is_outside);
            behind += usize::from(!is_outside && *visible == 0);
        }
        // Left of the instruments the ground is hidden from the right camera.
        assert!(outside > 5000 && behind > 2000, "seed {seed}: {outside} outside, {behind} behind");
    }
    let (disparity, _) = render::truth(&scenes::scene(condition("thin"), 101), false, &pool);
    assert!(disparity.iter().all(|d| (30.0..110.0).contains(d)));
}

#[test]
fn seeds_repeat_and_threads_do_not_show() {
    let bytes = |threads: usize| {
        let SyntheticPair([left, right]) = render(condition("faint"), 5, &Threads::new(threads));
        (left.bgr, right.bgr, left.visible)
    };
    assert!(bytes(1) == bytes(3));
    let truth = |seed: u64| render::truth(&scenes::scene(condition("faint"), seed), false, &Threads::new(2)).0;
    assert!(truth(5) != truth(6));
}

#[test]
fn disturbances_do_what_they_say() {
    let pool = Threads::new(2);
    let mean = |view: &SyntheticView| view.bgr.iter().map(|v| f64::from(*v)).sum::<f64>() / view.bgr.len() as f64;
    let light = render::render(&scenes::scene(condition("thin"), 101), &pool);
    let plain = disturb::develop(light.clone(), Disturbance::None, 101, &pool);
    for condition in CONDITIONS.iter().filter(|condition| condition.disturbance != Disturbance::None) {
        let name = condition.name;
        // What happens behind the lens needs no other light.
        let views = match condition.disturbance {
            Disturbance::Rows | Disturbance::Blood | Disturbance::Highlights => render(condition, 101, &pool).0,
            other => disturb::develop(light.clone(), other, 101, &pool),
        };
        assert!(views[0].disparity == plain[0].disparity, "{name} has the scene of `thin`");
        let changed = views[1].bgr.iter().zip(&plain[1].bgr).filter(|(a, b)| a.abs_diff(**b) > 1).count();
        assert!(changed > plain[1].bgr.len() / 100, "{name}: {changed} bytes changed");
        match name {
            "exposure" => assert!(mean(&views[1]) < 0.85 * mean(&views[0])),
            "smoke" => assert!(mean(&views[0]) > 1.15 * mean(&plain[0])),
            "blood" => assert!(mean(&views[0]) < 0.95 * mean(&plain[0])),
            "highlights" => {
                let is_burnt = |pixel: &&[u8; 3]| pixel.iter().all(|value| *value > 250);
                let burnt = |view: &SyntheticView| view.bgr.as_chunks::<3>().0.iter().filter(is_burnt).count();
                assert!(burnt(&plain[0]) == 0 && burnt(&views[0]) > 300, "{} burnt", burnt(&views[0]));
            }
            _ => {}
        }
    }
}
