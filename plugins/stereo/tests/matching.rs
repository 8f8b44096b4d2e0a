//! `stereo_bm` and `stereo_sgbm` through the harness.

use crate::common;
use crate::common::{SIZE, median, pair};
use panoscope_node::abi::{Roi, Scalar};
use panoscope_node::harness::{Harness, HarnessError, Level, Outputs, Setup};
use panoscope_node::{Disparity, Gray8, Node};
use panoscope_stereo::{StereoBm, StereoSgbm};

type TestResult = Result<(), HarnessError>;

fn run<N: Node>(node: &mut Harness<N>, left: &[u8], right: &[u8]) -> Result<Outputs, HarnessError> {
    node.input_image::<Gray8>("left", SIZE.0, SIZE.1, left)
        .input_image::<Gray8>("right", SIZE.0, SIZE.1, right)
        .process()
}

fn density(out: &Outputs, port: &str) -> Result<f64, HarnessError> {
    let map = out.plane::<Disparity>(port)?;
    Ok(map.data.iter().filter(|value| value.is_finite()).count() as f64 / map.data.len() as f64)
}

fn warned<N>(node: &Harness<N>, words: &str) -> bool {
    node.logs().iter().any(|line| line.level == Level::Warn && line.message.contains(words))
}

/// A slanted surface far beyond a search from 0 px.
fn slanted(x: f64, y: f64) -> f64 {
    150.0 + 0.05 * x + 0.04 * y
}

fn finds_the_offset<N: Node>() -> TestResult {
    let (left, right) = pair(slanted, 0.0);
    let mut node = Harness::<N>::from_toml("params = { search_px = 64 }")?;
    let out = run(&mut node, &left, &right)?;
    let map = out.plane::<Disparity>("disparity")?;
    let error =
        |index: usize| (map.data[index] - slanted((index % SIZE.0) as f64, (index / SIZE.0) as f64) as f32).abs();
    let errors = median((0..map.data.len()).map(error));
    assert!(errors < 0.25, "median error {errors} px");
    // The views share 320 - 160 of 320 columns.
    assert!(density(&out, "disparity")? > 0.4, "{}", density(&out, "disparity")?);
    assert!(density(&out, "disparity_right")? > 0.4);
    let right_map = out.plane::<Disparity>("disparity_right")?;
    let back = median(right_map.data.iter().copied());
    assert!((160.0..180.0).contains(&back), "{back}");
    let offset = node.metric("offset_px").unwrap_or(0.0);
    assert!((100.0..160.0).contains(&offset), "{offset}");
    assert_eq!(node.logs(), []);

    let mut plain = Harness::<N>::from_toml("params = { search_px = 64, auto_offset = false }")?;
    let out = run(&mut plain, &left, &right)?;
    let map = out.plane::<Disparity>("disparity")?;
    let error =
        |index: usize| (map.data[index] - slanted((index % SIZE.0) as f64, (index / SIZE.0) as f64) as f32).abs();
    let right = (0..map.data.len()).filter(|index| error(*index) < 4.0).count();
    assert_eq!(right, 0, "a plain 0..64 search cannot see it");
    Ok(())
}

#[test]
fn block_matching_finds_the_offset() -> TestResult {
    finds_the_offset::<StereoBm>()
}

#[test]
fn semi_global_matching_finds_the_offset() -> TestResult {
    finds_the_offset::<StereoSgbm>()
}

fn says_what_it_cannot_match<N: Node>() -> TestResult {
    let (left, right) = pair(slanted, 0.0);
    let mut node = Harness::<N>::from_toml("params = { search_px = 64, auto_offset = false }")?;
    for _ in 0..13 {
        run(&mut node, &left, &right)?;
    }
    let said = |node: &Harness<N>, words: &str| node.logs().iter().filter(|line| line.message.contains(words)).count();
    assert_eq!(said(&node, "`auto_offset` on"), 1, "{:?}", node.logs());
    assert!(node.metric("in_search_pct").is_some_and(|share| share < 25.0));
    // A short loss of light is not reported; a long one is, and so is its end.
    let mut node = Harness::<N>::from_toml("params = { search_px = 64 }")?;
    let dark = vec![5; SIZE.0 * SIZE.1];
    for (views, calls, poor) in
        [((&left, &right), 4, 0), ((&dark, &dark), 4, 0), ((&left, &right), 4, 0), ((&dark, &dark), 16, 1)]
    {
        for _ in 0..calls {
            run(&mut node, views.0, views.1)?;
        }
        assert_eq!(said(&node, "hardly anything"), poor, "{:?}", node.logs());
    }
    assert_eq!(node.metric("poor_match"), Some(1.0));
    for _ in 0..8 {
        run(&mut node, &left, &right)?;
    }
    assert_eq!((said(&node, "match again"), node.metric("poor_match")), (1, Some(0.0)));
    assert!(node.metric("matched_pct").is_some_and(|share| share > 40.0), "{:?}", node.metric("matched_pct"));
    Ok(())
}

