//! `stereo_net`: the network that ships matches rendered pairs, fills what a matcher left open, on any size; other files are refused.

use std::path::{Path, PathBuf};

use panoscope_node::harness::{Harness, HarnessError, Outputs, Setup};
use panoscope_node::random::SplitMix64;
use panoscope_node::{Bgr8, Confidence, Disparity, Gray8, GrayF32, Mask};
use panoscope_tools::stereo_net::StereoNet;

use crate::tiny_onnx::{FLOAT, WiredModel, folder, runtime_is_there};

type TestResult = Result<(), HarnessError>;

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("models/stereo_net.onnx")
}

fn params(more: &str) -> String {
    format!("params = {{ model = {:?} {more} }}", shipped())
}

/// A pair of a far wall and a near square, with what a matcher could have found of it.
struct Scene {
    size: (usize, usize),
    views: [Vec<u8>; 2],
    truth: Vec<f32>,
    /// With holes, wrong patches and a fattened square.
    matched: Vec<f32>,
}

/// Disparity of the square over that of the wall, px.
const STEP_PX: usize = 12;
/// How far a block matcher draws the square too large, px.
const FAT_PX: usize = 3;

/// Gray of a point of a surface; neighbours in steps of 2 px differ.
fn gray(x: usize, y: usize, surface: u64) -> u8 {
    let cell = SplitMix64((x as u64 / 2) << 32 | (y as u64 / 2) << 1 | surface).bits();
    (60 + cell % 100 + 60 * surface) as u8
}

fn scene(size: (usize, usize), wall_px: usize) -> Scene {
    let ((width, height), square_px) = (size, wall_px + STEP_PX);
    let inside = |x: usize, y: usize, grown: usize| {
        let within = |at: usize, side: usize| at + grown >= side / 3 && at < 2 * side / 3 + grown;
        within(x, width) && within(y, height)
    };
    let at = |make: &dyn Fn(usize, usize) -> f32| -> Vec<f32> {
        (0..width * height).map(|index| make(index % width, index / width)).collect()
    };
    let truth = at(&|x, y| if inside(x, y, 0) { square_px as f32 } else { wall_px as f32 });
    let left = (0..width * height).map(|i| gray(i % width, i / width, u64::from(inside(i % width, i / width, 0))));
    let right = (0..width * height).map(|index| {
        let (x, y) = (index % width, index / width);
        if inside(x + square_px, y, 0) { gray(x + square_px, y, 1) } else { gray(x + wall_px, y, 0) }
    });
    let matched = at(&|x, y| match (x * 4 / width, y * 5 / height) {
        _ if x < wall_px => f32::NAN,
        (3, 0) => f32::NAN,
        (0, 4) if x % 24 < 8 && y % 24 < 8 => wall_px as f32 + 34.0,
        _ if inside(x, y, FAT_PX) => square_px as f32,
        _ => wall_px as f32,
    });
    Scene { size, views: [left.collect(), right.collect()], truth, matched }
}

fn give<'a>(node: &'a mut Harness<StereoNet>, scene: &Scene) -> &'a mut Harness<StereoNet> {
    let (width, height) = scene.size;
    node.input_image::<Gray8>("left", width, height, &scene.views[0]).input_image::<Gray8>(
        "right",
        width,
        height,
        &scene.views[1],
    )
}

fn give_all<'a>(node: &'a mut Harness<StereoNet>, scene: &Scene) -> &'a mut Harness<StereoNet> {
    let (width, height) = scene.size;
    give(node, scene).input_image::<Disparity>("matched", width, height, &scene.matched)
}

/// Share of the pixels that are unknown or more than 2 px off, of those that both views show.
fn bad_share(found: &[f32], scene: &Scene, wall_px: usize) -> f64 {
    let seen = |index: &usize| index % scene.size.0 >= wall_px + STEP_PX;
    let is_bad = |index: &usize| found[*index].is_nan() || (found[*index] - scene.truth[*index]).abs() > 2.0;
    let all = (0..found.len()).filter(seen);
    all.clone().filter(is_bad).count() as f64 / all.count() as f64
}

fn bits(out: &Outputs) -> Vec<u32> {
    let maps =
        [out.plane::<Disparity>("disparity"), out.plane::<Confidence>("confidence"), out.plane::<GrayF32>("error")];
    maps.into_iter()
        .flat_map(|map| map.expect("a map").data.iter().map(|value| value.to_bits()).collect::<Vec<_>>())
        .collect()
}

