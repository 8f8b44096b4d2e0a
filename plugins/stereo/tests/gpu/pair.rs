//! Pairs that stay on the device give the maps of the processor: the same pixels are unmatched, the others agree to
//! 0.001 px.

use std::collections::HashMap;
use std::sync::Mutex;

use panoscope_imaging::lit::LitPart;
use panoscope_imaging::stereo::{BlockMatcher, BlockMatchingParams, PairMatcher, PairParams, SearchParams};
use panoscope_imaging::{Rect, Report, Serial, View, ViewMut};
use panoscope_stereo::gpu::pair::GpuPairMatcher;

use super::support::{Held, device};

/// Noise of a size, between its lattice points linear.
fn texture(x: f32, y: f32) -> f32 {
    let at = |x: f32, y: f32| {
        let mixed = (x as i32 as u32).wrapping_mul(73_856_093) ^ (y as i32 as u32).wrapping_mul(19_349_663);
        ((mixed ^ (mixed >> 13)).wrapping_mul(0x2c1b_3c6d) >> 24) as f32
    };
    let (i, j) = (x.floor(), y.floor());
    let (s, t) = (x - i, y - j);
    (at(i, j) * (1.0 - s) + at(i + 1.0, j) * s) * (1.0 - t)
        + (at(i, j + 1.0) * (1.0 - s) + at(i + 1.0, j + 1.0) * s) * t
}

/// A gray pair whose right view shows, in each column, what the left one shows `disparity` px further right. The left
/// view's disparity is nearly the same.
fn pair((width, height): (usize, usize), disparity: impl Fn(f32, f32) -> f32) -> [Vec<u8>; 2] {
    let view = |side: f32| {
        let gray = |i: usize| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            (20.0 + 0.8 * texture((x + side * disparity(x, y) + 999.0) / 3.0, (y + 999.0) / 3.0)) as u8
        };
        (0..width * height).map(gray).collect()
    };
    [view(0.0), view(1.0)]
}

/// The first value of each metric.
#[derive(Default)]
struct Metrics(Mutex<HashMap<String, f64>>);

impl Metrics {
    fn first(&self, name: &str) -> f64 {
        self.0.lock().expect("no panic").get(name).copied().unwrap_or(f64::NAN)
    }
}

impl Report for Metrics {
    fn info(&self, _: &str) {}

    fn warn(&self, _: &str) {}

    fn metric(&self, name: &str, value: f64) {
        self.0.lock().expect("no panic").entry(name.to_owned()).or_insert(value);
    }
}

struct Case {
    size: (usize, usize),
    roi: Rect,
    params: PairParams,
    lit: [Option<LitPart>; 2],
    has_right: bool,
}

impl Case {
    fn new(size: (usize, usize)) -> Self {
        let search = SearchParams {
            auto_offset: true,
            auto_range: true,
            min_disparity_px: 0,
            keeps_asked: false,
            search_px: 64,
            drift_px: 1.0,
        };
        let params = PairParams { search, left_right_px: Some(1), speckle_area_px: 0 };
        Self { size, roi: Rect::whole(size.0, size.1), params, lit: [None, None], has_right: true }
    }

    /// Matches a pair three times on the device and on the processor, and compares. Returns the left map and what the
    /// matcher reported of the first call; `None` without a device.
    fn check(&self, given: &[Vec<u8>; 2], what: &str) -> Option<(Vec<f32>, Metrics)> {
        let gpu = device()?;
        let (width, height) = self.size;
        let blocks = BlockMatchingParams { search_px: self.params.search.search_px, block_px: 9, ..Default::default() };
        let views = given.each_ref().map(|view| View::new(&view[..], width, height, 1));
        let mut pairs = [(); 2].map(|()| PairMatcher::new().expect("a matcher"));
        let parts = self.lit.each_ref().map(Option::as_ref);
        pairs.iter_mut().for_each(|pair| pair.set_lit(parts, 3));
        let mut processor = BlockMatcher::new(blocks.clone()).expect("a matcher");
        let mut on_gpu = GpuPairMatcher::new(gpu).expect("a matcher");
        let (metrics, of_host, mut last) = (Metrics::default(), Metrics::default(), Vec::new());
        for call in 0..3 {
            let mut expected = [0, 1].map(|_| vec![-1.0f32; width * height]);
            let [left, right] = expected.each_mut().map(|map| ViewMut::new(map, width, height, 1));
            let right = self.has_right.then_some(right);
            let [of_processor, of_gpu] = &mut pairs;
            of_processor
                .compute(&of_host, &mut processor, views, self.roi, &self.params, &Serial, left, right)
                .expect("matched on the processor");
            let stride = width + 7;
            let rows = |view: &Vec<u8>| {
                view.chunks_exact(width).flat_map(|row| row.iter().copied().chain([77; 7])).collect::<Vec<u8>>()
            };
            let held = given.each_ref().map(|view| Held::of(gpu, &rows(view), width, height, stride));
            let maps = [0, 1].map(|_| Held::new(gpu, width, height, 4));
            let there = held.each_ref().map(|held| held.image);
            let right = self.has_right.then_some(maps[1].image);
            on_gpu
                .compute(of_gpu, &metrics, there, self.roi, (&blocks, &self.params, 1), &Serial, maps[0].image, right)
                .expect("matched on the device");
            for side in 0..if self.has_right { 2 } else { 1 } {
                let bytes = maps[side].rows(gpu, 4 * width);
                for (at, (found, expected)) in bytes.as_chunks::<4>().0.iter().zip(&expected[side]).enumerate() {
                    let found = f32::from_le_bytes(*found);
                    let is_same = (found.is_nan() && expected.is_nan()) || (found - expected).abs() < 1e-3;
                    let (x, y) = (at % width, at / width);
                    assert!(is_same, "{what}, call {call}, side {side}: {found} and not {expected} at {x}, {y}");
                }
            }
            last = std::mem::take(&mut expected[0]);
        }
        let [row_error, expected] = [&metrics, &of_host].map(|metrics| metrics.first("epipolar_px"));
        let is_same = (row_error.is_nan() && expected.is_nan()) || (row_error - expected).abs() < 1e-6;
        assert!(is_same, "{what}: {row_error} rows and not {expected}");
        Some((last, metrics))
    }

