//! The weighted-least-squares filter and the bilateral solver.

use crate::stereo_common::*;
use panoscope_base::Threads;
use panoscope_imaging::stereo::{
    BilateralSolver, BilateralSolverParams, FilterInput, StereoError, WlsFilter, WlsParams,
};
use panoscope_imaging::{Parallel, Rect, Serial, View};

#[allow(clippy::large_enum_variant)]
enum Filter {
    Wls(WlsFilter),
    Solver(BilateralSolver),
}

fn filters() -> Vec<Filter> {
    vec![
        Filter::Wls(WlsFilter::new(WlsParams::default()).unwrap()),
        Filter::Solver(BilateralSolver::new(BilateralSolverParams::default()).unwrap()),
    ]
}

impl Filter {
    fn portable(mut self) -> Self {
        match &mut self {
            Self::Wls(filter) => filter.force_portable(),
            Self::Solver(filter) => filter.force_portable(),
        }
        self
    }

    fn run(&mut self, input: FilterInput<'_>, pool: &dyn Parallel) -> (Vec<f32>, Vec<f32>) {
        let (width, height) = (input.disparity.width, input.disparity.height);
        let mut map = vec![7.0; width * height];
        let mut confidence = vec![7.0; width * height];
        let (out, out_confidence) = (plane_mut(&mut map, width, height), plane_mut(&mut confidence, width, height));
        match self {
            Self::Wls(filter) => filter.compute(input, pool, out, Some(out_confidence)),
            Self::Solver(filter) => filter.compute(input, pool, out, Some(out_confidence)),
        }
        .unwrap();
        (map, confidence)
    }
}

fn input<'a>(guide: View<'a, u8>, disparity: View<'a, f32>) -> FilterInput<'a> {
    let roi = Rect::whole(disparity.width, disparity.height);
    FilterInput { guide, disparity, disparity_right: None, confidence: None, roi }
}

#[test]
fn a_constant_stays_and_its_holes_are_filled() {
    let (width, height) = (97, 61);
    let guide = vec![120; width * height];
    let mut disparity = vec![23.5; width * height];
    for (index, value) in disparity.iter_mut().enumerate() {
        if hash(index as i64, 1).is_multiple_of(5) {
            *value = f32::NAN;
        }
    }
    for mut filter in filters() {
        let (map, confidence) =
            filter.run(input(gray(&guide, width, height), plane(&disparity, width, height)), &Serial);
        // Left of column 23 the right view does not reach: what only one camera sees stays unknown. Column 23 lies on the edge.
        let right = |(i, value): (usize, &f32)| match i % width {
            0..23 => value.is_nan(),
            23 => true,
            _ => (value - 23.5).abs() < 1e-3,
        };
        assert!(map.iter().enumerate().all(right));
        assert!(confidence.iter().all(|value| (0.3..=1.001).contains(value)));
    }
}

#[test]
fn values_stop_at_the_pictures_edges() {
    let (width, height) = (96, 64);
    let side = |x: usize| if x < 48 { (40u8, 10.0f32) } else { (210, 30.0) };
    let guide: Vec<u8> = (0..width * height).map(|i| side(i % width).0).collect();
    // Noise, and a rim of unknown pixels around the edge.
    let disparity: Vec<f32> = (0..width * height)
        .map(|i| {
            let noise = (hash(i as i64, 2) % 1000) as f32 / 1000.0 - 0.5;
            if (44..52).contains(&(i % width)) { f32::NAN } else { side(i % width).1 + noise }
        })
        .collect();
    let bgr = to_bgr(&guide);
    for guide in [View::new(&guide, width, height, 1), View::new(&bgr, width, height, 3)] {
        for mut filter in filters() {
            let given = vec![1.0; width * height];
            let mut input = input(guide, plane(&disparity, width, height));
            input.confidence = Some(plane(&given, width, height));
            let (map, _) = filter.run(input, &Serial);
            for (i, value) in map.iter().enumerate() {
                let truth = side(i % width).1;
                // Not seen by both views, or just so.
                if i % width < 12 {
                    assert!(value.is_nan() || i % width >= 9, "({}, {}) = {value}", i % width, i / width);
                    continue;
                }
                assert!((value - truth).abs() < 0.6, "({}, {}) = {value}, {truth} expected", i % width, i / width);
            }
        }
    }
}

#[test]
fn what_nothing_reaches_stays_unknown() {
    let (width, height) = (160, 80);
    // A dark half with values, a bright half without any: no support crosses the edge.
    let guide: Vec<u8> = (0..width * height).map(|i| if i % width < 80 { 20 } else { 240 }).collect();
    let disparity: Vec<f32> = (0..width * height).map(|i| if i % width < 70 { 12.0 } else { f32::NAN }).collect();
    for mut filter in filters() {
        let (map, confidence) =
            filter.run(input(gray(&guide, width, height), plane(&disparity, width, height)), &Serial);
        for y in 0..height {
            assert!((map[y * width + 40] - 12.0).abs() < 1e-2);
            assert!(map[y * width + 120].is_nan() && confidence[y * width + 120] < 0.02);
        }
    }
    let nothing = vec![f32::NAN; width * height];
    for mut filter in filters() {
        let (map, _) = filter.run(input(gray(&guide, width, height), plane(&nothing, width, height)), &Serial);
        assert!(map.iter().all(|value| value.is_nan()));
    }
}