#[test]
fn a_pair_is_matched_and_a_matchers_holes_and_mistakes_are_mended() -> TestResult {
    if !runtime_is_there() {
        return Ok(());
    }
    let scene = scene((320, 256), 6);
    let mut node = Harness::<StereoNet>::from_toml(&params(""))?;
    let alone = bad_share(give(&mut node, &scene).process()?.plane::<Disparity>("disparity")?.data, &scene, 6);
    assert!(alone < 0.08, "{alone} of the pixels are bad without a hint");
    let out = give_all(&mut node, &scene).process()?;
    let map = out.plane::<Disparity>("disparity")?;
    assert!(map.data.iter().all(|value| value.is_finite()), "every pixel is known");
    let (before, after) = (bad_share(&scene.matched, &scene, 6), bad_share(map.data, &scene, 6));
    assert!(after < 0.5 * before, "{before} of the pixels are bad before, {after} after");
    assert!(out.plane::<Confidence>("confidence")?.data.iter().all(|value| (0.0..=1.0).contains(value)));
    assert_eq!(out.plane::<Mask>("occluded")?.data.len(), 320 * 256);
    Ok(())
}

/// The stated error is larger where the views show nothing than where they match.
#[test]
fn the_error_is_large_where_nothing_shows_the_surface() -> TestResult {
    if !runtime_is_there() {
        return Ok(());
    }
    let mut scene = scene((320, 256), 6);
    let dark = |index: usize| index / 320 > 180;
    for view in &mut scene.views {
        view.iter_mut().enumerate().filter(|(index, _)| dark(*index)).for_each(|(_, value)| *value = 0);
    }
    scene.matched.iter_mut().enumerate().filter(|(index, _)| dark(*index)).for_each(|(_, value)| *value = f32::NAN);
    let mut node = Harness::<StereoNet>::from_toml(&params(""))?;
    let out = give_all(&mut node, &scene).process()?;
    let errors = out.plane::<GrayF32>("error")?;
    let mean = |rows: std::ops::Range<usize>| {
        let values = &errors.data[rows.start * 320..rows.end * 320];
        values.iter().sum::<f32>() / values.len() as f32
    };
    let (lit, black) = (mean(100..160), mean(200..250));
    assert!(black > 2.0 * lit, "it expects {black} px in the dark, {lit} px in the light");
    Ok(())
}

#[test]
fn disparities_beyond_the_reach_of_the_network_are_found_by_the_hint() -> TestResult {
    if !runtime_is_there() {
        return Ok(());
    }
    let scene = scene((640, 128), 230);
    let mut node = Harness::<StereoNet>::from_toml(&params(""))?;
    let out = give_all(&mut node, &scene).process()?;
    let bad = bad_share(out.plane::<Disparity>("disparity")?.data, &scene, 230);
    assert!(bad < 0.08, "{bad} of the pixels are bad");
    Ok(())
}

#[test]
fn colours_and_gray_of_one_picture_give_nearly_the_same() -> TestResult {
    if !runtime_is_there() {
        return Ok(());
    }
    let scene = scene((200, 120), 6);
    let mut node = Harness::<StereoNet>::from_toml(&params(""))?;
    let gray = bits(&give_all(&mut node, &scene).process()?);
    let colour = |view: &Vec<u8>| view.iter().flat_map(|value| [*value; 3]).collect::<Vec<u8>>();
    let [left, right] = scene.views.each_ref().map(colour);
    let out = node
        .input_image::<Bgr8>("left", 200, 120, &left)
        .input_image::<Bgr8>("right", 200, 120, &right)
        .input_image::<Disparity>("matched", 200, 120, &scene.matched)
        .process()?;
    assert_eq!(bits(&out), gray);
    Ok(())
}

#[test]
fn the_bits_do_not_depend_on_threads_or_on_what_came_before() -> TestResult {
    if !runtime_is_there() {
        return Ok(());
    }
    let (one, other) = (scene((200, 120), 6), scene((64, 90), 3));
    let mut all = Vec::new();
    for threads in [1, 2] {
        let mut node = Harness::<StereoNet>::open(Setup::new(&params("")).threads(threads))?;
        for _ in 0..2 {
            all.push(bits(&give_all(&mut node, &one).process()?));
            give_all(&mut node, &other).process()?;
        }
    }
    assert!(all.windows(2).all(|pair| pair[0] == pair[1]), "four runs of one pair differ");
    Ok(())
}