#[test]
fn block_matching_says_what_it_cannot_match() -> TestResult {
    says_what_it_cannot_match::<StereoBm>()
}

#[test]
fn semi_global_matching_says_what_it_cannot_match() -> TestResult {
    says_what_it_cannot_match::<StereoSgbm>()
}

#[test]
fn swapped_views_are_named_once() -> TestResult {
    let (left, right) = pair(slanted, 0.0);
    let mut node = Harness::<StereoBm>::from_toml("")?;
    for _ in 0..9 {
        run(&mut node, &right, &left)?;
    }
    assert!(warned(&node, "swapped"));
    assert_eq!(node.logs().len(), 1, "{:?}", node.logs());
    assert_eq!(node.metric("views_swapped"), Some(1.0));
    assert_eq!(density(&run(&mut node, &right, &left)?, "disparity")?, 0.0, "what matches by chance is withheld");
    for _ in 0..4 {
        run(&mut node, &left, &right)?;
    }
    assert!(density(&run(&mut node, &left, &right)?, "disparity")? > 0.4);
    assert_eq!(node.metric("views_swapped"), Some(0.0));
    Ok(())
}

#[test]
fn dark_views_do_not_put_swapped_ones_in_order() -> TestResult {
    let (left, right) = pair(slanted, 0.0);
    let dark = vec![3; SIZE.0 * SIZE.1];
    let mut node = Harness::<StereoBm>::from_toml("")?;
    for (left, right, calls) in [(&right, &left, 9), (&dark, &dark, 40)] {
        for _ in 0..calls {
            run(&mut node, left, right)?;
        }
        assert_eq!((node.metric("views_swapped"), node.logs().len()), (Some(1.0), 1), "{:?}", node.logs());
    }
    for _ in 0..9 {
        run(&mut node, &left, &right)?;
    }
    assert_eq!(node.metric("views_swapped"), Some(0.0));
    assert!(node.logs().last().is_some_and(|line| line.message.contains("in order again")), "{:?}", node.logs());
    Ok(())
}

#[test]
fn blank_and_unlike_views_are_not_called_swapped() -> TestResult {
    let blank = vec![90; SIZE.0 * SIZE.1];
    let (left, _) = pair(slanted, 0.0);
    let (other, _) = pair(|_, _| 0.0, 0.0);
    let other: Vec<u8> = other.into_iter().rev().collect();
    for (left, right) in [(&blank, &blank), (&left, &blank), (&left, &other)] {
        let mut node = Harness::<StereoBm>::from_toml("")?;
        let out = run(&mut node, left, right)?;
        assert_eq!(node.logs(), []);
        assert!(node.metric("views_swapped") != Some(1.0));
        assert!(density(&out, "disparity")? < 0.2, "{}", density(&out, "disparity")?);
    }
    Ok(())
}

#[test]
fn rows_that_do_not_fit_are_measured_and_warned_of() -> TestResult {
    let mut node = Harness::<StereoBm>::from_toml("")?;
    let (left, right) = pair(slanted, 0.0);
    let out = run(&mut node, &left, &right)?;
    assert_eq!(out.value::<Scalar>("drifted")?.value, 0.0);
    let good = node.metric("epipolar_px").unwrap_or(f64::NAN);
    assert!(good < 0.3, "{good}");
    let (left, right) = pair(slanted, 2.0);
    for _ in 0..80 {
        run(&mut node, &left, &right)?;
    }
    let bad = node.metric("epipolar_px").unwrap_or(f64::NAN);
    assert!((1.5..2.5).contains(&bad), "{bad}");
    assert!(warned(&node, "off their rows"));
    assert_eq!(run(&mut node, &left, &right)?.value::<Scalar>("drifted")?.value, 1.0);
    Ok(())
}

