//! Disparities matched on the device are those of the processor: the same pixels are unmatched, the others agree to
//! 0.001 px.

use super::support::device;
use panoscope_imaging::stereo::{BlockMatcher, BlockMatchingParams, Tile};
use panoscope_imaging::{Rect, Serial, View, ViewMut};
use panoscope_stereo::gpu::block_matching::GpuBlockMatcher;

/// Padding of the rows of views and maps.
const PADDING: usize = 13;
const UNTOUCHED: f32 = -77.0;

/// A pseudo-random number of 32 bits.
fn hash(x: usize, y: usize, seed: u32) -> u32 {
    let mixed =
        (x as u32).wrapping_mul(73_856_093) ^ (y as u32).wrapping_mul(19_349_663) ^ seed.wrapping_mul(83_492_791);
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x2c1b_3c6d);
    (mixed ^ (mixed >> 13)).wrapping_mul(0x297a_2d39) >> 7
}

/// Left and right rows of `width + PADDING` bytes. The right view is the left one, moved by disparities that change in
/// steps from `shift` on, with noise; a quarter of the left view is nearly flat, another one repeats itself, so that
/// each test of the matcher rejects pixels.
fn pair(width: usize, height: usize, shift: i32, seed: u32) -> [Vec<u8>; 2] {
    let texture = |x: i32, y: usize| {
        let x = (x + 5000) as usize;
        let value = match (x / 37 + y / 29) % 4 {
            0 => 100 + hash(x / 5, y / 5, seed) % 3,
            1 => 40 + 150 * u32::from(x % 9 < 4) + hash(x, y, seed) % 6,
            _ => hash(x / 2, y / 2, seed) % 180 + hash(x, y, seed + 1) % 60,
        };
        value as u8
    };
    let mut views = [0, 1].map(|_| vec![0; height * (width + PADDING)]);
    for (side, view) in views.iter_mut().enumerate() {
        for (y, row) in view.chunks_exact_mut(width + PADDING).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                let step = ((y / 17) % 3 + (x / 41) % 2) as i32 * 4;
                let at = x as i32 + side as i32 * (shift + step);
                let noise = hash(x, y, seed + 7 + side as u32) % 5;
                *value = texture(at, y).saturating_add(noise as u8);
            }
        }
    }
    views
}

/// Both maps of a matcher, with padding that stays `UNTOUCHED`; the right one is unused without `has_right`.
fn maps(
    (width, height): (usize, usize),
    has_right: bool,
    compute: impl FnOnce(&mut ViewMut<'_, f32>, Option<&mut ViewMut<'_, f32>>),
) -> [Vec<f32>; 2] {
    let stride = width + PADDING;
    let mut maps = [0, 1].map(|_| vec![UNTOUCHED; stride * height]);
    let [mut left, mut right] = maps.each_mut().map(|map| ViewMut::with_stride(map, width, height, 1, stride));
    compute(&mut left, has_right.then_some(&mut right));
    maps
}

/// Compares maps with `width + PADDING` values per row; returns how many are known, and how many are not equal to the
/// last bit.
fn compare(found: &[f32], expected: &[f32], width: usize, what: &str) -> (usize, usize) {
    let (mut known, mut rounded) = (0, 0);
    for (at, (a, b)) in found.iter().zip(expected).enumerate() {
        let (x, y) = (at % (width + PADDING), at / (width + PADDING));
        let is_same = a.is_nan() == b.is_nan() && (a.is_nan() || (a - b).abs() < 1e-3);
        assert!(is_same, "{what}: {a} and not {b} at column {x}, row {y}");
        if x < width && a.is_finite() {
            known += 1;
            rounded += usize::from(a.to_bits() != b.to_bits());
        }
    }
    (known, rounded)
}

/// The same map for a function that takes it.
fn lent<'a>(map: &'a mut ViewMut<'_, f32>) -> ViewMut<'a, f32> {
    ViewMut::with_stride(map.data, map.width, map.height, 1, map.stride)
}

