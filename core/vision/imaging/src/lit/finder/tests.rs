//! The finder on rendered scopes: rims of all kinds, and darkness that is not a rim.

use super::*;

const SIZE: (usize, usize) = (320, 240);

/// A scene that moves with time: tissue-like waves of 60 to 180 levels.
fn tissue(x: f64, y: f64, time: f64) -> f64 {
    120.0 + 35.0 * ((x + 9.0 * time) * 0.05).sin() + 25.0 * ((y - 5.0 * time) * 0.083 + x * 0.02).cos()
}

fn noise(x: usize, y: usize, time: usize) -> f64 {
    let mut h = (x as u64) << 32 ^ (y as u64) << 12 ^ time as u64;
    h = (h ^ h >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    ((h ^ h >> 32) & 0xff) as f64 / 255.0 - 0.5
}

/// BGR: red tissue where `lit` holds, times `light`, and `rim` levels elsewhere, both with noise.
fn frame(time: usize, rim: f64, lit: impl Fn(f64, f64) -> bool, light: impl Fn(f64, f64) -> f64) -> Vec<u8> {
    let mut data = Vec::with_capacity(SIZE.0 * SIZE.1 * 3);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (u, v) = (x as f64, y as f64);
            let red = if lit(u, v) { rim.max(tissue(u, v, time as f64) * light(u, v)) } else { rim };
            let red = red + 6.0 * noise(x, y, time);
            let dull = if lit(u, v) { 0.5 } else { 1.0 };
            data.extend([red * dull, red * dull, red].map(|v| v.clamp(0.0, 255.0) as u8));
        }
    }
    data
}

fn view(data: &[u8]) -> View<'_, u8> {
    View::new(data, SIZE.0, SIZE.1, 3)
}

fn full(_: f64, _: f64) -> f64 {
    1.0
}

/// No pixel outside, and all inside but for `margin` px from the rim.
fn assert_fits(part: &LitPart, lit: impl Fn(f64, f64) -> bool, margin: f64, what: &str) {
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (u, v) = (x as f64, y as f64);
            let is_found = part.contains(x, y);
            assert!(!is_found || lit(u, v), "{what}: {x}, {y} is rim");
            let steps = [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (0.7, 0.7), (-0.7, 0.7)];
            let inside = |p: f64, size: usize| p.clamp(0.0, (size - 1) as f64);
            let deep = |(a, b): (f64, f64)| lit(inside(u + a * margin, SIZE.0), inside(v + b * margin, SIZE.1));
            let mirrored = steps.map(|(a, b)| (-a, -b));
            if steps.into_iter().chain(mirrored).all(deep) {
                assert!(is_found, "{what}: {x}, {y} is lit");
            }
        }
    }
}

fn round(u: f64, v: f64) -> bool {
    (u - 163.0).hypot(v - 117.0) < 139.0
}

fn small_round(u: f64, v: f64) -> bool {
    (u - 150.0).hypot(v - 120.0) < 100.0
}

fn letterbox(_: f64, v: f64) -> bool {
    (31.0..=208.0).contains(&v)
}

fn bordered(u: f64, v: f64) -> bool {
    (7.0..=310.0).contains(&u) && (5.0..=236.0).contains(&v)
}

/// As rectified views have it: slanted lines.
fn wedges(u: f64, v: f64) -> bool {
    u > 27.0 + 0.02 * v && v > 10.0 - 0.016 * u && v < 238.0 - 0.014 * u
}

#[test]
fn rims_of_all_kinds_are_found_in_the_first_frame_and_stay() {
    type Lit = fn(f64, f64) -> bool;
    let rims: [(&str, Lit); 5] = [
        ("round", round),
        ("small and round", small_round),
        ("letterbox", letterbox),
        ("bordered", bordered),
        ("wedges", wedges),
    ];
    for (what, lit) in rims {
        for rim in [3.0, 16.0] {
            let mut finder = LitFinder::default();
            for time in 0..24 {
                let data = frame(time, rim, lit, full);
                finder.look(view(&data), None);
                assert_fits(finder.part(), lit, 9.0, what);
            }
            // Nothing changes any more: what comes next is not computed again.
            assert!(!(24..48).any(|time| finder.look(view(&frame(time, rim, lit, full)), None)), "{what}");
        }
    }
}

