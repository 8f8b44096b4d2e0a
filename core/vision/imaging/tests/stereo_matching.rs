//! Block matching and semi-global matching on surfaces whose disparity is known.

use crate::stereo_common::*;
use panoscope_base::Threads;
use panoscope_imaging::stereo::{
    BlockMatcher, BlockMatchingParams, SemiGlobalMatcher, SemiGlobalParams, StereoError, Tile,
};
use panoscope_imaging::{Parallel, Rect, Serial};

/// Either matcher, with the parameters that differ set alike.
enum Matcher {
    Block(BlockMatcher),
    SemiGlobal(SemiGlobalMatcher),
}

fn matchers(min_disparity_px: i32, search_px: usize) -> Vec<Matcher> {
    let block = BlockMatchingParams { min_disparity_px, search_px, block_px: 11, ..Default::default() };
    let semi = SemiGlobalParams { min_disparity_px, search_px, ..Default::default() };
    vec![Matcher::Block(BlockMatcher::new(block).unwrap()), Matcher::SemiGlobal(SemiGlobalMatcher::new(semi).unwrap())]
}

impl Matcher {
    fn portable(mut self) -> Self {
        match &mut self {
            Self::Block(matcher) => matcher.force_portable(),
            Self::SemiGlobal(matcher) => matcher.force_portable(),
        }
        self
    }

    fn run(
        &mut self,
        left: &[u8],
        right: &[u8],
        (width, height): (usize, usize),
        roi: Rect,
        pool: &dyn Parallel,
    ) -> (Vec<f32>, Vec<f32>) {
        let mut map = vec![7.0; width * height];
        let mut map_right = vec![7.0; width * height];
        let (l, r) = (gray(left, width, height), gray(right, width, height));
        let (out, out_right) = (plane_mut(&mut map, width, height), plane_mut(&mut map_right, width, height));
        match self {
            Self::Block(matcher) => matcher.compute(l, r, roi, pool, out, Some(out_right)),
            Self::SemiGlobal(matcher) => matcher.compute(l, r, roi, pool, out, Some(out_right)),
        }
        .unwrap();
        (map, map_right)
    }
}

/// Share of matched pixels and mean absolute error inside `x0..x1`, away from the top and bottom.
fn errors(
    map: &[f32],
    (width, height): (usize, usize),
    x0: usize,
    x1: usize,
    truth: impl Fn(f64, f64) -> f64,
) -> (f64, f64) {
    let (mut count, mut known, mut sum) = (0, 0, 0.0);
    for y in 10..height - 10 {
        for x in x0..x1 {
            count += 1;
            let value = f64::from(map[y * width + x]);
            if value.is_finite() {
                known += 1;
                sum += (value - truth(x as f64, y as f64)).abs();
            }
        }
    }
    (f64::from(known) / f64::from(count), sum / f64::from(known))
}

#[test]
fn whole_and_fractional_shifts_are_found_in_both_views() {
    let size = (200, 80);
    for shift in [0.0, 5.0, 17.0, 30.5, 12.25] {
        let (left, right) = plane_pair(size.0, size.1, [shift, 0.0, 0.0]);
        for mut matcher in matchers(0, 64) {
            let (map, map_right) = matcher.run(&left, &right, size, Rect::whole(size.0, size.1), &Serial);
            let limit = if shift.fract() == 0.0 { 0.1 } else { 0.25 };
            let (density, error) = errors(&map, size, 70, 190, |_, _| shift);
            assert!(density > 0.97 && error < limit, "left {shift}: density {density}, error {error}");
            let (density, error) = errors(&map_right, size, 20, 130, |_, _| shift);
            assert!(density > 0.99 && error < limit, "right {shift}: density {density}, error {error}");
        }
    }
}

#[test]
fn a_slanted_plane_is_found_to_a_fraction_of_a_pixel() {
    let size = (240, 100);
    let slant = [8.0, 0.05, 0.03];
    let (left, right) = plane_pair(size.0, size.1, slant);
    for mut matcher in matchers(0, 64) {
        let (map, _) = matcher.run(&left, &right, size, Rect::whole(size.0, size.1), &Serial);
        let (density, error) = errors(&map, size, 40, 230, |x, y| slant[0] + slant[1] * x + slant[2] * y);
        assert!(density > 0.9 && error < 0.2, "density {density}, error {error}");
    }
}