/// Matches a pair on the device and the processor and compares; returns the share of pixels of the left view that are
/// known.
fn check(
    matcher: &mut GpuBlockMatcher,
    params: &BlockMatchingParams,
    [left, right]: [View<'_, u8>; 2],
    roi: Rect,
    has_right: bool,
) -> f64 {
    let (width, height) = (left.width, left.height);
    let found = maps((width, height), has_right, |map, map_right| {
        matcher.compute(params, left, right, roi, map, map_right, &Serial).expect("matched on the device");
    });
    let mut processor = BlockMatcher::new(params.clone()).expect("a matcher");
    let expected = maps((width, height), has_right, |map, map_right| {
        processor.compute(left, right, roi, &Serial, lent(map), map_right.map(lent)).expect("matched on the processor");
    });
    let what = format!("{width}x{height}, {roi:?}, {params:?}");
    let (known, rounded) = compare(&found[0], &expected[0], width, &format!("left map of {what}"));
    let (known_right, rounded_right) = compare(&found[1], &expected[1], width, &format!("right map of {what}"));
    if rounded + rounded_right > 0 {
        println!("{rounded} of {known} and {rounded_right} of {known_right} values differ in their last bits: {what}");
    }
    known as f64 / (width * height) as f64
}

/// As [`check`], for a pair of this size.
fn check_size(
    matcher: &mut GpuBlockMatcher,
    params: &BlockMatchingParams,
    (width, height): (usize, usize),
    roi: Rect,
    has_right: bool,
    seed: u32,
) -> f64 {
    let shift = params.min_disparity_px + (params.search_px as i32 / 3).min(20);
    let pixels = pair(width, height, shift, seed);
    let views = pixels.each_ref().map(|p| View::with_stride(&p[..], width, height, 1, width + PADDING));
    check(matcher, params, views, roi, has_right)
}

fn params(min: i32, search: usize, block: usize) -> BlockMatchingParams {
    BlockMatchingParams { min_disparity_px: min, search_px: search, block_px: block, ..BlockMatchingParams::default() }
}

#[test]
fn sizes_and_ranges_give_the_maps_of_the_processor() {
    let Some(gpu) = device() else { return };
    let mut matcher = GpuBlockMatcher::new(gpu).expect("a matcher");
    // The matcher keeps its memory: pictures get larger and smaller.
    for (seed, (size, min, search, block)) in [
        ((150, 70), 0, 32, 15),
        ((201, 67), 3, 50, 9),
        ((97, 33), -20, 64, 5),
        ((259, 101), 0, 64, 21),
        ((130, 40), -40, 32, 15),
        ((175, 45), 40, 96, 31),
        ((64, 32), 0, 128, 3),
        ((61, 90), 5, 20, 7),
        ((33, 7), -3, 33, 15),
        ((200, 50), -100, 200, 11),
        ((300, 40), 10, 512, 9),
    ]
    .into_iter()
    .enumerate()
    {
        let roi = Rect::whole(size.0, size.1);
        for has_right in [true, false] {
            let known = check_size(&mut matcher, &params(min, search, block), size, roi, has_right, seed as u32);
            assert!(known > 0.01 || size.0 < 100, "{size:?}: {known}");
        }
    }
}

#[test]
fn tests_reject_the_same_pixels() {
    let Some(gpu) = device() else { return };
    let mut matcher = GpuBlockMatcher::new(gpu).expect("a matcher");
    let size = (163, 75);
    let mut seed = 50;
    for cap in [0, 31, 7] {
        for uniqueness in [0, 15, 40] {
            for texture in [0, 400, 1_000_000] {
                for left_right in [None, Some(0), Some(1)] {
                    let params = BlockMatchingParams {
                        prefilter_cap: cap,
                        uniqueness_percent: uniqueness,
                        texture_threshold: texture,
                        left_right_px: left_right,
                        ..params(-5, 64, 9)
                    };
                    seed += 1;
                    let known =
                        check_size(&mut matcher, &params, size, Rect::whole(size.0, size.1), seed % 2 == 0, seed);
                    assert!(if texture > 65_535 { known == 0.0 } else { known > 0.1 }, "{params:?}: {known}");
                    if (uniqueness, texture, left_right) == (0, 0, None) {
                        assert!(known > 0.9, "{known}");
                    }
                }
            }
        }
    }
}

#[test]
fn lanes_outside_the_right_view_are_no_rivals() {
    let Some(gpu) = device() else { return };
    let mut matcher = GpuBlockMatcher::new(gpu).expect("a matcher");
    // Every other disparity is a rival: only pixels at the border, with few disparities, are left.
    let params = BlockMatchingParams { uniqueness_percent: 10_000, left_right_px: None, ..params(0, 32, 31) };
    let known = check_size(&mut matcher, &params, (120, 60), Rect::whole(120, 60), false, 190);
    assert!(known > 0.0 && known < 0.05, "{known}");
}

#[test]
fn a_region_is_matched_alone() {
    let Some(gpu) = device() else { return };
    let mut matcher = GpuBlockMatcher::new(gpu).expect("a matcher");
    let (width, height) = (203, 91);
    for (k, (roi, min, search)) in [
        (Rect::new(60, 30, 90, 40), 0, 64),
        (Rect::new(1, 1, 201, 89), 4, 32),
        (Rect::new(120, 50, 83, 41), -30, 64),
        (Rect::new(0, 0, 20, 91), 10, 32),
        (Rect::new(77, 88, 1, 3), 0, 32),
        (Rect::new(150, 80, 900, 900), 0, 128),
        // Nothing to match.
        (Rect::new(0, 0, 20, 91), 30, 32),
        (Rect::new(150, 0, 53, 91), -120, 32),
        (Rect::new(30, 30, 0, 10), 0, 32),
        (Rect::new(400, 30, 10, 10), 0, 32),
    ]
    .into_iter()
    .enumerate()
    {
        for block in [5, 15] {
            check_size(&mut matcher, &params(min, search, block), (width, height), roi, true, 200 + k as u32);
        }
    }
}

#[test]
fn views_without_texture_are_ties_that_go_the_same_way() {
    let Some(gpu) = device() else { return };
    let mut matcher = GpuBlockMatcher::new(gpu).expect("a matcher");
    let (width, height) = (140, 50);
    let params = BlockMatchingParams { texture_threshold: 0, uniqueness_percent: 0, ..params(-10, 64, 9) };
    for (left_right_px, stripe) in [(None, 0), (Some(1), 0), (None, 6), (Some(1), 6)] {
        // Equal, or in stripes that match at many disparities.
        let value = |at: usize| if stripe > 0 { (at % (width + PADDING) % stripe * 40) as u8 } else { 90 };
        let pixels: Vec<u8> = (0..height * (width + PADDING)).map(value).collect();
        let view = View::with_stride(&pixels[..], width, height, 1, width + PADDING);
        let params = BlockMatchingParams { left_right_px, ..params.clone() };
        check(&mut matcher, &params, [view, view], Rect::whole(width, height), true);
    }
}

#[test]
fn small_views_and_flat_ones_are_taken() {
    let Some(gpu) = device() else { return };
    let mut matcher = GpuBlockMatcher::new(gpu).expect("a matcher");
    for size in [(1, 1), (2, 3), (5, 1), (40, 2), (0, 5), (7, 0)] {
        for min in [-4, 0, 1] {
            let params = BlockMatchingParams { texture_threshold: 0, ..params(min, 32, 5) };
            check_size(&mut matcher, &params, size, Rect::whole(size.0, size.1), true, 300);
        }
    }
}

#[test]
fn tiles_give_the_map_of_the_processor() {
    let Some(gpu) = device() else { return };
    let mut matcher = GpuBlockMatcher::new(gpu).expect("a matcher");
    let (width, height) = (210, 98);
    let pixels = pair(width, height, 12, 400);
    let [left, right] = pixels.each_ref().map(|p| View::with_stride(&p[..], width, height, 1, width + PADDING));
    let mut tiles = Vec::new();
    for (row, y) in (0..height - 10).step_by(33).enumerate() {
        for (column, x) in (0..width).step_by(47).enumerate() {
            let (first_px, search_px) = ([0, 5, -12][(row + column) % 3], [32, 64, 20][(row * 2 + column) % 3]);
            tiles.push(Tile { area: Rect::new(x, y, 47, 33), first_px, search_px });
        }
    }
    tiles.push(Tile { area: Rect::new(0, height + 4, 10, 10), first_px: 0, search_px: 32 });
    for given in [&tiles[..], &tiles[3..4], &[]] {
        for left_right_px in [Some(1), None] {
            let params = BlockMatchingParams { left_right_px, ..params(0, 64, 9) };
            let found = maps((width, height), false, |map, _| {
                matcher.compute_tiles(&params, left, right, given, map, &Serial).expect("matched on the device");
            });
            let mut processor = BlockMatcher::new(params).expect("a matcher");
            let expected = maps((width, height), false, |map, _| {
                processor.compute_tiles(left, right, given, &Serial, lent(map)).expect("matched on the processor");
            });
            let (known, _) = compare(&found[0], &expected[0], width, &format!("{} tiles", given.len()));
            assert_eq!(known > 0, !given.is_empty());
        }
    }
    let wide = Tile { area: Rect::new(0, 0, 10, 10), first_px: 0, search_px: 513 };
    maps((width, height), false, |map, _| {
        let refused = matcher.compute_tiles(&params(0, 64, 9), left, right, &[wide], map, &Serial);
        assert!(refused.is_err_and(|e| e.to_string().contains("513")));
    });
}

#[test]
fn what_does_not_fit_is_refused_and_the_matcher_goes_on() {
    let Some(gpu) = device() else { return };
    let mut matcher = GpuBlockMatcher::new(gpu).expect("a matcher");
    let pixels = vec![9; 64 * 48];
    let (view, small) = (View::new(&pixels[..], 64, 48, 1), View::new(&pixels[..], 60, 48, 1));
    let roi = Rect::whole(64, 48);
    let mut map = vec![0.0; 64 * 48];
    let mut map = ViewMut::new(&mut map, 64, 48, 1);
    let refused =
        matcher.compute(&params(0, 32, 9), view, small, roi, &mut map, None, &Serial).expect_err("refused").to_string();
    assert!(refused.contains("right view") && refused.contains("60x48"), "{refused}");
    let refused =
        matcher.compute(&params(0, 32, 8), view, view, roi, &mut map, None, &Serial).expect_err("refused").to_string();
    assert!(refused.contains("block_px"), "{refused}");
    check_size(&mut matcher, &params(0, 32, 9), (64, 48), roi, true, 500);
}