#[test]
fn contradicted_and_glaring_pixels_are_not_trusted() {
    let (width, height) = (128, 64);
    let mut guide = vec![100; width * height];
    let mut disparity = vec![20.0f32; width * height];
    let disparity_right = vec![20.0f32; width * height];
    for y in 20..30 {
        for x in 60..70 {
            disparity[y * width + x] = 35.0;
        }
        for x in 90..100 {
            guide[y * width + x] = 255;
            disparity[y * width + x] = 21.0;
        }
    }
    let mut filter = WlsFilter::new(WlsParams::default()).unwrap();
    let mut map = vec![0.0; width * height];
    let mut input = input(gray(&guide, width, height), plane(&disparity, width, height));
    input.disparity_right = Some(plane(&disparity_right, width, height));
    filter.compute(input, &Serial, plane_mut(&mut map, width, height), None).unwrap();
    assert!((map[25 * width + 65] - 20.0).abs() < 0.05, "contradicted: {}", map[25 * width + 65]);
    let glare = map[25 * width + 95];
    assert!(glare.is_nan() || (glare - 20.0).abs() < 0.05, "glare: {glare}");
}

/// Far tissue with a box and a wire of 5 px before it: disparity and gray level.
fn objects(x: usize, y: usize) -> (f32, u8) {
    match (x, y) {
        (200..240, 100..130) => (70.0, 150),
        (_, 20..220) if (150 + y / 8..155 + y / 8).contains(&x) => (50.0, 40),
        _ => (30.0, 90),
    }
}

#[test]
fn objects_on_which_both_views_agree_keep_their_disparities() {
    let (width, height) = (320, 240);
    let noise = |i: usize| (hash(i as i64, 4) % 5) as u8;
    let guide: Vec<u8> = (0..width * height).map(|i| objects(i % width, i / width).1 + noise(i)).collect();
    let mut disparity: Vec<f32> = (0..width * height).map(|i| objects(i % width, i / width).0).collect();
    // The match reaches 3 px over the right side of the box; both views agree on that too.
    (100..130).for_each(|y| disparity[y * width + 240..][..3].fill(70.0));
    let mut right = vec![f32::NAN; width * height];
    for (i, d) in disparity.iter().enumerate() {
        let to = (i % width).checked_sub(*d as usize).map(|x| i / width * width + x);
        // The nearest surface hides the others.
        if let Some(other) = to.map(|to| &mut right[to]) {
            *other = other.max(*d);
        }
    }
    // A patch that the right view contradicts, and specks on which both agree.
    (40..60).for_each(|y| disparity[y * width + 270..][..20].fill(50.0));
    for at in [(100, 60), (90, 160), (300, 200)] {
        for i in 0..4 {
            let (x, y) = (at.0 + i % 2, at.1 + i / 2);
            (disparity[y * width + x], right[y * width + x - 45]) = (45.0, 45.0);
        }
    }
    for mut filter in filters() {
        let mut input = input(gray(&guide, width, height), plane(&disparity, width, height));
        input.disparity_right = Some(plane(&right, width, height));
        let (map, confidence) = filter.run(input, &Serial);
        let share = |counts: &dyn Fn(usize, usize) -> bool, truth: f32| {
            let all: Vec<usize> = (0..width * height).filter(|i| counts(i % width, i / width)).collect();
            let good = all.iter().filter(|i| (map[**i] - truth).abs() < 1.5).count();
            good as f64 / all.len() as f64
        };
        let is_wire = |x: usize, y: usize| objects(x, y).0 == 50.0;
        assert!(share(&is_wire, 50.0) > 0.98, "the wire: {}", share(&is_wire, 50.0));
        let is_box = |x: usize, y: usize| objects(x, y).0 == 70.0;
        assert!(share(&is_box, 70.0) > 0.95, "the box: {}", share(&is_box, 70.0));
        for (i, value) in confidence.iter().enumerate().filter(|(i, _)| is_wire(i % width, i / width)) {
            assert!(*value >= 0.05, "confidence {value} at {i}");
        }
        let reach = share(&|x, y| (240..243).contains(&x) && (103..127).contains(&y), 30.0);
        assert!(reach > 0.9 || matches!(filter, Filter::Solver(_)), "reach over the edge: {reach}");
        let contradicted = share(&|x, y| (270..290).contains(&x) && (40..60).contains(&y), 50.0);
        assert_eq!(contradicted, 0.0, "of the patch that the right view contradicts");
        assert!((map[60 * width + 100] - 30.0).abs() < 1.5, "a speck: {}", map[60 * width + 100]);
    }
}

