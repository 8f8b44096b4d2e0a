//! OpenCV's stereo engines behind our ports: disparities come out in px, positive, NaN where unknown.

use panoscope_node::harness::{Harness, Level, Setup};
use panoscope_node::{Bgr8, Confidence, Disparity, Gray8};
use panoscope_opencv::{DisparityFbsOpencv, DisparityWlsOpencv, StereoOpencv};

const SIZE: (usize, usize) = (320, 120);
const NEAR_PX: usize = 38;
const FAR_PX: usize = 22;

fn noise(x: usize, y: usize) -> u8 {
    let mut h = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    (h >> 24) as u8
}

/// Two upright planes: the left half of the left view is far away, the right half near.
fn pair() -> (Vec<u8>, Vec<u8>) {
    let (width, height) = SIZE;
    let (mut left, mut right) = (vec![0; width * height], vec![0; width * height]);
    let smooth = |x: usize, y: usize| {
        let sum: u32 = (0..9).map(|k| u32::from(noise(x + k % 3, y + k / 3))).sum();
        (sum / 9) as u8
    };
    for y in 0..height {
        for x in 0..width {
            left[y * width + x] = smooth(x, y);
            let near = x + NEAR_PX;
            let from = if near >= width / 2 { near } else { x + FAR_PX };
            right[y * width + x] = smooth(from, y);
        }
    }
    (left, right)
}

fn bgr(gray: &[u8]) -> Vec<u8> {
    gray.iter().flat_map(|v| [*v; 3]).collect()
}

/// Share of known values in a box, and their median.
fn look(plane: panoscope_node::View<'_, f32>, columns: std::ops::Range<usize>) -> (f64, f32) {
    let mut known = Vec::new();
    let mut all = 0;
    for y in 20..SIZE.1 - 20 {
        for x in columns.clone() {
            all += 1;
            known.extend(Some(plane.row(y)[x]).filter(|v| v.is_finite()));
        }
    }
    known.sort_by(f32::total_cmp);
    (known.len() as f64 / f64::from(all), known.get(known.len() / 2).copied().unwrap_or(f32::NAN))
}

fn matched(method: &str) -> (Vec<f32>, Vec<f32>) {
    matched_with(method, "")
}

fn matched_with(method: &str, more: &str) -> (Vec<f32>, Vec<f32>) {
    let (left, right) = pair();
    let block = if method == "bm" { 15 } else { 5 };
    let toml = format!("params = {{ method = \"{method}\", search_px = 64, block_px = {block}{more} }}");
    let mut node = Harness::<StereoOpencv>::from_toml(&toml).unwrap();
    node.input_image::<Gray8>("left", SIZE.0, SIZE.1, &left).input_image::<Gray8>("right", SIZE.0, SIZE.1, &right);
    let out = node.process().unwrap();
    let copy = |port: &str| out.plane::<Disparity>(port).unwrap().data.to_vec();
    (copy("disparity"), copy("disparity_right"))
}

#[test]
fn both_matchers_see_both_planes() {
    for method in ["bm", "sgbm"] {
        let (disparity, other) = matched(method);
        let plane = |data| panoscope_node::View::new(data, SIZE.0, SIZE.1, 1);
        let (known, far) = look(plane(&disparity), 80..140);
        assert!(known > 0.9 && (far - FAR_PX as f32).abs() < 0.3, "{method}: {known} {far}");
        let (known, near) = look(plane(&disparity), 190..290);
        assert!(known > 0.9 && (near - NEAR_PX as f32).abs() < 0.3, "{method}: {known} {near}");
        // From the right view's pixels, and positive too.
        let (known, near) = look(plane(&other), 160..240);
        assert!(known > 0.9 && (near - NEAR_PX as f32).abs() < 0.3, "{method} right: {known} {near}");
    }
}

#[test]
fn without_its_own_checks_the_matcher_keeps_all_that_it_keeps_with_them() {
    let (strict, strict_right) = matched("bm");
    let (all, all_right) = matched_with("bm", ", own_checks = false");
    let known = |map: &[f32]| map.iter().filter(|v| v.is_finite()).count();
    assert!(known(&all) > known(&strict), "{} of {}", known(&all), known(&strict));
    for (a, s) in all.iter().zip(&strict).filter(|(_, s)| s.is_finite()) {
        assert_eq!(a, s, "a match is the same whether it is checked or not");
    }
    // The right matcher never has them.
    let bits = |map: &[f32]| map.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&all_right), bits(&strict_right));
}

#[test]
fn the_filters_fill_what_the_matcher_leaves_open() {
    let (disparity, other) = matched("bm");
    let (left, _) = pair();
    let guide = bgr(&left);
    let (width, height) = SIZE;
    let mut node = Harness::<DisparityWlsOpencv>::from_toml("params = { search_px = 64 }").unwrap();
    node.input_image::<Bgr8>("image", width, height, &guide)
        .input_image::<Disparity>("disparity", width, height, &disparity)
        .input_image::<Disparity>("disparity_right", width, height, &other);
    let out = node.process().unwrap();
    let smooth = out.plane::<Disparity>("disparity").unwrap();
    let trust = out.plane::<Confidence>("confidence").unwrap();
    let (known, near) = look(smooth, 190..290);
    assert!(known > 0.99 && (near - NEAR_PX as f32).abs() < 0.5, "{known} {near}");
    assert!(trust.data.iter().all(|c| (0.0..=1.0).contains(c)) && look(trust, 190..290).1 > 0.5);
    let (smooth, trust) = (smooth.data.to_vec(), trust.data.to_vec());
    let mut node = Harness::<DisparityFbsOpencv>::open(Setup::new("")).unwrap();
    node.input_image::<Bgr8>("image", width, height, &guide)
        .input_image::<Disparity>("disparity", width, height, &smooth)
        .input_image::<Confidence>("confidence", width, height, &trust);
    let out = node.process().unwrap();
    let (known, near) = look(out.plane::<Disparity>("disparity").unwrap(), 190..290);
    assert!(known > 0.99 && (near - NEAR_PX as f32).abs() < 1.0, "{known} {near}");
}