#[test]
fn a_slow_drift_is_warned_of_at_the_limit_and_its_end_is_told() -> TestResult {
    // A calibration that slips by a fifth of a row at a time.
    let drifting: Vec<_> = (0..8).map(|step| pair(slanted, 0.2 * f64::from(step))).collect();
    let mut first_warned = Vec::new();
    for limit in ["0.5", "1.0", "0"] {
        let mut node = Harness::<StereoBm>::from_toml(&format!("params = {{ drift_px = {limit} }}"))?;
        let mut first = None;
        for (step, (left, right)) in drifting.iter().enumerate() {
            for _ in 0..48 {
                run(&mut node, left, right)?;
            }
            if first.is_none() && warned(&node, "off their rows") {
                first = Some(step);
                assert_eq!(node.metric("drifted"), Some(1.0));
            }
        }
        first_warned.push(first);
        let (left, right) = &drifting[0];
        for _ in 0..80 {
            run(&mut node, left, right)?;
        }
        assert_eq!(node.metric("drifted"), Some(0.0));
        let warnings = node.logs().iter().filter(|line| line.message.contains("rows again")).count();
        assert_eq!(warnings, usize::from(first.is_some()), "limit {limit}");
        // Said once, not at every tick.
        let warnings = node.logs().iter().filter(|line| line.message.contains("off their rows")).count();
        assert_eq!(warnings, usize::from(first.is_some()), "limit {limit}");
    }
    let [tight, wide, never] = first_warned[..] else { panic!("{first_warned:?}") };
    assert!(tight.is_some_and(|step| (2..=4).contains(&step)), "{first_warned:?}");
    assert!(wide.is_some_and(|step| step > tight.unwrap_or(9) && step <= 7), "{first_warned:?}");
    assert_eq!(never, None);
    Ok(())
}

#[test]
fn a_narrow_shared_region_is_found() -> TestResult {
    // Of 320 columns the views share 40, as the thesis's scope does at 20 mm.
    let (left, right) = pair(|_, _| 280.0, 0.0);
    let mut node = Harness::<StereoBm>::from_toml("params = { search_px = 64 }")?;
    let out = run(&mut node, &left, &right)?;
    let map = out.plane::<Disparity>("disparity")?;
    let known = median(map.data.iter().copied());
    assert!((known - 280.0).abs() < 0.5, "{known} {:?}", node.metric("offset_px"));
    Ok(())
}

#[test]
fn speckles_go_where_they_are_asked_to() -> TestResult {
    // Views that show different things match here and there by chance.
    let (left, _) = pair(slanted, 0.0);
    let (_, right) = pair(|x, y| slanted(x + 4000.0, y) + 3000.0, 0.0);
    let open = |area: usize| {
        Harness::<StereoBm>::from_toml(&format!(
            "params = {{ auto_offset = false, left_right_px = -1, uniqueness = 0, speckle_area_px = {area} }}"
        ))
    };
    let (mut all, mut clean) = (open(0)?, open(400)?);
    let before = density(&run(&mut all, &left, &right)?, "disparity")?;
    let after = density(&run(&mut clean, &left, &right)?, "disparity")?;
    assert!(before > 0.3 && after < 0.5 * before, "{before} {after}");
    // What hangs together stays.
    let (left, right) = pair(|x, y| slanted(x, y) - 120.0, 0.0);
    let before = density(&run(&mut all, &left, &right)?, "disparity")?;
    let after = density(&run(&mut clean, &left, &right)?, "disparity")?;
    assert!(after > 0.95 * before, "{before} {after}");
    Ok(())
}