#[test]
fn an_offset_finds_what_a_search_from_zero_cannot() {
    let size = (400, 60);
    let (left, right) = plane_pair(size.0, size.1, [213.0, 0.0, 0.0]);
    let roi = Rect { x: 220, y: 5, width: 150, height: 50 };
    for (mut far, mut near) in matchers(200, 32).into_iter().zip(matchers(0, 64)) {
        let (map, _) = far.run(&left, &right, size, roi, &Serial);
        let (density, error) = errors(&map, size, 235, 360, |_, _| 213.0);
        assert!(density > 0.97 && error < 0.1, "offset: density {density}, error {error}");
        let (map, _) = near.run(&left, &right, size, roi, &Serial);
        let right_by_chance = map.iter().filter(|value| (**value - 213.0).abs() < 2.0).count();
        assert_eq!(right_by_chance, 0);
    }
}

#[test]
fn swapped_views_give_negative_disparities() {
    let size = (200, 60);
    let (left, right) = plane_pair(size.0, size.1, [9.0, 0.0, 0.0]);
    for mut matcher in matchers(-32, 32) {
        let (map, _) = matcher.run(&right, &left, size, Rect::whole(size.0, size.1), &Serial);
        let (density, error) = errors(&map, size, 15, 150, |_, _| -9.0);
        assert!(density > 0.97 && error < 0.1, "density {density}, error {error}");
    }
}

#[test]
fn nothing_is_written_outside_the_roi_and_unmatched_is_nan() {
    let size = (120, 70);
    let (left, right) = plane_pair(size.0, size.1, [6.0, 0.0, 0.0]);
    let roi = Rect { x: 30, y: 20, width: 40, height: 25 };
    for mut matcher in matchers(0, 32) {
        let (map, _) = matcher.run(&left, &right, size, roi, &Serial);
        let mut known = 0;
        for y in 0..size.1 {
            for x in 0..size.0 {
                let inside = (30..70).contains(&x) && (20..45).contains(&y);
                let value = map[y * size.0 + x];
                assert!(inside || value.is_nan(), "({x}, {y}) = {value}");
                known += usize::from(value.is_finite());
            }
        }
        assert!(known > 900);
    }
    // A flat picture has no texture to match.
    let flat = vec![90; size.0 * size.1];
    let mut matcher = BlockMatcher::new(BlockMatchingParams::default()).unwrap();
    let mut map = vec![0.0; flat.len()];
    let (view, full) = (gray(&flat, size.0, size.1), Rect::whole(size.0, size.1));
    matcher.compute(view, view, full, &Serial, plane_mut(&mut map, size.0, size.1), None).unwrap();
    assert!(map.iter().all(|value| value.is_nan()));
}

#[test]
fn portable_and_simd_and_any_number_of_threads_agree() {
    let size = (150, 230);
    for (min, search) in
        [(0, 32), (-5, 40), (20, 64), (3, 90), (0, 128), (-40, 160), (-60, 192), (0, 200), (-90, 256), (-100, 288)]
    {
        let (left, mut right) = plane_pair(size.0, size.1, [24.0, 0.04, 0.02]);
        for (index, value) in right.iter_mut().enumerate() {
            *value = value.saturating_add((hash(index as i64, 3) % 9) as u8);
        }
        let roi = Rect { x: 3, y: 1, width: 140, height: 226 };
        let fast = matchers(min, search).into_iter();
        let slow = matchers(min, search).into_iter().map(Matcher::portable);
        for (mut fast, mut slow) in fast.zip(slow) {
            let wanted = slow.run(&left, &right, size, roi, &Serial);
            assert!(wanted.0.iter().any(|value| value.is_finite()));
            for threads in [1, 2, 8] {
                let found = fast.run(&left, &right, size, roi, &Threads::new(threads));
                assert!(same_bits(&found.0, &wanted.0), "left, {min} {search}, {threads} threads");
                assert!(same_bits(&found.1, &wanted.1), "right, {min} {search}, {threads} threads");
            }
        }
    }
}

#[test]
fn sizes_without_room_do_no_harm() {
    for size in [(0, 0), (1, 1), (3, 5), (5, 3), (1, 40), (40, 1), (33, 2)] {
        let left: Vec<u8> = (0..size.0 * size.1).map(|i| hash(i as i64, 0) as u8).collect();
        for (min, search) in [(0, 32), (-200, 64), (500, 64), (2, 512)] {
            for mut matcher in matchers(min, search) {
                matcher.run(&left, &left, size, Rect::whole(9999, 9999), &Threads::new(2));
            }
        }
    }
}

#[test]
fn wrong_inputs_are_named() {
    let data = vec![0; 400];
    let mut matcher = BlockMatcher::new(BlockMatchingParams::default()).unwrap();
    let mut map = vec![0.0; 400];
    let refused = matcher.compute(
        gray(&data, 20, 20),
        gray(&data, 40, 10),
        Rect::whole(20, 20),
        &Serial,
        plane_mut(&mut map, 20, 20),
        None,
    );
    assert_eq!(refused.unwrap_err().to_string(), "right view is 40x10, expected 20x20");
    for params in [
        BlockMatchingParams { block_px: 8, ..Default::default() },
        BlockMatchingParams { search_px: 0, ..Default::default() },
        BlockMatchingParams { prefilter_cap: 63, ..Default::default() },
    ] {
        assert!(matches!(BlockMatcher::new(params), Err(StereoError::Parameter { .. })));
    }
    assert!(SemiGlobalMatcher::new(SemiGlobalParams { large_penalty: 5, ..Default::default() }).is_err());
}

