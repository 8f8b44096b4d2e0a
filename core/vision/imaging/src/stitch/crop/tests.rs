//! Tests of cropped panoramas, through the compositor.

use crate::stitch::*;
use crate::{Serial, View, ViewMut};
use std::time::Duration;

const SIZE: (usize, usize) = (320, 240);
/// Frames per second.
const RATE: usize = 20;

fn tissue(x: f64, y: f64) -> u8 {
    (130.0 + 50.0 * (0.11 * x + (0.05 * y).sin()).sin() + 30.0 * (0.13 * y).sin()) as u8
}

/// A view `dx` px to the right, black beside its lit columns.
fn view(dx: f64, lit: std::ops::Range<usize>) -> Vec<u8> {
    let pixel = |i: usize| {
        let (x, y) = (i % SIZE.0, i / SIZE.0);
        if lit.contains(&x) { tissue(x as f64 + dx, y as f64) } else { 0 }
    };
    (0..SIZE.0 * SIZE.1).flat_map(|i| [pixel(i); 3]).collect()
}

fn right(dx: f64, dy: f64) -> [f64; 9] {
    [1.0, 0.0, dx, 0.0, 1.0, dy, 0.0, 0.0, 1.0]
}

struct Frame {
    canvas: Canvas,
    data: Vec<u8>,
    mask: Vec<u8>,
    gain_percent: f64,
}

impl Frame {
    /// Pixels that are black or that no view covers.
    fn black(&self) -> usize {
        let dark = self.data.chunks_exact(3).zip(&self.mask).filter(|(pixel, mask)| pixel[0] <= 16 || **mask == 0);
        dark.count()
    }
}

struct Run {
    compositor: Compositor,
    views: [Vec<u8>; 2],
}

impl Run {
    fn new(crop: CropMethod, hold_s: f32, views: [Vec<u8>; 2]) -> Self {
        let params = CompositeParams { crop, crop_hold_s: hold_s, mark_lost: false, ..CompositeParams::default() };
        let mut compositor = Compositor::new(params);
        compositor.set_frame_interval(Duration::from_secs(1) / RATE as u32);
        Self { compositor, views }
    }

    fn frame(&mut self, map: [f64; 9], state: GeometryState) -> Frame {
        let views = [&self.views[0], &self.views[1]].map(|data| View::new(data, SIZE.0, SIZE.1, 3));
        let maps = [IDENTITY, map];
        let canvas = self.compositor.canvas(&views, &maps, state).unwrap();
        let (width, height) = (canvas.width, canvas.height);
        let (mut data, mut mask) = (vec![7; width * height * 3], vec![7; width * height]);
        let report = self
            .compositor
            .compose(
                &views,
                &maps,
                state,
                &Serial,
                &mut ViewMut::new(&mut data, width, height, 3),
                Some(&mut ViewMut::new(&mut mask, width, height, 1)),
            )
            .unwrap();
        assert_eq!(report.canvas, canvas);
        let mut shown = vec![7; width * height];
        self.compositor.shown(&mut ViewMut::new(&mut shown, width, height, 1)).unwrap();
        assert!(shown.iter().zip(&mask).all(|(shown, mask)| (*shown > 0) == (*mask > 0)));
        Frame { canvas, data, mask, gain_percent: report.view_gain_percent }
    }
}

fn run(crop: CropMethod) -> Run {
    Run::new(crop, 2.0, [view(0.0, 0..SIZE.0), view(150.0, 0..SIZE.0)])
}

#[test]
fn a_filled_panorama_has_no_black_border_and_shows_the_tissue_where_the_canvas_says() {
    let none = run(CropMethod::None).frame(right(150.0, 9.0), GeometryState::Fresh);
    assert!(none.black() > 10_000, "{} px without a crop", none.black());
    let mut run = run(CropMethod::Filled);
    let filled = run.frame(right(150.0, 9.0), GeometryState::Fresh);
    assert_eq!(filled.black(), 0, "{:?}", filled.canvas);
    // Of 470 x 231 px at most a cell is lost at each side.
    let Canvas { width, height, left, top } = filled.canvas;
    assert!(width >= 450 && height >= 210, "{:?}", filled.canvas);
    for (i, pixel) in filled.data.chunks_exact(3).enumerate() {
        let (x, y) = ((i % width) as i32 - left, (i / width) as i32 - top);
        if x < 140 {
            assert_eq!(pixel[0], tissue(f64::from(x), f64::from(y)), "{x}, {y} of {height}");
        }
    }
}