#[test]
fn only_the_roi_is_matched() -> TestResult {
    let (left, right) = pair(slanted, 0.0);
    for (roi, empty) in [
        (Roi { x: 200, y: 40, width: 60, height: 30 }, false),
        (Roi { x: -50, y: -50, width: 20, height: 20 }, true),
        (Roi { x: 400, y: 10, width: 100, height: 10 }, true),
        (Roi { x: 10, y: 10, width: -5, height: i32::MAX }, true),
    ] {
        let mut node = Harness::<StereoBm>::from_toml("")?;
        node.input_value("roi", roi);
        let out = run(&mut node, &left, &right)?;
        let map = out.plane::<Disparity>("disparity")?;
        let (mut inside, mut outside) = (0, 0);
        for (index, _) in map.data.iter().enumerate().filter(|(_, value)| value.is_finite()) {
            let (x, y) = ((index % SIZE.0) as i32, (index / SIZE.0) as i32);
            let within = (roi.x..roi.x.saturating_add(roi.width)).contains(&x)
                && (roi.y..roi.y.saturating_add(roi.height)).contains(&y);
            if within { inside += 1 } else { outside += 1 }
        }
        assert_eq!((outside, inside == 0), (0, empty), "{roi:?}: {inside} inside");
    }
    Ok(())
}

#[test]
fn views_that_nobody_has_rectified_are_not_matched_where_that_is_asked() -> TestResult {
    let (left, right) = pair(slanted, 0.0);
    let mut node = Harness::<StereoBm>::from_toml("params = { rectified_only = true }")?;
    assert!(run(&mut node, &left, &right)?.is_empty("disparity")?);
    node.input_value("calibration", common::rectified(400.0, 15.0));
    assert!(!run(&mut node, &left, &right)?.is_empty("disparity")?);
    assert!(!run(&mut Harness::<StereoBm>::from_toml("")?, &left, &right)?.is_empty("disparity")?);
    Ok(())
}

#[test]
fn views_of_two_sizes_are_refused() -> TestResult {
    let mut node = Harness::<StereoBm>::from_toml("")?;
    let failed = node
        .input_image::<Gray8>("left", 64, 48, &[0; 64 * 48])
        .input_image::<Gray8>("right", 48, 64, &[0; 64 * 48])
        .process();
    let words = failed.err().map(|error| error.to_string()).unwrap_or_default();
    assert!(words.contains("left view is 64x48, the right one 48x64"), "{words}");
    Ok(())
}

#[test]
fn tiny_views_and_odd_searches_give_empty_maps() -> TestResult {
    for (width, height) in [(1, 1), (5, 3), (40, 2), (2, 40)] {
        for toml in [
            "",
            "params = { search_px = 512, block_px = 31 }",
            "params = { auto_offset = false, min_disparity_px = 1000 }",
        ] {
            let mut node = Harness::<StereoBm>::from_toml(toml)?;
            let pixels = vec![7; width * height];
            let out = node
                .input_image::<Gray8>("left", width, height, &pixels)
                .input_image::<Gray8>("right", width, height, &pixels)
                .process()?;
            assert_eq!(density(&out, "disparity")?, 0.0);
            assert_eq!(warned(&node, "nothing can be matched"), toml.contains("1000"));
        }
    }
    Ok(())
}

#[test]
fn wrong_parameters_are_named() -> TestResult {
    for (toml, word) in [
        ("params = { block_px = 4 }", "block_px"),
        ("params = { search_px = 1000 }", "search_px"),
        ("params = { left_right_px = -2 }", "left_right_px"),
    ] {
        let words = Harness::<StereoBm>::from_toml(toml).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(words.contains(word), "{toml}: {words}");
    }
    let toml = "params = { small_penalty = 100, large_penalty = 50 }";
    let words = Harness::<StereoSgbm>::from_toml(toml).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(words.contains("large_penalty"), "{words}");
    Ok(())
}

#[test]
fn threads_do_not_show() -> TestResult {
    let (left, right) = pair(slanted, 0.0);
    let bits = |threads: usize| -> Result<Vec<u32>, HarnessError> {
        let mut node = Harness::<StereoSgbm>::open(Setup::new("").threads(threads))?;
        let out = run(&mut node, &left, &right)?;
        Ok(out.plane::<Disparity>("disparity")?.data.iter().map(|value| value.to_bits()).collect())
    };
    assert_eq!(bits(1)?, bits(4)?);
    Ok(())
}

/// A near surface below a far one: 160 px of range.
fn far_and_near(_: f64, y: f64) -> f64 {
    if y < 64.0 { 30.0 } else { 190.0 }
}