#[test]
fn any_size_and_scale_gives_numbers_even_where_nothing_was_matched() -> TestResult {
    if !runtime_is_there() {
        return Ok(());
    }
    for scale in [0, 1, 3] {
        let mut node = Harness::<StereoNet>::from_toml(&params(&format!(", scale = {scale}")))?;
        for (width, height) in [(1, 1), (2, 3), (33, 17), (70, 51), (1000, 40)] {
            for value in [f32::NAN, f32::INFINITY, 3e38, -4.0, 0.0, 7.5, 2000.0] {
                let gray = vec![0u8; width * height];
                let map = vec![value; width * height];
                let out = node
                    .input_image::<Gray8>("left", width, height, &gray)
                    .input_image::<Gray8>("right", width, height, &gray)
                    .input_image::<Disparity>("matched", width, height, &map)
                    .process()?;
                let map = out.plane::<Disparity>("disparity")?;
                assert_eq!((map.width, map.height), (width, height));
                assert!(map.data.iter().all(|v| v.is_finite()), "{width}x{height} of {value} with scale {scale}");
                assert!(out.plane::<GrayF32>("error")?.data.iter().all(|v| *v > 0.0 && v.is_finite()));
            }
        }
    }
    Ok(())
}

#[test]
fn what_is_unlit_or_too_uncertain_is_unknown() -> TestResult {
    if !runtime_is_there() {
        return Ok(());
    }
    let scene = scene((160, 96), 6);
    let mut mask = vec![255u8; 160 * 96];
    mask[..160 * 10].fill(0);
    let mut node = Harness::<StereoNet>::from_toml(&params(""))?;
    let out = give_all(&mut node, &scene).input_image::<Mask>("mask_left", 160, 96, &mask).process()?;
    let (map, errors) = (out.plane::<Disparity>("disparity")?, out.plane::<GrayF32>("error")?);
    for (index, value) in map.data.iter().enumerate() {
        assert_eq!(value.is_nan(), index < 160 * 10, "pixel {index}");
    }
    assert!(out.plane::<Confidence>("confidence")?.data[..160 * 10].iter().all(|value| *value == 0.0));
    let mut sorted = errors.data[160 * 10..].to_vec();
    sorted.sort_by(f32::total_cmp);
    let limit = sorted[sorted.len() / 2];
    node.set_params(&params(&format!(", max_error_px = {limit}")))?;
    let out = give_all(&mut node, &scene).input_image::<Mask>("mask_left", 160, 96, &mask).process()?;
    let gated = out.plane::<Disparity>("disparity")?;
    for (index, (value, error)) in gated.data.iter().zip(errors.data).enumerate().skip(160 * 10) {
        assert_eq!(value.is_nan(), *error > limit, "pixel {index} with an error of {error} px");
    }
    Ok(())
}

#[test]
fn inputs_of_other_sizes_and_other_files_are_refused() -> TestResult {
    if !runtime_is_there() {
        return Ok(());
    }
    let folder = folder("stereo_net");
    let plane = vec![-1, 3, -1, -1];
    let echo = WiredModel {
        inputs: vec![("left", FLOAT, plane.clone())],
        steps: vec![("Cast", vec!["left".into()], "disparity".into(), Some(FLOAT))],
        outputs: vec![("disparity", FLOAT, plane)],
        ..WiredModel::default()
    };
    let path = echo.write(&folder, "other.onnx");
    let refused = Harness::<StereoNet>::from_toml(&format!("params = {{ model = {path:?} }}"));
    let error = refused.err().expect("another network").to_string();
    assert!(error.contains("other.onnx has no input `right`") && error.contains("`onnx` others"), "{error}");
    std::fs::write(folder.join("cut.onnx"), &std::fs::read(shipped()).expect("the model")[..1000]).expect("a file");
    let refused = Harness::<StereoNet>::from_toml(&format!("params = {{ model = {:?} }}", folder.join("cut.onnx")));
    assert!(refused.err().expect("a cut file").to_string().contains("is malformed or truncated"));
    let missing = Harness::<StereoNet>::open(Setup::new("params = { model = \"nowhere.onnx\" }"));
    let error = missing.err().expect("no file").to_string();
    assert!(error.contains("`model` names a file that does not exist") && error.contains("nowhere.onnx"), "{error}");

    let (small, large) = (scene((64, 40), 3), scene((70, 40), 3));
    let mut node = Harness::<StereoNet>::from_toml(&params(""))?;
    node.input_image::<Gray8>("left", 64, 40, &small.views[0]);
    let wrong = node.input_image::<Gray8>("right", 70, 40, &large.views[1]).process();
    let text = match wrong {
        Ok(out) => out.fault().unwrap_or_default().to_owned(),
        Err(error) => error.to_string(),
    };
    assert!(text.contains("`left` is 64x40, `right` is 70x40"), "{text}");
    Ok(())
}
