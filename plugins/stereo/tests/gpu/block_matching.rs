//! Disparities matched on the device are those of the processor: the same pixels are unmatched, the others agree to
//! 0.001 px.

use super::support::{Held, device};
use panoscope_imaging::stereo::{BlockMatcher, BlockMatchingParams, Tile};
use panoscope_imaging::{Rect, Serial, View, ViewMut};
use panoscope_node::Result;
use panoscope_node::device::{DeviceImage, Gpu};
use panoscope_stereo::gpu::block_matching::GpuBlockMatcher;

/// Padding of the rows of views.
const PADDING: usize = 13;

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

/// A matcher and its device.
struct Matcher {
    gpu: Gpu,
    blocks: GpuBlockMatcher,
}

impl Matcher {
    /// `None` without a device.
    fn new() -> Option<Self> {
        let gpu = device()?;
        Some(Self { gpu, blocks: GpuBlockMatcher::new(gpu).expect("a matcher") })
    }

    /// Maps of views with padded rows that `compute` matches there into maps of NaN.
    fn maps(
        &mut self,
        views: [View<'_, u8>; 2],
        compute: impl FnOnce(&mut GpuBlockMatcher, [DeviceImage; 2], [DeviceImage; 2]) -> Result<()>,
    ) -> Result<[Vec<f32>; 2]> {
        let (gpu, View { width, height, .. }) = (self.gpu, views[0]);
        let unknown: Vec<u8> = f32::NAN.to_le_bytes().repeat(width.next_multiple_of(4) * height);
        let views = views.map(|view| Held::of(gpu, view.data, width, height, view.stride));
        let maps = [(); 2].map(|()| Held::of(gpu, &unknown, width, height, DeviceImage::stride_bytes(width, 4)));
        compute(&mut self.blocks, views.each_ref().map(|view| view.image), maps.each_ref().map(|map| map.image))?;
        Ok(maps.map(|map| {
            let rows = if width > 0 { map.rows(gpu, 4 * width) } else { Vec::new() };
            rows.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
        }))
    }
}

/// Both maps of the processor, NaN where `compute` leaves them.
fn maps((width, height): (usize, usize), compute: impl FnOnce([ViewMut<'_, f32>; 2])) -> [Vec<f32>; 2] {
    let mut maps = [0, 1].map(|_| vec![f32::NAN; width * height]);
    compute(maps.each_mut().map(|map| ViewMut::new(map, width, height, 1)));
    maps
}

/// Compares maps of `width` columns; returns how many values are known, and how many are not equal to the last bit.
fn compare(found: &[f32], expected: &[f32], width: usize, what: &str) -> (usize, usize) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let (mut known, mut rounded) = (0, 0);
    for (at, (a, b)) in found.iter().zip(expected).enumerate() {
        let (x, y) = (at % width, at / width);
        let is_same = a.is_nan() == b.is_nan() && (a.is_nan() || (a - b).abs() < 1e-3);
        assert!(is_same, "{what}: {a} and not {b} at column {x}, row {y}");
        known += usize::from(a.is_finite());
        rounded += usize::from(a.is_finite() && a.to_bits() != b.to_bits());
    }
    (known, rounded)
}

/// Matches a pair on the device and the processor and compares; returns the share of pixels of the left view that are
/// known.
fn check(
    matcher: &mut Matcher,
    params: &BlockMatchingParams,
    views: [View<'_, u8>; 2],
    roi: Rect,
    has_right: bool,
) -> f64 {
    let (width, height) = (views[0].width, views[0].height);
    let found = matcher
        .maps(views, |blocks, views, [map, map_right]| {
            blocks.compute(params, views, roi, (map, has_right.then_some(map_right)))
        })
        .expect("matched on the device");
    let mut processor = BlockMatcher::new(params.clone()).expect("a matcher");
    let expected = maps((width, height), |[map, map_right]| {
        let map_right = has_right.then_some(map_right);
        processor.compute(views[0], views[1], roi, &Serial, map, map_right).expect("matched on the processor");
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
    matcher: &mut Matcher,
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
    let Some(mut matcher) = Matcher::new() else { return };
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
    let Some(mut matcher) = Matcher::new() else { return };
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
    let Some(mut matcher) = Matcher::new() else { return };
    // Every other disparity is a rival: only pixels at the border, with few disparities, are left.
    let params = BlockMatchingParams { uniqueness_percent: 10_000, left_right_px: None, ..params(0, 32, 31) };
    let known = check_size(&mut matcher, &params, (120, 60), Rect::whole(120, 60), false, 190);
    assert!(known > 0.0 && known < 0.05, "{known}");
}

#[test]
fn a_region_is_matched_alone() {
    let Some(mut matcher) = Matcher::new() else { return };
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
    let Some(mut matcher) = Matcher::new() else { return };
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
    let Some(mut matcher) = Matcher::new() else { return };
    for size in [(1, 1), (2, 3), (5, 1), (40, 2), (0, 5), (7, 0)] {
        for min in [-4, 0, 1] {
            let params = BlockMatchingParams { texture_threshold: 0, ..params(min, 32, 5) };
            check_size(&mut matcher, &params, size, Rect::whole(size.0, size.1), true, 300);
        }
    }
}

#[test]
fn tiles_give_the_map_of_the_processor() {
    let Some(mut matcher) = Matcher::new() else { return };
    let (width, height) = (210, 98);
    let pixels = pair(width, height, 12, 400);
    let views = pixels.each_ref().map(|p| View::with_stride(&p[..], width, height, 1, width + PADDING));
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
            let found = matcher.maps(views, |blocks, views, [map, _]| blocks.compute_tiles(&params, views, given, map));
            let found = found.expect("matched on the device");
            let mut processor = BlockMatcher::new(params).expect("a matcher");
            let expected = maps((width, height), |[map, _]| {
                processor.compute_tiles(views[0], views[1], given, &Serial, map).expect("matched on the processor");
            });
            let (known, _) = compare(&found[0], &expected[0], width, &format!("{} tiles", given.len()));
            assert_eq!(known > 0, !given.is_empty());
        }
    }
    let wide = Tile { area: Rect::new(0, 0, 10, 10), first_px: 0, search_px: 513 };
    let refused =
        matcher.maps(views, |blocks, views, [map, _]| blocks.compute_tiles(&params(0, 64, 9), views, &[wide], map));
    assert!(refused.is_err_and(|e| e.to_string().contains("513")));
}

#[test]
fn what_does_not_fit_is_refused_and_the_matcher_goes_on() {
    let Some(mut matcher) = Matcher::new() else { return };
    let pixels = vec![9; 64 * 48];
    let view = View::new(&pixels[..], 64, 48, 1);
    let roi = Rect::whole(64, 48);
    let refused =
        matcher.maps([view; 2], |blocks, views, [map, _]| blocks.compute(&params(0, 32, 8), views, roi, (map, None)));
    assert!(refused.is_err_and(|e| e.to_string().contains("block_px")));
    check_size(&mut matcher, &params(0, 32, 9), (64, 48), roi, true, 500);
}