#[test]
fn portable_and_simd_and_any_number_of_threads_agree() {
    for (width, height) in [(131, 117), (8, 40), (300, 33), (64, 200)] {
        let guide: Vec<u8> = (0..3 * width * height)
            .map(|i| texture((i / 3 % width) as f64 / 9.0, (i / 3 / width) as f64 / 9.0) as u8)
            .collect();
        let disparity: Vec<f32> = (0..width * height)
            .map(|i| {
                let roll = hash(i as i64, 4);
                if roll.is_multiple_of(7) {
                    f32::NAN
                } else {
                    20.0 + (roll % 100) as f32 / 50.0 + (i % width) as f32 / 20.0
                }
            })
            .collect();
        let roi = Rect { x: 0, y: 2, width: width - 1, height: height - 5 };
        let right = disparity.clone();
        let mut input = input(View::new(&guide, width, height, 3), plane(&disparity, width, height));
        input.roi = roi;
        for with_right in [false, true] {
            input.disparity_right = with_right.then(|| plane(&right, width, height));
            for (mut slow, number) in filters().into_iter().map(Filter::portable).zip(0..) {
                let wanted = slow.run(input, &Serial);
                for threads in [1, 2, 8] {
                    let found = filters().remove(number).run(input, &Threads::new(threads));
                    assert!(same_bits(&found.0, &wanted.0), "{width}x{height}, filter {number}, {threads} threads");
                    assert!(same_bits(&found.1, &wanted.1), "{width}x{height}, filter {number}, {threads} threads");
                }
            }
        }
        assert!(input.disparity.data.iter().any(|value| value.is_finite()));
    }
}

#[test]
fn a_warm_start_takes_fewer_steps_to_the_same_end() {
    let (width, height) = (160, 120);
    let guide: Vec<u8> =
        (0..width * height).map(|i| texture((i % width) as f64 / 15.0, (i / width) as f64 / 15.0) as u8).collect();
    let disparity: Vec<f32> = (0..width * height).map(|i| 30.0 + (hash(i as i64, 5) % 100) as f32 / 30.0).collect();
    let params = BilateralSolverParams { lambda: 16.0, tolerance: 1e-5, iterations: 200, ..Default::default() };
    let mut solver = BilateralSolver::new(params).unwrap();
    let mut cold = vec![0.0; width * height];
    let frame = input(gray(&guide, width, height), plane(&disparity, width, height));
    solver.compute(frame, &Serial, plane_mut(&mut cold, width, height), None).unwrap();
    let cold_steps = solver.steps();
    let mut warm = vec![0.0; width * height];
    solver.compute(frame, &Serial, plane_mut(&mut warm, width, height), None).unwrap();
    assert!(solver.steps() < cold_steps, "{} steps warm, {cold_steps} cold", solver.steps());
    let apart = cold.iter().zip(&warm).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(apart < 0.02, "{apart} px apart");
}

#[test]
fn odd_sizes_and_wild_numbers_do_no_harm() {
    for (width, height) in [(0, 0), (1, 1), (1, 20), (20, 1), (3, 5), (7, 17), (9, 16)] {
        let guide: Vec<u8> = (0..3 * width * height).map(|i| hash(i as i64, 6) as u8).collect();
        let wild = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, 0.0, 5.0];
        let disparity: Vec<f32> = (0..width * height).map(|i| wild[hash(i as i64, 7) as usize % wild.len()]).collect();
        let mut input = input(View::new(&guide, width, height, 3), plane(&disparity, width, height));
        input.disparity_right = Some(plane(&disparity, width, height));
        input.roi = Rect::whole(width + 100, height + 100);
        for mut filter in filters() {
            filter.run(input, &Threads::new(2));
            let mut given = input;
            given.confidence = Some(plane(&disparity, width, height));
            filter.run(given, &Threads::new(2));
        }
    }
}

#[test]
fn wrong_inputs_are_named() {
    let guide = vec![0; 100];
    let disparity = vec![0.0; 200];
    let mut filter = WlsFilter::new(WlsParams::default()).unwrap();
    let mut map = vec![0.0; 200];
    let refused = filter.compute(
        input(gray(&guide, 10, 10), plane(&disparity, 20, 10)),
        &Serial,
        plane_mut(&mut map, 20, 10),
        None,
    );
    assert!(matches!(refused, Err(StereoError::SizeMismatch { what: "guide", .. })));
    assert!(WlsFilter::new(WlsParams { lambda: f32::NAN, ..Default::default() }).is_err());
    assert!(BilateralSolver::new(BilateralSolverParams { sigma_luma: 0, ..Default::default() }).is_err());
}
