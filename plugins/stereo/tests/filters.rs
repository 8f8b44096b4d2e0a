//! `disparity_wls` and `disparity_fbs` through the harness.

use crate::common::{SIZE, bgr, median};
use panoscope_node::harness::{Harness, HarnessError, Outputs, Setup};
use panoscope_node::{Bgr8, Confidence, Disparity, Gray8, GrayF32, Node};
use panoscope_stereo::{DisparityFbs, DisparityWls};

type TestResult = Result<(), HarnessError>;

const EDGE: usize = 200;

/// A near surface right of column `EDGE`, a far one left of it: disparity and gray level.
fn step(x: usize) -> (f32, u8) {
    if x < EDGE { (60.0, 80) } else { (90.0, 160) }
}

/// The step with holes, wrong values and nothing left of column 100.
fn holed() -> (Vec<u8>, Vec<f32>) {
    let count = SIZE.0 * SIZE.1;
    let gray = (0..count).map(|index| step(index % SIZE.0).1).collect();
    let disparity = (0..count).map(|index| {
        let (x, y) = (index % SIZE.0, index / SIZE.0);
        let hole = (40..48).contains(&y) && (120..180).contains(&x);
        if x < 100 || hole { f32::NAN } else { step(x).0 + 0.2 * ((index * 7919) % 3) as f32 - 0.2 }
    });
    (gray, disparity.collect())
}

fn run<N: Node>(node: &mut Harness<N>, gray: &[u8], disparity: &[f32]) -> Result<Outputs, HarnessError> {
    node.input_image::<Bgr8>("image", SIZE.0, SIZE.1, &bgr(gray))
        .input_image::<Disparity>("disparity", SIZE.0, SIZE.1, disparity)
        .process()
}

fn fills_holes_and_keeps_edges<N: Node>() -> TestResult {
    let (gray, disparity) = holed();
    for setup in [Setup::new(""), Setup::new("").threads(3), Setup::new("").read_only(&["disparity"])] {
        let mut node = Harness::<N>::open(setup)?;
        for _ in 0..3 {
            let out = run(&mut node, &gray, &disparity)?;
            let map = out.plane::<Disparity>("disparity")?;
            let at = |x: usize, y: usize| map.row(y)[x];
            // The solver stops at its residual: a hole without any support is the last to settle.
            assert!((at(150, 44) - 60.0).abs() < 1.5, "the hole: {}", at(150, 44));
            assert!((at(EDGE - 3, 90) - 60.0).abs() < 1.0, "left of the edge: {}", at(EDGE - 3, 90));
            assert!((at(EDGE + 3, 90) - 90.0).abs() < 1.0, "right of the edge: {}", at(EDGE + 3, 90));
            assert!(at(20, 64).is_nan(), "far from anything known: {}", at(20, 64));
            if !out.is_empty("confidence")? {
                let confidence = out.plane::<Confidence>("confidence")?;
                assert!(confidence.data.iter().all(|value| (0.0..=1.0).contains(value)));
                assert!(confidence.row(90)[250] > 0.3 && confidence.row(64)[20] < 0.05);
            }
        }
    }
    Ok(())
}

#[test]
fn wls_fills_holes_and_keeps_edges() -> TestResult {
    fills_holes_and_keeps_edges::<DisparityWls>()
}

#[test]
fn fbs_fills_holes_and_keeps_edges() -> TestResult {
    fills_holes_and_keeps_edges::<DisparityFbs>()
}

fn given_confidence_decides<N: Node>() -> TestResult {
    let (gray, mut disparity) = holed();
    let mut trust = vec![1.0; disparity.len()];
    for y in 80..90 {
        for x in 240..260 {
            (disparity[y * SIZE.0 + x], trust[y * SIZE.0 + x]) = (10.0, 0.0);
        }
    }
    let mut node = Harness::<N>::from_toml("")?;
    node.input_image::<Confidence>("confidence", SIZE.0, SIZE.1, &trust);
    let out = run(&mut node, &gray, &disparity)?;
    let map = out.plane::<Disparity>("disparity")?;
    let patch = median((242..258).map(|x| map.row(85)[x]));
    assert!((patch - 90.0).abs() < 1.0, "{patch}");
    Ok(())
}

#[test]
fn given_confidence_decides_in_both() -> TestResult {
    given_confidence_decides::<DisparityWls>()?;
    given_confidence_decides::<DisparityFbs>()
}

/// A map that was matched at half its size scatters as much as it does, however it is filtered.
#[test]
fn scatter_counts_alike_on_shrunk_maps() -> TestResult {
    let gray = vec![120; SIZE.0 * SIZE.1];
    let noisy = |index: usize| {
        let (x, y) = (index % SIZE.0 / 2, index / SIZE.0 / 2);
        60.0 + 4.0 * (panoscope_node::random::lattice(x as i64, y as i64, 8) as f32 - 0.5)
    };
    let disparity: Vec<f32> = (0..gray.len()).map(noisy).collect();
    let confidence = |scale: usize| -> Result<f32, HarnessError> {
        let mut node = Harness::<DisparityWls>::from_toml(&format!("params = {{ scale = {scale} }}"))?;
        let out = run(&mut node, &gray, &disparity)?;
        Ok(median(out.plane::<Confidence>("confidence")?.data.iter().copied()))
    };
    let (whole, half) = (confidence(1)?, confidence(2)?);
    assert!((0.5..0.85).contains(&whole), "{whole}");
    assert!((half - whole).abs() < 0.08, "{whole} at the whole size, {half} at half of it");
    Ok(())
}

fn nothing_known_stays_unknown<N: Node>() -> TestResult {
    for (width, height) in [(1, 1), (3, 50), (SIZE.0, SIZE.1)] {
        let gray = vec![100; width * height];
        let nothing = vec![f32::NAN; width * height];
        let mut node = Harness::<N>::from_toml("")?;
        let out = node
            .input_image::<Gray8>("image", width, height, &gray)
            .input_image::<Disparity>("disparity", width, height, &nothing)
            .process()?;
        assert!(out.plane::<Disparity>("disparity")?.data.iter().all(|value| value.is_nan()));
        assert!(out.plane::<Confidence>("confidence")?.data.iter().all(|value| *value == 0.0));
    }
    Ok(())
}

#[test]
fn nothing_known_stays_unknown_in_both() -> TestResult {
    nothing_known_stays_unknown::<DisparityWls>()?;
    nothing_known_stays_unknown::<DisparityFbs>()
}

#[test]
fn what_does_not_fit_is_named() -> TestResult {
    let mut node = Harness::<DisparityWls>::from_toml("")?;
    let mut said = |image: &mut dyn FnMut(&mut Harness<DisparityWls>)| {
        image(&mut node);
        node.input_image::<Disparity>("disparity", 8, 4, &[1.0; 32]);
        node.process().err().map(|error| error.to_string()).unwrap_or_default()
    };
    let words = said(&mut |node| {
        node.input_image::<Gray8>("image", 4, 8, &[0; 32]);
    });
    assert!(words.contains("`disparity` is 8x4, `image` is 4x8"), "{words}");
    let words = said(&mut |node| {
        node.input_image::<GrayF32>("image", 8, 4, &[0.0; 32]);
    });
    assert!(words.contains("gray8 or bgr8"), "{words}");
    let words = said(&mut |node| {
        node.input_image::<Gray8>("image", 8, 4, &[0; 32]);
        node.input_image::<Confidence>("confidence", 2, 16, &[0.0; 32]);
    });
    assert!(words.contains("`confidence` is 2x16"), "{words}");
    Ok(())
}