#[test]
fn a_dark_scene_is_not_masked() {
    // No light at all, the light of a corner that falls off, a deep cavity at the left, and a dark scene.
    type Light = fn(f64, f64) -> f64;
    let scenes: [(&str, Light); 4] = [
        ("no light", |_, _| 0.0),
        ("light that falls off", |u, v| (1.0 - (u - 160.0).hypot(v - 120.0) / 170.0).clamp(0.0, 1.0)),
        ("cavity", |u, _| ((u - 40.0) / 150.0).clamp(0.0, 1.0)),
        ("dim", |_, _| 0.12),
    ];
    for (what, light) in scenes {
        let mut finder = LitFinder::default();
        for time in 0..24 {
            finder.look(view(&frame(time, 2.0, |_, _| true, light)), None);
            assert!(finder.part().is_whole(), "{what}, frame {time}");
        }
    }
}

#[test]
fn a_jagged_edge_of_a_cavity_is_not_a_rim() {
    let mut finder = LitFinder::default();
    let cavity = |u: f64, v: f64| u > 60.0 + 26.0 * (v * 0.06).sin() + 14.0 * (v * 0.21).sin();
    finder.look(view(&frame(0, 2.0, cavity, full)), None);
    assert!(finder.part().is_whole());
}

#[test]
fn darkness_within_the_rim_does_not_shrink_it() {
    // A light that goes off, and tissue in the shade at one side, after and before full light.
    let shade = |u: f64, _: f64| if u < 140.0 { 0.03 } else { 1.0 };
    let mut finder = LitFinder::default();
    for time in 0..16 {
        finder.look(view(&frame(time, 3.0, round, full)), None);
    }
    for time in 16..40 {
        finder.look(view(&frame(time, 3.0, round, if time % 2 == 0 { shade } else { |_, _| 0.0 })), None);
        assert_fits(finder.part(), round, 9.0, "shade");
    }
    let mut finder = LitFinder::default();
    for time in 0..32 {
        finder.look(view(&frame(time, 3.0, round, if time < 8 { shade } else { full })), None);
    }
    assert_fits(finder.part(), round, 9.0, "light after shade");
}

#[test]
fn lines_of_video_devices_and_text_in_the_rim_do_not_count() {
    let mut finder = LitFinder::default();
    for time in 0..16 {
        let mut data = frame(time, 8.0, round, full);
        for y in 0..SIZE.1 {
            data[y * SIZE.0 * 3..][..6].fill(190);
        }
        data[SIZE.0 * 3 + 30..][..120].fill(210);
        // Strokes two px wide.
        for y in 12..20 {
            for x in [12, 13, 18, 19, 24, 25] {
                data[(y * SIZE.0 + x) * 3..][..3].fill(230);
            }
        }
        finder.look(view(&data), None);
    }
    assert_fits(finder.part(), round, 9.0, "lines");
}

#[test]
fn a_rim_that_a_coupler_moved_is_found_again() {
    let mut finder = LitFinder::default();
    let small: Vec<Vec<u8>> = (0..4).map(|time| frame(time, 3.0, small_round, full)).collect();
    let large: Vec<Vec<u8>> = (0..4).map(|time| frame(time, 3.0, round, full)).collect();
    (0..16).for_each(|time| _ = finder.look(view(&large[time % 4]), None));
    // What is lit now is used at once, what is dark now after two windows.
    (0..2 * WINDOW_FRAMES as usize + 16).for_each(|time| _ = finder.look(view(&small[time % 4]), None));
    assert_fits(finder.part(), small_round, 9.0, "zoomed out");
    (0..40).for_each(|time| _ = finder.look(view(&large[time % 4]), None));
    assert_fits(finder.part(), round, 9.0, "zoomed in");
}

#[test]
fn outside_the_valid_part_nothing_is_lit() {
    let mut valid = LitPart::whole(SIZE.0, SIZE.1);
    (0..SIZE.1).for_each(|y| valid.set_row(y, 90..SIZE.0));
    let mut finder = LitFinder::default();
    finder.look(view(&frame(0, 3.0, round, full)), Some(&valid));
    assert_fits(finder.part(), |u, v| round(u, v) && u >= 90.0, 9.0, "valid");
}