#[test]
fn sizes_that_differ_are_refused() {
    let (left, right) = pair();
    let mut node = Harness::<StereoOpencv>::from_toml("").unwrap();
    node.input_image::<Gray8>("left", SIZE.0, SIZE.1, &left);
    node.input_image::<Gray8>("right", SIZE.0 / 2, SIZE.1, &right[..SIZE.0 / 2 * SIZE.1]);
    let message = node.process().err().unwrap().to_string();
    assert!(message.contains("320x120") && message.contains("160x120"), "{message}");
}

/// A wall whose disparity rises from 213 to 252 px from left to right.
fn far_beyond(width: usize, height: usize) -> (Vec<u8>, Vec<u8>) {
    let smooth = |x: f64, y: usize| {
        let (column, part) = (x.floor(), x.fract());
        let at = |x: f64| {
            let sum: u32 = (0..9).map(|k| u32::from(noise((x as i64 + 1000) as usize + k % 3, y + k / 3))).sum();
            f64::from(sum) / 9.0
        };
        (at(column) * (1.0 - part) + at(column + 1.0) * part) as u8
    };
    let pixels = |shift: &dyn Fn(f64) -> f64| -> Vec<u8> {
        (0..width * height).map(|i| smooth(shift((i % width) as f64), i / width)).collect()
    };
    let rise = 39.0 / width as f64;
    // The right view's pixel x shows the left view's pixel u with u - d(u) = x.
    (pixels(&|x| x), pixels(&|x| (x + 213.0) / (1.0 - rise)))
}

#[test]
fn the_offset_is_found_and_a_search_beside_the_scene_is_said() {
    let (width, height) = (640, 96);
    let (left, right) = far_beyond(width, height);
    let truth = |x: usize| 213.0 + 39.0 * x as f32 / width as f32;
    for method in ["bm", "sgbm"] {
        let block = if method == "bm" { 15 } else { 5 };
        let open = |more: &str| {
            let toml = format!("params = {{ method = \"{method}\", block_px = {block}{more} }}");
            Harness::<StereoOpencv>::from_toml(&toml).unwrap()
        };
        let run = |node: &mut Harness<StereoOpencv>| {
            node.input_image::<Gray8>("left", width, height, &left)
                .input_image::<Gray8>("right", width, height, &right)
                .process()
                .unwrap()
        };
        // Known pixels that are right, and of how many.
        let judge = |out: &panoscope_node::harness::Outputs| {
            let map = out.plane::<Disparity>("disparity").unwrap();
            let known = (0..height).flat_map(|y| (260..620).map(move |x| (x, map.row(y)[x])));
            let known: Vec<_> = known.filter(|(_, d)| d.is_finite()).collect();
            let good = known.iter().filter(|(x, d)| (d - truth(*x)).abs() < 1.5).count();
            (good as f64 / known.len().max(1) as f64, known.len() as f64 / (360 * height) as f64)
        };
        let mut node = open("");
        let out = run(&mut node);
        let (good, known) = judge(&out);
        assert!(good > 0.95 && known > 0.7, "{method}: {good} of {known}");
        assert_eq!(node.logs(), []);
        assert!(node.metric("in_search_pct").is_some_and(|share| share > 90.0), "{:?}", node.metric("in_search_pct"));
        // The filter follows the matcher.
        let toml = format!("params = {{ method = \"{method}\", block_px = {block} }}");
        let mut wls = Harness::<DisparityWlsOpencv>::from_toml(&toml).unwrap();
        let copy = |port: &str| out.plane::<Disparity>(port).unwrap().data.to_vec();
        wls.input_image::<Bgr8>("image", width, height, &bgr(&left))
            .input_image::<Disparity>("disparity", width, height, &copy("disparity"))
            .input_image::<Disparity>("disparity_right", width, height, &copy("disparity_right"));
        let (good, known) = judge(&wls.process().unwrap());
        assert!(good > 0.9 && known > 0.7, "{method} wls: {good} of {known}");
        // As it was asked for: wrong everywhere, and said.
        let mut node = open(", auto_offset = false");
        for _ in 0..9 {
            let (good, _) = judge(&run(&mut node));
            assert!(good < 0.01, "{method}: {good}");
        }
        let said: Vec<_> = node.logs().iter().filter(|line| line.level == Level::Warn).collect();
        assert_eq!(said.iter().filter(|line| line.message.contains("`auto_offset`")).count(), 1, "{said:?}");
        assert!(node.metric("in_search_pct").is_some_and(|share| share < 25.0));
    }
}

#[test]
fn views_without_anything_in_common_are_said_to_be_so() {
    let blank = vec![90; SIZE.0 * SIZE.1];
    let mut node = Harness::<StereoOpencv>::from_toml("params = { method = \"sgbm\", block_px = 5 }").unwrap();
    for _ in 0..12 {
        node.input_image::<Gray8>("left", SIZE.0, SIZE.1, &blank).input_image::<Gray8>("right", SIZE.0, SIZE.1, &blank);
        node.process().unwrap();
    }
    let said = node.logs().iter().filter(|line| line.message.contains("hardly anything in the two views matches"));
    assert_eq!(said.count(), 1, "{:?}", node.logs());
    assert_eq!(node.metric("poor_match"), Some(1.0));
}