#[test]
fn the_rims_of_views_are_cropped_too() {
    let views = || [view(0.0, 44..SIZE.0), view(150.0, 0..270)];
    for (crop, most) in [(CropMethod::Filled, 0), (CropMethod::Content, 8 * SIZE.1)] {
        let frame = Run::new(crop, 2.0, views()).frame(right(150.0, 0.0), GeometryState::Fresh);
        assert!(frame.black() <= most, "{crop:?}: {} px are black in {:?}", frame.black(), frame.canvas);
        // 44 to 420 are lit.
        assert!((350..=384).contains(&frame.canvas.width), "{crop:?}: {:?}", frame.canvas);
        assert!(frame.canvas.height >= 224);
        // 376 columns beside 276.
        assert!((20.0..40.0).contains(&frame.gain_percent), "{crop:?}: {}", frame.gain_percent);
    }
}

#[test]
fn content_is_the_bounding_box() {
    let frame = run(CropMethod::Content).frame(right(150.0, 30.0), GeometryState::Fresh);
    let Canvas { width, height, left, top } = frame.canvas;
    assert_eq!((left, top), (0, 0));
    assert!((456..=472).contains(&width) && (256..=272).contains(&height), "{:?}", frame.canvas);
}

#[test]
fn the_panorama_holds_still_while_the_far_edge_does_not() {
    for crop in [CropMethod::Filled, CropMethod::Content] {
        let mut run = run(crop);
        let mut first = run.frame(right(150.0, 4.0), GeometryState::Fresh).canvas;
        let mut changes = 0;
        for i in 0..20 * RATE {
            let noise = |k: usize| ((i * 7919 + k * 104_729) % 101) as f64 / 100.0 - 0.5;
            let map = right(150.0 + 8.0 * noise(0), 4.0 + 5.0 * noise(1));
            let frame = run.frame(map, GeometryState::Fresh);
            changes += usize::from(frame.canvas != first);
            assert!(frame.canvas == first || i < 5 * RATE, "{crop:?}, frame {i}: {:?} after {first:?}", frame.canvas);
            first = frame.canvas;
            let is_full = crop == CropMethod::Content || frame.black() == 0;
            assert!(is_full || i < 5 * RATE, "frame {i}: {} px are black", frame.black());
        }
        assert!(changes < 2, "{crop:?}: {changes} changes");
    }
}

#[test]
fn a_filled_panorama_shrinks_once_and_grows_back_after_its_time() {
    let mut run = run(CropMethod::Filled);
    let mut sizes = Vec::new();
    let at = |run: &mut Run, sizes: &mut Vec<Canvas>, dx: f64, seconds: usize| {
        let mut last_change = None;
        for i in 0..seconds * RATE {
            let frame = run.frame(right(dx, 0.0), GeometryState::Fresh);
            if sizes.last() != Some(&frame.canvas) {
                sizes.push(frame.canvas);
                last_change = Some(i as f64 / RATE as f64);
            }
        }
        (last_change, sizes.len())
    };
    assert_eq!(at(&mut run, &mut sizes, 150.0, 3), (Some(0.0), 1));
    let (shrunk_s, count) = at(&mut run, &mut sizes, 100.0, 6);
    assert!(count == 2 && shrunk_s.is_some_and(|s| (0.25..1.0).contains(&s)), "{shrunk_s:?}, {count} sizes");
    let (grown_s, count) = at(&mut run, &mut sizes, 150.0, 6);
    assert!(count == 3 && grown_s.is_some_and(|s| (1.7..3.0).contains(&s)), "{grown_s:?}, {count} sizes");
    assert_eq!(sizes[0], sizes[2]);
    // Some bad registrations, which a look falls on, change nothing.
    (0..6).for_each(|_| drop(run.frame(right(60.0, 0.0), GeometryState::Fresh)));
    assert_eq!(at(&mut run, &mut sizes, 150.0, 4), (None, 3));
}

#[test]
fn a_lost_geometry_keeps_the_crop_and_before_any_the_first_view_is_whole() {
    let mut run = run(CropMethod::Filled);
    let alone = run.frame(IDENTITY, GeometryState::Lost);
    assert_eq!(alone.canvas, Canvas { width: SIZE.0, height: SIZE.1, left: 0, top: 0 });
    assert!(alone.black() == 0 && alone.gain_percent.abs() < 1e-9);
    let good = run.frame(right(150.0, 0.0), GeometryState::Fresh);
    let lost = run.frame(IDENTITY, GeometryState::Lost);
    assert_eq!(lost.canvas, good.canvas);
}

#[test]
fn the_gain_is_that_of_the_area() {
    let none = run(CropMethod::None).frame(right(160.0, 0.0), GeometryState::Fresh);
    assert!((none.gain_percent - 50.0).abs() < 0.1, "{}", none.gain_percent);
    let filled = run(CropMethod::Filled).frame(right(160.0, 0.0), GeometryState::Fresh);
    assert!((45.0..=50.0).contains(&filled.gain_percent), "{}", filled.gain_percent);
    let least = run(CropMethod::Filled).frame(right(8.0, 0.0), GeometryState::Fresh);
    assert!(least.gain_percent.abs() < 5.0, "{}", least.gain_percent);
}