    /// As [`Case::check`]; returns the known share of the left map.
    fn known(&self, given: &[Vec<u8>; 2], what: &str) -> Option<f64> {
        let (map, _) = self.check(given, what)?;
        Some(map.iter().filter(|d| d.is_finite()).count() as f64 / map.len() as f64)
    }
}

#[test]
fn whole_views_and_regions_stay_there() {
    for (size, has_right) in [((322, 91), true), ((323, 90), false), ((161, 67), true)] {
        let given = pair(size, |x, y| 30.0 + x / 40.0 + y / 30.0);
        let case = Case { has_right, ..Case::new(size) };
        let Some(known) = case.known(&given, &format!("{size:?}")) else { return };
        assert!(known > 0.3, "{size:?}: {known}");
        let roi = Rect::new(60, 21, 90, 33);
        let known = Case { roi, ..case }.known(&given, &format!("a region of {size:?}"));
        assert!(known > Some(0.01), "{known:?}");
    }
}

#[test]
fn tiles_stay_there() {
    let size = (401, 150);
    // More disparities than one search holds.
    let given = pair(size, |x, _| if x < 120.0 { 20.0 } else { 110.0 });
    for (roi, left_right_px) in [
        (Rect::whole(size.0, size.1), Some(1)),
        (Rect::whole(size.0, size.1), None),
        (Rect::new(130, 10, 200, 101), Some(1)),
    ] {
        let mut case = Case { roi, ..Case::new(size) };
        case.params.left_right_px = left_right_px;
        case.params.search.search_px = 32;
        let Some((map, metrics)) = case.check(&given, &format!("tiles of {roi:?}")) else { return };
        assert!(metrics.first("tiles") > 1.0);
        let known = map.iter().filter(|d| d.is_finite()).count();
        assert!(known * 10 > map.len(), "{known}");
    }
}

#[test]
fn rows_are_measured_there() {
    let size = (403, 250);
    let [left, mut right] = pair(size, |x, _| 30.0 + x / 50.0);
    right.rotate_right(size.0);
    let Some((_, metrics)) = Case::new(size).check(&[left, right], "a right view that is a row lower") else { return };
    let row_error = metrics.first("epipolar_px");
    assert!((row_error - 1.0).abs() < 0.3, "{row_error}");
}

#[test]
fn rims_and_speckles_are_cleared_there() {
    let size = (323, 120);
    let given = pair(size, |x, _| 25.0 + x / 50.0);
    let disc = |shift: f32| {
        let inside = |i: usize| ((i % 323) as f32 - 161.0 - shift).hypot((i / 323) as f32 - 60.0) < 90.0;
        let mask: Vec<u8> = (0..323 * 120).map(|i| u8::from(inside(i))).collect();
        let mut part = LitPart::default();
        part.read_mask(View::new(&mask, 323, 120, 1));
        Some(part)
    };
    for (lit, speckle_area_px) in [([disc(0.0), disc(3.0)], 0), ([disc(0.0), None], 30), ([None, None], 100)] {
        let mut case = Case { lit, ..Case::new(size) };
        case.params.speckle_area_px = speckle_area_px;
        let Some(known) = case.known(&given, &format!("speckles of {speckle_area_px}")) else { return };
        assert!(known > 0.2, "{known}");
    }
}

#[test]
fn a_narrow_strip_at_the_border_is_filled_there() {
    // From 60 to 14 px of the views are shared.
    let size = (641, 240);
    let shared = |y: f32| 581.0 + 46.0 * (y / 240.0).min(0.8) / 0.8;
    let given = pair(size, |_, y| shared(y));
    let mut case = Case::new(size);
    // The search ends before the lower half of the strip.
    case.params.search.auto_offset = false;
    case.params.search.min_disparity_px = 546;
    let Some((map, _)) = case.check(&given, "a strip") else { return };
    let filled = (150..220).filter(|y| (map[y * 641 + 638] - shared(*y as f32)).abs() < 2.0).count();
    assert!(filled > 50, "{filled} rows");
}

#[test]
fn swapped_and_blank_views_are_unknown_there() {
    let size = (321, 160);
    let [left, right] = pair(size, |x, _| 40.0 + x / 60.0);
    let Some((map, metrics)) = Case::new(size).check(&[right, left], "swapped") else { return };
    assert_eq!(metrics.first("views_swapped"), 1.0);
    assert!(map.iter().all(|d| d.is_nan()));
    let blank = [0, 1].map(|_| vec![9; size.0 * size.1]);
    assert_eq!(Case::new(size).known(&blank, "blank"), Some(0.0));
}