/// Four tiles that cover a view, all with one range.
fn quarters((width, height): (usize, usize), first_px: i32, search_px: usize) -> Vec<Tile> {
    let tile = |x: usize, y: usize| {
        let area = Rect { x: x * width / 2, y: y * height / 2, width: width / 2, height: height / 2 };
        Tile { area, first_px, search_px }
    };
    vec![tile(0, 0), tile(1, 0), tile(0, 1), tile(1, 1)]
}

#[test]
fn tiles_of_one_range_give_what_one_search_gives() {
    let size = (240, 200);
    let (left, right) = plane_pair(size.0, size.1, [14.0, 0.05, 0.03]);
    let (l, r) = (gray(&left, size.0, size.1), gray(&right, size.0, size.1));
    let params = BlockMatchingParams { left_right_px: None, ..Default::default() };
    let tiles = quarters(size, 0, 64);
    let (mut whole, mut parts) = (vec![7.0; size.0 * size.1], vec![7.0; size.0 * size.1]);
    for threads in [1, 3] {
        for portable in [false, true] {
            let mut matcher = BlockMatcher::new(params.clone()).unwrap();
            if portable {
                matcher.force_portable();
            }
            let (pool, roi) = (Threads::new(threads), Rect::whole(size.0, size.1));
            matcher.compute(l, r, roi, &pool, plane_mut(&mut whole, size.0, size.1), None).unwrap();
            matcher.compute_tiles(l, r, &tiles, &pool, plane_mut(&mut parts, size.0, size.1)).unwrap();
            assert!(same_bits(&whole, &parts), "{threads} threads, portable: {portable}");
        }
    }
    // Paths of semi-global matching begin at a tile's rim: nearly the same.
    let mut matcher = SemiGlobalMatcher::new(SemiGlobalParams::default()).unwrap();
    matcher.compute_tiles(l, r, &tiles, &Threads::new(2), plane_mut(&mut parts, size.0, size.1)).unwrap();
    let (density, error) = errors(&parts, size, 40, 230, |x, y| 14.0 + 0.05 * x + 0.03 * y);
    assert!(density > 0.9 && error < 0.2, "density {density}, error {error}");
}

#[test]
fn every_tile_is_searched_over_its_own_range() {
    let size = (400, 120);
    let (near, near_right) = plane_pair(size.0, size.1 / 2, [150.0, 0.0, 0.0]);
    let (far, far_right) = plane_pair(size.0, size.1 / 2, [20.0, 0.0, 0.0]);
    let (left, right) = ([near, far].concat(), [near_right, far_right].concat());
    let (l, r) = (gray(&left, size.0, size.1), gray(&right, size.0, size.1));
    let upper = Tile { area: Rect { x: 160, y: 0, width: 240, height: 60 }, first_px: 130, search_px: 32 };
    let lower = Tile { area: Rect { x: 0, y: 60, width: 400, height: 60 }, first_px: 0, search_px: 64 };
    for matcher in &mut matchers(7, 32) {
        let mut map = vec![7.0; size.0 * size.1];
        let out = plane_mut(&mut map, size.0, size.1);
        match matcher {
            Matcher::Block(matcher) => matcher.compute_tiles(l, r, &[upper, lower], &Threads::new(2), out),
            Matcher::SemiGlobal(matcher) => matcher.compute_tiles(l, r, &[upper, lower], &Threads::new(2), out),
        }
        .unwrap();
        let share = |rows: std::ops::Range<usize>, columns: std::ops::Range<usize>, wanted: f32| {
            let values = rows.flat_map(|y| columns.clone().map(move |x| (x, y)));
            let (mut count, mut right) = (0, 0);
            for (x, y) in values {
                count += 1;
                right += usize::from((map[y * size.0 + x] - wanted).abs() < 0.3);
            }
            right as f64 / f64::from(count)
        };
        assert!(share(5..52, 170..390, 150.0) > 0.95, "{}", share(5..52, 170..390, 150.0));
        assert!(share(68..115, 40..390, 20.0) > 0.95, "{}", share(68..115, 40..390, 20.0));
        assert!(map[..60 * size.0].iter().enumerate().all(|(i, d)| i % size.0 >= 160 || d.is_nan()));
    }
}