/// Shares of the pixels that both views show with the right disparity, of the far surface and of the near one.
fn shares(out: &Outputs) -> Result<[f64; 2], HarnessError> {
    let map = out.plane::<Disparity>("disparity")?;
    Ok([(8..54, 30.0_f32), (74..120, 190.0)].map(|(rows, wanted)| {
        let columns = wanted as usize + 8..SIZE.0 - 8;
        let all = rows.flat_map(|y: usize| map.row(y)[columns.clone()].iter());
        let (count, right) = all.fold((0, 0), |(n, right), d| (n + 1, right + usize::from((d - wanted).abs() < 0.5)));
        f64::from(right as u32) / f64::from(count)
    }))
}

fn finds_a_range_wider_than_the_search<N: Node>() -> TestResult {
    let (left, right) = pair(far_and_near, 0.0);
    let mut node = Harness::<N>::from_toml("")?;
    for _ in 0..6 {
        let out = run(&mut node, &left, &right)?;
        let [far, near] = shares(&out)?;
        assert!(far > 0.9 && near > 0.9, "{far} {near}");
        // Both views' maps agree where the filters compare them.
        let (map, back) = (out.plane::<Disparity>("disparity")?, out.plane::<Disparity>("disparity_right")?);
        let (mut known, mut unanswered) = (0, 0);
        for (index, d) in map.data.iter().enumerate().filter(|(_, d)| d.is_finite()) {
            let to = (index % SIZE.0) as f32 - d;
            let there = back.row(index / SIZE.0)[to.round() as usize];
            assert!(there.is_nan() || (there - d).abs() <= 1.0, "{index}: {d} {there}");
            known += 1;
            unanswered += usize::from(there.is_nan());
        }
        // Where the far surface meets the near one the shared field is not known exactly.
        assert!(known > 10_000 && unanswered * 20 < known, "{unanswered} of {known}");
    }
    assert!(node.metric("tiles").is_some_and(|count| count > 0.0), "{:?}", node.metric("tiles"));
    assert_eq!(node.metric("in_search_pct"), Some(100.0));
    let lines: Vec<_> = node.logs().iter().map(|line| (line.level, line.message.clone())).collect();
    assert!(lines.len() == 1 && lines[0].0 == Level::Info && lines[0].1.contains("over its own range"), "{lines:?}");

    // What one search holds is searched at once again.
    let (left, right) = pair(slanted, 0.0);
    for _ in 0..40 {
        run(&mut node, &left, &right)?;
    }
    assert_eq!(node.metric("tiles"), Some(0.0));
    Ok(())
}

#[test]
fn block_matching_finds_a_range_wider_than_the_search() -> TestResult {
    finds_a_range_wider_than_the_search::<StereoBm>()
}

#[test]
fn semi_global_matching_finds_a_range_wider_than_the_search() -> TestResult {
    finds_a_range_wider_than_the_search::<StereoSgbm>()
}

#[test]
fn a_coarse_match_finds_a_wide_range_too() -> TestResult {
    let (left, right) = pair(far_and_near, 0.0);
    let mut node = Harness::<StereoBm>::from_toml("params = { scale = 2 }")?;
    let map = run(&mut node, &left, &right)?;
    let map = map.plane::<Disparity>("disparity")?;
    for (rows, wanted) in [(12..50, 30.0), (78..116, 190.0)] {
        let found = median(rows.flat_map(|y| map.row(y).iter().copied()));
        assert!((found - wanted).abs() < 1.0, "{found} in place of {wanted}");
    }
    Ok(())
}

#[test]
fn a_range_that_does_not_fit_is_warned_of() -> TestResult {
    let (left, right) = pair(far_and_near, 0.0);
    let mut node = Harness::<StereoBm>::from_toml("params = { auto_range = false }")?;
    for _ in 0..16 {
        let [far, near] = shares(&run(&mut node, &left, &right)?)?;
        assert!(far.min(near) < 0.05, "one search cannot hold both: {far} {near}");
    }
    let said = node.logs().iter().filter(|line| line.message.contains("`auto_range` on")).count();
    assert_eq!((said, node.logs().len()), (1, 1), "{:?}", node.logs());
    assert!(node.metric("in_search_pct").is_some_and(|share| share < 90.0));
    Ok(())
}
